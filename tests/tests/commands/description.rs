//! What `check`, `run`, `status` and the report state about the vehicle description, margins and stops.

use emulator::Outcome;
use report::BlockingReport;
use scanloop_tests::TestSystem;
use serde_json::{Value, json};
use vehicle::Surroundings;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs a command and returns what it prints for people.
fn text(system: &TestSystem, arguments: &[&str]) -> String {
    let output = system.run(arguments);
    scanloop_tests::printed(&output)
}

/// A believable robot that is wider than its description.
const WIDER: [&str; 6] =
    ["--set", "robot.preset=summit", "--set", "robot.width_m=0.5", "--set", "vehicle.width_m=0.4"];
const WIDER_ROW: &str = "robot.width_m = 0.5, vehicle.width_m = 0.4 (+25 %)";

#[test]
fn check_lists_where_the_robot_differs_and_run_and_report_name_it() {
    let system = TestSystem::new(EXECUTABLE);
    let checked = text(&system, &[&["check", "free"][..], &WIDER].concat());
    let expected = format!(
        "obstacles, goal at (10, 0)\n  the scenario differs from [vehicle] in one property:\n    {WIDER_ROW}\n"
    );
    assert!(checked.contains(&expected), "{checked}");
    let same = text(&system, &["check", "free", "--set", "robot.preset=summit"]);
    assert!(!same.contains("differ"), "{same}");

    let short = [&["run", "free", "--lockstep", "--duration", "0.5"][..], &WIDER].concat();
    let shown = text(&system, &short);
    assert!(shown.contains(WIDER_ROW), "{shown}");
    let quiet = text(&system, &[&short[..], &["--quiet"]].concat());
    assert!(!quiet.contains(WIDER_ROW), "{quiet}");
    let report = system.lockstep(&[&["free", "--duration", "0.5"][..], &WIDER].concat());
    let rows: Vec<_> =
        report.differences.iter().map(|it| (it.key.as_str(), &it.truth, &it.believed)).collect();
    assert_eq!(rows, [("width_m", &json!(0.5), &json!(0.4))]);

    let worn = ["--set", "robot.preset=worn"];
    let many = text(&system, &[&["run", "free", "--lockstep", "--duration", "0.5"][..], &worn].concat());
    assert!(
        many.contains("properties of robot.preset `worn` differ from [vehicle], largest: robot."),
        "{many}"
    );
    let listed = text(&system, &[&["check", "free"][..], &worn].concat());
    assert!(listed.lines().filter(|line| line.contains(", vehicle.")).count() > 10, "{listed}");
}

#[test]
fn open_surroundings_limit_the_speed_and_are_named_by_check_run_and_report() {
    let system = TestSystem::new(EXECUTABLE);
    let line = "speed limited to 0.3 m/s: nothing around shows that the scanner sees\n";
    let open = ["--set", "robot.preset=summit", "--set", "track.surroundings=open"];
    let run = [&["run", "free", "--lockstep", "--duration", "0.5"][..], &open].concat();
    for command in [&[&["check", "free"][..], &open].concat(), &run] {
        let shown = text(&system, command);
        assert!(shown.contains(line) && !shown.contains("differ"), "{shown}");
    }
    assert!(!text(&system, &[&run[..], &["--quiet"]].concat()).contains(line));
    assert!(!text(&system, &["check", "free"]).contains("speed limited"));

    let drive = |more: &[&str]| system.lockstep(&[&["free"][..], &open, more].concat());
    let careful = drive(&[]);
    assert_eq!(
        (careful.surroundings, careful.outcome),
        (Surroundings::Open, Outcome::Reached),
        "{}",
        careful.reason
    );
    assert_eq!(careful.drive.speed_limit_mps, Some(0.3));
    // 10 m, and true speeds that differ from the desired ones by a few percent at most.
    assert!((30.0..50.0).contains(&careful.duration_s), "{} s", careful.duration_s);
    let wrong = drive(&["--set", "vehicle.surroundings=hall"]);
    let rows: Vec<_> =
        wrong.differences.iter().map(|it| (it.key.as_str(), &it.truth, &it.believed)).collect();
    assert_eq!(rows, [("surroundings", &json!("open"), &json!("hall"))]);
    // Stages that expect a hall take an open world for a blind scanner.
    assert_eq!(
        (wrong.surroundings, wrong.outcome),
        (Surroundings::Open, Outcome::Stopped),
        "{}",
        wrong.reason
    );
    assert!(wrong.reason.contains("scanner"), "{}", wrong.reason);
    assert_eq!(system.lockstep(&["free", "--duration", "0.5"]).surroundings, Surroundings::Hall);
    system.assert_nothing_left();
}

