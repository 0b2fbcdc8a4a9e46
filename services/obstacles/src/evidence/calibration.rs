//! Whether the ranges fit the motion of the robot: a scale, an offset or a mounting angle that is wrong.
//!
//! Something that does not move seems to move when the robot does and the ranges are wrong: by (1 - f) of the robot's way
//! with a factor f, and by that way across with a mounting angle. An offset o moves it along the ray as the ray turns. Returns of two scans some way apart are matched, the distance of each pair along the surface
//! normal is linear in factor, offset and angle, and in an error of the odometry between the scans. The error is
//! eliminated with the uncertainty that odometry has, so that only what it can't explain is left. The normal equations
//! of many pairs of scans are added, the last two metres count most.
//!
//! On a straight way ranges that are too long look like an odometry that counts too little, and the ranges are
//! suspected. An odometry that is wrong by a factor also reports turns that are wrong by that factor, which ranges can't
//! explain: when that factor alone explains more than all errors of the scanner do, it is the odometry.

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector2, Vector4};
use shared_types::{Flag, TOLERATED_ERRORS, plain_state};

use crate::evidence::snapshot::{Snapshot, Viewpoint, normal_at};
use crate::points::{Beams, Place, Point};

/// Points farther apart than this are not the same [m].
const GATE_M: f64 = 0.6;
/// Beams of the URG-04LX beside the expected one in which the matching point is searched.
const SEARCH_BEAMS: f64 = 14.0;
/// Standard deviation of the distance of two matching points [m].
const NOISE_M: f64 = 0.03;
/// Pairs farther off than this many deviations count less and less.
const ROBUST: f64 = 2.0;
/// Errors of the odometry between two scans: fixed part [m, rad], and fractions of the distance and of the turn.
const ODOMETRY: (f64, f64, f64, f64) = (0.006, 0.006, 0.03, 0.05);
/// Way after which earlier scans count e times less [m].
const MEMORY_M: f64 = 2.0;
/// Many returns of one scan share their errors: so many of them count as one.
const SHARED: f64 = 8.0;
/// With more than this share of returns from what does not move, only those count. With fewer, what seems to move may do so
/// because of the error that is looked for.
const FIXED_SHARE: f64 = 0.5;
/// What is expected of factor, offset [m], angle [rad] and factor of the odometry before anything was seen, standard
/// deviations.
const PRIOR: [f64; 4] = [0.5, 0.5, 0.5, 0.5];
/// The factor of the odometry must explain so much more than the scanner before it is suspected, and so much less
/// before it no longer is: differences of chi squared.
const BLAMED: [f64; 2] = [8.0, 150.0];
/// An error counts when it is this many standard deviations beyond what is tolerated.
const SIGNIFICANT: f64 = 3.0;

plain_state! {
    /// Normal equations of factor, offset and mounting angle of the scanner, and of the factor of the odometry.
    pub struct CalibrationState {
        /// Information matrix, column by column
        pub information: [f64; 16],
        /// Right-hand side
        pub right: [f64; 4],
        /// 1 while the odometry is wrong by a factor
        pub blames_odometry: Flag,
        /// Unused, zero
        pub reserved: u32,
    }
}

/// Estimated errors of the scanner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Errors {
    /// Reported range per true range, less one; offset [m]; mounting angle [rad].
    pub(crate) values: [f64; 3],
    /// Their standard deviations.
    pub(crate) deviations: [f64; 3],
}

