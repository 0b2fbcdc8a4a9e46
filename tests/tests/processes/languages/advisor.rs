//! The advisor in Python, a process beside the loop, and the controller that obeys it.

use scanloop_tests::machine::repeat_when_late;
use std::process::Command;

use emulator::Outcome;
use scanloop_tests::TestSystem;

use super::tools::{EXECUTABLE, compile, examples, python};

/// The stretch that the advisor wants driven slowly, without its ends, and the speed there.
const SLOW_M: std::ops::Range<f64> = 2.4..3.9;
const SLOW_MPS: f64 = 0.3;

#[test]
fn a_controller_of_ones_own_obeys_the_advisor() {
    repeat_when_late(|| {
        let Some(python) = python("the advisor in Python") else { return };
        let folder = examples("python").join("speed-limit");
        let system = TestSystem::new(EXECUTABLE);
        let file = folder.join("system.toml");
        let command = |name: &str, program: &str| {
            let words = [python.to_str().unwrap(), folder.join(program).to_str().unwrap()].map(str::to_owned);
            format!("process.{name}.command={words:?}")
        };
        let (advisor, controller) =
            (command("advisor", "advisor.py"), command("controller", "controller.py"));
        let arguments = ["free", "--system", file.to_str().unwrap(), "--set", "goal.x_m=6"];
        let report = system.lockstep(&[&arguments[..], &["--set", &advisor, "--set", &controller]].concat());
        assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
        let advisor = &report.companions[0];
        assert_eq!((advisor.left_lockstep_at_scan, advisor.invalid), (None, 0));
        assert!(advisor.answered >= report.scans.published - 1, "{advisor:?}");
        assert!(report.digests.contains_key("limit"));
        for (topic, reader) in [("pose", "advisor"), ("limit", "controller")] {
            let row =
                report.ledger.companions.iter().find(|row| (&*row.topic, &*row.reader) == (topic, reader));
            assert!(
                row.is_some_and(|row| row.used > 20 && row.residual == 0),
                "{:?}",
                report.ledger.companions
            );
        }
        let speeds = report.trajectory.windows(2).map(|pair| {
            let [[t0, x0, ..], [t1, x1, ..]] = [pair[0], pair[1]];
            (x0, (x1 - x0) / (t1 - t0))
        });
        let (slow, fast): (Vec<_>, Vec<_>) = speeds.partition(|(x_m, _)| SLOW_M.contains(x_m));
        assert!(slow.len() > 20 && slow.iter().all(|(_, speed)| *speed < 1.1 * SLOW_MPS), "{slow:?}");
        assert!(fast.iter().any(|(_, speed)| *speed > 1.5 * SLOW_MPS), "{fast:?}");
    });
}

#[test]
fn the_class_of_the_example_is_what_the_executable_prints() {
    repeat_when_late(|| {
        let folder = examples("python").join("speed-limit");
        let output = Command::new(EXECUTABLE)
            .args(["types", "--python", "--layout"])
            .arg(folder.join("limit.toml"))
            .output()
            .unwrap();
        assert_eq!(
            String::from_utf8(output.stdout).unwrap(),
            std::fs::read_to_string(folder.join("limit.py")).unwrap()
        );
    });
}

/// A companion in C that answers each pose with a limit.
const ADVISOR: &str = r#"
#include "scanloop.h"
#include "limit.h"
#include <stdio.h>

int main(void) {
    scanloop_companion *companion;
    scanloop_topic *poses, *limits;
    const size_t rows = sizeof scanloop_limit_layout / sizeof scanloop_limit_layout[0];
    if (scanloop_companion_open(&companion) < 0
        || scanloop_companion_input(companion, SCANLOOP_TOPIC_POSE, &poses) < 0
        || scanloop_companion_topic(companion, "limit", scanloop_limit_layout, rows, &limits) < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return 2;
    }
    if (scanloop_companion_start(companion) == SCANLOOP_YES) {
        while (scanloop_companion_wait(companion, 0) == SCANLOOP_YES) {
            const void *sample;
            while (scanloop_topic_take(poses, &sample) == SCANLOOP_YES) {
                const scanloop_pose *pose = sample;
                scanloop_limit limit = {.speed_mps = 0.3};
                scanloop_answer(&pose->header, NULL, &limit.header);
                if (scanloop_topic_publish(limits, &limit, sizeof limit) < 0) {
                    fprintf(stderr, "%s\n", scanloop_last_error());
                    return 3;
                }
            }
        }
    }
    scanloop_topic_close(limits);
    scanloop_topic_close(poses);
    scanloop_companion_close(companion);
    return 0;
}
"#;

