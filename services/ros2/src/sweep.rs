//! From a `LaserScan` to the ranges of a scan.
//!
//! Its stamp is that of the first ray, ours that of the front beam, which is `time_increment` times its index later. Many
//! drivers leave the increments at zero: then the setting `sweep_s` is spread over the rays.

use std::f64::consts::TAU;

use driver::beams::{Beams, Fan, SweepRanges, Unusable};
use vehicle::ScannerDescription;

use crate::message::LaserScan;
use crate::transforms::Rays;

/// A sweep, resampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sweep {
    /// Ranges by beam of a scan [mm].
    pub(crate) ranges_mm: SweepRanges,
    /// Stamp of the front beam [s].
    pub(crate) front_s: f64,
    /// Duration [ns].
    pub(crate) sweep_ns: u64,
}

/// Resamples the sweeps of one scanner.
#[derive(Debug)]
pub(crate) struct Resampler {
    described: ScannerDescription,
    /// With the sign of the angles that they were made for.
    beams: Option<(f64, Beams)>,
}

impl Resampler {
    /// To the beams of the described scanner.
    pub(crate) fn new(described: ScannerDescription) -> Self {
        Self { described, beams: None }
    }

    /// The sweep of a message; `sweep_s` is its duration where the message has none [s].
    ///
    /// # Errors
    /// [`Unusable`] for a geometry that is none, or that does not cover what the stages need.
    pub(crate) fn sweep(&mut self, sweep_s: f64, rays: Rays, message: &LaserScan) -> Result<Sweep, Unusable> {
        let (count, sign) = (message.ranges.len(), rays.sign);
        let step_rad = step_rad(message);
        let first_rad = f64::from(message.angle_min) + sign * rays.yaw_rad;
        let fan = Fan {
            first_rad,
            last_rad: first_rad + step_rad * count.saturating_sub(1) as f64,
            min_range_m: f64::from(message.range_min.max(0.0)),
            max_range_m: f64::from(message.range_max),
        };
        let known = self.beams.take().filter(|(of, beams)| *of == sign && beams.fits(&fan, count));
        let (_, beams) = match known {
            Some(known) => self.beams.insert(known),
            None => self.beams.insert((sign, Beams::new(fan, count, sign, &self.described)?)),
        };
        let mut ranges_mm: SweepRanges = [0; _];
        beams.fill(|ray| f64::from(message.ranges[ray]), &mut ranges_mm);
        let ray_s = ray_s(sweep_s, message);
        // A first ray that is the front one but for its rounding is not a whole turn away from it.
        let front = (-first_rad / step_rad + 0.5).rem_euclid(TAU / step_rad.abs()) - 0.5;
        Ok(Sweep {
            ranges_mm,
            front_s: message.header.stamp.seconds() + ray_s * front,
            sweep_ns: (ray_s * count as f64 * 1e9) as u64,
        })
    }
}

/// The angle between two rays: as the message has it, or from its limits [rad].
fn step_rad(message: &LaserScan) -> f64 {
    let increment = f64::from(message.angle_increment);
    if increment.is_finite() && increment != 0.0 {
        return increment;
    }
    f64::from(message.angle_max - message.angle_min) / message.ranges.len().saturating_sub(1) as f64
}

