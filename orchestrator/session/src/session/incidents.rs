//! What is worth a file of its last seconds: a death, a rollback, a collision, and any stop but landing.

use audit::samples::ScanRecord;
use shared_types::{ActuationKind, BlockReason};

use super::Session;
use crate::run_recorder::RunRecorder;

/// What was noticed until now.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noticed {
    /// Swaps that were rolled back.
    rolled_back: usize,
    /// Whether the wheels turned in the newest scan.
    drove: bool,
    /// Files that the user was told of.
    told: usize,
}

impl Session {
    /// Has the recorder write what it keeps in memory, if it does.
    pub(super) fn incident(&mut self) {
        if let Some(recorder) = &mut self.recorder {
            recorder.incident();
        }
    }

    /// Notices wheels that are blocked while they turn, but for landing.
    pub(super) fn notice_stop(&mut self, scan: &ScanRecord) {
        let Some(actuation) = scan.actuations.last() else { return };
        if actuation.reason == BlockReason::EmergencyStop.wire() {
            self.notice_emergency();
        }
        let drives = actuation.kind == ActuationKind::Drive.wire();
        let drove = std::mem::replace(&mut self.noticed.drove, drives);
        let is_meant = actuation.reason == BlockReason::Landed.wire() || actuation.driven_by != 0;
        if drove && !drives && !is_meant && self.conclusion.is_open() {
            self.incident();
        }
    }

    /// Tells once when the recorder has failed, and which files it has written; the drive continues without it.
    pub(super) fn check_recorder(&mut self) {
        if let Some(reason) = self.recorder.as_mut().and_then(RunRecorder::has_failed) {
            self.progress.warn(&reason);
        }
        let rolled_back = self.swaps.rolled_back();
        if std::mem::replace(&mut self.noticed.rolled_back, rolled_back) < rolled_back {
            self.incident();
        }
        let files = self.recorder.as_ref().map_or(&[][..], RunRecorder::incidents);
        for file in &files[self.noticed.told.min(files.len())..] {
            self.progress.note(&format!("{} holds the last seconds", file.display()));
        }
        self.noticed.told = files.len();
    }
}
