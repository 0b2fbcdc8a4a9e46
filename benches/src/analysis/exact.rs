//! The motion under a constant control, exact enough to measure errors of 1e-4 against it.
//!
//! Radau-4 on elements that grow from the start: after a jump of the control the fast modes die out within 3 ms at
//! 0.1 m/s and 30 ms at 1 m/s, and the elements resolve them; what remains is smooth. RK4 in steps of 50 us is
//! the oracle of the tests.

use vehicle::{Control, Parameters, State};

use ocp::{Collocation, Scheme};
use ocp::{Propagation, propagate};

/// First element after a change of the control, in time constants of the fast modes.
const FIRST: f64 = 0.25;
/// Growth of the elements: share of the time since that change.
const GROWTH: f64 = 0.35;
/// Longest element [s].
const MAX_S: f64 = 0.15;
/// Decay of the fast modes times the velocity: -34 1/s at 1 m/s, -350 1/s at 0.1 m/s [m/s^2].
const DECAY: f64 = 35.0;

/// The exact motion.
#[derive(Debug, Clone)]
pub(crate) struct Exact {
    collocation: Collocation,
}

impl Exact {
    pub(crate) fn new() -> Self {
        Self { collocation: Collocation::new(Scheme::Radau4) }
    }

    /// The state `length` [s] after `start`, which is `since` [s] after the control jumped.
    pub(crate) fn advance(
        &self,
        parameters: &Parameters,
        start: &State,
        control: &Control,
        since: f64,
        length: f64,
    ) -> Option<State> {
        let mut state = *start;
        self.elements(control, since, length, |element| {
            state = propagate(parameters, &self.collocation, element, &state, control)?.end;
            Some(())
        })?;
        Some(state)
    }

    /// The state `length` [s] after `start` and its derivatives by the start and by the control, which jumps there.
    pub(crate) fn sensitivity(
        &self,
        parameters: &Parameters,
        start: &State,
        control: &Control,
        length: f64,
    ) -> Option<Propagation> {
        let mut whole = Propagation { end: *start, by_state: [[0.0; 5]; 5], by_control: [[0.0; 2]; 5] };
        for index in 0..5 {
            whole.by_state[index][index] = 1.0;
        }
        self.elements(control, 0.0, length, |element| {
            let part = propagate(parameters, &self.collocation, element, &whole.end, control)?;
            whole = chain(&whole, &part);
            Some(())
        })?;
        Some(whole)
    }

    /// Calls `advance` with the length of each element.
    fn elements(
        &self,
        control: &Control,
        since: f64,
        length: f64,
        mut advance: impl FnMut(f64) -> Option<()>,
    ) -> Option<()> {
        let first = FIRST * control.velocity / DECAY;
        let mut time = 0.0;
        while time < length {
            let element = (first + GROWTH * (since + time)).min(MAX_S);
            // Two halves instead of one element and a very short one.
            let rest = length - time;
            let element = if rest <= element {
                rest
            } else if rest < 2.0 * element {
                0.5 * rest
            } else {
                element
            };
            advance(element)?;
            time = if element >= rest { length } else { time + element };
        }
        Some(())
    }
}

/// Two motions under the same control, one after the other.
pub(crate) fn chain(first: &Propagation, second: &Propagation) -> Propagation {
    let mut whole = Propagation { end: second.end, by_state: [[0.0; 5]; 5], by_control: second.by_control };
    for row in 0..5 {
        for (inner, factor) in second.by_state[row].iter().enumerate() {
            for column in 0..5 {
                whole.by_state[row][column] += factor * first.by_state[inner][column];
            }
            for column in 0..2 {
                whole.by_control[row][column] += factor * first.by_control[inner][column];
            }
        }
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::integrate::rk4;

    #[test]
    fn it_agrees_with_runge_kutta_in_tiny_steps() {
        let parameters = Parameters::default();
        let exact = Exact::new();
        let start = State { sideslip: -0.03, yaw: 0.3, yaw_rate: -0.3, x: 1.0, y: 0.1 };
        for velocity in [0.1, 0.3, 1.0] {
            for steering in [-0.06, 0.06] {
                let control = Control { velocity, steering };
                for length in [0.013, 0.4533, 2.72] {
                    let steps = (length / 50e-6_f64).ceil();
                    let oracle = (0..steps as usize)
                        .fold(start, |state, _| rk4(&parameters, &state, &control, length / steps));
                    let found = exact.advance(&parameters, &start, &control, 0.0, length).unwrap();
                    let error = (found.to_vector() - oracle.to_vector()).amax();
                    // Ten thousand times finer than the errors that are measured against it.
                    assert!(error < 1e-8, "{velocity} m/s, {steering} rad, {length} s: {error:e}");
                }
            }
        }
    }

    #[test]
    fn two_parts_make_the_whole() {
        let parameters = Parameters::default();
        let exact = Exact::new();
        let control = Control { velocity: 0.7, steering: 0.05 };
        let whole = exact.advance(&parameters, &State::default(), &control, 0.0, 0.5).unwrap();
        let half = exact.advance(&parameters, &State::default(), &control, 0.0, 0.2).unwrap();
        let parts = exact.advance(&parameters, &half, &control, 0.2, 0.3).unwrap();
        assert!((whole.to_vector() - parts.to_vector()).amax() < 1e-8);
    }
}
