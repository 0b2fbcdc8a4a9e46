//! Play of the steering from sine runs.
//!
//! While the shaft moves from one turning point of the sine to the other, the wheels lag by half the play. Their angle
//! shows in the reported yaw. The fit predicts that yaw: the sent angles pass through a map (a polynomial of third
//! degree with fitted coefficients), the play, and the lateral model (7.27), (7.29) at the reported speed. So the lag
//! of the robot, which looks much like play, is modelled too. How late the steering follows, by delay and lag together, is fitted:
//! play makes the wheels stand still where the shaft turns round, and being late does not.
//!
//! The initial angle of the wheels is not known; a run counts from its first turning point on, where the shaft has
//! moved the wheels. Assumptions: the amplitude is at least three times the play, and each sent angle acts from its
//! row on, but for that.

use nalgebra::{Matrix2, SMatrix, Vector2};
use vehicle::frame::wrap_angle;
use vehicle::model::lateral_jacobians;
use vehicle::{Control, Parameters};

use crate::least_squares::{Solution, solve};
use crate::record::SineRow;
use crate::refusal::refuse_if;
use crate::{Estimate, RunRefusal};

/// Fewest rows behind the first turning points.
const MIN_ROWS: usize = 50;

/// Largest number of steps of the fit; from the starting values it takes three to five.
const MAX_STEPS: usize = 25;

/// Coefficients of the map, 1 to 3, a constant, half the play, and how late the steering is [s].
const SHARED: usize = 6;
const PLAY: usize = 4;
const LATE: usize = 5;

/// The steering is at most so late [s].
const MAX_LATE_S: f64 = 1.0;

/// Unit of the sent angle in the polynomial [rad].
const SCALE_RAD: f64 = 0.1;

/// Error of the fit without noise, because the lateral model is linear in the angle here [rad]: five times the 2e-6
/// found on the emulated robot at twice the intended speed.
const MODEL_ERROR_RAD: f64 = 1e-5;

/// The part of a run behind its first turning point.
struct Course {
    /// The whole run: times of its rows [s], and the angle sent from each on [rad].
    run: Vec<(f64, f64)>,
    /// Its row that is the first one of this part.
    first: usize,
    /// Reported yaw without jumps [rad].
    yaw: Vec<f64>,
    /// The effect of each interval on (sideslip, yaw rate, yaw).
    passages: Vec<Passage>,
    /// Whether the shaft moved to the left up to the first row.
    from_below: bool,
}

/// Exact solution of the lateral model over one interval under a constant wheel angle.
#[derive(Clone, Copy)]
struct Passage {
    /// By sideslip, yaw rate, yaw and angle, to the first three.
    matrix: SMatrix<f64, 4, 4>,
}

/// Half the play, and how late the steering follows [s]; `None` when sent angles are not recorded, or turn back too rarely.
///
/// # Errors
/// [`RunRefusal::Implausible`] when no play and no map explain the reported yaw.
pub(crate) fn fit(runs: &[&[SineRow]], vehicle: &Parameters) -> Result<Option<[Estimate; 2]>, RunRefusal> {
    let Some(courses) = runs.iter().map(|run| Course::of(run, vehicle)).collect::<Option<Vec<Course>>>()
    else {
        return Ok(None);
    };
    let rows: usize = courses.iter().map(|course| course.yaw.len()).sum();
    if rows < MIN_ROWS {
        return Ok(None);
    }
    let mut parameters = vec![0.0; SHARED + courses.len()];
    (parameters[0], parameters[PLAY], parameters[LATE]) = (1.0, 0.003, 0.03);
    for (index, course) in courses.iter().enumerate() {
        parameters[SHARED + index] = course.yaw[0];
    }
    for _ in 0..MAX_STEPS {
        let missed = residuals(&courses, &parameters);
        let slopes = slopes(&courses, &parameters, &missed);
        let Some(solution) = solve(&slopes, &missed) else { return Ok(None) };
        for (parameter, step) in parameters.iter_mut().zip(&solution.coefficients) {
            *parameter += step;
        }
        parameters[PLAY] = parameters[PLAY].max(0.0);
        parameters[LATE] = parameters[LATE].clamp(0.0, MAX_LATE_S);
        // A micrometre of play at the rim of a wheel is beyond any use.
        if solution.coefficients.iter().take(SHARED).all(|step| step.abs() < 1e-7) {
            return judge(&parameters, &solution).map(Some);
        }
    }
    // Without play the step always points below zero and never gets small: the last value holds.
    let missed = residuals(&courses, &parameters);
    let last = solve(&slopes(&courses, &parameters, &missed), &missed);
    last.map(|last| judge(&parameters, &last)).transpose()
}

fn judge(parameters: &[f64], solution: &Solution) -> Result<[Estimate; 2], RunRefusal> {
    let (play, deviation) = (parameters[PLAY], solution.deviation);
    // A tenth of a radian of yaw is ten times the noise of a good odometer.
    refuse_if(deviation > 0.1 || play > 0.05, || {
        format!(
            "reported yaw is {deviation:.3} rad off the yaw of the sent angles with a play of {play:.4} rad"
        )
    })?;
    let error = solution.standard_errors[PLAY].hypot(MODEL_ERROR_RAD);
    let late = Estimate::new(parameters[LATE], solution.standard_errors[LATE], solution.freedom);
    Ok([Estimate::new(play, error, solution.freedom), late])
}

