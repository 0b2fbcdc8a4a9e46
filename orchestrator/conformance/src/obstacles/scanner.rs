//! What must become of obstacles, and of the scanner's health, when the scanner fails.
//!
//! The robot drives around the box of the default drive. What its scanner would return with a fault, or in another
//! world, replaces the ranges of the recorded scans. The limits are wide, so that detectors with other thresholds than
//! the built-in one pass. Where the health must stop the robot, any state that stops it will do, and so will a scanner
//! that sees no farther than the robot's front.
//!
//! Where this fails: the robot of a recorded drive moves on after a stop. So only some cases require that a stop lasts.

use shared_types::{
    BEAMS, FRONT_BEAM, Flag, Obstacles, PITCH_RAD, SECTOR_BEAMS, SECTORS, Scan, ScannerHealth,
};

use emulator::Scenario;
use emulator::scenario::{Scanner, ScenarioObstacle, Shape};

use super::{BOX_M, covers_the_box};
use crate::case::{Play, Trouble, Verdict, failed, observed, require};
use crate::drive::Course;
use crate::message::Message;
use crate::suite::{Setup, Suite};
use crate::test_bench::TestBench;

/// The scanner fails when the robot is here: 1.7 m before the box [m].
const ONSET_M: f64 = 3.3;
/// The box is known from this many scans then.
const SIGHTINGS: u64 = 20;
/// A fault lasts for this long [s].
const FAULT_S: f64 = 2.0;
/// Half of the robot's length: with no more seen ahead it must not drive [m].
const FRONT_M: f64 = 0.28;
/// A health that stops the robot must be reached within this time [s].
const NOTICED_S: f64 = 1.0;
/// And must end within this time after the fault [s].
const RECOVERED_S: f64 = 4.0;
/// Repeated scans after which the robot must stop.
const STUCK_SCANS: u64 = 8;
/// Way within which ranges that contradict the motion must be found, from the start [m].
const MOVED_M: f64 = 3.0;
/// A body from which nothing comes is remembered for at least this long [s].
const REMEMBERED_S: f64 = 3.0;
/// A body whose place is seen free is forgotten after this many scans.
const FREE_SCANS: usize = 5;
/// With a scanner that is good enough, so much is seen ahead: enough to drive carefully [m].
const SEEN_M: f64 = 1.0;
/// The covered sector: half of its width [rad].
const COVERED_RAD: f64 = 0.9;

/// Gives the scanner a fault.
type SetFault = fn(&mut Scanner);

/// The cases of obstacle detectors whose scanner fails.
pub(crate) const CASES: [(&str, Play); 10] = [
    ("no-returns", no_returns),
    ("covered-sector", covered_sector),
    ("stuck", stuck),
    ("range-factor", range_factor),
    ("mounting-angle", mounting_angle),
    ("random-ranges", random_ranges),
    ("noisy-scanner", noisy_scanner),
    ("missing-scan", missing_scan),
    ("silent-body", silent_body),
    ("seen-free", seen_free),
];

fn no_returns(suite: &Suite) -> Verdict {
    let mut failing = Failing::at_the_box(suite, |scanner| scanner.dropout_steps = vec![[0.0, 1.0]])?;
    let began_ns = failing.before()?.header.acquired_ns;
    let noticed = failing.play(FAULT_S, |described, since_s| {
        remembers(described)?;
        require(since_s < NOTICED_S || stops(described), || not_noticed(described, since_s, "returns"))
    })?;
    let mut recovered = None;
    failing.play(RECOVERED_S + 1.0, |described, since_s| {
        recovered = (!stops(described)).then(|| recovered.unwrap_or(since_s));
        require(since_s < RECOVERED_S || recovered.is_some(), || {
            format!("state `{}` {since_s:.1} s after returns came again", state(described))
        })
    })?;
    let noticed_s = seconds(began_ns, noticed.first_stop_ns);
    Ok(format!("stops after {noticed_s:.1} s, until {:.1} s after the fault", recovered.unwrap_or(0.0)))
}

