//! A scan as straight pieces of surfaces.
//!
//! Returns that follow each other closely are split where they are furthest from the chord of their ends, until each
//! piece is a line within its noise (iterative end point fit, DOI 10.1016/S0146-664X(72)80017-0); a line is fitted
//! through each. A piece keeps count, mean and scatter of its returns, from which the sum of squares about any line
//! follows exactly. The robot moves while the scanner sweeps, so each return is placed where it was at the time of the
//! front beam.
//!
//! Assumptions: speed and yaw rate are constant during the sweep. What is round gives no straight piece; a small body is a
//! piece of its own then.

use std::f64::consts::SQRT_2;
use std::ops::Range;

use nalgebra::{Matrix2, Vector2};
use shared_types::{MAX_BEAMS, Scan};
use vehicle::Description;
use vehicle::frame::{heading, to_robot};

use super::round::Round;

/// Most pieces of a scan.
pub const MAX_PIECES: usize = 64;
/// Fewer returns make no piece.
const MIN_COUNT: usize = 6;
/// A shorter piece has no direction [m].
const MIN_LENGTH_M: f64 = 0.12;
/// Returns of one surface are no further apart than this, and so many times the distance of two beams [m].
const APART: (f64, f64) = (0.04, 6.0);
/// Returns are on a line when they are no further from it than this, or so many standard deviations [m].
const STRAIGHT: (f64, f64) = (0.02, 3.5);
/// They scatter about it by no more than this, and so many standard deviations [m].
const FLAT: (f64, f64) = (0.001, 1.3);
/// Least and most standard deviation of a range that a scan may show [m].
const NOISE_M: (f64, f64) = (0.002, 0.05);
/// A body of this size is a small one [m]; so many returns of it besides a piece may be its edges or a narrow side.
const SMALL_M: f64 = 1.0;
const REST: f64 = 6.0;
/// Pieces whose ends are so near meet [m].
const CORNER_M: f64 = 0.2;
/// Cosines of the angles between two chords of a round surface, the largest angle first; two of this length are walls that
/// meet from the middle one on [m].
const ROUND: (f64, f64, f64) = (0.26, 0.88, 0.9987);
const LONG_M: f64 = 1.0;
/// The middle of a straight piece is beside its ends by no more than this, and so many standard deviations [m].
const CURVED: (f64, f64) = (0.001, 2.0);
/// What is seen beside an edge is further away by this [m].
const BEHIND_M: f64 = 0.15;
/// So many returns behind a corner leave the line before it by this in the mean, and by so many standard deviations of one [m].
const BEYOND: usize = 10;
const CORNER_OFF: (f64, f64) = (0.03, 1.0);
/// What is smaller than this is a body with corners [m].
const BODY_M: f64 = 1.5;
/// Cosine between beam and normal below which beams meet a surface at a grazing angle.
const GRAZING: f64 = 0.4;
/// Share of the range of the scanner from which on it hardly sees a surface.
const HARDLY: f64 = 0.9;
/// So many beams without a return show an edge, as no fault of the scanner does.
const MISSING: usize = 3;
/// Standard deviation of the middle between two edges, by the distance of two beams.
const EDGE: f64 = 0.4;
/// Standard deviation of the second difference of three ranges, by that of one.
const OF_THREE: f64 = 2.449;
/// Median of a normal magnitude, by its standard deviation.
const MEDIAN: f64 = 0.6745;

/// A straight piece of a surface, in the frame of the robot at the time of the front beam.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Piece {
    /// How many returns it has.
    pub count: f64,
    /// Their mean [m].
    pub mean: Vector2<f64>,
    /// Sum of their squares about it [m^2].
    pub scatter: Matrix2<f64>,
    /// Direction that the surface faces, towards the scanner.
    pub normal: Vector2<f64>,
    /// Its first and last return [m].
    pub ends: [Vector2<f64>; 2],
    /// The middle between both, where they are the edges of the surface, and its standard deviation [m].
    pub middle: Option<(Vector2<f64>, f64)>,
    /// Those of both that are edges of the surface [m].
    pub edges: [Option<Vector2<f64>>; 2],
    /// Standard deviation of the difference of two sightings of one [m].
    pub edge_m: f64,
    /// The circle that it is seen to be instead; its mean is the middle of that.
    pub round: Option<Round>,
    is_chord: bool,
}

impl Piece {
    /// Its length [m].
    fn length_m(&self) -> f64 {
        (self.ends[1] - self.ends[0]).norm()
    }
}

/// A return.
#[derive(Debug, Clone, Copy)]
struct Return {
    place: Vector2<f64>,
    range_m: f64,
    beam: usize,
}

