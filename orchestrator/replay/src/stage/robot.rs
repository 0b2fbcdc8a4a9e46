//! Recomputes what the emulated robot measured, from its seed and the recorded actuations.

use emulator::service::RobotState;
use emulator::{Emulator, Scenario};
use shared_types::{Actuation, Header, JournalEntry, JournalKind, Odometry, Role, Scan, Truth};

use super::Findings;
use super::journal::{Missing, Stage, Taking};
use crate::{ReplayDrive, ReplayOptions};

/// The process of an emulated robot.
pub(super) struct Robot {
    emulator: Emulator,
    /// When the drive began [ns].
    origin_ns: u64,
    actuation: Result<Actuation, Missing>,
    odometry: Odometry,
    truth: Truth,
}

impl Stage for Robot {
    type Output = Scan;
    type State = RobotState;
    const ROLE: Role = Role::Robot;

    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self> {
        let scenario: Scenario = drive.table_of(incarnation, Role::Robot, "scenario")?;
        Ok(Self {
            emulator: Emulator::new(&scenario, drive.period_ns),
            origin_ns: 0,
            actuation: Err(Missing::Input),
            odometry: Odometry::default(),
            truth: Truth::default(),
        })
    }

    fn resume(&mut self, state: &RobotState) -> bool {
        self.origin_ns = state.origin_ns;
        self.emulator.resume(&state.emulator).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>) {
        self.actuation = taking.sample(&taking.drive.actuations, entry);
    }

    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing> {
        match kind {
            JournalKind::Begun => self.origin_ns = value,
            JournalKind::Used => {
                let actuation = self.actuation.as_ref().map_err(|missing| *missing)?;
                self.emulator.advance_to(value);
                self.emulator.actuate(actuation);
            }
            JournalKind::Stopped => {
                self.emulator.advance_to(value);
                self.emulator.block_at_once();
            }
            _ => {}
        }
        Ok(())
    }

    fn output(&mut self, scan_id: u64) -> Result<Scan, Missing> {
        let mut scan = Scan::default();
        (self.odometry, self.truth) = (Odometry::default(), Truth::default());
        self.emulator.advance_to(self.emulator.scan_ready_ns(scan_id));
        self.emulator.measure(scan_id, &mut scan, &mut self.odometry, &mut self.truth);
        let acquired_ns = self.origin_ns.wrapping_add(self.emulator.stamp_ns(scan_id));
        for header in [&mut scan.header, &mut self.odometry.header, &mut self.truth.header] {
            *header = Header { scan_id, acquired_ns, ..Header::default() };
        }
        Ok(scan)
    }

    fn compare_others(
        &mut self,
        recorded: &Scan,
        drive: &ReplayDrive,
        options: &ReplayOptions,
        findings: &mut Findings,
    ) {
        let Header { scan_id, incarnation, .. } = recorded.header;
        let is_same = |header: &Header| header.incarnation == incarnation;
        let odometry = drive.odometries.of_scan(scan_id).find(|other| is_same(&other.header));
        if let Some((odometry, replayed)) = odometry.zip(drive.clocks.to_common(incarnation, &self.odometry))
        {
            findings.compare(odometry, replayed, Self::ROLE, drive, options);
        }
        let truth = drive.truths.of_scan(scan_id).find(|other| is_same(&other.header));
        if let Some((truth, replayed)) = truth.zip(drive.clocks.to_common(incarnation, &self.truth)) {
            findings.compare(truth, replayed, Self::ROLE, drive, options);
        }
    }
}
