//! The suites of `scanloop conformance`: good implementations pass, and each faulty one fails its case.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;

use conformance::{CaseOutcome, RequirementLevel, SuiteReport};
use runtime::Domain;
use scanloop_tests::machine::repeat_when_late;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");
const DEAD_RECKONING: &str = env!("CARGO_BIN_EXE_dead-reckoning-under-test");

/// Role and built-in implementation.
const BUILT_IN: [(&str, &str); 5] = [
    ("estimator", "ekf"),
    ("obstacles", "ellipses"),
    ("controller", "nmpc"),
    ("actuator", "actuation"),
    ("robot", "emulator"),
];

/// Role, the faulty program, its fault, and the cases that must find it.
const FAULTS: [(&str, &str, &str, &[&str]); 63] = [
    ("estimator", "loner", "unready", &["states"]),
    ("estimator", "loner", "silent", &["heartbeats"]),
    ("estimator", "loner", "early-only", &["joins-late"]),
    ("estimator", "loner", "deaf", &["ends-on-request"]),
    ("estimator", "loner", "immortal", &["ends-as-orphan"]),
    ("estimator", "loner", "fickle", &["survives-a-new-orchestrator"]),
    ("estimator", "loner", "litters", &["leaves-nothing"]),
    ("estimator", "loner", "none", &["counts"]),
    ("estimator", "estimator", "skips", &["every-scan"]),
    ("estimator", "estimator", "twice", &["every-scan"]),
    ("estimator", "estimator", "late", &["in-time"]),
    ("estimator", "estimator", "header", &["header"]),
    ("estimator", "estimator", "nan", &["valid-values"]),
    ("estimator", "estimator", "random", &["repeatable"]),
    ("estimator", "estimator", "stateless", &["state"]),
    ("estimator", "estimator", "amnesia", &["resume"]),
    ("estimator", "estimator", "guesses", &["lost-state"]),
    ("estimator", "estimator", "trusts", &["authority", "repeated", "stale", "pause"]),
    ("estimator", "estimator", "believes", &["garbage"]),
    ("estimator", "estimator", "stays", &["exchange"]),
    ("estimator", "estimator", "invents", &["missing-input"]),
    ("estimator", "estimator", "off", &["near-the-truth"]),
    ("estimator", "estimator", "behind", &["looks-ahead"]),
    ("estimator", "estimator", "uncorrected", &["corrects-odometry"]),
    ("estimator", "estimator", "gullible", &["outlier"]),
    ("estimator", "estimator", "sure", &["covariance"]),
    ("obstacles", "obstacles", "unpaired", &["missing-input"]),
    ("obstacles", "obstacles", "small", &["sees-a-box"]),
    ("obstacles", "obstacles", "phantom", &["no-phantoms"]),
    ("obstacles", "obstacles", "needs-returns", &["no-returns"]),
    ("obstacles", "obstacles", "far-first", &["nearest-first"]),
    ("obstacles", "obstacles", "renumbers", &["keeps-identity"]),
    ("obstacles", "obstacles", "forgets", &["no-returns", "covered-sector", "missing-scan", "silent-body"]),
    (
        "obstacles",
        "obstacles",
        "trusting",
        &["no-returns", "covered-sector", "stuck", "range-factor", "mounting-angle", "random-ranges"],
    ),
    ("obstacles", "obstacles", "unforgiving", &["no-returns"]),
    ("obstacles", "obstacles", "travels", &["stuck"]),
    ("obstacles", "obstacles", "timid", &["noisy-scanner"]),
    ("obstacles", "obstacles", "needs-scans", &["missing-scan"]),
    ("obstacles", "obstacles", "keeps", &["seen-free"]),
    ("controller", "controller", "never", &["drives"]),
    ("controller", "controller", "blind", &["stops-before-a-barrier", "off-the-track", "obstacle-inside"]),
    ("controller", "controller", "never-lands", &["lands"]),
    ("controller", "controller", "careless", &["obeys-alarm", "obeys-the-scanner", "degraded-scanner"]),
    ("controller", "controller", "mute", &["names-its-reason"]),
    ("controller", "controller", "planless", &["plan"]),
    ("controller", "controller", "unverified", &["verified"]),
    ("controller", "controller", "alone", &["by-hand", "new-goal"]),
    ("controller", "controller", "straight", &["bend"]),
    ("actuator", "actuator", "clamps", &["limits"]),
    ("actuator", "actuator", "factor", &["sends-what-is-desired", "calibration"]),
    ("actuator", "actuator", "drives-on", &["obeys-stop"]),
    ("actuator", "actuator", "ignores-stop", &["stop-wins"]),
    ("actuator", "actuator", "alone", &["paused", "by-hand", "emergency-stop"]),
    ("actuator", "actuator", "patient", &["silence"]),
    ("actuator", "actuator", "hasty", &["two-after-silence"]),
    ("actuator", "actuator", "wary", &["gap"]),
    ("actuator", "actuator", "believes", &["future"]),
    ("actuator", "actuator", "wordless", &["last-word"]),
    ("actuator", "actuator", "eager", &["first-word"]),
    ("robot", "robot", "believes", &["nonsense", "blocks"]),
    ("robot", "robot", "trusts", &["authority", "repeated"]),
    ("robot", "robot", "tireless", &["dead-man"]),
    ("robot", "robot", "mirrored", &["drives"]),
];

