//! A fault of the scanner for a course: either mild and lasting, or severe and short.

use emulator::noise::NoiseStream;
use emulator::scenario::{Scanner, Scenario};

/// Kinds of faults that [`add`] draws.
const KINDS: usize = 12;
/// The scanner sees this far to either side of its front [rad].
const VIEW_RAD: f64 = 2.09;

/// Adds one fault.
pub(super) fn add(scenario: &mut Scenario, stream: &mut NoiseStream) {
    let mut scanner = Scanner::default();
    let kind = stream.count(0, KINDS - 1);
    let from_s = stream.between(1.0, 8.0);
    let to_s = from_s + stream.between(0.2, 3.0);
    match kind {
        0 => scenario.noise.dropout = stream.between(0.05, 0.3),
        1 => {
            scanner.dropout_steps = vec![[from_s, stream.between(0.5, 1.0)]];
            scanner.to_s = Some(to_s);
        }
        2 => {
            let (middle, half) = (stream.between(-VIEW_RAD, VIEW_RAD), stream.between(0.02, 0.3));
            scanner.dead_rad = vec![[middle - half, middle + half]];
            (scanner.from_s, scanner.to_s) = (from_s, Some(to_s));
        }
        3 => (scanner.stuck_s, scanner.to_s) = (Some(from_s), Some(to_s)),
        4 => scanner.salt = stream.between(0.0005, 0.005),
        5 => scanner.dust = stream.between(0.0005, 0.005),
        6 => scanner.late_s = stream.between(0.01, 0.05),
        7 => scanner.missing_every = 3 + stream.count(0, 27) as u64,
        8 => scanner.stamp_jitter_s = stream.between(0.002, 0.01),
        9 => scanner.period_s = Some([stream.between(0.03, 0.09), stream.between(0.12, 0.25)]),
        10 => scenario.obstacles.iter_mut().for_each(|obstacle| obstacle.black = true),
        _ => {
            scanner.range_factor = stream.between(0.98, 1.02);
            scanner.range_offset_m = stream.between(-0.02, 0.02);
            scanner.yaw_rad = stream.between(-0.01, 0.01);
        }
    }
    scenario.scanner = scanner;
}