impl CalibrationState {
    /// Adds what `points` of a scan from `place` show against an earlier scan.
    pub(crate) fn add(
        &mut self,
        earlier: &Snapshot,
        beams: &Beams,
        now: (&Place, &[Point]),
        index_of: &[u16],
    ) {
        let Some(before) = earlier.place() else { return };
        let place = now.0;
        let (way, turn) = earlier.moved(place);
        let (shift, angle, per_way, per_turn) = ODOMETRY;
        let (shift, angle) = (shift + per_way * way, angle + per_turn * turn);
        let (moved, turned) = (place.at - before.at, place.yaw - before.yaw);
        // Unknowns: factor, offset, angle, factor of the odometry, and its errors along x, along y and in yaw.
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        let view = Viewpoint::new(beams, earlier.scan(), place);
        let search = (SEARCH_BEAMS / beams.coarseness()).ceil() as usize;
        let guess = self.solution();
        let weight = 1.0 / (SHARED * NOISE_M * NOISE_M);
        let fixed = earlier.points().iter().filter(|point| earlier.is_fixed(point.beam)).count();
        // A body that drives ahead of the robot would make all ranges look too short.
        let suffices = fixed as f64 > FIXED_SHARE * earlier.points().len() as f64;
        for (index, point) in earlier.points().iter().enumerate().step_by(2) {
            if suffices && !earlier.is_fixed(point.beam) {
                continue;
            }
            let Some(direction) = normal_at(earlier.points(), index) else { continue };
            let (one, other) = (point.at - place.at, point.at - before.at);
            let across = |ray: Vector2<f64>| Vector2::new(-ray.y, ray.x);
            let bends = one / one.norm().max(0.02) - other / point.range;
            let row = SVector::<f64, 7>::from([
                -direction.dot(&moved),
                direction.dot(&bends),
                -direction.dot(&across(moved)),
                -direction.dot(&(moved + across(one) * turned)),
                direction.x,
                direction.y,
                direction.dot(&across(one)),
            ]);
            // Where it seems to be by the errors that are known so far: without them the nearest return is the wrong one.
            let shift = motion(&guess, moved, bends, across(one) * turned);
            let Some(found) = matching(&view, search, (now.1, index_of), point, point.at + shift) else {
                continue;
            };
            let residual = direction.dot(&(found.at - point.at));
            let unexplained = residual - direction.dot(&shift);
            let robust = 1.0 / (1.0 + (unexplained / (ROBUST * NOISE_M)).powi(2)).sqrt();
            normal.ger(weight * robust, &row, &row, 1.0);
            right.axpy(residual * weight * robust, &row, 1.0);
        }
        let prior = nalgebra::Vector3::new(shift, shift, angle).map(|deviation| deviation.powi(-2));
        let block = normal.fixed_view::<3, 3>(4, 4) + Matrix3::from_diagonal(&prior);
        let Some(inverse) = block.try_inverse() else { return };
        let cross: SMatrix<f64, 4, 3> = normal.fixed_view::<4, 3>(0, 4).into();
        let reduced = normal.fixed_view::<4, 4>(0, 0) - cross * inverse * cross.transpose();
        let reduced_right = right.fixed_rows::<4>(0) - cross * inverse * right.fixed_rows::<3>(4);
        self.fade(way);
        let reduced = (reduced + reduced.transpose()) / 2.0;
        for (value, added) in self.information.iter_mut().zip(reduced.iter()) {
            *value += added;
        }
        for (value, added) in self.right.iter_mut().zip(reduced_right.iter()) {
            *value += added;
        }
        self.blame();
    }

    /// Whether the ranges contradict the motion: one of the errors, [`Self::errors`], is clearly larger than what the margins cover.
    pub(crate) fn contradicts(&self, Errors { values, deviations }: &Errors) -> bool {
        let is_large =
            |index: usize| values[index].abs() > TOLERATED_ERRORS[index] + SIGNIFICANT * deviations[index];
        !self.blames_odometry.is_set() && (0..3).any(is_large)
    }

    /// Decides whether the odometry is wrong by a factor.
    fn blame(&mut self) {
        let (information, right) = self.equations();
        let explained = |matrix: &Matrix4<f64>, right: &Vector4<f64>| {
            matrix.try_inverse().map_or(0.0, |inverse| right.dot(&(inverse * right)))
        };
        let scanner = explained(&without(&information, &[1, 2, 3]), &Vector4::new(right.x, 0.0, 0.0, 0.0));
        let odometry = explained(&without(&information, &[0, 1, 2]), &Vector4::new(0.0, 0.0, 0.0, right.w));
        let [more, less] = BLAMED;
        if odometry > scanner + more {
            self.blames_odometry = true.into();
        } else if scanner > odometry + less {
            self.blames_odometry = false.into();
        }
    }

