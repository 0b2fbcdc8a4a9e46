//! `scanloop new`: each project that is offered is written, built, passes conformance, and drives.
//!
//! Programs in Rust are those that Cargo has built of the same sources for these tests; that the sources are the same, and
//! that Cargo resolves the manifest, is checked. `.ci/full` builds one from nothing.

use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, printed};

use super::tools::{DEAD_RECKONING, EXECUTABLE, MY_CONTROLLER, MY_ROBOT, compile, python, root};

/// Language, role, and cases that show that the program takes part; the others are those of its example.
const OFFERED: [(&str, &str, &[&str]); 8] = [
    ("rust", "controller", &["every-scan", "verified"]),
    ("rust", "estimator", &["every-scan", "header"]),
    ("rust", "robot", &["scans", "dead-man"]),
    ("c", "obstacles", &["every-scan", "sees-a-box"]),
    ("c", "robot", &["scans", "dead-man"]),
    ("python", "controller", &["every-scan", "verified"]),
    ("python", "robot", &["scans", "dead-man"]),
    ("python", "companion", &[]),
];

/// The words that start the program of a project, or `None` where it can't be built here.
fn build(folder: &Path, lang: &str, role: &str) -> Option<Vec<String>> {
    let path = |end: &str| folder.join(end).to_str().unwrap().to_owned();
    match lang {
        "rust" => {
            let (built, example) = match role {
                "controller" => (MY_CONTROLLER, "template-controller"),
                "robot" => (MY_ROBOT, "template-robot/rust"),
                _ => (DEAD_RECKONING, "rust/dead-reckoning"),
            };
            for entry in
                std::fs::read_dir(root().join("examples").join(example).join("src")).unwrap().flatten()
            {
                let written = std::fs::read(folder.join("src").join(entry.file_name())).unwrap();
                assert!(written == std::fs::read(entry.path()).unwrap(), "{}", entry.path().display());
            }
            let mut tree = Command::new(env!("CARGO"));
            tree.args(["tree", "--offline", "--manifest-path"]).arg(folder.join("Cargo.toml"));
            let tree = tree.output().unwrap();
            assert!(tree.status.success(), "{}", printed(&tree));
            std::fs::create_dir_all(folder.join("target/release")).unwrap();
            symlink(built, folder.join("target/release/mine")).unwrap();
            Some(vec![path("target/release/mine")])
        }
        "c" => {
            let types = root().join("examples/c");
            let types = if role == "obstacles" { folder } else { &types };
            compile(&folder.join(format!("{role}.c")), types, &folder.join(role));
            Some(vec![path(role)])
        }
        _ => {
            let interpreter = python("a project in Python that `scanloop new` writes")?;
            symlink(interpreter.parent().unwrap().parent().unwrap(), folder.join(".venv")).unwrap();
            let script = if role == "robot" { "robot.py" } else { "pure_pursuit.py" };
            Some(vec![path(".venv/bin/python"), "-B".to_owned(), path(script)])
        }
    }
}

#[test]
fn each_project_that_is_offered_is_written_built_and_passes_conformance() {
    repeat_when_late(|| {
        for (lang, role, cases) in OFFERED {
            let system = TestSystem::new(EXECUTABLE);
            let made = system.run(&[
                "new",
                "mine",
                "--lang",
                lang,
                "--role",
                role,
                "--source",
                root().to_str().unwrap(),
            ]);
            assert_eq!(made.status.code(), Some(0), "{}", printed(&made));
            let folder = system.folder().join("mine");
            let Some(program) = build(&folder, lang, role) else { continue };
            let mut suite = system.command(&["conformance", role, "--rate", "10"]);
            suite.args(cases.iter().flat_map(|case| ["--only", case])).arg("--").args(&program);
            if !cases.is_empty() {
                let suite = suite.output().unwrap();
                assert_eq!(suite.status.code(), Some(0), "{lang} {role}: {}", printed(&suite));
            }
            // A driver needs real time.
            let file = "mine/system.toml";
            let checked = system.run(&["check", "--system", file]);
            assert_eq!(checked.status.code(), Some(0), "{lang} {role}: {}", printed(&checked));
            if role != "robot" {
                let report = system.lockstep(&["free", "--system", file, "--set", "goal.x_m=3"]);
                // The estimator believes an odometer that does not report 1 % of the distance.
                assert!(
                    report.scans.commanded > 20 && report.scans.unaccounted == 0,
                    "{lang} {role}: {}",
                    report.reason
                );
            }
            system.assert_nothing_left();
        }
    });
}

