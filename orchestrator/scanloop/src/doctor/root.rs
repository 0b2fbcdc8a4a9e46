//! The files by which the kernel describes a machine.

use std::path::{Path, PathBuf};

/// The root of these files: that of this machine, or a folder of a test.
pub(super) struct Root(PathBuf);

impl Root {
    pub(super) fn of_this_machine() -> Self {
        Self("/".into())
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }

    /// The place of a file of the machine, `proc/self/limits`.
    pub(super) fn join(&self, path: impl AsRef<Path>) -> PathBuf {
        let path = path.as_ref();
        self.0.join(path.strip_prefix("/").unwrap_or(path))
    }

    /// A file without blanks at its ends; `None` where there is none.
    pub(super) fn read(&self, path: &str) -> Option<String> {
        let text = std::fs::read_to_string(self.join(path)).ok()?;
        Some(text.trim().to_owned())
    }

    /// What a link leads to.
    pub(super) fn link(&self, path: &str) -> Option<String> {
        Some(std::fs::read_link(self.join(path)).ok()?.to_string_lossy().into_owned())
    }
}

/// A machine that a test makes up.
#[cfg(test)]
pub(super) mod made_up {
    use super::*;

    pub(in crate::doctor) struct Machine {
        pub root: Root,
    }

    impl Machine {
        /// A machine with these files; `name` is that of the test.
        pub(in crate::doctor) fn new(name: &str, files: &[(&str, &str)]) -> Self {
            let folder = std::env::temp_dir().join(format!("scanloop-doctor-{name}-{}", std::process::id()));
            let machine = Self { root: Root(folder) };
            std::fs::create_dir_all(machine.root.path()).unwrap();
            files.iter().for_each(|(path, text)| machine.write(path, text));
            machine
        }

        pub(in crate::doctor) fn write(&self, path: &str, text: &str) {
            let path = self.root.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
    }

    impl Drop for Machine {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(self.root.path());
        }
    }
}
