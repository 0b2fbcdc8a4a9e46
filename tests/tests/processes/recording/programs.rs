//! Recorded drives with programs in Python and C: their journals, and their replay by the command that was recorded.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use recording::Recording;
use rustix::process::Signal;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{SHORT_CORRIDOR, TestSystem};
use serde_json::Value;
use shared_types::{
    Command, Header, Journal, JournalKind, Obstacles, Pose, Role, Sample, Scan, StageStamps, Topic,
};

use super::{EXECUTABLE, recorded_in, replayed, text};
use crate::languages::swaps::system_with;
use crate::languages::tools::{compile, examples, python};

/// At 5 Hz, so that an interpreter on a busy machine keeps the limit of half a period.
const SLOW: [&str; 2] = ["--set", "rate_hz=5"];

fn pure_pursuit(python: &Path) -> Vec<String> {
    let program = examples("python").join("pure_pursuit.py");
    [text(python), "-B", text(&program)].map(str::to_owned).to_vec()
}

fn c_obstacles(system: &TestSystem) -> Vec<String> {
    let program = system.folder().join("obstacles");
    compile(&examples("c").join("obstacles.c"), &examples("c"), &program);
    vec![text(&program).to_owned()]
}

fn system_file(system: &TestSystem, role: Role, command: &[String]) -> String {
    let words: Vec<&str> = command.iter().map(String::as_str).collect();
    system_with(system.folder(), role.name(), &words)
}

/// A recorded drive in real time, whose process of the role is killed once.
fn recorded_with_a_kill(system: &mut TestSystem, role: Role, arguments: &[&str]) -> PathBuf {
    system.start(&[arguments, &["--record"]].concat());
    system.wait_until("two seconds are driven", |system| {
        system.status().is_some_and(|status| status.scan > 12)
    });
    system.signal(system.pid(role), Signal::KILL);
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let recording = system.report().recording.expect("a recording");
    assert_eq!(recording.lost, 0, "{recording:?}");
    recording.file
}

/// A sample: topic, incarnation, sequence number.
type Number = (Topic, u32, u64);

/// What a recording tells about one role.
#[derive(Default)]
struct Told {
    /// The inputs of the role by their topic and the stamps of their writer, which the outputs carry too.
    inputs: BTreeMap<(Topic, [u64; 4]), Number>,
    outputs: Vec<Header>,
    /// By incarnation and sequence number.
    journals: BTreeMap<(u32, u64), Journal>,
}

impl Told {
    fn of<A: Sample, B: Sample, O: Sample>(file: &Path, role: Role) -> Self {
        let mut told = Self::default();
        let read = Recording::open(file).expect("a recording").samples(|_, sample| {
            let header = *(sample.topic.sample_type().header)(sample.bytes);
            let number = (sample.topic, header.incarnation, header.sequence);
            match sample.topic {
                topic if topic == A::TOPIC || topic == B::TOPIC => {
                    _ = told.inputs.insert((topic, stamps(&header, topic)), number);
                }
                topic if topic == O::TOPIC => told.outputs.push(header),
                Topic::Journal => {
                    let journal: &Journal = bytemuck::from_bytes(sample.bytes);
                    if journal.role == role.wire() {
                        told.journals.insert((header.incarnation, header.sequence), *journal);
                    }
                }
                _ => {}
            }
            Ok(())
        });
        read.expect("a whole recording");
        told
    }

    /// Asserts that each output has one journal, which names exactly the two inputs that it was made from, and that each
    /// process but the first continues from a state of one before it. Returns how many processes there were.
    fn assert_whole(&self, topics: [Topic; 2]) -> usize {
        let mut processes: BTreeMap<u32, u64> = BTreeMap::new();
        for output in &self.outputs {
            let journals = processes.entry(output.incarnation).or_default();
            let is_first = *journals == 0;
            let (mut taken, mut saved, mut resumed) = (Vec::new(), 0, Vec::new());
            loop {
                *journals += 1;
                let journal = self.journals.get(&(output.incarnation, *journals));
                let journal =
                    journal.unwrap_or_else(|| panic!("journal {journals} of scan {}", output.scan_id));
                for entry in journal.used() {
                    match JournalKind::try_from(u32::from(entry.kind)).expect("a kind") {
                        JournalKind::Taken => {
                            let topic = Topic::ALL[usize::from(entry.topic)];
                            taken.push((topic, entry.incarnation, entry.value));
                        }
                        JournalKind::Saved => saved += 1,
                        JournalKind::Resumed => resumed.push(entry.incarnation),
                        kind => panic!("{kind:?}"),
                    }
                }
                if journal.output > 0 {
                    assert_eq!((journal.output, journal.header.scan_id), (output.sequence, output.scan_id));
                    break;
                }
            }
            let expected = topics.map(|topic| self.inputs[&(topic, stamps(output, topic))]);
            assert_eq!(taken, expected, "scan {}", output.scan_id);
            assert_eq!(
                saved,
                u32::from(!is_first),
                "the state behind the output before scan {}",
                output.scan_id
            );
            let continues = is_first && processes.len() > 1;
            assert_eq!(resumed.len(), usize::from(continues), "scan {}", output.scan_id);
            assert!(resumed.iter().all(|incarnation| *incarnation < output.incarnation), "{resumed:?}");
        }
        processes.len()
    }
}

/// The stamps of the role that writes a topic, in a sample of it or in one that was made from it.
fn stamps(header: &Header, topic: Topic) -> [u64; 4] {
    let StageStamps { woken_ns, taken_ns, computed_ns, published_ns } =
        *header.stage(topic.writer().expect("a topic of the loop"));
    [woken_ns, taken_ns, computed_ns, published_ns]
}

