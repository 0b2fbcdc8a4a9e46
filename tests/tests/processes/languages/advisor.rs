//! The advisor in Python, a process beside the loop, and the controller that obeys it.

use std::process::Command;

use emulator::Outcome;
use scanloop_tests::System;

use super::tools::{EXECUTABLE, compile, examples, python};

/// The stretch that the advisor wants driven slowly, without its ends, and the speed there.
const SLOW_M: std::ops::Range<f64> = 2.4..3.9;
const SLOW_MPS: f64 = 0.3;

#[test]
fn a_controller_of_ones_own_obeys_the_advisor() {
    let Some(python) = python("the advisor in Python") else { return };
    let folder = examples("python").join("speed-limit");
    let system = System::new(EXECUTABLE);
    let file = folder.join("system.toml");
    let command = |name: &str, program: &str| {
        let words = [python.to_str().unwrap(), folder.join(program).to_str().unwrap()].map(str::to_owned);
        format!("process.{name}.command={words:?}")
    };
    let (advisor, controller) = (command("advisor", "advisor.py"), command("controller", "controller.py"));
    let arguments = ["free", "--system", file.to_str().unwrap(), "--set", "goal.x_m=6"];
    let report = system.lockstep(&[&arguments[..], &["--set", &advisor, "--set", &controller]].concat());
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    let advisor = &report.companions[0];
    assert_eq!((advisor.left_lockstep_at_scan, advisor.invalid), (None, 0));
    assert!(advisor.answered >= report.scans.published - 1, "{advisor:?}");
    assert!(report.digests.contains_key("limit"));
    let speeds = report.trajectory.windows(2).map(|pair| {
        let [[t0, x0, ..], [t1, x1, ..]] = [pair[0], pair[1]];
        (x0, (x1 - x0) / (t1 - t0))
    });
    let (slow, fast): (Vec<_>, Vec<_>) = speeds.partition(|(x_m, _)| SLOW_M.contains(x_m));
    assert!(slow.len() > 20 && slow.iter().all(|(_, speed)| *speed < 1.1 * SLOW_MPS), "{slow:?}");
    assert!(fast.iter().any(|(_, speed)| *speed > 1.5 * SLOW_MPS), "{fast:?}");
}

#[test]
fn the_class_of_the_example_is_what_the_executable_prints() {
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

#[test]
fn a_companion_in_c_answers_every_sample() {
    let system = System::new(EXECUTABLE);
    let folder = system.folder();
    std::fs::copy(examples("python").join("speed-limit/limit.toml"), folder.join("limit.toml")).unwrap();
    let header = system.run(&["types", "--c", "--layout", "limit.toml"]);
    std::fs::write(folder.join("limit.h"), &header.stdout).unwrap();
    std::fs::copy(examples("c").join("scanloop_types.h"), folder.join("scanloop_types.h")).unwrap();
    std::fs::write(folder.join("advisor.c"), ADVISOR).unwrap();
    compile(&folder.join("advisor.c"), folder, &folder.join("advisor"));
    let built_in = include_str!("../../../../orchestrator/systems/default.toml");
    let text = format!(
        "{built_in}\n[[topic]]\nname = \"limit\"\nlayout = \"limit.toml\"\n[[process]]\nrole = \"companion\"\nname = \
         \"advisor\"\ncommand = [\"./advisor\"]\nreads = [\"pose\"]\nwrites = [\"limit\"]\n"
    );
    std::fs::write(folder.join("lab.toml"), text).unwrap();
    let report = system.lockstep(&["free", "--set", "goal.x_m=4", "--system", "lab.toml"]);
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    let advisor = &report.companions[0];
    assert!(
        advisor.answered >= report.scans.published - 1 && advisor.published == advisor.taken,
        "{advisor:?}"
    );
}
