//! One recorded drive: where it was along the course, and its figures.

use std::collections::BTreeMap;
use std::path::Path;

use bytemuck::from_bytes;
use console::exit::Failure;
use recording::Recording;
use recording::read::{RUN, attachment, metadata};
use shared_types::{
    Actuation, ActuationKind, BlockReason, Directive, Header, Pose, Role, Sample, Topic, Truth,
};
use toml::Table;
use vehicle::{Course, Goal, State};

use super::STEP_M;
use crate::LatencyReport;
use crate::latency::Latencies;
use crate::ride::{RideFigures, RideRecording, measure};

/// Clearances from here on mean that nothing is near [m].
const NOTHING_NEAR_M: f64 = 1e6;

/// The robot when it first came as far as a place of the course.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Station {
    pub(super) scan_id: u64,
    /// Place of the station along the course [m].
    pub(super) along_m: f64,
    /// Position across it, to the left [m].
    pub(super) across_m: f64,
    pub(super) speed_mps: f64,
    /// Desired steering angle of the scan [rad].
    pub(super) steering_rad: Option<f64>,
    /// Clearance of the body at the scan, where something is near [m].
    pub(super) clearance_m: Option<f64>,
    /// Of the answer to the scan, where its stamps are those of a clock.
    pub(super) answer: Option<Header>,
}

/// A drive.
#[derive(Debug, Default)]
pub(super) struct Drive {
    pub(super) seed: Option<u64>,
    /// By the number of their place.
    pub(super) stations: BTreeMap<i64, Station>,
    pub(super) ride: Option<RideFigures>,
    pub(super) clearance_m: Option<f64>,
    pub(super) time_s: f64,
    pub(super) stops: u32,
    pub(super) stopped_s: f64,
    /// `None` where time was simulated.
    pub(super) latency: Option<LatencyReport>,
}

/// Name and value of a figure; `None` where a drive has none.
type DriveFigure = (&'static str, fn(&Drive) -> Option<f64>);

/// What is compared.
pub(super) const FIGURES: &[DriveFigure] = &[
    ("time [s]", |drive| Some(drive.time_s)),
    ("stops", |drive| Some(f64::from(drive.stops))),
    ("stopped [s]", |drive| Some(drive.stopped_s)),
    ("smallest clearance [m]", |drive| drive.clearance_m),
    ("ride: objective J", |drive| Some(drive.ride?.objective)),
    ("ride: variation of steering [rad]", |drive| Some(drive.ride?.steering_total_variation_rad)),
    ("ride: largest step [rad]", |drive| Some(drive.ride?.steering_step_max_rad)),
    ("ride: lateral acceleration [m/s^2]", |drive| Some(drive.ride?.lateral_acceleration_max_mps2)),
    ("ride: lateral jerk [m/s^3]", |drive| Some(drive.ride?.lateral_jerk_max_mps3)),
    ("scan to actuation, p50 [ms]", |drive| drive.ms(|all| all.scan_to_actuation.p50)),
    ("scan to actuation, p99 [ms]", |drive| drive.ms(|all| all.scan_to_actuation.p99)),
    ("estimator computes, p50 [ms]", |drive| drive.ms(|all| all.stages.compute.estimator.p50)),
    ("obstacles computes, p50 [ms]", |drive| drive.ms(|all| all.stages.compute.obstacles.p50)),
    ("controller computes, p50 [ms]", |drive| drive.ms(|all| all.stages.compute.controller.p50)),
    ("actuator computes, p50 [ms]", |drive| drive.ms(|all| all.stages.compute.actuator.p50)),
    ("transport, p50 [ms]", |drive| drive.ms(|all| all.stages.transport.p50)),
];

/// The robot at a scan: state and speed.
type Seen = (State, f64);

/// What is read of the samples of a drive.
#[derive(Default)]
struct Reading {
    directive: Directive,
    ride: RideRecording,
    /// By the truth, and by the estimate.
    seen: [BTreeMap<u64, Seen>; 2],
    clearances_m: BTreeMap<u64, f64>,
    /// Desired steering angle [rad] and header of the answer to each scan.
    answers: BTreeMap<u64, (f64, Header)>,
    /// With the times at which they were recorded [ns].
    actuations: Vec<(u64, Actuation)>,
    is_simulated: bool,
    first_ns: Option<u64>,
    last_ns: u64,
    has_driven: bool,
    stopped_ns: Option<u64>,
    stops: u32,
    stopped_s: f64,
}

impl Drive {
    /// A latency [ms].
    fn ms(&self, microseconds: fn(&LatencyReport) -> f64) -> Option<f64> {
        Some(microseconds(self.latency.as_ref()?) * 1e-3)
    }

    /// Reads the drive of a recording.
    ///
    /// # Errors
    /// A file that is no recording, has samples of another layout, or in which no robot moves along; exit code 2.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let refuse = |reason: &str| Failure::bad_input(format!("{}: {reason}", path.display()));
        let mut recording = Recording::open(path)?;
        let mut reading = Reading::default();
        recording.samples(|contents, sample| {
            reading.is_simulated = metadata(contents, "recording", "lockstep") == Some("true");
            reading.take(sample.topic, sample.bytes, sample.log_ns);
            Ok(())
        })?;
        if recording.files().len() > 1 {
            return Err(refuse(
                "it holds joined recordings; `scanloop recording repair` makes a file of each",
            ));
        }
        let contents = &recording.files()[0];
        let table = |name: &str| {
            attachment(contents, name).and_then(|text| text.parse::<Table>().ok()).unwrap_or_default()
        };
        let settings = table(&runtime::settings_file(Role::Controller));
        let of = |key: &str| settings.get("controller").and_then(|part| part.get(key)).cloned();
        let course = of("course").and_then(|course| course.try_into::<Course>().ok());
        let course = course.filter(|course| !course.is_line());
        let goal = of("goal").and_then(|goal| goal.try_into::<Goal>().ok());
        let run = table(RUN);
        let seed = run.get("scenario").and_then(|scenario| scenario.get("seed"));
        let seed = seed.and_then(toml::Value::as_integer).map(i64::cast_unsigned);
        let last_scan = metadata(contents, "end", "last_scan").and_then(|scan| scan.parse().ok());
        let last_scan = last_scan.filter(|scan| reading.is_simulated && *scan > 0).unwrap_or(u64::MAX);
        let drive = reading.finish(last_scan, course.as_ref(), goal.as_ref(), seed);
        if drive.stations.is_empty() {
            return Err(refuse("it holds no scan of a drive"));
        }
        Ok(drive)
    }
}

