//! A robot that was lifted or pushed finds itself among the surfaces that it knows.
//!
//! Where a scanner looks through a surface that stands there, and this in several places and nearly as often as it sees what
//! it should, the pose is wrong. Then poses around it are tried, some with each scan, and the one from which most
//! returns lie on known lines is taken.

use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};
use shared_types::{Scan, plain_state};
use vehicle::Description;
use vehicle::frame::{to_robot, wrap_angle};

use super::align::{Prior, nearest};
use super::known::Stated;
use super::pieces::Pieces;
use super::surface::SurfaceLine;

/// So many scans in a row contradict the pose before it is searched for.
const DOUBTS: u64 = 3;
/// A robot that has to be searched for again so soon was not lifted: its scans contradict its motion [ns].
const AGAIN_NS: u64 = 20_000_000_000;
/// Nor was one that seems to have turned, with its scanner within this of where it was: the scanner has turned on its mount, or
/// the yaw of the odometry is wrong [m].
const SAME_PLACE_M: f64 = 0.15;
/// Poses that are tried: steps to each side of [`STEP_M`] and [`STEP_RAD`]; one turn with each scan.
const STEPS: i32 = 8;
const TURNS: u64 = 11;
const STEP_M: f64 = 0.1;
const STEP_RAD: f64 = 0.06;
/// Share of the returns that lie on known lines where the robot is.
const ENOUGH: f64 = 0.6;
/// Of poses that explain the scan alike, the nearer one is taken: share of the returns that a metre costs.
const PER_M: f64 = 0.05;
/// A surface is seen where it stands to this, and looked through when the return is further behind it [m].
const THERE_M: (f64, f64) = (0.12, 0.2);
/// Surfaces further away, or less in the view, are not asked [m].
const ASKED_M: (f64, f64) = (0.3, 5.0);
/// Cosine between a beam and the normal of the surface, at least.
const FACING: f64 = 0.35;
/// Places of a surface that are asked: the nearest one, and these beside it [m].
const BESIDE_M: [f64; 3] = [-1.5, 0.0, 1.5];
/// So far inside of its ends: what is seen at an edge may be what is behind it [m].
const INSIDE_M: f64 = 0.1;
/// Places that have to be looked through at least.
const THROUGH: u32 = 3;
/// And more than this share of those that are seen.
const MORE: f64 = 0.7;

plain_state! {
    /// How far the search is.
    pub struct Search {
        /// Scans in a row that contradict the pose
        pub doubts: u64,
        /// Turns that were tried
        pub turns: u64,
        /// The best pose so far, against the one that is doubted: yaw, x and y [rad, m, m]
        pub best: [f64; 3],
        /// Share of the returns that it explains, less what its distance costs
        pub score: f64,
        /// How often the robot has found itself
        pub found: u64,
        /// How often it has not
        pub lost: u64,
        /// When it was searched for last [ns]
        pub since_ns: u64,
        /// How often it was not lifted: it was searched for again soon after, or has turned where it stands
        pub again: u64,
    }
}

/// What comes of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Whereabouts {
    /// Nothing speaks against the pose.
    Known,
    /// The pose is searched for.
    Sought,
    /// The robot is here.
    Found(Vector3<f64>),
    /// It is nowhere near.
    Lost,
}

impl Search {
    /// Whether the pose is not known.
    pub fn is_on(&self) -> bool {
        self.doubts >= DOUBTS
    }

    /// Takes a scan into account.
    pub fn follow(
        &mut self,
        scan: &Scan,
        pieces: &Pieces,
        lines: &[SurfaceLine],
        pose: [f64; 3],
        vehicle: &Description,
        stated: &mut Stated,
    ) -> Whereabouts {
        if !self.is_on() {
            let doubts = self.doubts + 1;
            self.doubts = if contradicts(scan, pieces, lines, pose, vehicle, stated) { doubts } else { 0 };
            if !self.is_on() {
                return Whereabouts::Known;
            }
        }
        self.try_turn(pieces, lines, pose);
        self.turns += 1;
        if self.turns < TURNS {
            return Whereabouts::Sought;
        }
        let Self { best, score, found, lost, since_ns, again, .. } = *self;
        let now_ns = scan.header.acquired_ns;
        let is_again = since_ns > 0 && now_ns.saturating_sub(since_ns) < AGAIN_NS;
        let was_found = score >= ENOUGH;
        let again = again + u64::from(is_again || was_found && has_turned(&best, pose[0], vehicle));
        *self = Self { found, lost, since_ns: now_ns, again, ..Self::default() };
        if !was_found {
            self.lost += 1;
            return Whereabouts::Lost;
        }
        self.found += 1;
        let [yaw, x, y] = pose;
        Whereabouts::Found(Vector3::new(wrap_angle(yaw + best[0]), x + best[1], y + best[2]))
    }

