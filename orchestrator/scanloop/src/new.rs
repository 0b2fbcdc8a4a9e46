//! `scanloop new`: a small project that drives, from the templates in `examples`.
//!
//! The templates are in this executable, so that an installed one has them. Programs in Rust and C are built with the crates
//! and the library of a source tree; those in Python have all that they need.

mod name;
mod template;

use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Component, Path, PathBuf};

use clap::{Args, ValueEnum};
use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile, make_folder};

use template::{TEMPLATES, Template};

/// A language that has templates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Language {
    /// Needs Cargo, and the source of Scanloop.
    Rust,
    /// Needs Python 3.11.
    Python,
    /// Needs a C compiler, make, Cargo, and the source of Scanloop.
    C,
}

/// What a project does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProjectRole {
    /// A driver of a robot, with a simulated device.
    Robot,
    /// Believes the odometer.
    Estimator,
    /// Describes what the scanner sees.
    Obstacles,
    /// Follows the nearest free line; `stage` is the same.
    #[value(alias = "stage")]
    Controller,
    /// A process without a role, with a topic of its own.
    Companion,
}

/// Arguments of `new`.
#[derive(Debug, Args)]
pub struct NewArguments {
    /// Name of the program, and of its folder, which is made here.
    pub name: String,
    /// Language of the program.
    #[arg(long, value_name = "LANGUAGE")]
    pub lang: Language,
    /// What the program is.
    #[arg(long, value_name = "ROLE")]
    pub role: ProjectRole,
    /// Source tree of Scanloop, for Rust and C; without it the one that this executable or this folder lies in.
    #[arg(long, value_name = "DIR")]
    pub source: Option<PathBuf>,
}

/// Writes the project.
///
/// # Errors
/// A name that is not allowed, a folder that exists, a language and role without a template, a missing source tree; exit
/// code 2.
pub(crate) fn new(arguments: &NewArguments) -> anyhow::Result<Exit> {
    let NewArguments { name, lang, role, source } = arguments;
    let template = template::find(*lang, *role).ok_or_else(|| no_template(*lang, *role))?;
    if let Some(reason) = name::refusal(name, template) {
        return Err(Failure::bad_input(format!("NAME = {name} is not allowed: {reason}")));
    }
    let folder = Path::new(name);
    if folder.symlink_metadata().is_ok() {
        return Err(Failure::bad_input(format!("{name} exists: name a folder that does not")));
    }
    let source = template.needs_source.then(|| source_tree(source.as_deref())).transpose()?;
    let from_folder = match &source {
        Some(source) => relative(source, &std::path::absolute(folder)?),
        None => PathBuf::new(),
    };
    std::fs::create_dir(folder).map_err(|error| Failure::bad_input(format!("{name}: {error}")))?;
    let lock = source.map(|source| source.join("Cargo.lock")).filter(|_| *lang == Language::Rust);
    if let Err(error) = write(template, folder, name, &from_folder, lock.as_deref()) {
        // The folder is ours: it was just made.
        let _ = std::fs::remove_dir_all(folder);
        return Err(error);
    }
    answer!(false, "{}", template.next_steps(name))?;
    Ok(Exit::Done)
}

fn write(
    template: &Template,
    folder: &Path,
    name: &str,
    source: &Path,
    lock: Option<&Path>,
) -> anyhow::Result<()> {
    // It stands in files of TOML and make.
    let is_plain = |letter: char| !letter.is_control() && !"\"\\$#:".contains(letter);
    let source = source.to_str().filter(|path| path.chars().all(is_plain)).ok_or_else(|| {
        let path = source.display();
        Failure::bad_input(format!(
            "the source tree is at {path}, seen from the project: a path with `\"`, `\\`, `$`, `#`, `:` or control \
             characters can't be used"
        ))
    })?;
    for file in template.files {
        let path = folder.join(file.path);
        write_file(&path, file.text(name, source).as_bytes())?;
        if file.is_program() {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755))?;
        }
    }
    // The same versions of the libraries as Scanloop.
    if let Some(lock) = lock.filter(|lock| lock.is_file()) {
        write_file(&folder.join("Cargo.lock"), &std::fs::read(lock)?)?;
    }
    Ok(())
}

fn write_file(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        make_folder(folder)?;
    }
    let mut file = NewFile::create(path, Existing::Keep, &[])?;
    file.write_all(content)?;
    file.finish()
}

fn no_template(lang: Language, role: ProjectRole) -> anyhow::Error {
    let shown =
        |lang: Language, role: ProjectRole| format!("--lang {} --role {}", value(&lang), value(&role));
    let there: Vec<String> = TEMPLATES.iter().map(|template| shown(template.lang, template.role)).collect();
    Failure::bad_input(format!("{} has no template; there are {}", shown(lang, role), there.join(", ")))
}

/// The name of a value on the command line.
fn value(value: &impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// The source tree of Scanloop.
fn source_tree(named: Option<&Path>) -> anyhow::Result<PathBuf> {
    let is_source = |folder: &Path| {
        ["shared-types", "services/runtime"].iter().all(|part| folder.join(part).join("Cargo.toml").is_file())
    };
    if let Some(named) = named {
        if is_source(named) {
            return Ok(std::path::absolute(named)?);
        }
        let named = named.display();
        return Err(Failure::bad_input(format!(
            "--source {named} is no source tree of Scanloop: it has no services/runtime"
        )));
    }
    let own = std::env::current_exe().unwrap_or_default();
    let here = std::env::current_dir().unwrap_or_default();
    let found = own.ancestors().chain(here.ancestors()).find(|folder| is_source(folder));
    found.map(Path::to_path_buf).ok_or_else(|| {
        let hint =
            "programs in Rust and C are built with the source of Scanloop: name its folder by --source DIR";
        Failure::bad_input(hint)
    })
}

/// The path to `target` as it is written in the folder `from`; both are absolute.
fn relative(target: &Path, from: &Path) -> PathBuf {
    let shared = target.components().zip(from.components()).take_while(|(one, other)| one == other).count();
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    up.chain(target.components().skip(shared)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_leads_up_to_what_both_have_and_down_again() {
        let path = |target, from| relative(Path::new(target), Path::new(from));
        assert_eq!(path("/a/scanloop", "/a/mine"), Path::new("../scanloop"));
        assert_eq!(path("/a/scanloop", "/a/scanloop/mine"), Path::new(".."));
        assert_eq!(path("/src/scanloop", "/a/b/mine"), Path::new("../../../src/scanloop"));
    }

    #[test]
    fn a_pair_without_a_template_is_refused_with_those_that_have_one() {
        let refused = no_template(Language::C, ProjectRole::Companion).to_string();
        assert!(
            refused.starts_with("--lang c --role companion has no template; there are --lang rust --role ")
        );
        assert!(refused.contains("--lang python --role companion"), "{refused}");
    }
}
