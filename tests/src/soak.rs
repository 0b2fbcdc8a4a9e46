//! Swaps, kills and stops at random moments of a drive, and what must hold after each.
//!
//! A *fault* is one SIGKILL or SIGSTOP of one process, the orchestrator included. After it either scans are commanded
//! again, or the run has ended with the robot at rest. In every run the true wheels are blocked when they have received
//! nothing for three scans, and the robot touches nothing. After each run nothing is left, and the same system starts
//! anew. A seed decides what happens; the exact moments depend on the machine.

use std::ops::AddAssign;

use handover::swap::SwapOutcome;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use runtime::wait_for;
use rustix::process::Signal;
use shared_types::{Role, Truth};

use crate::audit::{Audit, audit};
use crate::swaps::{BUILT_IN, assert_every_scan_answered_once, assert_seamless, swap};
use crate::{TestSystem, TruthWatch};

/// A scan period in real time [ns].
const PERIOD_NS: u64 = 100_000_000;
/// Swaps in one run in lock-step, which is compared with a run without swaps.
const PER_RUN: usize = 10;
/// Faults in one run at most: more deaths of one role within a minute end it.
const FAULTS_PER_RUN: usize = 10;
/// Scans without a new actuation after which the wheels are blocked.
const BLIND_SCANS: u64 = 3;
/// Roles whose death does not end the run.
const RESTARTED: [Role; 4] = [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];

/// Largest change of a command around swaps, as a multiple of the largest one elsewhere: both are the largest of some hundred
/// changes of one drive.
const JUMP: f64 = 2.0;
/// A smaller change is none [rad, m/s].
const SAME: [f64; 2] = [0.0, 0.01];

/// What happened, and with which result.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tally {
    /// Runs that were started.
    pub runs: usize,
    /// Swaps in lock-step, all completed without a difference in any sample.
    pub lockstep_swaps: usize,
    /// Swaps in real time, all completed without a scan missed or answered twice.
    pub live_swaps: usize,
    /// Largest change of steering angle and velocity from scan to scan around these [rad, m/s].
    pub jump: [f64; 2],
    /// The same elsewhere in the same drives.
    pub normal: [f64; 2],
    /// Processes that were killed.
    pub kills: usize,
    /// Processes that were stopped.
    pub stops: usize,
    /// Faults after which scans were commanded again.
    pub went_on: usize,
    /// Faults that ended the run, with the robot at rest.
    pub came_to_rest: usize,
    /// Orchestrators that were killed or stopped while the robot drove on.
    pub alone: usize,
    /// Orchestrators that took over from one that was killed.
    pub adopted: usize,
    /// Samples of the truth that were checked.
    pub truths: usize,
}

impl Tally {
    /// All that was done to the system.
    pub fn events(&self) -> usize {
        self.lockstep_swaps + self.live_swaps + self.kills + self.stops
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.runs += other.runs;
        self.lockstep_swaps += other.lockstep_swaps;
        self.live_swaps += other.live_swaps;
        self.jump = larger(self.jump, other.jump);
        self.normal = larger(self.normal, other.normal);
        self.kills += other.kills;
        self.stops += other.stops;
        self.went_on += other.went_on;
        self.came_to_rest += other.came_to_rest;
        self.alone += other.alone;
        self.adopted += other.adopted;
        self.truths += other.truths;
    }
}

