//! The figures of all conditions.

use emulator::Outcome;
use serde::Serialize;

use super::EstimatorArguments;
use super::course::Condition;
use super::drive::Drive;
use super::tally::{Moment, Tally, bounds_95};

/// The time of a drive is shown in at most this many parts.
const PARTS: usize = 60;

/// The figures of one condition, over all its scans.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Row {
    pub(super) scenario: &'static str,
    pub(super) robot: &'static str,
    pub(super) laser: &'static str,
    pub(super) runs: u64,
    pub(super) reached: u64,
    pub(super) stopped: u64,
    pub(super) missed: u64,
    pub(super) collision: u64,
    pub(super) scans: u64,
    /// Scans without a pose.
    pub(super) without_pose: u64,
    pub(super) rms_m: f64,
    pub(super) max_m: f64,
    pub(super) yaw_rms_rad: f64,
    pub(super) coverage_95: Option<f64>,
    pub(super) nees_mean: Option<f64>,
    /// What contains the mean NEES of a consistent filter with 95 %, if each run counts once: errors last.
    pub(super) nees_bounds_95: Option<[f64; 2]>,
    pub(super) nis_mean: Option<f64>,
    /// The same for the NIS, of which each scan counts.
    pub(super) nis_bounds_95: Option<[f64; 2]>,
    /// Median over the time of stated sigma over error of the position.
    pub(super) sigma_over_error: Option<f64>,
    pub(super) over_time: Vec<Moment>,
    /// What was learned and is wrong at the end, at most: steering offset [rad], factor of the velocity, fraction of the distance.
    pub(super) unlearned: [f64; 3],
}

/// What the command prints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Results {
    pub(super) way_m: f64,
    pub(super) seeds: u64,
    /// The estimates.
    pub(super) rows: Vec<Row>,
    /// The odometer without a filter, in the drives of the first setting.
    pub(super) odometer: Vec<Row>,
}

impl Results {
    /// Of the drives of all conditions, as many for each.
    pub(super) fn of(conditions: &[Condition], drives: &[Drive], arguments: &EstimatorArguments) -> Self {
        let seeds = drives.len() / conditions.len().max(1);
        let with_drives = || conditions.iter().zip(drives.chunks(seeds.max(1)));
        let odometer = with_drives()
            .filter(|(condition, _)| condition.is_first_setting())
            .map(|(condition, drives)| Row::of(condition, drives, |drive| &drive.odometer));
        Self {
            way_m: arguments.way,
            seeds: arguments.seeds,
            rows: with_drives()
                .map(|(condition, drives)| Row::of(condition, drives, |drive| &drive.estimate))
                .collect(),
            odometer: odometer.collect(),
        }
    }
}

impl Row {
    fn of(condition: &Condition, drives: &[Drive], tally: impl Fn(&Drive) -> &Tally) -> Self {
        let mut all = Tally::default();
        drives.iter().for_each(|drive| all.merge(tally(drive)));
        let ended = |outcome| drives.iter().filter(|drive| drive.outcome == outcome).count() as u64;
        let runs = drives.len() as u64;
        let nees_mean = all.nees().mean();
        Self {
            scenario: condition.ground.name(),
            robot: condition.robot,
            laser: condition.laser,
            runs,
            reached: ended(Outcome::Reached),
            stopped: ended(Outcome::Stopped),
            missed: ended(Outcome::Missed),
            collision: ended(Outcome::Collision),
            scans: all.squares_m2.count,
            without_pose: drives.iter().map(|drive| drive.without_pose).sum(),
            rms_m: all.squares_m2.mean().unwrap_or_default().sqrt(),
            max_m: all.max_m,
            yaw_rms_rad: all.yaw_squares_rad2.mean().unwrap_or_default().sqrt(),
            coverage_95: all.inside.mean(),
            nees_mean,
            nees_bounds_95: nees_mean.and_then(|_| bounds_95(runs)),
            nis_mean: all.nis.mean(),
            nis_bounds_95: bounds_95(all.nis.count),
            sigma_over_error: all.sigma_over_error(),
            over_time: all.over_time(PARTS),
            unlearned: std::array::from_fn(|place| {
                drives.iter().map(|drive| drive.unlearned[place].abs()).fold(0.0, f64::max)
            }),
        }
    }
}
