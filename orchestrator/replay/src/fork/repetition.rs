//! Whether a drive that is driven on repeats its recording.

use pipeline::Step;
use serde::Serialize;
use shared_types::{Role, Sample};

use crate::ReplayDrive;
use crate::compare::{FieldDifference, difference_to};
use crate::drive::Lane;

/// How the outputs of a drive compare with the recorded ones of the same scans.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Repetition {
    /// Outputs that were recorded as well.
    pub compared: u64,
    /// Of these, outputs that are equal to the recorded ones.
    pub identical: u64,
    /// The first difference.
    pub first_difference: Option<FieldDifference>,
}

impl Repetition {
    /// Compares all samples of a scan, unless the recorded run had ended.
    pub fn add(&mut self, drive: &ReplayDrive, step: &Step) {
        let Step { scan, odometry, truth, pose, obstacles, command, actuation, .. } = step;
        let of = (drive, scan.header.scan_id);
        if of.1 > drive.last_scan() {
            return;
        }
        self.compare(of, &drive.scans, Some(scan));
        self.compare(of, &drive.odometries, Some(odometry));
        self.compare(of, &drive.truths, Some(truth));
        self.compare(of, &drive.poses, pose.as_ref());
        self.compare(of, &drive.obstacles, obstacles.as_ref());
        self.compare(of, &drive.commands, command.as_ref());
        self.compare(of, &drive.actuations, actuation.as_ref());
    }

    fn compare<S: Sample>(&mut self, of: (&ReplayDrive, u64), lane: &Lane<S>, sample: Option<&S>) {
        let (drive, scan_id) = of;
        let Some(recorded) = drive.counted(lane, scan_id) else { return };
        let role = S::TOPIC.writer().unwrap_or(Role::Robot);
        let found = match sample {
            Some(sample) => difference_to(recorded, *sample, role),
            None => Some(FieldDifference::missing(recorded)),
        };
        self.compared += 1;
        self.identical += u64::from(found.is_none());
        self.first_difference = self.first_difference.take().or(found);
    }
}
