//! Whether another user can replace a program: then a command that runs it gives that user all rights of this one.
//!
//! A file is safe when it, each folder above it and each link on the way belong to this user or to root, and only the
//! owner may write to them. In a folder with the sticky bit, such as `/tmp`, others may not rename or remove what is not
//! theirs, so that one is safe too. Write access of a group does not count where the group is the user's own, by the
//! convention that its number is that of the user.
//!
//! Limits: access control lists are not read, nor what a program loads by itself.

use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

use rustix::process::geteuid;

/// As many links on the way as the kernel follows.
const MAX_LINKS: u32 = 40;
const STICKY: u32 = 0o1000;
const GROUP_WRITES: u32 = 0o020;
const OTHERS_WRITE: u32 = 0o002;

/// Why another user can replace the program of a command, or a file among its arguments; `None` when none can, or when
/// there is no such file.
pub fn command(command: &[String]) -> Option<String> {
    let mut parts = command.iter();
    let program = parts.next().and_then(|program| program_file(program));
    let arguments = parts.map(PathBuf::from).filter(|path| path.is_file());
    program.into_iter().chain(arguments).find_map(|file| path(&file))
}

/// Why another user can replace a file, with owner and mode of what makes it possible; `None` when none can.
pub fn path(path: &Path) -> Option<String> {
    let absolute = std::path::absolute(path).ok()?;
    let reason = walk(&absolute, geteuid().as_raw(), 0)?;
    Some(format!("another user can replace {}: {reason}", path.display()))
}

/// The file that the kernel would run.
fn program_file(program: &str) -> Option<PathBuf> {
    if program.contains('/') {
        return Some(PathBuf::from(program));
    }
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file())
}

/// Checks each part of a path from the root on, links with the path that they lead to.
fn walk(path: &Path, user: u32, links: u32) -> Option<String> {
    let mut here = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => _ = here.pop(),
            part => here.push(part),
        }
        let Ok(found) = here.symlink_metadata() else { return None };
        if let Some(fault) = fault_of(&found, user) {
            return Some(format!("{} {fault}", here.display()));
        }
        if found.is_symlink() && links < MAX_LINKS {
            let target = here.parent()?.join(std::fs::read_link(&here).ok()?);
            if let Some(reason) = walk(&target, user, links + 1) {
                return Some(reason);
            }
            here = here.canonicalize().ok()?;
        }
    }
    None
}

fn fault_of(found: &std::fs::Metadata, user: u32) -> Option<String> {
    let (owner, group, mode) = (found.uid(), found.gid(), found.mode());
    if owner != user && owner != 0 {
        return Some(format!("belongs to user {owner}"));
    }
    // The mode of a link has no meaning, and in a sticky folder only owners rename and remove.
    if found.is_symlink() || found.is_dir() && mode & STICKY != 0 {
        return None;
    }
    let own_group = group == owner && group == user;
    let writers = match mode {
        _ if mode & OTHERS_WRITE != 0 => "all users".to_owned(),
        _ if mode & GROUP_WRITES != 0 && !own_group => format!("group {group}"),
        _ => return None,
    };
    Some(format!("has owner {owner} and mode {:04o}: {writers} may write to it", mode & 0o7777))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    /// A folder of its own below the temporary one, removed at the end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path =
                std::env::temp_dir().join(format!("scanloop-replaceable-{name}-{}", std::process::id()));
            std::fs::create_dir_all(path.join("inner")).unwrap();
            std::fs::write(path.join("inner/program"), "#!/bin/sh\n").unwrap();
            for part in ["", "inner", "inner/program"] {
                set_mode(&path.join(part), 0o755);
            }
            Self(path)
        }

        fn program(&self) -> PathBuf {
            self.0.join("inner/program")
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn set_mode(path: &Path, mode: u32) {
        std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    }

    #[test]
    fn a_file_in_folders_that_only_their_owner_writes_to_is_safe() {
        let scratch = Scratch::new("safe");
        assert_eq!(path(&scratch.program()), None);
        assert_eq!(command(&[scratch.program().display().to_string(), "--fast".to_owned()]), None);
        assert_eq!(path(Path::new("/bin/sh")), None);
        assert_eq!(path(&scratch.0.join("none")), None, "there is none to be replaced");
    }

    #[test]
    fn each_part_of_the_way_that_others_may_write_to_is_named() {
        let scratch = Scratch::new("parts");
        for part in ["", "inner", "inner/program"] {
            let part = scratch.0.join(part);
            set_mode(&part, 0o757);
            let reason = path(&scratch.program()).unwrap();
            let named = part.display().to_string();
            assert!(reason.contains(named.trim_end_matches('/')) && reason.contains("mode 0757"), "{reason}");
            assert!(reason.contains("all users"), "{reason}");
            set_mode(&part, 0o755);
        }
        // In a sticky folder others can't touch what is not theirs.
        set_mode(&scratch.0, 0o1777);
        assert_eq!(path(&scratch.program()), None);
    }

    #[test]
    fn links_are_followed_and_scripts_among_the_arguments_count() {
        let scratch = Scratch::new("links");
        let (open, link) = (scratch.0.join("open"), scratch.0.join("link"));
        std::fs::create_dir(&open).unwrap();
        std::fs::write(open.join("script"), "").unwrap();
        set_mode(&open, 0o777);
        symlink("open/script", &link).unwrap();
        assert!(path(&link).unwrap().contains("open has owner"), "{:?}", path(&link));
        let script = command(&["sh".to_owned(), open.join("script").display().to_string()]).unwrap();
        assert!(script.contains("open has owner"), "{script}");
    }
}
