//! Drives of other programs as recordings: scans and odometry are taken over, estimator and obstacle detector run over them.
//!
//! The source is read twice: for the scanner, its rate and the odometry, and for the scans. What is not used is counted.

mod bag;
mod drive;
mod imported;
mod joined;
mod message;
mod rays;
mod rover;
mod settings;
mod source;
mod times;

use std::io::{BufWriter, IntoInnerError};
use std::path::{Path, PathBuf};

use console::new_file::{Existing, NewFile};
use driver::motion::{BaseState, Convention, Motion, Ordered, Turn};
use recording::imported::{begin, end};
use recording::ros2::BaseOdometry;

pub use crate::drive::Computed;
use crate::drive::Drive;
pub use crate::imported::Imported;
use crate::joined::Joined;
use crate::message::{Message, refuse};
use crate::rays::Beams;
pub use crate::rays::Mounting;
use crate::source::Source;
pub use crate::times::StampCounts;
use crate::times::Times;

/// Messages of the odometry that are held: those of a day at 48 Hz, in 235 MB.
const MAX_MOTIONS: usize = 1 << 22;
/// Scans of a drive: those of a day at 48 Hz.
const MAX_SCANS: usize = 1 << 22;
/// Poses and velocities beyond are none [m, rad].
const MAX_NUMBER: f64 = 1e7;
/// No drive is longer: a year [ns].
const MAX_DURATION_NS: u64 = 365 * 24 * 3600 * 1_000_000_000;

/// What is imported, and how.
#[derive(Debug, Clone)]
pub struct ImportOptions {
    /// The topic with the scans; without it the only one.
    pub scan: Option<String>,
    /// The topic with the odometry; without it the only one.
    pub odometry: Option<String>,
    /// System file with the vehicle.
    pub system: Option<PathBuf>,
    /// Scenario with the track.
    pub scenario: Option<String>,
    /// Keys of both that are overridden.
    pub overrides: Vec<String>,
    /// How the scanner is mounted.
    pub mounting: Mounting,
    /// Factors on way and turn of the log of a rover.
    pub wheel_factors: [f64; 2],
    /// Whether a file of the same name is replaced.
    pub force: bool,
}

/// What the first reading found.
struct Survey {
    motions: Vec<Motion>,
    beams: Beams,
    period_ns: u64,
    sweep_share: f64,
    imported: Imported,
}

/// Imports a bag of ROS 2 or the log of a rover as a new recording.
///
/// # Errors
/// A file of another kind, topics that are missing, messages that are none, and a file that can't be written; exit code 2.
pub fn import(from: &Path, out: &Path, options: &ImportOptions) -> anyhow::Result<Imported> {
    let source = Source::open(from, options)?;
    let Survey { motions, mut beams, period_ns, sweep_share, mut imported } = survey(from, &source, options)?;
    let plan = settings::plan(options, source.vehicle(), &beams, period_ns, sweep_share)?;
    if plan.system.vehicle.scanner.geometry() != beams.geometry {
        return Err(refuse(
            from,
            "its scans describe the beams of the scanner: vehicle.scanner can't be set",
        ));
    }
    let period_ns = plan.system.period_ns();
    let mut inputs = source.files(from);
    inputs.extend(options.system.as_deref());
    inputs.extend(options.scenario.as_deref().map(Path::new));
    let file = NewFile::create(out, Existing::forced(options.force), &inputs)?;
    let mut writer = begin(BufWriter::new(file), period_ns, &imported.file)?;
    settings::attach(&mut writer, &plan, source.name())?;
    let mut drive = Drive::new(writer, &plan.system.tuning().for_scenario(&plan.scenario), period_ns)?;
    let mut joined = Joined::new(&motions, &plan, period_ns);
    let (mut times, mut returns, mut overtaken) = (Times::default(), 0_usize, 0);
    source.read(&mut |log_ns, message| {
        let Message::Scan(message) = message else { return Ok(()) };
        let Some(stamp_ns) = times.next(message.stamp_ns, log_ns) else { return Ok(()) };
        let mut scan = joined.scan;
        let Ok(before_front_ns) = beams.fill(&message, scan.ranges_mut()) else {
            imported.impossible += 1;
            return Ok(());
        };
        let front_ns = stamp_ns.saturating_add(before_front_ns);
        if front_ns <= joined.newest_ns {
            overtaken += 1;
            return Ok(());
        }
        let Some(motion) = joined.motion(front_ns) else {
            imported.without_odometry += 1;
            return Ok(());
        };
        let (mut odometry, jump) = joined.tracked.next(&motion, Ordered::default());
        imported.jumps += u64::from(jump.is_some());
        imported.taken += 1;
        returns += scan.ranges().iter().filter(|range| **range > 0).count();
        scan.header = odometry.header;
        Ok(drive.add(&mut scan, &mut odometry, motion.time_ns + joined.after_front_ns)?)
    })?;
    imported.scan_stamps.left_out += overtaken;
    if imported.taken == 0 {
        let left_out = imported.left_out();
        return Err(refuse(
            from,
            format_args!("none of its {} scans can be used: {left_out}", imported.scans),
        ));
    }
    imported.valid_share = returns as f64 / (imported.taken * beams.geometry.count as u64) as f64;
    imported.computed = drive.computed;
    let buffer = end(drive.into_target(), imported.taken)?;
    buffer.into_inner().map_err(IntoInnerError::into_error)?.finish()?;
    Ok(imported)
}

