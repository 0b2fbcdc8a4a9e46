//! The ellipses of the last scan, so that noise of the description does not move those of this one by centimetres.
//!
//! A plan that is near the optimum drives along an ellipse. Then each jump of the ellipse is a jump of the steering. So
//! centre, axes and velocity follow the description with a first-order lag; the body, which is verified, is taken as it is
//! described. A change that noise does not explain is followed at once.
//!
//! Kept with it: by how much an ellipse was enlarged because the body came too near outside of it.

use shared_types::{MAX_OBSTACLES, plain_state};

use crate::predicted_obstacle::PredictedObstacle;

/// An ellipse is enlarged by at most this [m].
pub(crate) const MAX_GROWN_M: f64 = 0.3;
/// Changes larger than these are no noise: of centre [m], velocity [m/s], a and b [m].
const JUMP: [f64; 6] = [0.08, 0.08, 0.08, 0.08, 0.5, 0.08];

plain_state! {
    /// An ellipse as the last plan had it; one with the identity 0 is not used.
    pub struct SmoothedEllipse {
        /// Identity of the ellipse
        pub id: u32,
        /// Unused, zero
        pub reserved: u32,
        /// Centre at the start of the plan, and its velocity [m, m/s]
        pub motion: [f64; 4],
        /// Semi-axes along and across the track [m]
        pub axes: [f64; 2],
        /// By how much the ellipse was enlarged [m]
        pub grown_m: f64,
    }
}

/// The ellipses of one scan.
pub(crate) type SmoothedEllipses = [SmoothedEllipse; MAX_OBSTACLES];

impl SmoothedEllipse {
    fn values(&self) -> [f64; 6] {
        let ([x, y, vx, vy], [a, b]) = (self.motion, self.axes);
        [x, y, vx, vy, a, b]
    }

    /// The values `elapsed_s` later.
    fn later(&self, elapsed_s: f64) -> [f64; 6] {
        let [x, y, vx, vy, a, b] = self.values();
        [x + vx * elapsed_s, y + vy * elapsed_s, vx, vy, a, b]
    }
}

/// Replaces the ellipses of `predicted` by smoothed ones; plans start `elapsed_s` after those of the last scan.
pub(crate) fn smooth(
    known: &mut SmoothedEllipses,
    predicted: &mut [PredictedObstacle],
    elapsed_s: f64,
    time_constant_s: f64,
) {
    let gain = 1.0 - (-elapsed_s / time_constant_s).exp();
    let mut renewed = SmoothedEllipses::default();
    for (obstacle, entry) in predicted.iter_mut().zip(&mut renewed) {
        let now = values(obstacle);
        let before = known.iter().find(|entry| entry.id != 0 && entry.id == obstacle.id);
        let followed = before.map(|before| (before.later(elapsed_s), before.grown_m));
        let (next, grown_m) = match followed {
            Some((before, grown_m)) if is_noise(&before, &now) => {
                (std::array::from_fn(|index| before[index] + gain * (now[index] - before[index])), grown_m)
            }
            _ => (now, followed.map_or(0.0, |(_, grown_m)| grown_m)),
        };
        let [x, y, vx, vy, a, b] = next;
        (obstacle.centre, obstacle.velocity, obstacle.a, obstacle.b) = ([x, y], [vx, vy], a, b);
        *entry =
            SmoothedEllipse { id: obstacle.id, reserved: 0, motion: [x, y, vx, vy], axes: [a, b], grown_m };
    }
    *known = renewed;
}

/// By how much the ellipse of an obstacle was enlarged [m].
pub(crate) fn grown(known: &SmoothedEllipses, id: u32) -> f64 {
    known.iter().find(|entry| entry.id != 0 && entry.id == id).map_or(0.0, |entry| entry.grown_m)
}

/// Whether an ellipse moved at the scan before.
pub(crate) fn moved(known: &SmoothedEllipses, id: u32) -> bool {
    let [.., x, y] =
        known.iter().find(|entry| entry.id != 0 && entry.id == id).map_or([0.0; 4], |entry| entry.motion);
    [x, y] != [0.0, 0.0]
}

