//! Settings of the solver.

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

use crate::collocation::Scheme;
use crate::hessian::Hessian;
use crate::qp::QpChoice;
use crate::usable::MAX_INTERVALS;

/// How the nonlinear program is solved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Collocation inside the intervals: `radau1` to `radau4`, `gauss1` to `gauss4`.
    pub scheme: Scheme,
    /// Hessian of the quadratic programs: `gauss-newton`, `bfgs` (the source's choice) or `exact`.
    pub hessian: Hessian,
    /// Whether a Newton step with the exact Hessian, on the active set that the quadratic program found, is tried before
    /// the step of the program itself. Without it the method is the classic one of its Hessian: it converges linearly
    /// where an ellipse presses, and fails in every tenth of the random problems of the tests. The source's method is
    /// `bfgs` without refinement.
    pub refine: bool,
    /// Solver of the quadratic programs: `active-set` or `clarabel`.
    pub qp: QpChoice,
    /// Largest number of intervals whose quadratic programs are condensed, 0 to 200; longer horizons are solved stage by
    /// stage, in time linear in their number. Measured: as fast as condensing at 6 in the median and at 12 in the tail.
    /// Clarabel always condenses.
    pub condense_up_to: usize,
    /// Converged when the scaled KKT residual is at most this, 1e-10 to 1e-2.
    pub tolerance: f64,
    /// SQP iterations at most, 1 to 1000.
    pub max_iterations: u32,
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self {
            scheme: Scheme::default(),
            hessian: Hessian::default(),
            refine: true,
            qp: QpChoice::default(),
            condense_up_to: 12,
            tolerance: 1e-6,
            max_iterations: 60,
        }
    }
}

impl SolverSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Invalid`] names key, value and range.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("condense_up_to", self.condense_up_to as f64, 0.0..=MAX_INTERVALS as f64)?;
        require("tolerance", self.tolerance, 1e-10..=1e-2)?;
        require("max_iterations", f64::from(self.max_iterations), 1.0..=1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_that_is_no_number_is_refused() {
        let settings = SolverSettings { tolerance: f64::NAN, ..SolverSettings::default() };
        assert!(settings.validate().unwrap_err().to_string().starts_with("tolerance = NaN"));
        assert_eq!(SolverSettings::default().validate(), Ok(()));
        let none = SolverSettings { max_iterations: 0, ..SolverSettings::default() };
        assert!(none.validate().is_err());
    }
}
