//! Surfaces that stand still, and the memory of those that were seen.
//!
//! A surface begins as a piece of a scan that nothing known explains. It counts when it was seen often enough, for long
//! enough, and always in one place: what moves does not. Its line is fitted through all returns until then and for a
//! while after, and stays: a wall along which the robot drives for a kilometre keeps its direction. The surface that
//! was not seen for longest makes place for a new one, first of all one that never counted.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use shared_types::{Fault, finite, plain_state};

use super::pieces::{Piece, normal_of};
use super::round::Round;

/// How many surfaces are remembered.
pub const SURFACES: usize = 36;
/// A surface counts after so many sightings, over this time [ns].
const CONFIRMED: (u32, u64) = (5, 450_000_000);
/// One that does not count was seen in passing, if not for so long [ns].
const PASSING_NS: u64 = 1_000_000_000;
/// Its line is kept after so many sightings, and that of a long one after so many returns.
const SETTLED: (u32, f64) = (6, 1500.0);

plain_state! {
    /// A straight surface or a small round body on the track.
    pub struct Surface {
        /// How many returns its line is fitted through; 0 for no surface
        pub count: f64,
        /// Their mean [m]
        pub mean_m: [f64; 2],
        /// Sum of their squares about it: xx, xy, yy [m^2]
        pub scatter_m2: [f64; 3],
        /// From where to where it was seen, along it from its mean [m]
        pub extent_m: [f64; 2],
        /// The same of pieces that overlap, up to the last scan that showed it: between others there may be doors [m]
        pub last_m: [f64; 2],
        /// Length of the piece that it was when it was seen first [m]
        pub length_m: f64,
        /// Mean of its middles between its edges [m]
        pub middle_m: [f64; 2],
        /// Its edges, where they were seen first [m]
        pub edges_m: [[f64; 2]; 2],
        /// Its mean at the first sighting [m]
        pub first_m: [f64; 2],
        /// Radius of a round body, whose middle is its mean; 0 for a straight surface [m]
        pub radius_m: f64,
        /// 1 when its normal is the negative of that of its scatter
        pub is_turned: u8,
        /// Which of its edges were seen: 1 for the first, 2 for the last one
        pub edges: u8,
        /// How often both were seen, until its line was kept
        pub middles: u16,
        /// How often it was seen
        pub sightings: u32,
        /// When it was seen first [ns]
        pub since_ns: u64,
        /// When it was seen last [ns]
        pub seen_ns: u64,
        /// Where the robot was when it was seen first [m]
        pub seen_from_m: [f64; 2],
        /// Covariance of its place, as one of (yaw, x, y) of the robot then: its lower triangle, column by column
        pub covariance: [f64; 6],
    }
}

plain_state! {
    /// Surfaces that were seen.
    pub struct SurfaceMap {
        /// Each in a place of its own
        pub surfaces: [Surface; SURFACES],
    }
}

/// A line on the track that a piece of a scan may be a part of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceLine {
    /// Direction that it faces.
    pub normal: Vector2<f64>,
    /// A place on it [m].
    pub middle: Vector2<f64>,
    /// From where to where, along it from there, to the left of where it faces [m].
    pub extent_m: [f64; 2],
    /// The part of that on which nothing is open [m].
    pub closed_m: [f64; 2],
    /// Whether it is a long one: its direction counts, and it continues beyond what was seen of it.
    pub is_long: bool,
    /// Covariance of its place, as one of (yaw, x, y) of a robot that was there.
    pub covariance: Matrix3<f64>,
    /// Where that was [m].
    pub seen_from: Vector2<f64>,
    /// Standard deviation of where it alone is beside that, in one scan as in the next [m].
    pub off_m: f64,
    /// Its middle between its edges, if they were seen [m].
    pub center: Option<Vector2<f64>>,
    /// Radius of a round body, which faces the robot from everywhere; 0 for a straight surface [m].
    pub radius_m: f64,
    /// Which surface of the map it is, if it is one that was seen.
    pub index: Option<usize>,
    /// Whether it counts in a match.
    pub counts: bool,
}

