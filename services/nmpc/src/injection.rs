//! A seam for tests: replaces plans where they come from, before they are verified.

use ocp::{Solution, Status};
use shared_types::Level;
use vehicle::{Control, State};

/// Where a plan comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Place {
    /// The solution that was found from the last plan.
    SolutionFromPlan,
    /// The solution that was found from the reference path.
    SolutionFromReference,
    /// Simple steering along the reference path.
    Steering,
    /// The rest of the last plan.
    Rest,
}

impl Place {
    /// In the order in which they are tried.
    pub(crate) const ALL: [Self; 4] =
        [Self::SolutionFromPlan, Self::SolutionFromReference, Self::Steering, Self::Rest];
}

/// A plan that replaces those of some places.
#[derive(Debug, Clone, Default)]
pub(crate) struct Injection {
    /// The places.
    pub(crate) places: Vec<Place>,
    /// The controls of the plan.
    pub(crate) controls: Vec<Control>,
    /// The states that a solution has for these controls; empty where it keeps its own.
    pub(crate) states: Vec<State>,
    /// The places where the plan was injected.
    pub(crate) reached: Vec<Place>,
    /// What the next solutions are found from.
    pub(crate) guess: Option<Place>,
}

impl Injection {
    /// Notes what the next solutions are found from.
    pub(crate) fn guess_is(&mut self, place: Place) {
        self.guess = Some(place);
    }

    /// Replaces a solution, as one that converged.
    pub(crate) fn replace_solution(&mut self, solution: &mut Solution) {
        if self.guess.is_some_and(|place| self.reaches(place)) {
            solution.status = Status::Converged;
            solution.trajectory.controls.clone_from(&self.controls);
            if !self.states.is_empty() {
                solution.trajectory.states.clone_from(&self.states);
            }
        }
    }

    /// Replaces the controls of a guess that may become a plan of this level.
    pub(crate) fn replace_guess(&mut self, level: Level, controls: &mut Vec<Control>) {
        if self.reaches(if level == Level::LastPlan { Place::Rest } else { Place::Steering }) {
            controls.clone_from(&self.controls);
        }
    }

    fn reaches(&mut self, place: Place) -> bool {
        let is_injected = self.places.contains(&place);
        if is_injected {
            self.reached.push(place);
        }
        is_injected
    }
}
