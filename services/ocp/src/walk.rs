//! Where a step first meets a constraint that is not in the active set.

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
