//! At the prompt: completions in real shells, man pages, and colours where the user wants them.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::process::{Child, Command};

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::terminal::Terminal;
use scanloop_tests::{TestSystem, printed};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const LABORATORY: &str = env!("CARGO_BIN_EXE_scanloop-under-test-lab");

/// What is typed before the tabulator key, and what the shell then has.
const TYPED: [(&str, &str); 11] = [
    ("scanloop sw", "scanloop swap "),
    ("scanloop run corr", "scanloop run corridor "),
    ("scanloop swap contr", "scanloop swap controller "),
    ("scanloop run --lock", "scanloop run --lockstep "),
    ("scanloop run --set robot.velocity_fac", "scanloop run --set robot.velocity_factor="),
    ("scanloop set controller.profile=so", "scanloop set controller.profile=source "),
    ("scanloop topic echo obsta", "scanloop topic echo obstacles "),
    ("scanloop campaign --fam", "scanloop campaign --family "),
    ("scanloop faults --only brake", "scanloop faults --only brake-weak "),
    ("scanloop faults --only brake-weak/la", "scanloop faults --only brake-weak/landing "),
    ("scanloop-lab compa", "scanloop-lab compare "),
];

/// A folder in which the executables have the names that users type.
fn programs(system: &TestSystem) -> String {
    let folder = system.folder().join("bin");
    std::fs::create_dir(&folder).unwrap();
    for (program, name) in [(EXECUTABLE, "scanloop"), (LABORATORY, "scanloop-lab")] {
        std::os::unix::fs::symlink(program, folder.join(name)).unwrap();
    }
    format!("{}:{}", folder.display(), std::env::var("PATH").unwrap())
}

fn script(system: &TestSystem, shell: &str) -> String {
    let output = system.run(&["completions", shell]);
    assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// An interactive shell in a terminal; ended when dropped.
struct Shell {
    terminal: Terminal,
    child: Child,
}

impl Shell {
    /// Starts it with commands that load the completions, and that let Ctrl-O print the line as it is, in `<>`, and empty it.
    fn new(system: &TestSystem, program: &str, arguments: &[&str], prepare: &str) -> Self {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(system.folder()).env("PATH", programs(system));
        command.env("SCANLOOP_SYSTEM_ID", system.id()).env("TERM", "xterm").env("HOME", system.folder());
        let terminal = Terminal::new(200, 50);
        let shell = Self { child: terminal.spawn(command), terminal };
        std::fs::write(system.folder().join("prepare"), prepare).unwrap();
        shell.terminal.press(". ./prepare; printf 'rea''dy\\n'\n");
        system.wait_until("the shell is ready", |_| shell.terminal.output().contains("ready\r\n"));
        shell
    }

    fn assert_completes(&self, system: &TestSystem) {
        for (typed, expected) in TYPED {
            let before = self.terminal.output().len();
            self.terminal.press(&format!("{typed}\t\u{f}"));
            system.wait_until(&format!("`{typed}` becomes `{expected}`: {}", self.terminal.output()), |_| {
                self.terminal.output()[before..].contains(&format!("<{expected}>"))
            });
        }
    }
}

impl Drop for Shell {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Whether a shell is installed; a note names what was left out without it.
fn is_there(shell: &str) -> bool {
    let is_there = Command::new(shell).args(["-c", "true"]).status().is_ok_and(|status| status.success());
    if !is_there {
        eprintln!("SKIPPED completions of {shell}, which is not installed");
    }
    is_there
}

#[test]
fn bash_completes_words_of_both_executables() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let prepare = script(&system, "bash")
            + "\nbind -x '\"\\C-o\": printf \"<%s>\\n\" \"$READLINE_LINE\"; READLINE_LINE='\n";
        let shell = Shell::new(&system, "bash", &["--norc", "--noprofile", "-i"], &prepare);
        shell.assert_completes(&system);
    });
}

#[test]
fn zsh_completes_words_of_both_executables() {
    if !is_there("zsh") {
        return;
    }
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let functions = system.folder().join("functions");
        std::fs::create_dir(&functions).unwrap();
        std::fs::write(functions.join("_scanloop"), script(&system, "zsh")).unwrap();
        let prepare = "fpath=($PWD/functions $fpath); autoload -Uz compinit; compinit -u -D\n\
                       show() { zle -I; print -r -- \"<$BUFFER>\"; BUFFER= }; zle -N show; bindkey -e; bindkey '^O' show\n";
        let shell = Shell::new(&system, "zsh", &["-f", "-i"], prepare);
        shell.assert_completes(&system);
    });
}

#[test]
fn fish_completes_words_of_both_executables() {
    if !is_there("fish") {
        return;
    }
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        std::fs::write(system.folder().join("script.fish"), script(&system, "fish")).unwrap();
        let path = programs(&system);
        for (typed, expected) in TYPED {
            let mut fish = Command::new("fish");
            fish.args(["--no-config", "-c", "source script.fish; complete -C $argv[1]", typed]);
            let output = fish.current_dir(system.folder()).env("PATH", &path).output().unwrap();
            let words = String::from_utf8_lossy(&output.stdout).into_owned();
            let expected = expected.split(' ').rfind(|word| !word.is_empty()).unwrap();
            let found = words.lines().any(|line| line.split('\t').next() == Some(expected));
            assert!(found, "{typed}: {}", printed(&output));
        }
    });
}

