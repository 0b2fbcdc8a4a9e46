//! Settings of the solver.

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

use crate::collocation::Scheme;
use crate::qp::QpChoice;

/// How the nonlinear program is solved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Collocation inside the intervals: `radau1` to `radau4`, `gauss1` to `gauss4`.
    pub scheme: Scheme,
    /// Solver of the quadratic programs: `active-set` or `clarabel`.
    pub qp: QpChoice,
    /// Converged when the scaled KKT residual is at most this, 1e-10 to 1e-2.
    pub tolerance: f64,
    /// SQP iterations at most, 1 to 1000.
    pub max_iterations: u32,
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self { scheme: Scheme::default(), qp: QpChoice::default(), tolerance: 1e-6, max_iterations: 60 }
    }
}

impl SolverSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Invalid`] names key, value and range.
    pub fn validate(&self) -> Result<(), Invalid> {
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
