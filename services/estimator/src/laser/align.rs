//! The pose from which the pieces of a scan lie on known lines: point to line, DOI 10.1109/ROBOT.2008.4543181.
//!
//! Each piece is laid onto the line that it fits best, and the sum of squares of all its returns about these lines is made
//! smallest together with the distance from the expected pose, by Gauss-Newton: an iterated Kalman filter
//! (DOI 10.1109/9.250476), so that directions which no surface shows stay as expected. Of surfaces that face alike those
//! count most whose place is known best: what was seen at the start corrects what was seen since.

use nalgebra::{Matrix3, Vector2, Vector3};
use vehicle::frame::wrap_angle;

use super::pieces::{MAX_PIECES, Piece, Pieces};
use super::surface::{Placed, SurfaceLine};
use crate::dead_reckoning::{DeadReckoning, Sighting};

/// Steps of Gauss-Newton at most.
const STEPS: usize = 12;
/// The pose is found when a step changes it by less [rad, m].
const FOUND: f64 = 1e-6;
/// Angle between a piece and a line that it is a part of, beyond what is expected, and at most [rad].
const PARALLEL_RAD: (f64, f64) = (0.015, 0.2);
/// A piece that is further from a line than this beyond what is expected is no part of it [m].
const NEAR_M: f64 = 0.03;
/// Never further than this [m].
const FAR_M: f64 = 0.5;
/// So many standard deviations are expected.
const SIGMAS: f64 = 3.0;
/// Standard deviation of what is wrong with a surface in all its returns: of a short one, whose edges are a larger part of
/// it, and of a long one [m].
const BIAS_M: (f64, f64) = (0.02, 0.006);
/// The same of a round body [m].
const ROUND_BIAS_M: f64 = 0.006;
/// Where a surface alone is off, it is off in so many scans alike.
const SAME: f64 = 20.0;
/// Lines are parallel when their directions differ by less than this [rad].
const LEVEL_RAD: f64 = 0.01;
/// A residual of this size counts half [m].
const HALF_M: f64 = 0.03;
/// A piece of a line may be beyond its ends by this, and of one that continues by this [m].
const BEYOND_M: (f64, f64) = (0.15, 2.0);
/// A surface counts less than another where the variance of its place is larger by this factor.
const WORSE: f64 = 9.0;
/// Where the place of the surfaces around is known to this, others do not show another [m].
const LOST_M: f64 = 0.05;
/// Cosine of the angle between surfaces that face alike, at least.
const ALIKE: f64 = 0.7;

/// The pose before a match.
#[derive(Debug, Clone, Copy)]
pub struct Prior {
    /// Yaw, x and y [rad, m, m].
    pub pose: Vector3<f64>,
    /// Covariance against the surfaces around.
    pub covariance: Matrix3<f64>,
    /// Covariance of the place of these surfaces.
    pub map: Matrix3<f64>,
}

impl Prior {
    /// That of dead reckoning.
    pub fn of(reckoning: &DeadReckoning) -> Self {
        Self {
            pose: Vector3::from(reckoning.pose),
            covariance: reckoning.against_surfaces(),
            map: reckoning.map(),
        }
    }
}

/// A match.
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// The pose that explains scan and expectation best.
    pub pose: Vector3<f64>,
    /// What it says.
    pub sighting: Sighting,
    /// Returns on pieces that lie on a line, and on all pieces.
    pub returns: [f64; 2],
}

/// A pair of a piece and the line that it is a part of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair<'l> {
    pub(super) line: &'l SurfaceLine,
    pub(super) placed: Placed,
    count: f64,
    /// Distance of the mean from the line [m].
    pub(super) off_m: f64,
    /// Change of that with (yaw, x, y).
    pub(super) slope: Vector3<f64>,
    /// Covariance of the place of the line, as one of the pose.
    place: Matrix3<f64>,
    /// What it says of the pose.
    information: Matrix3<f64>,
}

