//! Hours of driving with faults, kills and swaps under way: nothing grows, and everything that happened is reported.
//!
//! A *drive* is one run of `endless` whose scanner fails again and again. In lock-step its processes are swapped; in real
//! time they are also killed and stopped. A seed decides what happens; the exact moments depend on the machine.

use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use emulator::Outcome;
use handover::swap::{Certificate, SwapOutcome};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use report::Report;
use rustix::process::Signal;
use shared_types::Role;

use crate::swaps::BUILT_IN;
use crate::{TestSystem, TruthWatch};

/// Longest duration of one drive: it has to end before the track of 10 km does [s].
pub const MAX_DRIVE_S: f64 = 9500.0;
/// Scanner faults are this far apart on average [s].
const FAULT_EVERY_S: f64 = 73.0;
/// Roles that are killed: the run continues without them for a moment.
const KILLED: [Role; 4] = [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];
/// Growth of memory, descriptors and files that is allowed from the first to the last quarter of a drive.
const GROWTH_MAX: f64 = 1.05;
/// The orchestrator keeps up to 200,000 rows of the drive for its report, which take at most so much [MiB].
const ROWS_MIB: f64 = 45.0;
/// Time between two samples of what the processes use.
const SAMPLE_EVERY: Duration = Duration::from_secs(1);

/// What happens in one drive.
#[derive(Debug, Clone)]
pub struct LongDrive {
    /// Seed of the drive.
    pub seed: u64,
    /// Driven time [s].
    pub duration_s: f64,
    /// Scans per second [Hz].
    pub rate_hz: f64,
    /// Whether processes run in real time and die.
    pub live: bool,
}

impl LongDrive {
    /// Keys of the scenario that give the scanner its faults, and how many of these there are.
    pub fn faults(&self) -> (Vec<String>, usize) {
        let mut dice = Pcg64::seed_from_u64(self.seed);
        let mut steps = Vec::new();
        let mut at_s = dice.random_range(5.0..FAULT_EVERY_S);
        while at_s + 5.0 < self.duration_s {
            let share = [0.3, 0.6, 0.9, 1.0][dice.random_range(0..4)];
            let lasts_s = dice.random_range(0.3..3.0);
            steps.push(format!("[{at_s:.2}, {share}], [{:.2}, 0]", at_s + lasts_s));
            at_s += dice.random_range(0.5..1.5) * FAULT_EVERY_S;
        }
        let count = steps.len();
        let mut keys = vec![format!("scanner.dropout_steps=[{}]", steps.join(", "))];
        keys.extend(match dice.random_range(0..5) {
            0 => Some("scanner.missing_every=50".to_owned()),
            1 => Some("scanner.dust=0.005".to_owned()),
            2 => Some("scanner.salt=0.005".to_owned()),
            3 => Some(format!("scanner.stamp_jitter_s={}", 0.1 / self.rate_hz)),
            _ => None,
        });
        (keys, count)
    }
}

/// What was done and seen in all drives.
#[derive(Debug, Clone, Default)]
pub struct LongTally {
    /// Drives.
    pub drives: usize,
    /// Driven time [s].
    pub driven_s: f64,
    /// Scanner faults.
    pub scanner_faults: usize,
    /// Drives that the robot ended at rest because of its scanner.
    pub stopped_by_scanner: usize,
    /// Swaps that were completed.
    pub swaps: usize,
    /// Swaps at which scans were missed or answered twice, as their certificates say: on a busy machine.
    pub rough_swaps: usize,
    /// Processes that were killed or stopped.
    pub kills: usize,
    /// Scans that were published, and those without a command by reason.
    pub scans: u64,
    /// See `scans`.
    pub lost: BTreeMap<String, u64>,
    /// Largest growth over a drive: of the memory of the processes, of open descriptors and of files in shared memory, as
    /// factors; of the memory of the orchestrator [MiB].
    pub growth: [f64; 4],
    /// What must not happen, by the seed of the drive.
    pub problems: Vec<String>,
}

impl fmt::Display for LongTally {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { drives, driven_s, scanner_faults, stopped_by_scanner, swaps, .. } = self;
        let Self { rough_swaps, kills, scans, lost, .. } = self;
        let [memory, descriptors, files, orchestrator] = self.growth;
        write!(
            out,
            "{drives} drives, {driven_s:.0} s, {scans} scans, {lost:?} lost; {scanner_faults} scanner faults, \
             {stopped_by_scanner} stops by them; {swaps} swaps, {rough_swaps} with missed scans, {kills} kills; growth of \
             memory {memory:.3}, \
             descriptors {descriptors:.3}, files {files:.3}, orchestrator {orchestrator:.1} MiB; {} problems",
            self.problems.len()
        )
    }
}