/// A line is carried along to where the surface is seen, when that is further than this from where its place was fitted [m].
const CARRY_M: f64 = 20.0;
/// A surface that stands still is found within this of where it was [m].
const STILL_M: f64 = 0.02;
/// An edge that is further than this from where it was is another, of a door [m].
const OTHER_M: f64 = 0.5;
/// Straight sides of a small body are so near its middle [m].
const BESIDE_M: f64 = 0.1;
/// A middle between edges that stands still is found within so many of its standard deviations.
const SIGMAS: f64 = 3.0;
/// A line of this length is a long one: its direction counts, and it continues beyond what was seen of it [m].
pub(super) const LONG_M: f64 = 1.5;

impl SurfaceLine {
    /// Direction along it, to the left of where it faces.
    pub fn along(&self) -> Vector2<f64> {
        Vector2::new(-self.normal.y, self.normal.x)
    }
}

/// A sighting counts half for the line of a surface when the robot may have turned by this unseen since the first one [rad].
const TURNED_RAD: f64 = 1e-3;

/// What is known when pieces are seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// Where the robot is [m], and the covariance of its pose.
    pub(super) place: Vector2<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// How fast it may turn unseen [rad/s], and drive [m/s].
    pub(super) rate_radps: f64,
    pub(super) rate_mps: f64,
    /// Standard deviation of a range [m].
    pub(super) noise_m: f64,
}

/// A piece as it lies on the track.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub(super) mean: Vector2<f64>,
    pub(super) scatter: Matrix2<f64>,
    pub(super) normal: Vector2<f64>,
    pub(super) ends: [Vector2<f64>; 2],
    pub(super) middle: Option<(Vector2<f64>, f64)>,
    pub(super) edges: [Option<Vector2<f64>>; 2],
    pub(super) edge_m: f64,
    pub(super) round: Option<Round>,
}

impl Placed {
    pub(super) fn new(piece: &Piece, pose: &Vector3<f64>) -> Self {
        let (sin, cos) = pose[0].sin_cos();
        let turn = Matrix2::new(cos, -sin, sin, cos);
        let place = |point: Vector2<f64>| turn * point + Vector2::new(pose[1], pose[2]);
        Self {
            mean: place(piece.mean),
            scatter: turn * piece.scatter * turn.transpose(),
            normal: turn * piece.normal,
            ends: piece.ends.map(place),
            middle: piece.middle.map(|(middle, sigma_m)| (place(middle), sigma_m)),
            edges: piece.edges.map(|edge| edge.map(place)),
            edge_m: piece.edge_m,
            round: piece.round,
        }
    }

    /// A round body where it is if it has this radius.
    pub(super) fn with_radius(self, radius_m: f64) -> Self {
        let Some(Round { radius_m: seen_m, per_radius, .. }) = self.round else { return self };
        let mean = self.mean - self.normal * (per_radius * (radius_m - seen_m));
        Self { mean, middle: self.middle.map(|(_, sigma_m)| (mean, sigma_m)), ..self }
    }

    /// Whether it can be a part of a surface of this radius, 0 for a straight one.
    pub(super) fn is_alike(&self, radius_m: f64) -> bool {
        self.round.is_some() == (radius_m > 0.0)
    }

    /// Whether its direction counts.
    pub(super) fn is_long(&self) -> bool {
        self.length_m() >= LONG_M
    }

    fn length_m(&self) -> f64 {
        (self.ends[1] - self.ends[0]).norm()
    }

    /// Covariance of its line by the noise of its returns, as one of (yaw, x, y) of the robot at `pose` that saw it; that of a
    /// long one when it is kept.
    pub(super) fn uncertainty(&self, count: f64, noise_m: f64, pose: &Vector3<f64>) -> Matrix3<f64> {
        let apart = Vector2::new(pose[1], pose[2]) - self.mean;
        let turned = Vector3::new(1.0, -apart.y, apart.x);
        let moved = Vector3::new(0.0, self.normal.x, self.normal.y);
        let along_m2 = self.scatter.trace().max(f64::MIN_POSITIVE);
        let (by_direction, by_place) =
            (turned * turned.transpose() / along_m2, moved * moved.transpose() / count);
        let noise_m2 = noise_m.powi(2);
        // The direction of a short one is not used.
        match self.is_long() {
            true => (by_direction + by_place) * (noise_m2 * (count / SETTLED.1).min(1.0)),
            false => by_place * noise_m2,
        }
    }
}

