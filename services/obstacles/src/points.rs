//! Returns of a sweep as points of the track.
//!
//! The beams are taken one after the other while the robot moves, so each is placed from the pose at its own time: the
//! pose at the front beam, predicted with constant speed, sideslip and yaw rate. Over half a sweep (33 ms) this is
//! accurate to a millimetre. Error codes are no returns. All beams are placed: the window of the source decides
//! only which points may start an obstacle, the rest keeps track of bodies beside the robot.
//!
//! (7.32) and (7.33) have the scanner at the robot's reference point; here it may be anywhere on the body.

use std::f64::consts::FRAC_PI_3;

use nalgebra::Vector2;
use shared_types::{BEAMS, PITCH_RAD, Pose, SECTORS, Scan, ScanGeometry};
use vehicle::frame::{heading, to_track};
use vehicle::{Description, ScannerDescription};

/// Range of the URG-04LX [m]: distances that follow from the range are stated for it.
const URG_RANGE_M: f64 = 5.6;
/// Longest reading of it that is a return [m]: noise may add to the range.
const MAX_RANGE_M: f64 = 5.75;
/// What is farther than this is not needed, and does not fit where scans are kept [m].
const FARTHEST_M: f64 = 60.0;

/// A return, in track coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// Where it is [m].
    pub(crate) at: Vector2<f64>,
    /// Measured range [m].
    pub(crate) range: f64,
    /// Index of the beam.
    pub(crate) beam: usize,
}

/// A usable pose of the scanner with the velocities that placing needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Position of the scanner at the front beam [m].
    pub(crate) at: Vector2<f64>,
    /// Direction of the front beam [rad].
    pub(crate) yaw: f64,
    /// Velocity over ground at the front beam [m/s].
    velocity: Vector2<f64>,
    /// Yaw rate [rad/s].
    yaw_rate: f64,
}

impl Place {
    /// The pose, `None` when it is not finite or far out of bounds.
    ///
    /// Speeds above 5 m/s and yaw rates above 3 rad/s are impossible for this robot and replaced by zero.
    pub(crate) fn of(pose: &Pose, vehicle: &Description) -> Option<Self> {
        let Pose { x_m, y_m, yaw_rad, speed_mps, sideslip_rad, yaw_rate_radps, .. } = *pose;
        let usable = x_m.abs() < 1e6 && y_m.abs() < 1e6 && yaw_rad.abs() < 1e3;
        if !usable {
            return None;
        }
        let speed = if speed_mps.abs() <= 5.0 { speed_mps } else { 0.0 };
        let yaw_rate = if yaw_rate_radps.abs() <= 3.0 { yaw_rate_radps } else { 0.0 };
        let sideslip = if sideslip_rad.abs() <= 1.6 { sideslip_rad } else { 0.0 };
        let (sin, cos) = (yaw_rad + sideslip).sin_cos();
        let offset = to_track(yaw_rad, vehicle.scanner_x_m, vehicle.scanner_y_m);
        // The scanner moves with the centre of the robot and around it.
        let velocity = Vector2::new(speed * cos - yaw_rate * offset.y, speed * sin + yaw_rate * offset.x);
        let at = Vector2::new(x_m, y_m) + offset;
        Some(Self { at, yaw: yaw_rad + vehicle.scanner_yaw_rad, velocity, yaw_rate })
    }

    /// Where the scanner is, and how far it has turned, `time` seconds after the front beam [m, rad].
    pub(crate) fn moved_by(&self, time: f64) -> (Vector2<f64>, f64) {
        (self.at + self.velocity * time, self.yaw_rate * time)
    }

    /// Speed of the scanner over ground [m/s].
    pub(crate) fn speed(&self) -> f64 {
        self.velocity.norm()
    }

    /// The place as plain numbers, see [`Self::from_array`].
    pub(crate) fn to_array(self) -> [f64; 6] {
        [self.at.x, self.at.y, self.yaw, self.velocity.x, self.velocity.y, self.yaw_rate]
    }

    /// The place of plain numbers.
    pub(crate) fn from_array([x, y, yaw, vx, vy, yaw_rate]: [f64; 6]) -> Self {
        Self { at: Vector2::new(x, y), yaw, velocity: Vector2::new(vx, vy), yaw_rate }
    }

