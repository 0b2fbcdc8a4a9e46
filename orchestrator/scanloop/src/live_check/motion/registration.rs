//! How the body has moved between two scans, whatever its wheels did.
//!
//! Points of one scan are laid onto the surfaces of the other, point to line, by Gauss-Newton in the shift ahead, the
//! shift to the left and the turn. Wheel encoders do not count what locked wheels slide, and count what spinning wheels
//! do not drive; the surroundings show both.
//!
//! Assumptions: nothing else moves, and the guess is less than [`GATES_M`] away. Smooth walls along the way do not show a
//! motion ahead: then there is no result.

use nalgebra::{Matrix3, Vector2, Vector3};
use shared_types::{BEAMS, Scan, ScanGeometry, WINDOW};
use vehicle::Description;

/// Returns on either side of one that its surface is a line through.
const NEIGHBOURS: usize = 4;
/// Returns of one surface are no further from each other than this, and this share of the range [m].
const APART: (f64, f64) = (0.05, 0.05);
/// Returns of one surface scatter by less about its line [m].
const FLAT_M: f64 = 0.03;
/// Largest distance of a point from the surface that it is laid onto, from coarse to fine [m].
const GATES_M: [f64; 4] = [0.4, 0.2, 0.1, 0.06];
/// Steps per gate.
const STEPS: usize = 6;
/// Fewer points on surfaces prove nothing.
const MIN_POINTS: usize = 30;
/// Surfaces that face ahead or back by more than this show a motion ahead; on others noise turns the normal as much.
const FACING: f64 = 0.5;
/// Smallest standard deviation of a range that the scatter may show [m].
const MIN_RANGE_ERROR_M: f64 = 0.003;
/// A motion ahead with a larger standard error was not seen [m].
const MAX_ERROR_M: f64 = 0.01;

/// Where the body was at one scan, seen from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shift {
    /// Ahead [m], to the left [m] and turned to the left [rad].
    pub(super) pose: [f64; 3],
    /// Standard error of the shift ahead [m].
    pub(super) error_m: f64,
}

/// The surfaces that a scan at rest shows.
#[derive(Debug)]
pub(super) struct Surroundings {
    /// By beam: a place on a surface and its normal.
    surfaces: Vec<Option<(Vector2<f64>, Vector2<f64>)>>,
    scanner: [f64; 3],
}

impl Surroundings {
    /// What scans at one place show, by the mean of their ranges.
    pub(super) fn of(scans: &[&Scan], vehicle: &Description) -> Self {
        let mean = |beam: usize| {
            let ranges: Option<Vec<f64>> = scans.iter().map(|scan| scan.range_m(beam)).collect();
            ranges.map(|ranges| ranges.iter().sum::<f64>() / ranges.len().max(1) as f64)
        };
        let points: Vec<Option<(f64, Vector2<f64>)>> = (0..BEAMS)
            .map(|beam| mean(beam).map(|range_m| (range_m, point(range_m, beam, vehicle))))
            .collect();
        let surfaces = (0..BEAMS).map(|beam| surface(&points, beam)).collect();
        Self { surfaces, scanner: [vehicle.scanner_x_m, vehicle.scanner_y_m, vehicle.scanner_yaw_rad] }
    }

    /// Where the body was at the front beam of another scan, from which it drove at `speed_mps`; near `guess`.
    ///
    /// `None` when the surroundings do not show how far ahead.
    pub(super) fn locate(
        &self,
        scan: &Scan,
        speed_mps: f64,
        guess: [f64; 3],
        vehicle: &Description,
    ) -> Option<Shift> {
        let points: Vec<Vector2<f64>> = WINDOW
            .filter_map(|beam| {
                let moved = Vector2::new(speed_mps * scan.beam_time_s(beam), 0.0);
                Some(point(scan.range_m(beam)?, beam, vehicle) + moved)
            })
            .collect();
        let mut pose = Vector3::from(guess);
        let mut error_m = f64::INFINITY;
        for gate_m in GATES_M {
            for _ in 0..STEPS {
                let (step, error) = self.step(&points, &pose, gate_m)?;
                pose += step;
                error_m = error;
            }
        }
        (error_m <= MAX_ERROR_M).then_some(Shift { pose: pose.into(), error_m })
    }

    /// One step of Gauss-Newton, and the standard error of the shift ahead.
    fn step(&self, points: &[Vector2<f64>], pose: &Vector3<f64>, gate_m: f64) -> Option<(Vector3<f64>, f64)> {
        let (sin, cos) = pose.z.sin_cos();
        let (mut information, mut slope) = (Matrix3::<f64>::zeros(), Vector3::zeros());
        let (mut squares, mut count, mut facing) = (0.0, 0, 0.0);
        for point in points {
            let turned = Vector2::new(cos * point.x - sin * point.y, sin * point.x + cos * point.y);
            let there = turned + Vector2::new(pose.x, pose.y);
            let Some((place, normal)) = self.nearest(&there, gate_m) else { continue };
            let residual = normal.dot(&(there - place));
            let by_turn = normal.dot(&Vector2::new(-turned.y, turned.x));
            let row = Vector3::new(normal.x, normal.y, by_turn);
            information += row * row.transpose();
            slope += row * residual;
            squares += residual * residual;
            count += 1;
            facing += if normal.x.abs() >= FACING { normal.x * normal.x } else { 0.0 };
        }
        if count < MIN_POINTS {
            return None;
        }
        // Directions that nothing shows stay where the guess has them.
        let weak = Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 1e-3));
        let inverse = (information + weak).try_inverse()?;
        let variance = (squares / count as f64).max(MIN_RANGE_ERROR_M.powi(2));
        Some((-(inverse * slope), (variance / facing).sqrt()))
    }

    /// The surface nearest to a point, among those that the scanner sees in its direction.
    fn nearest(&self, point: &Vector2<f64>, gate_m: f64) -> Option<(Vector2<f64>, Vector2<f64>)> {
        let [x, y, yaw] = self.scanner;
        let direction = (point.y - y).atan2(point.x - x) - yaw;
        let pitch = ScanGeometry::URG_04LX.yaw_rad(1) - ScanGeometry::URG_04LX.yaw_rad(0);
        let beam = ((direction - ScanGeometry::URG_04LX.yaw_rad(0)) / pitch).round();
        if !(0.0..BEAMS as f64).contains(&beam) {
            return None;
        }
        // A surface that moves towards the scanner is seen in other directions.
        let reach = (gate_m / pitch / point.norm().max(0.2)).ceil() as usize;
        let (beam, last) = (beam as usize, BEAMS - 1);
        let near = self.surfaces[beam.saturating_sub(reach)..=(beam + reach).min(last)].iter().flatten();
        let distance = |(place, _): &&(Vector2<f64>, Vector2<f64>)| (place - point).norm_squared();
        let (place, normal) = *near.min_by(|one, other| distance(one).total_cmp(&distance(other)))?;
        ((place - point).norm() <= gate_m).then_some((place, normal))
    }
}

