//! A scan laid onto what another one has shown: point to line, DOI 10.1109/ROBOT.2008.4543181.
//!
//! Of both the lines through each return and its neighbours are found, and where the one has such a place it is laid onto the
//! nearest line of the other, by Gauss-Newton in yaw and both ways, weighed against what is expected: corners look as round in
//! both. Wheel encoders do not count what locked wheels slide, and count what spinning wheels do not drive; the surroundings
//! show both, whatever their shape.
//!
//! Assumptions: most of what is seen stands still, and the guess is less than 0.4 m away.

use nalgebra::{Matrix2, Matrix3, Rotation2, SymmetricEigen, Vector2, Vector3};
use shared_types::{MAX_BEAMS, ScanGeometry};
use vehicle::Description;
use vehicle::frame::{heading, wrap_angle};

use super::pieces::normal_of;

/// Returns within this way to either side of one are those that its surface is a line through [m]: how many on each side, and how
/// many in all at least.
const BESIDE_M: f64 = 0.05;
const BESIDE: (usize, usize) = (2, 12);
const MIN_NEIGHBOURS: usize = 3;
/// Returns of one surface are no further from each other than this, and this share of the range [m].
const APART: (f64, f64) = (0.05, 0.05);
/// Returns of one surface scatter by less about its line [m].
const FLAT_M: f64 = 0.03;
/// Largest distance of a return from the surface that it is laid onto, from coarse to fine [m].
const GATES_M: [f64; 3] = [0.4, 0.2, 0.1];
/// Of so many beams one is laid until the last gate.
const COARSE: usize = 3;
/// Steps per gate at most; one that changes the pose by less is the last [rad, m].
const STEPS: usize = 4;
const FOUND: f64 = 1e-5;
/// A residual of this size counts half [m].
const HALF_M: f64 = 0.03;
/// Standard deviation of a return about the line that it is laid onto [m].
const RETURN_M: f64 = 0.02;
/// Cosine of the angle between the normals of two places that may be one.
const LIKE: f64 = 0.8;
/// Steps of the decomposition of what returns say at most: it takes a few.
const EIGEN_STEPS: usize = 100;
/// Fewer returns on surfaces prove nothing.
const MIN_COUNT: usize = 30;
/// Surfaces that face ahead or back by more than this show a motion ahead; on others noise turns the normal as much.
const FACING: f64 = 0.5;
/// Smallest standard deviation of a range that the scatter may show [m].
const MIN_RANGE_ERROR_M: f64 = 0.003;

/// A place on a surface.
#[derive(Debug, Clone, Copy)]
struct Face {
    place: Vector2<f64>,
    normal: Vector2<f64>,
    /// Variance of its direction [rad^2].
    tilt: f64,
}

/// The surfaces that a scan shows, by beam, in the frame of the robot that took it.
#[derive(Debug, Clone)]
pub struct Outline {
    returns: Vec<Option<(f64, Vector2<f64>)>>,
    faces: Vec<Option<Face>>,
    geometry: ScanGeometry,
    scanner: [f64; 3],
}

/// A scan that was laid onto an outline.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Laid {
    /// Yaw, and how far ahead and to the left of the outline's robot this one is [rad, m, m].
    pub pose: Vector3<f64>,
    /// What the returns say of that, zero in directions that nothing shows.
    pub information: Matrix3<f64>,
    /// That information times the difference of the pose that was seen from the guess.
    pub pull: Vector3<f64>,
    /// How many places of it are on a surface of the outline, and how many there are.
    pub count: [usize; 2],
    /// Standard error of the way ahead, by the scatter of the returns; infinite where no surface faces ahead or back [m].
    pub ahead_error_m: f64,
}

impl Default for Outline {
    fn default() -> Self {
        Self {
            returns: Vec::with_capacity(MAX_BEAMS),
            faces: Vec::with_capacity(MAX_BEAMS),
            geometry: ScanGeometry::URG_04LX,
            scanner: [0.0; 3],
        }
    }
}

