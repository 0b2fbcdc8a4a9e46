//! A person takes over by a program in C, Python or Rust; and controllers and drivers to be copied obey a person.

use std::process::{Command, Stdio};
use std::time::Duration;

use runtime::{Person, RuntimeError};
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;

use super::robots::drivers;
use super::swaps::system_with;
use super::tools::{EXECUTABLE, MY_CONTROLLER, compile, examples, python};

/// Drives, tries to take over once more, pauses, drives, and hands back; prints the reason of each refusal.
const IN_C: &str = r#"
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <time.h>
#include "scanloop.h"

static int drive(scanloop_person *person, int count) {
    const struct timespec pause = {0, 50000000};
    while (count-- > 0) {
        if (scanloop_person_give(person, 0.4, 0.0) < 0) {
            return -1;
        }
        nanosleep(&pause, NULL);
    }
    return 0;
}

int main(int count, char **words) {
    scanloop_person *person, *other;
    const char *system_id = count > 1 ? words[1] : NULL;
    if (scanloop_person_take_over(system_id, &person) < 0 || drive(person, 40) < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return 2;
    }
    if (scanloop_person_take_over(system_id, &other) != SCANLOOP_REFUSED || other != NULL) {
        return 3;
    }
    puts(scanloop_last_error());
    if (scanloop_person_pause(person) < 0 || drive(person, 20) < 0 || scanloop_person_resume(person) < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return 4;
    }
    if (scanloop_person_give(person, 0.4, 0.0) >= 0) {
        return 5;
    }
    puts(scanloop_last_error());
    scanloop_person_close(person);
    scanloop_person_close(NULL);
    return 0;
}
"#;

/// The same in Python.
const IN_PYTHON: &str = r#"
import sys, time
from person import Person, Refused

def drive(person, count):
    for _ in range(count):
        person.give(0.4, 0)
        time.sleep(0.05)

with Person(sys.argv[1]) as person:
    drive(person, 40)
    try:
        Person(sys.argv[1])
    except Refused as refused:
        print(refused)
    person.pause()
    drive(person, 20)
    person.resume()
    try:
        person.give(0.4, 0)
    except Refused as refused:
        print(refused)
"#;

/// The same in Rust.
fn in_rust(system: &TestSystem) -> Result<String, RuntimeError> {
    let take_over = || Person::take_over_by(EXECUTABLE, Some(system.id()));
    let mut person = take_over()?;
    let drive = |person: &mut Person, count| {
        (0..count).try_for_each(|_| {
            person.give(0.4, 0.0)?;
            std::thread::park_timeout(Duration::from_millis(50));
            Ok::<_, RuntimeError>(())
        })
    };
    drive(&mut person, 40)?;
    let refusal = take_over().err().map(|error| error.to_string());
    person.pause()?;
    drive(&mut person, 20)?;
    person.resume()?;
    Ok(refusal.unwrap_or_default())
}

/// What a program prints, which is given the id of the system.
fn printed(system: &TestSystem, mut program: Command) -> String {
    let output = program.arg(system.id()).env("SCANLOOP", EXECUTABLE).stdin(Stdio::null()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("this person "), "after it has handed back: {text}");
    text
}

/// A drive that is paused, driven by hand by a program, and driven to its goal by the controller.
fn a_program_drives(program: impl Fn(&TestSystem) -> String) {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free"]);
        assert_eq!(system.run(&["pause"]).status.code(), Some(0));
        system.await_rest();
        let text = program(&system);
        assert!(text.contains("another person drives"), "{text}");
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        let changes = report.driver_changes.iter().filter(|change| change.driven_by != "nobody");
        let drivers: Vec<&str> = changes.map(|change| change.driven_by.as_str()).collect();
        assert_eq!(drivers, ["person", "person", "controller"]);
        let x_m = |change: usize| {
            let scan = report.driver_changes[change].from_scan as usize;
            report.trajectory[scan - 1][1]
        };
        let driven_m = x_m(2) - x_m(1);
        assert!(driven_m > 0.4, "{driven_m} m by hand in 2 s");
        system.assert_nothing_left();
    });
}

