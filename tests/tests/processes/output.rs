//! Output that cannot be written does not delay a drive: terminals that are not read, full disks, readers that end.

use scanloop_tests::machine::repeat_when_late;
use std::fs::File;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{MetadataExt, symlink};
use std::process::Stdio;
use std::time::{Duration, Instant};

use emulator::Outcome;
use rustix::process::Signal;
use scanloop_tests::terminal::ends as terminal;
use scanloop_tests::{TestSystem, fill, system_file};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A run that is interrupted is at rest and gone within this time, on a busy machine too.
const END_LIMIT: Duration = Duration::from_secs(15);

/// A short drive to the goal.
const SHORT: [&str; 6] = ["run", "--out", "out", "free", "--set", "goal.x_m=3"];

/// Drives with a standard error that takes nothing and is never read, and interrupts the run.
fn drives_and_ends(output: OwnedFd) {
    fill(&output);
    let mut system = TestSystem::new(EXECUTABLE);
    system.launch_into(&output, &["run", "--out", "out", "endless"], &[]);
    drop(output);
    system.wait_until_driving();
    // Some more lines of progress.
    system.wait_until("it drives on", |system| system.status().is_some_and(|status| status.scan > 30));
    system.signal(system.orchestrator(), Signal::INT);
    let interrupted = Instant::now();
    assert_eq!(system.wait().code(), Some(1));
    assert!(interrupted.elapsed() < END_LIMIT, "{:?}", interrupted.elapsed());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Interrupted);
    assert_eq!(report.drive.final_speed_mps, 0.0, "the robot stands at the end");
    assert_eq!((report.scans.lost, report.scans.unaccounted), (0, 0), "{:?}", report.scans);
    system.assert_nothing_left();
}

#[test]
fn a_terminal_that_is_not_read_holds_up_neither_the_drive_nor_its_end() {
    repeat_when_late(|| {
        let (_near, far) = terminal();
        drives_and_ends(far);
    });
}

#[test]
fn a_second_run_does_not_write_into_the_folder_of_one_that_drives() {
    let mut first = TestSystem::new(EXECUTABLE);
    first.start(&["endless"]);
    let second = TestSystem::new(EXECUTABLE);
    let out = first.folder().join("out");
    let log = out.join("logs/robot.log");
    let before = std::fs::metadata(&log).unwrap().ino();
    let output = second.run(&["run", "free", "--lockstep", "--force", "--out", out.to_str().unwrap()]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("another run writes there"), "{message}");
    assert_eq!(std::fs::metadata(&log).unwrap().ino(), before);
    first.run(&["stop"]);
    first.wait();
    assert_eq!(first.report().outcome, Outcome::Interrupted);
}

#[test]
fn a_pipe_that_is_not_read_holds_up_neither_the_drive_nor_its_end() {
    repeat_when_late(|| {
        let (_reader, writer) = std::io::pipe().unwrap();
        drives_and_ends(writer.into());
    });
}

