//! The drivers that users copy for a robot of their own, with the simulated devices that they come with.

use scanloop_tests::machine::repeat_when_late;
use std::path::PathBuf;
use std::process::Output;

use conformance::{CaseOutcome, SuiteReport};
use emulator::{JudgedBy, Outcome};
use scanloop_tests::TestSystem;

use super::swaps::system_with;
use super::tools::{EXECUTABLE, MY_ROBOT, compile, examples, python, root};

/// What only an emulated robot can do.
const NOT_FOR_REAL_ROBOTS: [&str; 3] = ["truth", "grants", "repeatable"];

fn template(language: &str) -> PathBuf {
    root().join("examples/template-robot").join(language)
}

/// Language, command, and the rate at which it is tested: lower for an interpreter on a busy machine [Hz].
pub(super) fn drivers(system: &TestSystem, test: &str) -> Vec<(&'static str, Vec<String>, &'static str)> {
    let program = system.folder().join("robot");
    compile(&template("c").join("robot.c"), &examples("c"), &program);
    let mut all = vec![
        ("rust", vec![MY_ROBOT.to_owned()], "20"),
        ("c", vec![program.to_str().unwrap().to_owned()], "20"),
    ];
    if let Some(python) = python(test) {
        let script = template("python").join("robot.py");
        let command = [python.to_str().unwrap(), "-B", script.to_str().unwrap()];
        all.push(("python", command.map(str::to_owned).to_vec(), "10"));
    }
    all
}

#[test]
fn drivers_to_be_copied_honour_all_that_is_asked_of_a_real_robot() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let drivers = drivers(&system, "drivers_to_be_copied_honour_all, the driver");
        std::thread::scope(|scope| {
            for (language, command, rate_hz) in &drivers {
                let mut suite = system.command(&["conformance", "robot", "--json", "--rate", rate_hz, "--"]);
                scope.spawn(move || honours_all(language, &suite.args(command).output().unwrap()));
            }
        });
        system.assert_nothing_left();
    });
}

fn honours_all(language: &str, output: &Output) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{language}: {text}");
    let suite: SuiteReport = serde_json::from_slice(&output.stdout).unwrap();
    let failed = suite.cases.iter().filter(|case| case.outcome != CaseOutcome::Passed);
    let failed: Vec<&str> = failed.map(|case| case.name.as_str()).collect();
    assert_eq!(failed, NOT_FOR_REAL_ROBOTS, "{language}: {text}");
    // Its device restarts and breaks sweeps off, so the cases about that have something to find.
    let gaps = suite.cases.iter().find(|case| case.name == "gaps").unwrap();
    assert!(!gaps.reason.starts_with("0 of"), "{language}: {}", gaps.reason);
}

#[test]
fn drivers_to_be_copied_drive_to_the_goal_by_the_estimate() {
    repeat_when_late(|| {
        let test = "drivers_to_be_copied_drive_to_the_goal, the driver";
        for (language, command, _) in drivers(&TestSystem::new(EXECUTABLE), test) {
            let mut system = TestSystem::new(EXECUTABLE);
            let program = system.folder().join("robot");
            if language == "c" {
                compile(&template("c").join("robot.c"), &examples("c"), &program);
            }
            let own = vec![program.to_str().unwrap().to_owned()];
            let command = if language == "c" { own } else { command };
            let words: Vec<&str> = command.iter().map(String::as_str).collect();
            let file = system_with(system.folder(), "robot", &words);
            system.start(&["free", "--system", &file]);
            system.wait_until("its devices run", |system| {
                let processes = system.status().map_or(Vec::new(), |status| status.processes);
                processes.iter().any(|process| process.device.as_deref() == Some("running"))
            });
            assert_eq!(system.wait().code(), Some(0), "{language}: {}", system.stderr());
            let report = system.report();
            assert_eq!(
                (report.outcome, report.judged_by),
                (Outcome::Reached, JudgedBy::Estimate),
                "{language}"
            );
            assert_eq!((report.scans.unaccounted, report.ledger.residual), (0, 0), "{language}");
            assert!(report.drive.final_distance_m <= 0.1, "{language}: {}", report.drive.final_distance_m);
            system.assert_nothing_left();
        }
    });
}