/// Drives once and adds what happened.
///
/// # Panics
/// When the system can't be started or asked.
pub fn drive(executable: &str, plan: &LongDrive, tally: &mut LongTally) {
    let (keys, faults) = plan.faults();
    let mut system = TestSystem::new(executable);
    let (duration, rate) = (format!("{:.0}", plan.duration_s), format!("rate_hz={}", plan.rate_hz));
    let mut arguments = vec!["endless", "--duration", &duration, "--set", &rate];
    for key in &keys {
        arguments.extend(["--set", key]);
    }
    if !plan.live {
        arguments.push("--lockstep");
    }
    let seed = plan.seed.to_string();
    arguments.extend(["--seed", &seed]);
    system.start(&arguments);
    let mut use_of_machine = Vec::new();
    let (mut swaps, mut kills) = (0, BTreeMap::new());
    let mut dice = Pcg64::seed_from_u64(plan.seed ^ 0x5a5a);
    let watch = plan.live.then(|| TruthWatch::new(&system));
    let mut sampled = Instant::now();
    let mut strike_at = Instant::now() + Duration::from_secs(5);
    let mut problems = Vec::new();
    while let Some(usage) = usage(&system) {
        if sampled.elapsed() > SAMPLE_EVERY {
            use_of_machine.push(usage);
            sampled = Instant::now();
        }
        if let Some(watch) = watch.as_ref().filter(|_| strike_at.elapsed() > Duration::ZERO) {
            strike_at = Instant::now() + Duration::from_millis(dice.random_range(4_000..12_000));
            let role = KILLED[dice.random_range(0..KILLED.len())];
            let signal = if dice.random_range(0..3) == 0 { Signal::STOP } else { Signal::KILL };
            if strike(&system, watch, role, signal) {
                *kills.entry(role).or_insert(0_u32) += 1;
            }
        }
        let (role, implementation) = BUILT_IN[dice.random_range(0..BUILT_IN.len())];
        let shadow = dice.random_range(1..20).to_string();
        let arguments = [role.name(), "--to", implementation, "--shadow-scans", &shadow];
        if system.status().is_none_or(|status| status.state != "driving") {
            break;
        }
        if let Some(certificate) = try_swap(&system, &arguments) {
            swaps += usize::from(certificate.outcome == SwapOutcome::Swapped);
            if (certificate.missed_scans, certificate.duplicate_scans) != (0, 0) {
                tally.rough_swaps += 1;
                // In simulated time the machine is no excuse.
                let problem = (!plan.live).then(|| format!("a swap was not seamless: {certificate:?}"));
                problems.extend(problem);
            }
        }
        std::thread::park_timeout(Duration::from_millis(500));
    }
    let code = system.wait().code();
    let report = system.report();
    problems.extend(judge(&report, code, swaps, &kills));
    if let Some(watch) = &watch {
        problems
            .extend(watch.all().iter().find(|truth| truth.collided != 0).map(|truth| format!("{truth:?}")));
    }
    drop(watch);
    system.assert_nothing_left();
    let growth = growth(&use_of_machine);
    let what = ["memory of the processes", "descriptors", "files", "memory of the orchestrator"];
    for (index, limit) in [GROWTH_MAX, GROWTH_MAX, GROWTH_MAX, ROWS_MIB].into_iter().enumerate() {
        tally.growth[index] = tally.growth[index].max(growth[index]);
        if growth[index] > limit {
            problems.push(format!("growth of the {}: {:.3}, allowed {limit}", what[index], growth[index]));
        }
    }
    tally.drives += 1;
    tally.driven_s += report.duration_s;
    tally.scanner_faults += faults * usize::from(report.outcome != Outcome::Stopped);
    tally.stopped_by_scanner += usize::from(report.outcome == Outcome::Stopped);
    tally.swaps += swaps;
    tally.kills += kills.values().map(|count| *count as usize).sum::<usize>();
    tally.scans += report.scans.published;
    for (reason, count) in &report.scans.lost_reasons {
        *tally.lost.entry(reason.clone()).or_default() += count;
    }
    tally.problems.extend(problems.into_iter().map(|problem| format!("seed {}: {problem}", plan.seed)));
}

/// What a report says that must not be.
fn judge(report: &Report, code: Option<i32>, swaps: usize, kills: &BTreeMap<Role, u32>) -> Vec<String> {
    let mut problems = Vec::new();
    let stopped_by_scanner = report.outcome == Outcome::Stopped && report.reason.contains("scanner");
    if code != Some(1) || (report.outcome != Outcome::Timeout && !stopped_by_scanner) {
        problems.push(format!("code {code:?}, {:?}: {}", report.outcome, report.reason));
    }
    if report.scans.unaccounted != 0 || report.ledger.residual != 0 {
        let (scans, samples) = (report.scans.unaccounted, report.ledger.residual);
        problems.push(format!("{scans} scans and {samples} samples unaccounted"));
    }
    let reported =
        report.swaps.iter().filter(|certificate| certificate.outcome == SwapOutcome::Swapped).count();
    // The run may end before the command of its last swap has its answer.
    if !(swaps..=swaps + 1).contains(&reported) {
        problems.push(format!("{swaps} swaps, {reported} in the report"));
    }
    for process in &report.processes {
        let killed =
            kills.iter().find(|(role, _)| role.name() == process.role).map_or(0, |(_, count)| *count);
        if process.restarts != killed {
            problems.push(format!("{}: {killed} kills, {} restarts", process.role, process.restarts));
        }
    }
    let blind_s = report.drive.truth.map_or(0.0, |truth| truth.longest_blind_s);
    let period_s = report.duration_s / (report.scans.published.max(1) as f64);
    if blind_s > 3.0 * period_s * 1.01 {
        problems.push(format!("wheels turned for {blind_s} s without an actuation"));
    }
    problems
}

