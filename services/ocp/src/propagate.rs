//! Converged collocation from start and control alone, for roll-outs and design analyses.

use vehicle::{Control, State};

use crate::collocation::{Collocation, MAX_STAGES};
use crate::interval::{Interval, Linearisation, StageValues, settle};
use crate::model::LateralModel;
use crate::problem::Trajectory;

/// States at nodes 0 to N under piecewise constant controls; `None` where the collocation does not converge.
pub fn roll_out(
    model: &dyn LateralModel,
    collocation: &Collocation,
    initial: &State,
    controls: &[Control],
    intervals: &[f64],
) -> Option<Trajectory> {
    let mut states = Vec::with_capacity(controls.len() + 1);
    let mut state = *initial;
    states.push(state);
    for (control, &length) in controls.iter().zip(intervals) {
        state = propagate(model, collocation, length, &state, control)?.end;
        states.push(state);
    }
    Some(Trajectory { states, controls: controls.to_vec() })
}

/// End state of an interval with its exact sensitivities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Propagation {
    /// State at the end.
    pub end: State,
    /// Derivatives by the start state, row by row, in the order (sideslip, yaw, yaw rate, x, y).
    pub by_state: [[f64; 5]; 5],
    /// Derivatives by (velocity, steering), row by row.
    pub by_control: [[f64; 2]; 5],
}

/// Solves the collocation equations of one interval of `length` [s]; `None` when they do not converge.
pub fn propagate(
    model: &dyn LateralModel,
    collocation: &Collocation,
    length: f64,
    start: &State,
    control: &Control,
) -> Option<Propagation> {
    let interval = Interval { model, collocation, length };
    let (linearisation, _) = converge(&interval, start, control)?;
    Some(Propagation {
        end: State::from_vector(&linearisation.end.into()),
        by_state: linearisation.by_state(),
        by_control: linearisation.by_control,
    })
}

/// The linearisation at the solution of the collocation equations, and their stage values.
///
/// Newton starts from the start's values at all stages. The equations are nearly linear in (sideslip, yaw rate):
/// three to five steps are usual.
pub fn converge(
    interval: &Interval,
    start: &State,
    control: &Control,
) -> Option<(Linearisation, StageValues)> {
    /// Many times the usual count.
    const NEWTON_STEPS: usize = 30;
    /// Rounding level of values of order one, with room for h times the stiff Jacobian.
    const TOLERANCE: f64 = 1e-13;
    let start: [f64; 5] = start.to_vector().into();
    let control = [control.velocity, control.steering];
    let mut stages = [[start[0], start[2]]; MAX_STAGES];
    let (linearisation, _) = settle(interval, &start, &control, &mut stages, NEWTON_STEPS, TOLERANCE, true)?;
    Some((linearisation, stages))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collocation::Scheme;
    use crate::interval::linearise;
    use proptest::prelude::*;
    use vehicle::{Parameters, integrate};

    fn state(sideslip: f64, yaw: f64, yaw_rate: f64) -> State {
        State { sideslip, yaw, yaw_rate, x: 1.0, y: -0.2 }
    }

    proptest! {
        #[test]
        fn sensitivities_agree_with_central_differences(
            sideslip in -0.15..0.15f64, yaw in -3.0..3.0f64, yaw_rate in -0.8..0.8f64,
            velocity in 0.11..1.0f64, steering in -0.06..0.06f64, which in 0..8usize,
        ) {
            let parameters = Parameters::default();
            let collocation = Collocation::new(Scheme::ALL[which]);
            let run = |start: &State, control: &Control| {
                propagate(&parameters, &collocation, 0.4533, start, control).expect("Newton converges")
            };
            let start = state(sideslip, yaw, yaw_rate);
            let control = Control { velocity, steering };
            let centre = run(&start, &control);
            let step = 1e-5;
            for column in 0..5 {
                let shifted = |sign: f64| {
                    let mut vector = start.to_vector();
                    vector[column] += sign * step;
                    run(&State::from_vector(&vector), &control).end.to_vector()
                };
                let difference = (shifted(1.0) - shifted(-1.0)) / (2.0 * step);
                for row in 0..5 {
                    // Newton leaves 1e-13 and the step is 1e-5; third derivatives are of order 10.
                    prop_assert!((difference[row] - centre.by_state[row][column]).abs() < 1e-7);
                }
            }
            for column in 0..2 {
                let shifted = |sign: f64| {
                    let mut moved = [velocity, steering];
                    moved[column] += sign * step;
                    run(&start, &Control { velocity: moved[0], steering: moved[1] }).end.to_vector()
                };
                let difference = (shifted(1.0) - shifted(-1.0)) / (2.0 * step);
                for row in 0..5 {
                    // The third derivative by the velocity reaches 1 / u1^3 = 1000: 1e-10 * 1000 / 6.
                    prop_assert!((difference[row] - centre.by_control[row][column]).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn radau_reproduces_a_fine_runge_kutta_reference() {
        let parameters = Parameters::default();
        let collocation = Collocation::new(Scheme::Radau3);
        for velocity in [0.1, 0.4, 1.0] {
            let control = Control { velocity, steering: 0.06 };
            let start = state(0.02, 0.3, -0.2);
            // Fifty intervals resolve the transient of 3 to 30 ms, so the fifth order shows.
            let fine = (0..50).try_fold(start, |state, _| {
                propagate(&parameters, &collocation, 0.4533 / 50.0, &state, &control).map(|step| step.end)
            });
            let reference = integrate::integrate(&parameters, &start, &control, 0.4533);
            let error = (fine.unwrap().to_vector() - reference.to_vector()).amax();
            assert!(error < 1e-6, "{velocity} m/s: {error}");
            // One interval passes over the transient; the analysis puts the adverse error at 2 to 3 mm.
            let coarse = propagate(&parameters, &collocation, 0.4533, &start, &control).unwrap().end;
            assert!((coarse.x - reference.x).hypot(coarse.y - reference.y) < 3e-3);
        }
    }

    #[test]
    fn transport_is_multiplication_with_the_derivative() {
        let parameters = Parameters::default();
        let collocation = Collocation::new(Scheme::Radau3);
        let interval = Interval { model: &parameters, collocation: &collocation, length: 0.45 };
        let linearisation =
            linearise(&interval, &[0.01, 0.2, 0.1, 0.0, 0.0], &[0.8, 0.03], &[[0.01, 0.1]; MAX_STAGES]);
        let matrix = linearisation.by_state();
        let change = [0.3, -0.2, 0.5, 0.7, -0.1];
        let ahead = linearisation.transport(&change);
        let back = linearisation.transport_back(&change);
        for index in 0..5 {
            let row: f64 = (0..5).map(|column| matrix[index][column] * change[column]).sum();
            let column: f64 = (0..5).map(|row| matrix[row][index] * change[row]).sum();
            assert!((ahead[index] - row).abs() < 1e-14 && (back[index] - column).abs() < 1e-14);
        }
    }

    #[test]
    fn nothing_is_returned_for_a_state_that_is_not_finite() {
        let collocation = Collocation::new(Scheme::Radau3);
        let start = State { sideslip: f64::NAN, ..State::default() };
        let control = Control { velocity: 0.5, steering: 0.0 };
        assert!(propagate(&Parameters::default(), &collocation, 0.4, &start, &control).is_none());
    }
}