/// Swaps random roles in lock-step; every sample of every topic must be as in a run without swaps.
///
/// # Panics
/// When anything is otherwise.
pub fn swap_in_lockstep(executable: &str, count: usize, seed: u64) -> Tally {
    let mut dice = Pcg64::seed_from_u64(seed);
    let mut tally = Tally::default();
    let arguments = ["endless", "--duration", "300"];
    let undisturbed = TestSystem::new(executable).lockstep(&arguments);
    let mut system = TestSystem::new(executable);
    while tally.lockstep_swaps < count {
        system.start(&[&["--lockstep"], &arguments[..]].concat());
        tally.runs += 1;
        let mut certificates = Vec::new();
        for _ in 0..PER_RUN.min(count - tally.lockstep_swaps) {
            let (role, implementation) = BUILT_IN[dice.random_range(0..BUILT_IN.len())];
            let shadow = dice.random_range(1..20).to_string();
            let arguments = [role.name(), "--to", implementation, "--shadow-scans", &shadow];
            let certificate = swap(&system, &arguments);
            assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{certificate:?}");
            assert_seamless(&certificate);
            certificates.push(certificate);
        }
        tally.lockstep_swaps += certificates.len();
        assert_eq!(system.wait().code(), Some(1), "the time is over: {}", system.stderr());
        let report = system.report();
        assert_eq!(report.swaps, certificates);
        assert_eq!(report.digests, undisturbed.digests, "the bits of all samples: {certificates:?}");
        assert_every_scan_answered_once(&system);
        system.assert_nothing_left();
    }
    tally
}

/// Swaps random roles at random moments in real time, and checks each certificate against what was recorded.
///
/// # Panics
/// When anything is otherwise.
pub fn swap_live(executable: &str, count: usize, seed: u64) -> Tally {
    let mut dice = Pcg64::seed_from_u64(seed);
    let mut system = TestSystem::new(executable);
    system.start(&["endless", "--set", "timeout_s=36000"]);
    let mut tally = Tally { runs: 1, ..Tally::default() };
    while tally.live_swaps < count {
        let recorder = Audit::start(&system.domain());
        let mut certificates = Vec::new();
        for _ in 0..PER_RUN.min(count - tally.live_swaps) {
            let (role, implementation) = BUILT_IN[dice.random_range(0..BUILT_IN.len())];
            wait_for(&[], dice.random_range(0..PERIOD_NS));
            let scans = ["--shadow-scans", "5", "--standby-scans", "5"];
            let certificate = swap(&system, &[&[role.name(), "--to", implementation], &scans[..]].concat());
            assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{certificate:?}");
            assert_seamless(&certificate);
            certificates.push(certificate);
        }
        let recording = recorder.stop();
        tally.live_swaps += certificates.len();
        certificates
            .iter()
            .for_each(|certificate| audit(certificate, &recording).expect("a true certificate"));
        let changes: Vec<u64> =
            certificates.iter().filter_map(|certificate| certificate.first_scan_new).collect();
        tally.jump = larger(tally.jump, recording.jump(&changes));
        tally.normal = larger(tally.normal, recording.normal_change(&changes, 3));
    }
    // Where the commands between two swaps stay the same, the last digits of another process are no jump.
    let most = [0, 1].map(|index| (JUMP * tally.normal[index]).max(SAME[index]));
    let is_normal = tally.jump.iter().zip(most).all(|(jump, most)| *jump <= most);
    assert!(is_normal, "jumps {:?}, normal are {:?}", tally.jump, tally.normal);
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    system.wait();
    assert_every_scan_answered_once(&system);
    system.assert_nothing_left();
    tally
}

/// Kills and stops random processes at random moments.
///
/// # Panics
/// When the robot touches something, drives blind, neither drives on nor rests, or something is left.
pub fn faults(executable: &str, kills: usize, stops: usize, seed: u64) -> Tally {
    let mut dice = Pcg64::seed_from_u64(seed);
    let mut system = TestSystem::new(executable);
    let mut tally = Tally::default();
    while tally.kills + tally.stops < kills + stops {
        system.start(&["endless", "--set", "timeout_s=36000"]);
        tally.runs += 1;
        let watch = TruthWatch::new(&system);
        let mut drives = true;
        for _ in 0..FAULTS_PER_RUN.min(kills + stops - tally.kills - tally.stops) {
            let left = [kills - tally.kills, stops - tally.stops];
            let is_kill = dice.random_range(0..left[0] + left[1]) < left[0];
            wait_for(&[], dice.random_range(0..PERIOD_NS));
            drives = strike(&mut system, &watch, is_kill, &mut dice, &mut tally);
            if !drives {
                break;
            }
        }
        if drives {
            assert_eq!(system.run(&["stop"]).status.code(), Some(0), "{}", system.stderr());
        }
        let code = system.wait().code();
        assert_ne!(code, Some(3), "a collision: {}", system.stderr());
        tally.truths += check(&watch.all());
        drop(watch);
        system.assert_nothing_left();
    }
    tally
}

