//! A key scan: of a robot whose wheels slip so much that no surface seems to stand still, the next scans are laid onto one
//! that was taken shortly before, whatever the shape of what it showed.
//!
//! What is known of the pose then becomes where the surroundings are, and the pose against them begins anew: errors add up
//! from key scan to key scan, and the covariance with them.

use nalgebra::{Matrix3, Vector3};
use shared_types::{Fault, Scan, ScanGeometry, finite, plain_state};
use vehicle::Description;
use vehicle::frame::{to_robot, wrap_angle};

use super::outline::Outline;
use super::pieces::SweepMotion;
use crate::dead_reckoning::{DeadReckoning, DriftSources, Sighting};

/// Most ranges of a key scan: of more beams every second one is kept, or fewer.
const RANGES: usize = 344;
/// A robot whose wheels slip by more in a metre [m], or whose gyro turns by more in a second [rad], sees no surface stand still.
const POOR: (f64, f64) = (0.03, 0.015);
/// Another scan is taken as key after this way or turn [m, rad].
const NEXT: (f64, f64) = (0.15, 0.15);
/// ... or where a smaller share of the returns is on its surfaces.
const OVERLAP: f64 = 0.7;
/// Standard deviations of what is wrong with all returns alike [rad, m, m].
const ALIKE: [f64; 3] = [2e-3, 3e-3, 3e-3];

plain_state! {
    /// A scan that later ones are laid onto.
    pub struct KeyScan {
        /// When it was taken; 0 for none [ns]
        pub acquired_ns: u64,
        /// From where: yaw, x and y [rad, m, m]
        pub pose: [f64; 3],
        /// Motion of the robot: speed and yaw rate [m/s, rad/s]
        pub motion: [f64; 2],
        /// How many beams the scan had
        pub beams: u64,
        /// Range of the beams that are kept; 0 for no return [mm]
        pub ranges_mm: [u16; RANGES],
    }
}

/// Whether the odometer is so poor that key scans are needed.
pub fn is_poor(odometer: &DriftSources) -> bool {
    odometer.slip_m > POOR.0 || odometer.yaw_rad > POOR.1
}

impl KeyScan {
    /// Passes when scans can be laid onto it.
    ///
    /// # Errors
    /// [`Fault`] of a number that is not finite.
    pub fn check(&self) -> Result<(), Fault> {
        finite("key", &self.pose)?;
        finite("key", &self.motion)
    }

    /// A scan of this motion, taken from this pose, whose ranges are too long by `offset_m`.
    pub(super) fn of(scan: &Scan, motion: &SweepMotion, pose: [f64; 3], offset_m: f64) -> Self {
        let beams = scan.ranges().len();
        let mut key = Self {
            acquired_ns: scan.header.acquired_ns,
            pose,
            motion: [motion.speed_mps, motion.yaw_rate_radps],
            beams: beams as u64,
            ..Self::default()
        };
        for (kept, beam) in key.ranges_mm.iter_mut().zip((0..beams).step_by(every(beams))) {
            let range_m = scan.range_m(beam).map_or(0.0, |range_m| range_m - offset_m);
            *kept = (1e3 * range_m).round() as u16;
        }
        key
    }

    /// Whether there is one, with the beams of this scan.
    fn is_of(&self, scan: &Scan) -> bool {
        self.acquired_ns > 0 && self.beams == scan.ranges().len() as u64
    }

    /// Shows an outline what it saw; `like` is a scan with the same beams.
    fn outline(&self, like: &Scan, vehicle: &Description, outline: &mut Outline) {
        let every = every(like.ranges().len());
        let ScanGeometry { count, first_rad, increment_rad } = like.geometry();
        let geometry = ScanGeometry {
            count: count.div_ceil(every),
            first_rad,
            increment_rad: increment_rad * every as f64,
        };
        let [speed_mps, yaw_rate_radps] = self.motion;
        let motion = SweepMotion { speed_mps, yaw_rate_radps };
        let range_m = |kept: usize| {
            let range = self.ranges_mm[kept];
            (range > 0).then(|| f64::from(range) * 1e-3)
        };
        let at_front = |kept: usize, place| motion.at_front(place, like.beam_time_s(kept * every));
        outline.show(geometry, 1, vehicle, range_m, at_front);
    }

    /// Whether the next scan needs another one from this pose, from which it shares so much with the scan.
    pub(super) fn is_passed(&self, pose: &[f64; 3], shared: Option<f64>) -> bool {
        let [turned, ahead_m, left_m] = self.seen_from(*pose).into();
        let is_far = ahead_m.hypot(left_m) > NEXT.0 || turned.abs() > NEXT.1;
        is_far || shared.is_none_or(|shared| shared < OVERLAP)
    }

    /// The pose of dead reckoning in the frame of this scan's robot: yaw, ahead and to the left.
    fn seen_from(&self, [yaw, x, y]: [f64; 3]) -> Vector3<f64> {
        let [key_yaw, key_x, key_y] = self.pose;
        let way = to_robot(key_yaw, x - key_x, y - key_y);
        Vector3::new(wrap_angle(yaw - key_yaw), way.x, way.y)
    }
}

/// One beam of so many is kept of a scan with `beams`.
fn every(beams: usize) -> usize {
    beams.div_ceil(RANGES).max(1)
}

/// Key scans: the outlines of the newest one and of the scan that is laid onto it, in memory that is kept, but no state.
#[derive(Debug, Clone, Default)]
pub(super) struct KeyScans {
    of_key: Outline,
    key_ns: u64,
    seen: Outline,
}

impl KeyScans {
    /// Lays a scan of this motion, whose ranges are too long by so much [m], onto the key and corrects the pose; which share of it
    /// is on the surfaces of the key.
    pub(super) fn lay(
        &mut self,
        (scan, motion, offset_m): (&Scan, &SweepMotion, f64),
        key: &KeyScan,
        vehicle: &Description,
        reckoning: &mut DeadReckoning,
    ) -> Option<f64> {
        if !key.is_of(scan) {
            return None;
        }
        if self.key_ns != key.acquired_ns {
            key.outline(scan, vehicle, &mut self.of_key);
            self.key_ns = key.acquired_ns;
        }
        let range_m = |beam: usize| {
            scan.range_m(beam).map(|range_m| range_m - offset_m).filter(|range_m| *range_m > 0.0)
        };
        let at_front = |beam: usize, place| motion.at_front(place, scan.beam_time_s(beam));
        self.seen.show(scan.geometry(), every(scan.ranges().len()), vehicle, range_m, at_front);
        let (sin, cos) = key.pose[0].sin_cos();
        let turn = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos);
        let covariance = turn.transpose() * reckoning.against_surfaces() * turn;
        let guess = key.seen_from(reckoning.pose);
        let laid = self.of_key.locate(&self.seen, &guess, &covariance)?;
        let alike = Matrix3::from_diagonal(&Vector3::from(ALIKE).map(|sigma| sigma * sigma));
        let shared = (Matrix3::identity() + laid.information * alike).try_inverse()?;
        let information = turn * (shared * laid.information) * turn.transpose();
        let sighting = Sighting {
            information,
            pull: turn * (shared * laid.pull),
            noise: information,
            map: reckoning.map(),
            beside: Matrix3::zeros(),
        };
        let [on_it, all] = laid.count;
        reckoning.correct(&sighting).then(|| on_it as f64 / all as f64)
    }
}
