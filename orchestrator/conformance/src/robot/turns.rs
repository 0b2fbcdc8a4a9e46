//! Whether scan and odometry of one stamp are of one time, as they show in turns.
//!
//! A driver that maps the stamps of base and scanner by two clocks, or does not map them at all, publishes the ranges of
//! one time with the pose of another. While the robot turns, the walls then turn before or after the odometry. The
//! direction of the walls is that of the chords between beams, four times their angle: so walls of a room count alike, and
//! where the robot is does not. Where nothing is straight, or the ranges do not turn, as on stands, nothing is shown.

use std::f64::consts::{FRAC_PI_2, TAU};

use shared_types::{MIN_RANGE_MM, Odometry, Scan};
use supervision::private_system::Order;
use vehicle::frame::wrap_angle;

use crate::case::{Verdict, observed, passed_if};
use crate::test_bench::TestBench;

/// The robot turns to the left, twice as long to the right, and to the left again.
const STEERING_RAD: [f64; 4] = [0.1, -0.1, -0.1, 0.1];
/// Scans of each of these: more than a second at 10 Hz.
const SCANS: usize = 12;
/// Beams of a chord: long against the noise of its ends.
const CHORD_BEAMS: usize = 24;
/// Its middle beam is no farther from it on a straight wall [m].
const STRAIGHT_M: f64 = 0.02;
/// A longer chord leads from one body to another [m].
const MAX_CHORD_M: f64 = 1.0;
/// Mean length of the sum of all directions, of 1, below which nothing straight is seen.
const MIN_STRAIGHT: f64 = 0.4;
/// Turns of the ranges that are smaller than this share of those of the odometry are none.
const MIN_SEEN: f64 = 0.5;
/// Turns that show the time to some milliseconds: standard deviation of the turn rate [rad/s].
const MIN_RATE_RADPS: f64 = 0.1;

pub(crate) fn turns(bench: &mut TestBench<'_>) -> Verdict {
    let mut odometry = Vec::new();
    for steering_rad in STEERING_RAD {
        bench.order = Some(Order::Drive(0.7, steering_rad));
        odometry.extend(bench.samples::<Odometry>(SCANS)?);
    }
    bench.turn()?;
    let scans: Vec<Scan> =
        bench.received.iter().filter_map(|received| received.get::<Scan>()).copied().collect();
    let (mut seen_rad, mut told_rad, mut rates_radps) = (Vec::new(), Vec::new(), Vec::new());
    let (mut straight, mut first_rad) = (0.0, None);
    for [before, now, after] in odometry.array_windows() {
        let scan = scans.iter().find(|scan| scan.header.scan_id == now.header.scan_id);
        let Some(scan) = scan.filter(|scan| !scan.missing.is_set()) else { continue };
        let dt_s = (after.header.acquired_ns as f64 - before.header.acquired_ns as f64) * 1e-9;
        let rate_radps = wrap_angle(after.yaw_rad - before.yaw_rad) / dt_s;
        let (direction_rad, share) = walls(scan, rate_radps);
        let told = told_rad.last().map_or(now.yaw_rad, |last| last + wrap_angle(now.yaw_rad - last));
        // Four directions look alike: the nearest to that of the first scan counts.
        let off_rad = -direction_rad - told;
        let first_rad = *first_rad.get_or_insert(off_rad);
        let quarters = ((off_rad - first_rad) / FRAC_PI_2).round();
        seen_rad.push(told + off_rad - quarters * FRAC_PI_2);
        told_rad.push(told);
        rates_radps.push(rate_radps);
        straight += share;
    }
    let count = seen_rad.len();
    straight /= count.max(1) as f64;
    observed(count >= 2 * SCANS && straight >= MIN_STRAIGHT, || "it sees nothing straight".to_owned())?;
    let [turned, rate] = [&told_rad, &rates_radps].map(|values| covariance(values, values).sqrt());
    observed(rate >= MIN_RATE_RADPS, || format!("it turns by {rate:.2} rad/s only"))?;
    let seen = covariance(&seen_rad, &told_rad) / turned;
    observed(seen >= MIN_SEEN * turned, || "its ranges do not turn with it".to_owned())?;
    let off: Vec<f64> = seen_rad.iter().zip(&told_rad).map(|(seen, told)| seen - told).collect();
    let late_ms = covariance(&off, &rates_radps) / (rate * rate) * 1e3;
    let limit_ms = bench.suite.period_ns as f64 * 1e-6 / 5.0;
    let measured = format!("the ranges are of {late_ms:+.0} ms after the odometry of their stamp");
    passed_if(late_ms.abs() <= limit_ms, measured)
}

/// Direction of what is straight, seen from the robot, and how much of what it sees is straight, from 0 to 1 [rad].
///
/// The robot turns by `rate_radps` while a sweep is taken.
fn walls(scan: &Scan, rate_radps: f64) -> (f64, f64) {
    let ranges = scan.ranges();
    let sweep_s = scan.sweep_ns as f64 * 1e-9;
    let point = |beam: usize| {
        let (range_m, angle_rad) =
            (f64::from(ranges[beam]) * 1e-3, scan.first_rad + beam as f64 * scan.increment_rad);
        let late_s = sweep_s * angle_rad / (scan.increment_rad * ranges.len() as f64);
        let (sin, cos) = (angle_rad + rate_radps * late_s).sin_cos();
        [range_m * cos, range_m * sin]
    };
    let (mut along, mut across, mut length) = (0.0, 0.0, 0.0);
    for beam in CHORD_BEAMS..ranges.len() {
        if ranges[beam - CHORD_BEAMS..=beam].iter().any(|range| *range < MIN_RANGE_MM) {
            continue;
        }
        let ([x, y], [to_x, to_y]) = (point(beam - CHORD_BEAMS), point(beam));
        let (dx, dy) = (to_x - x, to_y - y);
        let chord_m = dx.hypot(dy);
        let [middle_x, middle_y] = point(beam - CHORD_BEAMS / 2);
        let beside_m = ((middle_x - x) * dy - (middle_y - y) * dx).abs() / chord_m.max(f64::MIN_POSITIVE);
        if chord_m <= MAX_CHORD_M && beside_m <= STRAIGHT_M {
            let (sin, cos) = (4.0 * dy.atan2(dx)).rem_euclid(TAU).sin_cos();
            (along, across, length) = (along + chord_m * cos, across + chord_m * sin, length + chord_m);
        }
    }
    (across.atan2(along) / 4.0, along.hypot(across) / length.max(f64::MIN_POSITIVE))
}

/// Covariance of two rows of numbers.
fn covariance(one: &[f64], other: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (first, second) = (mean(one), mean(other));
    one.iter().zip(other).map(|(a, b)| (a - first) * (b - second)).sum::<f64>() / one.len() as f64
}
