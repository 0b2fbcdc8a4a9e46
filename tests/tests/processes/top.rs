//! `top` and `run --top` on a real terminal: what they show, what their keys do, and that the terminal is as before
//! after any end.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::machine::waits_of;
use scanloop_tests::terminal::Terminal;
use scanloop_tests::{DEADLINE, TestSystem, is_ignored};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A system that drives, and a view of it that has drawn it.
fn view() -> (TestSystem, Terminal, Child) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&["endless"]);
    let terminal = Terminal::new(80, 24);
    let view = terminal.spawn(system.command(&["top"]));
    wait_for_text(&system, &terminal, "driving, endless");
    wait_for_text(&system, &terminal, "speed");
    (system, terminal, view)
}

fn wait_for_text(system: &TestSystem, terminal: &Terminal, text: &str) {
    system.wait_until(&format!("the terminal has `{text}`"), |_| {
        terminal.screen(24).iter().any(|line| line.contains(text))
    });
}

/// Waits for the end of a process and checks that the terminal is as before.
fn end(system: &TestSystem, terminal: &Terminal, mut view: Child) -> ExitStatus {
    let started = Instant::now();
    let status = loop {
        if let Some(status) = view.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < DEADLINE, "the view does not end: {}", waits_of(view.id()));
        std::thread::park_timeout(Duration::from_millis(10));
    };
    system.wait_until("the terminal is restored", |_| terminal.is_restored());
    status
}

fn stop(mut system: TestSystem) {
    system.run(&["stop"]);
    system.wait();
    system.assert_nothing_left();
}

/// The process that draws.
fn painter(view: &Child) -> Pid {
    let children = std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", view.id())).unwrap();
    Pid::from_raw(children.split_whitespace().next().unwrap().parse().unwrap()).unwrap()
}

#[test]
fn all_roles_are_shown_and_a_resized_terminal_is_filled() {
    repeat_when_late(|| {
        let (system, terminal, view) = view();
        for role in Role::ALL {
            wait_for_text(&system, &terminal, role.name());
        }
        wait_for_text(&system, &terminal, "p99");
        terminal.resize(100, 40);
        system.wait_until("the last row has the keys", |_| terminal.screen(40)[39].contains("? help"));
        terminal.press("q");
        assert_eq!(end(&system, &terminal, view).code(), Some(0));
        stop(system);
    });
}

#[test]
fn the_terminal_is_restored_after_any_end() {
    repeat_when_late(|| {
        let (system, terminal, first) = view();
        terminal.press("\x03");
        assert_eq!(end(&system, &terminal, first).code(), Some(0));
        let of_this = |pid: &Child| Pid::from_child(pid);
        type Target = fn(&Child) -> Pid;
        for (target, signal, code) in [
            (of_this as Target, Signal::TERM, Some(0)),
            (of_this, Signal::HUP, Some(0)),
            (painter, Signal::KILL, Some(5)),
            (painter, Signal::ABORT, Some(5)),
            (of_this, Signal::KILL, None),
        ] {
            // Under `nohup`, as in many runs of a whole suite, a hang-up ends nothing.
            if is_ignored(signal) {
                eprintln!("skipped: {signal:?} is ignored here");
                continue;
            }
            let terminal = Terminal::new(80, 24);
            let view = terminal.spawn(system.command(&["top"]));
            wait_for_text(&system, &terminal, "driving, endless");
            assert!(!terminal.is_restored());
            kill_process(target(&view), signal).unwrap();
            assert_eq!(end(&system, &terminal, view).code(), code, "{signal:?}: {}", terminal.output());
        }
        let terminal = Terminal::new(80, 24);
        let view = terminal.spawn(system.command(&["top"]));
        wait_for_text(&system, &terminal, "driving, endless");
        stop(system);
        let system = TestSystem::new(EXECUTABLE);
        assert_eq!(end(&system, &terminal, view).code(), Some(0), "the system has ended");
    });
}

#[test]
fn a_key_tells_why_of_the_newest_scan_and_again_closes_the_answer() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--record=drive.mcap"]);
        let terminal = Terminal::new(80, 24);
        let view = terminal.spawn(system.command(&["top"]));
        wait_for_text(&system, &terminal, "speed");
        terminal.press("y");
        wait_for_text(&system, &terminal, "wheels     driven with");
        wait_for_text(&system, &terminal, "rung `converged`");
        terminal.press("y");
        wait_for_text(&system, &terminal, "p99");
        terminal.press("q");
        assert_eq!(end(&system, &terminal, view).code(), Some(0));
        stop(system);
    });
}