/// Finds the pose; `None` when no piece lies on a line that counts.
pub fn align(pieces: &Pieces, lines: &[SurfaceLine], reckoning: &DeadReckoning) -> Option<Found> {
    let prior = &Prior::of(reckoning);
    let mut pose = prior.pose;
    let (mut found, mut beside) = (None, Matrix3::zeros());
    for _ in 0..STEPS {
        let mut pairs = [None; MAX_PIECES];
        let (mut sighting, returns) = sight(pieces, lines, prior, &pose, &mut pairs)?;
        sighting.beside = beside;
        let covariance = prior.covariance + beside;
        let inverse = (Matrix3::identity() + sighting.information * covariance).try_inverse()?;
        let next = prior.pose + covariance * (inverse * sighting.pull);
        let step = next - pose;
        pose = next;
        sighting.map = blended(prior, &pairs, &covariance, &inverse);
        found = Some(Found { pose, sighting, returns });
        if !step.iter().all(|value| value.is_finite()) {
            return None;
        }
        if step.amax() < FOUND {
            break;
        }
        let map = sighting.map;
        let far = |axis| prior.map[(axis, axis)] > LOST_M.powi(2);
        if (1..3).any(|axis| far(axis) && map[(axis, axis)] * WORSE < prior.map[(axis, axis)]) {
            beside = prior.map;
        }
    }
    found
}

