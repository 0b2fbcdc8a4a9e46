//! The velocity factor kv from timed straight runs.
//!
//! The robot drives with `sent / kv`; between two points of distance d it takes t = kv d / sent. Times carry the
//! error of a stopwatch, equal for all runs and found from their scatter. The distance is measured once, so its
//! error is the same in all runs and does not show in the scatter: it is added to the standard error.
//!
//! Assumption: velocity is proportional to what is sent, and both points are passed at full speed. A run that starts
//! from standstill adds a constant to the time, which is detected and refused.

use vehicle::bounds::ANY_SENT_VELOCITY_MAX_MPS;

use crate::least_squares::{contradicting_row, root_mean_square, solve};
use crate::record::StraightRun;
use crate::refusal::{enough, refuse_if, within};
use crate::{Estimate, FitChart, RunRefusal};

/// Fewest runs.
const MIN_RUNS: usize = 5;

/// Standard error of a distance of a few metres by tape measure, common to all runs [m].
pub const TAPE_ERROR_M: f64 = 0.003;

/// Smallest ratio of the largest to the smallest velocity sent, so that proportionality can be checked.
const MIN_SPREAD: f64 = 1.25;

/// Largest scatter that a stopwatch explains, as a share of the times.
const LARGEST_SCATTER: f64 = 0.03;

/// Result of straight runs.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityFit {
    /// Velocity sent per velocity driven, kv.
    pub factor: Estimate,
    /// Root mean square of the residuals of the times [s].
    pub residual_s: f64,
    /// How many runs.
    pub runs: usize,
    /// Velocities, and residuals of the times.
    pub charts: Vec<FitChart>,
}

/// The velocity factor with its standard error.
///
/// # Errors
/// [`RunRefusal`] when there are too few runs, one is out of range, or times and velocities are not in proportion.
pub fn fit(runs: &[StraightRun]) -> Result<VelocityFit, RunRefusal> {
    check(runs)?;
    let rows: Vec<Vec<f64>> = runs.iter().map(|run| vec![run.distance_m / run.sent_velocity_mps]).collect();
    let times: Vec<f64> = runs.iter().map(|run| run.time_s).collect();
    let solution =
        solve(&rows, &times).ok_or_else(|| RunRefusal::implausible("the runs do not determine a factor"))?;
    let factor = solution.coefficients[0];
    let floor = 0.05 * times.iter().copied().fold(0.0, f64::max);
    if let Some((index, missed)) = contradicting_row(&rows, &times, floor) {
        let StraightRun { place, time_s, .. } = &runs[index];
        return Err(RunRefusal::implausible(format!(
            "{place}: time_s = {time_s} does not fit the other runs, which give {:.2} s",
            time_s - missed
        )));
    }
    require_proportion(&rows, &times)?;
    let scatter = solution.deviation / (times.iter().sum::<f64>() / times.len() as f64);
    refuse_if(scatter > LARGEST_SCATTER, || {
        let (found, largest) = (100.0 * scatter, 100.0 * LARGEST_SCATTER);
        format!("times scatter by {found:.1} % about a constant factor, more than {largest:.0} %")
    })?;
    refuse_if(!(0.2..=5.0).contains(&factor), || {
        format!("a velocity factor of {factor:.3} is outside 0.2 to 5")
    })?;
    let distance = runs.iter().map(|run| run.distance_m).sum::<f64>() / runs.len() as f64;
    let standard_error = solution.standard_errors[0].hypot(factor * TAPE_ERROR_M / distance);
    Ok(VelocityFit {
        factor: Estimate::new(factor, standard_error, solution.freedom),
        residual_s: root_mean_square(&solution.residuals),
        runs: runs.len(),
        charts: charts(runs, factor, &solution.residuals),
    })
}

fn check(runs: &[StraightRun]) -> Result<(), RunRefusal> {
    for StraightRun { sent_velocity_mps, distance_m, time_s, place } in runs {
        within(place, "sent_velocity_mps", *sent_velocity_mps, 0.05..=ANY_SENT_VELOCITY_MAX_MPS)?;
        within(place, "distance_m", *distance_m, 1.0..=1000.0)?;
        within(place, "time_s", *time_s, 0.5..=36_000.0)?;
    }
    enough("straight runs", runs.len(), MIN_RUNS)?;
    let sent = || runs.iter().map(|run| run.sent_velocity_mps);
    let (low, high) = (sent().fold(f64::INFINITY, f64::min), sent().fold(0.0, f64::max));
    refuse_if(high < MIN_SPREAD * low, || {
        format!(
            "sent velocities from {low} to {high} m/s are too much alike to tell a factor from a delay; the largest must be {MIN_SPREAD} times the smallest"
        )
    })
}