/// Faults of robots whose cases can be played in one go, because no case hides another.
const ROBOT_FAULTS: [(&str, &[&str]); 18] = [
    ("halves", &["scans"]),
    ("stamps", &["header"]),
    ("nan", &["valid-values"]),
    ("jumps", &["increments"]),
    ("restless", &["stopping"]),
    ("truthless", &["truth"]),
    ("runs-ahead", &["grants"]),
    ("random", &["repeatable"]),
    ("foreign", &["foreign-clock"]),
    ("drifts", &["foreign-clock"]),
    ("arrival", &["foreign-clock"]),
    ("jittery", &["jitter"]),
    ("fills", &["gaps"]),
    ("resets", &["device-restart"]),
    ("half", &["half-a-scan"]),
    ("old-half", &["half-a-scan"]),
    ("backwards", &["counts-up"]),
    ("apart", &["counts-up"]),
];

#[test]
fn built_in_implementations_meet_everything() {
    repeat_when_late(|| {
        std::thread::scope(|scope| {
            for (role, name) in BUILT_IN {
                scope.spawn(move || {
                    let (report, output) = suite(&["--rate", "20", "--jobs", "8", role, "--to", name]);
                    assert!(bad(&report).is_empty(), "{role}: {}", stderr(&output));
                    assert_eq!((output.status.code(), report.skipped), (Some(0), 0), "{}", stderr(&output));
                    assert_eq!(report.passed, report.cases.len());
                });
            }
        });
    });
}

