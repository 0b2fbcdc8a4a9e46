//! What must become of obstacles, and of the scanner's health, when the scanner fails.
//!
//! The robot drives around the box of the default drive. What its scanner would return with a fault, or in another
//! world, replaces the ranges of the recorded scans. The limits are wide, so that detectors with other thresholds than
//! the built-in one pass. Where the health must stop the robot, any state that stops it will do, and so will a scanner
//! that sees no farther than the robot's front.
//!
//! Where this fails: the robot of a recorded drive moves on after a stop. So only some cases require that a stop lasts.

use emulator::scenario::{Scanner, ScenarioObstacle, Shape};
use shared_types::{FRONT_BEAM, Flag, MAX_BEAMS, Obstacles, PITCH_RAD, SECTOR_BEAMS, SECTORS, ScannerHealth};

use super::failing::{FAULT_S, Failing, ONSET_M, state, stops};
use super::{BOX_M, covers_the_box, position_at};
use crate::case::{Tried, Verdict, failed, observed, require};
use crate::drive::Course;
use crate::suite::Suite;
use crate::vehicle::SuiteVehicle;

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
/// With a scanner that is good enough, so much is seen ahead of the body: enough to drive carefully [m].
const SEEN_M: f64 = 0.72;
/// The covered sector: half of its width [rad].
const COVERED_RAD: f64 = 0.9;

/// Ranges that are wrong by a factor.
const FACTOR: f64 = 1.4;

/// Gives the scanner a fault.
type SetFault = fn(&mut Scanner);

/// Scanners that are good enough to drive.
const NOISY: [(&str, SetFault); 3] = [
    ("without a fault", |_| {}),
    ("half of the returns missing", |scanner| scanner.dropout_steps = vec![[0.0, 0.5]]),
    ("one range in a hundred random", |scanner| scanner.salt = 0.01),
];

pub(crate) fn no_returns(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::at_the_box(suite, |scanner| scanner.dropout_steps = vec![[0.0, 1.0]])?;
    let began_ns = failing.before()?.header.acquired_ns;
    let first_stop = failing.play(FAULT_S, |described, since_s| {
        remembers(vehicle, described)?;
        noticed(stops(vehicle, described), described, since_s, "returns")
    })?;
    let mut recovered = None;
    failing.play(RECOVERED_S + 1.0, |described, since_s| {
        recovered = (!stops(vehicle, described)).then(|| recovered.unwrap_or(since_s));
        let (in_time, state) = (since_s < RECOVERED_S || recovered.is_some(), state(described));
        require(in_time, || format!("state `{state}` {since_s:.1} s after returns came again"))
    })?;
    let noticed_ns = first_stop.map_or(0, |(_, header)| header.acquired_ns.saturating_sub(began_ns));
    let (noticed_s, recovered_s) = (noticed_ns as f64 * 1e-9, recovered.unwrap_or(0.0));
    Ok(format!("stops after {noticed_s:.1} s, until {recovered_s:.1} s after the fault"))
}

