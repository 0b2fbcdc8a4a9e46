//! The drive of a robot that publishes no truth, by its estimated poses.

use shared_types::{Header, Pose};
use vehicle::{Course, State};

use crate::picture::Moment;
use crate::report::DriveReport;

/// What is known of the drive so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Estimated {
    /// When the run started [ns].
    start_ns: Option<u64>,
    newest_ns: u64,
    course: Course,
    /// Where the robot is along the course [m].
    along_m: Option<f64>,
    first_across_m: f64,
    path_length_m: f64,
    max_abs_lateral_m: f64,
    newest: Option<Moment>,
}

impl Estimated {
    /// Nothing is known yet of a drive along `course`.
    pub(super) fn on(course: Course) -> Self {
        Self { course, ..Self::default() }
    }

    /// A scan was published. Scans are numbered from the start of the run, and the first one takes a period, so an adopted
    /// run keeps its time.
    pub(super) fn scan(&mut self, header: &Header, period_ns: u64) {
        let before_ns = header.scan_id.saturating_mul(period_ns);
        self.start_ns.get_or_insert_with(|| header.acquired_ns.saturating_sub(before_ns));
        self.newest_ns = self.newest_ns.max(header.acquired_ns);
    }

    /// Time since the start of the run at the newest scan [s].
    pub(super) fn time_s(&self) -> f64 {
        self.time_of_s(self.newest_ns)
    }

    /// The state at the scan of a pose.
    pub(super) fn pose(&mut self, pose: &Pose, steering_rad: f64) -> Moment {
        let moment = Moment {
            time_s: self.time_of_s(pose.header.acquired_ns),
            x_m: pose.x_m,
            y_m: pose.y_m,
            yaw_rad: pose.yaw_rad,
            speed_mps: pose.speed_mps,
            steering_rad,
        };
        let across_m = self.across_m(pose);
        match self.newest {
            None => self.first_across_m = across_m,
            // The speed has less noise than the difference of two positions.
            Some(before) => {
                let seconds = (moment.time_s - before.time_s).max(0.0);
                self.path_length_m += seconds * f64::midpoint(before.speed_mps, moment.speed_mps).abs();
            }
        }
        self.max_abs_lateral_m = self.max_abs_lateral_m.max((across_m - self.first_across_m).abs());
        self.newest = Some(moment);
        moment
    }

    /// The report of the drive with the estimated figures, without those that only the truth knows.
    pub(super) fn report(&self, report: DriveReport) -> DriveReport {
        DriveReport {
            final_speed_mps: self.newest.map_or(0.0, |moment| moment.speed_mps),
            path_length_m: self.path_length_m,
            max_abs_lateral_m: self.max_abs_lateral_m,
            truth: None,
            ..report
        }
    }

    /// How far the pose is to the left of the course; on the line its y [m].
    fn across_m(&mut self, pose: &Pose) -> f64 {
        let state = State { x: pose.x_m, y: pose.y_m, yaw: pose.yaw_rad, ..State::default() };
        let near_m = self.along_m.unwrap_or_else(|| self.course.find(&state));
        let place = self.course.on_course(&state, near_m);
        self.along_m = Some(place.x);
        place.y
    }

    fn time_of_s(&self, acquired_ns: u64) -> f64 {
        acquired_ns.saturating_sub(self.start_ns.unwrap_or(acquired_ns)) as f64 * 1e-9
    }
}