    /// Tries the poses with the next turn: none first, then ever larger ones to both sides.
    fn try_turn(&mut self, pieces: &Pieces, lines: &[SurfaceLine], [yaw, x, y]: [f64; 3]) {
        let side = if self.turns.is_multiple_of(2) { 1.0 } else { -1.0 };
        let turn = side * self.turns.div_ceil(2) as f64 * STEP_RAD;
        let returns: f64 = pieces.all().iter().map(|piece| piece.count).sum();
        let coarse = Matrix3::from_diagonal(
            &Vector3::new(STEP_RAD / 4.0, STEP_M / 4.0, STEP_M / 4.0).map(|sigma| sigma * sigma),
        );
        for (ahead, left) in
            (-STEPS..=STEPS).flat_map(|ahead| (-STEPS..=STEPS).map(move |left| (ahead, left)))
        {
            let (dx, dy) = (f64::from(ahead) * STEP_M, f64::from(left) * STEP_M);
            let pose = Vector3::new(yaw + turn, x + dx, y + dy);
            let prior = Prior { pose, covariance: coarse, map: Matrix3::zeros() };
            let explained = pieces.all().iter().filter(|piece| {
                nearest(piece, lines, &pose, pieces.noise_m, &prior, |line| line.counts).is_some()
            });
            let score =
                explained.map(|piece| piece.count).sum::<f64>() / returns.max(1.0) - PER_M * dx.hypot(dy);
            if score > self.score {
                (self.score, self.best) = (score, [turn, dx, dy]);
            }
        }
    }
}

/// Whether the scanner has turned and stands where it stood, by the pose that was found against the one that was doubted.
pub(super) fn has_turned([turn, dx, dy]: &[f64; 3], yaw: f64, vehicle: &Description) -> bool {
    let mount = |yaw: f64| Rotation2::new(yaw) * Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m);
    let moved = Vector2::new(*dx, *dy) + mount(yaw + turn) - mount(yaw);
    *turn != 0.0 && moved.norm() < SAME_PLACE_M
}

/// Whether the scan looks through surfaces that should be seen, nearly as often as it sees them; notes the same of those that
/// the track states.
fn contradicts(
    scan: &Scan,
    pieces: &Pieces,
    lines: &[SurfaceLine],
    [yaw, x, y]: [f64; 3],
    vehicle: &Description,
    stated: &mut Stated,
) -> bool {
    let robot = Vector2::new(x, y);
    let scanner = Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m);
    let (mut seen, mut through) = (0, 0);
    // Of a round body it is not the middle that is seen.
    for line in lines.iter().filter(|line| line.counts && line.radius_m == 0.0) {
        let [first, last] = line.closed_m;
        let nearest_m = line.along().dot(&(robot - line.middle));
        let half_m = (last - first) / 2.0;
        let inside_m = INSIDE_M.min(half_m);
        for beside_m in
            BESIDE_M.map(|beside_m| beside_m.clamp(-half_m, half_m) / if half_m < 1.5 { 2.0 } else { 1.0 })
        {
            let at_m =
                (nearest_m + beside_m).clamp(first + inside_m, (last - inside_m).max(first + inside_m));
            let from = line.middle + line.along() * at_m - robot;
            let front = to_robot(yaw, from.x, from.y);
            let beam_at = |place: Vector2<f64>| {
                let angle = wrap_angle(place.y.atan2(place.x) - vehicle.scanner_yaw_rad);
                ((angle - scan.first_rad) / scan.increment_rad).round()
            };
            let beams = 0.0..scan.ranges().len() as f64;
            let first_beam = beam_at(front - scanner);
            if !beams.contains(&first_beam) {
                continue;
            }
            let place = pieces.motion.at_time(front, scan.beam_time_s(first_beam as usize)) - scanner;
            let expected_m = place.norm();
            let is_asked = (ASKED_M.0..ASKED_M.1).contains(&expected_m)
                && -line.normal.dot(&from) >= FACING * from.norm();
            let beam = beam_at(place);
            if !is_asked || !beams.contains(&beam) {
                continue;
            }
            let Some(range_m) = scan.range_m(beam as usize) else { continue };
            let behind_m = range_m - pieces.longer_m - expected_m;
            let (is_seen, is_through) = (behind_m.abs() <= THERE_M.0, behind_m >= THERE_M.1);
            if line.index.is_none() {
                stated.note(line.is_long, u64::from(is_seen), u64::from(is_through));
            }
            seen += u32::from(is_seen);
            through += u32::from(is_through);
        }
    }
    through >= THROUGH && f64::from(through) > MORE * f64::from(seen)
}
