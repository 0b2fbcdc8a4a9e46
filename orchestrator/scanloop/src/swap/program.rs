//! The files that a command is made of: its program, its scripts, and what a Python script imports from its folder.
//!
//! Imports are found in the text, so one that the script computes while it runs is not found.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use console::user_file::{self, TEXT_BYTES};

/// Bytes of the header of an ELF file of 64 bits.
const ELF_HEADER: usize = 64;
/// The name of its interpreter stands in the first so many bytes of a script.
const FIRST_LINE: u64 = 256;
/// Relative imports go up this many folders at most.
const MAX_DOTS: usize = 8;

/// The files of a command, also through symbolic links: each path is one whose change changes the program.
pub(super) fn files(command: &[String]) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::new();
    for (index, part) in command.iter().enumerate() {
        let path = Path::new(part);
        // A program without a slash is looked up in PATH: an interpreter, or nothing that is being edited.
        let is_named = if index == 0 { part.contains('/') } else { path.is_file() };
        let Ok(path) = std::path::absolute(path) else { continue };
        if is_named {
            match path.parent() {
                Some(folder) if is_python(&path) => add_imports(&path, folder, &mut files),
                _ => _ = files.insert(path),
            }
        }
    }
    let targets: Vec<PathBuf> = files.iter().filter_map(|path| path.canonicalize().ok()).collect();
    files.extend(targets);
    files
}

/// A number for the content of all files; `None` while one of them is missing or not whole.
pub(super) fn fingerprint(files: &BTreeSet<PathBuf>, program: &Path) -> Option<u64> {
    let mut hasher = DefaultHasher::new();
    for path in files {
        let mut bytes = Vec::new();
        user_file::open(path).and_then(|mut file| file.read_to_end(&mut bytes)).ok()?;
        let is_executable = || path.metadata().is_ok_and(|found| found.permissions().mode() & 0o111 != 0);
        if bytes.is_empty() && path == program || !is_whole(&bytes) || path == program && !is_executable() {
            return None;
        }
        (path, bytes).hash(&mut hasher);
    }
    Some(hasher.finish())
}

/// Whether an ELF file has all that its header announces; other files are taken as they are.
fn is_whole(bytes: &[u8]) -> bool {
    if !bytes.starts_with(b"\x7fELF\x02\x01") {
        return true;
    }
    let number = |from: usize, length: usize| {
        let field = bytes.get(from..from + length)?;
        Some(field.iter().rev().fold(0_u64, |number, byte| number << 8 | u64::from(*byte)))
    };
    // Tables of segments and sections: where each starts, the size of a row, and how many there are.
    let end = |[at, size, count]: [(usize, usize); 3]| {
        let rows = number(size.0, size.1)?.checked_mul(number(count.0, count.1)?)?;
        number(at.0, at.1)?.checked_add(rows)
    };
    let tables = [[(32, 8), (54, 2), (56, 2)], [(40, 8), (58, 2), (60, 2)]];
    bytes.len() >= ELF_HEADER
        && tables.into_iter().all(|table| end(table).is_some_and(|end| end <= bytes.len() as u64))
}

fn is_python(path: &Path) -> bool {
    let is_script = || {
        let start = user_file::read_start(path, FIRST_LINE).unwrap_or_default();
        let line = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
        line.starts_with(b"#!") && String::from_utf8_lossy(line).contains("python")
    };
    path.extension().map_or_else(is_script, |extension| extension == "py")
}

/// Adds a Python file and, of what it imports, what is found below `folder`.
fn add_imports(file: &Path, folder: &Path, files: &mut BTreeSet<PathBuf>) {
    if !files.insert(file.to_owned()) {
        return;
    }
    let text = user_file::read_bytes(file, TEXT_BYTES).unwrap_or_default();
    for name in imported(&String::from_utf8_lossy(&text)) {
        let dots = name.len() - name.trim_start_matches('.').len();
        let mut base = if dots == 0 { Some(folder) } else { file.parent() };
        for _ in 1..dots.min(MAX_DOTS) {
            base = base.and_then(Path::parent);
        }
        let Some(base) = base else { continue };
        let mut place = base.to_owned();
        for part in name.split('.').filter(|part| !part.is_empty()) {
            place.push(part);
            for found in [place.with_extension("py"), place.join("__init__.py")] {
                if found.is_file() {
                    add_imports(&found, folder, files);
                }
            }
        }
    }
}

