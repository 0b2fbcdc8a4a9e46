//! Recorded drives with faults, swaps and restarts at random moments, and the replay of each.

use std::fmt;
use std::ops::AddAssign;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use runtime::wait_for;
use rustix::process::Signal;
use serde_json::Value;
use shared_types::Role;

use crate::swaps::BUILT_IN;
use crate::{SHORT_CORRIDOR, TestSystem};

/// What happens in a recorded drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordingKind {
    /// Nothing, in lock-step.
    Lockstep,
    /// A course with walls, in lock-step.
    Walls,
    /// Salt, dropouts and missing scans, in lock-step.
    ScannerInLockstep,
    /// A process is killed.
    Kill,
    /// A process is stopped until it counts as hung.
    Hang,
    /// A process is stopped for a moment, so that samples are late or lost.
    Late,
    /// A process is swapped.
    Swap,
    /// A process is restarted.
    Restart,
    /// Settings change: the new process takes over, or is refused.
    Set,
    /// Scanner faults, and a process is killed.
    ScannerAndKill,
    /// A worn robot on a noisy course.
    Worn,
    /// At 200 Hz, where inputs often come while a process works.
    Fast,
}

/// All kinds.
pub const KINDS: [RecordingKind; 12] = [
    RecordingKind::Lockstep,
    RecordingKind::Kill,
    RecordingKind::Swap,
    RecordingKind::Hang,
    RecordingKind::Set,
    RecordingKind::Restart,
    RecordingKind::Late,
    RecordingKind::ScannerAndKill,
    RecordingKind::Worn,
    RecordingKind::Walls,
    RecordingKind::ScannerInLockstep,
    RecordingKind::Fast,
];

/// Roles whose death does not end the run.
const RESTARTED: [Role; 4] = [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];
/// Changes of settings: the second drives otherwise and is refused.
const CHANGES: [&[&str]; 4] = [
    &["--tolerance", "1000", "controller.cruise_mps=0.9"],
    &["controller.cruise_mps=0.3"],
    &["estimator.recover_after=7"],
    &["actuator.recovery=3"],
];
/// Faults of the scanner that a drive survives.
const SCANNER: [&str; 6] =
    ["--set", "scanner.salt=0.005", "--set", "scanner.missing_every=40", "--set", "noise.dropout=0.1"];
/// A process that is stopped for so long misses one or two scans, and does not count as hung [ns].
const LATE_NS: u64 = 200_000_000;
/// The longest time after which something happens in a drive of nine seconds [ns].
const MAX_DELAY_NS: u64 = 4_000_000_000;

/// What replays have found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReplayTally {
    /// Recordings.
    pub recordings: u64,
    /// Of these, recordings without a difference.
    pub same: u64,
    /// Outputs of the stages.
    pub samples: u64,
    /// Outputs that were recomputed.
    pub compared: u64,
    /// Outputs that are equal to the recorded ones.
    pub identical: u64,
    /// Outputs that could not be recomputed.
    pub skipped: u64,
    /// Samples that the recorder lost.
    pub lost: u64,
}

impl AddAssign for ReplayTally {
    fn add_assign(&mut self, other: Self) {
        self.recordings += other.recordings;
        self.same += other.same;
        self.samples += other.samples;
        self.compared += other.compared;
        self.identical += other.identical;
        self.skipped += other.skipped;
        self.lost += other.lost;
    }
}

impl fmt::Display for ReplayTally {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { recordings, same, samples, compared, identical, skipped, lost } = self;
        write!(
            formatter,
            "{recordings} recordings, {same} without a difference; {samples} outputs, {compared} compared, {identical} identical, {skipped} skipped; {lost} samples lost"
        )
    }
}

/// Drives and records one drive, and replays it; also what the replay printed.
///
/// # Panics
/// When the drive can't be recorded or the recording can't be read.
pub fn check(executable: &str, kind: RecordingKind, seed: u64) -> (ReplayTally, String) {
    let mut system = TestSystem::new(executable);
    let seed_text = seed.to_string();
    let own: &[&str] = match kind {
        RecordingKind::Walls => &["walls", "--duration", "15"],
        RecordingKind::Worn => {
            &["noisy", "--set", "robot.preset=worn", "--set", "goal.x_m=7", "--duration", "12"]
        }
        RecordingKind::Fast => &["endless", "--set", "rate_hz=200", "--duration", "9"],
        _ => &SHORT_CORRIDOR,
    };
    let faults: &[&str] = if matches!(kind, RecordingKind::ScannerInLockstep | RecordingKind::ScannerAndKill)
    {
        &SCANNER
    } else {
        &[]
    };
    let arguments = [own, faults, &["--seed", &seed_text, "--record"]].concat();
    let in_lockstep =
        matches!(kind, RecordingKind::Lockstep | RecordingKind::Walls | RecordingKind::ScannerInLockstep);
    let report = if in_lockstep {
        system.lockstep(&arguments)
    } else {
        system.start(&arguments);
        disturb(&system, kind, seed);
        system.wait();
        system.report()
    };
    let recording = report.recording.expect("a recording");
    let file = recording.file.to_str().expect("a readable path");
    let output = system.run(&["replay", file, "--json"]);
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{printed}"));
    let count = |key: &str| found[key].as_u64().expect("a count");
    let tally = ReplayTally {
        recordings: 1,
        same: u64::from(output.status.code() == Some(0)),
        samples: count("samples"),
        compared: count("compared"),
        identical: count("identical"),
        skipped: count("skipped"),
        lost: recording.lost,
    };
    (tally, printed)
}

/// Lets something happen at a random moment of a drive.
fn disturb(system: &TestSystem, kind: RecordingKind, seed: u64) {
    let mut dice = Pcg64::seed_from_u64(seed);
    wait_for(&[], dice.random_range(0..MAX_DELAY_NS));
    let role = RESTARTED[dice.random_range(0..RESTARTED.len())];
    match kind {
        RecordingKind::Kill | RecordingKind::ScannerAndKill => system.signal(system.pid(role), Signal::KILL),
        RecordingKind::Hang => system.signal(system.pid(role), Signal::STOP),
        RecordingKind::Late => {
            let pid = system.pid(role);
            system.signal(pid, Signal::STOP);
            wait_for(&[], LATE_NS);
            // On a busy machine it may count as hung, and be gone.
            let pid = rustix::process::Pid::from_raw(pid).expect("a process id");
            let _ = rustix::process::kill_process(pid, Signal::CONT);
        }
        RecordingKind::Swap => {
            let (role, implementation) = BUILT_IN[dice.random_range(0..BUILT_IN.len())];
            system.run(&["swap", role.name(), "--to", implementation, "--shadow-scans", "5"]);
        }
        RecordingKind::Set => {
            let change = CHANGES[dice.random_range(0..CHANGES.len())];
            system.run(&[&["set"], change].concat());
        }
        RecordingKind::Restart => _ = system.run(&["restart", role.name()]),
        _ => {}
    }
}