/// Kills or stops a process and waits until another one answers; false when the run ended before.
fn strike(system: &TestSystem, watch: &TruthWatch, role: Role, signal: Signal) -> bool {
    let Some(status) = system.status() else { return false };
    let Some(row) = status.processes.iter().find(|row| row.role == role && row.pid != 0) else {
        return false;
    };
    let (pid, before) = (row.pid, watch.newest());
    system.signal(pid, signal);
    let before = before.map_or(0, |truth| truth.header.scan_id);
    system.wait_until("another one answers", |system| {
        let status = system.status();
        let is_new = status.as_ref().is_some_and(|status| {
            let mut rows = status.processes.iter().filter(|row| row.role == role);
            rows.any(|row| row.pid != pid && row.pid != 0 && row.state.name() == "ready")
        });
        system.find().is_none() || is_new && watch.newest().is_some_and(|now| now.actuation_scan > before + 2)
    });
    system.find().is_some()
}

/// The certificate of a swap; `None` from a run that ended.
fn try_swap(system: &TestSystem, arguments: &[&str]) -> Option<Certificate> {
    let output = system.run(&[&["swap", "--json"], arguments].concat());
    serde_json::from_slice(&output.stdout).ok()
}

/// Resident memory of the processes of the system [KiB], descriptors that they and the orchestrator have open, the files of
/// the run in shared memory, and the memory of the orchestrator [KiB].
fn usage(system: &TestSystem) -> Option<[f64; 4]> {
    let domain = system.find()?;
    let orchestrator = system.orchestrator();
    let memory_kib = |pid: i32| -> Option<u64> {
        let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
        line.split_whitespace().next()?.parse().ok()
    };
    let descriptors = |pid: i32| std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count);
    let files = std::fs::read_dir("/dev/shm").ok()?.flatten();
    let files = files.filter(|entry| entry.file_name().to_string_lossy().contains(domain.run_id())).count();
    let mut memory = 0;
    let mut open = descriptors(orchestrator);
    for pid in system.processes() {
        memory += memory_kib(pid).unwrap_or(0);
        open += descriptors(pid);
    }
    Some([memory as f64, open as f64, files as f64, memory_kib(orchestrator)? as f64])
}

/// Median of the last quarter over that of the second one, after which everything has been used once; of the last figure
/// the difference [MiB]. No growth without samples.
fn growth(samples: &[[f64; 4]]) -> [f64; 4] {
    let of = |index: usize| growth_of(samples, index);
    let factor = |index: usize| of(index).map_or(1.0, |[early, late]| late / early.max(1.0));
    [factor(0), factor(1), factor(2), of(3).map_or(0.0, |[early, late]| (late - early) / 1024.0)]
}

/// Medians of one figure in the second and in the last quarter; `None` without enough samples.
pub(crate) fn growth_of<const N: usize>(samples: &[[f64; N]], index: usize) -> Option<[f64; 2]> {
    let quarter = samples.len() / 4;
    let median = |range: &[[f64; N]]| {
        let mut values: Vec<f64> = range.iter().map(|sample| sample[index]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let late = &samples[samples.len() - quarter..];
    (quarter >= 3).then(|| [median(&samples[quarter..2 * quarter]), median(late)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_the_late_median_against_the_early_one() {
        let grown = |n: usize| if n < 20 { 10.0 } else { 12.0 };
        let samples: Vec<[f64; 4]> = (0..40).map(|n| [100.0, grown(n), 5.0, 1024.0 * grown(n)]).collect();
        assert_eq!(growth(&samples), [1.0, 1.2, 1.0, 2.0]);
        assert_eq!(growth(&samples[..8]), [1.0, 1.0, 1.0, 0.0], "too few to tell");
    }

    #[test]
    fn a_seed_gives_its_faults_and_they_end_before_the_drive() {
        let plan = LongDrive { seed: 3, duration_s: 1000.0, rate_hz: 10.0, live: false };
        let (keys, count) = plan.faults();
        assert_eq!((keys.clone(), count), plan.faults());
        assert!((8..30).contains(&count), "{keys:?}");
    }
}