/// A system with the advisor in C, compiled against the header of `limit` with this change.
fn advisor_in_c(from: &str, to: &str) -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let folder = system.folder();
    std::fs::copy(examples("python").join("speed-limit/limit.toml"), folder.join("limit.toml")).unwrap();
    let header = system.run(&["types", "--c", "--layout", "limit.toml"]);
    let header = String::from_utf8(header.stdout).unwrap();
    assert!(header.contains(from), "{header}");
    std::fs::write(folder.join("limit.h"), header.replace(from, to)).unwrap();
    std::fs::copy(examples("c").join("scanloop_types.h"), folder.join("scanloop_types.h")).unwrap();
    std::fs::write(folder.join("advisor.c"), ADVISOR).unwrap();
    compile(&folder.join("advisor.c"), folder, &folder.join("advisor"));
    let built_in = include_str!("../../../../orchestrator/systems/default.toml");
    let text = format!(
        "{built_in}\n[[topic]]\nname = \"limit\"\nlayout = \"limit.toml\"\n[[process]]\nrole = \"companion\"\nname = \
         \"advisor\"\ncommand = [\"./advisor\"]\nreads = [\"pose\"]\nwrites = [\"limit\"]\n"
    );
    std::fs::write(folder.join("lab.toml"), text).unwrap();
    system
}

#[test]
fn a_companion_in_c_answers_every_sample() {
    repeat_when_late(|| {
        let system = advisor_in_c("double speed_mps", "double speed_mps");
        let report = system.lockstep(&["free", "--set", "goal.x_m=4", "--system", "lab.toml"]);
        assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
        let advisor = &report.companions[0];
        assert!(
            advisor.answered >= report.scans.published - 1 && advisor.published == advisor.taken,
            "{advisor:?}"
        );
    });
}

#[test]
fn companions_in_c_and_python_that_were_built_against_another_layout_are_refused_with_the_field() {
    repeat_when_late(|| {
        let assert_refused = |system: &TestSystem, arguments: &[&str], message: &str| {
            let report = system.lockstep(&[&["free", "--set", "goal.x_m=4"], arguments].concat());
            assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
            assert_eq!((report.companions[0].published, report.companions[0].state.as_str()), (0, "failed"));
            let log = std::fs::read_to_string(system.folder().join("out/logs/advisor.log")).unwrap();
            assert!(log.contains(message), "{log}");
        };
        let in_c = advisor_in_c("double speed_mps", "uint64_t speed_mps");
        let message = "topic limit: field speed_mps is of type u64 in this process, f64 in the system";
        assert_refused(&in_c, &["--system", "lab.toml"], message);
        let Some(python) = python("an advisor in Python of another layout") else { return };
        let (folder, system) = (examples("python").join("speed-limit"), TestSystem::new(EXECUTABLE));
        let mine = system.folder().join("speed-limit");
        std::fs::create_dir_all(&mine).unwrap();
        for name in ["limit.toml", "advisor.py"] {
            std::fs::copy(folder.join(name), mine.join(name)).unwrap();
        }
        // What the programs import from the folder above their own.
        for name in ["scanloop.py", "scanloop_types.py", "own_topics.py"] {
            std::fs::copy(examples("python").join(name), system.folder().join(name)).unwrap();
        }
        let class = std::fs::read_to_string(folder.join("limit.py")).unwrap();
        let renamed = class.replace("\"speed_mps\"", "\"velocity_mps\"");
        std::fs::write(mine.join("limit.py"), renamed).unwrap();
        let built_in = include_str!("../../../../orchestrator/systems/default.toml");
        let words = [python.to_str().unwrap(), mine.join("advisor.py").to_str().unwrap()].map(str::to_owned);
        let text = format!(
            "{built_in}\n[[topic]]\nname = \"limit\"\nlayout = \"speed-limit/limit.toml\"\n[[process]]\nrole = \
         \"companion\"\nname = \"advisor\"\ncommand = {words:?}\nreads = [\"pose\"]\nwrites = [\"limit\"]\n"
        );
        std::fs::write(system.folder().join("lab.toml"), text).unwrap();
        assert_refused(
            &system,
            &["--system", "lab.toml"],
            "field speed_mps is called velocity_mps in this process",
        );
    });
}
