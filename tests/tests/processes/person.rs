//! A person takes over: pauses the drive, drives by hand, and hands back to the controller.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::cell::Cell;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Stdio};

use runtime::{Wheels, monotonic_ns};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::Signal;
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::terminal::Terminal;
use session::control::{Reply, Request, ask};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Exit code and messages of a command.
fn run(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, String) {
    let output = system.run(arguments);
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn driven_by(system: &TestSystem) -> String {
    system.status().and_then(|status| status.driven_by).unwrap_or_default()
}

fn scan(system: &TestSystem) -> u64 {
    system.status().map_or(0, |status| status.scan)
}

/// The newest scan of a paused drive in lock-step, once time stands.
fn scan_while_time_stands(system: &TestSystem) -> u64 {
    let newest = Cell::new(0);
    system.wait_until("time stands", |system| {
        // On a busy machine a scan may take longer than a command: only once the robot rests is none to come.
        let Some(status) = system.status() else { return false };
        let is_known = newest.replace(status.scan) == status.scan && status.scan > 0;
        is_known && status.driven_by.as_deref() == Some("nobody") && status.wheels == Some(Wheels::Resting)
    });
    newest.get()
}

/// Pauses a drive in lock-step, which may be over before a command has started.
fn pause_at_once(system: &TestSystem) {
    let pause = |domain| matches!(ask(&domain, &Request::Pause), Ok(Reply::Done));
    system.wait_until("the drive is paused", |system| system.find().is_some_and(pause));
}

/// `teleop` with arguments, as a process.
fn teleop(system: &TestSystem, arguments: &[&str]) -> Child {
    system.command(&[&["teleop"], arguments].concat()).spawn().unwrap()
}

/// Who drove, one after the other.
fn drivers(system: &TestSystem) -> Vec<String> {
    system.report().driver_changes.into_iter().map(|change| change.driven_by).collect()
}

#[test]
fn a_drive_is_paused_driven_by_hand_around_a_corner_and_resumed_to_its_goal() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["bend", "--record"]);
        system.wait_until("the robot drives", |system| scan(system) > 10);
        assert_eq!(run(&system, &["resume"]).0, Some(2), "the controller drives");
        assert_eq!(run(&system, &["pause"]).0, Some(0));
        let rest = system.await_rest();
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(system.newest("actuation")["reason"], "paused");
        // All processes answer each scan meanwhile.
        let before = scan(&system);
        system.wait_until("scans go by", |system| scan(system) > before + 10);
        assert_eq!(system.await_rest(), rest);
        assert_eq!(run(&system, &["teleop", "--velocity=0.5", "--steering=0.06", "--for=2.5"]).0, Some(0));
        let [x_m, y_m] = system.await_rest();
        assert!((x_m - rest[0]).hypot(y_m - rest[1]) > 0.6, "({x_m}, {y_m}) after {rest:?}");
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(run(&system, &["resume"]).0, Some(0));
        assert_eq!(system.wait().code(), Some(0));
        assert_eq!(drivers(&system), ["nobody", "person", "nobody", "controller"]);
        assert!(!system.stderr().contains("was moved"), "{}", system.stderr());
        system.assert_replayed();
        system.assert_nothing_left();
    });
}

#[test]
fn a_paused_robot_that_is_pushed_with_blocked_wheels_says_so_and_stands() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        // Pushed after 5 s: it is paused and at rest by then.
        system.start(&["walls", "--set", "robot.pushed_s=5", "--set", "robot.pushed_left_m=0.3"]);
        system.wait_until("the robot drives", |system| scan(system) > 10);
        assert_eq!(run(&system, &["pause"]).0, Some(0));
        system.await_rest();
        assert!(!system.stderr().contains("was moved"), "{}", system.stderr());
        system.wait_until("it is told", |system| {
            system.stderr().contains("the robot was moved while it stood")
        });
        system.await_rest();
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(system.newest("actuation")["reason"], "paused");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn a_program_drives_by_lines_and_a_line_that_is_none_ends_it_with_blocked_wheels() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--lockstep"]);
        pause_at_once(&system);
        let drive = |text: &str| {
            let mut command = system.command(&["teleop", "--stdin"]);
            let mut person = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
            person.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
            let output = person.wait_with_output().unwrap();
            (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
        };
        let before = scan(&system);
        let (code, text) = drive(&"0.4 0.0\n".repeat(20));
        assert_eq!(code, Some(0), "{text}");
        assert!(scan_while_time_stands(&system) >= before + 20, "a scan for each line");
        let (code, text) = drive("0.4 0.0\n0.4\n");
        assert!(code == Some(2) && text.contains("standard input, line 2: \"0.4\""), "{text}");
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(run(&system, &["resume"]).0, Some(0));
        assert_eq!(system.wait().code(), Some(0));
    });
}