/// A return in the frame of the body [m].
fn point(range_m: f64, beam: usize, vehicle: &Description) -> Vector2<f64> {
    let (sin, cos) = (ScanGeometry::URG_04LX.yaw_rad(beam) + vehicle.scanner_yaw_rad).sin_cos();
    Vector2::new(vehicle.scanner_x_m + range_m * cos, vehicle.scanner_y_m + range_m * sin)
}

/// The line through a return and its neighbours: its place and its normal; `None` at edges and on rough surfaces.
fn surface(points: &[Option<(f64, Vector2<f64>)>], beam: usize) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let near = points.get(beam.checked_sub(NEIGHBOURS)?..=beam + NEIGHBOURS)?;
    let near: Option<Vec<(f64, Vector2<f64>)>> = near.iter().copied().collect();
    let near = near?;
    let is_whole = near.windows(2).all(|pair| (pair[1].0 - pair[0].0).abs() <= APART.0 + APART.1 * pair[0].0);
    let mean = near.iter().map(|(_, place)| place).sum::<Vector2<f64>>() / near.len() as f64;
    let spread = near.iter().fold([0.0; 3], |[xx, xy, yy], (_, place)| {
        let offset = place - mean;
        [xx + offset.x * offset.x, xy + offset.x * offset.y, yy + offset.y * offset.y]
    });
    let [xx, xy, yy] = spread;
    // The main axis of the spread is the line.
    let axis = 0.5 * (2.0 * xy).atan2(xx - yy);
    let normal = Vector2::new(-axis.sin(), axis.cos());
    let scatter = near.iter().map(|(_, place)| normal.dot(&(place - mean)).powi(2)).sum::<f64>();
    (is_whole && (scatter / near.len() as f64).sqrt() <= FLAT_M).then_some((mean, normal))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scan from `x_m` along a corridor with a box ahead, or without one.
    fn scan(x_m: f64, speed_mps: f64, has_box: bool) -> Scan {
        let mut scan = Scan { sweep_ns: 66_666_667, ..Scan::of(ScanGeometry::URG_04LX) };
        for beam in 0..BEAMS {
            let at_m = x_m + speed_mps * scan.beam_time_s(beam);
            let (sin, cos) = ScanGeometry::URG_04LX.yaw_rad(beam).sin_cos();
            let side = if sin == 0.0 { f64::INFINITY } else { 2.0 / sin.abs() };
            let ahead = (4.0 - at_m) / cos;
            let hits = has_box && cos > 0.0 && (ahead * sin).abs() <= 0.5;
            let range_m = if hits { ahead.min(side) } else { side };
            // Noise of 10 mm that a reader can repeat.
            let noise_mm = ((beam * 7919) % 21) as f64 - 10.0;
            if range_m < 5.6 {
                scan.ranges_mm[beam] = (1e3 * range_m + noise_mm) as u32;
            }
        }
        scan
    }

    fn vehicle() -> Description {
        Description { scanner_x_m: 0.0, scanner_y_m: 0.0, scanner_yaw_rad: 0.0, ..Description::default() }
    }

    #[test]
    fn the_way_to_a_box_is_seen_to_millimetres_from_a_moving_scanner() {
        let rest = scan(1.0, 0.0, true);
        let surroundings = Surroundings::of(&[&rest], &vehicle());
        for (x_m, speed_mps, guess_m) in [(0.9, 0.6, 0.0), (0.7, 0.3, -0.05), (1.0, 0.0, -0.1)] {
            let shift =
                surroundings.locate(&scan(x_m, speed_mps, true), speed_mps, [guess_m, 0.0, 0.0], &vehicle());
            let shift = shift.unwrap();
            assert!((shift.pose[0] - (x_m - 1.0)).abs() < 0.006, "{x_m}: {shift:?}");
            assert!(shift.pose[1].abs() < 0.006 && shift.pose[2].abs() < 0.006, "{shift:?}");
            assert!(shift.error_m < 0.004, "{shift:?}");
        }
    }

    #[test]
    fn smooth_walls_along_the_way_do_not_show_it() {
        let surroundings = Surroundings::of(&[&scan(1.0, 0.0, false)], &vehicle());
        assert_eq!(surroundings.locate(&scan(0.9, 0.0, false), 0.0, [0.0; 3], &vehicle()), None);
    }
}