impl Reading {
    fn take(&mut self, topic: Topic, bytes: &[u8], log_ns: u64) {
        let kind = topic.sample_type();
        if (kind.check)(bytes).is_err() || !self.directive.counts(topic, (kind.header)(bytes)) {
            return;
        }
        match topic {
            Topic::Directive => self.directive = *of::<Directive>(bytes),
            Topic::Truth => self.truth(of(bytes)),
            Topic::Pose => {
                let pose = of::<Pose>(bytes);
                let state = State { x: pose.x_m, y: pose.y_m, yaw: pose.yaw_rad, ..State::default() };
                self.seen[1].insert(pose.header.scan_id, (state, pose.speed_mps));
            }
            Topic::Actuation => self.actuations.push((log_ns, *of(bytes))),
            _ => {}
        }
    }

    fn truth(&mut self, truth: &Truth) {
        self.ride.truth(truth);
        let state = State { x: truth.x_m, y: truth.y_m, yaw: truth.yaw_rad, ..State::default() };
        self.seen[0].insert(truth.header.scan_id, (state, truth.speed_mps));
        if truth.clearance_m < NOTHING_NEAR_M {
            self.clearances_m.insert(truth.header.scan_id, truth.clearance_m);
        }
    }

    /// Stops are blocks after the first drive command and before landing or end.
    fn actuation(&mut self, actuation: &Actuation, log_ns: u64) {
        self.ride.actuation(actuation);
        let drives = actuation.kind == ActuationKind::Drive.wire();
        let is_end = matches!(
            BlockReason::try_from(actuation.reason),
            Ok(BlockReason::Landed | BlockReason::StopRequested)
        );
        if drives {
            self.first_ns.get_or_insert(log_ns);
            self.last_ns = log_ns;
        }
        self.has_driven |= drives;
        if drives || is_end {
            let since_ns = self.stopped_ns.take();
            self.stopped_s += since_ns.map_or(0.0, |since| log_ns.saturating_sub(since) as f64 * 1e-9);
        } else if self.has_driven && self.stopped_ns.is_none() {
            (self.stops, self.stopped_ns) = (self.stops + 1, Some(log_ns));
        }
    }