impl Outline {
    /// Becomes that of a scan with these ranges; `moved` places a return where it was at the time of the front beam. Neighbours of
    /// a return are those that are `stride` beams from each other.
    pub fn show(
        &mut self,
        geometry: ScanGeometry,
        stride: usize,
        vehicle: &Description,
        range_m: impl Fn(usize) -> Option<f64>,
        moved: impl Fn(usize, Vector2<f64>) -> Vector2<f64>,
    ) {
        self.scanner = [vehicle.scanner_x_m, vehicle.scanner_y_m, vehicle.scanner_yaw_rad];
        self.geometry = geometry;
        let Self { returns, faces, .. } = self;
        let seen = |beam| {
            let range_m = range_m(beam)?;
            Some((range_m, moved(beam, place(vehicle, geometry.yaw_rad(beam), range_m))))
        };
        returns.clear();
        returns.extend((0..geometry.count).map(seen));
        faces.clear();
        let beams = Beams { stride, pitch_rad: geometry.increment_rad.abs(), scanner: self.scanner };
        faces.extend((0..geometry.count).map(|beam| beams.face(returns, beam)));
    }

    /// Where a robot is that sees another outline, near a guess of this covariance; yaw, ahead and to the left of the robot of
    /// this one. `None` where too little is on its surfaces.
    pub fn locate(&self, other: &Self, guess: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Laid> {
        let mut laid = Laid { pose: *guess, ..Laid::default() };
        for (gate_m, every) in GATES_M.into_iter().zip([COARSE, COARSE, 1]) {
            for _ in 0..STEPS {
                let pose = laid.pose;
                laid = self.lay((other, every), &pose, guess, gate_m)?;
                let inverse = (Matrix3::identity() + laid.information * covariance).try_inverse()?;
                laid.pose = guess + covariance * (inverse * laid.pull);
                let step = laid.pose - pose;
                if !step.iter().all(|value| value.is_finite()) {
                    return None;
                }
                if step.amax() < FOUND {
                    break;
                }
            }
        }
        Some(laid)
    }

    /// What another outline, one of `every` beams of it, says that is seen from `pose`.
    fn lay(
        &self,
        (other, every): (&Self, usize),
        pose: &Vector3<f64>,
        guess: &Vector3<f64>,
        gate_m: f64,
    ) -> Option<Laid> {
        let turn = Rotation2::new(pose[0]);
        let mut laid = Laid { pose: *pose, ..Laid::default() };
        let (mut slope, mut squares, mut facing) = (Vector3::zeros(), 0.0, 0.0);
        let mut by_noise = Matrix3::zeros();
        for (face, seen) in other.faces.iter().zip(&other.returns).step_by(every) {
            let Some((_, alone)) = seen else { continue };
            laid.count[1] += 1;
            let turned = turn * face.map_or(*alone, |face| face.place);
            let there = turned + pose.yz();
            let faced = face.map(|face| turn * face.normal);
            let Some(Face { place, normal, tilt }) = self.nearest(&there, faced, gate_m) else { continue };
            let off_m = normal.dot(&(there - place));
            let weight = 1.0 / (1.0 + (off_m / HALF_M).powi(2)) / RETURN_M.powi(2);
            let [row, along] = [normal, Vector2::new(-normal.y, normal.x)]
                .map(|direction| Vector3::new(turned.perp(&direction), direction.x, direction.y));
            laid.information += row * row.transpose() * weight;
            by_noise += along * along.transpose() * (tilt * weight);
            slope += row * (off_m * weight);
            squares += off_m * off_m;
            laid.count[0] += 1;
            facing += if normal.x.abs() >= FACING { normal.x * normal.x } else { 0.0 };
        }
        without(&by_noise, &mut laid.information, &mut slope);
        let from = pose - guess;
        laid.pull = laid.information * Vector3::new(wrap_angle(from[0]), from[1], from[2]) - slope;
        let variance = (squares / laid.count[0] as f64).max(MIN_RANGE_ERROR_M.powi(2));
        laid.ahead_error_m = (variance / facing).sqrt();
        (laid.count[0] * every >= MIN_COUNT).then_some(laid)
    }

    /// The surface nearest to a place of another one, among those that the scanner sees in its direction.
    fn nearest(&self, place: &Vector2<f64>, facing: Option<Vector2<f64>>, gate_m: f64) -> Option<Face> {
        let [x, y, yaw] = self.scanner;
        let ScanGeometry { first_rad, increment_rad, .. } = self.geometry;
        let direction = wrap_angle((place.y - y).atan2(place.x - x) - yaw);
        let beam = ((direction - first_rad) / increment_rad).round();
        if !(0.0..self.faces.len() as f64).contains(&beam) {
            return None;
        }
        // A surface that moves towards the scanner is seen in other directions.
        let reach = (gate_m / increment_rad.abs() / place.norm().max(0.2)).ceil();
        let (beam, reach) = (beam as usize, reach.min(MAX_BEAMS as f64) as usize);
        let near = &self.faces[beam.saturating_sub(reach)..(beam + reach + 1).min(self.faces.len())];
        let mut best = (gate_m * gate_m, None);
        for face in near.iter().flatten() {
            let apart = (face.place - place).norm_squared();
            if apart <= best.0 && facing.is_none_or(|facing| face.normal.dot(&facing) >= LIKE) {
                best = (apart, Some(*face));
            }
        }
        best.1
    }
}

/// A return of a beam in the frame of the robot [m].
fn place(vehicle: &Description, beam_yaw_rad: f64, range_m: f64) -> Vector2<f64> {
    Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m)
        + heading(beam_yaw_rad + vehicle.scanner_yaw_rad) * range_m
}

