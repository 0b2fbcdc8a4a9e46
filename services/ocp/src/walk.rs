//! The first constraint outside the active set that a step meets.

use crate::qp::{BoundState, RowState};

/// A constraint with the state that it has once a step has met it.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Met {
    Bound(usize, BoundState),
    Row(usize, RowState),
}

/// The fraction of a step up to the first of the constraints considered so far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Walk {
    /// 1 where none is met.
    pub fraction: f64,
    /// The first constraint.
    pub met: Option<Met>,
}

impl Walk {
    /// The whole step.
    pub(crate) fn whole() -> Self {
        Self { fraction: 1.0, met: None }
    }

    /// Considers the bounds of a free variable that the step changes from `value` by `change`.
    pub(crate) fn consider_bound(&mut self, index: usize, value: f64, change: f64, [lower, upper]: [f64; 2]) {
        let (limit, state) =
            if change > 0.0 { (upper, BoundState::Upper) } else { (lower, BoundState::Lower) };
        self.consider(Met::Bound(index, state), limit - value, change);
    }

    /// Considers the limits of a row in state `present` that the step changes from `value` by `change`.
    pub(crate) fn consider_row(
        &mut self,
        index: usize,
        present: RowState,
        value: f64,
        change: f64,
        [lower, upper]: [f64; 2],
    ) {
        let (limit, state) = match present {
            RowState::Inside if change > 0.0 => (upper, RowState::AtUpper),
            RowState::Inside => (lower, RowState::AtLower),
            RowState::BeyondUpper if change < 0.0 => (upper, RowState::AtUpper),
            RowState::BeyondLower if change > 0.0 => (lower, RowState::AtLower),
            _ => return,
        };
        self.consider(Met::Row(index, state), limit - value, change);
    }

    fn consider(&mut self, met: Met, room: f64, change: f64) {
        let fraction = room / change;
        if change != 0.0 && fraction < self.fraction {
            self.fraction = fraction.max(0.0);
            self.met = Some(met);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_limit_on_the_way_ends_the_walk() {
        let mut walk = Walk::whole();
        // Away from its limit, along it, and short of it.
        walk.consider_row(0, RowState::AtUpper, 0.0, 1.0, [0.0, 0.5]);
        walk.consider_bound(1, 0.0, 0.0, [-1.0, 1.0]);
        walk.consider_bound(2, 0.0, 0.9, [-1.0, 1.0]);
        assert!(walk.met.is_none() && walk.fraction == 1.0);
        walk.consider_bound(3, 0.0, -2.0, [-1.0, 1.0]);
        assert!(matches!(walk.met, Some(Met::Bound(3, BoundState::Lower))) && walk.fraction == 0.5);
        walk.consider_row(4, RowState::BeyondUpper, 3.0, -4.0, [0.0, 2.0]);
        assert!(matches!(walk.met, Some(Met::Row(4, RowState::AtUpper))) && walk.fraction == 0.25);
        // One that is met later changes nothing; one that is passed already ends it at once.
        walk.consider_row(5, RowState::Inside, 0.0, 1.0, [-1.0, 0.5]);
        assert_eq!(walk.fraction, 0.25);
        walk.consider_row(6, RowState::Inside, 1.0, 1.0, [-1.0, 0.5]);
        assert_eq!(walk.fraction, 0.0);
    }
}
