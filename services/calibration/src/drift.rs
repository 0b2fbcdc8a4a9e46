//! The odometry coefficients df and dds of (7.38)-(7.40) from sine runs.
//!
//! The correction adds to the reported position, per interval, the distance times R(yaw) (df, ds), with ds growing by
//! dds per second. Both coefficients are constant, so the sum over a run is linear in them:
//!
//! ```text
//! true(T) - reported(T) = df A(T) + dds B(T),   A = sum v dt (cos, sin),   B = sum v t dt (-sin, cos)
//! ```
//!
//! Each measured position gives one row for x and one for y. The measured frame is never exactly that of the robot at
//! its start, so a shift and a small turn per run are fitted as well.
//!
//! Assumptions: the robot moves all the time (else growth with time and growth while moving differ), and its errors
//! are those of the model. Where odometry errs otherwise (a turned heading, a slipping wheel) the residual is large,
//! and the fit is refused.

use vehicle::Description;
use vehicle::bounds::{ANY_SENT_STEERING_MAX_RAD, ANY_SENT_VELOCITY_MAX_MPS};
use vehicle::frame::{to_track, wrap_angle};

use crate::backlash;
use crate::least_squares::{contradicting_row, root_mean_square, solve};
use crate::record::SineRow;
use crate::refusal::{enough, refuse_if, within};
use crate::{Estimate, FitChart, RunRefusal};

/// Fewest measured positions of one run; three coefficients of its own are fitted to them.
const MIN_MARKS: usize = 5;

/// Most runs: three coefficients are fitted to each, together.
const MAX_RUNS: usize = 200;

/// Shortest distance of a run [m].
const MIN_DISTANCE_M: f64 = 3.0;

/// Slower than this the robot stands [m/s].
pub(crate) const STANDSTILL_MPS: f64 = 0.01;

/// Longest time between two rows [s]; the yaw in between is taken as its mean.
const MAX_GAP_S: f64 = 0.5;

/// Largest residual that the model explains [m].
const LARGEST_REMAINDER_M: f64 = 0.1;

/// Result of sine runs.
#[derive(Debug, Clone, PartialEq)]
pub struct DriftFit {
    /// Share of the distance that odometry does not report, df.
    pub longitudinal: Estimate,
    /// Growth of the lateral drift, dds [1/s].
    pub lateral_rate: Estimate,
    /// Half the play between shaft and wheels [rad]; `None` when sent angles were not recorded.
    pub play: Option<Estimate>,
    /// How late the steering follows, by delay and lag together [s]; `None` when sent angles were not recorded.
    pub steering_late: Option<Estimate>,
    /// Root mean square of the residuals of corrected positions, per axis [m].
    pub residual_m: f64,
    /// How many runs.
    pub runs: usize,
    /// How many measured positions.
    pub marks: usize,
    /// Errors before and after the correction.
    pub charts: Vec<FitChart>,
}

/// One measured position of a run, with the sums up to it.
struct Mark<'a> {
    row: &'a SineRow,
    run: usize,
    /// Measured position from the first reported one on [m].
    measured: [f64; 2],
    /// Measured minus reported position [m].
    error: [f64; 2],
    /// A: distance along the heading [m].
    along: [f64; 2],
    /// B: distance times time across the heading [m s].
    across: [f64; 2],
}

/// df, dds and, where sent angles are recorded, the play of a vehicle.
///
/// # Errors
/// [`RunRefusal`] when runs are too short, marks too few, values out of range, or the errors are not those of the
/// model.
pub fn fit(rows: &[SineRow], vehicle: &Description) -> Result<DriftFit, RunRefusal> {
    let runs = split(rows)?;
    refuse_if(runs.len() > MAX_RUNS, || {
        format!("{} runs are more than {MAX_RUNS}: fit them in parts", runs.len())
    })?;
    let mut marks = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        check(run)?;
        let found = marks_of(run, index)?;
        enough("measured positions of a run", found.len(), MIN_MARKS)?;
        marks.extend(found);
    }

    let (equations, targets) = equations(&marks, runs.len());
    let solution = solve(&equations, &targets)
        .ok_or_else(|| RunRefusal::implausible("the measured positions do not determine df and dds"))?;
    if let Some((index, missed)) = contradicting_row(&equations, &targets, 0.05) {
        return Err(RunRefusal::implausible(format!(
            "{}: the measured position is {missed:.3} m off the fit to all others",
            marks[index / 2].row.place
        )));
    }
    let remainder = solution.deviation;
    refuse_if(remainder > LARGEST_REMAINDER_M, || {
        format!(
            "errors of {remainder:.3} m remain after the correction, more than {LARGEST_REMAINDER_M}: this odometry does not err as (7.38)-(7.40) describe"
        )
    })?;
    let estimate = |index: usize| {
        Estimate::new(solution.coefficients[index], solution.standard_errors[index], solution.freedom)
    };
    let (longitudinal, lateral_rate) = (estimate(0), estimate(1));
    require_range("df", longitudinal.value, 0.5)?;
    require_range("dds", lateral_rate.value, 1.0)?;
    let steering = backlash::fit(&runs, &vehicle.parameters())?;
    Ok(DriftFit {
        longitudinal,
        lateral_rate,
        play: steering.map(|[play, _]| play),
        steering_late: steering.map(|[_, late]| late),
        residual_m: root_mean_square(&solution.residuals),
        runs: runs.len(),
        marks: marks.len(),
        charts: charts(&marks, &solution.residuals),
    })
}