    /// Information and right-hand side with what is expected before anything was seen.
    fn equations(&self) -> (Matrix4<f64>, Vector4<f64>) {
        let prior = Vector4::from(PRIOR).map(|deviation| deviation.powi(-2));
        (Matrix4::from_column_slice(&self.information) + Matrix4::from_diagonal(&prior), self.right.into())
    }

    /// Errors of the scanner, or factor of the odometry where that is blamed, as far as they are significant; the rest is zero.
    fn solution(&self) -> Vector4<f64> {
        let (information, right) = self.equations();
        let fixed: &[usize] = if self.blames_odometry.is_set() { &[0, 1, 2] } else { &[3] };
        let mut right = right;
        fixed.iter().for_each(|index| right[*index] = 0.0);
        let Some(covariance) = without(&information, fixed).try_inverse() else { return Vector4::zeros() };
        let values = covariance * right;
        Vector4::from_fn(|index, _| {
            let is_known = values[index].powi(2) > SIGNIFICANT.powi(2) * covariance[(index, index)];
            if is_known { values[index] } else { 0.0 }
        })
    }

    /// The errors by all that was added.
    pub(crate) fn errors(&self) -> Errors {
        let (information, mut right) = self.equations();
        right.w = 0.0;
        let Some(covariance) = without(&information, &[3]).try_inverse() else {
            return Errors { values: [0.0; 3], deviations: [0.5; 3] };
        };
        let values = covariance * right;
        let deviation = |index: usize| covariance[(index, index)].max(0.0).sqrt();
        Errors {
            values: [values.x, values.y, values.z],
            deviations: [deviation(0), deviation(1), deviation(2)],
        }
    }

    /// Whether all numbers can be used.
    pub(crate) fn is_sound(&self) -> bool {
        self.information.iter().chain(&self.right).all(|value| value.abs() < 1e15)
    }

    fn fade(&mut self, way: f64) {
        let keep = (-way / MEMORY_M).exp();
        for value in self.information.iter_mut().chain(&mut self.right) {
            *value *= keep;
        }
    }
}

/// The matrix with some unknowns fixed to zero.
fn without(matrix: &Matrix4<f64>, fixed: &[usize]) -> Matrix4<f64> {
    let mut kept = *matrix;
    for index in fixed {
        kept.fill_row(*index, 0.0);
        kept.fill_column(*index, 0.0);
        kept[(*index, *index)] = 1.0;
    }
    kept
}

/// How far something that does not move seems to have moved, with errors of the scanner and the odometry [m].
fn motion(
    errors: &Vector4<f64>,
    moved: Vector2<f64>,
    bends: Vector2<f64>,
    turned: Vector2<f64>,
) -> Vector2<f64> {
    let across = Vector2::new(-moved.y, moved.x);
    bends * errors.y - moved * errors.x - across * errors.z - (moved + turned) * errors.w
}

/// The return within `search` beams that shows what `point` of the earlier scan shows, which is expected at `target`.
fn matching<'a>(
    view: &Viewpoint<'_>,
    search: usize,
    (points, index_of): (&'a [Point], &[u16]),
    point: &Point,
    target: Vector2<f64>,
) -> Option<&'a Point> {
    let expected = view.expected(point)?;
    let low = index_of[expected.beam.saturating_sub(search)] as usize;
    let high = index_of[(expected.beam + search).min(index_of.len() - 1)] as usize;
    let (square, nearest) = points[low..high.max(low)]
        .iter()
        .map(|point| ((point.at - target).norm_squared(), point))
        .min_by(|one, other| one.0.total_cmp(&other.0))?;
    (square < GATE_M * GATE_M).then_some(nearest)
}

/// For each of `count` beams the index of the first of `points` that is not before it.
pub(crate) fn index_beams(points: &[Point], count: usize, index_of: &mut Vec<u16>) {
    index_of.clear();
    for (index, point) in points.iter().enumerate() {
        while index_of.len() <= point.beam {
            index_of.push(index as u16);
        }
    }
    while index_of.len() < count {
        index_of.push(points.len() as u16);
    }
}
