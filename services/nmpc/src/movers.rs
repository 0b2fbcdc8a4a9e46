//! Bodies that moved when they were seen last, and where they may be by now.
//!
//! The scanner looks ahead. A body that moves may have come to ground that was free when the robot looked there, so
//! backwards all ground is left alone that it could have reached: in any direction, a little faster than it was seen to be.
//!
//! Assumed: what stood still has stayed where it was, and nothing came that was never seen.

use shared_types::{Obstacle, Obstacles, plain_state};
use vehicle::geometry::Rectangle;

use crate::predicted_obstacle;

/// How many bodies are remembered.
const MAX_MOVERS: usize = 16;
/// A body that moved rests when it was seen to for so long [ns]: at the edge of the view its velocity is lost first.
const RESTS_NS: u64 = 2_000_000_000;
/// A body may be faster than it was seen to be, by this share and by this much [m/s].
const FASTER: (f64, f64) = (1.25, 0.05);

plain_state! {
    /// One body.
    pub struct Mover {
        /// Identity of its ellipse
        pub id: u64,
        /// When it was seen last [ns]
        pub seen_ns: u64,
        /// When it was seen to move last [ns]
        pub moved_ns: u64,
        /// Centre of its box then [m]
        pub x_m: f64,
        /// Centre of its box, to the left of x [m]
        pub y_m: f64,
        /// Half of the diagonal of its box [m]
        pub radius_m: f64,
        /// How fast it may be [m/s]
        pub speed_mps: f64,
    }
}

plain_state! {
    /// The bodies, in no order.
    pub struct Movers {
        /// How many of `bodies` are used
        pub count: u64,
        /// The bodies
        pub bodies: [Mover; MAX_MOVERS],
    }
}

impl Movers {
    /// Follows the description of a scan that was taken at `now_ns`; bodies that were seen before `since_ns` are forgotten.
    pub(crate) fn follow(&mut self, obstacles: &Obstacles, now_ns: u64, since_ns: u64) {
        let mut kept = 0;
        for index in 0..self.len() {
            let mut known = self.bodies[index];
            match obstacles.list().iter().find(|one| u64::from(one.id) == known.id) {
                Some(one) if predicted_obstacle::moves(one) => continue,
                Some(one) if one.unseen_s == 0.0 => {
                    (known.seen_ns, known.x_m, known.y_m) = (now_ns, one.box_x_m, one.box_y_m);
                }
                Some(_) | None => {}
            }
            let rests = known.seen_ns.saturating_sub(known.moved_ns) >= RESTS_NS;
            if !rests && known.seen_ns >= since_ns {
                self.bodies[kept] = known;
                kept += 1;
            }
        }
        for one in obstacles.list().iter().filter(|one| predicted_obstacle::moves(one)) {
            let place = if kept < MAX_MOVERS { kept } else { self.oldest() };
            let seen_ns = now_ns.saturating_sub((one.unseen_s * 1e9) as u64);
            self.bodies[place] = Mover::of(one, seen_ns);
            kept = kept.max(place + 1);
        }
        self.count = kept as u64;
    }

    /// Whether one that is out of view may be within `clearance_m` of a body at `then_ns`.
    pub(crate) fn reach(&self, body: &Rectangle, clearance_m: f64, now_ns: u64, then_ns: u64) -> bool {
        self.bodies[..self.len()].iter().filter(|known| known.seen_ns < now_ns).any(|known| {
            let age_s = then_ns.saturating_sub(known.seen_ns) as f64 * 1e-9;
            let radius_m = known.radius_m + known.speed_mps * age_s + clearance_m;
            body.distance_to_point([known.x_m, known.y_m].into()) < radius_m
        })
    }

    /// What a checkpoint has of it; nothing where it is impossible.
    pub(crate) fn valid(&self) -> Self {
        let finite = |one: &Mover| {
            [one.x_m, one.y_m, one.radius_m, one.speed_mps].iter().all(|value| value.is_finite())
        };
        let is_valid = self.count <= MAX_MOVERS as u64 && self.bodies[..self.len()].iter().all(finite);
        if is_valid { *self } else { Self::default() }
    }

