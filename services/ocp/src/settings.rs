//! Settings of the solver.

use vehicle::settings;

use crate::collocation::Scheme;
use crate::hessian::Hessian;
use crate::qp::QpChoice;
use crate::usable::MAX_INTERVALS;

settings! {
    /// How the nonlinear program is solved.
    #[derive(Copy)]
    pub struct SolverSettings {
        /// Collocation scheme inside the intervals; the source uses `gauss2`.
        pub scheme: Scheme = Scheme::default();
        /// Hessian of the quadratic programs; the source uses `bfgs`.
        pub hessian: Hessian = Hessian::default();
        /// Whether each iteration first tries a Newton step with the exact Hessian, on the active set of the quadratic program.
        // Without it the method is the classic one of its Hessian: it converges linearly where an ellipse presses, and
        // fails in every tenth of the random problems of the tests. The source's method is `bfgs` without refinement.
        pub refine: bool = true;
        /// Solver of the quadratic programs; `active-set` falls back to Clarabel where its result fails the check.
        pub qp: QpChoice = QpChoice::default();
        /// Largest number of intervals whose quadratic programs are condensed where the search by stages fails.
        // The search comes first for every horizon. Where it fails, the condensed dual active set is faster in the tail up
        // to 6 intervals, and the interior point by stages from 12 on. Clarabel always condenses.
        pub condense_up_to: usize = 12, 0.0..=MAX_INTERVALS as f64;
        /// The solver has converged when the scaled KKT residual is at most this.
        pub tolerance: f64 = 1e-6, 1e-10..=1e-2;
        /// Limit of SQP iterations.
        pub max_iterations: u32 = 60, 1.0..=1000.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_that_is_no_number_is_refused() {
        let settings = SolverSettings { tolerance: f64::NAN, ..SolverSettings::default() };
        assert!(settings.require_ranges().unwrap_err().to_string().starts_with("tolerance = NaN"));
        assert_eq!(SolverSettings::default().require_ranges(), Ok(()));
        let none = SolverSettings { max_iterations: 0, ..SolverSettings::default() };
        assert!(none.require_ranges().is_err());
    }
}