fn covered_sector(suite: &Suite) -> Verdict {
    let mut failing =
        Failing::at_the_box(suite, |scanner| scanner.dead_rad = vec![[-COVERED_RAD, COVERED_RAD]])?;
    failing.before()?;
    let mut covered = String::new();
    failing.play(FAULT_S, |described, since_s| {
        remembers(described)?;
        let ScannerHealth { unseen_sectors, seen_ahead_m, .. } = described.scanner;
        let unseen = covered_sectors() & unseen_sectors;
        let is_noticed = unseen != 0 || seen_ahead_m < SEEN_M || stops(described);
        require(since_s < NOTICED_S || is_noticed, || {
            not_noticed(described, since_s, "returns of the sector")
        })?;
        covered = format!("{} covered sectors unseen, {seen_ahead_m:.2} m seen ahead", unseen.count_ones());
        Ok(())
    })?;
    Ok(covered)
}

/// Bits of the sectors that are covered as a whole.
fn covered_sectors() -> u64 {
    let reach = (COVERED_RAD / PITCH_RAD) as usize;
    let is_covered = |sector: &usize| {
        let first = sector * SECTOR_BEAMS;
        first >= FRONT_BEAM - reach && first + SECTOR_BEAMS <= FRONT_BEAM + reach
    };
    (0..SECTORS).filter(is_covered).fold(0, |bits, sector| bits | 1 << sector)
}

fn stuck(suite: &Suite) -> Verdict {
    let mut failing = Failing::at_the_box(suite, |scanner| scanner.stuck_s = Some(0.0))?;
    let first_repeated = failing.before()?.header.scan_id + 2;
    let played = failing.play(FAULT_S, |described, since_s| {
        remembers(described)?;
        let scans = described.header.scan_id - first_repeated.min(described.header.scan_id) + 1;
        require(scans < STUCK_SCANS || stops(described), || not_noticed(described, since_s, "new ranges"))?;
        // Until it is noticed the body may move with the robot: 0.8 m at 1 m/s.
        let farthest = described.list().iter().map(|item| item.x_m).fold(BOX_M[0], f64::max);
        require(farthest < BOX_M[0] + 1.0, || {
            format!("scan {}: the box travels, it is at x = {farthest:.2} m", described.header.scan_id)
        })
    })?;
    Ok(format!("stops after {} repeated scans", (played.first_stop_scan + 1).saturating_sub(first_repeated)))
}

fn range_factor(suite: &Suite) -> Verdict {
    contradicts_motion(suite, |scanner| scanner.range_factor = 1.4)
}

fn mounting_angle(suite: &Suite) -> Verdict {
    contradicts_motion(suite, |scanner| scanner.yaw_rad = 0.3)
}

/// Passes when a fault that is there from the start stops the robot within some metres, and until the box is near.
fn contradicts_motion(suite: &Suite, fault: impl FnOnce(&mut Scanner)) -> Verdict {
    let mut failing = Failing::new(suite, 1, |scenario, _| fault(&mut scenario.scanner))?;
    let drive = suite.drive(Course::Corridor)?;
    let moved = |scan_id: u64| drive.step(scan_id).truth.x_m - drive.step(1).truth.x_m;
    let (begins, ends) = (drive.scan_at(MOVED_M), drive.scan_at(MOVED_M + 1.0));
    let (mut first_m, mut drove) = (None, false);
    for scan_id in 1..ends {
        let described = failing.round()?;
        drove |= !stops(&described);
        first_m = stops(&described).then(|| first_m.unwrap_or(moved(scan_id)));
        require(scan_id < begins || first_m.is_some(), || {
            format!("state `{}` after {:.2} m of way", state(&described), moved(scan_id))
        })?;
    }
    observed(drove, || "it stops the robot from the first scan on, before anything moves".to_owned())?;
    Ok(format!("stops after {:.2} m of way", first_m.unwrap_or(0.0)))
}

