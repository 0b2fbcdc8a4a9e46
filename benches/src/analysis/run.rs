//! The error of collocation along a horizon under given controls.
//!
//! Collocation and the exact motion both start at the zero state and continue from their own ends. So the error at the
//! end of an interval includes those of all intervals before.

use vehicle::{Control, Parameters, State};

use super::exact::Exact;
use ocp::Interval;
use ocp::converge;
use ocp::{Collocation, MAX_STAGES, Scheme};

/// Points of an interval at which the dense measure compares, its end included.
const DENSE: usize = 10;

/// How the error of collocation is measured. States are in SI units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ErrorMeasure {
    /// The larger error of x and y at the ends of intervals [m].
    PositionEnds,
    /// The largest error of all five states at the ends of intervals [rad, rad/s or m].
    AllStatesEnds,
    /// The larger error of x and y inside intervals, on the collocation polynomial, and at their ends [m].
    PositionDense,
}

impl ErrorMeasure {
    /// All measures.
    pub(crate) const ALL: [Self; 3] = [Self::PositionEnds, Self::AllStatesEnds, Self::PositionDense];
}

/// Both motions at a node, and the largest error up to it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Node {
    approximate: State,
    exact: State,
    /// The last control and how long it has been held [s].
    held: Option<(Control, f64)>,
    /// Largest error so far; infinite where collocation has no solution.
    pub error: f64,
}

/// Computes errors along a horizon.
#[derive(Debug, Clone)]
pub(crate) struct Runner {
    parameters: Parameters,
    collocation: Collocation,
    measure: ErrorMeasure,
    exact: Exact,
}

impl Runner {
    pub(crate) fn new(parameters: Parameters, scheme: Scheme, measure: ErrorMeasure) -> Self {
        Self { parameters, collocation: Collocation::new(scheme), measure, exact: Exact::new() }
    }

    /// The largest error along intervals of these lengths [s] under these controls.
    pub(crate) fn error(&self, lengths: &[f64], controls: &[Control]) -> f64 {
        let intervals = lengths.iter().zip(controls);
        intervals.fold(Node::default(), |node, (length, control)| self.advance(&node, *length, control)).error
    }

    /// The node after one more interval.
    pub(crate) fn advance(&self, node: &Node, length: f64, control: &Control) -> Node {
        self.try_advance(node, length, control).unwrap_or(Node { error: f64::INFINITY, ..*node })
    }

    fn try_advance(&self, node: &Node, length: f64, control: &Control) -> Option<Node> {
        if !node.error.is_finite() {
            return None;
        }
        let (approximate, inside) = self.collocate(&node.approximate, length, control)?;
        let since = node.held.filter(|(held, _)| held == control).map_or(0.0, |(_, since)| since);
        let mut error = node.error;
        let mut exact = node.exact;
        if self.measure == ErrorMeasure::PositionDense {
            for (index, position) in inside.iter().enumerate() {
                let part = length / DENSE as f64;
                let since = since + index as f64 * part;
                exact = self.exact.advance(&self.parameters, &exact, control, since, part)?;
                error = error.max((position[0] - exact.x).abs()).max((position[1] - exact.y).abs());
            }
        } else {
            exact = self.exact.advance(&self.parameters, &exact, control, since, length)?;
        }
        let difference = approximate.to_vector() - exact.to_vector();
        let at_end = match self.measure {
            ErrorMeasure::AllStatesEnds => difference.amax(),
            ErrorMeasure::PositionEnds | ErrorMeasure::PositionDense => {
                difference[3].abs().max(difference[4].abs())
            }
        };
        let held = Some((*control, since + length));
        Some(Node { approximate, exact, held, error: error.max(at_end) })
    }

    /// The end of an interval, and positions at equal fractions of it on the collocation polynomial.
    fn collocate(&self, start: &State, length: f64, control: &Control) -> Option<(State, [[f64; 2]; DENSE])> {
        let interval = Interval { model: &self.parameters, collocation: &self.collocation, length };
        let (linearisation, stages) = converge(&interval, start, control)?;
        let inside = if self.measure == ErrorMeasure::PositionDense {
            self.inside(length, &start.to_vector().into(), control, &stages)
        } else {
            [[0.0; 2]; DENSE]
        };
        Some((State::from_vector(&linearisation.end.into()), inside))
    }

