//! Settings changed while the robot drives: the process of the role is swapped, and what starts after it has them too.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use handover::swap::{Certificate, SwapOutcome};
use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, prlimit};
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{
    assert_every_scan_answered_once, assert_seamless, assert_seamless_swap, certificate,
};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

fn set(system: &TestSystem, arguments: &[&str]) -> Certificate {
    certificate(&system.run(&[&["set", "--json"], arguments].concat()))
}

/// Number of nodes in the plan of the next command: one more than the controller has intervals.
fn plan_length(system: &TestSystem) -> u64 {
    let output = system.run(&["topic", "echo", "command", "-n", "1", "--short"]);
    let command: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    command["plan_length"].as_u64().unwrap()
}

/// Kills the controller and waits until its successor is ready.
fn kill_controller(system: &TestSystem) {
    let old = system.pid(Role::Controller);
    system.signal(old, Signal::KILL);
    system.wait_until("the controller is restarted", |system| {
        system.status().is_some_and(|status| {
            let of_role = |role| status.processes.iter().find(|process| process.role == role);
            of_role(Role::Controller)
                .is_some_and(|process| process.pid != old && process.state.name() == "ready")
        })
    });
}

/// Settings files of single processes.
fn own_files(system: &TestSystem) -> Vec<String> {
    let names = system.domain().folder().names().into_iter();
    names.filter(|name| name.starts_with("settings-") && name.as_bytes()[9].is_ascii_digit()).collect()
}

#[test]
fn a_setting_acts_at_once_and_survives_restarts_and_an_adoption() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let before = plan_length(&system);
        let old = system.pid(Role::Controller);
        let certificate = set(&system, &["--tolerance", "1000", "controller.intervals=9"]);
        assert_seamless_swap(&certificate);
        assert_eq!(
            (certificate.from.as_str(), certificate.to.as_str()),
            ("nmpc", "nmpc with controller.intervals=9")
        );
        assert_ne!(system.pid(Role::Controller), old);
        assert!(before != 10 && plan_length(&system) == 10, "{before}");
        // A second change starts from the first one.
        let arguments = ["--tolerance", "1000", "controller.smoothing_s=0.3"];
        assert_seamless_swap(&set(&system, &arguments));
        assert_eq!(plan_length(&system), 10);
        kill_controller(&system);
        assert_eq!(plan_length(&system), 10);
        system.kill_orchestrator();
        system.adopt(&[]);
        kill_controller(&system);
        assert_eq!(plan_length(&system), 10);
        assert_eq!(own_files(&system), [""; 0]);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_change_that_drives_otherwise_is_refused_and_leaves_the_settings_as_they_were() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let file = || system.domain().folder().read_text("settings-actuator.toml").unwrap();
        let (before, pid) = (file(), system.pid(Role::Actuator));
        // No command is that young: the candidate blocks the wheels.
        let certificate = set(&system, &["actuator.max_age_periods=0.1"]);
        assert_eq!(certificate.outcome, SwapOutcome::Refused, "{certificate:?}");
        assert!(certificate.reason.contains("kind differs"), "{certificate:?}");
        assert_seamless(&certificate);
        system.wait_until("the file of the candidate is gone", |system| own_files(system).is_empty());
        assert_eq!((file(), system.pid(Role::Actuator)), (before, pid));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        assert_every_scan_answered_once(&system);
        system.assert_nothing_left();
    });
}