/// The robot's motion during a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SweepMotion {
    /// Speed [m/s].
    pub speed_mps: f64,
    /// Yaw rate [rad/s].
    pub yaw_rate_radps: f64,
}

/// The pieces of one scan, in memory that is kept.
#[derive(Debug, Clone)]
pub struct Pieces {
    returns: Vec<Return>,
    magnitudes: Vec<f64>,
    pieces: Vec<Piece>,
    /// Standard deviation of a range [m].
    pub noise_m: f64,
    /// Range of the scanner [m].
    reach_m: f64,
    /// Beams beside which there are others.
    inner: Range<usize>,
    /// Motion of the robot during the sweep.
    pub motion: SweepMotion,
    /// What its ranges seem to have too much [m].
    pub longer_m: f64,
}

impl Default for Pieces {
    fn default() -> Self {
        Self {
            returns: Vec::with_capacity(MAX_BEAMS),
            magnitudes: Vec::with_capacity(MAX_BEAMS),
            pieces: Vec::with_capacity(MAX_PIECES),
            noise_m: NOISE_M.0,
            reach_m: f64::INFINITY,
            inner: 0..0,
            motion: SweepMotion::default(),
            longer_m: 0.0,
        }
    }
}

impl Pieces {
    /// The pieces found last.
    pub fn all(&self) -> &[Piece] {
        &self.pieces
    }

    /// How many returns the scan had.
    pub fn returns(&self) -> usize {
        self.returns.len()
    }