    /// A robot that stands still.
    #[cfg(test)]
    pub(crate) fn standing(at: Vector2<f64>, yaw: f64) -> Self {
        Self { at, yaw, velocity: Vector2::zeros(), yaw_rate: 0.0 }
    }
}

/// The beams of the scanner: their directions in its frame, and how far they reach.
#[derive(Debug, Clone)]
pub(crate) struct Beams {
    /// Where they look.
    pub(crate) geometry: ScanGeometry,
    /// Index of the beam that looks straight ahead, which may be between two.
    pub(crate) front: f64,
    /// How many of them make a sector of evidence.
    pub(crate) sector: usize,
    /// By how much the range is longer than that of the URG-04LX [m].
    longer_m: f64,
    /// Smallest and largest reading that is a return [mm].
    readings_mm: [u32; 2],
    units: Vec<Vector2<f64>>,
}

impl Beams {
    /// Every `stride`th beam of a scanner.
    pub(crate) fn new(scanner: &ScannerDescription, stride: usize) -> Self {
        let ScanGeometry { count, first_rad, increment_rad } = scanner.geometry();
        let geometry = ScanGeometry {
            count: count.div_ceil(stride),
            first_rad,
            increment_rad: increment_rad * stride as f64,
        };
        let longer_m = scanner.range_m.min(FARTHEST_M) - URG_RANGE_M;
        Self {
            front: geometry.front(),
            sector: geometry.count.div_ceil(SECTORS),
            longer_m,
            readings_mm: [scanner.min_range_m, MAX_RANGE_M + longer_m]
                .map(|range| (range * 1e3).round() as u32),
            units: (0..geometry.count).map(|beam| heading(geometry.yaw_rad(beam))).collect(),
            geometry,
        }
    }

    /// All beams of the URG-04LX.
    #[cfg(test)]
    pub(crate) fn urg() -> Self {
        Self::new(&ScannerDescription::default(), 1)
    }

    /// How many there are.
    #[inline]
    pub(crate) fn count(&self) -> usize {
        self.units.len()
    }

    /// Angle from one to the next [rad].
    #[inline]
    pub(crate) fn pitch(&self) -> f64 {
        self.geometry.increment_rad
    }

    /// How much coarser than those of the URG-04LX they are.
    pub(crate) fn coarseness(&self) -> f64 {
        self.pitch() / PITCH_RAD
    }

    /// For how many beams of the URG-04LX each counts.
    pub(crate) fn weight(&self) -> f64 {
        BEAMS as f64 / self.count() as f64
    }

    /// What a distance near the end of the range is, stated for the URG-04LX [m].
    #[inline]
    pub(crate) fn reach(&self, of_urg_m: f64) -> f64 {
        of_urg_m + self.longer_m
    }

    /// Range of a beam [m]; a reading beyond the device's reach is no return.
    #[inline]
    pub(crate) fn range_of(&self, scan: &Scan, beam: usize) -> Option<f64> {
        let [low, high] = self.readings_mm;
        let reading = scan.ranges_mm[beam];
        (low <= reading && reading <= high).then(|| f64::from(reading) * 1e-3)
    }

    /// The first and the last beam within 60 degrees to each side of straight ahead, of a scanner that is turned by
    /// `yaw_rad`: the beams 170 to 511 of the source.
    pub(crate) fn ahead(&self, yaw_rad: f64) -> [usize; 2] {
        let turned = (yaw_rad / self.pitch()).round();
        let half = FRAC_PI_3 / self.pitch();
        [self.front - half, self.front + half]
            .map(|edge| (edge.ceil() - turned).clamp(0.0, (self.count() - 1) as f64) as usize)
    }

    /// Direction of one beam in the robot's frame; `beam` is below [`Self::count`].
    #[inline]
    pub(crate) fn unit(&self, beam: usize) -> Vector2<f64> {
        self.units[beam]
    }