    /// Positions on the polynomial of degree s through the start and the stages.
    fn inside(
        &self,
        length: f64,
        start: &[f64; 5],
        control: &Control,
        stages: &[[f64; 2]; MAX_STAGES],
    ) -> [[f64; 2]; DENSE] {
        let Collocation { stages: count, points, integrals, .. } = &self.collocation;
        let summed = |row: usize, slopes: &[f64; MAX_STAGES]| {
            length * (0..*count).map(|column| integrals[row][column] * slopes[column]).sum::<f64>()
        };
        let yaw_rates = stages.map(|stage| stage[1]);
        let mut slopes = [[0.0; MAX_STAGES]; 2];
        for stage in 0..*count {
            let (sin, cos) = (start[1] + stages[stage][0] + summed(stage, &yaw_rates)).sin_cos();
            slopes[0][stage] = control.velocity * cos;
            slopes[1][stage] = control.velocity * sin;
        }
        let mut knots = [0.0; MAX_STAGES + 1];
        let mut values = [[start[3], start[4]]; MAX_STAGES + 1];
        knots[1..].copy_from_slice(points);
        for stage in 0..*count {
            values[stage + 1][0] += summed(stage, &slopes[0]);
            values[stage + 1][1] += summed(stage, &slopes[1]);
        }
        let mut inside = [[0.0; 2]; DENSE];
        for (index, position) in inside.iter_mut().enumerate() {
            let fraction = (index + 1) as f64 / DENSE as f64;
            for knot in 0..=*count {
                let basis: f64 = (0..=*count)
                    .filter(|other| *other != knot)
                    .map(|other| (fraction - knots[other]) / (knots[knot] - knots[other]))
                    .product();
                position[0] += basis * values[knot][0];
                position[1] += basis * values[knot][1];
            }
        }
        inside
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ocp::propagate;

    #[test]
    fn an_interval_ends_where_the_controller_believes_it_to_end() {
        let start = State { sideslip: 0.01, yaw: 0.2, yaw_rate: -0.1, x: 1.0, y: -0.3 };
        let control = Control { velocity: 0.8, steering: 0.05 };
        for scheme in Scheme::ALL {
            let runner = Runner::new(Parameters::default(), scheme, ErrorMeasure::PositionDense);
            let (end, inside) = runner.collocate(&start, 0.4533, &control).unwrap();
            let oracle =
                propagate(&Parameters::default(), &Collocation::new(scheme), 0.4533, &start, &control)
                    .unwrap();
            assert_eq!(end, oracle.end);
            // The polynomial ends there too.
            let last = inside[DENSE - 1];
            assert!((last[0] - end.x).hypot(last[1] - end.y) < 1e-12, "{scheme:?}");
        }
    }

    #[test]
    fn driving_straight_has_no_error() {
        for measure in ErrorMeasure::ALL {
            let runner = Runner::new(Parameters::default(), Scheme::Gauss1, measure);
            let controls = [Control { velocity: 0.9, steering: 0.0 }; 4];
            assert!(runner.error(&[0.7; 4], &controls) < 1e-14);
        }
    }

    #[test]
    fn the_dense_measure_is_never_below_that_at_the_ends() {
        let controls = [Control { velocity: 1.0, steering: 0.06 }; 6];
        let error = |measure| {
            Runner::new(Parameters::default(), Scheme::Gauss2, measure).error(&[2.72 / 6.0; 6], &controls)
        };
        // Other elements of the exact motion leave 1e-9 between the two.
        assert!(error(ErrorMeasure::PositionDense) >= error(ErrorMeasure::PositionEnds) - 1e-9);
        assert!(error(ErrorMeasure::AllStatesEnds) >= error(ErrorMeasure::PositionEnds));
    }
}
