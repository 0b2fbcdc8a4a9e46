//! The steering map from steady circle runs, and its inverse.
//!
//! Chord s and height h of a driven arc give its radius, R = s^2 / (8 h) + h / 2; the geometry of axles that steer by
//! the same angle in opposite directions gives the realised angle, tan(u2) = (lh + lv) / (2 R); that of another vehicle is the
//! angle of its model. A network of six
//! hidden neurons is fitted to the pairs of sent and realised angles. It is smooth, so the scatter of single runs
//! averages out; its inverse, a second network, is fitted to the first one and corrects the commands.
//!
//! Play between shaft and wheels splits the map in two: the wheels stay behind by the play, to the side that the
//! shaft came from. Where an angle was approached from both sides, the play is half of the difference; the map is
//! that of the shaft, in the middle.
//!
//! The model (7.29) is the small-angle form of this geometry; the difference, a third of the cube of the angle
//! (0.07 mrad at 0.06 rad), is counted as an error.
//!
//! Assumptions: the turn is steady, and slow enough for the kinematic geometry (0.15 % of the angle at 1 m/s, less
//! below). The arc is at most half a circle. Outside of the angles driven the map is unknown, so desired angles
//! that no run realised are refused.

mod network_error;
mod play;

use vehicle::bounds::ANY_SENT_STEERING_MAX_RAD;
use vehicle::network::{MIN_SAMPLES, SteeringNetwork, train};
use vehicle::{Description, Parameters, VehicleModel};

use crate::least_squares::{outlier, root_mean_square};
use crate::record::{ApproachSide, CircleRun};
use crate::refusal::{enough, refuse_if, within};
use crate::{Estimate, FitChart, RunRefusal};

use network_error::NetworkError;

/// Largest step between neighbouring sent angles, as a share of the largest desired one: a bend of the map within a larger one
/// would be missed.
const LARGEST_STEP: f64 = 0.2;

/// Largest scatter about a smooth map that a tape measure explains, as such a share.
const LARGEST_SCATTER: f64 = 1.0 / 12.0;

/// Residuals below this share never make a single run an outlier.
const DOUBTFUL: f64 = 1.0 / 15.0;

/// Largest error of the inverse network against the map it was fitted to, as such a share.
const LARGEST_INVERSION: f64 = 1.0 / 60.0;

/// A run that was steered by more than this share turns to that side.
const STEERED: f64 = 0.5;

/// Smallest slope of the map, realised per sent, that can be inverted.
const SMALLEST_SLOPE: f64 = 0.2;

/// Realised angles up to this share are fitted by the inverse: a little more than desired, so that its ends are good.
const INVERTED: f64 = 1.0 + 8.0 / 60.0;

/// Result of circle runs.
#[derive(Debug, Clone, PartialEq)]
pub struct SteeringFit {
    /// Realised angle for the angle sent.
    pub map: SteeringNetwork,
    /// Angle to send for the angle desired: what corrects commands.
    pub inverse: SteeringNetwork,
    /// Half the play between shaft and wheels [rad]; `None` when no angle was approached from both sides.
    pub play: Option<Estimate>,
    /// Realised angle over the desired range, with its error.
    pub points: Vec<MapPoint>,
    /// Largest error over the third of the runs that the map was not fitted to [rad].
    pub held_out_rad: f64,
    /// Root mean square of the residuals of single runs [rad].
    pub residual_rad: f64,
    /// Sent angles that were driven, the smallest and the largest [rad].
    pub sent_range_rad: [f64; 2],
    /// How many runs.
    pub runs: usize,
    /// Angles, and residuals of the map.
    pub charts: Vec<FitChart>,
}

/// One angle of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// Desired angle [rad].
    pub desired_rad: f64,
    /// Angle to send for it [rad].
    pub sent_rad: f64,
    /// Angle that is realised then; about the desired one [rad].
    pub realised_rad: Estimate,
}

/// Steering angle that drives the arc with a chord and a height [rad]: of the SUMMIT tan(u2) = (lh + lv) / (2 R).
///
/// The curvature 1 / R = 8 h / (s^2 + 4 h^2) stays finite for a straight line.
pub fn realised_angle(parameters: &Parameters, chord_m: f64, height_m: f64) -> f64 {
    parameters.steering_of(8.0 * height_m / (chord_m * chord_m + 4.0 * height_m * height_m))
}

