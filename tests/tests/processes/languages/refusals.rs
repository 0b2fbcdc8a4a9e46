//! A process built against another layout does not join, and names the field that differs.

use scanloop_tests::machine::repeat_when_late;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use handover::swap::{Certificate, SwapOutcome};
use scanloop_tests::{SHORT_FREE, TestSystem};
use shared_types::{LayoutRow, Layouts, Role, TOPICS, difference};

use super::tools::{DEAD_RECKONING, EXECUTABLE, MY_CONTROLLER, compile, examples, python};

/// A program that joins in the role given by its number and does nothing more.
const JOINS: &str = r#"
#include <stdio.h>
#include <stdlib.h>
#include "scanloop.h"

int main(int count, char **words) {
    scanloop_process *process;
    int result = scanloop_open(count > 1 ? atoi(words[1]) : 0, SCANLOOP_LAYOUTS, &process);
    fprintf(stderr, "%d %s\n", result, scanloop_last_error());
    scanloop_close(process);
    return result == SCANLOOP_OTHER_LAYOUT ? 2 : 0;
}
"#;

/// Another version of the samples: changes in the generated header, and the message of a process of that role.
struct Version {
    role: Role,
    /// Texts that occur once, and their replacements.
    changes: &'static [(&'static str, &'static str)],
    message: &'static str,
}

const VERSIONS: [Version; 9] = [
    Version {
        role: Role::Obstacles,
        changes: &[("uint32_t ranges_mm[2048];", "uint32_t ranges_mm[2050];")],
        message: "topic scan: field ranges_mm has 2050 elements in this process, 2048 in the system",
    },
    Version {
        role: Role::Estimator,
        changes: &[("double dx_m;", "double step_m;"), ("\"dx_m\", dx_m", "\"step_m\", step_m")],
        message: "topic odometry: field dx_m is called step_m in this process",
    },
    Version {
        role: Role::Estimator,
        changes: &[("double nis;", "uint64_t nis;")],
        message: "topic pose: field nis is of type u64 in this process, f64 in the system",
    },
    Version {
        role: Role::Obstacles,
        changes: &[
            ("double unseen_s;", "double belief; double unseen_s;"),
            (
                "SCANLOOP_VALUE(\"obstacles\", scanloop_obstacles, \"items.unseen_s\"",
                "SCANLOOP_VALUE(\"obstacles\", scanloop_obstacles, \"items.belief\", items[0].belief),\n    \
                 SCANLOOP_VALUE(\"obstacles\", scanloop_obstacles, \"items.unseen_s\"",
            ),
        ],
        message: "topic obstacles: field items.belief is not in the samples of the system",
    },
    Version {
        role: Role::Controller,
        changes: &[("int32_t side;", "uint32_t side;")],
        message: "topic command: field side is of type u32 in this process, i32 in the system",
    },
    Version {
        role: Role::Actuator,
        changes: &[
            ("uint32_t answers;", ""),
            ("    SCANLOOP_VALUE(\"actuation\", scanloop_actuation, \"answers\", answers),\n", ""),
        ],
        message: "topic actuation: field answers is missing in this process",
    },
    Version {
        role: Role::Actuator,
        changes: &[("uint32_t state; /* State that", "uint64_t state; /* State that")],
        message: "topic heartbeat: field state is of type u64 in this process, u32 in the system",
    },
    Version {
        role: Role::Controller,
        changes: &[
            ("uint32_t incarnation; /* The incarnation whose", "uint32_t later; /* The incarnation whose"),
            ("uint32_t previous;", "uint32_t incarnation;"),
            ("uint32_t later;", "uint32_t previous;"),
        ],
        message: "topic directive: field authority.incarnation begins at byte 324 in this process, at 320 in the system",
    },
    Version {
        role: Role::Estimator,
        changes: &[("uint8_t bytes[12800];", "uint8_t bytes[4096];")],
        message: "topic checkpoint: field bytes has 4096 elements in this process, 12800 in the system",
    },
];