fn larger(one: [f64; 2], other: [f64; 2]) -> [f64; 2] {
    [one[0].max(other[0]), one[1].max(other[1])]
}

/// One fault, and what comes after it; false when it ended the run.
fn strike(
    system: &mut TestSystem,
    watch: &TruthWatch,
    is_kill: bool,
    dice: &mut Pcg64,
    tally: &mut Tally,
) -> bool {
    let signal = if is_kill { Signal::KILL } else { Signal::STOP };
    *(if is_kill { &mut tally.kills } else { &mut tally.stops }) += 1;
    match dice.random_range(0..8) {
        0 | 1 => {
            let lost = newest(system, watch);
            system.signal(system.orchestrator(), signal);
            let scans = dice.random_range(1..8);
            // It drives on alone, or rests when the orchestrator was about to start a process.
            system.wait_until("the robot drives on alone", |_| {
                watch.newest().is_some_and(|now| now.header.scan_id >= lost.header.scan_id + scans)
            });
            tally.alone += usize::from(newest(system, watch).blocked == 0);
            if is_kill {
                system.wait();
                system.adopt(&[]);
                tally.adopted += 1;
            } else {
                system.signal(system.orchestrator(), Signal::CONT);
            }
            tally.went_on += 1;
            true
        }
        // A run ends when its robot dies.
        2 if dice.random_range(0..4) == 0 => {
            system.signal(system.pid(Role::Robot), signal);
            system.wait_until("the run ends", has_ended);
            tally.came_to_rest += 1;
            false
        }
        number => {
            let role = RESTARTED[number % RESTARTED.len()];
            let before = newest(system, watch);
            let pid = system.pid(role);
            system.signal(pid, signal);
            system.wait_until("another one answers, or all comes to rest", |system| {
                has_ended(system) || drives_by_another(system, watch, role, pid, &before)
            });
            let drives = !has_ended(system);
            *(if drives { &mut tally.went_on } else { &mut tally.came_to_rest }) += 1;
            drives
        }
    }
}

fn newest(system: &TestSystem, watch: &TruthWatch) -> Truth {
    system.wait_until("a robot", |_| watch.newest().is_some());
    watch.newest().expect("a robot")
}

fn has_ended(system: &TestSystem) -> bool {
    system.find().is_none()
}

/// Whether the role is filled by another process and the robot drives by answers that are newer than the fault.
fn drives_by_another(system: &TestSystem, watch: &TruthWatch, role: Role, pid: i32, before: &Truth) -> bool {
    let is_new = system.status().is_some_and(|status| {
        let mut rows = status.processes.iter().filter(|process| process.role == role);
        rows.any(|process| process.pid != pid && process.pid != 0 && process.state.name() == "ready")
    });
    is_new
        && watch
            .newest()
            .is_some_and(|now| now.blocked == 0 && now.actuation_scan > before.header.scan_id + 2)
}

/// Checks all that was seen of one robot; returns how many samples that were.
fn check(truths: &[Truth]) -> usize {
    for truth in truths {
        assert_eq!(truth.collided, 0, "{truth:?}");
        let blind = truth.header.scan_id.saturating_sub(truth.actuation_scan);
        assert!(truth.blocked == 1 || blind <= BLIND_SCANS, "blind for {blind} scans: {truth:?}");
        assert!(truth.longest_blind_s <= BLIND_SCANS as f64 * 0.1 + 1e-9, "{truth:?}");
    }
    truths.len()
}