    fn len(&self) -> usize {
        (self.count as usize).min(MAX_MOVERS)
    }

    fn oldest(&self) -> usize {
        let pairs = self.bodies.iter().enumerate();
        pairs.min_by_key(|(_, known)| known.seen_ns).map_or(0, |(index, _)| index)
    }
}

impl Mover {
    fn of(one: &Obstacle, seen_ns: u64) -> Self {
        let speed_mps = one.velocity_x_mps.hypot(one.velocity_y_mps);
        Self {
            id: u64::from(one.id),
            seen_ns,
            moved_ns: seen_ns,
            x_m: one.box_x_m,
            y_m: one.box_y_m,
            radius_m: one.box_length_m.hypot(one.box_width_m) / 2.0,
            speed_mps: FASTER.0 * speed_mps + FASTER.1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    const SECOND: u64 = 1_000_000_000;

    fn described(bodies: &[(u32, f64, f64)]) -> Obstacles {
        let mut obstacles = Obstacles { count: bodies.len() as u32, ..Obstacles::default() };
        for (item, &(id, box_x_m, velocity_y_mps)) in obstacles.items.iter_mut().zip(bodies) {
            *item = Obstacle {
                id,
                box_x_m,
                velocity_y_mps,
                box_length_m: 0.6,
                box_width_m: 0.8,
                ..Obstacle::default()
            };
        }
        obstacles
    }

    fn at(x: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(x, 0.0), yaw: 0.0, length: 0.6, width: 0.4 }
    }

    #[test]
    fn a_body_that_moved_may_be_wherever_it_could_get_to() {
        let mut movers = Movers::default();
        movers.follow(&described(&[(1, 0.0, 0.2)]), SECOND, 0);
        assert!(!movers.reach(&at(0.0), 0.0, SECOND, 2 * SECOND), "it is in view and predicted");
        let mut unseen = described(&[(1, 0.0, 0.2)]);
        unseen.items[0].unseen_s = 1.0;
        movers.follow(&unseen, 2 * SECOND, 0);
        // Half a diagonal of 0.5 m, 0.3 m in each second, 0.3 m of the robot: at 3.8 m after 10 s.
        let reached = |x: f64| movers.reach(&at(x), 0.0, 2 * SECOND, 11 * SECOND);
        assert!(reached(3.79) && !reached(3.81));
        assert!(movers.reach(&at(3.84), 0.05, 2 * SECOND, 11 * SECOND));
    }

    #[test]
    fn one_that_rests_or_was_seen_long_ago_is_no_mover() {
        let mut movers = Movers::default();
        movers.follow(&described(&[(1, 0.0, 0.2), (2, 3.0, 0.0)]), SECOND, 0);
        assert_eq!(movers.count, 1);
        let mut rests = movers;
        rests.follow(&described(&[(1, 0.2, 0.0)]), 2 * SECOND, 0);
        assert_eq!(rests.count, 1, "for too short a time");
        rests.follow(&described(&[(1, 0.2, 0.0)]), 3 * SECOND, 0);
        assert_eq!(rests.count, 0);
        movers.follow(&described(&[]), 2 * SECOND, SECOND);
        assert_eq!(movers.count, 1);
        movers.follow(&described(&[]), 2 * SECOND, SECOND + 1);
        assert_eq!(movers.count, 0);
    }

    #[test]
    fn of_too_many_the_last_count_and_impossible_ones_are_not_continued_from() {
        let mut movers = Movers::default();
        for id in 1..=20 {
            movers.follow(&described(&[(id, f64::from(id), 0.2)]), u64::from(id) * SECOND, 0);
        }
        assert_eq!(movers.len(), MAX_MOVERS);
        assert!(movers.bodies.iter().all(|known| known.id > 4));
        assert_eq!(movers.valid(), movers);
        assert_eq!(Movers { count: 90, ..movers }.valid(), Movers::default());
        movers.bodies[2].speed_mps = f64::NAN;
        assert_eq!(movers.valid(), Movers::default());
    }
}
