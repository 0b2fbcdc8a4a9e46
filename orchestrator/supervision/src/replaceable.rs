//! Whether another user can replace a program: then a command that runs it gives that user all rights of this one.
//!
//! A file is safe when it, each folder above it and each link on the way belong to this user or to root, and only the
//! owner may write to them. In a folder with the sticky bit, such as `/tmp`, others may not rename or remove what is not
//! theirs, so that one is safe too. Write access of a group does not count where the group is the user's own, by the
//! convention that its number is that of the user.
//!
//! What a command runs in addition to its program counts too: the interpreter in the first line of a script, the program behind
//! `env`, and the modules in the folder of a Python script, with their compiled form. Python runs a module that others have
//! added there, so for such a folder the sticky bit does not help.
//!
//! Limits: access control lists are not read, nor the text of a shell script, nor what else a program loads by itself.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

use rustix::process::geteuid;

/// As many links on the way as the kernel follows.
const MAX_LINKS: u32 = 40;
/// As many scripts may be the interpreters of each other as the kernel accepts.
const MAX_INTERPRETERS: u32 = 5;
/// The kernel reads so many bytes of a file for the name of its interpreter.
const FIRST_LINE: u64 = 256;
const STICKY: u32 = 0o1000;
const GROUP_WRITES: u32 = 0o020;
const OTHERS_WRITE: u32 = 0o002;

/// Why another user can replace the program of a command, what it runs, or a file among its arguments; `None` when none can,
/// or when there is no such file.
pub fn command(command: &[String]) -> Option<String> {
    Runs { folder: PathBuf::new(), search: std::env::var_os("PATH"), links: 0 }.command(command)
}

/// Why another user can replace a file, with owner and mode of what makes it possible; `None` when none can.
pub fn path(path: &Path) -> Option<String> {
    let absolute = std::path::absolute(path).ok()?;
    let reason = walk(&absolute, geteuid().as_raw(), 0)?;
    Some(format!("another user can replace {}: {reason}", path.display()))
}

/// How a command is run: where, and with which search path.
#[derive(Clone)]
struct Runs {
    /// Names of files begin here; empty for the folder of this process.
    folder: PathBuf,
    search: Option<OsString>,
    /// Interpreters of interpreters so far.
    links: u32,
}

impl Runs {
    /// [`command`] for a command that is run so.
    fn command(&self, command: &[String]) -> Option<String> {
        let (name, arguments) = command.split_first()?;
        let program = self.program_file(name);
        let files: Vec<PathBuf> =
            arguments.iter().map(|name| self.folder.join(name)).filter(|path| path.is_file()).collect();
        let behind = || if is_called(name, "env") { self.behind_env(arguments) } else { None };
        let modules = || {
            let script = files.first().filter(|_| is_python(name))?;
            modules_beside(script)
        };
        let all = program.iter().chain(&files);
        all.clone()
            .find_map(|file| path(file))
            .or_else(|| all.clone().find_map(|file| self.interpreter_of(file)))
            .or_else(behind)
            .or_else(modules)
    }

    /// The file that the kernel would run.
    fn program_file(&self, program: &str) -> Option<PathBuf> {
        if program.contains('/') {
            return Some(self.folder.join(program));
        }
        let found = std::env::split_paths(self.search.as_ref()?).map(|folder| self.folder.join(folder));
        found.map(|folder| folder.join(program)).find(|file| file.is_file())
    }

    /// [`command`] for the interpreter that the first line of a script names.
    fn interpreter_of(&self, script: &Path) -> Option<String> {
        let line = first_line(script)?;
        let line = line.strip_prefix("#!")?.trim();
        // The kernel splits once: what follows the interpreter is one argument.
        let (interpreter, argument) = line.split_once([' ', '\t']).unwrap_or((line, ""));
        if interpreter.is_empty() || self.links == MAX_INTERPRETERS {
            return None;
        }
        let words = [interpreter, argument.trim()].into_iter().filter(|word| !word.is_empty());
        let mut command: Vec<String> = words.map(str::to_owned).collect();
        command.push(script.display().to_string());
        Self { links: self.links + 1, ..self.clone() }.command(&command)
    }