/// Refuses times that contain a constant in addition to their proportional part.
fn require_proportion(rows: &[Vec<f64>], times: &[f64]) -> Result<(), RunRefusal> {
    let rows: Vec<Vec<f64>> = rows.iter().map(|row| vec![row[0], 1.0]).collect();
    let Some(solution) = solve(&rows, times) else { return Ok(()) };
    let (constant, error) = (solution.coefficients[1], solution.standard_errors[1]);
    // Five standard errors are not reached by chance; a hand may be late by a tenth of a second.
    refuse_if(constant.abs() > 5.0 * error && constant.abs() > 0.1, || {
        format!(
            "times contain a constant {constant:.2} s in addition to the part in proportion to the velocity; pass both points at full speed"
        )
    })
}

fn charts(runs: &[StraightRun], factor: f64, residuals: &[f64]) -> Vec<FitChart> {
    let fastest = runs.iter().map(|run| run.sent_velocity_mps).fold(0.0, f64::max);
    let driven = runs.iter().map(|run| [run.sent_velocity_mps, run.distance_m / run.time_s]).collect();
    let missed = runs.iter().zip(residuals).map(|(run, missed)| [run.sent_velocity_mps, *missed]).collect();
    let title = format!("straight runs, kv = {factor:.4}");
    vec![
        FitChart {
            line: vec![[0.0, 0.0], [fastest, fastest / factor]],
            ..FitChart::of_points(&title, "velocity sent [m/s]", "velocity driven [m/s]", driven)
        },
        FitChart::of_points("residuals of the times", "velocity sent [m/s]", "residual [s]", missed),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn runs(times: &[(f64, f64)]) -> Vec<StraightRun> {
        let run = |(index, (sent, time)): (usize, &(f64, f64))| StraightRun {
            sent_velocity_mps: *sent,
            distance_m: 5.0,
            time_s: *time,
            place: format!("runs.csv: line {}", index + 2),
        };
        times.iter().enumerate().map(run).collect()
    }

    fn reason(times: &[(f64, f64)]) -> String {
        fit(&runs(times)).unwrap_err().to_string()
    }

    #[test]
    fn five_metres_in_seven_seconds_at_one_metre_per_second_sent_are_a_factor_of_1_4() {
        let fit = fit(&runs(&[(1.0, 7.0), (1.0, 7.0), (0.5, 14.0), (0.7, 10.0), (1.4, 5.0)])).unwrap();
        assert!((fit.factor.value - 1.4).abs() < 1e-12);
        // Without scatter the tape measure remains: 1.4 * 0.003 / 5.
        assert!((fit.factor.standard_error - 8.4e-4).abs() < 1e-9);
    }

    #[test]
    fn too_few_or_too_similar_runs_are_refused() {
        assert_eq!(reason(&[(1.0, 7.0); 4]), "4 straight runs are too few: at least 5 are needed");
        assert!(reason(&[(1.0, 7.0); 6]).contains("too much alike"));
    }

    #[test]
    fn a_value_outside_its_range_is_refused_with_its_line() {
        let text = reason(&[(1.0, 7.0), (30.0, 2.0), (0.5, 14.0), (0.7, 10.0), (1.4, 5.0)]);
        assert_eq!(text, "runs.csv: line 3: sent_velocity_mps = 30 is not allowed: 0.05 to 20");
        assert!(reason(&[(1.0, f64::NAN); 6]).contains("time_s = NaN"));
    }

    #[test]
    fn a_mistyped_time_is_named() {
        let text = reason(&[(1.0, 7.02), (1.0, 6.98), (0.5, 14.05), (0.7, 19.0), (1.4, 5.0), (1.2, 5.8)]);
        assert!(text.contains("runs.csv: line 5: time_s = 19 does not fit the other runs"), "{text}");
    }

    #[test]
    fn runs_from_standstill_are_refused() {
        let text = reason(&[(1.0, 7.5), (1.1, 6.87), (0.5, 14.51), (0.7, 10.49), (1.4, 5.51), (0.6, 12.16)]);
        assert!(text.contains("constant 0.5"), "{text}");
    }

    #[test]
    fn an_absurd_factor_or_scatter_is_refused() {
        assert!(
            reason(&[(1.0, 50.0), (0.5, 100.0), (0.8, 62.5), (1.4, 35.7), (1.2, 41.7)])
                .contains("outside 0.2 to 5")
        );
        let scattered = [(1.0, 7.6), (1.0, 6.5), (0.5, 13.0), (0.5, 15.1), (0.7, 10.6), (0.7, 9.3)];
        assert!(reason(&scattered).contains("times scatter by"), "{}", reason(&scattered));
    }
}