#[test]
fn an_output_that_is_read_again_has_the_lines_of_the_time_between_and_the_summary() {
    repeat_when_late(|| {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let writer = OwnedFd::from(writer);
        fill(&writer);
        let mut system = TestSystem::new(EXECUTABLE);
        system.launch_into(&writer, &SHORT, &[]);
        drop(writer);
        system.wait_until_driving();
        system.wait_until("it drives on", |system| system.status().is_some_and(|status| status.scan > 20));
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!(system.wait().code(), Some(0));
        let text = text.trim_start_matches('x');
        assert!(text.contains("\ngoal") && text.contains("\noutcome         reached"), "{text}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_terminal_that_is_read_shows_a_live_line_and_then_the_summary() {
    repeat_when_late(|| {
        let (near, far) = terminal();
        let mut system = TestSystem::new(EXECUTABLE);
        system.launch_into(&far, &SHORT, &[]);
        drop(far);
        let mut shown = Vec::new();
        // When all writers have closed it, reading fails.
        while let Ok(1..) = File::from(near.try_clone().unwrap()).by_ref().take(4096).read_to_end(&mut shown)
        {
        }
        assert_eq!(system.wait().code(), Some(0));
        let shown = String::from_utf8_lossy(&shown);
        let (live, summary) = shown.rsplit_once("\r\u{1b}[K").expect("a live line that was cleared");
        assert!(live.contains("\r\u{1b}[Kgoal ") && live.contains("con\u{25cf}"), "{live}");
        assert!(summary.starts_with("outcome") && summary.contains("reached"), "{summary}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_drive_whose_output_cannot_be_written_reaches_its_goal() {
    repeat_when_late(|| {
        let gone = OwnedFd::from(std::io::pipe().unwrap().1);
        let full = OwnedFd::from(File::options().write(true).open("/dev/full").unwrap());
        for output in [gone, full] {
            let mut system = TestSystem::new(EXECUTABLE);
            system.launch_into(&output, &SHORT, &[]);
            assert_eq!(system.wait().code(), Some(0));
            assert_eq!(system.report().outcome, Outcome::Reached);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn commands_whose_reader_goes_end_without_a_panic() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let closed = || Stdio::from(std::io::pipe().unwrap().1);
        for arguments in [
            &["status"][..],
            &["status", "--json"],
            &["topic", "list"],
            &["topic", "echo", "pose"],
            &["topic", "hz", "pose"],
            &["check"],
            &["types"],
            &["stop"],
        ] {
            let status = system.command(arguments).stdout(closed()).stderr(closed()).status().unwrap();
            assert_eq!(status.code(), Some(0), "{arguments:?}");
        }
        // Data that was asked for and is not there is an error, of a disk that is full.
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = system.command(&["topic", "list"]).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(4), "{output:?}");
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn results_that_cannot_be_written_change_the_exit_code_and_not_the_summary() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let out = system.folder().join("out");
        // Folders in the places of the files: root too can't write there.
        std::fs::create_dir_all(out.join("report.json")).unwrap();
        let output = system.run(&["run", "--lockstep", "--quiet", "--out", "out", "--force", "free"]);
        let (summary, text) =
            (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
        assert_eq!(output.status.code(), Some(4), "{text}");
        assert!(summary.contains("outcome") && summary.contains("reached"), "{summary}");
        assert!(
            text.contains("error: the results were not written") && text.contains("report.json"),
            "{text}"
        );
        assert!(out.join("drive.svg").is_file());
        system.assert_nothing_left();
    });
}

#[test]
fn a_process_is_restarted_while_its_log_is_on_a_full_disk() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        system.kill_orchestrator();
        // An adopting orchestrator appends to the logs that are there.
        let log = system.folder().join("out/logs/controller.log");
        std::fs::remove_file(&log).unwrap();
        symlink("/dev/full", &log).unwrap();
        system.adopt(&[]);
        let before = system.pid(Role::Controller);
        assert_eq!(system.run(&["restart", "controller"]).status.code(), Some(0));
        system.wait_until("a new controller is ready", |system| {
            let status = system.status().unwrap_or_default();
            let controller = status.processes.iter().find(|process| process.role.name() == "controller");
            controller
                .is_some_and(|process| ![0, before].contains(&process.pid) && process.state.name() == "ready")
        });
        system.signal(system.orchestrator(), Signal::INT);
        assert_eq!(system.wait().code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn escape_sequences_in_names_do_not_reach_the_terminal() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        // It would clear the screen, set the title, ring, and colour what follows.
        let evil = "\u{1b}[2J\u{1b}]0;title\u{7}\u{9b}31m";
        let escaped: String = evil.chars().map(|letter| format!("\\u{:04x}", u32::from(letter))).collect();
        std::fs::write(system.folder().join("scenario.toml"), format!("name = \"{escaped}\"")).unwrap();
        let text = system_file(10, &[Role::Robot], "./EVIL", &[]).replace("EVIL", &escaped);
        std::fs::write(system.folder().join("system.toml"), text).unwrap();
        let name = format!("{evil}.toml");
        for (arguments, code) in [
            (&["check", "scenario.toml"][..], 2),
            (&["run", &name], 2),
            (&["check", "system.toml"], 0),
            (&["run", "--system", "system.toml", "--out", "out", "free"], 4),
        ] {
            let output = system.run(arguments);
            let text = String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
            assert!(!text.contains(|letter: char| letter.is_control() && letter != '\n'), "{text:?}");
            assert!(text.contains("\\u001b[2J"), "{arguments:?}: the name is shown: {text}");
        }
        system.assert_nothing_left();
    });
}