/// The lower triangle of a symmetric matrix, column by column.
fn triangle(matrix: &Matrix3<f64>) -> [f64; 6] {
    [(0, 0), (1, 0), (2, 0), (1, 1), (2, 1), (2, 2)].map(|place| matrix[place])
}

impl Surface {
    /// Whether there is one.
    fn is_there(&self) -> bool {
        self.count > 0.0
    }

    fn scatter(&self) -> Matrix2<f64> {
        let [xx, xy, yy] = self.scatter_m2;
        Matrix2::new(xx, xy, xy, yy)
    }

    fn mean(&self) -> Vector2<f64> {
        Vector2::from(self.mean_m)
    }

    /// Where it faces; a round body where it was seen from first.
    fn normal(&self) -> Vector2<f64> {
        if self.radius_m > 0.0 {
            return (Vector2::from(self.seen_from_m) - self.mean()).normalize();
        }
        let normal = normal_of(&self.scatter());
        if self.is_turned == 1 { -normal } else { normal }
    }

    /// Whether it was seen often enough and for long enough.
    fn counts(&self) -> bool {
        self.sightings >= CONFIRMED.0 && self.seen_ns.saturating_sub(self.since_ns) >= CONFIRMED.1
    }

    /// Whether its first piece was long: a line that pieces of a bent wall make longer is no straight one.
    fn is_long(&self) -> bool {
        self.length_m >= LONG_M
    }

    fn is_settled(&self) -> bool {
        let (sightings, count) = SETTLED;
        self.sightings >= sightings && (!self.is_long() || self.count >= count)
    }

    /// Its line for a robot at a place.
    fn line(&self, index: usize, place: Vector2<f64>) -> SurfaceLine {
        let [a, b, c, d, e, f] = self.covariance;
        let is_round = self.radius_m > 0.0;
        SurfaceLine {
            normal: if is_round { (place - self.mean()).normalize() } else { self.normal() },
            middle: self.mean(),
            extent_m: self.extent_m,
            closed_m: self.last_m,
            is_long: self.is_long(),
            covariance: Matrix3::new(a, b, c, b, d, e, c, e, f),
            seen_from: Vector2::from(self.seen_from_m),
            off_m: 0.0,
            // What turned out longer was seen in parts.
            center: (self.middles > 0 && self.extent_m[1] - self.extent_m[0] < LONG_M)
                .then(|| if is_round { self.mean() } else { Vector2::from(self.middle_m) }),
            radius_m: self.radius_m,
            index: Some(index),
            counts: self.counts(),
        }
    }

    fn fit(&mut self, count: f64, placed: &Placed) {
        let sum = self.count + count;
        let apart = placed.mean - self.mean();
        let before = self.normal();
        let scatter =
            self.scatter() + placed.scatter + apart * apart.transpose() * (self.count * count / sum);
        let mean = self.mean() + apart * (count / sum);
        (self.mean_m, self.count) = ([mean.x, mean.y], sum);
        self.scatter_m2 = [scatter[(0, 0)], scatter[(0, 1)], scatter[(1, 1)]];
        self.is_turned = u8::from(normal_of(&scatter).dot(&before) < 0.0);
        let moved_m = Vector2::new(-before.y, before.x).dot(&apart) * (count / sum);
        self.extent_m = self.extent_m.map(|end| end - moved_m);
        self.last_m = self.last_m.map(|end| end - moved_m);
        self.center(placed);
        if let Some(Round { radius_m, per_radius, .. }) = placed.round {
            let more_m = (radius_m - self.radius_m) / f64::from(self.middles);
            self.radius_m += more_m;
            let first = Vector2::from(self.first_m) - placed.normal * (per_radius * more_m);
            self.first_m = [first.x, first.y];
        }
    }

