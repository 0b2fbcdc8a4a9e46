//! One stop: the speed before it, and the distance that the robot still covers.
//!
//! The distance is that between the place at the block, which the speed before it predicts, and the place of rest.
//! The way during the delay of the command, as `[vehicle]` describes it, does not count.

use super::super::feed::Point;

/// What the distance may be wrong by at any speed: encoder steps [m].
const RESOLUTION_M: f64 = 0.002;
/// A single stop may take this much longer than described: delays of the command and of a busy computer [s].
const TOLERANCE_S: f64 = 0.02;
/// The speed before the block is the mean over this time [ns].
pub(super) const SPEED_NS: u64 = 500_000_000;
/// At rest, the odometry moves less than this in three samples [m].
const REST_M: f64 = 5e-4;
/// Fewer places of the body before the block show no speed.
const MIN_PLACES: usize = 3;

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

/// Speed and distance of the same stop from places of the body, each with its time [ns] and its way [m] to the place of
/// rest; `None` when there are too few.
pub(super) fn of_body(places: &[(u64, f64)], blocked_ns: u64, delay_s: f64) -> Option<Halt> {
    if places.len() < MIN_PLACES {
        return None;
    }
    // A line through the places: the speed is the same until the block.
    let since_s = |at_ns: u64| (at_ns as f64 - blocked_ns as f64) * 1e-9;
    let mean = |of: &dyn Fn(&(u64, f64)) -> f64| places.iter().map(of).sum::<f64>() / places.len() as f64;
    let (time_s, way_m) = (mean(&|place| since_s(place.0)), mean(&|place| place.1));
    let spread = mean(&|place| (since_s(place.0) - time_s).powi(2));
    let slope = mean(&|place| (since_s(place.0) - time_s) * (place.1 - way_m)) / spread;
    let speed_mps = -slope;
    let distance_m = way_m + slope * (0.0 - time_s) - speed_mps * delay_s;
    (speed_mps > 0.02).then_some(Halt { speed_mps, distance_m })
}

impl Halt {
    /// The longest distance of a robot that stops as described [m].
    pub(super) fn allowed_m(&self, described_mps2: f64) -> f64 {
        let speed_mps = self.speed_mps;
        speed_mps * speed_mps / (2.0 * described_mps2) + RESOLUTION_M + TOLERANCE_S * speed_mps
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
    fn speed_and_distance_of_a_stop_are_found() {
        for deceleration in [0.5, 2.0, 5.0] {
            let halt = measure(&way(deceleration), 1_030_000_000, 0.02).unwrap();
            let distance_m = 0.25 / (2.0 * deceleration);
            assert!((halt.distance_m - distance_m).abs() < 1e-9 && (halt.speed_mps - 0.5).abs() < 1e-9);
            assert!(halt.distance_m < halt.allowed_m(deceleration));
        }
        let weak = measure(&way(2.0), 1_030_000_000, 0.02).unwrap();
        assert!(weak.distance_m > weak.allowed_m(5.0));
    }

    #[test]
    fn places_of_the_body_show_the_same_stop() {
        for deceleration in [0.5, 2.0, 5.0] {
            let way = way(deceleration);
            let rest_m = way.last().unwrap().ahead_m;
            let before = way.iter().filter(|point| (500_000_000..1_030_000_000).contains(&point.at_ns));
            let places: Vec<_> = before.map(|point| (point.at_ns, rest_m - point.ahead_m)).collect();
            let halt = of_body(&places, 1_030_000_000, 0.02).unwrap();
            assert!((halt.distance_m - 0.25 / (2.0 * deceleration)).abs() < 1e-9, "{halt:?}");
            assert!((halt.speed_mps - 0.5).abs() < 1e-9, "{halt:?}");
        }
        assert_eq!(of_body(&[(1, 0.2), (2, 0.1)], 3, 0.0), None);
    }

    #[test]
    fn a_robot_that_moves_does_not_rest() {
        let way = way(2.0);
        assert!(!rests(&way[..12]) && rests(&way) && !rests(&[]));
        assert_eq!(measure(&way[20..], 2_900_000_000, 0.0), None);
    }
}
