//! Bodies that moved when they were seen last, and where they may be by now.
//!
//! The scanner looks ahead. A body that moves may have come to ground that was free when the robot looked there, so
//! backwards all ground is left alone that it could have reached: in any direction, a little faster than it was seen to be.
//! At the edge of the view the velocity of a body stays unknown: there it is what the way since the first sight tells, and
//! until that tells anything the body may move.
//!
//! Assumed: what stood still has stayed where it was, and nothing came that was never seen.

use shared_types::{Obstacle, Obstacles, plain_state};
use vehicle::geometry::Rectangle;

use crate::predicted_obstacle;

/// How many bodies are remembered: those of a description, and some more.
const MAX_MOVERS: usize = shared_types::MAX_OBSTACLES + 8;
/// A body may be faster than it was seen to be, by this share and by this much [m/s].
const FASTER: (f64, f64) = (1.25, 0.05);
/// A body that moved rests when it was seen to for so long [ns]: at the edge of the view its velocity is lost first.
const RESTS_NS: u64 = 2_000_000_000;
/// A velocity of this standard deviation is not known [m/s].
const UNKNOWN_MPS: f64 = 0.35;
/// Without a known velocity a body that has come so far moves [m]: less is what a wider view of it makes ...
const CREPT_M: f64 = 0.15;
/// ... one that is seen for less than this, and in fewer scans, may move ...
const FRESH_NS: u64 = 1_500_000_000;
const FRESH_SCANS: u64 = 20;
/// ... this fast [m/s], and when it is lost after less ...
const FRESH_MPS: f64 = 0.5;
/// ... this fast [m/s], and not further than what would have shown that it moves: what is faster is described so.
const CREEPS_MPS: f64 = 0.1;

