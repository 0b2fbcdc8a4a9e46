//! The demo: all of its promises hold here, a promise that does not hold fails it, and it leaves nothing behind.

use rustix::process::Signal;
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

fn demo(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let output = system.run(&[&["demo", "--fast", "--json"], arguments].concat());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let result = serde_json::from_slice(&output.stdout);
    (output.status.code(), result.unwrap_or_else(|error| panic!("{error}: {text}")), text)
}

#[test]
fn every_promise_of_the_demo_holds() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (code, result, text) = demo(&system, &["--out", "out"]);
        let claims = result["claims"].as_array().unwrap();
        let failed: Vec<&Value> = claims.iter().filter(|claim| claim["held"] != true).collect();
        assert!(failed.is_empty(), "{failed:#?}\n{text}");
        assert_eq!((code, &result["held"]), (Some(0), &Value::Bool(true)));
        assert!(claims.len() >= 20 && claims.iter().all(|claim| claim["measured"].is_number()), "{result}");
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
        let page = std::fs::read_to_string(system.folder().join("out/demo.html")).unwrap();
        assert!(page.contains("<svg") && !page.contains("src="), "one file that shows the drive");
        let saved = std::fs::read_to_string(system.folder().join("out/demo.json")).unwrap();
        assert_eq!(serde_json::from_str::<Value>(&saved).unwrap(), result);
        system.assert_nothing_left();
    });
}

#[test]
fn a_promise_that_does_not_hold_fails_the_demo() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let arguments = ["--only", "drive", "--promise", "scan_to_actuation_ms=0.001"];
        let (code, result, text) = demo(&system, &arguments);
        assert_eq!((code, &result["held"]), (Some(1), &Value::Bool(false)));
        let claims = result["claims"].as_array().unwrap();
        let failed = claims.iter().find(|claim| claim["name"] == "scan_to_actuation_ms").unwrap();
        assert!(failed["held"] == false && failed["measured"].as_f64().unwrap() > 0.001, "{failed}");
        assert!(text.contains("NOT HELD"), "{text}");
        system.assert_nothing_left();
    });
}

#[test]
fn an_interrupted_demo_stops_everything() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.launch(&["demo", "--fast"], &[]);
        system.wait_until_driving();
        system.signal(system.orchestrator(), Signal::INT);
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        assert!(system.stderr().contains("interrupted"), "{}", system.stderr());
        system.assert_nothing_left();
    });
}

#[test]
fn the_demo_leaves_a_system_of_the_user_alone() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let output = system.run(&["demo", "--fast"]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && text.contains("exists already"), "{text}");
        assert_eq!(system.status().map(|status| status.state).as_deref(), Some("driving"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn what_the_demo_can_t_do_is_refused_before_anything_is_started() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let held = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = held.local_addr().unwrap().port().to_string();
        for (arguments, reason) in [
            (&["--promise", "speed=1"][..], "speed is unknown: expected one of answered_scans"),
            (&["--out", "/proc/none"], "name a folder that you may write to"),
            (&["--port", port.as_str()], port.as_str()),
        ] {
            let output = system.run(&[&["demo"], arguments].concat());
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.code() == Some(2) && text.contains(reason), "{arguments:?}: {text}");
        }
        system.assert_nothing_left();
    });
}