/// The time between two rays [s].
fn ray_s(sweep_s: f64, message: &LaserScan) -> f64 {
    let increment = f64::from(message.time_increment);
    let count = message.ranges.len().max(1) as f64;
    // A whole sweep takes less than a second, so a larger one is an error of its driver.
    if increment > 0.0 && increment * count <= 1.0 { increment } else { sweep_s / count }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use shared_types::{BEAMS, FRONT_BEAM, ScanGeometry};

    use super::*;
    use crate::message::{Header, Time};

    const NOT_MEASURED: u32 = 19;

    /// 181 rays from -90 to 90 degrees, all at 2 m, at 100 s.
    fn message() -> LaserScan {
        LaserScan {
            header: Header { stamp: Time { sec: 100, nanosec: 0 }, ..Header::default() },
            angle_min: -90.0_f32.to_radians(),
            angle_max: 90.0_f32.to_radians(),
            angle_increment: 1.0_f32.to_radians(),
            range_min: 0.1,
            range_max: 10.0,
            ranges: vec![2.0; 181],
            ..LaserScan::default()
        }
    }

    const AHEAD: Rays = Rays { yaw_rad: 0.0, sign: 1.0 };

    fn swept(sweep_s: f64, message: &LaserScan) -> Sweep {
        Resampler::new(ScannerDescription::default()).sweep(sweep_s, AHEAD, message).unwrap()
    }

    #[test]
    fn the_stamp_is_that_of_the_front_ray() {
        // 90 rays of 0.5 ms before the front one.
        let sweep = swept(0.0, &LaserScan { time_increment: 0.0005, ..message() });
        assert!((sweep.front_s - 100.045).abs() < 1e-6, "{}", sweep.front_s);
        assert!((90_400_000..90_600_000).contains(&sweep.sweep_ns), "{}", sweep.sweep_ns);
        // Backwards from the left: the front ray is the same.
        let clockwise = LaserScan {
            angle_min: message().angle_max,
            angle_max: message().angle_min,
            angle_increment: -message().angle_increment,
            time_increment: 0.0005,
            ..message()
        };
        assert!((swept(0.0, &clockwise).front_s - 100.045).abs() < 1e-6);
    }

    #[test]
    fn a_sweep_that_begins_ahead_begins_with_the_front_ray_whatever_the_rounding() {
        for angle_min in [0.0, 1e-6, -1e-6] {
            let all_around =
                LaserScan { angle_min, time_increment: 0.0002, ranges: vec![2.0; 360], ..message() };
            let front_s = swept(0.0, &all_around).front_s;
            assert!((front_s - 100.0).abs() < 1e-6, "{angle_min}: {front_s}");
        }
    }

    #[test]
    fn without_increments_the_settings_and_the_limits_count() {
        for time_increment in [0.0, f32::NAN, -1.0, 1.0] {
            let sweep = swept(0.181, &LaserScan { time_increment, angle_increment: 0.0, ..message() });
            assert!((sweep.front_s - 100.09).abs() < 1e-4, "{time_increment}: {}", sweep.front_s);
            assert_eq!((sweep.ranges_mm[FRONT_BEAM], sweep.sweep_ns), (2000, 181_000_000));
        }
        assert_eq!(swept(0.0, &message()).sweep_ns, 0);
    }

    #[test]
    fn what_is_no_range_is_no_return_and_what_is_not_measured_is_marked() {
        let mut message = message();
        for (ray, range) in [(90, f32::NAN), (80, f32::INFINITY), (70, 0.05), (60, 10.0), (50, -1.0)] {
            // A beam has up to two neighbours a degree apart.
            message.ranges[ray - 1..=ray + 1].fill(range);
        }
        let sweep = swept(0.0, &message);
        // 10 degrees are 28.4 beams.
        let at =
            |degrees: f64| sweep.ranges_mm[(FRONT_BEAM as f64 + degrees * 1024.0 / 360.0).round() as usize];
        assert_eq!([0.0, -10.0, -20.0, -30.0, -40.0].map(at), [0; 5]);
        assert_eq!([5.0, 45.0, -89.0].map(at), [2000; 3]);
        assert_eq!([91.0, -91.0].map(at), [NOT_MEASURED; 2]);
    }

    #[test]
    fn a_scanner_that_is_turned_or_upside_down_sees_a_body_where_it_is() {
        // All around in 360 rays; ray 200 sees a body.
        let mut all_around = LaserScan {
            angle_min: 0.0,
            angle_max: 359.0_f32.to_radians(),
            ranges: vec![4.0; 360],
            ..message()
        };
        all_around.ranges[200] = 1.0;
        // One resampler: the turn may become known later.
        let mut resampler = Resampler::new(ScannerDescription::default());
        let mut seen_at = |yaw_rad: f64, sign: f64| {
            let sweep = resampler.sweep(0.0, Rays { yaw_rad, sign }, &all_around).unwrap();
            let hit: Vec<f64> = (0..BEAMS)
                .filter(|beam| sweep.ranges_mm[*beam] == 1000)
                .map(|beam| ScanGeometry::URG_04LX.yaw_rad(beam).to_degrees())
                .collect();
            assert!(!hit.is_empty());
            hit.iter().sum::<f64>() / hit.len() as f64
        };
        // Looking backwards: 200 degrees are 20 to the left of ahead.
        assert!((seen_at(PI, 1.0) - 20.0).abs() < 0.3);
        assert!((seen_at(PI, -1.0) + 20.0).abs() < 0.3);
        // 200 degrees to the right of ahead are 160 to the left, where no beam is; turned by -140, they are 20 to the left.
        assert!((seen_at(-140.0_f64.to_radians(), -1.0) - 20.0).abs() < 0.3);
    }

    #[test]
    fn a_narrow_scanner_is_refused_with_its_numbers_and_nonsense_with_its_own() {
        let narrow = LaserScan { ranges: vec![2.0; 91], angle_min: -45.0_f32.to_radians(), ..message() };
        let refused = |message: &LaserScan| {
            Resampler::new(ScannerDescription::default()).sweep(0.0, AHEAD, message).unwrap_err().to_string()
        };
        assert_eq!(
            refused(&narrow),
            "the scanner covers -45.0 to 45.0 degrees, but at least -60 to 60 are needed"
        );
        let none = refused(&LaserScan { ranges: Vec::new(), ..message() });
        assert!(none.starts_with("0 beams from "), "{none}");
        for faulty in [
            LaserScan { angle_min: f32::NAN, ..message() },
            LaserScan { range_max: f32::NAN, ..message() },
            LaserScan { angle_increment: f32::NAN, angle_max: f32::INFINITY, ..message() },
            LaserScan { ranges: vec![2.0; 1000], ..message() },
        ] {
            assert!(refused(&faulty).ends_with("are no scan"));
        }
    }
}
