//! On which side each obstacle is passed, held from scan to scan.
//!
//! An obstacle on the line is a symmetric trap: left and right cost the same, and noise would change the
//! choice with every scan until it is too late for both. The choice itself is made by the guide, whose cost
//! contains every side that was chosen before; this module remembers the choices. Ellipses are found again
//! by their identity, or by their place when tracking has given them a new one.

use shared_types::plain_state;

use crate::predicted_obstacle::PredictedObstacle;

/// How many choices are remembered.
pub(crate) const MAX_SIDES: usize = 16;
/// Distance within which an ellipse with a new identity is taken for a known one [m].
const SAME_PLACE_M: f64 = 0.5;

/// On which side of an obstacle the robot passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Passing {
    /// Left of its centre.
    Left,
    /// Right of its centre.
    Right,
}

impl Passing {
    /// The side of a path at lateral position `y` past a centre at `centre_y`.
    pub(crate) fn of(y: f64, centre_y: f64) -> Self {
        if y > centre_y { Self::Left } else { Self::Right }
    }

    /// 1 for left, -1 for right, as samples and checkpoints have it.
    pub(crate) fn wire(self) -> i32 {
        match self {
            Self::Left => 1,
            Self::Right => -1,
        }
    }

    fn from_wire(side: i32) -> Option<Self> {
        [Self::Left, Self::Right].into_iter().find(|passing| passing.wire() == side)
    }
}

plain_state! {
    /// The choice for one ellipse; one with the identity 0 is not used.
    pub struct Side {
        /// Identity of the ellipse
        pub id: u32,
        /// 1 passes left of it, -1 right of it
        pub side: i32,
        /// Centre along the track [m]
        pub x_m: f64,
        /// Centre across the track [m]
        pub y_m: f64,
    }
}

/// The choices of the last scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Sides {
    entries: [Side; MAX_SIDES],
}

impl Sides {
    /// The choices as they stand in a checkpoint.
    pub(crate) fn entries(&self) -> &[Side; MAX_SIDES] {
        &self.entries
    }

    /// The choices of a checkpoint; entries without meaning are left out.
    pub(crate) fn from_entries(entries: &[Side; MAX_SIDES]) -> Self {
        let sound = |entry: &Side| {
            Passing::from_wire(entry.side).is_some() && entry.x_m.is_finite() && entry.y_m.is_finite()
        };
        Self { entries: entries.map(|entry| if sound(&entry) { entry } else { Side::default() }) }
    }

    /// The side held for the ellipse.
    pub(crate) fn held(&self, obstacle: &PredictedObstacle) -> Option<Passing> {
        let used = || self.entries.iter().filter(|entry| entry.id != 0);
        let known = used().find(|entry| entry.id == obstacle.id).or_else(|| {
            let distance =
                |entry: &Side| (entry.x_m - obstacle.centre[0]).hypot(entry.y_m - obstacle.centre[1]);
            used()
                .filter(|entry| distance(entry) < SAME_PLACE_M)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        });
        Passing::from_wire(known?.side)
    }

    /// Holds a side for the ellipse; `None` lets go.
    pub(crate) fn hold(&mut self, obstacle: &PredictedObstacle, side: Option<Passing>) {
        let old = self.entries.iter().position(|entry| entry.id == obstacle.id);
        let Some(index) = old.or_else(|| self.entries.iter().position(|entry| entry.id == 0)) else { return };
        self.entries[index] = match side {
            None => Side::default(),
            Some(side) => {
                Side { id: obstacle.id, side: side.wire(), x_m: obstacle.centre[0], y_m: obstacle.centre[1] }
            }
        };
    }

    /// Replaces all choices by those that `choose` makes; `None` keeps what was held for the ellipse.
    pub(crate) fn renew(
        &mut self,
        predicted: &[PredictedObstacle],
        choose: impl Fn(&PredictedObstacle) -> Option<Passing>,
    ) {
        let mut renewed = Self::default();
        for obstacle in predicted.iter().filter(|obstacle| obstacle.id != 0) {
            renewed.hold(obstacle, choose(obstacle).or_else(|| self.held(obstacle)));
        }
        *self = renewed;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;

    fn obstacle(id: u32, x: f64, y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.4 };
        PredictedObstacle { id, centre: [x, y], velocity: [0.0, 0.0], a: 1.2, b: 0.8, body }
    }

    #[test]
    fn a_choice_is_found_again_by_identity_or_by_place() {
        let mut sides = Sides::default();
        sides.hold(&obstacle(7, 5.0, 0.0), Some(Passing::Right));
        assert_eq!(sides.held(&obstacle(7, 5.9, 0.3)), Some(Passing::Right));
        assert_eq!(sides.held(&obstacle(8, 5.2, 0.1)), Some(Passing::Right));
        assert_eq!(sides.held(&obstacle(8, 6.0, 0.0)), None);
    }

    #[test]
    fn choices_of_ellipses_that_are_gone_are_forgotten() {
        let mut sides = Sides::default();
        sides.hold(&obstacle(7, 5.0, 0.0), Some(Passing::Right));
        sides.renew(&[obstacle(9, 9.0, 0.0)], |_| Some(Passing::Left));
        assert_eq!(sides.held(&obstacle(7, 5.0, 0.0)), None);
        assert_eq!(sides.held(&obstacle(9, 9.0, 0.0)), Some(Passing::Left));
        sides.renew(&[obstacle(9, 9.0, 0.0)], |_| None);
        assert_eq!(sides.held(&obstacle(9, 9.0, 0.0)), Some(Passing::Left));
    }

    #[test]
    fn nonsense_in_a_checkpoint_is_left_out() {
        let mut entries = [Side::default(); MAX_SIDES];
        entries[0] = Side { id: 3, side: 40, x_m: 1.0, y_m: 0.0 };
        entries[1] = Side { id: 4, side: 1, x_m: f64::NAN, y_m: 0.0 };
        assert_eq!(Sides::from_entries(&entries), Sides::default());
    }
}