    /// Takes the middle between its edges into the mean.
    fn center(&mut self, placed: &Placed) {
        let Some((middle, _)) = placed.middle else { return };
        self.middles = self.middles.saturating_add(1);
        let mean = Vector2::from(self.middle_m);
        let mean = mean + (middle - mean) / f64::from(self.middles);
        self.middle_m = [mean.x, mean.y];
    }

    /// How far an edge has moved, and notes those that were not seen before [m].
    fn edge_moved_m(&mut self, placed: &Placed) -> f64 {
        let mut most_m = 0.0_f64;
        for (side, (known, edge)) in (1..).zip(self.edges_m.iter_mut().zip(placed.edges)) {
            let Some(edge) = edge else { continue };
            if self.edges & side == 0 {
                self.edges |= side;
                *known = edge.into();
            }
            let moved_m = (edge - Vector2::from(*known)).norm();
            if moved_m < OTHER_M {
                most_m = most_m.max(moved_m);
            }
        }
        most_m
    }

    /// From where to where along it a piece is [m].
    fn ends(&self, placed: &Placed) -> [f64; 2] {
        let normal = self.normal();
        let along = Vector2::new(-normal.y, normal.x);
        let [one, other] = placed.ends.map(|end| along.dot(&(end - self.mean())));
        [one.min(other), one.max(other)]
    }

    /// Notes a piece of a scan; `is_first` if it is the first one of that scan.
    fn spot(&mut self, placed: &Placed, is_first: bool) {
        // What moves past a short one makes it no longer.
        let [low, high] = self.extent_m;
        let ([first, last], [from, to]) = (self.ends(placed).map(|end| end.clamp(low, high)), self.last_m);
        if first == last {
            return;
        }
        if first <= to && last >= from {
            self.last_m = [first.min(from), last.max(to)];
        } else if is_first || last - first > to - from {
            self.last_m = [first, last];
        }
    }

    /// Moves the line to the piece where that is far away, in its direction: what this is off would make the place wrong there.
    /// Its place is known as that of the robot is now.
    fn carry(&mut self, placed: &Placed, sight: &Sight) {
        let normal = self.normal();
        let along_m = Vector2::new(-normal.y, normal.x).dot(&(placed.mean - self.mean()));
        if along_m.abs() < CARRY_M {
            return;
        }
        self.mean_m = [placed.mean.x, placed.mean.y];
        self.extent_m = self.extent_m.map(|end| end - along_m);
        self.last_m = self.last_m.map(|end| end - along_m);
        (self.covariance, self.seen_from_m) = (triangle(&sight.covariance), sight.place.into());
    }

    fn extend(&mut self, placed: &Placed) {
        for at in self.ends(placed) {
            self.extent_m = [self.extent_m[0].min(at), self.extent_m[1].max(at)];
        }
    }
}

impl SurfaceMap {
    /// The lines of the surfaces.
    pub(super) fn lines(&self, place: Vector2<f64>) -> impl Iterator<Item = SurfaceLine> {
        let there = self.surfaces.iter().enumerate().filter(|(_, surface)| surface.is_there());
        there.map(move |(index, surface)| surface.line(index, place))
    }

    /// A piece of a surface was seen again; one that does not count yet is forgotten when it is further than `tolerance_m` from
    /// where it was.
    pub(super) fn see(&mut self, index: usize, count: f64, placed: &Placed, now_ns: u64, sight: &Sight) {
        let surface = &mut self.surfaces[index];
        let since_s = now_ns.saturating_sub(surface.since_ns) as f64 * 1e-9;
        let turned_rad = sight.rate_radps * since_s;
        let unseen_m = (turned_rad * (placed.mean - sight.place).norm()).hypot(sight.rate_mps * since_s);
        let weight = 1.0 / (1.0 + (turned_rad / TURNED_RAD).powi(2));
        let seen = placed.with_radius(surface.radius_m);
        let moved_m = surface.normal().dot(&(seen.mean - Vector2::from(surface.first_m))).abs();
        let center = Vector2::from(surface.middle_m);
        let along_m = seen.middle.filter(|_| surface.middles > 0).map_or(0.0, |(middle, sigma_m)| {
            ((middle - center).norm() - SIGMAS * sigma_m.hypot(unseen_m)).max(0.0)
        });
        // Two edges are compared, and a corner may be a beam further than it seems.
        let edge_m = surface.edge_moved_m(placed) - 2.0 * SIGMAS * placed.edge_m.hypot(unseen_m);
        let along_m = along_m.max(edge_m);
        let tolerance_m = STILL_M.max(SIGMAS * (sight.noise_m / count.sqrt()).hypot(unseen_m));
        if !surface.counts() && (moved_m > tolerance_m || along_m > STILL_M) {
            *surface = Surface::default();
            return;
        }
        if !surface.is_settled() {
            surface.fit(count * weight, &Placed { scatter: placed.scatter * weight, ..*placed });
        }
        if !surface.is_settled() || surface.is_long() {
            surface.extend(placed);
        }
        surface.spot(placed, surface.seen_ns < now_ns);
        if surface.is_settled() && surface.is_long() && placed.is_long() {
            surface.carry(placed, sight);
        }
        surface.sightings = surface.sightings.saturating_add(1);
        surface.seen_ns = now_ns;
    }

