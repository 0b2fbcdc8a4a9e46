//! The base and its frame: what is sent to it, and where its odometry places it on the track.

use std::f64::consts::TAU;

use vehicle::Parameters;

/// Tolerance of a place that the odometry reports, at any speed: noise of a real base [m].
const REACH_M: f64 = 0.1;
/// The same of a heading, with what a robot turns within a period and does not report [rad].
const REACH_RAD: f64 = 0.2;

/// A state of the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseState {
    /// Position and yaw in the frame of the odometry [m, m, rad].
    pub pose: [f64; 3],
    /// Velocities ahead and to the left, yaw rate [m/s, m/s, rad/s].
    pub velocity: [f64; 3],
    /// Whether the wheels are blocked by something.
    pub stalled: bool,
}

/// What a robot was told to do since its last scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ordered {
    /// Lowest and highest velocity, and zero [m/s].
    pub mps: [f64; 2],
    /// Largest yaw rate to either side [rad/s].
    pub radps: f64,
}

impl Ordered {
    /// One more order.
    pub fn add(&mut self, velocity_mps: f64, yaw_rate_radps: f64) {
        let [slowest_mps, fastest_mps] = self.mps;
        self.mps = [slowest_mps.min(velocity_mps), fastest_mps.max(velocity_mps)];
        self.radps = self.radps.max(yaw_rate_radps.abs());
    }
}

/// What turns a robot, in a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// A steering angle.
    Steering,
    /// A yaw rate.
    YawRate,
}

/// How a robot is commanded, and how it reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convention {
    /// What turns it.
    pub turn: Turn,
    /// Wheelbase that its steering angle refers to: angle = atan(wheelbase x curvature) [m].
    pub wheelbase_m: f64,
    /// Sign of the velocity ahead.
    pub velocity_sign: f64,
    /// Sign of the steering angle, or of the yaw rate, that is sent; 1 if left is positive.
    pub steering_sign: f64,
    /// Signs of the reported x, y and yaw; 1 if ahead, left and counter-clockwise are positive.
    pub odometry_signs: [f64; 3],
}

impl Convention {
    /// That of a robot with ahead, left and counter-clockwise positive.
    pub fn usual(turn: Turn, wheelbase_m: f64) -> Self {
        Self { turn, wheelbase_m, velocity_sign: 1.0, steering_sign: 1.0, odometry_signs: [1.0; 3] }
    }

    /// What drives the wheels: a velocity [m/s], and a steering angle [rad] or a yaw rate [rad/s].
    ///
    /// `steering_rad` is the angle of the model of the robot, whose path has the curvature [`Parameters::curvature_of`]. A car
    /// with this path steers by atan(wheelbase x curvature).
    pub fn sent(&self, parameters: &Parameters, velocity_mps: f64, steering_rad: f64) -> [f64; 2] {
        let curvature = parameters.curvature_of(steering_rad);
        let turn = match self.turn {
            Turn::Steering => (self.wheelbase_m * curvature).atan(),
            Turn::YawRate => velocity_mps * curvature,
        };
        [self.velocity_sign * velocity_mps, self.steering_sign * turn]
    }
}

/// The steering angle that makes this yaw rate at this velocity [rad], the inverse of a command with [`Turn::YawRate`]; zero
/// where nothing drives, as no robot turns on the spot here.
pub fn steering_of(parameters: &Parameters, velocity_mps: f64, yaw_rate_radps: f64) -> f64 {
    if velocity_mps == 0.0 { 0.0 } else { parameters.steering_of(yaw_rate_radps / velocity_mps) }
}

/// A pose and the velocities there, at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// When, on CLOCK_MONOTONIC [ns].
    pub time_ns: u64,
    /// Position and yaw [m, m, rad].
    pub pose: [f64; 3],
    /// Velocity ahead [m/s].
    pub speed_mps: f64,
    /// Yaw rate [rad/s].
    pub yaw_rate_radps: f64,
}

