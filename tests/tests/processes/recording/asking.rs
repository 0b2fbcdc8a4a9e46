//! Why a robot does what it does, asked while it drives.

use std::process::Output;

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, printed};

use super::{EXECUTABLE, json, text};
use crate::view::View;

const FORGED: [&str; 5] = ["-1", "0", "18446744073709551616", "stop", ""];

/// The message of a command that was refused.
fn refusal(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(2), "{}", printed(output));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn answer(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", printed(output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// What does not depend on the scans that came later: not the usual time, and no line of a log.
fn timeless(answer: &str) -> Vec<&str> {
    let mut counts = true;
    let mut stays = |line: &&str| {
        if !line.starts_with(' ') {
            counts = !line.starts_with("time ") && !line.starts_with("log ");
        }
        counts
    };
    answer.lines().filter(|line| stays(line)).collect()
}

#[test]
fn a_stop_that_just_happened_is_explained_as_by_the_finished_recording() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["sudden", "--set", "stop_final_s=60", "--record=drive.mcap"]);
        let stop = || {
            let stops = json(&system.run(&["why", "--stops", "--json"]));
            let blocked = |row: &&serde_json::Value| {
                row["text"].as_str().is_some_and(|text| text.starts_with("blocked by"))
            };
            stops.as_array()?.iter().find(blocked)?["scan"].as_u64()
        };
        system.wait_until("a stop is recorded", |_| stop().is_some());
        let scan = stop().expect("of a test").to_string();
        let asked = answer(&system.run(&["why", &scan]));
        let newest = system.status().expect("it still runs").scan;
        assert!(asked.contains("stop       blocked by obstacle"), "{asked}");
        for (scan, reason) in [
            ("9223372036854775808", "is not driven yet"),
            ("18446744073709551616", "is not allowed: a whole number from 1"),
            ("0", "is not allowed: a whole number from 1"),
            ("drive.mcap", "the scan is missing"),
        ] {
            let refused = refusal(&system.run(&["why", scan]));
            assert!(refused.contains(reason), "{refused}");
        }
        // A scan of the future is waited for when it is near.
        let soon = answer(&system.run(&["why", &(newest + 5).to_string()]));
        assert!(soon.starts_with(&format!("scan {}\n", newest + 5)), "{soon}");
        system.run(&["stop"]);
        system.wait();
        assert_eq!(timeless(&answer(&system.run(&["why", "drive.mcap", &scan]))), timeless(&asked));
        let over = refusal(&system.run(&["why", &scan]));
        assert!(over.contains("is not running"), "{over}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_drive_that_is_not_recorded_is_asked_by_what_is_kept_in_memory() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--set", "recording.ring_s=60"]);
        let asked = answer(&system.run(&["why", "5"]));
        let file = system.folder().join("out/asked.mcap");
        assert_eq!(asked, answer(&system.run(&["why", text(&file), "5"])));
        let slow = json(&system.run(&["why", "--slow", "--json"]));
        assert!(slow.as_array().is_some_and(|rows| !rows.is_empty()), "{slow}");
        system.run(&["stop"]);
        system.wait();
        assert!(system.report().incidents.iter().all(|incident| *incident != file));
        system.assert_nothing_left();
    });
}

#[test]
fn without_a_recording_the_commands_that_make_one_are_named() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        for arguments in [["why", "4"], ["why", "--stops"]] {
            let refused = refusal(&system.run(&arguments));
            assert!(
                refused.contains("is not recorded") && refused.contains("`scanloop record FILE`"),
                "{refused}"
            );
        }
        // From now on it is; a scan from before stays unknown.
        let mut recorder = system.command(&["record", "later.mcap"]).spawn().expect("of a test");
        system.wait_until("it is recorded", |system| system.run(&["why", "--late"]).status.success());
        let refused = refusal(&system.run(&["why", "4"]));
        assert!(refused.contains("scan 4 of system") && refused.contains("is not recorded: "), "{refused}");
        let newest = system.status().expect("it runs").scan;
        answer(&system.run(&["why", &newest.to_string()]));
        system.run(&["stop"]);
        system.wait();
        recorder.wait().expect("of a test");
        system.assert_nothing_left();
    });
}

/// An answer as JSON without lines of logs, which are recorded a little later than the samples.
fn unlogged(answer: &str) -> serde_json::Value {
    let mut value: serde_json::Value = serde_json::from_str(answer).expect("an answer is JSON");
    let sentences = value["sentences"].as_array_mut().expect("sentences");
    sentences.retain(|sentence| sentence["about"] != "log");
    value
}

#[test]
fn the_page_tells_why_and_refuses_forged_scans() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--record=drive.mcap"]);
        let live = View::start(&system, &[]);
        let why = |view: &View, scan: &str| view.ask(&format!("GET /why?scan={scan}"), "", "");
        let (code, told) = why(&live, "6");
        let asked = answer(&system.run(&["why", "6", "--json"]));
        assert_eq!((code, unlogged(&told)), (200, unlogged(&asked)));
        for forged in FORGED {
            assert_eq!(why(&live, forged).0, 400, "{forged}");
        }
        let (code, refused) = why(&live, "9223372036854775808");
        assert!(code == 404 && refused.contains("is not driven yet"), "{code} {refused}");
        let host = "GET /why?scan=6 HTTP/1.1\r\nHost: example.org\r\n\r\n";
        assert_eq!(crate::view::raw(&live.address, host).0, 403, "its host is another one");
        live.end();
        system.run(&["stop"]);
        system.wait();
        let file = system.folder().join("drive.mcap");
        let played = View::start(&system, &[text(&file)]);
        let (code, played_told) = why(&played, "6");
        assert_eq!((code, unlogged(&played_told)), (200, unlogged(&told)));
        let (code, refused) = why(&played, "9223372036854775808");
        assert!(code == 404 && refused.contains("it has the scans 1 to"), "{code} {refused}");
        played.end();
        system.assert_nothing_left();
    });
}