    /// The drive up to a scan: what follows the end is not the same in each run.
    fn finish(
        mut self,
        last_scan: u64,
        course: Option<&Course>,
        goal: Option<&Goal>,
        seed: Option<u64>,
    ) -> Drive {
        let mut latencies = Latencies::new(self.is_simulated);
        for (log_ns, actuation) in std::mem::take(&mut self.actuations) {
            if actuation.header.scan_id <= last_scan {
                self.actuation(&actuation, log_ns);
                if actuation.answers == 1 {
                    latencies.record(&actuation.header);
                }
                self.answers
                    .insert(actuation.header.scan_id, (actuation.desired_steering_rad, actuation.header));
            }
        }
        self.clearances_m.retain(|scan_id, _| *scan_id <= last_scan);
        let [truth, estimate] = self.seen.map(|mut seen| {
            seen.retain(|scan_id, _| *scan_id <= last_scan);
            seen
        });
        let seen = if truth.is_empty() { estimate } else { truth };
        let trace = self.ride.drive();
        let trace = course.map_or_else(|| trace.clone(), |course| trace.clone().along(course));
        let mut stations = stations(&seen, course);
        for station in stations.values_mut() {
            let answer = self.answers.get(&station.scan_id);
            station.steering_rad = answer.map(|(steering_rad, _)| *steering_rad);
            station.answer = answer.map(|(_, header)| *header).filter(|_| !self.is_simulated);
            station.clearance_m = self.clearances_m.get(&station.scan_id).copied();
        }
        Drive {
            seed,
            stations,
            ride: goal.and_then(|goal| measure(&trace, goal)),
            clearance_m: self.clearances_m.into_values().reduce(f64::min),
            time_s: self.last_ns.saturating_sub(self.first_ns.unwrap_or(self.last_ns)) as f64 * 1e-9,
            stops: self.stops,
            stopped_s: self.stopped_s,
            latency: Some(latencies.report()).filter(|report| report.scan_to_actuation.count > 0),
        }
    }
}

/// From one scan to the next no robot drives further [m].
const FARTHEST_M: f64 = 100.0;

/// The stations that a robot came to, each between the scans around it.
fn stations(seen: &BTreeMap<u64, Seen>, course: Option<&Course>) -> BTreeMap<i64, Station> {
    let mut stations = BTreeMap::new();
    let (mut before, mut near_m): (Option<(State, f64)>, Option<f64>) = (None, None);
    for (scan_id, (state, speed_mps)) in seen {
        let state = course.map_or(*state, |course| {
            let on_course = course.on_course(state, near_m.unwrap_or_else(|| course.find(state)));
            near_m = Some(on_course.x);
            on_course
        });
        if let Some((last, last_mps)) = before.filter(|(last, _)| state.x - last.x <= FARTHEST_M) {
            let [from, to] = [last.x, state.x].map(|x| (x / STEP_M).floor() as i64);
            for place in from.saturating_add(1)..=to {
                let along_m = place as f64 * STEP_M;
                let share = (along_m - last.x) / (state.x - last.x);
                let between = |one: f64, other: f64| one + share * (other - one);
                stations.entry(place).or_insert_with(|| Station {
                    scan_id: *scan_id,
                    along_m,
                    across_m: between(last.y, state.y),
                    speed_mps: between(last_mps, *speed_mps),
                    ..Station::default()
                });
            }
        }
        before = Some((state, *speed_mps));
    }
    stations
}

fn of<S: Sample>(bytes: &[u8]) -> &S {
    from_bytes(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_is_said_to_be_far_away_at_once_passes_no_stations_on_the_way() {
        let at = |x: f64| (State { x, ..State::default() }, 1.0);
        let drive =
            [(1, at(0.0)), (2, at(0.5)), (3, at(1e9)), (4, at(-1e15)), (5, at(f64::MAX)), (6, at(0.6))];
        let few = stations(&BTreeMap::from(drive), None);
        let drive = [(1, at(0.0)), (2, at(0.5))];
        assert_eq!(few.len(), stations(&BTreeMap::from(drive), None).len());
        assert!(few.values().all(|station| station.along_m <= 0.5), "{few:?}");
    }
}
