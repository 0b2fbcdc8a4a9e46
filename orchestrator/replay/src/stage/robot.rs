//! Recomputes what the emulated robot measured, from its seed and the recorded actuations.

use emulator::service::RobotState;
use emulator::{Emulator, Scenario};
use shared_types::{Actuation, Header, JournalEntry, JournalKind, Odometry, Role, Scan, Truth};

use super::Findings;
use super::journal::{Missing, Stage};
use crate::{Drive, Options};

/// The process of an emulated robot.
pub(super) struct Robot<'d> {
    emulator: Emulator,
    /// When the drive began [ns].
    origin_ns: u64,
    actuation: Option<&'d Actuation>,
    odometry: Odometry,
    truth: Truth,
}

impl<'d> Stage<'d> for Robot<'d> {
    type Output = Scan;
    type State = RobotState;
    const ROLE: Role = Role::Robot;

    fn begin(drive: &'d Drive) -> anyhow::Result<Self> {
        let scenario: Scenario = drive.table(Role::Robot, "scenario")?;
        Ok(Self {
            emulator: Emulator::new(&scenario, drive.period_ns),
            origin_ns: 0,
            actuation: None,
            odometry: Odometry::default(),
            truth: Truth::default(),
        })
    }

    fn resume(&mut self, state: &RobotState) -> bool {
        self.origin_ns = state.origin_ns;
        self.emulator.resume(&state.emulator).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, drive: &'d Drive) {
        self.actuation = drive.actuations.of_number(entry.incarnation, entry.value);
    }

    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing> {
        match kind {
            JournalKind::Begun => self.origin_ns = value,
            JournalKind::Used => {
                self.emulator.advance_to(value);
                self.emulator.actuate(self.actuation.ok_or(Missing)?);
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

    fn compare_others(&mut self, recorded: &Scan, drive: &Drive, options: &Options, findings: &mut Findings) {
        let Header { scan_id, incarnation, .. } = recorded.header;
        let is_same = |header: &Header| header.incarnation == incarnation;
        if let Some(odometry) = drive.odometries.of_scan(scan_id).find(|other| is_same(&other.header)) {
            findings.compare(odometry, self.odometry, Self::ROLE, drive, options);
        }
        if let Some(truth) = drive.truths.of_scan(scan_id).find(|other| is_same(&other.header)) {
            findings.compare(truth, self.truth, Self::ROLE, drive, options);
        }
    }
}