#[test]
fn what_can_not_be_made_is_refused_and_nothing_is_left() {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::create_dir(system.folder().join("there")).unwrap();
    for (words, expected) in [
        ("there --lang python --role controller", "there exists"),
        ("a/b --lang python --role controller", "NAME = a/b is not allowed: a small letter, then "),
        ("Mine --lang python --role controller", "NAME = Mine is not allowed"),
        ("serde --lang rust --role controller", "the program uses a crate of this name"),
        ("self --lang rust --role controller", "NAME = self is not allowed: it is a keyword of Rust"),
        ("class --lang python --role controller", "NAME = class is not allowed: it is a keyword of Python"),
        (
            "mine --lang c --role controller",
            "--lang c --role controller has no template; there are --lang rust",
        ),
        ("mine --lang rust --role robot --source there", "--source there is no source tree of Scanloop"),
    ] {
        let refused = system.run(&[&["new"], words.split(' ').collect::<Vec<_>>().as_slice()].concat());
        assert_eq!(refused.status.code(), Some(2), "{words}: {}", printed(&refused));
        assert!(printed(&refused).contains(expected), "{words}: {}", printed(&refused));
    }
    let quoted = system.folder().join("a\"b");
    symlink(root(), &quoted).unwrap();
    let words = ["new", "mine", "--lang", "rust", "--role", "robot", "--source", quoted.to_str().unwrap()];
    let refused = system.run(&words);
    std::fs::remove_file(&quoted).unwrap();
    assert_eq!(refused.status.code(), Some(2), "{}", printed(&refused));
    assert!(printed(&refused).contains("can't be used"), "{}", printed(&refused));
    let left: Vec<_> =
        std::fs::read_dir(system.folder()).unwrap().flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(left, ["there"]);
}

/// Cargo only warns of names such as `core`, and edition 2024 has the keyword `gen`.
#[test]
fn names_that_cargo_refuses_are_refused_and_names_beside_them_are_not() {
    let system = TestSystem::new(EXECUTABLE);
    let by_cargo = |name: &str| {
        let mut new = Command::new(env!("CARGO"));
        new.args(["new", "--quiet", "--vcs", "none", name]).current_dir(system.folder());
        !new.output().unwrap().status.success()
    };
    let words = "abstract as async await become box break const continue crate do dyn else enum extern false final fn for \
        gen if impl in let loop macro match mod move mut override priv pub ref return self static struct super trait true \
        try type typeof unsafe unsized use virtual where yield test build deps examples incremental union auto default \
        safe raw main macro_rules tests lib bin src target debug release name edition version a_ a- self-driving";
    let source = root();
    for name in words.split_ascii_whitespace() {
        let made = system.run(&[
            "new",
            name,
            "--lang",
            "rust",
            "--role",
            "robot",
            "--source",
            source.to_str().unwrap(),
        ]);
        let refused = made.status.code() == Some(2);
        let _ = std::fs::remove_dir_all(system.folder().join(name));
        assert!(refused || made.status.success(), "{name}: {}", printed(&made));
        assert_eq!(refused, by_cargo(name) || name == "gen", "{name}: {}", printed(&made));
        let _ = std::fs::remove_dir_all(system.folder().join(name));
    }
}