impl Motion {
    /// A reported state in the frame of the robot, with ahead, left and counter-clockwise positive. `None` when a number
    /// is not finite.
    pub fn of(convention: &Convention, state: &BaseState, time_ns: u64) -> Option<Self> {
        let [x, y, yaw] = convention.odometry_signs;
        let pose = [x * state.pose[0], y * state.pose[1], yaw * state.pose[2]];
        let speed_mps = convention.velocity_sign * state.velocity[0];
        let yaw_rate_radps = yaw * state.velocity[2];
        let is_finite = pose.iter().chain([&speed_mps, &yaw_rate_radps]).all(|number| number.is_finite());
        is_finite.then_some(Self { time_ns, pose, speed_mps, yaw_rate_radps })
    }

    /// The motion at another time, with the same velocities.
    pub fn at(&self, time_ns: u64) -> Self {
        let elapsed_s = (time_ns as f64 - self.time_ns as f64) * 1e-9;
        let turned = self.yaw_rate_radps * elapsed_s;
        let (sin, cos) = (self.pose[2] + turned / 2.0).sin_cos();
        let way_m = self.speed_mps * elapsed_s;
        let [x_m, y_m, yaw_rad] = self.pose;
        Self { time_ns, pose: [x_m + way_m * cos, y_m + way_m * sin, yaw_rad + turned], ..*self }
    }

    /// Whether the robot can have driven from here to `later`: at a speed between the lowest and the highest of both and of
    /// those that it was told since, and with the largest yaw rate of these; with a tolerance of a tenth and of `REACH_M` and
    /// `REACH_RAD`.
    ///
    /// Another place is that of a server that was started anew, with its odometry at zero.
    pub fn reaches(&self, later: &Self, ordered: Ordered) -> bool {
        let [slowest_mps, fastest_mps] = ordered.mps;
        let seconds = later.time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        let slowest_mps = slowest_mps.min(self.speed_mps).min(later.speed_mps);
        let fastest_mps = fastest_mps.max(self.speed_mps).max(later.speed_mps).max(-slowest_mps);
        let (dx, dy) = (later.pose[0] - self.pose[0], later.pose[1] - self.pose[1]);
        let (sin, cos) = self.pose[2].sin_cos();
        let turned_rad = wrapped(later.pose[2] - self.pose[2]).abs();
        let radps = ordered.radps.max(self.yaw_rate_radps.abs()).max(later.yaw_rate_radps.abs());
        turned_rad <= 1.1 * radps * seconds + REACH_RAD
            && dx * cos + dy * sin >= 1.1 * slowest_mps.min(0.0) * seconds - REACH_M
            && dx.hypot(dy) <= 1.1 * fastest_mps * seconds + REACH_M
    }

    /// The motion between two at a time between theirs.
    pub fn between(one: &Self, other: &Self, time_ns: u64) -> Self {
        let span_ns = other.time_ns.saturating_sub(one.time_ns).max(1);
        let share = time_ns.saturating_sub(one.time_ns) as f64 / span_ns as f64;
        let mix = |from: f64, to: f64| from + share * (to - from);
        let yaw_rad = one.pose[2] + share * wrapped(other.pose[2] - one.pose[2]);
        Self {
            time_ns,
            pose: [mix(one.pose[0], other.pose[0]), mix(one.pose[1], other.pose[1]), yaw_rad],
            speed_mps: mix(one.speed_mps, other.speed_mps),
            yaw_rate_radps: mix(one.yaw_rate_radps, other.yaw_rate_radps),
        }
    }
}

/// Moves poses of the odometry onto the track: the first one is the start of the scenario.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    origin: [f64; 3],
    start: [f64; 3],
}

impl Anchor {
    /// The odometry reports `origin` while the robot is at `start` of the track.
    pub fn new(origin: [f64; 3], start: [f64; 3]) -> Self {
        Self { origin, start }
    }

    /// A pose on the track, with its yaw in (-pi, pi].
    pub fn on_track(&self, pose: [f64; 3]) -> [f64; 3] {
        let (dx, dy) = (pose[0] - self.origin[0], pose[1] - self.origin[1]);
        let turn = self.start[2] - self.origin[2];
        let (sin, cos) = turn.sin_cos();
        [self.start[0] + dx * cos - dy * sin, self.start[1] + dx * sin + dy * cos, wrapped(pose[2] + turn)]
    }
}