fn random_ranges(suite: &Suite) -> Verdict {
    let mut failing = Failing::at_the_box(suite, |scanner| scanner.salt = 1.0)?;
    failing.before()?;
    let mut stopped_s = None;
    failing.play(NOTICED_S, |described, since_s| {
        stopped_s = stopped_s.or_else(|| stops(described).then_some(since_s));
        Ok(())
    })?;
    let Some(stopped_s) = stopped_s else {
        return failed(format!("it does not stop the robot in {NOTICED_S} s of random ranges"));
    };
    let mut resting = Failing::at_rest(suite, |scanner| scanner.salt = 1.0)?;
    resting.play(FAULT_S, |described, since_s| {
        require(since_s < NOTICED_S || stops(described), || not_noticed(described, since_s, "true ranges"))
    })?;
    Ok(format!("stops after {stopped_s:.1} s, and while the robot rests"))
}

fn noisy_scanner(suite: &Suite) -> Verdict {
    let faults: [(&str, SetFault); 3] = [
        ("without a fault", |_| {}),
        ("half of the returns missing", |scanner| scanner.dropout_steps = vec![[0.0, 0.5]]),
        ("one range in a hundred random", |scanner| scanner.salt = 0.01),
    ];
    let mut least_m = f64::INFINITY;
    for (name, fault) in faults {
        let mut failing = Failing::new(suite, 1, |scenario, _| fault(&mut scenario.scanner))?;
        for _ in 1..suite.drive(Course::Corridor)?.scan_at(ONSET_M) {
            let described = failing.round()?;
            let (scan_id, seen_m) = (described.header.scan_id, described.scanner.seen_ahead_m);
            require(!stops(&described) && seen_m >= SEEN_M, || {
                format!("scan {scan_id}, {name}: state `{}`, {seen_m:.2} m seen ahead", state(&described))
            })?;
            least_m = least_m.min(seen_m);
        }
    }
    Ok(format!("at least {least_m:.2} m seen ahead"))
}

fn missing_scan(suite: &Suite) -> Verdict {
    let mut failing = Failing::at_the_box(suite, |_| {})?;
    for _ in 0..2 {
        let before = failing.before()?;
        let described = failing.round_with(|scan| {
            (scan.missing, scan.ranges_mm) = (Flag::from(true), [0; BEAMS]);
        })?;
        remembers(&described)?;
        require(described.scanner.state == before.scanner.state, || {
            format!("one missing scan changes the state from `{}` to `{}`", state(&before), state(&described))
        })?;
        failing.onset += 5;
    }
    Ok("2 missing scans answered from memory".to_owned())
}

fn silent_body(suite: &Suite) -> Verdict {
    let mut failing = Failing::with(suite, |scenario, onset_s| {
        scenario.obstacles[0].black = true;
        scenario.scanner = Scanner { from_s: onset_s, black_range_m: 0.0, ..Scanner::default() };
    })?;
    failing.before()?;
    failing.play(REMEMBERED_S, |described, _| remembers(described))?;
    Ok(format!("remembered for {REMEMBERED_S} s"))
}

fn seen_free(suite: &Suite) -> Verdict {
    let mut failing = Failing::with(suite, |scenario, onset_s| {
        // A barrier 2 m behind the box returns what passes its place.
        let barrier = Shape::Box { length_m: 0.1, width_m: 3.6, yaw_rad: 0.0 };
        scenario.obstacles[0].disappears_s = Some(onset_s);
        scenario.obstacles.push(ScenarioObstacle::fixed(barrier, BOX_M[0] + 2.0, 0.0));
    })?;
    let known = |described: &Obstacles| {
        described.list().iter().any(|item| (item.x_m - BOX_M[0]).hypot(item.y_m - BOX_M[1]) < 0.6)
    };
    let before = failing.before()?;
    require(known(&before), || "the box was never reported".to_owned())?;
    let answers = (0..FREE_SCANS).map(|_| failing.round()).collect::<Result<Vec<_>, _>>()?;
    let forgotten = answers.iter().position(|described| !known(described));
    require(forgotten.is_some() && !known(&answers[FREE_SCANS - 1]), || {
        format!("still reported after {FREE_SCANS} scans that show its place free")
    })?;
    Ok(format!("forgotten after {} scans", forgotten.unwrap_or(0) + 1))
}