#[test]
fn a_program_in_rust_drives_by_hand() {
    a_program_drives(|system| in_rust(system).unwrap());
}

#[test]
fn a_program_in_c_drives_by_hand() {
    a_program_drives(|system| {
        let (source, program) = (system.folder().join("person.c"), system.folder().join("person"));
        std::fs::write(&source, IN_C).unwrap();
        compile(&source, &examples("c"), &program);
        printed(system, Command::new(program))
    });
}

#[test]
fn a_program_in_python_drives_by_hand() {
    a_program_drives(|system| {
        let mut program = Command::new("python3");
        program.args(["-B", "-c", IN_PYTHON]).env("PYTHONPATH", examples("python"));
        printed(system, program)
    });
}

#[test]
fn a_program_is_told_why_it_may_not_drive() {
    let system = TestSystem::new(EXECUTABLE);
    let refused = Person::take_over_by(EXECUTABLE, Some(system.id())).unwrap_err().to_string();
    assert_eq!(refused, format!("system `{}` is not running", system.id()));
    let refused = Person::take_over_by("/nonexistent/scanloop", None).unwrap_err().to_string();
    assert!(refused.starts_with("start `scanloop teleop`: "), "{refused}");
}

/// The words of a controller in Python.
pub(super) fn controller(python: &std::path::Path, name: &str) -> Vec<String> {
    let script = examples("python").join(name);
    [python.to_str().unwrap(), "-B", script.to_str().unwrap()].map(str::to_owned).to_vec()
}

/// A drive with this program in a role, paused, with the robot at rest.
fn paused(system: &mut TestSystem, role: &str, command: &[String]) {
    let words: Vec<&str> = command.iter().map(String::as_str).collect();
    let file = system_with(system.folder(), role, &words);
    system.start(&["free", "--system", &file, "--set", "goal.x_m=21", "--set", "rate_hz=5"]);
    system.wait_until("the robot drives", |system| system.newest("actuation")["kind"] == "drive");
    assert_eq!(system.run(&["pause"]).status.code(), Some(0));
    system.wait_until("the robot rests", |system| {
        let (actuation, odometry) = (system.newest("actuation"), system.newest("odometry"));
        actuation["reason"] == "paused"
            && odometry["speed_mps"].as_f64().is_some_and(|speed| speed.abs() < 1e-2)
    });
}

#[test]
fn controllers_and_drivers_to_be_copied_obey_a_person() {
    repeat_when_late(|| {
        let place = TestSystem::new(EXECUTABLE);
        let mut programs = vec![("controller", vec![MY_CONTROLLER.to_owned()])];
        programs.extend(
            drivers(&place, "a person and drivers").into_iter().map(|(_, command, _)| ("robot", command)),
        );
        if let Some(python) = python("a person and a controller in Python") {
            programs.push(("controller", controller(&python, "pure_pursuit.py")));
        }
        for (role, command) in programs {
            let mut system = TestSystem::new(EXECUTABLE);
            paused(&mut system, role, &command);
            let x_m = |system: &TestSystem| system.newest("pose")["x_m"].as_f64().unwrap();
            let before_m = x_m(&system);
            let output = system.run(&["teleop", "--velocity=0.5", "--for=2.5"]);
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(0), "{command:?}: {text}");
            let driven_m = x_m(&system) - before_m;
            assert!(driven_m > 0.5, "{command:?}: {driven_m} m by hand");
            assert_eq!(system.run(&["resume"]).status.code(), Some(0));
            system.wait_until("it drives on", |system| system.newest("actuation")["kind"] == "drive");
            assert_eq!(system.run(&["stop"]).status.code(), Some(0));
            system.wait();
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_controller_that_knows_of_no_person_is_named_to_the_person() {
    repeat_when_late(|| {
        let Some(python) = python("a controller that knows of no person") else { return };
        let mut system = TestSystem::new(EXECUTABLE);
        paused(&mut system, "controller", &controller(&python, "casadi_controller.py"));
        let output = system.run(&["teleop", "--velocity=0.5", "--for=30"]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains("the controller of this system does not drive by hand"), "{text}");
        assert_eq!(system.newest("actuation")["reason"], "paused");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}