/// The only process that a replay names as not compared.
fn left_out(report: &Value) -> &Value {
    let left_out = report["not_compared"].as_array().expect("a list");
    assert_eq!(left_out.len(), 1, "{report}");
    &left_out[0]
}

#[test]
fn each_output_of_a_controller_in_python_has_a_journal_of_what_it_took() {
    repeat_when_late(|| {
        let Some(python) = python("each_output_of_a_controller_in_python_has_a_journal") else { return };
        let mut system = TestSystem::new(EXECUTABLE);
        let file = system_file(&system, Role::Controller, &pure_pursuit(&python));
        let arguments = [&["free", "--set", "goal.x_m=6", "--system", &file], &SLOW[..]].concat();
        let file = recorded_with_a_kill(&mut system, Role::Controller, &arguments);
        let told = Told::of::<Pose, Obstacles, Command>(&file, Role::Controller);
        assert_eq!(told.assert_whole([Topic::Pose, Topic::Obstacles]), 2);
        assert!(told.outputs.len() > 20, "{}", told.outputs.len());
        // The inputs are those of the journals, so it does not matter that it was in real time.
        let with = format!("controller={}", pure_pursuit(&python).join(" "));
        let (same, code) = replayed(&system, &file, &["--with", &with]);
        assert_eq!((code, &same["identical"], &same["skipped"]), (0, &same["compared"], &0.into()), "{same}");
        system.assert_nothing_left();
    });
}

#[test]
fn each_output_of_obstacles_in_c_has_a_journal_of_what_it_took() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let command = c_obstacles(&system);
        let file = system_file(&system, Role::Obstacles, &command);
        let arguments = [&SHORT_CORRIDOR[..], &["--system", &file]].concat();
        let file = recorded_with_a_kill(&mut system, Role::Obstacles, &arguments);
        let told = Told::of::<Scan, Pose, Obstacles>(&file, Role::Obstacles);
        assert_eq!(told.assert_whole([Topic::Scan, Topic::Pose]), 2);
        assert!(told.outputs.len() > 60, "{}", told.outputs.len());
        system.assert_nothing_left();
    });
}

#[test]
fn programs_in_c_and_python_are_replayed_to_the_bit_by_the_option_that_the_replay_names() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let mut programs = vec![(Role::Obstacles, c_obstacles(&system), &[][..])];
        if let Some(python) = python("programs_in_c_and_python_are_replayed_to_the_bit, the controller") {
            programs.push((Role::Controller, pure_pursuit(&python), &SLOW[..]));
        }
        for (role, command, slow) in programs {
            let file = system_file(&system, role, &command);
            let file = recorded_in(&system, &[&SHORT_CORRIDOR[..], &["--system", &file], slow].concat());
            let (whole, code) = replayed(&system, &file, &[]);
            assert_eq!((code, &whole["identical"]), (0, &whole["compared"]), "{whole}");
            let program = left_out(&whole);
            let with = format!("{role}={}", command.join(" "));
            assert_eq!((&program["role"], &program["has_journals"]), (&role.name().into(), &true.into()));
            assert_eq!(program["with"], format!("--with '{with}'"), "{program}");
            let (same, code) = replayed(&system, &file, &["--with", &with]);
            assert_eq!(
                (code, &same["identical"], &same["skipped"]),
                (0, &same["compared"], &0.into()),
                "{same}"
            );
            assert_eq!(same["compared"], whole["skipped"], "{same}");
            let (part, code) = replayed(&system, &file, &["--with", &with, "--from", "20", "--to", "30"]);
            assert_eq!((code, &part["identical"], &part["compared"]), (0, &11.into(), &11.into()), "{part}");
            // Alone, nothing of it can be compared.
            let alone = system.run(&["replay", text(&file), "--stage", role.name()]);
            let message = String::from_utf8_lossy(&alone.stderr).into_owned();
            assert!(alone.status.code() == Some(2) && message.contains("nothing was compared"), "{message}");
            std::fs::remove_file(&file).unwrap();
        }
        system.assert_nothing_left();
    });
}

#[test]
fn a_program_in_place_of_a_stage_with_two_processes_gets_the_inputs_of_both() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let command = c_obstacles(&system);
        system.start(&[&SHORT_CORRIDOR[..], &["--record"]].concat());
        system.wait_until("a second is driven", |system| {
            system.status().is_some_and(|status| status.scan > 10)
        });
        let restarted = system.run(&["restart", "estimator"]);
        assert_eq!(restarted.status.code(), Some(0), "{}", String::from_utf8_lossy(&restarted.stderr));
        // In shadow of the detector in charge, with states of another kind.
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let shadow = [&["shadow", "obstacles", "--for", "2s", "--"], &words[..]].concat();
        let shadowed = system.run(&shadow);
        assert!(
            matches!(shadowed.status.code(), Some(0 | 1)),
            "{}",
            String::from_utf8_lossy(&shadowed.stderr)
        );
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let file = system.report().recording.expect("a recording").file;
        let scans = replayed(&system, &file, &["--stage", "obstacles"]).0["scans"].as_u64().expect("a count");
        for (with, from) in [("obstacles=ellipses", 1), ("obstacles=ellipses", 60), ("estimator=ekf", 1)] {
            let (same, code) = replayed(&system, &file, &["--with", with, "--from", &from.to_string()]);
            assert_eq!((code, &same["beyond"], &same["skipped"]), (0, &0.into(), &0.into()), "{same}");
            assert_eq!(same["compared"].as_u64(), Some(scans + 1 - from), "{with} {from}: {same}");
        }
        system.assert_nothing_left();
    });
}