/// The rows of each run.
fn split(rows: &[SineRow]) -> Result<Vec<&[SineRow]>, RunRefusal> {
    let runs: Vec<&[SineRow]> = rows.chunk_by(|one, next| one.run == next.run).collect();
    enough("sine runs", runs.len(), 1)?;
    for (index, run) in runs.iter().enumerate() {
        if runs[..index].iter().any(|earlier| earlier[0].run == run[0].run) {
            return Err(RunRefusal::unreadable(
                &run[0].place,
                format!("run {} continues after another run", run[0].run),
            ));
        }
    }
    Ok(runs)
}

fn check(run: &[SineRow]) -> Result<(), RunRefusal> {
    let mut distance = 0.0;
    for row in run {
        let place = &row.place;
        within(place, "time_s", row.time_s, 0.0..=3600.0)?;
        within(place, "speed_mps", row.speed_mps, STANDSTILL_MPS..=ANY_SENT_VELOCITY_MAX_MPS)?;
        within(place, "reported_yaw_rad", row.reported_yaw_rad, -1e3..=1e3)?;
        let sent = row.sent_steering_rad.unwrap_or(0.0);
        within(place, "sent_steering_rad", sent, -ANY_SENT_STEERING_MAX_RAD..=ANY_SENT_STEERING_MAX_RAD)?;
        let places = [
            ("reported_x_m", Some(row.reported_x_m)),
            ("reported_y_m", Some(row.reported_y_m)),
            ("measured_x_m", row.measured_x_m),
            ("measured_y_m", row.measured_y_m),
        ];
        for (column, value) in places {
            within(place, column, value.unwrap_or(0.0), -1e4..=1e4)?;
        }
    }
    // (7.38) begins with the motion, so the first row must be at its start.
    within(&run[0].place, "time_s", run[0].time_s, 0.0..=MAX_GAP_S)?;
    for pair in run.windows(2) {
        let (low, high) = (pair[0].time_s + 1e-3, pair[0].time_s + MAX_GAP_S);
        within(&pair[1].place, "time_s", pair[1].time_s, low..=high)?;
        distance += pair[0].speed_mps * (pair[1].time_s - pair[0].time_s);
    }
    refuse_if(distance < MIN_DISTANCE_M, || {
        format!("run {} is {distance:.2} m long; a drift shows after {MIN_DISTANCE_M} m", run[0].run)
    })
}

fn marks_of(run: &[SineRow], index: usize) -> Result<Vec<Mark<'_>>, RunRefusal> {
    let (mut along, mut across) = ([0.0; 2], [0.0; 2]);
    let mut marks = Vec::new();
    let mut before = SineRow { time_s: 0.0, ..run[0].clone() };
    for row in run {
        let dt = row.time_s - before.time_s;
        let turn = wrap_angle(row.reported_yaw_rad - before.reported_yaw_rad);
        let (distance, yaw) = (before.speed_mps * dt, before.reported_yaw_rad + turn / 2.0);
        let middle_s = (before.time_s + row.time_s) / 2.0;
        let forward = to_track(yaw, distance, 0.0);
        let left = to_track(yaw, 0.0, distance * middle_s);
        along = [along[0] + forward.x, along[1] + forward.y];
        across = [across[0] + left.x, across[1] + left.y];
        before = row.clone();
        match (row.measured_x_m, row.measured_y_m) {
            (Some(x), Some(y)) => marks.push(Mark {
                row,
                run: index,
                measured: [x - run[0].reported_x_m, y - run[0].reported_y_m],
                error: [x - row.reported_x_m, y - row.reported_y_m],
                along,
                across,
            }),
            (None, None) => {}
            _ => {
                return Err(RunRefusal::unreadable(
                    &row.place,
                    "measured_x_m and measured_y_m have to be given both or not at all",
                ));
            }
        }
    }
    Ok(marks)
}

/// Two rows per mark: df, dds, then shift and turn of each run's frame.
fn equations(marks: &[Mark<'_>], runs: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
    let (mut equations, mut targets) = (Vec::new(), Vec::new());
    for mark in marks {
        for axis in 0..2 {
            let mut row = vec![0.0; 2 + 3 * runs];
            row[0] = mark.along[axis];
            row[1] = mark.across[axis];
            row[2 + 3 * mark.run + axis] = 1.0;
            row[4 + 3 * mark.run] = [-mark.measured[1], mark.measured[0]][axis];
            equations.push(row);
            targets.push(mark.error[axis]);
        }
    }
    (equations, targets)
}

fn require_range(name: &str, value: f64, limit: f64) -> Result<(), RunRefusal> {
    let is_outside = value.is_nan() || value.abs() > limit;
    refuse_if(is_outside, || format!("{name} = {value:.4} is outside -{limit} to {limit}"))
}

fn charts(marks: &[Mark<'_>], residuals: &[f64]) -> Vec<FitChart> {
    let raw = |axis: usize| marks.iter().map(move |mark| [mark.row.time_s, mark.error[axis]]).collect();
    let rest = marks
        .iter()
        .zip(residuals.chunks(2))
        .flat_map(|(mark, pair)| pair.iter().map(|missed| [mark.row.time_s, 1e3 * missed]))
        .collect();
    vec![
        FitChart::of_points("error of the odometry along x", "time [s]", "error [m]", raw(0)),
        FitChart::of_points("error of the odometry along y", "time [s]", "error [m]", raw(1)),
        FitChart::of_points("residual after the correction, x and y", "time [s]", "residual [mm]", rest),
    ]
}

#[cfg(test)]
mod tests;
