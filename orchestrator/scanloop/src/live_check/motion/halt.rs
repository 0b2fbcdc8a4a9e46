//! The deceleration of blocked wheels, from the distance that the robot still covers.
//!
//! The distance is that between the place at the block, which the speed before it predicts, and the place of rest.
//! The way during the delay of the command, as `[vehicle]` describes it, does not count. The rest is v^2 / (2 a).
//!
//! Limits: at 0.3 m/s and 5 m/s^2 the distance is 9 mm, near the resolution of an odometer. So the result is the value
//! of a distance that is longer by this resolution, and by a delay that differs from its mean: rather too small.

use super::super::feed::Point;
use super::super::finding::Finding;

/// What the distance may be wrong by at any speed: encoder steps [m].
const RESOLUTION_M: f64 = 0.002;
/// What the delay of a single command may differ from its mean [s].
const DELAY_ERROR_S: f64 = 0.005;
/// A single stop may take this much longer than described: delays of the command and of a busy computer [s].
const TOLERANCE_S: f64 = 0.02;
/// The speed before the block is the mean over this time [ns].
const SPEED_NS: u64 = 500_000_000;
/// At rest, the odometry moves less than this in three samples [m].
const REST_M: f64 = 5e-4;
/// The range of `vehicle.blocked_deceleration_mps2`.
const RANGE_MPS2: [f64; 2] = [0.1, 50.0];

/// How the robot came to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Halt {
    /// Speed before the block [m/s].
    pub(super) speed_mps: f64,
    /// Distance from the block to rest, without the way during the delay [m].
    pub(super) distance_m: f64,
}

/// Whether the last samples are those of a robot at rest.
pub(super) fn rests(way: &[Point]) -> bool {
    let Some(last) = way.last_chunk::<4>() else { return false };
    last.iter().all(|point| (point.ahead_m - last[3].ahead_m).abs() < REST_M)
}

/// Speed and distance of a stop that was ordered at `blocked_ns`; `None` when the robot did not drive before.
pub(super) fn measure(way: &[Point], blocked_ns: u64, delay_s: f64) -> Option<Halt> {
    let before = &way[..way.partition_point(|point| point.at_ns <= blocked_ns)];
    let (rest, last) = (way.last()?, before.last()?);
    let first = before.iter().find(|point| point.at_ns + SPEED_NS >= last.at_ns)?;
    let seconds = |from_ns: u64, to_ns: u64| to_ns.saturating_sub(from_ns) as f64 * 1e-9;
    let speed_mps = (last.ahead_m - first.ahead_m) / seconds(first.at_ns, last.at_ns);
    let at_block_m = last.ahead_m + speed_mps * (seconds(last.at_ns, blocked_ns) + delay_s);
    (speed_mps > 0.02).then_some(Halt { speed_mps, distance_m: rest.ahead_m - at_block_m })
}

impl Halt {
    /// The deceleration to be entered in `[vehicle]`, rounded down to a tenth [m/s^2].
    pub(super) fn deceleration_mps2(&self) -> f64 {
        let [low, high] = RANGE_MPS2;
        let distance_m = self.distance_m.max(0.0) + self.error_m();
        let deceleration = self.speed_mps * self.speed_mps / (2.0 * distance_m);
        ((10.0 * deceleration).floor() / 10.0).clamp(low, high)
    }

    /// Passes when the stop may be as short as the description of the vehicle states.
    pub(super) fn finding(&self, described_mps2: f64) -> Finding {
        let Self { speed_mps, distance_m } = *self;
        let allowed_m =
            speed_mps * speed_mps / (2.0 * described_mps2) + RESOLUTION_M + TOLERANCE_S * speed_mps;
        let deceleration = self.deceleration_mps2();
        Finding::of(
            "stop",
            distance_m <= allowed_m,
            format!("{distance_m:.3} m from {speed_mps:.2} m/s: at least {deceleration} m/s^2"),
            format!("up to {allowed_m:.3} m by vehicle.blocked_deceleration_mps2 = {described_mps2}"),
        )
    }

    /// What the distance may be wrong by [m].
    fn error_m(&self) -> f64 {
        RESOLUTION_M + DELAY_ERROR_S * self.speed_mps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot at 0.5 m/s that brakes with `deceleration`, 20 ms after the block at 1.03 s.
    fn way(deceleration: f64) -> Vec<Point> {
        let ahead_m = |at_s: f64| {
            let braking_s = (at_s - 1.05).clamp(0.0, 0.5 / deceleration);
            0.5 * at_s.min(1.05) + 0.5 * braking_s - deceleration * braking_s * braking_s / 2.0
        };
        let point = |index: u64| Point {
            at_ns: index * 100_000_000,
            ahead_m: ahead_m(index as f64 * 0.1),
            left_rad: 0.0,
        };
        (1..30).map(point).collect()
    }

    #[test]
    fn the_deceleration_is_found_up_to_the_resolution() {
        for (deceleration, expected) in [(0.5, 0.4), (2.0, 1.8), (5.0, 4.2)] {
            let halt = measure(&way(deceleration), 1_030_000_000, 0.02).unwrap();
            let distance_m = 0.25 / (2.0 * deceleration);
            assert!((halt.distance_m - distance_m).abs() < 1e-9 && (halt.speed_mps - 0.5).abs() < 1e-9);
            assert_eq!(halt.deceleration_mps2(), expected);
        }
    }

    #[test]
    fn a_stop_that_is_longer_than_described_fails() {
        use super::super::super::finding::Outcome;
        let halt = measure(&way(2.0), 1_030_000_000, 0.02).unwrap();
        assert_eq!(halt.finding(2.0).outcome, Outcome::Ok);
        assert_eq!(halt.finding(5.0).outcome, Outcome::Failed);
        assert!(halt.finding(5.0).measured.ends_with("from 0.50 m/s: at least 1.8 m/s^2"), "{halt:?}");
    }

    #[test]
    fn a_robot_that_moves_does_not_rest() {
        let way = way(2.0);
        assert!(!rests(&way[..12]) && rests(&way) && !rests(&[]));
        assert_eq!(measure(&way[20..], 2_900_000_000, 0.0), None);
    }
}