#[test]
fn built_in_implementations_meet_what_depends_on_the_vehicle_with_each_shipped_one() {
    let cases: [(&str, &str, &[&str]); 5] = [
        ("estimator", "ekf", &["near-the-truth", "looks-ahead"]),
        ("obstacles", "ellipses", &["sees-a-box", "noisy-scanner", "seen-free"]),
        ("controller", "nmpc", &["stops-before-a-barrier", "lands", "by-hand", "new-goal", "bend"]),
        ("actuator", "actuation", &["limits", "sends-what-is-desired", "valid-values"]),
        ("robot", "emulator", &["drives", "blocks", "valid-values"]),
    ];
    repeat_when_late(|| {
        for (vehicle, scale) in [("racecar", "2"), ("turtlebot", "1"), ("car", "2")] {
            let file = format!("{}/../examples/vehicles/{vehicle}.toml", env!("CARGO_MANIFEST_DIR"));
            let with = ["--system", &file, "--scale", scale, "--jobs", "8"];
            std::thread::scope(|scope| {
                for (role, name, only) in cases {
                    let only = only.iter().flat_map(|case| ["--only", case]);
                    let arguments: Vec<&str> =
                        [role, "--to", name].into_iter().chain(with).chain(only).collect();
                    scope.spawn(move || {
                        let (report, output) = suite(&arguments);
                        let code = output.status.code();
                        assert!(
                            bad(&report).is_empty() && code == Some(0),
                            "{vehicle} {role}: {}",
                            stderr(&output)
                        );
                    });
                }
            });
        }
    });
    // The bounds of the default robot are none of this one: a command that it may not drive is found by its own.
    let file = format!("{}/../examples/vehicles/racecar.toml", env!("CARGO_MANIFEST_DIR"));
    let refused = run(&["actuator", "--to", "actuation", "--system", &file, "--scale", "1e9"]);
    assert!(
        refused.status.code() == Some(2) && stderr(&refused).contains("--scale 1000000000"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn an_estimator_of_ones_own_meets_what_is_required() {
    let (report, output) = suite(&["--rate", "20", "--jobs", "8", "estimator", "--", DEAD_RECKONING]);
    assert_eq!((output.status.code(), report.failed), (Some(0), 0), "{}", stderr(&output));
    // It has no state and trusts the odometer.
    let advice: Vec<&str> = bad(&report);
    assert_eq!(advice, ["state", "corrects-odometry", "outlier", "covariance"], "{}", stderr(&output));
}

#[test]
fn every_case_finds_a_fault() {
    let robots = ROBOT_FAULTS.iter().map(|(fault, cases)| ("robot", "robot", *fault, *cases));
    let wrong = Mutex::new(Vec::new());
    let queue = Mutex::new(FAULTS.into_iter().chain(robots).collect::<Vec<_>>());
    std::thread::scope(|scope| {
        for _ in 0..6 {
            scope.spawn(|| {
                while let Some((role, program, fault, cases)) = { queue.lock().unwrap().pop() } {
                    let mut arguments = vec!["--rate", "20", "--tries", "1", "--jobs", "8", role];
                    cases.iter().for_each(|case| arguments.extend(["--only", case]));
                    arguments.extend(["--", FAULTY, program, fault]);
                    // On a machine that is too busy to publish actuations a robot stops, whatever its fault.
                    let found = (0..3).any(|_| {
                        let (report, output) = suite(&arguments);
                        let required =
                            report.cases.iter().any(|case| case.level == RequirementLevel::Required);
                        bad(&report) == names(&report) && output.status.code() == Some(i32::from(required))
                    });
                    if !found {
                        wrong.lock().unwrap().push(format!("{program} {fault}: {cases:?}"));
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "not found: {wrong:?}");
}

/// Cases of one program, with their outcome each.
fn outcomes(
    role: &str,
    program: &str,
    fault: &str,
    cases: &[&str],
) -> (Vec<CaseOutcome>, Option<i32>, String) {
    let mut arguments = vec!["--rate", "20", "--tries", "1", "--jobs", "8", role];
    cases.iter().for_each(|case| arguments.extend(["--only", case]));
    arguments.extend(["--", FAULTY, program, fault]);
    let (report, output) = suite(&arguments);
    assert_eq!(report.not_observed, cases.len(), "{}", stderr(&output));
    (report.cases.iter().map(|case| case.outcome).collect(), output.status.code(), stderr(&output))
}

#[test]
fn a_case_that_could_not_see_what_it_is_about_is_no_pass() {
    // A robot at a wall, a controller that never drives, and a detector that reports nothing.
    for (role, fault, cases) in [
        ("robot", "stuck", &["increments", "gaps", "device-restart", "half-a-scan"][..]),
        ("controller", "never", &["stops-before-a-barrier", "stale", "authority", "pause"]),
        ("obstacles", "nothing", &["no-phantoms"]),
        ("obstacles", "always-blind", &["range-factor", "mounting-angle"]),
    ] {
        let (outcomes, code, text) = outcomes(role, role, fault, cases);
        assert_eq!(outcomes, vec![CaseOutcome::NotObserved; cases.len()], "{text}");
        assert_eq!(code, Some(1), "{text}");
        assert!(text.contains("not observed  ") && text.contains("was not seen to meet all"), "{text}");
    }
    // Without a recommended case it may fill the role.
    for (role, fault, case) in [
        ("robot", "stuck", "jitter"),
        ("controller", "halts", "names-its-reason"),
        ("obstacles", "nothing", "nearest-first"),
        ("obstacles", "nothing", "keeps-identity"),
    ] {
        let (_, code, text) = outcomes(role, role, fault, &[case]);
        assert_eq!(code, Some(0), "{text}");
    }
}

#[test]
fn the_table_of_faults_has_every_case_of_every_role() {
    let mut tried: BTreeSet<(&str, &str)> = BTreeSet::new();
    for (role, _, _, cases) in FAULTS {
        tried.extend(cases.iter().map(|case| (role, *case)));
    }
    tried.extend(ROBOT_FAULTS.iter().flat_map(|(_, cases)| cases.iter().map(|case| ("robot", *case))));
    let common: BTreeSet<&str> =
        tried.iter().filter(|(role, _)| *role == "estimator").map(|(_, case)| *case).collect();
    for (role, _) in BUILT_IN {
        for line in rows(&list(&[role, "--list"])) {
            let case = line.split('`').nth(1).unwrap();
            // The cases that all roles share are tried with estimators.
            assert!(tried.contains(&(role, case)) || common.contains(case), "{role}: no fault for `{case}`");
        }
    }
}

#[test]
fn a_program_that_cannot_be_started_ends_with_code_4() {
    for command in [&["./no-such-program"][..], &["true"], &["sh", "-c", "echo gone >&2; exit 3"]] {
        let output = run(&[&["estimator", "--"], command].concat());
        assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    }
    let output = run(&["estimator", "--", "sh", "-c", "echo gone >&2; exit 3"]);
    assert!(stderr(&output).contains("its last log lines: gone"), "{}", stderr(&output));
}

#[test]
fn wrong_usage_names_what_is_allowed() {
    let messages = [
        (&["pilot", "--to", "ekf"][..], "unknown role `pilot`: expected robot, estimator"),
        (&["estimator", "--to", "nmpc"], "--to nmpc is not allowed for role estimator: ekf"),
        (&["estimator"], "expected `--to IMPLEMENTATION` or `-- COMMAND...`"),
        (&["estimator", "--to", "ekf", "--only", "sings"], "role estimator has no such case, it has states,"),
        (&["estimator", "--to", "ekf", "--rate", "500"], "--rate 500 is not allowed: 2 to 50 Hz"),
    ];
    for (arguments, message) in messages {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    }
}

#[test]
fn the_page_lists_each_case_once_with_its_roles() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/conformance-cases.md");
    let all = list(&["--list"]);
    assert!(std::fs::read_to_string(page).unwrap().ends_with(&all), "docs/conformance-cases.md is old");
    let every: BTreeSet<&str> = rows(&all).collect();
    assert_eq!(every.len(), rows(&all).count(), "a case is listed twice");
    let mut of_roles = BTreeSet::new();
    for (role, _) in BUILT_IN {
        let of_role = list(&[role, "--list"]);
        let sections = all.split("## ").filter(|section| roles(section).any(|name| name == role));
        let expected: Vec<&str> = sections.flat_map(rows).collect();
        assert_eq!(rows(&of_role).collect::<Vec<_>>(), expected, "{role}");
        of_roles.extend(rows(&of_role).map(str::to_owned));
    }
    assert!(every.iter().copied().eq(&of_roles), "a case of no role");
}

/// What a list prints.
fn list(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The lines of a list that are cases.
fn rows(list: &str) -> impl Iterator<Item = &str> {
    list.lines().filter(|line| line.starts_with("| `"))
}

/// The roles of a section: its title, or what stands below that.
fn roles(section: &str) -> impl Iterator<Item = &str> {
    let below = section.lines().find_map(|line| line.strip_prefix("For ")?.strip_suffix('.'));
    below.or(section.lines().next()).unwrap_or_default().split(", ")
}

/// Plays a suite and checks that it leaves nothing.
fn suite(arguments: &[&str]) -> (SuiteReport, Output) {
    let output = run(&[&["--json"], arguments].concat());
    let report: SuiteReport =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {}", stderr(&output)));
    let count = |outcome| report.cases.iter().filter(|case| case.outcome == outcome).count();
    assert_eq!(count(CaseOutcome::Passed), report.passed);
    assert_eq!(count(CaseOutcome::Failed), report.failed + report.not_recommended);
    (report, output)
}

/// Runs the command to its end; it must leave nothing.
fn run(arguments: &[&str]) -> Output {
    let mut command = Command::new(EXECUTABLE);
    command
        .arg("conformance")
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    // Systems of the suite are numbered: `c21-0`, `c21-1`.
    let prefix = format!("c{}-", child.id());
    let output = child.wait_with_output().unwrap();
    let left: Vec<_> =
        Domain::all().unwrap().into_iter().filter(|domain| domain.system_id().starts_with(&prefix)).collect();
    assert!(left.is_empty(), "left: {left:?}");
    let owner = |path: &std::path::Path| std::fs::read_to_string(path.join("system-id")).unwrap_or_default();
    let left = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|entry| entry.path());
    let left: Vec<_> = left.filter(|path| owner(path).starts_with(&prefix)).collect();
    assert!(left.is_empty(), "left in shared memory: {left:?}");
    output
}

/// Names of the cases that failed.
fn bad(report: &SuiteReport) -> Vec<&str> {
    report
        .cases
        .iter()
        .filter(|case| case.outcome == CaseOutcome::Failed)
        .map(|case| case.name.as_str())
        .collect()
}

/// Names of all cases.
fn names(report: &SuiteReport) -> Vec<&str> {
    report.cases.iter().map(|case| case.name.as_str()).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