impl Version {
    /// The header as the generator of that version would have written it, but for the assertions.
    fn header(&self, text: &str) -> String {
        let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("_Static_assert")).collect();
        self.changes.iter().fold(lines.join("\n") + "\n", |header, (old, new)| {
            assert_eq!(header.matches(old).count(), 1, "{old}");
            header.replace(old, new)
        })
    }
}

fn refused(system: &TestSystem, arguments: &[&str], message: &str) {
    let output = system.run(&[&["swap", "--json"], arguments].concat());
    let certificate: Certificate = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(certificate.outcome, SwapOutcome::Refused, "{certificate:?}");
    assert!(certificate.reason.starts_with("the new process ended: exit code 2"), "{}", certificate.reason);
    assert!(certificate.reason.contains(message), "{}", certificate.reason);
    assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (0, 0));
}

#[test]
fn a_c_program_of_another_version_is_refused_with_the_field_in_the_certificate() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let header = std::fs::read_to_string(examples("c").join("scanloop_types.h")).unwrap();
        let source = system.folder().join("joins.c");
        std::fs::write(&source, JOINS).unwrap();
        let programs: Vec<_> = VERSIONS
            .iter()
            .enumerate()
            .map(|(index, version)| {
                let folder = system.folder().join(index.to_string());
                std::fs::create_dir(&folder).unwrap();
                std::fs::write(folder.join("scanloop_types.h"), version.header(&header)).unwrap();
                compile(&source, &folder, &folder.join("joins"));
                folder.join("joins")
            })
            .collect();
        system.start(&SHORT_FREE);
        for (version, program) in VERSIONS.iter().zip(&programs) {
            refused(
                &system,
                &[version.role.name(), "--", program.to_str().unwrap(), &version.role.wire().to_string()],
                version.message,
            );
        }
        assert_eq!(system.wait().code(), Some(0), "the drive was disturbed: {}", system.stderr());
        system.assert_nothing_left();
    });
}

#[test]
fn a_python_program_of_another_version_is_refused_with_the_field_in_the_certificate() {
    repeat_when_late(|| {
        let Some(python) = python("a_python_program_of_another_version_is_refused") else { return };
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_FREE);
        for (index, (old, new, message)) in [
            (
                "(\"predicted_x_m\", ctypes.c_double)",
                "(\"x_ahead_m\", ctypes.c_double)",
                "topic pose: field predicted_x_m is called x_ahead_m in this process",
            ),
            (
                "(\"scan_id\", ctypes.c_uint64)",
                "(\"scan_id\", ctypes.c_uint32)",
                "topic pose: field header.scan_id is of type u32 in this process, u64 in the system",
            ),
            (
                "(\"plan\", PlanNode * 25)",
                "(\"plan\", PlanNode * 24)",
                "topic command: field plan has 24 elements in this process, 25 in the system",
            ),
            (
                "scanloop.Obstacles.v3",
                "scanloop.Obstacles.v4",
                "topic obstacles: the sample is of type scanloop.Obstacles.v4",
            ),
        ]
        .into_iter()
        .enumerate()
        {
            let folder = system.folder().join(format!("version-{index}"));
            copy(&examples("python"), &folder);
            let types = std::fs::read_to_string(folder.join("scanloop_types.py")).unwrap();
            assert!(types.contains(old), "{old}");
            std::fs::write(folder.join("scanloop_types.py"), types.replace(old, new)).unwrap();
            let program = folder.join("pure_pursuit.py");
            let command = [python.to_str().unwrap(), "-B", program.to_str().unwrap()];
            refused(&system, &[&["controller", "--"][..], &command].concat(), message);
        }
        assert_eq!(system.wait().code(), Some(0), "the drive was disturbed: {}", system.stderr());
        system.assert_nothing_left();
    });
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten().filter(|entry| entry.path().is_file()) {
        std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

#[test]
fn a_program_that_is_started_by_hand_says_what_starts_it() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (source, program) = (system.folder().join("joins.c"), system.folder().join("joins"));
        std::fs::write(&source, JOINS).unwrap();
        compile(&source, &examples("c"), &program);
        let mut commands: Vec<_> = [DEAD_RECKONING, MY_CONTROLLER].map(Command::new).into();
        if let Some(python) = python("a_program_that_is_started_by_hand_says_what_starts_it in Python") {
            let mut command = Command::new(python);
            command.arg("-B").arg(examples("python").join("pure_pursuit.py"));
            commands.push(command);
        }
        let end_by_hand = |command: &mut Command| {
            let output =
                command.env_remove(runtime::SYSTEM_ID_VARIABLE).stdin(Stdio::null()).output().unwrap();
            let printed = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(printed.contains("processes are started by `scanloop run`"), "{printed}");
            output.status.code()
        };
        for command in &mut commands {
            assert_eq!(end_by_hand(command), Some(2), "{command:?}");
        }
        // This program has an exit code of its own.
        end_by_hand(Command::new(program).arg("2"));
    });
}