/// A test bench with the ranges of a scanner that fails.
struct Failing<'a> {
    bench: TestBench<'a>,
    /// Ranges of all scans, scan 1 first.
    ranges: Vec<[u16; BEAMS]>,
    /// The first scan with the fault.
    onset: u64,
}

/// When the state stopped the robot first.
#[derive(Default)]
struct Played {
    first_stop_scan: u64,
    first_stop_ns: u64,
}

impl<'a> Failing<'a> {
    /// A bench whose scanner has a fault for [`FAULT_S`], from [`ONSET_M`] on.
    fn at_the_box(suite: &'a Suite, fault: impl FnOnce(&mut Scanner)) -> Result<Self, Trouble> {
        Self::with(suite, |scenario, onset_s| {
            fault(&mut scenario.scanner);
            scenario.scanner.from_s = onset_s;
            scenario.scanner.to_s = Some(onset_s + FAULT_S);
        })
    }

    /// A bench that begins with the scans in which the box becomes known; `change` gets the time of the onset [s].
    fn with(suite: &'a Suite, change: impl FnOnce(&mut Scenario, f64)) -> Result<Self, Trouble> {
        let onset = suite.drive(Course::Corridor)?.scan_at(ONSET_M);
        Self::new(suite, onset.saturating_sub(SIGHTINGS).max(1), change)
    }

    /// A bench along the drive around the box; `change` gets the time of the onset [s].
    fn new(
        suite: &'a Suite,
        first_scan: u64,
        change: impl FnOnce(&mut Scenario, f64),
    ) -> Result<Self, Trouble> {
        let onset = suite.drive(Course::Corridor)?.scan_at(ONSET_M);
        Self::of(suite, Setup { first_scan, ..Setup::default() }, onset, change)
    }

    /// A bench whose robot rests before a barrier, with a fault after five scans.
    fn at_rest(suite: &'a Suite, fault: impl FnOnce(&mut Scanner)) -> Result<Self, Trouble> {
        let course = Course::Barrier;
        let drive = suite.drive(course)?;
        let first_scan = drive.scan_at(drive.step(drive.ended as u64).truth.x_m - 1e-3);
        let setup = Setup { course, first_scan, ..Setup::default() };
        let mut failing = Self::of(suite, setup, first_scan + 5, |scenario, onset_s| {
            fault(&mut scenario.scanner);
            scenario.scanner.from_s = onset_s;
        })?;
        let mut last = Obstacles::default();
        for _ in 1..failing.onset {
            last = failing.round()?;
        }
        observed(!stops(&last), || format!("state `{}` at rest before the fault", state(&last)))?;
        Ok(failing)
    }

    fn of(
        suite: &'a Suite,
        setup: Setup,
        onset: u64,
        change: impl FnOnce(&mut Scenario, f64),
    ) -> Result<Self, Trouble> {
        let drive = suite.drive(setup.course)?;
        let onset_s = drive.step(onset).scan.header.acquired_ns as f64 * 1e-9;
        let skipped = setup.first_scan - 1;
        let ranges = drive.rescan(|scenario| change(scenario, onset_s)).split_off(skipped as usize);
        Ok(Self { bench: suite.started(setup)?, ranges, onset: onset - skipped })
    }

