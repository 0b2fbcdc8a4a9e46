//! Multiple shooting: the iterate of node states, controls and stage values, and its linearisation.

use crate::collocation::{Collocation, MAX_STAGES};
use crate::dense::fill;
use crate::interval::{Interval, Linearisation, StageValues, settle};
use crate::problem::{Problem, Trajectory};

/// The variables of the nonlinear program: states at nodes 0 to N, controls and stage values of the intervals.
#[derive(Debug, Clone, Default)]
pub(crate) struct Iterate {
    /// (sideslip, yaw, yaw rate, x, y) at nodes 0 to N; node 0 is the measured state.
    pub states: Vec<[f64; 5]>,
    /// (velocity, steering) of the intervals.
    pub controls: Vec<[f64; 2]>,
    /// (sideslip, yaw rate) at the stages of the intervals.
    pub stages: Vec<StageValues>,
}

impl Iterate {
    /// Starts from `guess` with the measured state at node 0 and controls inside their bounds; a guess of another
    /// length is replaced by a roll-out of its controls, or of the reference control where there are none.
    ///
    /// Returns [`Sweep::Keep`] when the node states are those of the guess, which need not satisfy the model.
    pub(crate) fn start(&mut self, problem: &Problem, guess: &Trajectory) -> Sweep {
        let count = problem.intervals.len();
        fill(
            &mut self.controls,
            (0..count).map(|index| {
                let control = guess.controls.get(index).or(guess.controls.last());
                let control = problem.bounds.clamp(*control.unwrap_or(&problem.control_reference));
                [control.velocity, control.steering]
            }),
        );
        self.states.clear();
        self.states.push(problem.initial.to_vector().into());
        if guess.states.len() == count + 1 {
            self.states.extend(guess.states[1..].iter().map(|state| <[f64; 5]>::from(state.to_vector())));
        }
        let known = self.states.len() == count + 1;
        self.states.resize(count + 1, self.states[0]);
        self.stages.clear();
        // The fast modes have settled at the stages, so the end of an interval is nearer to them than its start.
        self.stages.extend(self.states[1..].iter().map(|end| [[end[0], end[2]]; MAX_STAGES]));
        if known { Sweep::Keep } else { Sweep::Close }
    }

    /// This iterate is `base` moved by `fraction` of `step`.
    pub(crate) fn move_from(&mut self, base: &Self, step: &Self, fraction: f64) {
        copy_moved(&mut self.states, &base.states, &step.states, fraction);
        copy_moved(&mut self.controls, &base.controls, &step.controls, fraction);
        fill(
            &mut self.stages,
            base.stages.iter().zip(&step.stages).map(|(base, step)| {
                let mut moved = *base;
                for (value, change) in moved.iter_mut().flatten().zip(step.iter().flatten()) {
                    *value += fraction * change;
                }
                moved
            }),
        );
    }
}

fn copy_moved<const C: usize>(
    target: &mut Vec<[f64; C]>,
    base: &[[f64; C]],
    step: &[[f64; C]],
    fraction: f64,
) {
    fill(
        target,
        base.iter().zip(step).map(|(base, step)| {
            let mut moved = *base;
            for (value, change) in moved.iter_mut().zip(step) {
                *value += fraction * change;
            }
            moved
        }),
    );
}

/// Linearisations of all intervals with the gaps at their ends.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shooting {
    /// Per interval.
    pub intervals: Vec<Linearisation>,
    /// End of each interval minus the next node's state; zero after a closing sweep.
    pub gaps: Vec<[f64; 5]>,
    /// The largest gap, or square of the last Newton step of a stage: what is left of the model's equations.
    pub defect: f64,
    /// The largest change of a stage by the last Newton step, which the sensitivities do not contain.
    pub last_step: f64,
}

/// What a sweep does with the node states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sweep {
    /// Each node gets the end of the interval before it, so that the iterate satisfies the model.
    Close,
    /// The nodes stay as they are and the gaps are reported.
    Keep,
}

impl Shooting {
    /// Solves the collocation equations of all intervals from the stage values of `iterate` and linearises there;
    /// false where they do not converge. `is_far` says that the stage values are a guess.
    ///
    /// Near the solution of the program the stage values come predicted by the last step, and one Newton step per
    /// interval is enough: its linearisation is the one that is needed anyway.
    pub(crate) fn sweep(
        &mut self,
        problem: &Problem,
        collocation: &Collocation,
        iterate: &mut Iterate,
        sweep: Sweep,
        is_far: bool,
    ) -> bool {
        /// Three are usual from afar, one near the solution.
        const NEWTON_STEPS: usize = 20;
        /// The equations are nearly linear, and less than the square of the last step is left: rounding errors. With
        /// 1e-4 the noise of the merit, which penalties magnify, stops the search.
        const LAST_STEP: f64 = 1e-7;
        self.intervals.clear();
        self.gaps.clear();
        self.defect = 0.0;
        self.last_step = 0.0;
        for (index, &length) in problem.intervals.iter().enumerate() {
            let interval = Interval { model: problem.model.as_ref(), collocation, length };
            let (start, control) = (&iterate.states[index], &iterate.controls[index]);
            let stages = &mut iterate.stages[index];
            let settled = settle(&interval, start, control, stages, NEWTON_STEPS, LAST_STEP, is_far);
            let Some((mut linearisation, last)) = settled else { return false };
            if let Some(bend) = problem.frames.get(index) {
                linearisation.turn(bend);
            }
            let mut gap = [0.0; 5];
            self.last_step = self.last_step.max(last);
            self.defect = self.defect.max(last * last);
            let next = &mut iterate.states[index + 1];
            let ends = linearisation.end.iter().zip(&linearisation.correction);
            for ((gap, next), (end, correction)) in gap.iter_mut().zip(next).zip(ends) {
                let end = end + correction;
                match sweep {
                    Sweep::Close => *next = end,
                    Sweep::Keep => *gap = end - *next,
                }
                self.defect = self.defect.max(gap.abs());
            }
            self.gaps.push(gap);
            self.intervals.push(linearisation);
        }
        true
    }

    /// Fills the states and stages of `step` that follow from its controls.
    pub(crate) fn expand(&self, step: &mut Iterate) {
        step.states.clear();
        step.stages.clear();
        let mut change = [0.0; 5];
        step.states.push(change);
        for ((interval, gap), control) in self.intervals.iter().zip(&self.gaps).zip(&step.controls) {
            // The Newton step of the stages, in column 0, has been made by the sweep.
            let mut stages = [[0.0; 2]; MAX_STAGES];
            for (stage, columns) in stages.iter_mut().flatten().zip(interval.stages.iter().flatten()) {
                *stage = columns[1] * change[0]
                    + columns[2] * change[2]
                    + columns[3] * control[0]
                    + columns[4] * control[1];
            }
            step.stages.push(stages);
            change = interval.transport(&change);
            for ((value, gap), by_control) in change.iter_mut().zip(gap).zip(&interval.by_control) {
                *value += gap + by_control[0] * control[0] + by_control[1] * control[1];
            }
            step.states.push(change);
        }
    }
}
