//! Where the robot was and what its scanner showed from there: what is behind it now.
//!
//! The scanner looks ahead. A robot that drives backwards therefore stays on ground where its body was before, or that
//! was in view and not hidden by a body that is known, not long ago, and that no body that moved can have reached since.
//! What came from where the robot never looked is not seen, and is touched.
//!
//! The same places are the way back out of a dead end.

use nalgebra::Vector2;
use shared_types::{Pose, ScannerHealth, plain_state};
use vehicle::frame::{to_robot, to_track, wrap_angle};
use vehicle::geometry::{Rectangle, ray_in_box};
use vehicle::{Description, State};

use crate::config::ControllerConfig;
use crate::movers::Movers;

/// How many places are remembered: over 12 m.
const PLACES: usize = 64;
/// How far the robot moves, or turns, from one place to the next [m, rad].
const APART: (f64, f64) = (0.2, 0.15);
/// The scanner shows what is at most so far to either side of the front, and so far away [rad, m].
const VIEW: (f64, f64) = (1.02, 5.0);
/// Around the body of a place it is free as far as the robot gets between two places [m].
const AROUND_M: f64 = 0.15;

plain_state! {
    /// One place.
    pub struct Sight {
        /// Position of the robot [m]
        pub x_m: f64,
        /// Position of the robot, to the left of x [m]
        pub y_m: f64,
        /// Its direction [rad]
        pub yaw_rad: f64,
        /// How far ahead nothing is missed there [m]
        pub seen_m: f64,
        /// When the robot was there last [ns]
        pub seen_ns: u64,
    }
}

plain_state! {
    /// The last places, in a ring.
    pub struct Sights {
        /// Number of places that were entered and not taken back
        pub entered: u64,
        /// The number of the first one that is still there
        pub first: u64,
        /// The places
        pub places: [Sight; PLACES],
    }
}

/// What a robot that drives backwards knows of the ground that it comes to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Behind<'a> {
    /// Where the robot was
    pub(crate) sights: &'a Sights,
    /// What moved there
    pub(crate) movers: &'a Movers,
    /// When the scan was taken [ns]
    pub(crate) now_ns: u64,
    /// When the plan starts [ns]
    pub(crate) start_ns: u64,
    /// What was seen before is not known any more [ns]
    pub(crate) since_ns: u64,
}

impl Behind<'_> {
    /// Whether a body `t` seconds after the start of the plan is on ground that is free, past the bodies that are known.
    pub(crate) fn is_free(
        &self,
        body: &Rectangle,
        t: f64,
        config: &ControllerConfig,
        bodies: &[Rectangle],
    ) -> bool {
        let then_ns = self.start_ns.saturating_add((t * 1e9) as u64);
        self.sights.show(body, self.since_ns, &config.vehicle, bodies)
            && !self.movers.reach(body, config.clearance_m, self.now_ns, then_ns)
    }
}

impl Sights {
    /// Enters the place of a scan unless the robot is still near the last one; backwards near any one.
    pub(crate) fn enter(&mut self, pose: &Pose, scanner: &ScannerHealth) {
        let (x_m, y_m, yaw_rad) = (pose.x_m, pose.y_m, pose.yaw_rad);
        if ![x_m, y_m, yaw_rad].iter().all(|value| value.is_finite()) {
            return;
        }
        let seen_m = if scanner.state().is_stop() { 0.0 } else { scanner.seen_ahead_m };
        let seen_ns = pose.header.acquired_ns;
        let is_near = |last: &Sight| {
            (last.x_m - x_m).hypot(last.y_m - y_m) < APART.0
                && wrap_angle(last.yaw_rad - yaw_rad).abs() < APART.1
        };
        let newest = self.newest().next().copied();
        if let Some(last) = newest.filter(is_near) {
            // It still shows what it showed; where it does not any more, that is as old as it was.
            if seen_m.min(VIEW.1) >= last.seen_m.min(VIEW.1) {
                let index = ((self.entered - 1) % PLACES as u64) as usize;
                self.places[index].seen_ns = seen_ns;
            }
            return;
        }
        if pose.speed_mps < 0.0 && self.newest().any(is_near) {
            return;
        }
        let index = (self.entered % PLACES as u64) as usize;
        self.places[index] = Sight { x_m, y_m, yaw_rad, seen_m, seen_ns };
        self.entered += 1;
        self.first = self.first.max(self.entered.saturating_sub(PLACES as u64));
    }

