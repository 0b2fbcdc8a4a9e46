//! Bodies at rest that the robot has passed, or that stand in a dead end: the description forgets what is far behind.
//!
//! They count where the robot drives backwards, and until it has passed a dead end. What is described now is taken from the
//! description; what should be described and is not has gone.

use shared_types::{MAX_OBSTACLES, Obstacle, Obstacles, Pose, plain_state};
use vehicle::frame::to_robot;

use crate::predicted_obstacle;

/// How many ellipses are remembered.
const MAX_BODIES: usize = 32;
/// Ellipses whose centres are no further apart are of one body [m].
const SAME_M: f64 = 0.6;
/// So near ahead of the robot what stands there is described; what is not has gone [m]. It stops up to 3.5 m before what it is
/// too near to turn away from: the description tells there when that goes.
const DESCRIBED_M: f64 = 4.0;
/// The same to the side, by the distance ahead.
const DESCRIBED_SIDE: f64 = 0.8;
/// What is farther away is forgotten [m].
const FAR_M: f64 = 14.0;
/// What is added to the identity of what is remembered: another ellipse may have it now.
const REMEMBERED: u32 = 1 << 30;

plain_state! {
    /// The ellipses that are remembered.
    pub struct Memory {
        /// How many of `bodies` are used
        pub count: u64,
        /// In no order
        pub bodies: [Obstacle; MAX_BODIES],
    }
}

impl Memory {
    /// Follows the description of a scan.
    pub(crate) fn follow(&mut self, obstacles: &Obstacles, pose: &Pose) {
        let mut kept = 0;
        for index in 0..self.len() {
            let known = self.bodies[index];
            let from = to_robot(pose.yaw_rad, known.x_m - pose.x_m, known.y_m - pose.y_m);
            let is_near = (0.0..DESCRIBED_M).contains(&from.x) && from.y.abs() < DESCRIBED_SIDE * from.x;
            // What is described is entered anew.
            if is_near || from.norm() > FAR_M || obstacles.list().iter().any(|one| is_same(one, &known)) {
                continue;
            }
            self.bodies[kept] = known;
            kept += 1;
        }
        self.count = kept as u64;
        for obstacle in obstacles.list().iter().filter(|one| !predicted_obstacle::moves(one)) {
            let place = if self.len() < MAX_BODIES { self.len() } else { self.farthest(pose) };
            self.bodies[place] = Obstacle {
                id: obstacle.id & !REMEMBERED,
                velocity_x_mps: 0.0,
                velocity_y_mps: 0.0,
                ..*obstacle
            };
            self.count = self.count.max(place as u64 + 1);
        }
    }

    /// The description with what is remembered beside it: of all the ellipses that are nearest to the robot.
    pub(crate) fn beside(&self, obstacles: &Obstacles, pose: &Pose) -> Obstacles {
        let mut all = *obstacles;
        for known in &self.bodies[..self.len()] {
            if obstacles.list().iter().any(|one| is_same(one, known)) {
                continue;
            }
            let known = Obstacle { id: known.id | REMEMBERED, ..*known };
            let count = all.count as usize;
            if count < MAX_OBSTACLES {
                all.items[count] = known;
                all.count += 1;
                continue;
            }
            let place = farthest(&all.items, pose);
            if distance(&all.items[place], pose) > distance(&known, pose) {
                all.items[place] = known;
            }
        }
        all
    }

    /// What a checkpoint has of it; nothing where it is impossible.
    pub(crate) fn valid(&self) -> Self {
        let finite = |one: &Obstacle| {
            [one.x_m, one.y_m, one.a_m, one.b_m, one.box_x_m, one.box_y_m]
                .iter()
                .all(|value| value.is_finite())
        };
        let is_valid = self.count <= MAX_BODIES as u64 && self.bodies[..self.len()].iter().all(finite);
        if is_valid { *self } else { Self::default() }
    }