const SCRIPT: &str = r#"
import scanloop
theirs = scanloop.read_layouts(open("theirs.txt").read())
topics = list(dict.fromkeys(row[0] for row in theirs))
for table in open("mine.txt").read().split("\n\n"):
    print(scanloop.difference(scanloop.read_layouts(table), theirs, topics))
assert scanloop.types.layouts() == theirs
"#;

/// All tables in which one row differs.
fn mutations() -> Vec<Layouts> {
    let theirs = Layouts::built_in();
    let mut found = vec![theirs.clone()];
    for index in 0..theirs.rows.len() {
        let mut change = |act: &dyn Fn(&mut Vec<LayoutRow>)| {
            let mut mine = theirs.clone();
            act(&mut mine.rows);
            found.push(mine);
        };
        change(&|rows| rows[index].field += "_new");
        change(&|rows| "i32".clone_into(&mut rows[index].kind));
        change(&|rows| "Other".clone_into(&mut rows[index].kind));
        change(&|rows| rows[index].count += 1);
        change(&|rows| rows[index].size += 8);
        change(&|rows| rows[index].offset += 4);
        change(&|rows| drop(rows.remove(index)));
        change(&|rows| rows.insert(index, LayoutRow { field: "added".to_owned(), ..rows[index].clone() }));
        if index + 1 < theirs.rows.len() {
            change(&|rows| rows.swap(index, index + 1));
        }
    }
    found
}

#[test]
fn python_describes_a_difference_of_layouts_like_rust() {
    repeat_when_late(|| {
        let Some(python) = python("python_describes_a_difference_of_layouts_like_rust") else { return };
        let system = TestSystem::new(EXECUTABLE);
        let theirs = Layouts::built_in();
        let (mut tables, mut expected) = (Vec::new(), String::new());
        for mine in mutations() {
            tables.push(mine.to_string().trim_end().to_owned());
            let found = difference(&mine, &theirs, TOPICS);
            let _ = writeln!(expected, "{}", found.map_or("None".to_owned(), |found| found.to_string()));
        }
        std::fs::write(system.folder().join("theirs.txt"), theirs.to_string()).unwrap();
        std::fs::write(system.folder().join("mine.txt"), tables.join("\n\n")).unwrap();
        let output = Command::new(python)
            .args(["-B", "-c", SCRIPT])
            .env("PYTHONPATH", examples("python"))
            .current_dir(system.folder())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let printed = String::from_utf8(output.stdout).unwrap();
        for (theirs, mine) in printed.lines().zip(expected.lines()) {
            assert_eq!(theirs, mine);
        }
        assert_eq!(printed.lines().count(), expected.lines().count());
    });
}