    /// The places of a checkpoint; none when a number of it is impossible.
    pub(crate) fn valid(&self) -> Self {
        let finite =
            |sight: &Sight| [sight.x_m, sight.y_m, sight.yaw_rad, sight.seen_m].iter().all(|v| v.is_finite());
        let count = self.entered.checked_sub(self.first);
        let is_valid = count.is_some_and(|count| count <= PLACES as u64) && self.places.iter().all(finite);
        if is_valid { *self } else { Self::default() }
    }

    /// The places, the last one first.
    fn newest(&self) -> impl Iterator<Item = &Sight> {
        (self.first..self.entered).rev().map(|number| &self.places[(number % PLACES as u64) as usize])
    }

    /// Where the robot was `way_m` before it came to a place; nothing where that is not remembered.
    pub(crate) fn before(&self, [x_m, y_m]: [f64; 2], way_m: f64) -> Option<State> {
        let (mut left_m, mut from) = (way_m, Vector2::new(x_m, y_m));
        for sight in self.newest() {
            let to = Vector2::new(sight.x_m, sight.y_m);
            let step = (to - from).norm();
            if step >= left_m && step > 0.0 {
                let at = from + (to - from) * (left_m / step);
                return Some(State { x: at.x, y: at.y, yaw: sight.yaw_rad, ..State::default() });
            }
            (left_m, from) = (left_m - step, to);
        }
        None
    }

    /// Takes the last places back, to the one that is nearest to where the robot is: it drove back to there.
    pub(crate) fn take_back(&mut self, [x_m, y_m]: [f64; 2]) {
        let distance = |sight: &Sight| (sight.x_m - x_m).hypot(sight.y_m - y_m);
        let nearest = (self.first..self.entered).rev().min_by(|one, other| {
            let of = |number: &u64| distance(&self.places[(*number % PLACES as u64) as usize]);
            of(one).total_cmp(&of(other))
        });
        self.entered = nearest.map_or(self.entered, |number| number + 1);
    }

    /// Whether all of a body is on ground that was seen since a time, past the bodies that are known.
    fn show(&self, body: &Rectangle, since_ns: u64, vehicle: &Description, bodies: &[Rectangle]) -> bool {
        let corners = body.corners();
        let middles = [0, 1, 2, 3].map(|index| (corners[index] + corners[(index + 1) % 4]) / 2.0);
        corners.into_iter().chain(middles).all(|point| {
            let mut lately = self.newest().filter(|sight| sight.seen_ns >= since_ns);
            lately.any(|sight| sight.shows(point, vehicle, bodies))
        })
    }
}

impl Sight {
    /// Whether a point was under the body here, or in view of the scanner.
    fn shows(&self, point: Vector2<f64>, vehicle: &Description, bodies: &[Rectangle]) -> bool {
        let from = to_robot(self.yaw_rad, point.x - self.x_m, point.y - self.y_m);
        let is_under = (from.x - vehicle.body_x_m).abs() <= vehicle.length_m / 2.0 + AROUND_M
            && from.y.abs() <= vehicle.width_m / 2.0 + AROUND_M;
        if is_under {
            return true;
        }
        let ahead = from - Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m);
        let is_in_view = ahead.norm() <= self.seen_m.min(VIEW.1)
            && ahead.x > 0.0
            && ahead.y.abs() <= VIEW.0.tan() * ahead.x;
        is_in_view && {
            let scanner = point - to_track(self.yaw_rad, ahead.x, ahead.y);
            !bodies.iter().any(|body| hides(body, scanner, point))
        }
    }
}

