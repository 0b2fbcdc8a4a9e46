//! Control-variable correlation: the angle between the directions in which velocity and steering move the state.
//!
//! The columns of the sensitivity of an end state to (velocity, steering) are two vectors in the space of the five
//! states, in their SI units. Near 0 or 180 degrees both controls have the same effect: the Hessian is close to
//! singular in them, and BFGS learns it slowly. Near 90 degrees they are independent.
//!
//! Two sensitivities are analysed: of the end of an interval to its control, and of the end of the horizon so far to
//! a control that is held from its start. Both are those of the exact motion, on elements that resolve the transient
//! of 3 to 30 ms. One collocation interval does not resolve it; its own angle is reported as well. The robot starts
//! in the zero state.
//!
//! Source note: the source prints one angle, 95.46 degrees, without the operating point. It is that of one interval
//! at a steering angle of about -0.0074 rad, or of the horizon at about -0.015 rad; straight ahead the angle is 90.

use vehicle::{Bounds, Control, Invalid, Parameters, State, require};

use super::exact::{Exact, chain};
use super::search;
use ocp::propagate;
use ocp::{Collocation, Scheme};

/// A smaller angle gives a warning [deg].
pub(crate) const CORRELATED_BELOW_DEG: f64 = 10.0;

/// Input of the analysis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CorrelationSettings {
    /// The robot.
    pub parameters: Parameters,
    /// The box of controls.
    pub bounds: Bounds,
    /// The scheme whose own angles are reported as well.
    pub scheme: Scheme,
    /// Length of the horizon [s].
    pub horizon_s: f64,
    /// Number of intervals.
    pub count: usize,
}

/// Angles at the end of one interval [deg].
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub(crate) struct Angles {
    /// End of the interval [s].
    pub time_s: f64,
    /// Of the interval's end state by the control of this interval.
    pub interval_deg: f64,
    /// The same with one collocation interval of the scheme.
    pub scheme_deg: f64,
    /// Of the same end state by a control held since the start of the horizon.
    pub held_deg: f64,
}

/// Result at an operating point and over the box of controls.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Correlation {
    /// One row per interval.
    pub intervals: Vec<Angles>,
    /// Smallest of angle and 180 - angle over the horizon, of both sensitivities [deg].
    pub min_angle_deg: f64,
    /// Smallest of the same over the box of controls [deg].
    pub box_min_angle_deg: f64,
    /// The controls with that angle.
    pub box_worst: Control,
}

impl Correlation {
    /// Angle of the first interval [deg].
    pub(crate) fn angle_deg(&self) -> f64 {
        self.intervals.first().map_or(f64::NAN, |angles| angles.interval_deg)
    }

    /// Whether no angle is small, so that BFGS can learn the curvature of each control.
    pub(crate) fn bfgs_admissible(&self) -> bool {
        self.min_angle_deg >= CORRELATED_BELOW_DEG && self.box_min_angle_deg >= CORRELATED_BELOW_DEG
    }
}

impl CorrelationSettings {
    /// Passes when all numbers are allowed.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and the range.
    pub(crate) fn validate(&self) -> Result<(), Invalid> {
        require("tf", self.horizon_s, 0.05..=60.0)?;
        require("n", self.count as f64, 1.0..=100.0)
    }

    /// Angles along the horizon under one control; `None` when the model has no solution.
    pub(crate) fn angles(&self, control: &Control) -> Option<Vec<Angles>> {
        let exact = Exact::new();
        let collocation = Collocation::new(self.scheme);
        let length = self.horizon_s / self.count as f64;
        let mut held = exact.sensitivity(&self.parameters, &State::default(), control, 0.0)?;
        let mut rows = Vec::with_capacity(self.count);
        for index in 0..self.count {
            let seen = propagate(&self.parameters, &collocation, length, &held.end, control)?;
            let interval = exact.sensitivity(&self.parameters, &held.end, control, length)?;
            held = chain(&held, &interval);
            rows.push(Angles {
                time_s: (index + 1) as f64 * length,
                interval_deg: angle_deg(&interval.by_control),
                scheme_deg: angle_deg(&seen.by_control),
                held_deg: angle_deg(&held.by_control),
            });
        }
        Some(rows)
    }

    /// Analyses the horizon at an operating point, and searches the box for the smallest angle.
    ///
    /// # Errors
    /// [`Invalid`] when a setting or the operating point is not allowed, or the model has no solution there.
    pub(crate) fn analyse(&self, control: Control) -> Result<Correlation, Invalid> {
        /// Points of the grid from which the search starts.
        const GRID: usize = 9;
        self.validate()?;
        let bounds = &self.bounds;
        require("velocity", control.velocity, bounds.velocity_min_mps..=bounds.velocity_max_mps)?;
        require("steering", control.steering, -bounds.steering_max_rad..=bounds.steering_max_rad)?;
        let Some(intervals) = self.angles(&control) else {
            return Err(Invalid::new(
                "steering",
                control.steering,
                "an angle at which the model has a solution",
            ));
        };
        let nearness =
            |control: Control| self.angles(&control).map_or(f64::NEG_INFINITY, |rows| -smallest(&rows));
        let (box_worst, nearest) =
            search::maximise(bounds, search::grid(bounds, GRID, GRID), search::LAST_STEP, nearness);
        let min_angle_deg = smallest(&intervals);
        // The operating point is a point of the box.
        let (box_min_angle_deg, box_worst) =
            if -nearest <= min_angle_deg { (-nearest, box_worst) } else { (min_angle_deg, control) };
        Ok(Correlation { intervals, min_angle_deg, box_min_angle_deg, box_worst })
    }
}