    fn len(&self) -> usize {
        (self.count as usize).min(MAX_BODIES)
    }

    fn farthest(&self, pose: &Pose) -> usize {
        farthest(&self.bodies, pose)
    }
}

fn is_same(one: &Obstacle, known: &Obstacle) -> bool {
    one.id == known.id || (one.x_m - known.x_m).hypot(one.y_m - known.y_m) < SAME_M
}

fn distance(one: &Obstacle, pose: &Pose) -> f64 {
    (one.box_x_m - pose.x_m).hypot(one.box_y_m - pose.y_m)
}

fn farthest(bodies: &[Obstacle], pose: &Pose) -> usize {
    let pairs = bodies.iter().enumerate().map(|(index, one)| (index, distance(one, pose)));
    pairs.max_by(|one, other| one.1.total_cmp(&other.1)).map_or(0, |(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(bodies: &[(u32, f64)]) -> Obstacles {
        let mut obstacles = Obstacles { count: bodies.len() as u32, ..Obstacles::default() };
        for (item, &(id, x_m)) in obstacles.items.iter_mut().zip(bodies) {
            *item = Obstacle { id, x_m, box_x_m: x_m, ..Obstacle::default() };
        }
        obstacles
    }

    fn at(x_m: f64) -> Pose {
        Pose { x_m, ..Pose::default() }
    }

    fn places(obstacles: &Obstacles) -> Vec<f64> {
        obstacles.list().iter().map(|one| one.x_m).collect()
    }

    #[test]
    fn what_is_not_described_any_more_is_remembered_beside_what_is() {
        let mut memory = Memory::default();
        memory.follow(&described(&[(1, 3.0), (2, 5.0)]), &at(1.0));
        memory.follow(&described(&[(2, 5.1), (3, 9.0)]), &at(7.0));
        let all = memory.beside(&described(&[(2, 5.1), (3, 9.0)]), &at(7.0));
        assert_eq!(places(&all), [5.1, 9.0, 3.0]);
        assert_eq!(all.items[2].id, 1 | REMEMBERED);
        // The same body under another identity is described once.
        memory.follow(&described(&[(4, 3.2)]), &at(7.0));
        assert!(!places(&memory.beside(&described(&[(4, 3.2)]), &at(7.0))).contains(&3.0));
    }

    #[test]
    fn what_moves_has_gone_or_is_far_is_not_remembered() {
        let mut memory = Memory::default();
        let mut moving = described(&[(1, 3.0)]);
        moving.items[0].velocity_y_mps = 0.3;
        memory.follow(&moving, &at(1.0));
        assert_eq!(memory.count, 0);
        memory.follow(&described(&[(2, 6.0)]), &at(1.0));
        let mut gone = memory;
        gone.follow(&described(&[]), &at(1.9));
        assert_eq!(gone.count, 1, "too far to tell");
        gone.follow(&described(&[]), &at(2.1));
        assert_eq!(gone.count, 0, "in view and not there");
        memory.follow(&described(&[]), &at(7.0));
        assert_eq!(memory.count, 1);
        memory.follow(&described(&[]), &at(21.0));
        assert_eq!(memory.count, 0, "far");
    }

    #[test]
    fn of_too_many_the_nearest_count() {
        let mut memory = Memory::default();
        for id in 1..=40_u32 {
            let x_m = f64::from(id);
            memory.follow(&described(&[(id, x_m)]), &at(x_m + 0.1));
        }
        assert!(memory.len() <= MAX_BODIES);
        let full: Vec<_> = (101..=116).map(|id| (id, f64::from(id) - 60.0)).collect();
        let all = places(&memory.beside(&described(&full), &at(40.1)));
        assert_eq!(all.len(), MAX_OBSTACLES);
        assert!(all.contains(&40.0) && all.contains(&41.0) && !all.contains(&56.0), "{all:?}");
        assert_eq!(Memory { count: 90, ..memory }.valid(), Memory::default());
    }
}
