//! What a command was asked for goes to standard output, the rest to standard error; a reader may go at any time.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::process::{Command, Output, Stdio};

use scanloop_tests::TestSystem;

use super::languages::tools::EXECUTABLE;

/// Cases of the solver, so that its bench is short.
const CASES: &str = "name,x1,x2,x3,x4,x5\nahead,0,0,0,0,0\n";

/// Commands that need no system, each with a part of what it is asked for. They run in this order in one folder.
const ALONE: &[(&str, &str)] = &[
    ("run free --lockstep --record=drive.mcap", "outcome         reached"),
    ("run free --lockstep --quiet", "scans           "),
    ("check corridor", "corridor: a valid scenario"),
    ("check --list", "corridor\n"),
    ("types", "odometry"),
    ("reference backlash", "robot.steering_backlash_rad = "),
    ("inject --list", "scanner-dead"),
    ("analyse observability", "definition"),
    ("calibrate velocity --drive --scenario imperfect-robot", "kv              "),
    ("campaign --runs 2 --out out", "courses"),
    ("faults --only pose-late-30ms --sample 1", "passed"),
    ("bench solver --cases cases.csv --intervals 6", "gauss-newton"),
    ("bench ride free", "no regret       free"),
    ("conformance estimator --to ekf --only every-scan", "passed        every-scan"),
    ("recording info drive.mcap", "odometry"),
    ("recording repair drive.mcap", "messages"),
    ("recording cut drive.mcap --from 0 --to 1 --out cut.mcap", "messages"),
    ("recording export drive.mcap --csv tables", "rows"),
    ("replay drive.mcap", "identical"),
    ("demo --fast --only lockstep", "promises held"),
];

/// The same for a system that drives.
const BESIDE: &[(&str, &str)] = &[
    ("status", "estimator"),
    ("latency --duration 1.2", "scan to actuation"),
    ("topic list", "odometry"),
    ("topic hz pose --duration 0.5", "on average"),
    ("topic echo pose -n 1 --short", "\"x_m\""),
    ("swap controller --to nmpc --tolerance 1000", "has taken over"),
    ("set controller.budget_iterations=50 --tolerance 1000", "has taken over"),
    ("restart estimator", "was restarted"),
    ("shadow estimator --to ekf --for 1s", "in the shadow of"),
    ("inject scanner-dead --for 0.1s", "scanner-dead: for 0.1 s"),
    ("record live.mcap --duration 0.5", "samples"),
    ("check --live --observe 1", " ok, "),
];

fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Asserts that the part of the answer is on standard output alone.
fn assert_answers(line: &str, part: &str, output: &Output) {
    let (answer, rest) = (text(&output.stdout), text(&output.stderr));
    assert!(answer.contains(part) && !rest.contains(part), "{line}: `{part}` in\n{answer}\nbeside\n{rest}");
    assert!(!rest.contains("panicked") && !answer.contains("error:"), "{line}: {rest}");
}

/// Asserts that a command whose reader goes after a line ends as one that is read, without a word.
fn assert_quiet_without_reader(system: &TestSystem, line: &str, code: Option<i32>) {
    let id = system.id();
    let script =
        format!("{EXECUTABLE} --system-id {id} {line} | head -1 >/dev/null; exit ${{PIPESTATUS[0]}}");
    let mut shell = Command::new("bash");
    let output =
        shell.args(["-c", &script]).current_dir(system.folder()).stdin(Stdio::null()).output().unwrap();
    let rest = text(&output.stderr);
    assert_eq!(output.status.code(), code, "{line}: {rest}");
    assert!(!rest.contains("panicked") && !rest.contains("pipe"), "{line}: {rest}");
}

#[test]
fn what_a_command_was_asked_for_is_on_standard_output() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        std::fs::write(system.folder().join("cases.csv"), CASES).unwrap();
        for (line, part) in ALONE {
            assert_answers(line, part, &system.run(&words(line)));
        }
        for line in [
            "run free --lockstep",
            "check corridor",
            "types",
            "recording info drive.mcap",
            "replay drive.mcap",
        ] {
            assert_quiet_without_reader(&system, line, Some(0));
        }
        system.assert_nothing_left();
    });
}

#[test]
fn what_is_asked_of_a_running_system_is_on_standard_output() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--allow-inject"]);
        for (line, part) in BESIDE {
            assert_answers(line, part, &system.run(&words(line)));
        }
        for line in
            ["status", "latency --duration 2.5", "topic hz pose", "topic echo pose", "restart estimator"]
        {
            assert_quiet_without_reader(&system, line, Some(0));
        }
        assert_answers("stop", "is stopped: wheels blocked after", &system.run(&["stop"]));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn with_json_standard_output_has_nothing_else() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        std::fs::write(system.folder().join("cases.csv"), CASES).unwrap();
        for line in [
            "analyse observability --json",
            "bench solver --cases cases.csv --intervals 6 --json",
            "campaign --runs 1 --out out --json",
            "conformance estimator --to ekf --only every-scan --json",
            "demo --fast --only lockstep --json",
        ] {
            let output = system.run(&words(line));
            let found = serde_json::from_slice::<serde_json::Value>(&output.stdout);
            assert!(found.is_ok_and(|value| value.is_object()), "{line}: {}", text(&output.stdout));
            assert!(!output.stderr.is_empty(), "{line}: the text for people");
        }
        system.assert_nothing_left();
    });
}
