//! From the rays of any scanner to the beams of one that is described: counter-clockwise, in equal steps, once around at most.
//!
//! The first scan of a drive makes the description. A scan with other rays, as of a scanner whose turns have not all the same
//! number, gives each beam the ray that looks most to its side. Of more rays than a scan has places, neighbours are merged,
//! and the nearest counts.

use std::f64::consts::{PI, TAU};

use driver::beams::{Fan, Unusable};
use driver::motion::wrapped;
use recording::ros2::LaserScan;
use shared_types::{MAX_BEAMS, ScanGeometry};

/// How far a scanner has to see to each side [rad]: 60 degrees.
const SIDE_RAD: f64 = PI / 3.0;
/// Angles of messages have seven digits.
const ROUNDING: f64 = 1e-3;

/// How a scanner is mounted on its robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// Where its angle zero points, counter-clockwise from straight ahead [rad].
    pub yaw_rad: f64,
    /// Sign of its angles: -1 for one that is upside down.
    pub sign: f64,
}

/// The rays of a message, seen from the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct RayFan {
    count: usize,
    first_rad: f64,
    step_rad: f64,
}

impl RayFan {
    fn of(scan: &LaserScan, mounting: Mounting) -> Result<(Self, Fan), Unusable> {
        let [first, last, increment] = scan.angles_rad.map(f64::from);
        let count = scan.ranges_m.len();
        let is_increment = increment.is_finite() && increment != 0.0;
        let step = if is_increment { increment } else { (last - first) / count.saturating_sub(1) as f64 };
        let [min_range_m, max_range_m] = scan.limits_m.map(f64::from);
        let last_rad = first + step * count.saturating_sub(1) as f64;
        let fan = Fan { first_rad: first, last_rad, min_range_m: min_range_m.max(0.0), max_range_m };
        let is_possible = step.is_finite() && first.abs() <= 2.0 * TAU && max_range_m > fan.min_range_m;
        if !is_possible || count < 3 || count as f64 > TAU / step.abs() + 1.5 {
            let [first_deg, last_deg] = [first, last_rad].map(f64::to_degrees);
            return Err(Unusable::Impossible { count, first_deg, last_deg, max_range_m });
        }
        let Mounting { yaw_rad, sign } = mounting;
        Ok((Self { count, first_rad: sign * first + yaw_rad, step_rad: sign * step }, fan))
    }

    fn last_rad(&self) -> f64 {
        self.first_rad + (self.count - 1) as f64 * self.step_rad
    }

    /// Where an angle lies among the rays: steps behind the first one, less than once around.
    fn place(&self, yaw_rad: f64) -> f64 {
        let turn = TAU / self.step_rad.abs();
        rounded((yaw_rad - self.first_rad) / self.step_rad + 0.5, turn) - 0.5
    }
}

/// The beams that are made of the rays of a scanner.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Beams {
    pub(crate) geometry: ScanGeometry,
    /// Smallest and largest range [m].
    pub(crate) limits_m: [f64; 2],
    /// Rays that are merged to a beam.
    pub(crate) merged: usize,
    mounting: Mounting,
    /// The rays for which `rays` holds.
    known: Option<RayFan>,
    /// Of each beam the first of its rays, and how many.
    rays: Vec<(usize, usize)>,
}

impl Beams {
    /// Those of a scanner with this scan.
    ///
    /// # Errors
    /// [`Unusable`] rays.
    pub(crate) fn new(scan: &LaserScan, mounting: Mounting) -> Result<Self, Unusable> {
        let (rays, fan) = RayFan::of(scan, mounting)?;
        let merged = rays.count.div_ceil(MAX_BEAMS);
        let step_rad = rays.step_rad.abs();
        let pitch_rad = step_rad * merged as f64;
        let lowest_rad = rays.first_rad.min(rays.last_rad()) + step_rad * (merged - 1) as f64 / 2.0;
        let mut count = rays.count / merged;
        let span_rad = (count - 1) as f64 * pitch_rad;
        let first_rad = if span_rad + 1.5 * pitch_rad > TAU {
            // All around: it begins at the back. A ray that repeats the first one is left out.
            count = count.min(((TAU + ROUNDING) / pitch_rad) as usize);
            -PI + (rounded((lowest_rad + PI) / pitch_rad, 1.0) * pitch_rad).max(0.0)
        } else {
            // Between back and back; what lies beyond is not described.
            let first_rad = wrapped(lowest_rad + span_rad / 2.0) - span_rad / 2.0;
            let before = ((-PI - first_rad - ROUNDING) / pitch_rad).ceil().max(0.0);
            let behind = ((first_rad + span_rad - PI) / pitch_rad - 1.0).ceil().max(0.0);
            count = count.saturating_sub((before + behind) as usize).max(3);
            (first_rad + before * pitch_rad).max(-PI)
        };
        let geometry = ScanGeometry { count, first_rad, increment_rad: pitch_rad };
        if first_rad > -SIDE_RAD + ROUNDING || geometry.yaw_rad(count - 1) < SIDE_RAD - ROUNDING {
            let [first_deg, last_deg] = [first_rad, geometry.yaw_rad(count - 1)].map(f64::to_degrees);
            return Err(Unusable::Narrow { first_deg, last_deg });
        }
        // What a scanner may be described with.
        let limits_m = [fan.min_range_m.clamp(0.02, 1.0), fan.max_range_m.clamp(1.0, 100.0)];
        let limits_m = limits_m.map(|limit_m| (limit_m * 1e3).round() / 1e3);
        let mut beams = Self { geometry, limits_m, merged, mounting, known: None, rays: Vec::new() };
        beams.fit(rays);
        Ok(beams)
    }