/// The modules that a Python text imports, with the names taken from them, which may be modules too.
fn imported(text: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    // One statement a line: lines within brackets, and those that end in a backslash, are joined.
    let joined = text.replace("\\\n", " ");
    let mut lines = joined.lines();
    while let Some(line) = lines.next() {
        let mut statement = line.split('#').next().unwrap_or_default().trim().to_owned();
        if statement.starts_with("from ") && statement.contains('(') {
            while !statement.contains(')')
                && let Some(more) = lines.next()
            {
                statement.push_str(more.split('#').next().unwrap_or_default());
            }
        }
        let plain = |part: &str| part.split_whitespace().next().unwrap_or_default().to_owned();
        if let Some(modules) = statement.strip_prefix("import ") {
            names.extend(modules.split(',').map(plain));
        } else if let Some((module, taken)) =
            statement.strip_prefix("from ").and_then(|rest| rest.split_once(" import "))
        {
            let module = module.trim();
            let link = if module.ends_with('.') { "" } else { "." };
            let taken = taken.replace(['(', ')'], " ");
            names.extend(taken.split(',').map(|name| format!("{module}{link}{}", plain(name))));
        }
    }
    names.retain(|name| !name.is_empty());
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder that is removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str, files: &[(&str, &str)]) -> Self {
            let folder = std::env::temp_dir().join(format!("scanloop-program-{name}-{}", std::process::id()));
            for (path, text) in files {
                let path = folder.join(path);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, text).unwrap();
            }
            Self(folder.canonicalize().unwrap())
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn a_python_program_is_its_script_and_what_it_imports_from_its_folder() {
        let folder = Folder::new(
            "imports",
            &[
                ("drive.py", "import os, plan\nfrom tools import (\n  near,  # comment\n  far)\n"),
                ("plan.py", "import numpy as np\nfrom tools.deep import *\nimport drive\n"),
                ("tools/__init__.py", "from . import near\n"),
                ("tools/near.py", "from .deep import x\n"),
                ("tools/deep.py", "    from .. import late\n"),
                ("late.py", ""),
                ("other.py", "import plan"),
            ],
        );
        let script = folder.0.join("drive.py").to_str().unwrap().to_owned();
        let command = ["python3".to_owned(), script, "--fast".to_owned()];
        let names: Vec<String> = files(&command)
            .iter()
            .map(|path| path.strip_prefix(&folder.0).unwrap().display().to_string())
            .collect();
        let expected =
            ["drive.py", "late.py", "plan.py", "tools/__init__.py", "tools/deep.py", "tools/near.py"];
        assert_eq!(names, expected);
    }

    #[test]
    fn a_program_that_is_half_written_is_not_whole() {
        let own = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert!(is_whole(&own) && is_whole(b"#!/bin/sh\n"));
        for length in [6, 63, 64, own.len() / 2, own.len() - 1] {
            assert!(!is_whole(&own[..length]), "{length} of {}", own.len());
        }
    }

    #[test]
    fn the_fingerprint_is_that_of_the_content() {
        let folder = Folder::new("print", &[("run", "#!/bin/sh\n"), ("a.py", "")]);
        let run = folder.0.join("run");
        let command = [run.to_str().unwrap().to_owned(), folder.0.join("a.py").to_str().unwrap().to_owned()];
        let all = files(&command);
        assert_eq!(all.len(), 2);
        assert_eq!(fingerprint(&all, &run), None, "not executable yet");
        std::fs::set_permissions(&run, PermissionsExt::from_mode(0o755)).unwrap();
        let before = fingerprint(&all, &run);
        assert!(before.is_some() && before == fingerprint(&all, &run));
        std::fs::write(folder.0.join("a.py"), "import os").unwrap();
        assert_ne!(fingerprint(&all, &run), before);
        std::fs::write(&run, "").unwrap();
        assert_eq!(fingerprint(&all, &run), None, "empty");
        let pipe = folder.0.join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RWXU).unwrap();
        assert_eq!(fingerprint(&[pipe.clone()].into(), &pipe), None, "it is not waited for");
    }
}