#[test]
fn what_a_setting_is_meant_to_change_is_no_disagreement() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        for key in ["controller.cruise_mps=0.7", "noise.odometry_m=0.01", "controller.cruise_mps=1.0"] {
            let certificate = set(&system, &[key]);
            assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{key}: {certificate:?}");
            assert_seamless(&certificate);
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

/// Two plans that cruise at 1.0 and 0.8 m/s differ there by up to 0.6 m/s.
#[test]
fn a_speed_that_is_set_beside_an_obstacle_is_no_disagreement() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long"]);
        system.wait_until("it comes to an obstacle", |system| {
            system.status().is_some_and(|status| status.scan > 20)
        });
        let certificate = set(&system, &["controller.cruise_mps=0.8"]);
        assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{certificate:?}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_goal_changes_while_the_robot_drives_and_no_process_is_swapped() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--record"]);
        system
            .wait_until("the robot drives", |system| system.status().is_some_and(|status| status.scan > 15));
        let old = system.pid(Role::Controller);
        for (arguments, reason) in [
            (&["goal.x_m=0.5"][..], "m further on than the robot"),
            (&["goal.y_m=40"], "goal.y_m = 40 is not allowed: "),
            (&["goal.x_m=7", "controller.cruise_mps=0.9"], "set goals alone"),
        ] {
            let output = system.run(&[&["set"], arguments].concat());
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.code() == Some(2) && text.contains(reason), "{arguments:?}: {text}");
        }
        let output = system.run(&["set", "--json", "goal.x_m=6", "goal.y_m=0.3"]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let set: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let from_scan = set["from_scan"].as_u64().unwrap();
        system.wait_until("the goal counts", |system| {
            system.status().is_some_and(|status| status.scan > from_scan)
        });
        let truth = system.run(&["topic", "echo", "truth", "-n", "1", "--short"]);
        let truth: serde_json::Value = serde_json::from_slice(&truth.stdout).unwrap();
        let [x_m, y_m, distance_m] =
            ["x_m", "y_m", "goal_distance_m"].map(|key| truth[key].as_f64().unwrap());
        assert!(((x_m - 6.0).hypot(y_m - 0.3) - distance_m).abs() < 1e-3, "{truth}");
        // A controller that starts again has it among its settings.
        kill_controller(&system);
        assert_ne!(system.pid(Role::Controller), old);
        assert_eq!(system.wait().code(), Some(0));
        let report = system.report();
        let [.., [_, x_m, y_m, _]] = report.trajectory[..] else { panic!("{report:?}") };
        assert!((x_m - 6.0).hypot(y_m - 0.3) < 0.1, "({x_m}, {y_m})");
        let [change] = report.goal_changes[..] else { panic!("{:?}", report.goal_changes) };
        assert_eq!((change.from_scan, change.x_m, change.y_m), (from_scan, 6.0, 0.3));
        assert_eq!(report.swaps, []);
        let recording = report.recording.unwrap().file;
        let replayed = system.run(&["replay", recording.to_str().unwrap()]);
        assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_goal_that_can_not_be_written_is_written_nowhere_and_one_line_says_why() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free"]);
        system.wait_until("the robot drives", |system| system.status().is_some_and(|status| status.scan > 5));
        let files = || {
            let folder = system.domain().folder().clone();
            ["settings-controller.toml", "run.toml"].map(|name| folder.read_text(name).unwrap())
        };
        let before = files();
        let [settings, run] = before.each_ref().map(|text| text.len() as u64);
        assert!(settings + 200 < run, "the second file is the larger one");
        let orchestrator = Pid::from_raw(system.orchestrator());
        let limit = |current| {
            let maximum = getrlimit(Resource::Fsize).maximum;
            prlimit(orchestrator, Resource::Fsize, Rlimit { current, maximum }).unwrap();
        };
        limit(Some(settings + 100));
        let refused = system.run(&["set", "goal.x_m=7"]);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(4), "{text}");
        assert!(text.contains("run.toml: File too large") && text.lines().count() == 1, "{text}");
        assert_eq!(text.matches("File too large").count(), 1, "{text}");
        assert_eq!(files(), before);
        limit(None);
        let set = system.run(&["set", "goal.x_m=7"]);
        assert_eq!(set.status.code(), Some(0), "{set:?}");
        assert!(files().iter().zip(&before).all(|(new, old)| new != old));
        assert_eq!(system.wait().code(), Some(0));
        system.assert_nothing_left();
    });
}

#[test]
fn what_is_not_allowed_is_named_with_the_reason() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        for (arguments, reason) in [
            (&["controller.intervals=0"][..], "controller.intervals = 0 is not allowed: "),
            (
                &["controller.interval=9"],
                "controller.interval = 9 is not allowed: the key is unknown. Did you mean `intervals`? Expected one of",
            ),
            (&["controller.intervals=9", "actuator.recovery=3"], "set keys of one role at a time"),
            (&["rate_hz=20"], "rate_hz can't be set while the system runs: all processes depend on it"),
            (&["player.port=1"], "player.port: this system has no robot `player`"),
            (&["controller.intervals"], "expected KEY=VALUE"),
        ] {
            let output = system.run(&[&["set"], arguments].concat());
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.code() == Some(2) && text.contains(reason), "{arguments:?}: {text}");
        }
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        assert_eq!(system.report().swaps, []);
        system.assert_nothing_left();
    });
}