    /// [`command`] for the command among the arguments of `env`, with the folder and the search path that it sets.
    fn behind_env(&self, arguments: &[String]) -> Option<String> {
        let mut inner = self.clone();
        let mut words = VecDeque::from(arguments.to_vec());
        while let Some(word) = words.pop_front() {
            let (option, value) = option_of(&word);
            match (option, value) {
                (Some(Setting::Folder), value) => inner.folder.push(value.or_else(|| words.pop_front())?),
                (Some(Setting::Words), value) => {
                    let text = value.or_else(|| words.pop_front())?;
                    split(&text).into_iter().rev().for_each(|word| words.push_front(word));
                }
                (Some(Setting::Unset), None) => _ = words.pop_front(),
                (Some(Setting::Search), value) => inner.search = value.map(OsString::from),
                (Some(Setting::Unset | Setting::Other), _) => {}
                (None, _) => {
                    words.push_front(word);
                    break;
                }
            }
        }
        inner.command(&Vec::from(words))
    }
}

/// What a word before the command of `env` sets.
#[derive(Clone, Copy)]
enum Setting {
    /// The folder in which the command runs.
    Folder,
    /// More words.
    Words,
    /// A variable that it removes.
    Unset,
    /// The search path.
    Search,
    /// Nothing that leads to another program.
    Other,
}

/// What a word before the command of `env` sets, and its value unless that is the next word; no setting for the command.
fn option_of(word: &str) -> (Option<Setting>, Option<String>) {
    let of_letter = |letter| match letter {
        'C' => Some(Setting::Folder),
        'S' => Some(Setting::Words),
        'u' => Some(Setting::Unset),
        _ => None,
    };
    if let Some(long) = word.strip_prefix("--") {
        let (name, value) = long.split_once('=').map_or((long, None), |(name, value)| (name, Some(value)));
        let setting = match name {
            "chdir" => Setting::Folder,
            "split-string" => Setting::Words,
            "unset" => Setting::Unset,
            _ => Setting::Other,
        };
        return (Some(setting), value.map(str::to_owned));
    }
    if let Some(letters) = word.strip_prefix('-') {
        // The value of the last of several letters follows at once, or is the next word.
        let found = letters.char_indices().find_map(|(at, letter)| Some((at, of_letter(letter)?)));
        return found.map_or((Some(Setting::Other), None), |(at, setting)| {
            (Some(setting), Some(letters[at + 1..].to_owned()).filter(|value| !value.is_empty()))
        });
    }
    match word.split_once('=') {
        Some(("PATH", value)) => (Some(Setting::Search), Some(value.to_owned())),
        Some(_) => (Some(Setting::Other), None),
        None => (None, None),
    }
}

/// The words of a text as `env -S` splits it, without its escapes.
fn split(text: &str) -> Vec<String> {
    text.split_whitespace().map(|word| word.trim_matches(['"', '\'']).to_owned()).collect()
}

/// The first line of a file, as far as the kernel reads it; `None` when it is not readable as text.
fn first_line(file: &Path) -> Option<String> {
    let mut bytes = Vec::new();
    // Not every file is one that can be read to its end.
    let opened = std::fs::File::open(file).ok().filter(|_| file.is_file())?;
    opened.take(FIRST_LINE).read_to_end(&mut bytes).ok()?;
    let line = bytes.split(|byte| *byte == b'\n').next()?;
    String::from_utf8(line.to_vec()).ok()
}

/// Whether the last part of the name of a program is this.
fn is_called(program: &str, name: &str) -> bool {
    Path::new(program).file_name().is_some_and(|found| found == name)
}

fn is_python(program: &str) -> bool {
    let name = Path::new(program).file_name().and_then(|name| name.to_str()).unwrap_or("");
    name.starts_with("python") || name.starts_with("pypy")
}

/// Why another user can replace a module that a Python script finds beside it, or add one; `None` when none can.
fn modules_beside(script: &Path) -> Option<String> {
    // Python follows links to the script, and searches modules where it really is.
    let script = script.canonicalize().ok()?;
    let folder = script.parent()?;
    let compiled = folder.join("__pycache__");
    let added = |folder: &Path| {
        let fault = fault_of_mode(&folder.metadata().ok()?, geteuid().as_raw())?;
        Some(format!("another user can add modules to {}: it {fault}", folder.display()))
    };
    let files = |folder: &Path, endings: &[&str]| {
        let names = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let is_module = |path: &PathBuf| {
            let ending = path.extension().and_then(|ending| ending.to_str());
            ending.is_some_and(|ending| endings.contains(&ending))
        };
        names.filter(is_module).collect::<Vec<_>>()
    };
    let modules = files(folder, &["py", "so", "pyc"]).into_iter().chain(files(&compiled, &["pyc"]));
    added(folder)
        .or_else(|| path(&compiled))
        .or_else(|| added(&compiled))
        .or_else(|| modules.into_iter().find_map(|module| path(&module)))
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
    let owner = found.uid();
    if owner != user && owner != 0 {
        return Some(format!("belongs to user {owner}"));
    }
    // The mode of a link has no meaning, and in a sticky folder only owners rename and remove.
    if found.is_symlink() || found.is_dir() && found.mode() & STICKY != 0 {
        return None;
    }
    fault_of_mode(found, user)
}