pub(crate) fn covered_sector(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let cover = |scanner: &mut Scanner| scanner.dead_rad = vec![[-COVERED_RAD, COVERED_RAD]];
    let mut failing = Failing::at_the_box(suite, cover)?;
    failing.before()?;
    let mut covered = String::new();
    failing.play(FAULT_S, |described, since_s| {
        remembers(vehicle, described)?;
        let ScannerHealth { unseen_sectors, seen_ahead_m, .. } = described.scanner;
        let unseen = (covered_sectors() & unseen_sectors).count_ones();
        covered = format!("{unseen} covered sectors unseen, {seen_ahead_m:.2} m seen ahead");
        let is_noticed = unseen > 0 || seen_ahead_m < vehicle.ahead_m(SEEN_M) || stops(vehicle, described);
        noticed(is_noticed, described, since_s, "returns of the sector")
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

pub(crate) fn stuck(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::at_the_box(suite, |scanner| scanner.stuck_s = Some(0.0))?;
    let first_repeated = failing.before()?.header.scan_id + 2;
    let first_stop = failing.play(FAULT_S, |described, since_s| {
        remembers(vehicle, described)?;
        let scan_id = described.header.scan_id;
        let is_noticed = scan_id + 1 < first_repeated + STUCK_SCANS || stops(vehicle, described);
        require(is_noticed, || not_noticed(described, since_s, "new ranges"))?;
        // Until it is noticed the body may move with the robot: 0.8 m at 1 m/s.
        let farthest = described.list().iter().map(|item| item.x_m).fold(vehicle.m(BOX_M[0]), f64::max);
        let travels = || format!("scan {scan_id}: the box travels, it is at x = {farthest:.2} m");
        require(farthest < vehicle.m(BOX_M[0] + 1.0), travels)
    })?;
    let scans = first_stop.map_or(0, |(_, header)| (header.scan_id + 1).saturating_sub(first_repeated));
    Ok(format!("stops after {scans} repeated scans"))
}

pub(crate) fn range_factor(suite: &Suite) -> Verdict {
    // On a larger course too long ones are out of reach.
    let factor = if suite.vehicle.m(1.0) > 1.0 { 1.0 / FACTOR } else { FACTOR };
    contradicts_motion(suite, |scanner| scanner.range_factor = factor)
}

pub(crate) fn mounting_angle(suite: &Suite) -> Verdict {
    contradicts_motion(suite, |scanner| scanner.yaw_rad = 0.3)
}

/// Passes when a fault that is there from the start stops the robot within some metres, and until the box is near.
fn contradicts_motion(suite: &Suite, fault: impl FnOnce(&mut Scanner)) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::from_the_start(suite, fault)?;
    let drive = suite.drive(Course::Corridor)?;
    let moved = |scan_id: u64| drive.step(scan_id).truth.x_m - drive.step(1).truth.x_m;
    let (begins, ends) = (drive.scan_at(MOVED_M), drive.scan_at(MOVED_M + 1.0));
    let (mut first_m, mut drove) = (None, false);
    for scan_id in 1..ends {
        let described = failing.round()?;
        drove |= !stops(vehicle, &described);
        first_m = stops(vehicle, &described).then(|| first_m.unwrap_or(moved(scan_id)));
        let drives_on = || format!("state `{}` after {:.2} m of way", state(&described), moved(scan_id));
        require(scan_id < begins || first_m.is_some(), drives_on)?;
    }
    observed(drove, || "it stops the robot from the first scan on, before anything moves")?;
    Ok(format!("stops after {:.2} m of way", first_m.unwrap_or(0.0)))
}

pub(crate) fn random_ranges(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let random = |scanner: &mut Scanner| scanner.salt = 1.0;
    let mut failing = Failing::at_the_box(suite, random)?;
    failing.before()?;
    let Some((stopped_s, _)) = failing.play(NOTICED_S, |_, _| Ok(()))? else {
        return failed(format!("it does not stop the robot in {NOTICED_S} s of random ranges"));
    };
    Failing::at_rest(suite, random)?.play(FAULT_S, |described, since_s| {
        noticed(stops(vehicle, described), described, since_s, "true ranges")
    })?;
    Ok(format!("stops after {stopped_s:.1} s, and while the robot rests"))
}

pub(crate) fn noisy_scanner(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut least_m = f64::INFINITY;
    for (name, fault) in NOISY {
        let mut failing = Failing::from_the_start(suite, fault)?;
        for _ in 1..suite.drive(Course::Corridor)?.scan_at(ONSET_M) {
            let described = failing.round()?;
            let (scan_id, seen_m) = (described.header.scan_id, described.scanner.seen_ahead_m);
            let health = format!("state `{}`, {seen_m:.2} m seen ahead", state(&described));
            require(!stops(vehicle, &described) && seen_m >= vehicle.ahead_m(SEEN_M), || {
                format!("scan {scan_id}, {name}: {health}")
            })?;
            least_m = least_m.min(seen_m);
        }
    }
    Ok(format!("at least {least_m:.2} m seen ahead"))
}

pub(crate) fn missing_scan(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::at_the_box(suite, |_| {})?;
    for _ in 0..2 {
        let before = failing.before()?;
        let described =
            failing.round_with(|scan| (scan.missing, scan.ranges_mm) = (Flag::from(true), [0; MAX_BEAMS]))?;
        remembers(vehicle, &described)?;
        let (was, is) = (state(&before), state(&described));
        let changes = || format!("one missing scan changes the state from `{was}` to `{is}`");
        require(described.scanner.state == before.scanner.state, changes)?;
        failing.onset += 5;
    }
    Ok("2 missing scans answered from memory".to_owned())
}

pub(crate) fn silent_body(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::with(suite, |scenario, onset_s| {
        scenario.obstacles[0].black = true;
        scenario.scanner = Scanner { from_s: onset_s, black_range_m: 0.0, ..Scanner::default() };
    })?;
    failing.before()?;
    failing.play(REMEMBERED_S, |described, _| remembers(vehicle, described))?;
    Ok(format!("remembered for {REMEMBERED_S} s"))
}

pub(crate) fn seen_free(suite: &Suite) -> Verdict {
    let vehicle = &suite.vehicle;
    let mut failing = Failing::with(suite, |scenario, onset_s| {
        // A barrier 2 m behind the box, within reach also on a larger course, returns what passes its place.
        let [length_m, width_m, x_m] = [0.1, 3.6, BOX_M[0]].map(|usual_m| vehicle.m(usual_m));
        let x_m = x_m + 2.0 / vehicle.m(1.0);
        let barrier = Shape::Box { length_m, width_m, yaw_rad: 0.0 };
        scenario.obstacles[0].disappears_s = Some(onset_s);
        scenario.obstacles.push(ScenarioObstacle::fixed(barrier, x_m, 0.0));
    })?;
    let is_known = |described: &Obstacles| position_at(vehicle, described, [BOX_M[0], BOX_M[1]]).is_some();
    require(is_known(&failing.before()?), || "the box was never reported")?;
    let answers = (0..FREE_SCANS).map(|_| failing.round()).collect::<Result<Vec<_>, _>>()?;
    let forgotten = answers.iter().position(|described| !is_known(described));
    let is_forgotten = forgotten.is_some() && !is_known(&answers[FREE_SCANS - 1]);
    require(is_forgotten, || format!("still reported after {FREE_SCANS} scans that show its place free"))?;
    Ok(format!("forgotten after {} scans", forgotten.unwrap_or(0) + 1))
}

fn remembers(vehicle: &SuiteVehicle, described: &Obstacles) -> Tried {
    let is_known = described.list().iter().any(|item| covers_the_box(vehicle, item));
    let scan_id = described.header.scan_id;
    require(is_known, || format!("scan {scan_id}: the box is forgotten"))
}

/// Requires that a fault which lasts for `since_s` is noticed in time.
fn noticed(is_noticed: bool, described: &Obstacles, since_s: f64, missing: &str) -> Tried {
    require(since_s < NOTICED_S || is_noticed, || not_noticed(described, since_s, missing))
}

fn not_noticed(described: &Obstacles, since_s: f64, missing: &str) -> String {
    let seen_m = described.scanner.seen_ahead_m;
    format!("state `{}`, {seen_m:.2} m seen ahead, after {since_s:.1} s without {missing}", state(described))
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
        let drive = Drive::record(Course::Corridor, 100_000_000, &SuiteVehicle::read(None, 1.0)?.0)?;
        let ranges = |drive: &Drive| drive.steps.iter().map(|step| step.scan.ranges_mm).collect::<Vec<_>>();
        let recorded = ranges(&drive);
        assert!(recorded == ranges(&drive.rescanned(|_| {})));
        let onset = drive.scan_at(ONSET_M) as usize;
        let faulty = drive.rescanned(|scenario| {
            scenario.scanner.range_factor = 1.4;
            scenario.scanner.from_s = drive.steps[onset - 1].scan.header.acquired_ns as f64 * 1e-9;
        });
        let faulty = ranges(&faulty);
        assert!(recorded[..onset - 1] == faulty[..onset - 1]);
        assert!(recorded.iter().zip(&faulty).skip(onset - 1).all(|(one, other)| one != other));
        Ok(())
    }
}