    /// Whether the beams are measured in their order: else a sweep has no duration.
    pub(crate) fn is_in_order(&self) -> bool {
        self.mounting.sign * self.known.map_or(0.0, |rays| rays.step_rad) > 0.0 && self.rays.is_sorted()
    }

    /// Fills the ranges of a scan [mm]; returns when the front beam was measured after the stamp [ns].
    ///
    /// # Errors
    /// [`Unusable`] rays.
    pub(crate) fn fill(&mut self, scan: &LaserScan, ranges_mm: &mut [u32]) -> Result<u64, Unusable> {
        let (rays, fan) = RayFan::of(scan, self.mounting)?;
        self.fit(rays);
        let reach_m = self.limits_m[1];
        let range = |ray: usize| fan.range(f64::from(scan.ranges_m[ray % rays.count]), reach_m);
        for ((first, count), range_mm) in self.rays.iter().zip(ranges_mm) {
            let nearest = (*first..first + count).filter_map(range).fold(f64::INFINITY, f64::min);
            *range_mm = if nearest.is_finite() { (nearest * 1e3).round() as u32 } else { 0 };
        }
        Ok((ray_s(scan) * rays.place(0.0).max(0.0) * 1e9).round() as u64)
    }

    /// Finds the rays of each beam.
    fn fit(&mut self, rays: RayFan) {
        if self.known == Some(rays) {
            return;
        }
        let group = (self.geometry.increment_rad / rays.step_rad.abs()).round().max(1.0);
        let is_closed = rays.count as f64 > TAU / rays.step_rad.abs() - 0.5;
        let of_beam = |beam: usize| {
            let place = rays.place(self.geometry.yaw_rad(beam));
            let first = (place - (group - 1.0) / 2.0).round().max(0.0) as usize;
            let count =
                if is_closed { group as usize } else { rays.count.saturating_sub(first).min(group as usize) };
            (first % rays.count, count)
        };
        self.rays = (0..self.geometry.count).map(of_beam).collect();
        self.known = Some(rays);
    }
}

/// The rest of a division, which is a little below zero where it is nearly the divisor.
fn rounded(steps: f64, turn: f64) -> f64 {
    (steps + ROUNDING).rem_euclid(turn) - ROUNDING
}