/// 1 where the model is the small-angle form of the geometry of the arc, which is an error, and 0 where it is the geometry.
fn small_angle(parameters: &Parameters) -> f64 {
    f64::from(u8::from(parameters.model == VehicleModel::CounterSteered))
}

/// Map, inverse and play of a vehicle with their errors.
///
/// # Errors
/// [`RunRefusal`] when runs are too few, out of range, do not cover the desired angles, or are not on one smooth
/// rising curve.
pub fn fit(runs: &[CircleRun], vehicle: &Description) -> Result<SteeringFit, RunRefusal> {
    let desired_max_rad = vehicle.bounds.steering_max_rad;
    check(runs, desired_max_rad)?;
    let parameters = vehicle.parameters();
    let of_run = |run: &CircleRun| realised_angle(&parameters, run.chord_m, run.height_m);
    let realised: Vec<f64> = runs.iter().map(of_run).collect();
    check_directions(runs, &realised, STEERED * desired_max_rad)?;
    let play = play::estimate(runs, &realised, small_angle(&parameters));
    let half_play = play.map_or(0.0, |play| play.value);
    let shaft = |(run, wheels): (&CircleRun, &f64)| match run.approached_from {
        Some(ApproachSide::Below) => wheels + half_play,
        Some(ApproachSide::Above) => wheels - half_play,
        None => *wheels,
    };
    let samples: Vec<(f64, f64)> =
        runs.iter().zip(&realised).map(|pair| (pair.0.sent_steering_rad, shaft(pair))).collect();

    let trained = train(&samples).map_err(|error| RunRefusal::implausible(error.to_string()))?;
    let map = trained.network;
    let residuals: Vec<f64> = samples.iter().map(|(sent, angle)| angle - map.eval(*sent)).collect();
    require_smooth(runs, &residuals, desired_max_rad)?;
    let sent_range_rad = range(samples.iter().map(|sample| sample.0));
    let inverse = invert(&map, sent_range_rad, desired_max_rad)?;
    let error = NetworkError::of(&map, &samples, small_angle(&parameters))
        .ok_or_else(|| RunRefusal::implausible("the runs do not determine a steering map"))?;
    let points = (-6..=6)
        .map(|step| {
            let desired_rad = desired_max_rad * f64::from(step) / 6.0;
            let sent_rad = inverse.eval(desired_rad);
            MapPoint { desired_rad, sent_rad, realised_rad: error.at(sent_rad) }
        })
        .collect();
    Ok(SteeringFit {
        map,
        inverse,
        play,
        points,
        held_out_rad: trained.held_out_error,
        residual_rad: root_mean_square(&residuals),
        sent_range_rad,
        runs: runs.len(),
        charts: charts(&samples, &residuals, &map, sent_range_rad),
    })
}

fn check(runs: &[CircleRun], desired_max_rad: f64) -> Result<(), RunRefusal> {
    for CircleRun { sent_steering_rad, chord_m, height_m, place, .. } in runs {
        within(
            place,
            "sent_steering_rad",
            *sent_steering_rad,
            -ANY_SENT_STEERING_MAX_RAD..=ANY_SENT_STEERING_MAX_RAD,
        )?;
        within(place, "chord_m", *chord_m, 0.3..=100.0)?;
        // Half a circle: a higher arc has the same chord as a flatter one.
        within(place, "height_m", *height_m, -chord_m / 2.0..=chord_m / 2.0)?;
    }
    enough("circle runs", runs.len(), MIN_SAMPLES)?;
    let mut sent: Vec<f64> = runs.iter().map(|run| run.sent_steering_rad).collect();
    sent.sort_by(f64::total_cmp);
    let step_rad = LARGEST_STEP * desired_max_rad;
    if let Some(pair) = sent.windows(2).find(|pair| pair[1] - pair[0] > step_rad) {
        return Err(RunRefusal::implausible(format!(
            "no run between sent angles of {:.4} and {:.4} rad; neighbours may be {step_rad:.3} rad apart",
            pair[0], pair[1]
        )));
    }
    Ok(())
}

/// Refuses a run that turned away from the side it was steered to; most often the sign of the height was forgotten.
fn check_directions(runs: &[CircleRun], realised: &[f64], steered_rad: f64) -> Result<(), RunRefusal> {
    let wrong = runs.iter().zip(realised).find(|(run, angle)| {
        run.sent_steering_rad.abs() > steered_rad && run.sent_steering_rad * **angle < 0.0
    });
    match wrong {
        None => Ok(()),
        Some((run, _)) => Err(RunRefusal::OutsideRange {
            place: run.place.clone(),
            column: "height_m",
            value: run.height_m,
            allowed: "the sign of the angle sent: positive for a left turn".to_owned(),
        }),
    }
}