#[test]
fn a_program_holds_the_wheels_drives_on_and_hands_back_by_words() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--record"]);
        let mut command = system.command(&["teleop", "--stdin"]);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut person = command.spawn().unwrap();
        let mut lines = BufReader::new(person.stdout.take().unwrap()).lines();
        let input = person.stdin.take().unwrap();
        let say = |line: &str| (&input).write_all(line.as_bytes()).unwrap();
        let mut next = || lines.next().unwrap().unwrap();
        assert_eq!(next(), "by hand");
        for _ in 0..2 {
            system.wait_until("a control drives on by hand", |system| {
                say("0.4 0.0\n");
                system.newest("actuation")["driven_by"] == "person"
            });
            say("pause\n");
            assert_eq!(next(), "paused");
            system.await_rest();
            assert_eq!(system.newest("actuation")["reason"], "paused");
        }
        say("resume\n");
        assert_eq!(next(), "resumed");
        assert_eq!(person.wait().unwrap().code(), Some(0));
        assert_eq!(system.wait().code(), Some(0), "the controller drives to its goal");
        let drivers = drivers(&system);
        assert_eq!(drivers, ["person", "nobody", "person", "nobody", "controller"]);
        system.assert_replayed();
        system.assert_nothing_left();
    });
}

#[test]
fn one_who_does_not_drive_any_more_hands_nothing_back() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let mut command = system.command(&["teleop", "--stdin"]);
        let mut person = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        system.wait_until("a person drives", |system| driven_by(system) == "person");
        assert_eq!(run(&system, &["pause"]).0, Some(0));
        person.stdin.take().unwrap().write_all(b"resume\n").unwrap();
        let output = person.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && text.contains("does not drive any more"), "{text}");
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

/// Events of a gamepad: type, code and value each, and a report after them.
fn events(all: &[(u16, u16, i32)]) -> Vec<u8> {
    let event = |(kind, code, value): (u16, u16, i32)| {
        let time = [0; 2 * size_of::<usize>()];
        [&time[..], &kind.to_ne_bytes(), &code.to_ne_bytes(), &value.to_ne_bytes()].concat()
    };
    all.iter().copied().chain([(0, 0, 0)]).flat_map(event).collect()
}

#[test]
fn a_gamepad_drives_while_its_dead_man_is_held_and_hands_back() {
    const DEAD_MAN: (u16, u16) = (1, 0x136);
    let up = (3, 1, -32768);
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let refused = run(&system, &["teleop", "--gamepad", "missing"]);
        assert_eq!(refused.0, Some(2), "{refused:?}");
        system.start(&["endless"]);
        let refused = run(&system, &["teleop", "--gamepad", "missing"]);
        assert!(refused.0 == Some(2) && refused.1.contains("gamepad missing: No such file"), "{refused:?}");
        let pipe = system.folder().join("pad");
        mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let mut pad = File::options().read(true).write(true).open(&pipe).unwrap();
        let mut send = |all: &[(u16, u16, i32)]| pad.write_all(&events(all)).unwrap();
        let mut person = teleop(&system, &["--gamepad", pipe.to_str().unwrap(), "--velocity=0.4"]);
        system.wait_until("a person drives", |system| driven_by(system) == "person");
        send(&[up]);
        system.await_rest();
        for ends in [(DEAD_MAN.0, DEAD_MAN.1, 0), (0, 3, 0), (1, 0x13a, 1)] {
            send(&[(DEAD_MAN.0, DEAD_MAN.1, 1), up]);
            system.wait_until("it drives", moves);
            send(&[ends]);
            system.await_rest();
            let paused = if ends.1 == 0x13a { "nobody" } else { "person" };
            assert_eq!(driven_by(&system), paused);
            send(&[(DEAD_MAN.0, DEAD_MAN.1, 0)]);
        }
        send(&[(1, 0x13b, 1)]);
        assert_eq!(person.wait().unwrap().code(), Some(0));
        system
            .wait_until("the controller drives", |system| driven_by(system) == "controller" && moves(system));
        // One that goes away while it is held.
        let mut person = teleop(&system, &["--gamepad", pipe.to_str().unwrap()]);
        system.wait_until("a person drives", |system| driven_by(system) == "person");
        send(&[(DEAD_MAN.0, DEAD_MAN.1, 1), up]);
        system.wait_until("it drives", moves);
        drop(pad);
        assert_eq!(person.wait().unwrap().code(), Some(0));
        system.await_rest();
        assert_eq!(driven_by(&system), "nobody");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

/// Whether the true robot moves.
fn moves(system: &TestSystem) -> bool {
    system.newest("truth")["speed_mps"].as_f64().is_some_and(|speed| speed > 0.05)
}

#[test]
fn keys_drive_while_they_are_held_and_tell_why_the_wheels_are_blocked() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        for (end, code) in [("q", 0), ("\x03", 0), ("", 5)] {
            let terminal = Terminal::new(120, 24);
            let mut person = terminal.spawn(system.command(&["teleop"]));
            system.wait_until("keys are shown", |_| terminal.output().contains("up or w: drive while held"));
            system.await_rest();
            assert_eq!(driven_by(&system), "person");
            system.wait_until("the reason is shown", |_| {
                terminal.output().contains("wheels resting: released")
            });
            for key in ["w", "\x1b[A"] {
                system.wait_until("a key that is held drives", |system| {
                    terminal.press(key);
                    moves(system)
                });
                assert!(terminal.output().contains("drives: 0.30 m/s"));
                system.await_rest();
            }
            if end.is_empty() {
                let children = format!("/proc/{0}/task/{0}/children", person.id());
                let children = std::fs::read_to_string(children).unwrap();
                system.signal(children.split_whitespace().next().unwrap().parse().unwrap(), Signal::KILL);
            }
            terminal.press(end);
            system.wait_until("the terminal is restored", |_| terminal.is_restored());
            assert_eq!(person.wait().unwrap().code(), Some(code), "{end:?}: {}", terminal.output());
            assert_eq!(driven_by(&system), "nobody", "{end:?}");
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn in_lockstep_a_person_drives_scan_by_scan_and_time_stands_while_the_drive_is_paused() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["figure-eight", "--lockstep", "--record"]);
        pause_at_once(&system);
        let before = scan_while_time_stands(&system);
        assert_eq!(run(&system, &["teleop", "--velocity=0.5", "--steering=0.02", "--for=2"]).0, Some(0));
        let after = scan_while_time_stands(&system);
        assert!((20..60).contains(&(after - before)), "20 scans and the way to stop, not {}", after - before);
        assert_eq!(run(&system, &["resume"]).0, Some(0));
        assert_eq!(system.wait().code(), Some(0));
        assert_eq!(drivers(&system), ["nobody", "person", "nobody", "controller"]);
        system.assert_replayed();
        system.assert_nothing_left();
    });
}