/// Covariance of the place of the surfaces around after a match: the mean of that before and of those that were seen, each
/// axis by their weights in the pose. Their errors may be one and the same, so several are no better than one.
fn blended(
    prior: &Prior,
    pairs: &[Option<Pair<'_>>],
    covariance: &Matrix3<f64>,
    inverse: &Matrix3<f64>,
) -> Matrix3<f64> {
    let gain = inverse.transpose() * covariance;
    let weights = |pair: &Pair<'_>| (gain * pair.information).diagonal().map(|weight| weight.max(0.0));
    let kept = inverse.diagonal().map(|weight| weight.max(0.0));
    let sum = pairs.iter().flatten().map(weights).sum::<Vector3<f64>>() + kept;
    let share = |weights: Vector3<f64>, place: &Matrix3<f64>| {
        let root = Matrix3::from_diagonal(&weights.component_div(&sum).map(f64::sqrt));
        root * place * root
    };
    pairs.iter().flatten().map(|pair| share(weights(pair), &pair.place)).sum::<Matrix3<f64>>()
        + share(kept, &prior.map)
}

/// What the pieces say of the expected pose when they are seen from `pose`; the pairs of piece and line.
fn sight<'l>(
    pieces: &Pieces,
    lines: &'l [SurfaceLine],
    prior: &Prior,
    pose: &Vector3<f64>,
    pairs: &mut [Option<Pair<'l>>; MAX_PIECES],
) -> Option<(Sighting, [f64; 2])> {
    let (mut count, mut returns) = (0, [0.0; 2]);
    for piece in pieces.all() {
        returns[1] += piece.count;
        let pair = nearest(piece, lines, pose, pieces.noise_m, prior, |line| line.counts);
        if let (Some(pair), Some(place)) = (pair, pairs.get_mut(count)) {
            returns[0] += pair.count;
            *place = Some(pair);
            count += 1;
        }
    }
    level(&mut pairs[..count]);
    let mut sighting = Sighting::default();
    let mut slope = Vector3::zeros();
    for index in 0..count {
        let Some(pair) = pairs[index] else { continue };
        let (squares, residual) = pair.squares();
        // Of a return: its own noise, and that which all have.
        let bias_m = pair.bias_m();
        let same = pair.same(prior);
        let variance = pieces.noise_m.powi(2) / pair.count + bias_m.powi(2) + same;
        let of_return = 1.0 / (variance * pair.count);
        let alike = pairs[..count]
            .iter()
            .flatten()
            .filter(|other| other.line.normal.dot(&pair.line.normal).abs() >= ALIKE);
        let least = alike.map(Pair::variance).fold(f64::INFINITY, f64::min);
        let worse = (pair.variance() - WORSE * (least + variance)).max(0.0);
        let weight = 1.0 / (1.0 + worse / variance) / (1.0 + (pair.off_m / HALF_M).powi(2));
        let mut information = squares * (of_return * weight);
        sighting.noise += squares * (of_return * weight * weight);
        slope += residual * (of_return * weight);
        if let Some((off_m, by_pose, sigma_m)) = pair.along(pose, prior) {
            let variance = sigma_m.powi(2) + bias_m.powi(2);
            let weight = 1.0 / variance / (1.0 + (off_m / HALF_M).powi(2));
            let squares = by_pose * by_pose.transpose() * weight;
            information += squares;
            sighting.noise += squares / (1.0 + (off_m / HALF_M).powi(2));
            slope += by_pose * (off_m * weight);
        }
        sighting.information += information;
        pairs[index] = Some(Pair { information, ..pair });
    }
    let [yaw, x, y] = (pose - prior.pose).into();
    sighting.pull = sighting.information * Vector3::new(wrap_angle(yaw), x, y) - slope;
    (count > 0).then_some((sighting, returns))
}

/// Lines that are parallel as far as is known do not show how far the robot is along them, by where they would meet.
fn level(pairs: &mut [Option<Pair<'_>>]) {
    for index in 1..pairs.len() {
        let (before, from) = pairs.split_at_mut(index);
        let Some(pair) = &mut from[0] else { continue };
        let normal = pair.line.normal;
        let parallel = before
            .iter()
            .flatten()
            .map(|other| other.slope.yz())
            .find(|other| normal.perp(other).abs() < LEVEL_RAD);
        if let Some(other) = parallel {
            let other = other * normal.dot(&other).signum();
            (pair.slope[1], pair.slope[2]) = (other.x, other.y);
        }
    }
}

impl Pair<'_> {
    /// Sums over the returns: of the squares of their slopes, and of slope times residual.
    fn squares(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let normal = self.line.normal;
        let (arm, scatter) = (Vector2::new(normal.y, -normal.x), &self.placed.scatter);
        let mut squares = self.slope * self.slope.transpose() * self.count;
        let mut residual = self.slope * (self.count * self.off_m);
        // The direction of a short one is not known.
        if self.line.is_long {
            squares[(0, 0)] += arm.dot(&(scatter * arm));
            residual[0] += arm.dot(&(scatter * normal));
        }
        (squares, residual)
    }

    /// Standard deviation of what is wrong with it in all its returns [m].
    fn bias_m(&self) -> f64 {
        match self.line {
            SurfaceLine { radius_m, .. } if *radius_m > 0.0 => ROUND_BIAS_M,
            SurfaceLine { is_long: true, .. } => BIAS_M.1,
            _ => BIAS_M.0,
        }
    }

    /// How far the middle of a short surface is along it, how that changes with (yaw, x, y), and its standard deviation.
    fn along(&self, pose: &Vector3<f64>, prior: &Prior) -> Option<(f64, Vector3<f64>, f64)> {
        let (center, (middle, sigma_m)) = self.line.center.zip(self.placed.middle)?;
        let along = self.line.along();
        let from = middle - Vector2::new(pose[1], pose[2]);
        let off_m = along.dot(&(middle - center));
        let by_pose = Vector3::new(along.y * from.x - along.x * from.y, along.x, along.y);
        let beside = by_pose.dot(&((self.place - prior.map) * by_pose)).abs();
        let variance = by_pose.dot(&(prior.covariance * by_pose)) + beside + sigma_m * sigma_m;
        let is_it = off_m.abs() <= NEAR_M + SIGMAS * variance.sqrt();
        (!self.line.is_long && is_it).then_some((off_m, by_pose, sigma_m))
    }

    /// Variance by which the line alone may be off, and so be in scans before this one: not where the pose is known worse [m^2].
    fn same(&self, prior: &Prior) -> f64 {
        let off = self.line.off_m.powi(2);
        let expected = self.slope.dot(&(prior.covariance * self.slope)).max(f64::MIN_POSITIVE);
        off + SAME * off * off / (off + expected)
    }

    /// Variance of the place of the line where the piece is [m^2].
    pub(super) fn variance(&self) -> f64 {
        self.slope.dot(&(self.place * self.slope))
    }
}

/// The line that a piece seen from `pose` is a part of, among those that `may` be it.
pub(super) fn nearest<'l>(
    piece: &Piece,
    lines: &'l [SurfaceLine],
    pose: &Vector3<f64>,
    noise_m: f64,
    prior: &Prior,
    may: impl Fn(&SurfaceLine) -> bool,
) -> Option<Pair<'l>> {
    let placed = Placed::new(piece, pose);
    let robot = Vector2::new(pose[1], pose[2]);
    let direction = noise_m * noise_m / placed.scatter.trace().max(f64::MIN_POSITIVE);
    let turned_rad = PARALLEL_RAD.0 + SIGMAS * (direction + prior.covariance[(0, 0)]).sqrt();
    let turned_rad = turned_rad.min(PARALLEL_RAD.1);
    let mut best: Option<Pair<'l>> = None;
    for line in lines.iter().filter(|line| may(line)) {
        let placed = placed.with_radius(line.radius_m);
        if !placed.is_alike(line.radius_m)
            || line.normal.dot(&placed.normal) < 0.0
            || line.along().dot(&placed.normal).abs() > turned_rad
        {
            continue;
        }
        let off_m = line.normal.dot(&(placed.mean - line.middle));
        if off_m.abs() > best.as_ref().map_or(FAR_M, |best| best.off_m.abs()) {
            continue;
        }
        let ends = placed.ends.map(|end| line.along().dot(&(end - line.middle)));
        let [first, last] = line.extent_m;
        let beyond_m = if line.is_long { BEYOND_M.1 } else { BEYOND_M.0 };
        if ends[0].max(ends[1]) < first - beyond_m || ends[0].min(ends[1]) > last + beyond_m {
            continue;
        }
        let [x, y] = line.normal.into();
        let from = placed.mean - robot;
        let slope = Vector3::new(y * from.x - x * from.y, x, y);
        let moved = robot - line.seen_from;
        let transport = Matrix3::new(1.0, 0.0, 0.0, -moved.y, 1.0, 0.0, moved.x, 0.0, 1.0);
        let place = transport * line.covariance * transport.transpose();
        // What was seen later shares the errors of what was seen before.
        let beside = slope.dot(&((place - prior.map) * slope)).abs();
        let own = noise_m * noise_m / piece.count + line.off_m * line.off_m;
        let variance = slope.dot(&(prior.covariance * slope)) + beside + own;
        if off_m.abs() <= NEAR_M + SIGMAS * variance.sqrt() {
            best = Some(Pair {
                line,
                placed,
                count: piece.count,
                off_m,
                slope,
                place,
                information: Matrix3::zeros(),
            });
        }
    }
    best
}