#[test]
fn an_old_key_of_a_stage_warns_in_check_and_in_run_even_with_quiet() {
    let system = TestSystem::new(EXECUTABLE);
    let warning = "warning: controller.body_width_m holds for this stage only; set vehicle.width_m instead\n";
    let old = ["--set", "controller.body_width_m=0.5"];
    let run = ["run", "free", "--quiet", "--lockstep", "--duration", "0.5"];
    for command in [&["check", "free"][..], &["check"], &run] {
        let shown = text(&system, &[command, &old].concat());
        assert_eq!(shown.matches(warning).count(), 1, "{command:?}: {shown}");
        assert!(!text(&system, command).contains("warning"), "{command:?}");
    }
    let ignored = text(&system, &["check", "--set", "controller.period_s=0.2"]);
    assert!(ignored.contains("controller.period_s has no effect"), "{ignored}");
    system.assert_nothing_left();
}

#[test]
fn the_report_has_the_margins_of_the_drive_and_the_coverage_of_the_estimate() {
    let system = TestSystem::new(EXECUTABLE);
    let report = system.lockstep(&["corridor"]);
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    assert!(
        report.drive.truth.unwrap().covariance_coverage.is_some_and(|share| (0.0..=1.0).contains(&share))
    );
    assert!(report.drive.speed_limit_mps.is_some_and(|limit_mps| limit_mps > 0.0), "{:?}", report.drive);
    let margin = report.margin_m;
    assert!(margin.base > 0.0 && margin.sum() > margin.base && margin.sum() < 0.6, "{margin:?}");
    assert_eq!(report.blocking, None);
}

/// The obstacle of the scenario `blocked`, whose boxes close the track at x = 6 m.
fn assert_names_the_wall(blocking: &BlockingReport, text: &str) {
    assert!(blocking.id > 0 && (5.0..7.5).contains(&blocking.x_m), "{blocking:?}");
    assert!(blocking.needed_m > 0.4 && blocking.gap_m < blocking.needed_m, "{blocking:?}");
    assert!(text.contains(&format!("blocked by {blocking}")), "{text}");
}

#[test]
fn a_stop_names_its_obstacle_in_report_summary_and_log() {
    let system = TestSystem::new(EXECUTABLE);
    let out = system.folder().join("out");
    let printed = text(&system, &["run", "blocked", "--lockstep", "--quiet", "--out", out.to_str().unwrap()]);
    let report = report::Report::read(&out.join("report.json")).unwrap();
    assert_eq!(report.outcome, Outcome::Stopped, "{}", report.reason);
    let blocking = report.blocking.unwrap_or_else(|| panic!("no obstacle is named: {}", report.reason));
    assert_names_the_wall(&blocking, &report.reason);
    assert!(printed.contains(&format!("blocked by {blocking}")), "{printed}");
    let log = std::fs::read_dir(out.join("logs")).unwrap().flatten();
    let mut logs = log.map(|entry| std::fs::read_to_string(entry.path()).unwrap_or_default());
    assert!(logs.any(|log| log.contains("stopped: blocked by obstacle ")), "no log names the obstacle");
}

#[test]
fn status_names_the_obstacle_while_the_robot_stands_in_front_of_it() {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&["blocked", "--set", "stop_final_s=60"]);
    let json = |system: &TestSystem| -> Value {
        let output = system.run(&["status", "--json"]);
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    };
    assert!(json(&system).get("blocking").is_some_and(Value::is_null), "it drives");
    system.wait_until("it stands", |system| json(system)["blocking"].is_object());
    let blocking: BlockingReport = serde_json::from_value(json(&system)["blocking"].clone()).unwrap();
    assert_names_the_wall(&blocking, &text(&system, &["status"]));
    system.run(&["stop"]);
    system.wait();
    assert_eq!(system.report().blocking.map(|it| it.id), Some(blocking.id));
    system.assert_nothing_left();
}