/// The time between two rays; zero where it is not known [s].
pub(crate) fn ray_s(scan: &LaserScan) -> f64 {
    let ray_s = f64::from(scan.times_s[0]);
    // A whole sweep takes less than a second, so a larger one is an error of its driver.
    if ray_s > 0.0 && ray_s * scan.ranges_m.len() as f64 <= 1.0 { ray_s } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: Mounting = Mounting { yaw_rad: 0.0, sign: 1.0 };

    /// Rays with these angles [deg], whose ranges count up from 1 m by a centimetre.
    fn scan(first: f32, step: f32, count: usize) -> LaserScan {
        LaserScan {
            angles_rad: [first.to_radians(), 0.0, step.to_radians()],
            limits_m: [0.05, 60.0],
            ranges_m: (0..count).map(|ray| 1.0 + ray as f32 * 0.01).collect(),
            ..LaserScan::default()
        }
    }

    fn filled(scan: &LaserScan, mounting: Mounting) -> (Beams, Vec<u32>) {
        let mut beams = Beams::new(scan, mounting).unwrap();
        let mut ranges_mm = vec![7; beams.geometry.count];
        beams.fill(scan, &mut ranges_mm).unwrap();
        (beams, ranges_mm)
    }

    /// The range of the beam that looks most to an angle [deg].
    fn at((beams, ranges_mm): &(Beams, Vec<u32>), degrees: f64) -> u32 {
        let ScanGeometry { first_rad, increment_rad, .. } = beams.geometry;
        ranges_mm[((degrees.to_radians() - first_rad) / increment_rad).round() as usize]
    }

    #[test]
    fn rays_in_order_stay_as_they_are() {
        let (beams, ranges_mm) = filled(&scan(-135.0, 0.25, 1081), AHEAD);
        assert_eq!((beams.geometry.count, beams.merged, beams.is_in_order()), (1081, 1, true));
        assert!((beams.geometry.first_rad.to_degrees() + 135.0).abs() < 1e-4);
        assert!(ranges_mm.iter().enumerate().all(|(beam, range)| *range == 1000 + 10 * beam as u32));
    }

    #[test]
    fn clockwise_rays_and_those_from_ahead_all_around_see_a_body_where_it_is() {
        // Ray 30 of a clockwise sweep from 90 degrees looks 60 degrees to the left.
        let clockwise = filled(&scan(90.0, -1.0, 181), AHEAD);
        assert_eq!(
            (at(&clockwise, 60.0), at(&clockwise, -60.0), clockwise.0.is_in_order()),
            (1300, 2500, false)
        );
        // Ray 350 of 360 from straight ahead looks 10 degrees to the right.
        let around = filled(&scan(0.0, 1.0, 360), AHEAD);
        assert_eq!((around.0.geometry.count, around.0.is_in_order()), (360, false));
        assert_eq!([-10.0, 0.0, 10.0, -179.0].map(|angle| at(&around, angle)), [4500, 1000, 1100, 2810]);
        // Upside down, and turned to the back.
        let over = filled(&scan(-90.0, 1.0, 181), Mounting { yaw_rad: 0.0, sign: -1.0 });
        assert_eq!((at(&over, 60.0), over.0.is_in_order()), (1300, false));
        let back = filled(&scan(0.0, 1.0, 360), Mounting { yaw_rad: PI, sign: 1.0 });
        assert_eq!(at(&back, 10.0), 2900);
    }

    #[test]
    fn a_ray_that_repeats_the_first_one_is_left_out_and_more_than_there_are_places_are_merged() {
        let (repeats, _) = filled(&scan(-180.0, 0.5, 721), AHEAD);
        assert_eq!(repeats.geometry.count, 720);
        let many = scan(-135.0, 0.05, 5401);
        let (merged, ranges_mm) = filled(&many, AHEAD);
        assert_eq!((merged.geometry.count, merged.merged), (1800, 3));
        // The nearest of the rays 300, 301 and 302.
        assert_eq!(ranges_mm[100], 4000);
    }

    #[test]
    fn a_scan_with_other_rays_fills_the_same_beams() {
        let mut beams = Beams::new(&scan(-180.0, 1.0, 360), AHEAD).unwrap();
        let mut ranges_mm = vec![0; 360];
        // 0.9 degrees apart: the ray nearest to straight ahead is 200.
        beams.fill(&scan(-180.0, 0.9, 400), &mut ranges_mm).unwrap();
        assert_eq!((ranges_mm[180], ranges_mm[0]), (3000, 1000));
        // Half as many: what is behind them is no return.
        beams.fill(&scan(-90.0, 1.0, 181), &mut ranges_mm).unwrap();
        assert_eq!([0, 89, 90, 180, 270, 271].map(|beam| ranges_mm[beam]), [0, 0, 1000, 1900, 2800, 0]);
    }

    #[test]
    fn the_front_beam_is_measured_when_its_ray_is() {
        let mut timed = scan(-90.0, 1.0, 181);
        timed.times_s[0] = 0.0005;
        let mut ranges_mm = vec![0; 181];
        let mut beams = Beams::new(&timed, AHEAD).unwrap();
        // Times and angles of messages have seven digits.
        assert!((44_999_900..45_000_100).contains(&beams.fill(&timed, &mut ranges_mm).unwrap()));
        timed.times_s[0] = f32::NAN;
        assert_eq!(beams.fill(&timed, &mut ranges_mm), Ok(0));
    }

    #[test]
    fn what_is_no_range_is_no_return_and_what_is_no_scanner_is_refused() {
        let mut faulty = scan(-90.0, 1.0, 181);
        faulty.ranges_m[..6].copy_from_slice(&[f32::NAN, f32::INFINITY, 0.0, -1.0, 0.04, 60.0]);
        assert_eq!(filled(&faulty, AHEAD).1[..7], [0, 0, 0, 0, 0, 0, 1060]);
        let refused = |scan: &LaserScan| Beams::new(scan, AHEAD).unwrap_err().to_string();
        assert!(refused(&scan(-45.0, 1.0, 91)).starts_with("the scanner covers -45.0 to 45.0 degrees"));
        for wrong in [
            scan(-90.0, f32::NAN, 181),
            scan(-90.0, 1.0, 0),
            scan(f32::NAN, 1.0, 181),
            scan(-90.0, 1.0, 1000),
            scan(-90.0, f32::INFINITY, 181),
            scan(-90.0, 1e-30, 181),
            LaserScan { limits_m: [f32::NAN, f32::NAN], ..scan(-90.0, 1.0, 181) },
        ] {
            let message = refused(&wrong);
            assert!(message.ends_with("are no scan") || message.contains("the scanner covers"), "{message}");
        }
    }
}