/// The line that a piece is a part of, where the pose is known: one that counts if there is one.
pub(super) fn part_of<'l>(
    piece: &Piece,
    lines: &'l [SurfaceLine],
    prior: &Prior,
    noise_m: f64,
) -> Option<&'l SurfaceLine> {
    let find = |counts| nearest(piece, lines, &prior.pose, noise_m, prior, |line| line.counts == counts);
    find(true).or_else(|| find(false)).map(|pair| pair.line)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pair that tells `information` of a surface of this covariance.
    fn pair<'l>(line: &'l SurfaceLine, information: Matrix3<f64>, place: Matrix3<f64>) -> Option<Pair<'l>> {
        let placed = Placed::new(&Piece::default(), &Vector3::zeros());
        let slope = Vector3::zeros();
        Some(Pair { line, placed, count: 1.0, off_m: 0.0, slope, place, information })
    }

    #[test]
    fn each_axis_has_the_place_of_the_surfaces_that_show_it_and_several_are_no_better_than_one() {
        let mut line = None;
        let track = vehicle::Track { walls: true, ..Default::default() };
        crate::laser::known::surfaces(&track, Vector2::zeros(), 5.6, &mut |wall| line = Some(wall));
        let line = &line.unwrap();
        let covariance = Matrix3::identity();
        let prior = Prior {
            pose: Vector3::zeros(),
            covariance,
            map: Matrix3::from_diagonal(&Vector3::new(0.1, 4.0, 9.0)),
        };
        // Two surfaces show y alone, each as well: of these y is the mean, the rest stays as it was.
        let shown = Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, 1e9));
        let (one, other) = (Matrix3::identity() * 0.04, Matrix3::identity() * 0.02);
        let pairs = [pair(line, shown, one), None, pair(line, shown, other)];
        let inverse = (Matrix3::identity() + shown * 2.0 * covariance).try_inverse().unwrap();
        let map = blended(&prior, &pairs, &covariance, &inverse);
        assert!((map.diagonal() - Vector3::new(0.1, 4.0, 0.03)).amax() < 1e-6, "{map}");
        // A covariance, whatever is blended.
        let skewed = Matrix3::new(0.1, 0.6, -0.9, 0.6, 4.0, -5.9, -0.9, -5.9, 9.0);
        let pairs = [pair(line, Matrix3::repeat(1.0), skewed)];
        let inverse = (Matrix3::identity() + Matrix3::repeat(1.0)).try_inverse().unwrap();
        assert!(blended(&prior, &pairs, &covariance, &inverse).symmetric_eigenvalues().min() > -1e-9);
    }
}
