//! The tutorial: its commands run as they stand, in their order, and print what the page shows.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Instant;

use emulator::Outcome;
use handover::swap::SwapOutcome;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::pages::{compare_or_write, without_numbers};
use scanloop_tests::{DEADLINE, TestSystem};

use super::tools::{EXECUTABLE, MY_CONTROLLER, python, root};

/// How often a step is tried: on a machine that does other things as well, an answer of a candidate may come late.
const TRIES: usize = 4;
/// What a swap that was refused for such a reason prints.
const TOO_SLOW: [&str; 3] = ["late: ", "hangs: ", "no output within"];

/// Commands that build or install, and what stands for each here: the program that Cargo has built for this test. The
/// manifest of the template is resolved with the locked versions; its source is compiled as a program of this crate.
fn set_up(python: Option<&str>) -> [(&'static str, String); 3] {
    let cargo = env!("CARGO");
    [
        (
            "cargo build --release --manifest-path scanloop/Cargo.toml",
            format!(
                "mkdir -p scanloop/target/release && ln -s {EXECUTABLE} scanloop/target/release/scanloop"
            ),
        ),
        (
            "cargo build --release --manifest-path my-controller/Cargo.toml",
            format!(
                "{cargo} tree --offline --manifest-path my-controller/Cargo.toml > tree && \
                 mkdir -p my-controller/target/release && \
                 ln -s {MY_CONTROLLER} my-controller/target/release/my-controller"
            ),
        ),
        (
            "scanloop/examples/python/setup.sh",
            format!("ln -s {} scanloop/target/python", python.unwrap_or_default()),
        ),
    ]
}

/// Commands that are shown together, and the output that the page shows for them.
struct Step {
    section: String,
    commands: String,
    shown: Vec<String>,
}

/// The steps of a page, and its excerpts of programs with their language.
fn parse(page: &str) -> (Vec<Step>, Vec<(String, String)>) {
    let (mut steps, mut excerpts) = (Vec::<Step>::new(), Vec::new());
    let (mut section, mut lines) = (String::new(), page.lines());
    while let Some(line) = lines.next() {
        if let Some(title) = line.strip_prefix("## ") {
            title.clone_into(&mut section);
        }
        let Some(language) = line.strip_prefix("```") else { continue };
        let block: Vec<String> =
            lines.by_ref().take_while(|line| *line != "```").map(str::to_owned).collect();
        match language {
            "sh" => {
                let (section, commands) = (section.clone(), block.join("\n"));
                steps.push(Step { section, commands, shown: Vec::new() });
            }
            "text" => steps.last_mut().expect("commands come first").shown.extend(block),
            _ => excerpts.push((language.to_owned(), block.join("\n"))),
        }
    }
    (steps, excerpts)
}

/// Whether a line was printed as it is shown; ` ... ` stands for what is left out of it.
fn is_shown(printed: &str, shown: &str) -> bool {
    match shown.split_once(" ... ") {
        Some((start, end)) => printed.starts_with(start) && printed.ends_with(end),
        None => printed == shown,
    }
}

/// The first shown line that was not printed. Cases of the conformance suite end in any order.
fn missing<'a>(shown: &'a [String], printed: &str) -> Option<&'a str> {
    let printed: Vec<String> = printed.lines().map(without_numbers).collect();
    let mut shown = shown.iter().map(String::as_str).filter(|line| !line.is_empty() && *line != "...");
    shown.find(|line| {
        let wanted = without_numbers(line);
        !printed.iter().any(|line| is_shown(line, &wanted))
    })
}

/// A shell that keeps its variables and its jobs from step to step.
struct Shell {
    child: Child,
    input: ChildStdin,
    lines: Receiver<String>,
}