plain_state! {
    /// One body.
    pub struct Mover {
        /// Identity of its ellipse
        pub id: u64,
        /// Since when it is seen [ns]
        pub since_ns: u64,
        /// When it was seen last [ns]
        pub seen_ns: u64,
        /// When it was seen to move last [ns]; 0 for never
        pub moved_ns: u64,
        /// Whether it is predicted by its velocity as long as it is in view
        pub is_predicted: u64,
        /// Centre of its box at first [m]
        pub first_m: [f64; 2],
        /// Centre of its box when it was seen last [m]
        pub last_m: [f64; 2],
        /// Half of the diagonal of its box, at first and when it was seen last [m]
        pub radius_m: [f64; 2],
        /// How fast it may be; 0 when it rests [m/s]
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
    /// Whether one of them may be in motion.
    pub(crate) fn move_about(&self) -> bool {
        self.bodies[..self.len()].iter().any(|body| body.speed_mps > 0.0)
    }

    /// Follows the description of a scan that was taken at `now_ns`; bodies that were seen before `since_ns` are forgotten.
    pub(crate) fn follow(&mut self, obstacles: &Obstacles, now_ns: u64, since_ns: u64) {
        let described = |known: &Mover| obstacles.list().iter().find(|one| u64::from(one.id) == known.id);
        let mut kept = 0;
        for index in 0..self.len() {
            let mut known = self.bodies[index];
            match described(&known) {
                Some(one) => known.see(one, now_ns),
                None if known.speed_mps == 0.0 || known.seen_ns < since_ns => continue,
                None => known.lose(),
            }
            self.bodies[kept] = known;
            kept += 1;
        }
        for one in obstacles.list() {
            if self.bodies[..kept].iter().any(|known| known.id == u64::from(one.id)) {
                continue;
            }
            let place = if kept < MAX_MOVERS { kept } else { self.oldest() };
            self.bodies[place] = Mover::of(one, now_ns);
            kept = kept.max(place + 1);
        }
        self.count = kept as u64;
    }

    /// Whether one that no prediction is for may be within `clearance_m` of a body at `then_ns`.
    pub(crate) fn reach(&self, body: &Rectangle, clearance_m: f64, now_ns: u64, then_ns: u64) -> bool {
        let moving =
            |known: &&Mover| known.speed_mps > 0.0 && (known.is_predicted == 0 || known.seen_ns < now_ns);
        self.bodies[..self.len()].iter().filter(moving).any(|known| {
            let age_s = then_ns.saturating_sub(known.seen_ns) as f64 * 1e-9;
            let most_m = if known.moved_ns == 0 && known.seen_ns < now_ns { CREPT_M } else { f64::INFINITY };
            let way_m = (known.speed_mps * age_s).min(most_m);
            let radius_m = known.radius_m[1] + way_m + clearance_m;
            body.distance_to_point(known.last_m.into()) < radius_m
        })
    }

    /// What a checkpoint has of it; nothing where it is impossible.
    pub(crate) fn valid(&self) -> Self {
        let finite = |one: &Mover| {
            let numbers = [one.first_m, one.last_m, one.radius_m, [one.speed_mps, 0.0]];
            numbers.as_flattened().iter().all(|value| value.is_finite())
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
    fn of(one: &Obstacle, now_ns: u64) -> Self {
        let first_m = [one.box_x_m, one.box_y_m];
        let radius_m = [half_diagonal_m(one); 2];
        let mut new = Self { id: u64::from(one.id), since_ns: now_ns, first_m, radius_m, ..Self::default() };
        new.see(one, now_ns);
        new
    }

    /// Follows its description.
    fn see(&mut self, one: &Obstacle, now_ns: u64) {
        let unseen_ns = (one.unseen_s * 1e9) as u64;
        let is_in_view = unseen_ns == 0;
        let is_predicted = predicted_obstacle::moves(one);
        if is_in_view || is_predicted {
            self.seen_ns = now_ns.saturating_sub(unseen_ns);
            self.last_m = [one.box_x_m, one.box_y_m];
            self.radius_m[1] = half_diagonal_m(one);
        }
        self.is_predicted = u64::from(is_predicted);
        if is_predicted {
            self.moves(one.velocity_x_mps.hypot(one.velocity_y_mps));
        } else if is_in_view {
            self.judge(one);
        } else {
            self.lose();
        }
    }

    /// Judges one in view that is not described as one that moves.
    fn judge(&mut self, one: &Obstacle) {
        let [xx, _, yy] = one.velocity_covariance;
        let way_m = (self.last_m[0] - self.first_m[0]).hypot(self.last_m[1] - self.first_m[1]);
        // The centre of one of which more is seen than at first is elsewhere by half of that.
        let way_m = way_m - (self.radius_m[1] - self.radius_m[0]).max(0.0);
        let seen_for_ns = self.seen_ns.saturating_sub(self.since_ns);
        let is_unknown = xx.max(yy) > UNKNOWN_MPS * UNKNOWN_MPS;
        if is_unknown && way_m > CREPT_M {
            self.moves(way_m / (seen_for_ns as f64 * 1e-9).max(1e-3));
        } else if is_unknown && seen_for_ns < FRESH_NS && one.sightings < FRESH_SCANS {
            self.speed_mps = FRESH_MPS;
        } else if self.moved_ns == 0 || self.seen_ns.saturating_sub(self.moved_ns) >= RESTS_NS {
            (self.speed_mps, self.moved_ns) = (0.0, 0);
            (self.since_ns, self.first_m) = (self.seen_ns.saturating_sub(FRESH_NS), self.last_m);
            self.radius_m[0] = self.radius_m[1];
        }
    }

    /// It is out of view: of one that was not seen to move only what is not described can have moved.
    fn lose(&mut self) {
        if self.moved_ns == 0 {
            self.speed_mps = self.speed_mps.min(CREEPS_MPS);
        }
    }

    fn moves(&mut self, speed_mps: f64) {
        (self.speed_mps, self.moved_ns) = (FASTER.0 * speed_mps + FASTER.1, self.seen_ns.max(1));
    }
}

/// Half of the diagonal of a body's box [m].
fn half_diagonal_m(one: &Obstacle) -> f64 {
    one.box_length_m.hypot(one.box_width_m) / 2.0
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
        let moving =
            |movers: &Movers| movers.bodies[..movers.len()].iter().filter(|one| one.speed_mps > 0.0).count();
        movers.follow(&described(&[(1, 0.0, 0.2), (2, 3.0, 0.0)]), SECOND, 0);
        assert_eq!(moving(&movers), 1);
        let mut rests = movers;
        rests.follow(&described(&[(1, 0.2, 0.0)]), 2 * SECOND, 0);
        assert_eq!(moving(&rests), 1, "for too short a time");
        rests.follow(&described(&[(1, 0.2, 0.0)]), 3 * SECOND, 0);
        assert_eq!(moving(&rests), 0);
        movers.follow(&described(&[]), 2 * SECOND, SECOND);
        assert_eq!(moving(&movers), 1);
        movers.follow(&described(&[]), 2 * SECOND, SECOND + 1);
        assert_eq!(movers.count, 0);
    }

    #[test]
    fn of_an_unknown_velocity_the_way_tells_and_at_first_nothing_does() {
        let mut movers = Movers::default();
        let see = |movers: &mut Movers, tenths: u64, x: f64| {
            let mut obstacles = described(&[(1, x, 0.0)]);
            obstacles.items[0].velocity_covariance = [0.49, 0.0, 0.49];
            movers.follow(&obstacles, SECOND + tenths * SECOND / 10, 0);
            movers.bodies[0].speed_mps
        };
        assert_eq!(see(&mut movers, 0, 0.0), FRESH_MPS);
        let mut stands = movers;
        assert_eq!((see(&mut stands, 14, 0.1), see(&mut stands, 15, 0.1)), (FRESH_MPS, 0.0));
        // 0.2 m in half a second.
        assert!((see(&mut movers, 5, 0.2) - (1.25 * 0.4 + 0.05)).abs() < 1e-9);
        let mut grows = stands;
        let mut longer = described(&[(1, 0.5, 0.0)]);
        (longer.items[0].box_length_m, longer.items[0].velocity_covariance) = (1.4, [0.49, 0.0, 0.49]);
        grows.follow(&longer, 3 * SECOND, 0);
        assert_eq!(grows.bodies[0].speed_mps, 0.0, "more is seen of it");
        movers.follow(&described(&[]), 2 * SECOND, 0);
        assert_eq!(movers.count, 1);
        let mut lost = movers;
        stands.follow(&described(&[]), 3 * SECOND, 0);
        assert_eq!(stands.count, 0);
        lost.bodies[0] = Mover { moved_ns: 0, speed_mps: FRESH_MPS, ..lost.bodies[0] };
        lost.follow(&described(&[]), 3 * SECOND, 0);
        assert_eq!(lost.bodies[0].speed_mps, CREEPS_MPS);
    }

    #[test]
    fn of_too_many_the_last_count_and_impossible_ones_are_not_continued_from() {
        let mut movers = Movers::default();
        for id in 1..=30 {
            movers.follow(&described(&[(id, f64::from(id), 0.2)]), u64::from(id) * SECOND, 0);
        }
        assert_eq!(movers.len(), MAX_MOVERS);
        assert!(movers.bodies.iter().all(|known| known.id > 6));
        assert_eq!(movers.valid(), movers);
        assert_eq!(Movers { count: 90, ..movers }.valid(), Movers::default());
        movers.bodies[2].speed_mps = f64::NAN;
        assert_eq!(movers.valid(), Movers::default());
    }
}