#[test]
fn a_running_system_is_offered_with_its_name() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let mut command = Command::new(EXECUTABLE);
        let output = command.args(["complete", "--", "scanloop", "--system-id", ""]).output().unwrap();
        let found = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(found.lines().any(|line| line.trim_end() == system.id()), "{found}");
        system.run(&["stop"]);
        system.wait();
        let output = Command::new(EXECUTABLE)
            .args(["complete", "--", "scanloop", "--system-id", system.id()])
            .output();
        assert_eq!(printed(&output.unwrap()), "");
        system.assert_nothing_left();
    });
}

#[test]
fn man_pages_cover_the_commands_of_both_executables() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["man", "pages"]);
    assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
    let page = |name: &str| std::fs::read_to_string(system.folder().join(format!("pages/{name}.1"))).unwrap();
    assert!(page("scanloop-run").contains("\\-\\-lockstep"));
    assert!(page("scanloop").contains("scanloop\\-swap(1)"));
    // As the laboratory has them, under the names that users type.
    assert!(page("scanloop-campaign").contains("\\-\\-family"));
    assert!(page("scanloop-bench-solver").contains("feedback phase"));
    assert!(page("scanloop-analyse-drift").contains("scanloop"));
    assert!(page("scanloop-lab").contains("campaign"));
    let entries = std::fs::read_dir(system.folder().join("pages")).unwrap().flatten();
    let names: Vec<String> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    assert!(names.len() > 50 && names.iter().all(|name| name.ends_with(".1")), "{names:?}");
    assert!(!names.iter().any(|name| name.contains("complete.1")), "{names:?}");
    // A page that is there is replaced; a folder that can't be made is refused.
    assert_eq!(system.run(&["man", "pages"]).status.code(), Some(0));
    assert_eq!(system.run(&["man", "pages/scanloop.1"]).status.code(), Some(2));
    // Without the laboratory the pages name it.
    let alone = system.executable_alone("scanloop");
    let output = Command::new(alone).args(["man", "few"]).current_dir(system.folder()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
    assert!(String::from_utf8_lossy(&output.stderr).contains("scanloop-lab"), "{}", printed(&output));
    assert!(system.folder().join("few/scanloop-campaign.1").exists());
}

/// What the executable writes to pipes with these variables.
fn help_of(system: &TestSystem, words: &[&str], variables: &[(&str, &str)]) -> String {
    let mut command = system.command(words);
    for name in ["NO_COLOR", "CLICOLOR_FORCE", "CLICOLOR"] {
        command.env_remove(name);
    }
    let output = command.envs(variables.iter().copied()).env("TERM", "xterm").output().unwrap();
    printed(&output)
}

#[test]
fn every_help_has_colours_where_the_user_wants_them() {
    let system = TestSystem::new(EXECUTABLE);
    // The last is the answer to a command without its words.
    for words in [&["run", "--help"][..], &["--help"], &["bench"]] {
        let is_styled = |variables: &[_]| help_of(&system, words, variables).contains('\u{1b}');
        assert!(!is_styled(&[]), "{words:?}: a pipe");
        assert!(is_styled(&[("CLICOLOR_FORCE", "1")]), "{words:?}");
        assert!(!is_styled(&[("NO_COLOR", "1"), ("CLICOLOR_FORCE", "1")]), "{words:?}");
        assert!(!is_styled(&[("CLICOLOR_FORCE", "0")]), "{words:?}: zero forces nothing");
    }
    for words in [&["rnu"][..], &["run", "nowhere.toml"], &["status"], &["doctor"]] {
        let text = help_of(&system, words, &[("CLICOLOR_FORCE", "1")]);
        assert!(!text.contains('\u{1b}'), "reports and errors are plain: {text}");
    }
    for (no_color, has_colours) in [("", true), ("1", false)] {
        let terminal = Terminal::new(100, 50);
        let mut command = system.command(&["run", "--help"]);
        command.env("TERM", "xterm").env("NO_COLOR", no_color);
        terminal.spawn(command).wait().unwrap();
        system.wait_until("the help is there", |_| terminal.output().contains("--lockstep"));
        assert_eq!(terminal.output().contains('\u{1b}'), has_colours, "NO_COLOR={no_color}");
    }
}

#[test]
fn the_view_has_no_colours_where_the_user_forbids_them() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        for (no_color, has_colours) in [("", true), ("1", false)] {
            let terminal = Terminal::new(100, 30);
            let mut command = system.command(&["top"]);
            command.env("TERM", "xterm").env("NO_COLOR", no_color);
            let mut view = terminal.spawn(command);
            let text = "driving, endless";
            system.wait_until("it draws", |_| terminal.screen(30).iter().any(|line| line.contains(text)));
            terminal.press("q");
            view.wait().unwrap();
            let output = terminal.output();
            let colours = (30..=37).chain(90..=97).filter(|code| output.contains(&format!(";{code}m")));
            assert_eq!(colours.count() > 0, has_colours, "NO_COLOR={no_color}");
        }
        system.run(&["stop"]);
        system.wait();
        system.assert_nothing_left();
    });
}