/// An angle in (-pi, pi] [rad].
pub fn wrapped(angle: f64) -> f64 {
    let rest = angle.rem_euclid(TAU);
    if rest > TAU / 2.0 { rest - TAU } else { rest }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use vehicle::VehicleModel;

    fn summit() -> Parameters {
        Parameters::default()
    }

    fn usual() -> Convention {
        Convention::usual(Turn::Steering, 0.185)
    }

    #[test]
    fn a_car_with_half_the_axle_distance_steers_by_the_same_angle() {
        let [velocity, angle] = usual().sent(&summit(), 0.8, 0.06);
        assert_eq!(velocity, 0.8);
        assert!((angle - 0.06).abs() < 1e-12);
        // The angle of the model of a car at full lock leads it on the path of the model: 0.37 m at 0.6 rad.
        let car = Parameters { model: VehicleModel::Bicycle, ..summit() };
        let [_, angle] = Convention::usual(Turn::Steering, 0.37).sent(&car, 0.8, 0.6);
        assert!((angle - 0.6_f64.atan()).abs() < 1e-12);
    }

    #[test]
    fn a_longer_car_steers_more_and_a_base_without_steering_gets_its_yaw_rate() {
        let curvature = summit().curvature_of(0.06);
        assert!((curvature - 2.0 * 0.06_f64.tan() / 0.37).abs() < 1e-12);
        let config = Convention { wheelbase_m: 0.37, steering_sign: -1.0, ..usual() };
        assert_eq!(config.sent(&summit(), 0.8, 0.06), [0.8, -(0.37 * curvature).atan()]);
        let config = Convention { turn: Turn::YawRate, ..usual() };
        assert_eq!(config.sent(&summit(), 0.8, 0.06), [0.8, 0.8 * curvature]);
    }

    #[test]
    fn a_yaw_rate_is_made_by_the_steering_angle_that_is_sent_as_this_yaw_rate() {
        let config = Convention { turn: Turn::YawRate, ..usual() };
        let [velocity, yaw_rate] = config.sent(&summit(), 0.8, -0.06);
        assert!((steering_of(&summit(), velocity, yaw_rate) + 0.06).abs() < 1e-12);
        let wide = Parameters { front_m: 0.5, rear_m: 0.5, ..summit() };
        // A circle of 2 m radius, with axles 1 m apart: each steers by atan(0.5 / 2).
        assert!((steering_of(&wide, 1.0, 0.5) - 0.25_f64.atan()).abs() < 1e-12);
        assert_eq!([steering_of(&wide, 0.0, 0.5), steering_of(&wide, 1.0, 0.0)], [0.0, 0.0]);
    }

    #[test]
    fn the_first_pose_is_the_start_and_the_rest_follows() {
        // The odometry has the robot at (3, 4) and looking to the left, the track at (1, 0) and looking ahead.
        let anchor = Anchor::new([3.0, 4.0, FRAC_PI_2], [1.0, 0.0, 0.0]);
        assert_eq!(anchor.on_track([3.0, 4.0, FRAC_PI_2]), [1.0, 0.0, 0.0]);
        let [x, y, yaw] = anchor.on_track([2.5, 6.0, FRAC_PI_2 + 0.1]);
        assert!((x - 3.0).abs() < 1e-12 && (y - 0.5).abs() < 1e-12 && (yaw - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_pose_between_two_turns_the_short_way() {
        let motion =
            |time_ns, yaw: f64| Motion { time_ns, pose: [time_ns as f64, 0.0, yaw], ..Motion::default() };
        let middle = Motion::between(&motion(10, PI - 0.1), &motion(20, -PI + 0.1), 15);
        assert!((middle.pose[2] - PI).abs() < 1e-12 && middle.pose[0] == 15.0);
    }

    #[test]
    fn a_pose_is_moved_on_along_its_arc() {
        let motion = Motion { time_ns: 0, pose: [0.0; 3], speed_mps: 1.0, yaw_rate_radps: 0.5 };
        let moved = motion.at(100_000_000);
        assert!((moved.pose[0] - 0.1).abs() < 1e-4 && (moved.pose[2] - 0.05).abs() < 1e-12);
        assert!((moved.pose[1] - 0.0025).abs() < 1e-5);
        assert_eq!(moved.at(0).pose[2], 0.0);
    }

    #[test]
    fn speed_times_time_decides_what_is_a_jump() {
        let at = |time_ms: u64, x_m: f64, speed_mps: f64| Motion {
            time_ns: time_ms * 1_000_000,
            pose: [x_m, 0.0, 0.0],
            speed_mps,
            ..Motion::default()
        };
        let told = |mps| Ordered { mps, radps: 0.0 };
        let from = at(0, 5.0, 1.0);
        // An outage in which the base drove on, and one in which it stopped.
        for (time_ms, x_m) in [(1_200, 6.2), (3_000, 8.0), (1_200, 5.2), (100, 5.1)] {
            assert!(from.reaches(&at(time_ms, x_m, 0.0), told([0.0; 2])), "{time_ms} ms, {x_m} m");
        }
        // Its odometry at zero, or elsewhere: 1.2 s at 1 m/s are 1.32 m with a tenth, and 0.1 m.
        for (time_ms, x_m) in [(1_200, 0.0), (1_200, 4.8), (1_200, 6.43), (100, 5.4), (60_000, 4.0)] {
            assert!(!from.reaches(&at(time_ms, x_m, 0.0), told([0.0; 2])), "{time_ms} ms, {x_m} m");
        }
        // It was told to drive faster than it did.
        let slow = at(0, 5.0, 0.1);
        assert!(
            !slow.reaches(&at(1_000, 5.9, 0.0), told([0.0, 0.1]))
                && slow.reaches(&at(1_000, 5.9, 0.0), told([0.0, 0.8]))
        );
        let turned = Motion { pose: [5.0, 0.0, FRAC_PI_2], ..from };
        assert!(
            turned.reaches(&Motion { pose: [5.0, 0.9, FRAC_PI_2], ..at(1_000, 5.0, 0.0) }, told([0.0; 2]))
        );
        // It was told to drive backwards.
        let back = |x_m, slowest_mps| slow.reaches(&at(1_000, x_m, 0.0), told([slowest_mps, 0.0]));
        assert!(back(4.7, -0.2) && !back(4.6, -0.2) && !back(4.7, 0.0));
    }

    #[test]
    fn yaw_rate_times_time_decides_what_is_a_jump_of_the_heading() {
        let at = |time_ms: u64, yaw_rad: f64, yaw_rate_radps: f64| Motion {
            time_ns: time_ms * 1_000_000,
            pose: [0.0, 0.0, yaw_rad],
            yaw_rate_radps,
            ..Motion::default()
        };
        let told = |radps| Ordered { radps, ..Ordered::default() };
        // The short way, in a period and in an outage in which it turned on; with a yaw rate reported, or told.
        let from = at(0, 3.1, 0.5);
        for (time_ms, turned_rad) in [(100, 0.25), (100, -0.25), (2_000, 1.2), (20_000, 3.1)] {
            assert!(from.reaches(&at(time_ms, 3.1 + turned_rad, 0.0), told(0.0)), "{time_ms} {turned_rad}");
        }
        for (time_ms, turned_rad) in [(100, 0.26), (100, -PI), (2_000, 1.4), (2_000, -3.1)] {
            assert!(!from.reaches(&at(time_ms, 3.1 + turned_rad, 0.0), told(0.0)), "{time_ms} {turned_rad}");
        }
        let rests = at(0, 0.0, 0.0);
        assert!(
            rests.reaches(&at(1_000, 1.0, 0.0), told(0.8)) && rests.reaches(&at(1_000, 1.0, -0.8), told(0.0))
        );
        let mut ordered = Ordered::default();
        [(0.5, 0.1), (-0.2, -0.3), (0.1, 0.2)].iter().for_each(|(mps, radps)| ordered.add(*mps, *radps));
        assert_eq!(ordered, Ordered { mps: [-0.2, 0.5], radps: 0.3 });
    }

    #[test]
    fn signs_turn_the_frame_and_numbers_that_are_none_are_dropped() {
        let config = Convention { odometry_signs: [1.0, -1.0, -1.0], ..usual() };
        let state = BaseState { pose: [1.0, 2.0, 0.3], velocity: [0.5, 0.0, 0.2], stalled: false };
        let motion = Motion::of(&config, &state, 7).unwrap();
        assert_eq!((motion.pose, motion.yaw_rate_radps), ([1.0, -2.0, -0.3], -0.2));
        let broken = BaseState { pose: [1.0, f64::NAN, 0.0], ..state };
        assert_eq!(Motion::of(&config, &broken, 7), None);
    }
}