impl Course {
    fn of(run: &[SineRow], vehicle: &Parameters) -> Option<Self> {
        let sent: Vec<f64> = run.iter().map(|row| row.sent_steering_rad).collect::<Option<_>>()?;
        let (turning, from_below) = first_turning(&sent)?;
        let rows = &run[turning..];
        let mut yaw = vec![rows[0].reported_yaw_rad];
        for pair in rows.windows(2) {
            yaw.push(yaw[yaw.len() - 1] + wrap_angle(pair[1].reported_yaw_rad - pair[0].reported_yaw_rad));
        }
        let mut passages: Vec<Passage> = Vec::with_capacity(rows.len());
        let mut last = None;
        for pair in rows.windows(2) {
            let key = (pair[0].speed_mps, pair[1].time_s - pair[0].time_s);
            let passage = match (last, passages.last()) {
                (Some(before), Some(passage)) if before == key => *passage,
                _ => Passage::new(vehicle, key.0, key.1),
            };
            last = Some(key);
            passages.push(passage);
        }
        let run = run.iter().map(|row| row.time_s).zip(sent).collect();
        Some(Self { from_below, run, first: turning, yaw, passages })
    }

    /// The mean angle sent from a row to the next, so much earlier [rad].
    fn sent_before(&self, row: usize, late_s: f64) -> f64 {
        let [from_s, to_s] = [row, row + 1].map(|row| self.run[row].0 - late_s);
        let (mut sum, mut at_s) = (0.0, from_s);
        let first = self.run.partition_point(|(time_s, _)| *time_s <= from_s).saturating_sub(1);
        for (index, (_, sent)) in self.run.iter().enumerate().skip(first) {
            let end_s = self.run.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
            sum += sent * (end_s - at_s).max(0.0);
            at_s = at_s.max(end_s);
            if end_s >= to_s {
                break;
            }
        }
        sum / (to_s - from_s)
    }

    /// The yaw at each row for a map, a play and a yaw at the first row.
    fn predict(&self, shared: &[f64], first_yaw: f64, out: &mut Vec<f64>) {
        let shaft = |sent: f64| {
            let share = sent / SCALE_RAD;
            SCALE_RAD * share * (shared[0] + share * (shared[1] + share * shared[2])) + shared[3]
        };
        let play = shared[PLAY].max(0.0);
        let late_s = shared[LATE].max(0.0);
        let start = shaft(self.sent_before(self.first, late_s));
        let mut wheels = if self.from_below { start - play } else { start + play };
        // In the quasi-steady turn: at a turning point the angle hardly changes.
        let mut state = self.passages.first().map_or([0.0; 2], |passage| passage.steady(wheels));
        let mut yaw = first_yaw;
        out.push(yaw);
        for (row, passage) in (self.first..).zip(&self.passages) {
            let shaft = shaft(self.sent_before(row, late_s));
            wheels = wheels.clamp(shaft - play, shaft + play);
            let row = |index: usize| {
                let matrix = &passage.matrix;
                matrix[(index, 0)] * state[0] + matrix[(index, 1)] * state[1] + matrix[(index, 3)] * wheels
            };
            let (sideslip, rate, turn) = (row(0), row(1), row(2));
            state = [sideslip, rate];
            yaw += turn;
            out.push(yaw);
        }
    }
}

/// The first row at which the sent angle is about to turn round, and whether it rose until there.
fn first_turning(sent: &[f64]) -> Option<(usize, bool)> {
    let mut rising = None;
    for (index, pair) in sent.windows(2).enumerate() {
        if pair[1] == pair[0] {
            continue;
        }
        let rises = pair[1] > pair[0];
        if rising.is_some_and(|before| before != rises) {
            return Some((index, !rises));
        }
        rising = Some(rises);
    }
    None
}

impl Passage {
    fn new(vehicle: &Parameters, speed: f64, duration: f64) -> Self {
        let control = Control { velocity: speed.max(0.05), steering: 0.0 };
        let (by_state, by_control) = lateral_jacobians(vehicle, 0.0, 0.0, &control);
        let mut rates = SMatrix::<f64, 4, 4>::zeros();
        for row in 0..2 {
            (rates[(row, 0)], rates[(row, 1)]) = (by_state[row][0], by_state[row][1]);
            rates[(row, 3)] = by_control[row][1];
        }
        rates[(2, 1)] = 1.0;
        Self { matrix: (rates * duration).exp() }
    }

    /// Sideslip and yaw rate of the steady turn.
    fn steady(&self, wheels: f64) -> [f64; 2] {
        let matrix = self.matrix;
        let own = Matrix2::new(1.0 - matrix[(0, 0)], -matrix[(0, 1)], -matrix[(1, 0)], 1.0 - matrix[(1, 1)]);
        let forced = Vector2::new(matrix[(0, 3)], matrix[(1, 3)]) * wheels;
        own.lu().solve(&forced).map_or([0.0; 2], |state| [state[0], state[1]])
    }
}

fn predictions(courses: &[Course], parameters: &[f64]) -> Vec<f64> {
    let mut out = Vec::new();
    for (index, course) in courses.iter().enumerate() {
        course.predict(&parameters[..SHARED], parameters[SHARED + index], &mut out);
    }
    out
}

fn residuals(courses: &[Course], parameters: &[f64]) -> Vec<f64> {
    let reported = courses.iter().flat_map(|course| &course.yaw);
    reported.zip(predictions(courses, parameters)).map(|(yaw, predicted)| yaw - predicted).collect()
}

/// Derivatives of the predicted yaw by forward differences, one row per sample.
fn slopes(courses: &[Course], parameters: &[f64], missed: &[f64]) -> Vec<Vec<f64>> {
    const STEP: f64 = 1e-6;
    let mut slopes = vec![vec![0.0; parameters.len()]; missed.len()];
    for column in 0..parameters.len() {
        let mut moved = parameters.to_vec();
        moved[column] += STEP;
        for ((slope, before), after) in slopes.iter_mut().zip(missed).zip(residuals(courses, &moved)) {
            slope[column] = (before - after) / STEP;
        }
    }
    slopes
}
