//! Drives whose samples a candidate receives: the pipeline makes them in this process, so they are consistent. They take
//! place in a hall, so that a healthy scanner has returns everywhere.

use std::f64::consts::FRAC_PI_2;

use emulator::scenario::{ScenarioObstacle, Shape};
use emulator::steering_map::SteeringMap;
use emulator::{Emulator, Referee, Scenario};
use pipeline::{Pipeline, PipelineSettings, Step};
use serde::Deserialize;
use shared_types::{Odometry, Role, Scan, Topic, Truth};
use vehicle::correction::Calibration;
use vehicle::course::{CourseKeys, Waypoint};

use super::message::Message;
use super::vehicle::SuiteVehicle;

/// Scans that are recorded after a drive has ended, while the robot rests.
const AFTER_THE_END: usize = 12;
/// The waypoints of the bend: a quarter of a circle of 4.5 m between two lines [m, m, rad].
const BEND: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [8.5, 4.5, FRAC_PI_2], [8.5, 9.0, FRAC_PI_2]];
/// No drive of a suite takes longer.
const MAX_SCANS: usize = 4_000;

/// What is driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Course {
    /// The default: one box in the way, default noise, default robot.
    Corridor,
    /// The same without noise, with a robot that needs no correction, and no correction.
    Exact,
    /// The same with an odometry scale error of a tenth, which the settings contain.
    Drifting,
    /// Nothing in the way.
    Free,
    /// A barrier across the track: the drive ends in front of it.
    Barrier,
    /// Nothing in the way, which bends to the left after 4 m.
    Bend,
    /// Two boxes, one behind the other, left and right of the line.
    Two,
}

impl Course {
    /// Scenario and settings, at a scan period [ns].
    ///
    /// # Errors
    /// Waypoints that make no course: a mistake in them.
    pub(crate) fn settings(self, period_ns: u64, vehicle: &SuiteVehicle) -> anyhow::Result<PipelineSettings> {
        let mut scenario = Scenario { name: "conformance".to_owned(), ..Scenario::default() };
        let solid = |x_m, y_m, length_m, width_m| {
            ScenarioObstacle::fixed(Shape::Box { length_m, width_m, yaw_rad: 0.0 }, x_m, y_m)
        };
        scenario.obstacles = match self {
            Self::Corridor | Self::Exact | Self::Drifting => vec![solid(5.0, 0.0, 0.1, 0.4)],
            Self::Free | Self::Bend => vec![],
            Self::Barrier => vec![solid(4.0, 0.0, 0.1, 3.6)],
            Self::Two => vec![solid(4.5, 0.9, 0.1, 0.4), solid(6.0, -0.9, 0.1, 0.4)],
        };
        if self == Self::Bend {
            let waypoints = BEND.map(|[x_m, y_m, yaw_rad]| Waypoint::new(x_m, y_m, Some(yaw_rad))).to_vec();
            let bend = vehicle::Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() });
            scenario = scenario.along(bend?)?;
        }
        let missed = if self == Self::Drifting { 0.1 } else { 0.0 };
        let is_exact = matches!(self, Self::Exact | Self::Drifting);
        if is_exact {
            scenario.noise.range_m = 0.0;
            scenario.robot.velocity_factor = Some(1.0);
            scenario.robot.steering_map = Some(SteeringMap::Identity);
            scenario.robot.odometry_longitudinal = Some(missed);
        }
        let mut settings = vehicle.settings(&scenario)?;
        if is_exact {
            settings.tuning.actuator.calibration = Calibration::Identity;
            settings.tuning.estimator.odometry_longitudinal = Some(missed);
        }
        settings.tuning.controller.period_s = period_ns as f64 * 1e-9;
        Ok(PipelineSettings { period_ns, ..settings })
    }
}

/// A recorded drive.
pub(crate) struct Drive {
    /// Scenario and settings that it was made with.
    pub(crate) settings: PipelineSettings,
    /// Scan 1 first.
    pub(crate) steps: Vec<Step>,
    /// How many scans belong to the drive; the robot rests after them.
    pub(crate) ended: usize,
    /// What drives.
    pub(crate) vehicle: SuiteVehicle,
}