/// Reads all but the ranges.
fn survey(from: &Path, source: &Source, options: &ImportOptions) -> anyhow::Result<Survey> {
    let (mut scan_times, mut odometry_times) = (Times::default(), Times::default());
    let (mut first, mut motions, mut stamps_ns) = (None, Vec::new(), Vec::new());
    let [mut scans, mut odometry, mut not_finite] = [0; 3];
    source.read(&mut |log_ns, message| {
        match message {
            Message::Scan(scan) => {
                scans += 1;
                stamps_ns.extend(scan_times.next(scan.stamp_ns, log_ns));
                if first.is_none() {
                    let beams = Beams::new(&scan, options.mounting);
                    let beams =
                        beams.map_err(|unusable| refuse(from, format_args!("the first scan: {unusable}")))?;
                    first = Some((beams, rays::ray_s(&scan) * scan.ranges_m.len() as f64));
                }
            }
            Message::Odometry(message) => {
                odometry += 1;
                match (motion(&message), odometry_times.next(message.stamp_ns, log_ns)) {
                    (Some(motion), Some(time_ns)) => motions.push(Motion { time_ns, ..motion }),
                    (None, _) => not_finite += 1,
                    _ => {}
                }
            }
        }
        for (count, most, what) in
            [(motions.len(), MAX_MOTIONS, "odometry"), (stamps_ns.len(), MAX_SCANS, "scans")]
        {
            if count > most {
                return Err(refuse(
                    from,
                    format_args!("more than {most} messages with {what}; cut it first"),
                ));
            }
        }
        Ok(())
    })?;
    let Some((beams, sweep_s)) = first else { return Err(refuse(from, "it has no scan")) };
    if motions.is_empty() {
        return Err(refuse(from, format_args!("none of its {odometry} messages with odometry can be used")));
    }
    let duration_ns = stamps_ns.last().zip(stamps_ns.first()).map_or(0, |(last, first)| last - first);
    if duration_ns > MAX_DURATION_NS {
        return Err(refuse(from, "its first and last scan are more than a year apart"));
    }
    let period_ns = period_ns(&stamps_ns).ok_or_else(|| refuse(from, "it has less than two scans"))?;
    let is_swept = beams.is_in_order() && sweep_s > 0.0;
    let sweep_share = if is_swept { (sweep_s * 1e9 / period_ns as f64).clamp(0.01, 1.0) } else { 0.01 };
    let geometry = beams.geometry;
    let angles_rad = [geometry.first_rad, geometry.yaw_rad(geometry.count - 1), geometry.increment_rad];
    let imported = Imported {
        file: from.display().to_string(),
        kind: source.kind(),
        topics: source.topics(),
        cut_off: source.is_cut_off()?,
        duration_s: duration_ns as f64 * 1e-9,
        scans,
        taken: 0,
        without_odometry: 0,
        impossible: 0,
        scan_stamps: scan_times.counts,
        odometry,
        not_finite,
        jumps: 0,
        odometry_stamps: odometry_times.counts,
        beams: geometry.count,
        merged: beams.merged,
        angles_deg: angles_rad.map(f64::to_degrees),
        range_m: beams.limits_m[1],
        rate_hz: 1e9 / period_ns as f64,
        valid_share: 0.0,
        computed: Computed::default(),
    };
    Ok(Survey { motions, beams, period_ns, sweep_share, imported })
}

/// The mean time between two scans, without gaps: of those near their median [ns].
fn period_ns(stamps_ns: &[u64]) -> Option<u64> {
    let mut apart_ns: Vec<u64> = stamps_ns.windows(2).map(|two| two[1] - two[0]).collect();
    apart_ns.sort_unstable();
    let median_ns = *apart_ns.get(apart_ns.len() / 2)?;
    let usual_ns = apart_ns.iter().copied().filter(|ns| ns.abs_diff(median_ns) <= median_ns / 2);
    let (sum_ns, count) = usual_ns.fold((0_u128, 0), |(sum, count), ns| (sum + u128::from(ns), count + 1));
    Some((sum_ns / count) as u64)
}

/// What a base reports, without its time; `None` for numbers that no robot has.
fn motion(message: &BaseOdometry) -> Option<Motion> {
    if !message.pose.iter().chain(&message.velocity).all(|number| number.abs() <= MAX_NUMBER) {
        return None;
    }
    let state = BaseState { pose: message.pose, velocity: message.velocity, stalled: false };
    Motion::of(&Convention::usual(Turn::YawRate, 1.0), &state, 0)
}