/// The devices of the driver in C: each state of the base takes 20 to 60 ms, whatever the others take. The true place is
/// written beside the driver.
const OVERTAKEN_C: &str = r#"
static int read_odometry(struct device *device, uint64_t now_ns, uint64_t *stamp_ns, struct pose *pose) {
    static struct { uint64_t due_ns, stamp_ns; struct pose pose; } held[16];
    static unsigned random = 7;
    int first = -1;
    for (int index = 0; index < 16; index++) {
        if (held[index].due_ns == 0 && read_in_order(device, now_ns, &held[index].stamp_ns, &held[index].pose)) {
            random = random * 1103515245u + 12345u;
            held[index].due_ns = now_ns + (20 + (random >> 16) % 40) * (uint64_t)MS;
            FILE *file = fopen("TRUTH", "w");
            fprintf(file, "%f %f", device->pose.x_m, device->pose.y_m);
            fclose(file);
        }
        int is_due = held[index].due_ns != 0 && held[index].due_ns <= now_ns;
        if (is_due && (first < 0 || held[index].due_ns < held[first].due_ns)) {
            first = index;
        }
    }
    if (first < 0) {
        return 0;
    }
    *stamp_ns = held[first].stamp_ns;
    *pose = held[first].pose;
    held[first].due_ns = 0;
    return 1;
}
"#;

/// The same for the driver in Python.
const OVERTAKEN_PYTHON: &str = r#"

class Device(InOrder):
    held, order = [], random.Random(7)

    def read_odometry(self, now_ns):
        if state := super().read_odometry(now_ns):
            self.held.append((now_ns + self.order.randrange(20_000_000, 60_000_000), state))
            with open("TRUTH", "w") as file:
                file.write(f"{self._pose.x_m} {self._pose.y_m}")
        due = [entry for entry in self.held if entry[0] <= now_ns]
        if not due:
            return None
        first = min(due, key=lambda entry: entry[0])
        self.held.remove(first)
        return first[1]
"#;

/// A copy of a file of the template with these texts replaced.
fn changed(file: PathBuf, replacements: &[(&str, &str)]) -> String {
    let mut text = std::fs::read_to_string(file).unwrap();
    for (old, new) in replacements {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    text
}

/// Command of a driver to be copied whose base sends messages that overtake each other.
fn overtaken(language: &str, folder: &std::path::Path, truth: &str) -> Option<Vec<String>> {
    let template = template(language);
    if language == "c" {
        let replacements =
            [("(2000u * (uint64_t)MS)", "UINT64_MAX"), ("int read_odometry(", "int read_in_order(")];
        let text = changed(template.join("device.h"), &replacements);
        let device = text.replace("#endif", &format!("{}\n#endif", OVERTAKEN_C.replace("TRUTH", truth)));
        let device = device.replacen("#include <math.h>", "#include <math.h>\n#include <stdio.h>", 1);
        std::fs::write(folder.join("device.h"), device).unwrap();
        std::fs::copy(template.join("robot.c"), folder.join("robot.c")).unwrap();
        compile(&folder.join("robot.c"), &examples("c"), &folder.join("robot"));
        return Some(vec![folder.join("robot").to_str().unwrap().to_owned()]);
    }
    let python = python("a driver to be copied whose base is overtaken")?;
    let path = format!("import sys\nsys.path.insert(0, {:?})\nimport math", examples("python"));
    let replacements = [
        ("RESTART_NS = 2_000_000_000", "RESTART_NS = 10**18"),
        ("class Device:", "class InOrder:"),
        ("import math", &path),
    ];
    let device =
        changed(template.join("device.py"), &replacements) + &OVERTAKEN_PYTHON.replace("TRUTH", truth);
    std::fs::write(folder.join("device.py"), device).unwrap();
    std::fs::copy(template.join("robot.py"), folder.join("robot.py")).unwrap();
    let script = folder.join("robot.py");
    Some(vec![python.to_str().unwrap().to_owned(), "-B".to_owned(), script.to_str().unwrap().to_owned()])
}

#[test]
fn messages_that_overtake_each_other_do_not_move_a_driver_to_be_copied() {
    repeat_when_late(|| {
        for language in ["c", "python"] {
            let mut system = TestSystem::new(EXECUTABLE);
            let truth = system.folder().join("truth");
            let Some(command) = overtaken(language, system.folder(), truth.to_str().unwrap()) else {
                continue;
            };
            let words: Vec<&str> = command.iter().map(String::as_str).collect();
            let file = system_with(system.folder(), "robot", &words);
            system.start(&["free", "--system", &file, "--set", "goal.x_m=5"]);
            system.wait_until("messages are counted", |system| {
                let processes = system.status().map_or(Vec::new(), |status| status.processes);
                let reasons = processes.iter().filter_map(|process| process.device_reason.as_deref());
                reasons.into_iter().any(|reason| reason.contains("messages were overtaken by others"))
            });
            assert_eq!(system.wait().code(), Some(0), "{language}: {}", system.stderr());
            let report = system.report();
            let text = std::fs::read_to_string(truth).unwrap();
            let place: Vec<f64> = text.split(' ').map(|number| number.parse().unwrap()).collect();
            let beside_m = (place[0] - 5.0).hypot(place[1]);
            assert!(
                beside_m < 0.15,
                "{language}: {beside_m:.3} m by the truth, {} by the estimate",
                report.drive.final_distance_m
            );
            system.assert_nothing_left();
        }
    });
}
