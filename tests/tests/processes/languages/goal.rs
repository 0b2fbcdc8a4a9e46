//! A goal is set by a program in C, Python or Rust, and controllers to be copied drive to it.

use std::process::Command;

use runtime::GoalOrder;
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;

use super::person::controller;
use super::swaps::system_with;
use super::tools::{EXECUTABLE, MY_CONTROLLER, compile, examples, python};

/// Sets a goal and prints its first scan, then the reason why another is not taken.
const GOAL_IN_C: &str = r#"
#include <inttypes.h>
#include <stdio.h>
#include "scanloop.h"

int main(int count, char **words) {
    const char *system_id = count > 1 ? words[1] : NULL;
    uint64_t from_scan = 0;
    if (scanloop_set_goal(system_id, 6.0, 0.3, NULL, &from_scan) < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return 2;
    }
    printf("%" PRIu64 "\n", from_scan);
    const double yaw_rad = 0.0;
    if (scanloop_set_goal(system_id, -6.0, 0.3, &yaw_rad, NULL) != SCANLOOP_REFUSED) {
        return 3;
    }
    puts(scanloop_last_error());
    return 0;
}
"#;

/// The same in Python.
const GOAL_IN_PYTHON: &str = r#"
import sys
from goal import Refused, set_goal

print(set_goal(6.0, 0.3, system_id=sys.argv[1]))
try:
    set_goal(-6.0, 0.3, 0.0, sys.argv[1])
except Refused as refused:
    print(refused)
"#;

/// A drive with a controller whose goal a program sets: `program` is given the system and returns what it prints.
fn a_program_sets_the_goal(controller: &[String], program: impl Fn(&TestSystem) -> String) {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let words: Vec<&str> = controller.iter().map(String::as_str).collect();
        let file = system_with(system.folder(), "controller", &words);
        system.start(&["free", "--system", &file, "--set", "goal.x_m=4", "--set", "rate_hz=5"]);
        system.wait_until("it drives", |system| system.status().is_some_and(|status| status.scan > 8));
        let text = program(&system);
        let (first, refusal) = text.split_once('\n').unwrap();
        assert!(refusal.contains("goal"), "{text}");
        assert_eq!(system.wait().code(), Some(0), "{controller:?}: {}", system.stderr());
        let report = system.report();
        assert_eq!(report.goal_changes[0].from_scan.to_string(), first);
        let [.., [_, x_m, y_m, _]] = report.trajectory[..] else { panic!("{report:?}") };
        assert!((x_m - 6.0).hypot(y_m - 0.3) < 0.1, "{controller:?}: ({x_m}, {y_m})");
        system.assert_nothing_left();
    });
}

#[test]
fn programs_set_goals_and_controllers_to_be_copied_drive_to_them() {
    a_program_sets_the_goal(&[MY_CONTROLLER.to_owned()], |system| {
        let give = |x_m, yaw_rad| GoalOrder::give_by(EXECUTABLE, Some(system.id()), [x_m, 0.3], yaw_rad);
        let first = give(6.0, None).and_then(GoalOrder::wait).unwrap();
        format!("{first}\n{}\n", give(-6.0, Some(0.0)).and_then(GoalOrder::wait).unwrap_err())
    });
    let printed = |system: &TestSystem, mut program: Command| {
        let output = program.arg(system.id()).env("SCANLOOP", EXECUTABLE).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let Some(python) = python("goals and controllers in Python") else { return };
    a_program_sets_the_goal(&controller(&python, "pure_pursuit.py"), |system| {
        let (source, program) = (system.folder().join("goal.c"), system.folder().join("goal"));
        std::fs::write(&source, GOAL_IN_C).unwrap();
        compile(&source, &examples("c"), &program);
        printed(system, Command::new(program))
    });
    a_program_sets_the_goal(&controller(&python, "casadi_controller.py"), |system| {
        let mut program = Command::new("python3");
        program.args(["-B", "-c", GOAL_IN_PYTHON]).env("PYTHONPATH", examples("python"));
        printed(system, program)
    });
}