/// Notes by how much the ellipse of an obstacle is enlarged.
pub(crate) fn grow(known: &mut SmoothedEllipses, id: u32, grown_m: f64) {
    if let Some(entry) = known.iter_mut().find(|entry| entry.id != 0 && entry.id == id) {
        entry.grown_m = grown_m;
    }
}

/// The entries of a checkpoint without impossible ones.
pub(crate) fn valid(known: &SmoothedEllipses) -> SmoothedEllipses {
    let is_valid = |entry: &SmoothedEllipse| {
        entry.values().iter().all(|value| value.abs() < 1e5)
            && entry.axes.iter().all(|axis| *axis > 0.0)
            && (0.0..=MAX_GROWN_M).contains(&entry.grown_m)
    };
    known.map(|entry| if is_valid(&entry) { entry } else { SmoothedEllipse::default() })
}

fn values(obstacle: &PredictedObstacle) -> [f64; 6] {
    let ([x, y], [vx, vy]) = (obstacle.centre, obstacle.velocity);
    [x, y, vx, vy, obstacle.a, obstacle.b]
}

/// Whether noise explains the change; a body that begins to move or stops is no noise.
fn is_noise(before: &[f64; 6], now: &[f64; 6]) -> bool {
    let moves = |values: &[f64; 6]| values[2] != 0.0 || values[3] != 0.0;
    let is_small = before.iter().zip(now).zip(JUMP).all(|((before, now), jump)| (before - now).abs() < jump);
    moves(before) == moves(now) && is_small
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;

    fn obstacle(x: f64, velocity_y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, 0.0), yaw: 0.0, length: 0.1, width: 0.4 };
        PredictedObstacle {
            id: 3,
            centre: [x, 0.0],
            velocity: [0.0, velocity_y],
            a: 1.2,
            b: 0.5,
            body,
            in_plane: None,
        }
    }

    #[test]
    fn noise_moves_the_ellipse_by_the_share_of_a_lag_and_the_body_at_once() {
        let (mut known, mut predicted) = (SmoothedEllipses::default(), [obstacle(5.0, 0.0)]);
        smooth(&mut known, &mut predicted, 0.1, 0.3);
        assert_eq!(predicted[0], obstacle(5.0, 0.0));
        predicted = [obstacle(5.03, 0.0)];
        smooth(&mut known, &mut predicted, 0.1, 0.3);
        let expected = 5.0 + 0.03 * (1.0 - (-1.0_f64 / 3.0).exp());
        assert!((predicted[0].centre[0] - expected).abs() < 1e-12);
        assert_eq!(predicted[0].body, obstacle(5.03, 0.0).body);
    }

    #[test]
    fn a_jump_and_a_body_that_begins_to_move_are_followed_at_once() {
        for changed in [obstacle(5.09, 0.0), obstacle(5.0, 0.07)] {
            let mut known = SmoothedEllipses::default();
            smooth(&mut known, &mut [obstacle(5.0, 0.0)], 0.1, 0.3);
            let mut predicted = [changed];
            smooth(&mut known, &mut predicted, 0.1, 0.3);
            assert_eq!(predicted[0], changed);
        }
    }

    #[test]
    fn a_moving_ellipse_moves_on_and_its_enlargement_is_kept() {
        let mut known = SmoothedEllipses::default();
        smooth(&mut known, &mut [obstacle(5.0, 0.2)], 0.1, 0.3);
        grow(&mut known, 3, 0.02);
        let mut moved = obstacle(5.0, 0.2);
        moved.centre[1] = 0.02;
        let mut predicted = [moved];
        smooth(&mut known, &mut predicted, 0.1, 0.3);
        assert!((predicted[0].centre[1] - 0.02).abs() < 1e-12);
        assert_eq!((grown(&known, 3), grown(&known, 4)), (0.02, 0.0));
    }

    #[test]
    fn nonsense_in_a_checkpoint_is_left_out() {
        let mut known = SmoothedEllipses::default();
        known[0] = SmoothedEllipse { id: 1, axes: [1.2, f64::NAN], ..SmoothedEllipse::default() };
        known[1] = SmoothedEllipse { id: 2, axes: [1.2, 0.5], grown_m: 3.0, ..SmoothedEllipse::default() };
        assert_eq!(valid(&known), SmoothedEllipses::default());
    }
}
