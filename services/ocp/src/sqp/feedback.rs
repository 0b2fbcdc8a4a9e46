//! The real-time iteration: all work that does not need the measured state is done before it arrives.
//!
//! [`Solver::prepare`] linearises the problem at a predicted state and solves its quadratic program; [`Solver::feedback`]
//! moves the linearised model to the measured one and solves the program again, with the same factors where its active set
//! is the same. The answer is exact to first order in the error
//! of the prediction, so it suits small errors; nothing is searched, iterated or verified. Initial value embedding:
//! DOI 10.1137/S0363012902400713.

use vehicle::{Control, State};

use super::{Solver, Step};
use crate::problem::{Problem, Trajectory};
use crate::usable::is_usable;

impl Solver {
    /// Linearises `problem` around `guess` at its predicted initial state; false for invalid input, or a program without an
    /// answer.
    pub fn prepare(&mut self, problem: &Problem, guess: &Trajectory) -> bool {
        self.is_prepared = is_usable(problem, guess) && self.start(problem, guess);
        if self.is_prepared {
            self.build_qp(problem, 0.0);
            self.is_prepared = self.solve_program(problem, 0.0);
        }
        self.is_prepared
    }

    /// The first control for the measured state, after [`Solver::prepare`] with the same problem.
    ///
    /// `None` for a state that is not finite, a program without an answer, or a solver that was not prepared.
    pub fn feedback(&mut self, problem: &Problem, measured: &State) -> Option<Control> {
        if !measured.is_finite() || !self.is_prepared {
            return None;
        }
        let interval = self.shooting.intervals.first()?;
        let (gap, predicted) = (self.shooting.gaps.first_mut()?, self.iterate.states.first_mut()?);
        let measured: [f64; 5] = measured.to_vector().into();
        let mut deviation = measured;
        deviation.iter_mut().zip(&*predicted).for_each(|(value, predicted)| *value -= predicted);
        gap.iter_mut().zip(interval.transport(&deviation)).for_each(|(gap, moved)| *gap += moved);
        *predicted = measured;
        if !self.solve_program_again(problem) {
            return None;
        }
        self.expand(Step::Program);
        let (control, step) = (self.iterate.controls.first()?, self.step.controls.first()?);
        let control = Control { velocity: control[0] + step[0], steering: control[1] + step[1] };
        control.is_finite().then(|| problem.bounds.clamp(control))
    }
}