impl Shell {
    fn new(system: &TestSystem) -> Self {
        let mut command = Command::new("bash");
        command.current_dir(system.folder()).env("SCANLOOP_SYSTEM_ID", system.id());
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (input, output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            BufReader::new(output).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        let mut shell = Self { child, input, lines };
        writeln!(shell.input, "exec 2>&1; trap 'echo \"FAILED $BASH_COMMAND\"' ERR").unwrap();
        shell
    }

    /// What commands print; a line that starts with `FAILED` for each one that fails.
    fn run(&mut self, system: &TestSystem, commands: &str) -> String {
        std::fs::write(system.folder().join("step.sh"), format!("{commands}\n")).unwrap();
        // Commands must not read the script of the shell.
        writeln!(self.input, ". ./step.sh < /dev/null; echo; echo STEP DONE").unwrap();
        let (started, mut printed) = (Instant::now(), String::new());
        loop {
            match self.lines.recv_timeout(DEADLINE.saturating_sub(started.elapsed())) {
                Ok(line) if line == "STEP DONE" => {
                    // Paths are printed whole; the page shows them below the folder of the reader.
                    let folder = format!("{}/", system.folder().display());
                    return printed.replace(&folder, "").replace(system.id(), "default");
                }
                Ok(line) => printed += &(line + "\n"),
                Err(RecvTimeoutError::Timeout) => panic!("{commands}: not within {DEADLINE:?}: {printed}"),
                Err(RecvTimeoutError::Disconnected) => panic!("{commands}: the shell ended: {printed}"),
            }
        }
    }
}

impl Drop for Shell {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs a step until it prints what the page shows; again only when a candidate was too slow.
fn play(shell: &mut Shell, system: &TestSystem, step: &Step) {
    for attempt in 1..=TRIES {
        let printed = shell.run(system, &step.commands);
        let missing = missing(&step.shown, &printed);
        let failed = printed.lines().any(|line| line.starts_with("FAILED"));
        if missing.is_none() && !failed {
            // Simulated time gives the same figures on every machine.
            if step.commands.contains("--lockstep") {
                compare_or_write("docs/tutorial.md", &step.shown, &printed);
            }
            return;
        }
        let is_slow = TOO_SLOW.iter().any(|reason| printed.contains(reason));
        assert!(is_slow && attempt < TRIES, "{}: missing {missing:?} in:\n{printed}", step.commands);
    }
}

/// The repository as a clone named `scanloop`, without what was built in it.
fn clone(system: &TestSystem) {
    let clone = system.folder().join("scanloop");
    std::fs::create_dir(&clone).unwrap();
    for entry in std::fs::read_dir(root()).unwrap().flatten() {
        if entry.file_name() != "target" && entry.file_name() != "out" {
            std::os::unix::fs::symlink(entry.path(), clone.join(entry.file_name())).unwrap();
        }
    }
}

#[test]
fn the_commands_of_the_tutorial_run_as_they_stand_and_print_what_it_shows() {
    repeat_when_late(|| {
        let python = python("the part of the tutorial about Python");
        let folder =
            python.as_ref().map(|python| python.parent().unwrap().parent().unwrap().to_str().unwrap());
        let mut page = std::fs::read_to_string(root().join("docs/tutorial.md")).unwrap();
        for (command, instead) in set_up(folder) {
            assert_eq!(page.matches(&format!("\n{command}\n")).count(), 1, "{command}");
            page = page.replace(&format!("\n{command}\n"), &format!("\n{instead}\n"));
        }
        let system = TestSystem::new(EXECUTABLE);
        clone(&system);
        let mut shell = Shell::new(&system);
        let steps = parse(&page).0;
        for step in steps.iter().filter(|step| python.is_some() || !step.section.contains("Python")) {
            play(&mut shell, &system, step);
            if step.commands.ends_with(" &") {
                system.wait_until_driving();
            }
        }
        let text = std::fs::read(system.folder().join("out/road/report.json")).unwrap();
        let report: report::Report = serde_json::from_slice(&text).unwrap();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Interrupted, 0));
        let swapped = report.swaps.iter().filter(|swap| swap.outcome == SwapOutcome::Swapped);
        assert_eq!(swapped.count(), if python.is_some() { 3 } else { 1 });
        drop(shell);
        system.assert_nothing_left();
    });
}

#[test]
fn the_programs_that_the_tutorial_shows_are_those_of_the_examples() {
    repeat_when_late(|| {
        let page = std::fs::read_to_string(root().join("docs/tutorial.md")).unwrap();
        let excerpts = parse(&page).1;
        assert_eq!(excerpts.len(), 4);
        for (language, excerpt) in excerpts {
            let files = match language.as_str() {
                "rust" => ["template-controller/src/main.rs", "template-controller/src/controller.rs"],
                _ => ["python/pure_pursuit.py"; 2],
            };
            let mut texts =
                files.map(|file| std::fs::read_to_string(root().join("examples").join(file)).unwrap());
            assert!(texts.iter_mut().any(|text| text.contains(&excerpt)), "{language}: {excerpt}");
        }
    });
}

/// Their sources are compiled here as programs of another crate, which has more dependencies.
#[test]
fn the_manifests_of_the_templates_name_each_crate_that_their_sources_use() {
    repeat_when_late(|| {
        for folder in ["template-controller", "template-robot/rust"] {
            let folder = root().join("examples").join(folder);
            let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
            for entry in std::fs::read_dir(folder.join("src")).unwrap().flatten() {
                let source = std::fs::read_to_string(entry.path()).unwrap();
                for line in source.lines().filter_map(|line| line.strip_prefix("use ")) {
                    let name = line.split("::").next().unwrap().replace('_', "-");
                    let is_named = manifest.lines().any(|line| line.starts_with(&format!("{name} = ")));
                    let is_known = ["std", "crate"].contains(&name.as_str()) || is_named;
                    assert!(is_known, "{}: {line}", entry.path().display());
                }
            }
        }
    });
}