    /// Whether a piece looks round where a straight surface is known; a round body that looks straight now is forgotten.
    fn contradicts(&mut self, placed: &Placed) -> bool {
        let is_round = placed.round.is_some();
        let others = self.surfaces.iter_mut().filter(|other| {
            let near_m = other.radius_m + placed.round.map_or(0.0, |round| round.radius_m) + BESIDE_M;
            let is_other = (other.radius_m > 0.0) != is_round && !other.is_long();
            other.is_there() && is_other && (other.mean() - placed.mean).norm() <= near_m
        });
        if is_round {
            return others.count() > 0;
        }
        others.for_each(|round| *round = Surface::default());
        false
    }

    /// Remembers a piece as a new surface; `covariance` is that of its place.
    pub(super) fn add(
        &mut self,
        piece: &Piece,
        placed: &Placed,
        pose: &Vector3<f64>,
        covariance: &Matrix3<f64>,
        now_ns: u64,
    ) {
        let oldest = (0..SURFACES).min_by_key(|index| {
            let surface = &self.surfaces[*index];
            let is_passing = !surface.counts() && surface.seen_ns + PASSING_NS < now_ns;
            (surface.is_there(), !is_passing, surface.seen_ns)
        });
        let Some(index) = oldest else { return };
        if self.contradicts(placed) {
            return;
        }
        let scatter = placed.scatter;
        let mut surface = Surface {
            count: piece.count,
            mean_m: [placed.mean.x, placed.mean.y],
            scatter_m2: [scatter[(0, 0)], scatter[(0, 1)], scatter[(1, 1)]],
            length_m: placed.length_m(),
            first_m: [placed.mean.x, placed.mean.y],
            is_turned: u8::from(normal_of(&scatter).dot(&placed.normal) < 0.0),
            radius_m: placed.round.map_or(0.0, |round| round.radius_m),
            sightings: 1,
            since_ns: now_ns,
            seen_ns: now_ns,
            seen_from_m: [pose[1], pose[2]],
            covariance: triangle(covariance),
            ..Surface::default()
        };
        surface.extend(placed);
        surface.last_m = surface.extent_m;
        surface.center(placed);
        surface.edge_moved_m(placed);
        self.surfaces[index] = surface;
    }

    /// Passes when all numbers are finite.
    ///
    /// # Errors
    /// [`Fault`] of the first surface with another.
    pub fn check(&self) -> Result<(), Fault> {
        for surface in &self.surfaces {
            let Surface {
                count,
                mean_m,
                scatter_m2,
                extent_m,
                last_m,
                first_m,
                middle_m,
                edges_m: [one_m, other_m],
                seen_from_m,
                covariance,
                radius_m,
                ..
            } = surface;
            finite("map", &[*count, *radius_m])?;
            let places = [mean_m, extent_m, last_m, first_m, middle_m, one_m, other_m, seen_from_m];
            let mut numbers = places.map(|place| &place[..]).into_iter().chain([&scatter_m2[..], covariance]);
            numbers.try_for_each(|numbers| finite("map", numbers))?;
        }
        Ok(())
    }
}