#[test]
fn in_lockstep_each_control_that_is_taken_drives_a_scan_of_its_own() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep"]);
        pause_at_once(&system);
        let before = scan_while_time_stands(&system);
        let domain = system.find().unwrap();
        let Ok(Reply::Teleop { person, .. }) = ask(&domain, &Request::Teleop) else { panic!("refused") };
        // Those of several threads wait for the same turn of the orchestrator's loop.
        let taken = || {
            let give = |_: &usize| {
                let given_ns = monotonic_ns();
                let control = Request::Control { person, velocity_mps: 0.1, steering_rad: 0.0, given_ns };
                matches!(ask(&domain, &control), Ok(Reply::Accepted(_)))
            };
            (0..200).filter(give).count() as u64
        };
        let taken: u64 = std::thread::scope(|scope| {
            [(); 8].map(|()| scope.spawn(taken)).into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        assert_eq!(run(&system, &["pause"]).0, Some(0));
        let scans = scan_while_time_stands(&system) - before;
        // The last one may be paused before its scan.
        assert!(taken > 20 && taken <= scans + 1, "{taken} controls in {scans} scans");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn without_a_person_the_wheels_are_blocked_and_only_resume_gives_them_back() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--record"]);
        system.wait_until("the robot drives", |system| scan(system) > 10);
        let mut person = teleop(&system, &["--velocity=0.4", "--for=600"]);
        system.wait_until("a person drives", |system| system.newest("actuation")["driven_by"] == "person");
        system.wait_until("the wheels turn by hand", |system| {
            let actuation = system.newest("actuation");
            actuation["driven_by"] == "person" && actuation["kind"] == "drive"
        });
        // No other person may drive meanwhile.
        let (code, text) = run(&system, &["teleop", "--for=1"]);
        assert!(code == Some(2) && text.contains("another person drives"), "{text}");
        // The person's program dies, without a word: dead man.
        person.kill().unwrap();
        person.wait().unwrap();
        system.await_rest();
        assert_eq!(driven_by(&system), "person", "nothing is handed back by itself");
        assert_eq!(system.newest("command")["reason"], "released");
        // A controller that starts again does not drive either, and neither does another orchestrator.
        let old = system.pid(Role::Controller);
        system.signal(old, Signal::KILL);
        system.wait_until("the controller is restarted", |system| system.pid(Role::Controller) != old);
        system.await_rest();
        system.kill_orchestrator();
        system.adopt(&[]);
        system.wait_until("nobody drives", |system| driven_by(system) == "nobody");
        system.await_rest();
        let before = scan(&system);
        system.wait_until("scans go by", |system| scan(system) > before + 10);
        system.await_rest();
        assert_eq!(run(&system, &["resume"]).0, Some(0));
        system.wait_until("the controller drives", |system| system.newest("actuation")["kind"] == "drive");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        for verb in [&["pause"][..], &["resume"], &["teleop", "--for=1"]] {
            assert_eq!(run(&system, verb).0, Some(2), "{verb:?} of what is stopped");
        }
        system.wait();
        system.assert_nothing_left();
    });
}