/// Takes off what normals that are off by noise seem to say of the way along their surfaces, in each direction of the
/// information; what is left of it is left of the slope.
fn without(by_noise: &Matrix3<f64>, information: &mut Matrix3<f64>, slope: &mut Vector3<f64>) {
    let (eigen, all) = (SymmetricEigen::try_new(*information, f64::EPSILON, EIGEN_STEPS), *slope);
    (*information, *slope) = (Matrix3::zeros(), Vector3::zeros());
    let Some(eigen) = eigen else { return };
    for (value, direction) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        let left = (value - direction.dot(&(by_noise * direction))).max(0.0);
        if left > 0.0 {
            *information += direction * direction.transpose() * left;
            *slope += direction * (direction.dot(&all) * left / value);
        }
    }
}

/// How the beams of a scan lie.
struct Beams {
    stride: usize,
    pitch_rad: f64,
    scanner: [f64; 3],
}

impl Beams {
    /// The line through a return and its neighbours, which faces the scanner; `None` at edges and on rough surfaces.
    fn face(&self, returns: &[Option<(f64, Vector2<f64>)>], beam: usize) -> Option<Face> {
        let (range_m, _) = returns[beam]?;
        let pitch_m = self.pitch_rad * self.stride as f64 * range_m;
        let reach = ((BESIDE_M / pitch_m).round() as usize).clamp(BESIDE.0, BESIDE.1);
        let first = beam - reach.min(beam / self.stride) * self.stride;
        let near =
            returns[first..(beam + reach * self.stride + 1).min(returns.len())].iter().step_by(self.stride);
        let apart_m = APART.0 + APART.1 * range_m;
        let on_it = || near.clone().flatten().filter(|(other_m, _)| (other_m - range_m).abs() <= apart_m);
        let count = on_it().count();
        if count < MIN_NEIGHBOURS.max(reach) {
            return None;
        }
        let mean = on_it().map(|(_, place)| place).sum::<Vector2<f64>>() / count as f64;
        let scatter = on_it().fold(Matrix2::zeros(), |sum, (_, place)| {
            let offset = place - mean;
            sum + offset * offset.transpose()
        });
        let [x, y, _] = self.scanner;
        let normal = normal_of(&scatter);
        let normal = if normal.dot(&(Vector2::new(x, y) - mean)) < 0.0 { -normal } else { normal };
        let across = normal.dot(&(scatter * normal));
        let along = scatter.trace() - across;
        let is_line = (across / count as f64).sqrt() <= FLAT_M && across <= 0.25 * along;
        let variance = (across / (count - 2) as f64).max(MIN_RANGE_ERROR_M.powi(2));
        is_line.then_some(Face { place: mean, normal, tilt: variance / along })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{BEAMS, Scan};

    fn vehicle() -> Description {
        Description { scanner_x_m: 0.0, scanner_y_m: 0.0, scanner_yaw_rad: 0.0, ..Description::default() }
    }

    /// A scan from `x_m` along a corridor with a box ahead, or without one.
    fn scan(geometry: ScanGeometry, x_m: f64, speed_mps: f64, has_box: bool) -> Scan {
        let mut scan = Scan { sweep_ns: 66_666_667, ..Scan::of(geometry) };
        for beam in 0..geometry.count {
            let at_m = x_m + speed_mps * scan.beam_time_s(beam);
            let (sin, cos) = geometry.yaw_rad(beam).sin_cos();
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

    fn outline(scan: &Scan) -> Outline {
        let mut outline = Outline::default();
        outline.show(scan.geometry(), 1, &vehicle(), |beam| scan.range_m(beam), |_, place| place);
        outline
    }

    /// A scan of a robot that drives, laid onto an outline, where nothing but the guess is known.
    fn laid(outline: &Outline, scan: &Scan, speed_mps: f64, guess_m: f64) -> Option<Laid> {
        let mut seen = Outline::default();
        let moved = |beam: usize, place| place + Vector2::new(speed_mps * scan.beam_time_s(beam), 0.0);
        seen.show(scan.geometry(), 1, &vehicle(), |beam| scan.range_m(beam), moved);
        outline.locate(&seen, &Vector3::new(0.0, guess_m, 0.0), &Matrix3::identity())
    }

    #[test]
    fn the_way_to_a_box_is_seen_to_millimetres_from_a_moving_scanner_with_any_beams() {
        // The second one sweeps clockwise, twice as fine.
        let fine = ScanGeometry {
            count: 2 * BEAMS,
            first_rad: 2.09,
            increment_rad: -2.0 * 2.09 / (2 * BEAMS - 1) as f64,
        };
        for geometry in [ScanGeometry::URG_04LX, fine] {
            let outline = outline(&scan(geometry, 1.0, 0.0, true));
            for (x_m, speed_mps, guess_m) in [(0.9, 0.6, 0.0), (0.7, 0.3, -0.05), (1.0, 0.0, -0.1)] {
                let laid = laid(&outline, &scan(geometry, x_m, speed_mps, true), speed_mps, guess_m).unwrap();
                assert!((laid.pose - Vector3::new(0.0, x_m - 1.0, 0.0)).amax() < 0.006, "{x_m}: {laid:?}");
                assert!(laid.ahead_error_m < 0.004, "{laid:?}");
            }
        }
    }

    #[test]
    fn smooth_walls_along_the_way_do_not_show_it() {
        let outline = outline(&scan(ScanGeometry::URG_04LX, 1.0, 0.0, false));
        let laid = laid(&outline, &scan(ScanGeometry::URG_04LX, 0.9, 0.0, false), 0.0, 0.0).unwrap();
        assert!(
            laid.ahead_error_m > 0.01 && laid.information[(1, 1)] < 1e-2 * laid.information[(2, 2)],
            "{laid:?}"
        );
    }

    #[test]
    fn a_clean_way_is_believed_as_it_is_expected_and_a_poor_one_as_it_is_seen() {
        let outline = outline(&scan(ScanGeometry::URG_04LX, 1.0, 0.0, true));
        let seen = self::outline(&scan(ScanGeometry::URG_04LX, 0.9, 0.0, true));
        for (sigma_m, expected_m) in [(1e-6, -0.05), (0.1, -0.1)] {
            let covariance =
                Matrix3::from_diagonal(&Vector3::new(1e-12, sigma_m * sigma_m, sigma_m * sigma_m));
            let laid = outline.locate(&seen, &Vector3::new(0.0, -0.05, 0.0), &covariance).unwrap();
            assert!((laid.pose[1] - expected_m).abs() < 0.006, "{laid:?}");
        }
    }
}