impl Drive {
    /// Drives a course to its end, and some scans more.
    ///
    /// # Errors
    /// A setting that is not allowed: a mistake in the courses.
    pub(crate) fn record(course: Course, period_ns: u64, vehicle: &SuiteVehicle) -> anyhow::Result<Self> {
        let settings = course.settings(period_ns, vehicle)?;
        let mut pipeline = Pipeline::new(&settings)?;
        let mut referee = Referee::new(&settings.scenario);
        let (mut steps, mut ended) = (Vec::new(), None);
        while steps.len() < MAX_SCANS && ended.is_none_or(|ended| steps.len() < ended + AFTER_THE_END) {
            let step = *pipeline.step();
            if referee.observe(&step.truth, step.actuation.as_ref()).is_some() && ended.is_none() {
                ended = Some(steps.len() + 1);
            }
            steps.push(step);
        }
        Ok(Self { settings, ended: ended.unwrap_or(steps.len()), steps, vehicle: vehicle.clone() })
    }

    /// The drive with the ranges that the robot would measure on its way in another scenario.
    ///
    /// The robot gets the same actuations, so it moves as recorded. The world and the scanner are those of the changed
    /// scenario.
    pub(crate) fn rescanned(&self, change: impl FnOnce(&mut Scenario)) -> Self {
        let mut scenario = self.settings.scenario.clone();
        change(&mut scenario);
        let mut emulator = Emulator::new(&scenario, self.settings.period_ns);
        let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
        let mut drive = self.starting_at(1);
        for step in &mut drive.steps {
            let scan_id = step.scan.header.scan_id;
            emulator.advance_to(emulator.scan_ready_ns(scan_id));
            emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
            if let Some(actuation) = &step.actuation {
                emulator.actuate(actuation);
            }
            step.scan.ranges_mm = scan.ranges_mm;
        }
        drive
    }

    /// The drive from a scan on, which becomes scan 1: a run begins with that.
    pub(crate) fn starting_at(&self, first_scan: u64) -> Self {
        let skipped = (first_scan.max(1) as usize - 1).min(self.steps.len() - 1);
        let (settings, steps) = (self.settings.clone(), self.steps[skipped..].to_vec());
        Self { settings, steps, ended: self.ended.saturating_sub(skipped), vehicle: self.vehicle.clone() }
    }

    /// All samples of a scan; a scan beyond the end is the last one.
    pub(crate) fn step(&self, scan_id: u64) -> &Step {
        &self.steps[(scan_id.max(1) as usize - 1).min(self.steps.len() - 1)]
    }

    /// The sample of one topic for a scan.
    pub(crate) fn message(&self, topic: Topic, scan_id: u64) -> Option<Message> {
        let step = self.step(scan_id);
        Some(match topic {
            Topic::Scan => Message::new(&step.scan),
            Topic::Odometry => Message::new(&step.odometry),
            Topic::Pose => Message::new(&step.pose?),
            Topic::Obstacles => Message::new(&step.obstacles?),
            Topic::Command => Message::new(&step.command?),
            Topic::Actuation => Message::new(&step.actuation?),
            _ => return None,
        })
    }

    /// When a scan is published, in the drive's own time [ns].
    pub(crate) fn ready_ns(&self, scan_id: u64) -> u64 {
        self.step(scan_id).scan.header.stage(Role::Robot).published_ns
    }

    /// The first scan with the robot's centre beyond a place on the default robot's course [m].
    pub(crate) fn scan_at(&self, usual_m: f64) -> u64 {
        self.scan_beyond(self.vehicle.m(usual_m))
    }

    /// The first scan with the robot's centre beyond `x_m`.
    pub(crate) fn scan_beyond(&self, x_m: f64) -> u64 {
        let index = self.steps.iter().position(|step| step.truth.x_m >= x_m);
        index.unwrap_or(self.steps.len() - 1) as u64 + 1
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{BEAMS, MIN_RANGE_MM};

    use super::*;

    fn usual() -> SuiteVehicle {
        SuiteVehicle::read(None, 1.0).unwrap().0
    }

    #[test]
    fn a_scanner_on_an_empty_track_sees_the_hall_from_start_to_end() {
        let drive = Drive::record(Course::Free, 100_000_000, &usual()).unwrap();
        for step in &drive.steps {
            let valid = step.scan.ranges_mm.iter().filter(|range| **range >= MIN_RANGE_MM).count();
            // Of a healthy scan two thirds have a return; the end walls are out of reach ahead.
            assert!(valid > BEAMS / 2, "scan {}: {valid}", step.scan.header.scan_id);
        }
    }
}