#[test]
fn keys_restart_a_role_and_stop_the_system() {
    repeat_when_late(|| {
        let (mut system, terminal, view) = view();
        let old = system.pid(Role::Estimator);
        terminal.press("?");
        wait_for_text(&system, &terminal, "blocks the wheels at once");
        terminal.press("?2r");
        system.wait_until("the estimator is restarted", |system| system.pid(Role::Estimator) != old);
        wait_for_text(&system, &terminal, "restart estimator ...");
        terminal.press("s");
        assert_eq!(end(&system, &terminal, view).code(), Some(0));
        assert_eq!(system.wait().code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn a_pasted_text_stops_nothing() {
    repeat_when_late(|| {
        let (system, terminal, view) = view();
        let text =
            "a sentence of letters that are keys, s and r and w and q, longer than what is read at once "
                .repeat(30);
        terminal.press(&text);
        terminal.press(&format!("\x1b[200~s\n{text}\x1b[201~"));
        // In pieces, as a slow connection brings it.
        for (pieces, between_ms) in [
            (&["ru", "n s", "top\n"][..], 20),
            (&["h", "e", "l", "l", "o", " ", "t", "h", "i", "s", " ", "i", "s"], 10),
            (&["\x1b]0;s", "top\x07", "\x1b[Ms", "qr"], 20),
        ] {
            for piece in pieces {
                terminal.press(piece);
                std::thread::park_timeout(Duration::from_millis(between_ms));
            }
            std::thread::park_timeout(Duration::from_millis(500));
        }
        // A key after it counts, once the terminal has been quiet. It is pressed again only after it must have been shown.
        system.wait_until("the help is shown", |_| {
            terminal.press("?");
            std::thread::park_timeout(Duration::from_millis(700));
            terminal.screen(24).iter().any(|line| line.contains("blocks the wheels at once"))
        });
        let scan = system.status().unwrap().scan;
        system.wait_until("it drives on", |system| {
            system.status().is_some_and(|status| status.scan > scan + 3)
        });
        assert_eq!(system.status().unwrap().state, "driving");
        terminal.press("q");
        assert_eq!(end(&system, &terminal, view).code(), Some(0));
        stop(system);
    });
}

#[test]
fn a_run_shows_itself_and_prints_its_summary_afterwards() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let terminal = Terminal::new(80, 24);
        let run = terminal.spawn(system.command(&["run", "--top", "--out", "out", "endless"]));
        wait_for_text(&system, &terminal, "driving, endless");
        wait_for_text(&system, &terminal, "^C end run");
        terminal.press("\x03");
        assert_eq!(end(&system, &terminal, run).code(), Some(1));
        // What an ended process has written is read a little later.
        system.wait_until("the summary is printed on the restored terminal", |_| {
            let output = terminal.output();
            output.rsplit("\x1b[?1049l").next().is_some_and(|rest| rest.contains("interrupted"))
        });
        system.assert_nothing_left();
    });
}

#[test]
fn a_run_goes_on_without_its_view() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let terminal = Terminal::new(80, 24);
        let run = terminal.spawn(system.command(&["run", "--top", "--out", "out", "endless"]));
        wait_for_text(&system, &terminal, "driving, endless");
        terminal.press("q");
        system.wait_until("the terminal is restored", |_| terminal.is_restored());
        let scan = system.status().unwrap().scan;
        system.wait_until("it drives on", |system| {
            system.status().is_some_and(|status| status.scan > scan + 5)
        });
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(end(&system, &terminal, run).code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn without_a_terminal_or_a_system_there_is_no_view() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        for arguments in [&["top"][..], &["run", "--top"]] {
            let output = system.run(arguments);
            assert_eq!(output.status.code(), Some(2));
            assert!(String::from_utf8_lossy(&output.stderr).contains("needs a terminal"));
        }
        let terminal = Terminal::new(80, 24);
        let view = terminal.spawn(system.command(&["top"]));
        assert_eq!(end(&system, &terminal, view).code(), Some(2));
        // What was written is read by another thread.
        system.wait_until("the reason is shown", |_| terminal.output().contains("is not running"));
    });
}