/// Smallest of angle and 180 - angle over the rows [deg].
fn smallest(rows: &[Angles]) -> f64 {
    let angles = rows.iter().flat_map(|row| [row.interval_deg, row.held_deg]);
    angles.map(|angle| angle.min(180.0 - angle)).fold(90.0, f64::min)
}

/// Angle between the two columns [deg].
fn angle_deg(columns: &[[f64; 2]; 5]) -> f64 {
    let product = |left: usize, right: usize| columns.iter().map(|row| row[left] * row[right]).sum::<f64>();
    let cosine = product(0, 1) / (product(0, 0) * product(1, 1)).sqrt();
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> CorrelationSettings {
        CorrelationSettings {
            parameters: Parameters::default(),
            bounds: Bounds::default(),
            scheme: Scheme::Radau3,
            horizon_s: 2.72,
            count: 6,
        }
    }

    #[test]
    fn the_angle_of_the_source_is_found_at_its_operating_point() {
        let found = settings().analyse(Control { velocity: 0.5, steering: -0.0074 }).unwrap();
        // 95.46 is printed; the operating point is known to two digits.
        assert!((found.angle_deg() - 95.46).abs() < 0.1, "{}", found.angle_deg());
        assert!((found.min_angle_deg - 84.5).abs() < 0.1, "{}", found.min_angle_deg);
        assert!(found.bfgs_admissible());
    }

    #[test]
    fn straight_ahead_the_controls_are_orthogonal() {
        for velocity in [0.1, 0.6, 1.0] {
            for row in settings().angles(&Control { velocity, steering: 0.0 }).unwrap() {
                assert!((row.interval_deg - 90.0).abs() < 1e-9 && (row.held_deg - 90.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn over_the_box_the_angle_is_that_of_the_analysis() {
        let found = settings().analyse(Control { velocity: 0.5, steering: 0.0 }).unwrap();
        // 52 to 128 degrees for one interval, at full lock.
        assert!((found.box_min_angle_deg - 52.0).abs() < 1.0, "{}", found.box_min_angle_deg);
        assert_eq!(found.box_worst.steering.abs(), 0.06);
    }

    #[test]
    fn over_the_whole_horizon_the_angle_of_the_source_is_at_twice_the_steering() {
        let held = |velocity, steering| {
            settings().angles(&Control { velocity, steering }).unwrap().last().unwrap().held_deg
        };
        // The analysis puts 95.46 between -0.0166 at 0.1 m/s and -0.0143 at 1 m/s.
        assert!((held(0.1, -0.0166) - 95.46).abs() < 0.1, "{}", held(0.1, -0.0166));
        assert!((held(1.0, -0.0143) - 95.46).abs() < 0.1, "{}", held(1.0, -0.0143));
    }

    #[test]
    fn sensitivities_agree_with_central_differences() {
        let (parameters, exact) = (Parameters::default(), Exact::new());
        let control = Control { velocity: 0.5, steering: 0.03 };
        let found = exact.sensitivity(&parameters, &State::default(), &control, 0.4533).unwrap();
        let step = 1e-4;
        for (column, change) in [[step, 0.0], [0.0, step]].into_iter().enumerate() {
            let end = |sign: f64| {
                let moved = Control {
                    velocity: control.velocity + sign * change[0],
                    steering: control.steering + sign * change[1],
                };
                exact.advance(&parameters, &State::default(), &moved, 0.0, 0.4533).unwrap().to_vector()
            };
            let difference = (end(1.0) - end(-1.0)) / (2.0 * step);
            for row in 0..5 {
                // Ends are exact to 1e-9 and the step is 1e-4.
                assert!((difference[row] - found.by_control[row][column]).abs() < 2e-5, "{row} {column}");
            }
        }
    }

    #[test]
    fn a_point_outside_the_box_is_refused() {
        for control in [
            Control { velocity: 0.05, steering: 0.0 },
            Control { velocity: f64::NAN, steering: 0.0 },
            Control { velocity: 0.5, steering: 0.07 },
        ] {
            assert!(settings().analyse(control).unwrap_err().to_string().contains(" to "));
        }
        let error = CorrelationSettings { count: 0, ..settings() }.validate().unwrap_err().to_string();
        assert!(error.contains("n = 0"), "{error}");
    }
}
