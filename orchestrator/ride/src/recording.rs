//! Collects the drive from samples, which may come in any order between topics.

use std::collections::BTreeMap;

use shared_types::{Actuation, ActuationKind, Role, Truth};
use vehicle::{Control, State};

use crate::drive::{Drive, Issued, Moment};

/// Maximum number of scans: 5.5 hours at 10 Hz. A longer drive has no figures.
const MAX_SCANS: usize = 200_000;

/// What is recorded of the ride.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    truths: BTreeMap<u64, Seen>,
    /// What was desired in answer to a scan, `None` for blocked wheels.
    answers: BTreeMap<u64, Option<Control>>,
    overflow: bool,
}

/// What one sample of the truth shows.
#[derive(Debug, Clone, Copy)]
struct Seen {
    moment: Moment,
    /// The scan whose answer acts, and since when [s].
    acting: (u64, f64),
}

impl Recording {
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
        let moment = Moment { time_s, state, speed_mps, clearance_m };
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
    pub fn drive(&self) -> Drive {
        if self.overflow {
            return Drive::default();
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
        Drive { moments, commands }
    }
}
