//! Which of two sides of an obstacle costs less.

use shared_types::Sides;

use crate::side::Passing;

/// An obstacle that may be passed on either side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contest {
    /// Identity of its ellipse.
    pub(crate) id: u32,
    /// The side of the reference path.
    pub(crate) side: Passing,
    /// Share of the cost of the reference path below which the alternative is taken.
    pub(crate) share: f64,
}

impl Contest {
    /// Both costs by side; an objective that is `None` belongs to no plan that may be driven.
    pub(crate) fn compare(&self, reference: Option<f64>, alternative: Option<f64>) -> Sides {
        let (left, right) = match self.side {
            Passing::Left => (reference, alternative),
            Passing::Right => (alternative, reference),
        };
        let cost = |objective: Option<f64>| objective.unwrap_or(-1.0);
        Sides { left_objective: cost(left), right_objective: cost(right), id: self.id, reserved: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_named_by_their_side() {
        let contest = Contest { id: 7, side: Passing::Right, share: 1.0 };
        let sides = contest.compare(Some(2.0), Some(3.0));
        assert_eq!((sides.left_objective, sides.right_objective, sides.id), (3.0, 2.0, 7));
        assert_eq!(contest.compare(None, Some(3.0)).right_objective, -1.0, "no plan on this side");
    }
}
