//! On which side each obstacle is passed, held from scan to scan.
//!
//! An obstacle on the line is a symmetric trap: left and right cost the same, and noise would change the choice with
//! every scan until it is too late for both. The lattice search chooses the sides, and adds a cost for every change of
//! a side chosen before; this module remembers the choices. Ellipses are recognised by their identity, or by their
//! place when tracking has given them a new one.

use shared_types::plain_state;

use crate::predicted_obstacle::PredictedObstacle;

/// How many choices are remembered.
pub(crate) const MAX_SIDES: usize = 16;
/// Distance within which an ellipse with a new identity counts as a known one [m].
const SAME_PLACE_M: f64 = 0.5;

/// On which side of an obstacle the robot passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Passing {
    /// Left of its centre.
    Left = 1,
    /// Right of its centre.
    Right = -1,
}

impl Passing {
    /// The side of a path at lateral position `y` past a centre at `centre_y`.
    pub(crate) fn of(y: f64, centre_y: f64) -> Self {
        if y > centre_y { Self::Left } else { Self::Right }
    }

    /// The number in samples and checkpoints.
    pub(crate) fn wire(self) -> i32 {
        self as i32
    }

    /// The other side.
    pub(crate) fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
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

/// The choices of one scan.
pub(crate) type Sides = [Side; MAX_SIDES];

/// The choices of a checkpoint without invalid entries.
pub(crate) fn valid(sides: &Sides) -> Sides {
    let is_valid = |entry: &Side| {
        Passing::from_wire(entry.side).is_some() && entry.x_m.is_finite() && entry.y_m.is_finite()
    };
    sides.map(|entry| if is_valid(&entry) { entry } else { Side::default() })
}

/// The side held for the ellipse.
pub(crate) fn held(sides: &Sides, obstacle: &PredictedObstacle) -> Option<Passing> {
    let used = || sides.iter().filter(|entry| entry.id != 0);
    let known = used().find(|entry| entry.id == obstacle.id).or_else(|| {
        let distance = |entry: &Side| (entry.x_m - obstacle.centre[0]).hypot(entry.y_m - obstacle.centre[1]);
        used()
            .filter(|entry| distance(entry) < SAME_PLACE_M)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    });
    Passing::from_wire(known?.side)
}

/// Holds a side for the ellipse, replacing the one held before.
pub(crate) fn hold(sides: &mut Sides, obstacle: &PredictedObstacle, side: Passing) {
    let old = sides.iter().position(|entry| entry.id == obstacle.id);
    let Some(index) = old.or_else(|| sides.iter().position(|entry| entry.id == 0)) else { return };
    let [x_m, y_m] = obstacle.centre;
    sides[index] = Side { id: obstacle.id, side: side.wire(), x_m, y_m };
}

/// Replaces all choices by those that `choose` makes; where it makes none, the side held before stays.
pub(crate) fn renew(
    sides: &mut Sides,
    predicted: &[PredictedObstacle],
    choose: impl Fn(&PredictedObstacle) -> Option<Passing>,
) {
    let mut renewed = Sides::default();
    for obstacle in predicted.iter().filter(|obstacle| obstacle.id != 0) {
        if let Some(side) = choose(obstacle).or_else(|| held(sides, obstacle)) {
            hold(&mut renewed, obstacle, side);
        }
    }
    *sides = renewed;
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;

    fn obstacle(id: u32, x: f64, y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.4 };
        PredictedObstacle { id, centre: [x, y], velocity: [0.0, 0.0], a: 1.2, b: 0.8, body, in_plane: None }
    }

    #[test]
    fn a_choice_is_recognised_by_identity_or_by_place() {
        let mut sides = Sides::default();
        hold(&mut sides, &obstacle(7, 5.0, 0.0), Passing::Right);
        assert_eq!(held(&sides, &obstacle(7, 5.9, 0.3)), Some(Passing::Right));
        assert_eq!(held(&sides, &obstacle(8, 5.2, 0.1)), Some(Passing::Right));
        assert_eq!(held(&sides, &obstacle(8, 6.0, 0.0)), None);
    }

    #[test]
    fn choices_of_ellipses_that_are_gone_are_forgotten() {
        let mut sides = Sides::default();
        hold(&mut sides, &obstacle(7, 5.0, 0.0), Passing::Right);
        renew(&mut sides, &[obstacle(9, 9.0, 0.0)], |_| Some(Passing::Left));
        assert_eq!(held(&sides, &obstacle(7, 5.0, 0.0)), None);
        assert_eq!(held(&sides, &obstacle(9, 9.0, 0.0)), Some(Passing::Left));
        renew(&mut sides, &[obstacle(9, 9.0, 0.0)], |_| None);
        assert_eq!(held(&sides, &obstacle(9, 9.0, 0.0)), Some(Passing::Left));
    }

    #[test]
    fn nonsense_in_a_checkpoint_is_left_out() {
        let mut entries = Sides::default();
        entries[0] = Side { id: 3, side: 40, x_m: 1.0, y_m: 0.0 };
        entries[1] = Side { id: 4, side: 1, x_m: f64::NAN, y_m: 0.0 };
        assert_eq!(valid(&entries), Sides::default());
    }
}