/// Who else may write to a file or a folder.
fn fault_of_mode(found: &std::fs::Metadata, user: u32) -> Option<String> {
    let (owner, group, mode) = (found.uid(), found.gid(), found.mode());
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

    /// The reason against a command of words.
    fn reason(words: &[&str]) -> Option<String> {
        command(&words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn the_interpreter_of_a_script_and_the_program_behind_env_count() {
        let scratch = Scratch::new("interpreters");
        let open = scratch.0.join("open");
        std::fs::create_dir(&open).unwrap();
        std::fs::write(open.join("interpreter"), "").unwrap();
        set_mode(&open.join("interpreter"), 0o755);
        set_mode(&open, 0o777);
        let (open, script) = (open.display().to_string(), scratch.program());
        let name = script.display().to_string();
        for line in [
            format!("#!{open}/interpreter"),
            format!("#! {open}/interpreter -x"),
            format!("#!/usr/bin/env {open}/interpreter"),
            format!("#!/usr/bin/env -S {open}/interpreter -x"),
            format!("#!/usr/bin/env -S PATH={open} interpreter"),
        ] {
            std::fs::write(&script, format!("{line}\n")).unwrap();
            for words in [&[&*name][..], &["sh", &name], &["env", "A=b", &name]] {
                let reason = reason(words).unwrap_or_else(|| panic!("{line}: {words:?}"));
                assert!(reason.contains("open has owner"), "{reason}");
            }
        }
        std::fs::write(&script, "#!/usr/bin/env -S sh -e\n").unwrap();
        assert_eq!(reason(&[&name]), None);
        // An interpreter that is a script of itself has no end.
        std::fs::write(&script, format!("#!{name}\n")).unwrap();
        assert_eq!(reason(&[&name]), None);
        let folder = format!("--chdir={open}");
        let path = format!("PATH={open}");
        for words in [
            &["env", "-C", &open, "./interpreter"][..],
            &["/usr/bin/env", "-i", "-u", "HOME", &folder, "A=b", "./interpreter"],
            &["env", &path, "interpreter"],
            &["env", "-iC", &open, "./interpreter"],
            &["env", "-ivS", &format!("{open}/interpreter -x")],
            &["env", "--", "env", "-C", &open, "sh", "interpreter"],
        ] {
            assert!(reason(words).is_some_and(|reason| reason.contains("open has owner")), "{words:?}");
        }
        assert_eq!(reason(&["env", "-C", "/", "sh", "-c", "true"]), None);
        assert_eq!(reason(&["env"]), None);
    }

    #[test]
    fn modules_beside_a_python_script_count_with_their_compiled_form() {
        let scratch = Scratch::new("modules");
        let folder = scratch.0.join("inner");
        let (script, compiled) = (folder.join("m.py"), folder.join("__pycache__"));
        std::fs::create_dir(&compiled).unwrap();
        for file in [&script, &folder.join("helper.py"), &compiled.join("helper.cpython-312.pyc")] {
            std::fs::write(file, "").unwrap();
            set_mode(file, 0o644);
        }
        set_mode(&compiled, 0o755);
        let name = script.display().to_string();
        assert_eq!(reason(&["python3", &name]), None);
        for part in ["__pycache__", "__pycache__/helper.cpython-312.pyc", "helper.py"] {
            let part = folder.join(part);
            let before = part.metadata().unwrap().permissions();
            set_mode(&part, 0o777);
            let reason = reason(&["python3", "-u", &name]);
            assert!(reason.as_ref().is_some_and(|reason| reason.contains("mode 0777")), "{reason:?}");
            std::fs::set_permissions(&part, before).unwrap();
        }
        std::fs::write(&script, "#!/usr/bin/env python3\n").unwrap();
        assert_eq!(reason(&[&name]), None);
        // Others may add a module even to a sticky folder.
        set_mode(&folder, 0o1777);
        for words in [&[&*name][..], &["python3", &name]] {
            let reason = reason(words);
            assert!(reason.as_ref().is_some_and(|reason| reason.contains("can add modules")), "{reason:?}");
        }
    }
}