    /// Finds the pieces of a scan whose ranges are too long by `offset_m`.
    pub fn find(&mut self, scan: &Scan, vehicle: &Description, motion: &SweepMotion, offset_m: f64) {
        self.reach_m = vehicle.scanner.range_m;
        self.inner = MISSING..scan.ranges().len().saturating_sub(MISSING);
        self.motion = *motion;
        let Self { returns, pieces, .. } = self;
        returns.clear();
        pieces.clear();
        let scanner = Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m);
        for beam in 0..scan.ranges().len() {
            let range_m = scan.range_m(beam).map(|range_m| range_m - offset_m);
            let Some(range_m) = range_m.filter(|range_m| *range_m > 0.0) else { continue };
            let place = scanner + heading(scan.beam_yaw_rad(beam) + vehicle.scanner_yaw_rad) * range_m;
            returns.push(Return { place: motion.at_front(place, scan.beam_time_s(beam)), range_m, beam });
        }
        self.noise_m = self.noise();
        let pitch_rad = scan.increment_rad.abs();
        let is_apart = |pair: &[Return]| {
            let limit_m = APART.0 + APART.1 * pitch_rad * pair[0].range_m.min(pair[1].range_m);
            (pair[1].place - pair[0].place).norm() > limit_m
        };
        let mut first = 0;
        for next in 1..=self.returns.len() {
            if next == self.returns.len() || is_apart(&self.returns[next - 1..=next]) {
                let known = self.pieces.len();
                self.split(first, next, scanner, pitch_rad);
                self.drop_curved(known, first..next);
                if self.pieces.len() == known {
                    self.pieces.extend(self.round(first..next, scanner));
                }
                first = next;
            }
        }
    }

    /// Splits the returns from `first` to before `end` into pieces.
    fn split(&mut self, first: usize, end: usize, scanner: Vector2<f64>, pitch_rad: f64) {
        let cluster = first..end;
        let mut waiting = [(0, 0); 64];
        let mut count = 1;
        waiting[0] = (first, end);
        let limit_m = STRAIGHT.0.max(STRAIGHT.1 * self.noise_m);
        while count > 0 && self.pieces.len() < MAX_PIECES {
            count -= 1;
            let (first, end) = waiting[count];
            if end - first < MIN_COUNT {
                continue;
            }
            let (from, to) = (self.returns[first].place, self.returns[end - 1].place);
            let chord = to - from;
            let normal = Vector2::new(-chord.y, chord.x) / chord.norm().max(1e-9);
            let off = |index: usize| normal.dot(&(self.returns[index].place - from)).abs();
            let (at, most_m) = (first..end).fold((first, 0.0), |(at, most), index| {
                if off(index) > most { (index, off(index)) } else { (at, most) }
            });
            if most_m <= limit_m && self.is_curved(first..end, normal) {
                continue;
            } else if most_m <= limit_m {
                let Some(piece) = fit(&self.returns[first..end], scanner, self.noise_m) else { continue };
                let edges = [(first, first.checked_sub(1), first + 1), (end - 1, Some(end), end - 2)].map(
                    |(at, outer, inner)| match outer {
                        Some(outer) if cluster.contains(&outer) => self
                            .is_corner(outer, outer > at, &cluster, &piece)
                            .then(|| self.returns[at].place),
                        _ => self.edge(
                            at,
                            outer.and_then(|outer| self.returns.get(outer)),
                            inner,
                            &piece,
                            scanner,
                        ),
                    },
                );
                let width_m = pitch_rad * self.returns[first].range_m.max(self.returns[end - 1].range_m);
                let middle = edges[0].zip(edges[1]).map(|(one, other)| (one + other) / 2.0);
                let middle = middle.map(|middle| (middle, EDGE * width_m));
                // Where the view ends, and where it is hardly seen, a surface may continue.
                let is_sure = |at: usize| {
                    let last = &self.returns[at];
                    self.inner.contains(&last.beam) && last.range_m <= HARDLY * self.reach_m
                };
                let edges = [edges[0].filter(|_| is_sure(first)), edges[1].filter(|_| is_sure(end - 1))];
                self.pieces.push(Piece { middle, edges, edge_m: SQRT_2 * EDGE * width_m, ..piece });
            } else if count + 2 <= waiting.len() {
                (waiting[count], waiting[count + 1]) = ((at, end), (first, at + 1));
                count += 2;
            }
        }
    }

    /// Drops what is no piece of a straight surface, among the pieces of one cluster from `known` on: chords of a round one
    /// meet at an angle that corners rarely have, and one chord of a small body leaves much of it.
    fn drop_curved(&mut self, known: usize, cluster: Range<usize>) {
        let size_m = (self.returns[cluster.end - 1].place - self.returns[cluster.start].place).norm();
        if let [only] = &mut self.pieces[known..] {
            // A part of a small body, the rest of which is no piece.
            only.is_chord = size_m < SMALL_M && only.count + REST < cluster.len() as f64;
        }
        for place in known + 1..self.pieces.len() {
            let [before, piece] = [self.pieces[place - 1], self.pieces[place]];
            let cos = before.normal.dot(&piece.normal);
            let is_near = (piece.ends[0] - before.ends[1]).norm() <= CORNER_M;
            let are_long = before.length_m().min(piece.length_m()) >= LONG_M && cos < ROUND.1;
            if is_near && !are_long && (ROUND.0..ROUND.2).contains(&cos) {
                (self.pieces[place - 1].is_chord, self.pieces[place].is_chord) = (true, true);
            }
        }
        let mut place = known;
        while place < self.pieces.len() {
            if self.pieces[place].is_chord {
                self.pieces.remove(place);
            } else {
                place += 1;
            }
        }
    }

    /// A small round body, if the returns of a cluster lie on a circle. Those at its edges may be of something else in part.
    fn round(&self, cluster: Range<usize>, scanner: Vector2<f64>) -> Option<Piece> {
        let inner = self.returns.get(cluster.start + 1..cluster.end - 1)?;
        let size_m = (inner.last()?.place - inner.first()?.place).norm();
        let flat_m = FLAT.0 + FLAT.1 * self.noise_m;
        let places = inner.iter().map(|one| one.place);
        let round = Round::fit(places, scanner, flat_m)
            .filter(|_| size_m < SMALL_M && self.pieces.len() < MAX_PIECES)?;
        let Round { middle, radius_m, count, aside, .. } = round;
        let normal = (scanner - middle).normalize();
        let side = Vector2::new(-normal.y, normal.x) * radius_m;
        let ends = [middle - side, middle + side];
        let middle = (middle, self.noise_m * aside);
        Some(Piece {
            count,
            mean: middle.0,
            normal,
            ends,
            middle: Some(middle),
            edges: [None; 2],
            edge_m: 0.0,
            round: Some(round),
            ..Piece::default()
        })
    }

    /// Whether the middle third of returns lies beside the other two, further than noise explains.
    fn is_curved(&self, range: Range<usize>, normal: Vector2<f64>) -> bool {
        let third = range.len() / 3;
        let mean = |first: usize| {
            let returns = &self.returns[first..first + third];
            returns.iter().map(|one| normal.dot(&one.place)).sum::<f64>() / third as f64
        };
        let (start, end) = (range.start, range.end);
        let outer = f64::midpoint(mean(start), mean(end - third));
        let off_m = (mean(start + (range.len() - third) / 2) - outer).abs();
        off_m > CURVED.0 + CURVED.1 * self.noise_m * (1.5 / third as f64).sqrt()
    }

    /// Whether the returns of a cluster from `outer` on, ahead or back, leave the line of the piece beside them, as they do behind a
    /// corner: noise splits straight surfaces as well.
    fn is_corner(&self, outer: usize, ahead: bool, cluster: &Range<usize>, piece: &Piece) -> bool {
        let size_m = (self.returns[cluster.end - 1].place - self.returns[cluster.start].place).norm();
        if size_m < BODY_M {
            return true;
        }
        let beyond = if ahead {
            outer..cluster.end.min(outer + BEYOND)
        } else {
            cluster.start.max((outer + 1).saturating_sub(BEYOND))..outer + 1
        };
        let count = beyond.len() as f64;
        let off = |one: &Return| piece.normal.dot(&(one.place - piece.mean));
        let off_m = self.returns[beyond].iter().map(off).sum::<f64>() / count;
        off_m.abs() > CORNER_OFF.0.max(CORNER_OFF.1 * self.noise_m)
    }

    /// The edge of a surface that ends with the return `at`, where what is seen next to it is behind it, or nothing is: half a
    /// beam beyond the last return; `inner` is the one before. Where beams that return nothing meet the surface at a grazing
    /// angle, it continues.
    fn edge(
        &self,
        at: usize,
        outer: Option<&Return>,
        inner: usize,
        piece: &Piece,
        scanner: Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let last = &self.returns[at];
        let is_edge = match outer.filter(|outer| outer.beam.abs_diff(last.beam) <= MISSING) {
            Some(outer) => outer.range_m > last.range_m + BEHIND_M,
            None => piece.normal.dot(&(last.place - scanner)).abs() >= GRAZING * last.range_m,
        };
        is_edge.then(|| last.place + (last.place - self.returns[inner].place) / 2.0)
    }

    /// Standard deviation of a range, by the median of the second differences.
    fn noise(&mut self) -> f64 {
        let Self { returns, magnitudes, .. } = self;
        magnitudes.clear();
        magnitudes.extend(
            returns
                .windows(3)
                .map(|three| (three[0].range_m - 2.0 * three[1].range_m + three[2].range_m).abs()),
        );
        if magnitudes.is_empty() {
            return NOISE_M.0;
        }
        let middle = magnitudes.len() / 2;
        let (_, median, _) = magnitudes.select_nth_unstable_by(middle, f64::total_cmp);
        (*median / (MEDIAN * OF_THREE)).clamp(NOISE_M.0, NOISE_M.1)
    }
}