    /// Places all returns of `scan` into `points`, in the order of the beams.
    pub(crate) fn place(&self, scan: &Scan, place: &Place, points: &mut Vec<Point>) {
        points.clear();
        let (sin, cos) = place.yaw.sin_cos();
        for (beam, unit) in self.units.iter().enumerate() {
            let Some(range) = self.range_of(scan, beam) else { continue };
            let time = scan.beam_time_s(beam).clamp(-0.2, 0.2);
            let turned = place.yaw_rate * time;
            // Series of cosine and sine: the turn within a sweep is below 0.1 rad, where their error is 1e-6.
            let (turn_sin, turn_cos) = (turned - turned * turned * turned / 6.0, 1.0 - turned * turned / 2.0);
            let forward = unit.x * turn_cos - unit.y * turn_sin;
            let left = unit.y * turn_cos + unit.x * turn_sin;
            let direction = Vector2::new(forward * cos - left * sin, left * cos + forward * sin);
            // The course turns with the yaw; its mean over the time is that of half the turn.
            let course = place.velocity + Vector2::new(-place.velocity.y, place.velocity.x) * (turned / 2.0);
            points.push(Point { at: place.at + course * time + direction * range, range, beam });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_of_a_moving_robot_are_placed_from_where_it_was() {
        let mut scan =
            Scan { sweep_ns: 66_666_667, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        scan.ranges_mm[0] = 2000;
        scan.ranges_mm[340] = 2000;
        scan.ranges_mm[5] = 19;
        let place = Place::of(&Pose { speed_mps: 1.0, ..Pose::default() }, &Description::default()).unwrap();
        let mut points = Vec::new();
        Beams::urg().place(&scan, &place, &mut points);
        assert_eq!(points.len(), 2, "an error code is no return");
        assert_eq!(points[1].at, Vector2::new(2.0, 0.0));
        // Beam 0 was taken 340 / 682 of 66.7 ms earlier: the robot stood 33.2 mm farther back.
        let angle = -340.0 * std::f64::consts::TAU / 1024.0;
        assert!((points[0].at - Vector2::new(2.0 * angle.cos() - 0.03324, 2.0 * angle.sin())).norm() < 1e-5);
    }

    #[test]
    fn what_is_ahead_is_within_60_degrees_whatever_the_beams() {
        assert_eq!(Beams::urg().ahead(0.0), [170, 511]);
        let scanner = |beams, increment_rad| ScannerDescription {
            beams,
            increment_rad,
            ..ScannerDescription::default()
        };
        let fine = Beams::new(&scanner(1081, std::f64::consts::TAU / 1440.0), 2);
        assert_eq!((fine.count(), fine.sector), (541, 9));
        let [first, last] = fine.ahead(0.0).map(|beam| fine.geometry.yaw_rad(beam).to_degrees());
        assert!((-60.0..-59.4).contains(&first) && (59.9..60.6).contains(&last), "{first} {last}");
    }

    #[test]
    fn an_impossible_pose_is_refused() {
        assert_eq!(Place::of(&Pose { x_m: f64::NAN, ..Pose::default() }, &Description::default()), None);
        assert_eq!(
            Place::of(&Pose { yaw_rad: f64::INFINITY, ..Pose::default() }, &Description::default()),
            None
        );
        assert!(
            Place::of(&Pose { speed_mps: f64::NAN, ..Pose::default() }, &Description::default()).is_some()
        );
    }

    #[test]
    fn returns_are_placed_from_where_the_scanner_is_mounted() {
        let mut scan =
            Scan { sweep_ns: 66_666_667, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        scan.ranges_mm[340] = 2000;
        let vehicle = Description {
            scanner_x_m: 0.2,
            scanner_y_m: 0.1,
            scanner_yaw_rad: std::f64::consts::FRAC_PI_2,
            ..Description::default()
        };
        let pose = Pose { x_m: 1.0, yaw_rad: std::f64::consts::FRAC_PI_2, ..Pose::default() };
        let mut points = Vec::new();
        Beams::urg().place(&scan, &Place::of(&pose, &vehicle).unwrap(), &mut points);
        // The robot faces left, so 0.2 m ahead is +y and 0.1 m left is -x; the front beam points backwards along x.
        assert!((points[0].at - Vector2::new(1.0 - 0.1 - 2.0, 0.2)).norm() < 1e-12, "{:?}", points[0].at);
    }
}