fn require_smooth(runs: &[CircleRun], residuals: &[f64], desired_max_rad: f64) -> Result<(), RunRefusal> {
    let scatter = root_mean_square(residuals);
    if let Some(index) = outlier(residuals, DOUBTFUL * desired_max_rad) {
        return Err(RunRefusal::implausible(format!(
            "{}: the run is {:.4} rad off the map through all others; a wrong value, or play that was not taken up on the way to the angle",
            runs[index].place, residuals[index]
        )));
    }
    let largest_rad = LARGEST_SCATTER * desired_max_rad;
    refuse_if(scatter > largest_rad, || {
        format!(
            "runs scatter by {scatter:.4} rad about a smooth map, more than {largest_rad:.3}; was approached_from left out for a steering with play?"
        )
    })
}

/// The network that gives back the sent angle of a realised one.
///
/// It is fitted where the map rises without a break from the middle outwards: the outermost angles have neighbours on
/// one side only, where the map is not reliable.
fn invert(
    map: &SteeringNetwork,
    [low, high]: [f64; 2],
    desired_max_rad: f64,
) -> Result<SteeringNetwork, RunRefusal> {
    const GRID: usize = 240;
    let sent = |index: usize| low + (high - low) * index as f64 / GRID as f64;
    let middle = (0..=GRID)
        .min_by(|one, other| map.eval(sent(*one)).abs().total_cmp(&map.eval(sent(*other)).abs()))
        .unwrap_or_default();
    let usable = |index: &usize| {
        map.derivative(sent(*index)) >= SMALLEST_SLOPE
            && map.eval(sent(*index)).abs() <= INVERTED * desired_max_rad
    };
    let below = (0..=middle).rev().take_while(usable);
    let above = (middle..=GRID).skip(1).take_while(usable);
    let mut samples: Vec<(f64, f64)> =
        below.chain(above).map(|index| (map.eval(sent(index)), sent(index))).collect();
    samples.sort_by(|one, other| one.0.total_cmp(&other.0));
    let [least, most] = range(samples.iter().map(|sample| sample.0));
    let [first, last] = range(samples.iter().map(|sample| sample.1));
    refuse_if(!(least <= -desired_max_rad && most >= desired_max_rad), || {
        format!(
            "the map rises from sent angles of {first:.4} to {last:.4} rad only, of {low:.4} to {high:.4} rad driven, and realises {least:.4} to {most:.4} rad there; -{desired_max_rad} to {desired_max_rad} rad have to be covered (`vehicle.bounds.steering_max_rad`)"
        )
    })?;
    let inverse = train(&samples).map_err(|error| RunRefusal::implausible(error.to_string()))?.network;
    let desired = |index: usize| desired_max_rad * (2.0 * index as f64 / GRID as f64 - 1.0);
    let worst = (0..=GRID)
        .map(|index| (map.eval(inverse.eval(desired(index))) - desired(index)).abs())
        .fold(0.0, f64::max);
    let rises = (0..=GRID).all(|index| inverse.derivative(desired(index)) > 0.0);
    let largest_rad = LARGEST_INVERSION * desired_max_rad;
    refuse_if(worst > largest_rad || !rises, || {
        format!(
            "the inverse network is {worst:.5} rad off the map, more than {largest_rad:.4}, or does not rise: the map is too wavy; more runs, or longer arcs, make it smooth"
        )
    })?;
    Ok(inverse)
}

fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
}

fn charts(
    samples: &[(f64, f64)],
    residuals: &[f64],
    map: &SteeringNetwork,
    [low, high]: [f64; 2],
) -> Vec<FitChart> {
    let line = (0..=100).map(|step| low + (high - low) * f64::from(step) / 100.0);
    let driven = samples.iter().map(|(sent, angle)| [*sent, *angle]).collect();
    let missed = samples.iter().zip(residuals).map(|((sent, _), missed)| [*sent, 1e3 * missed]).collect();
    vec![
        FitChart {
            line: line.map(|sent| [sent, map.eval(sent)]).collect(),
            ..FitChart::of_points(
                "circle runs without the play",
                "angle sent [rad]",
                "angle realised [rad]",
                driven,
            )
        },
        FitChart::of_points("residuals of the map", "angle sent [rad]", "residual [mrad]", missed),
    ]
}

#[cfg(test)]
mod tests;
