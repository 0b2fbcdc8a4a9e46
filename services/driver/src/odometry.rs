//! From what a base reports to the odometry of scans on the track.

use shared_types::Odometry;

use crate::motion::{Anchor, Motion, Ordered, wrapped};

/// The odometry of a robot: the first pose that it reports is its start on the track.
#[derive(Debug, Clone)]
pub struct TrackedOdometry {
    start: [f64; 3],
    anchor: Option<Anchor>,
    /// The motion of the last scan, as the base reported it.
    reported: Motion,
    last: Option<Odometry>,
}

impl TrackedOdometry {
    /// Nothing was reported yet; the robot stands at this pose of the track.
    pub fn new(start: [f64; 3]) -> Self {
        Self { start, anchor: None, reported: Motion::default(), last: None }
    }

    /// The sample of the next scan, at which the base reports `motion`; and from where to where the pose has jumped, if the robot
    /// can't have driven there with what it was told since the last one: then it is taken to be where it was.
    pub fn next(&mut self, motion: &Motion, ordered: Ordered) -> (Odometry, Option<[[f64; 3]; 2]>) {
        let last = self.last;
        let place = last.map_or(self.start, |last| [last.x_m, last.y_m, last.yaw_rad]);
        let has_jumped = last.is_some() && !self.reported.reaches(motion, ordered);
        let jump = has_jumped.then_some([self.reported.pose, motion.pose]);
        if has_jumped {
            self.anchor = None;
        }
        self.reported = *motion;
        let anchor = *self.anchor.get_or_insert_with(|| Anchor::new(motion.pose, place));
        let [x_m, y_m, yaw_rad] = anchor.on_track(motion.pose);
        let mut odometry = Odometry { x_m, y_m, yaw_rad, speed_mps: motion.speed_mps, ..Odometry::default() };
        odometry.header.acquired_ns = motion.time_ns;
        odometry.header.scan_id = last.map_or(1, |last| last.header.scan_id + 1);
        if let Some(last) = last {
            (odometry.dx_m, odometry.dy_m) = (x_m - last.x_m, y_m - last.y_m);
            odometry.dyaw_rad = wrapped(yaw_rad - last.yaw_rad);
            odometry.dt_s = motion.time_ns.saturating_sub(last.header.acquired_ns) as f64 * 1e-9;
        }
        self.last = Some(odometry);
        (odometry, jump)
    }
}