/// Whether a body is between two points.
fn hides(body: &Rectangle, from: Vector2<f64>, to: Vector2<f64>) -> bool {
    let local = |point: Vector2<f64>| to_robot(body.yaw, point.x - body.centre.x, point.y - body.centre.y);
    let (origin, end) = (local(from), local(to));
    let half = Vector2::new(body.length / 2.0, body.width / 2.0);
    ray_in_box(origin, end - origin, half).is_some_and(|(enter, leave)| enter < 1.0 && leave > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::Header;

    fn driven(way_m: f64) -> Sights {
        let mut sights = Sights::default();
        for step in 0..=(way_m / 0.05) as u32 {
            let pose = Pose { x_m: 0.05 * f64::from(step), ..Pose::default() };
            sights.enter(&pose, &ScannerHealth::healthy(5.0));
        }
        sights
    }

    fn body(x: f64, y: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.56, width: 0.4 }
    }

    #[test]
    fn ground_is_seen_where_the_body_was_and_where_the_scanner_showed_it() {
        let (sights, vehicle) = (driven(3.0), Description::default());
        let shown = |x: f64, y: f64, bodies: &[Rectangle]| sights.show(&body(x, y), 0, &vehicle, bodies);
        // The first place is at zero, its body reaches 0.28 m behind it, and the view begins in front of it.
        assert!(shown(0.1, 0.0, &[]) && !shown(-0.5, 0.0, &[]));
        assert!(shown(3.0, 1.0, &[]) && !shown(0.5, 1.5, &[]), "beside the first place nothing was in view");
        // A box between the way and the place hides it from wherever the robot was.
        let wall = Rectangle { centre: Vector2::new(3.0, 0.6), yaw: 0.0, length: 9.0, width: 0.1 };
        assert!(!shown(3.0, 1.0, &[wall]));
        assert!(!Sights::default().show(&body(0.0, 0.0), 0, &vehicle, &[]));
    }

    #[test]
    fn the_way_back_leads_over_the_places_and_ends_where_they_do() {
        let mut sights = driven(3.0);
        let back = sights.before([3.0, 0.0], 1.3).unwrap();
        assert!((back.x - 1.7).abs() < 1e-9);
        assert_eq!(sights.before([3.0, 0.0], 3.5), None);
        sights.take_back([1.0, 0.1]);
        let back = sights.before([1.0, 0.0], 0.5).unwrap();
        assert!((back.x - 0.5).abs() < 0.25, "{back:?}");
        assert!(
            !sights.show(&body(6.6, 0.0), 0, &Description::default(), &[]),
            "what was seen later is taken back"
        );
    }

    #[test]
    fn ground_that_was_seen_long_ago_is_not_known_and_a_robot_that_stands_still_sees_what_is_ahead() {
        let (mut sights, vehicle) = (driven(3.0), Description::default());
        let pose = Pose { x_m: 3.0, ..Pose::default() };
        let at = |seconds: u64| Pose {
            header: Header { acquired_ns: seconds * 1_000_000_000, ..Header::default() },
            ..pose
        };
        for (seconds, seen_m) in [(1, 5.0), (70, 5.0), (90, 1.0)] {
            sights.enter(&at(seconds), &ScannerHealth::healthy(seen_m));
        }
        let shown = |x: f64, since_s: u64| sights.show(&body(x, 0.0), since_s * 1_000_000_000, &vehicle, &[]);
        assert!(shown(1.0, 0) && !shown(1.0, 1));
        assert!(shown(5.0, 70) && !shown(5.0, 71));
    }

    #[test]
    fn backwards_over_the_same_places_none_is_forgotten() {
        let mut sights = driven(12.0);
        for step in 0..=200 {
            let pose = Pose { x_m: 12.0 - 0.05 * f64::from(step), speed_mps: -0.3, ..Pose::default() };
            sights.enter(&pose, &ScannerHealth::healthy(5.0));
        }
        assert!(sights.show(&body(0.5, 0.0), 0, &Description::default(), &[]));
    }

    #[test]
    fn the_oldest_places_are_forgotten_and_impossible_ones_are_not_continued_from() {
        let sights = driven(40.0);
        assert_eq!(sights.entered - sights.first, PLACES as u64);
        assert_eq!(sights.valid(), sights);
        assert_eq!(Sights { entered: 900, ..sights }.valid(), Sights::default());
        let mut broken = sights;
        broken.places[3].yaw_rad = f64::NAN;
        assert_eq!(broken.valid(), Sights::default());
    }
}