impl SweepMotion {
    /// A place that was seen `time_s` after the front beam, from where the robot was then.
    pub fn at_front(&self, place: Vector2<f64>, time_s: f64) -> Vector2<f64> {
        let turn = self.yaw_rate_radps * time_s;
        let moved = heading(turn / 2.0) * (self.speed_mps * time_s);
        let (sin, cos) = turn.sin_cos();
        Vector2::new(cos * place.x - sin * place.y, sin * place.x + cos * place.y) + moved
    }

    /// A place as it is from where the robot is `time_s` after the front beam.
    pub fn at_time(&self, place: Vector2<f64>, time_s: f64) -> Vector2<f64> {
        let turn = self.yaw_rate_radps * time_s;
        let apart = place - heading(turn / 2.0) * (self.speed_mps * time_s);
        to_robot(turn, apart.x, apart.y)
    }
}

/// The line through returns; `None` where they are too short or scatter too much. The two at the edges may be of
/// something else in part.
fn fit(returns: &[Return], scanner: Vector2<f64>, noise_m: f64) -> Option<Piece> {
    let inner = &returns[1..returns.len() - 1];
    let count = inner.len() as f64;
    let mean = inner.iter().map(|one| one.place).sum::<Vector2<f64>>() / count;
    let scatter = inner.iter().fold(Matrix2::zeros(), |sum, one| {
        let offset = one.place - mean;
        sum + offset * offset.transpose()
    });
    let normal = normal_of(&scatter);
    let across = normal.dot(&(scatter * normal)) / count;
    let ends = [inner[0].place, inner[inner.len() - 1].place];
    let is_line = (ends[1] - ends[0]).norm() >= MIN_LENGTH_M && across.sqrt() <= FLAT.0 + FLAT.1 * noise_m;
    let normal = if normal.dot(&(scanner - mean)) < 0.0 { -normal } else { normal };
    is_line.then_some(Piece {
        count,
        mean,
        scatter,
        normal,
        ends,
        middle: None,
        edges: [None; 2],
        edge_m: 0.0,
        round: None,
        is_chord: false,
    })
}

/// Normal of the line through places of this scatter.
pub(super) fn normal_of(scatter: &Matrix2<f64>) -> Vector2<f64> {
    let axis = 0.5 * (2.0 * scatter[(0, 1)]).atan2(scatter[(0, 0)] - scatter[(1, 1)]);
    heading(axis + std::f64::consts::FRAC_PI_2)
}
