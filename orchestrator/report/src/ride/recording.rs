//! Collects the drive from samples, which may come in any order between topics.

use std::collections::BTreeMap;

use shared_types::{Actuation, ActuationKind, Role, Truth};
use vehicle::{Control, State};

use super::drive::{Issued, RideMoment, RideTrace};

/// Maximum number of scans: an hour at 10 Hz, about 5 MB. A longer drive has no figures.
const MAX_SCANS: usize = 36_000;

/// What is recorded of the ride.
#[derive(Debug, Clone, Default)]
pub struct RideRecording {
    truths: BTreeMap<u64, Seen>,
    /// What was desired in answer to a scan, `None` for blocked wheels.
    answers: BTreeMap<u64, Option<Control>>,
    overflow: bool,
}

/// What one sample of the truth shows.
#[derive(Debug, Clone, Copy)]
struct Seen {
    moment: RideMoment,
    /// The scan whose answer acts, and since when [s].
    acting: (u64, f64),
}

impl RideRecording {
    /// The true state at a scan.
    pub fn truth(&mut self, truth: &Truth) {
        let header = &truth.header;
        // The age of the actuation counts from the time at which the scan was ready.
        let sweep_ns =
            header.stage(Role::Robot).published_ns.saturating_sub(header.acquired_ns).min(1_000_000_000);
        let acting_s = truth.time_s + sweep_ns as f64 * 1e-9 - truth.actuation_age_s;
        let state = State {
            sideslip: truth.sideslip_rad,
            yaw: truth.yaw_rad,
            yaw_rate: truth.yaw_rate_radps,
            x: truth.x_m,
            y: truth.y_m,
        };
        let (time_s, speed_mps, clearance_m) = (truth.time_s, truth.speed_mps, truth.clearance_m);
        let moment = RideMoment { time_s, state, way_rad: 0.0, speed_mps, clearance_m };
        self.overflow |= self.truths.len() >= MAX_SCANS;
        if !self.overflow {
            self.truths.insert(header.scan_id, Seen { moment, acting: (truth.actuation_scan, acting_s) });
        }
    }

    /// What was sent to the robot.
    pub fn actuation(&mut self, actuation: &Actuation) {
        if actuation.answers == 1 && self.answers.len() < MAX_SCANS {
            let Actuation { desired_velocity_mps, desired_steering_rad, .. } = *actuation;
            let desired = Control { velocity: desired_velocity_mps, steering: desired_steering_rad };
            let drives = actuation.kind == ActuationKind::Drive.wire();
            self.answers.insert(actuation.header.scan_id, drives.then_some(desired));
        }
    }

    /// The drive; empty when it was too long to be kept.
    pub fn drive(&self) -> RideTrace {
        if self.overflow {
            return RideTrace::default();
        }
        let moments = self.truths.values().map(|seen| seen.moment).collect();
        let mut commands: Vec<Issued> = Vec::new();
        let mut last_scan = 0;
        for Seen { acting: (scan, time_s), .. } in self.truths.values() {
            let Some(answer) = self.answers.get(scan).filter(|_| *scan != last_scan) else { continue };
            last_scan = *scan;
            let steering = commands.last().map_or(0.0, |issued| issued.control.steering);
            let control = answer.unwrap_or(Control { velocity: 0.0, steering });
            commands.push(Issued { time_s: *time_s, control });
        }
        RideTrace { moments, commands }
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{Header, StageStamps};

    use super::*;

    /// The truth at a scan whose sweep ends 30 ms later, when the answer to the scan before has acted for 70 ms.
    fn truth(scan_id: u64) -> Truth {
        let acquired_ns = scan_id * 100_000_000;
        let mut header = Header { scan_id, acquired_ns, ..Header::default() };
        *header.stage_mut(Role::Robot) =
            StageStamps { published_ns: acquired_ns + 30_000_000, ..StageStamps::default() };
        let (time_s, actuation_scan) = (scan_id as f64 * 0.1, scan_id - 1);
        Truth { header, time_s, actuation_scan, actuation_age_s: 0.07, speed_mps: 1.0, ..Truth::default() }
    }

    fn answer(scan_id: u64, kind: ActuationKind) -> Actuation {
        let header = Header { scan_id, ..Header::default() };
        let (desired_velocity_mps, desired_steering_rad) = (0.9, 0.01 * scan_id as f64);
        let kind = kind.wire();
        Actuation {
            header,
            kind,
            answers: 1,
            desired_velocity_mps,
            desired_steering_rad,
            ..Actuation::default()
        }
    }

    #[test]
    fn a_command_counts_from_the_time_at_which_it_acts_whatever_the_order_of_the_samples() {
        let mut recording = RideRecording::default();
        for scan_id in [4, 1, 3, 2] {
            recording.truth(&truth(scan_id));
            recording.actuation(&answer(scan_id, ActuationKind::Drive));
        }
        let drive = recording.drive();
        assert_eq!(
            drive.moments.iter().map(|moment| moment.time_s).collect::<Vec<_>>(),
            [0.1, 0.2, 0.1 * 3.0, 0.4]
        );
        assert_eq!(drive.commands.len(), 3, "no truth shows that the last one acts");
        for (issued, scan_id) in drive.commands.iter().zip(1..) {
            // 30 ms after the scan after it, and 70 ms before that.
            assert!((issued.time_s - (0.1 * f64::from(scan_id) + 0.06)).abs() < 1e-9, "{issued:?}");
            assert!((issued.control.steering - 0.01 * f64::from(scan_id)).abs() < 1e-12);
        }
        assert_eq!(drive.start_s(), Some(drive.commands[0].time_s));
    }

    #[test]
    fn blocked_wheels_are_a_command_of_no_velocity_and_the_last_angle() {
        let mut recording = RideRecording::default();
        (1..=4).for_each(|scan_id| recording.truth(&truth(scan_id)));
        recording.actuation(&answer(1, ActuationKind::Drive));
        recording.actuation(&answer(2, ActuationKind::Block));
        recording.actuation(&Actuation { answers: 0, ..answer(3, ActuationKind::Drive) });
        let controls: Vec<Control> = recording.drive().commands.iter().map(|issued| issued.control).collect();
        assert_eq!(
            controls,
            [(0.9, 0.01), (0.0, 0.01)].map(|(velocity, steering)| Control { velocity, steering })
        );
    }

    #[test]
    fn a_command_that_acts_longer_counts_once() {
        let mut recording = RideRecording::default();
        (1..=4).for_each(|scan_id| recording.truth(&truth(scan_id)));
        (1..=4).for_each(|scan_id| recording.actuation(&answer(scan_id, ActuationKind::Drive)));
        let lost = Truth { actuation_scan: 3, actuation_age_s: 0.17, ..truth(5) };
        recording.truth(&lost);
        assert_eq!(recording.drive().commands.len(), 3);
    }

    #[test]
    fn a_drive_that_is_too_long_is_empty() {
        let mut recording = RideRecording::default();
        (1..=MAX_SCANS as u64 + 1).for_each(|scan_id| recording.truth(&truth(scan_id)));
        assert_eq!(recording.drive(), RideTrace::default());
    }
}