    /// Plays the scans before the onset, after which the box must be known; returns the last answer.
    fn before(&mut self) -> Result<Obstacles, Trouble> {
        let mut described = self.round()?;
        while self.bench.scan_id < self.onset {
            described = self.round()?;
        }
        require(described.list().iter().any(covers_the_box), || "the box was never reported".to_owned())?;
        require(!stops(&described), || format!("state `{}` before the fault", state(&described)))?;
        Ok(described)
    }

    /// Plays for some time; `check` gets each answer, and the time since the first of them [s].
    fn play(
        &mut self,
        duration_s: f64,
        mut check: impl FnMut(&Obstacles, f64) -> Result<(), Trouble>,
    ) -> Result<Played, Trouble> {
        let mut played = Played::default();
        let scans = (duration_s * 1e9 / self.bench.suite.period_ns as f64).round() as u64;
        for scan in 0..scans {
            let described = self.round()?;
            if stops(&described) && played.first_stop_scan == 0 {
                let header = &described.header;
                (played.first_stop_scan, played.first_stop_ns) = (header.scan_id, header.acquired_ns);
            }
            check(&described, (scan * self.bench.suite.period_ns) as f64 * 1e-9)?;
        }
        Ok(played)
    }

    fn round(&mut self) -> Result<Obstacles, Trouble> {
        self.round_with(|_| {})
    }

    /// The answer to the next scan, which is changed.
    fn round_with(&mut self, change: impl Fn(&mut Scan)) -> Result<Obstacles, Trouble> {
        let index = (self.bench.scan_id as usize - 1).min(self.ranges.len() - 1);
        let ranges = &self.ranges[index];
        let answer = self.bench.round_with(|message: &mut Message| {
            message.change(|scan: &mut Scan| {
                scan.ranges_mm = *ranges;
                change(scan);
            });
        })?;
        if let Err(fault) = answer.message.check() {
            return failed(format!("scan {}: {fault}", answer.message.scan_id()));
        }
        answer.message.sample().copied()
    }
}

fn remembers(described: &Obstacles) -> Result<(), Trouble> {
    require(described.list().iter().any(covers_the_box), || {
        format!("scan {}: the box is forgotten", described.header.scan_id)
    })
}

/// Whether the robot is stopped because of its scanner.
fn stops(described: &Obstacles) -> bool {
    described.scanner.state().is_stop() || described.scanner.seen_ahead_m <= FRONT_M
}

fn state(described: &Obstacles) -> &'static str {
    described.scanner.state().name()
}

fn not_noticed(described: &Obstacles, since_s: f64, what: &str) -> String {
    let seen_m = described.scanner.seen_ahead_m;
    format!("state `{}`, {seen_m:.2} m seen ahead, after {since_s:.1} s without {what}", state(described))
}

fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::Drive;

    #[test]
    fn the_covered_sectors_are_ahead() {
        let sectors = covered_sectors();
        assert_eq!(sectors.count_ones(), 26, "sectors 18 to 43 lie within 146 beams of beam 340");
        assert_eq!(sectors.trailing_zeros(), 18);
    }

    #[test]
    fn a_scanner_without_a_fault_gives_the_recorded_ranges_and_one_with_a_fault_does_not()
    -> anyhow::Result<()> {
        let drive = Drive::record(Course::Corridor, 100_000_000)?;
        let recorded = || drive.steps.iter().map(|step| step.scan.ranges_mm);
        assert!(recorded().eq(drive.rescan(|_| {})));
        let onset = drive.scan_at(ONSET_M) as usize;
        let faulty = drive.rescan(|scenario| {
            scenario.scanner.range_factor = 1.4;
            scenario.scanner.from_s = drive.steps[onset - 1].scan.header.acquired_ns as f64 * 1e-9;
        });
        assert!(recorded().take(onset - 1).eq(faulty[..onset - 1].iter().copied()));
        assert!(recorded().skip(onset - 1).zip(&faulty[onset - 1..]).all(|(one, other)| one != *other));
        Ok(())
    }
}
