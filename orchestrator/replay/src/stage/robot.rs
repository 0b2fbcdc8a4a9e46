//! Recomputes what the emulated robot measured, from its seed and the recorded actuations.

use emulator::service::RobotState;
use emulator::{Emulator, Scenario};
use shared_types::{
    Actuation, AnySample, Directive, GivenGoal, Header, Odometry, Role, Sample, SampleType, Scan, Stage,
    StageEvent, Stopwatch, Truth,
};

use super::Findings;
use super::journal::Recomputed;
use crate::{ReplayDrive, ReplayOptions};

/// The process of an emulated robot.
#[derive(Clone)]
pub(crate) struct Robot {
    pub(crate) emulator: Emulator,
    /// When the drive began [ns].
    pub(crate) origin_ns: u64,
    /// The goal that was set last.
    pub(crate) goal: GivenGoal,
    odometry: Odometry,
    truth: Truth,
}

impl Stage for Robot {
    type Settings = Scenario;
    type Invalid = String;
    type Output = Scan;
    type State = RobotState;

    const ROLE: Role = Role::Robot;
    const ANSWERS: &'static [&'static SampleType] = &[];
    const NOTES: &'static [&'static SampleType] = &[Actuation::TYPE];

    fn begin(scenario: Scenario, period_ns: u64) -> Result<Self, String> {
        scenario.validate().map_err(|invalid| invalid.to_string())?;
        let (odometry, truth) = (Odometry::default(), Truth::default());
        let (emulator, goal) = (Emulator::new(&scenario, period_ns), GivenGoal::default());
        Ok(Self { emulator, origin_ns: 0, goal, odometry, truth })
    }

    fn resume(&mut self, state: &RobotState) -> bool {
        self.origin_ns = state.origin_ns;
        self.emulator.resume(&state.emulator).is_ok()
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        if let Some(actuation) = sample.get() {
            self.emulator.advance_to(now_ns);
            self.emulator.actuate(actuation);
        } else if let Some(directive) = sample.get::<Directive>() {
            self.goal = directive.goal;
        }
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        match event {
            StageEvent::Begun(at_ns) => self.origin_ns = at_ns,
            StageEvent::Stopped(at_ns) => {
                self.emulator.advance_to(at_ns);
                self.emulator.block_at_once();
            }
            _ => return false,
        }
        true
    }

    fn output(&mut self, scan_id: u64, _: &Stopwatch<'_>) -> Option<Scan> {
        let mut scan = Scan::default();
        (self.odometry, self.truth) = (Odometry::default(), Truth::default());
        self.emulator.advance_to(self.emulator.scan_ready_ns(scan_id));
        self.emulator.give(&self.goal, scan_id);
        self.emulator.measure(scan_id, &mut scan, &mut self.odometry, &mut self.truth);
        let acquired_ns = self.origin_ns.wrapping_add(self.emulator.stamp_ns(scan_id));
        for header in [&mut scan.header, &mut self.odometry.header, &mut self.truth.header] {
            *header = Header { scan_id, acquired_ns, ..Header::default() };
        }
        Some(scan)
    }
}

impl Recomputed for Robot {
    /// What stood in the old scenario stays as it was; obstacles that were added at its end have not appeared.
    fn with_settings(&self, scenario: Scenario, period_ns: u64, scan_id: u64) -> Result<Self, String> {
        scenario.validate().map_err(|invalid| invalid.to_string())?;
        let state = self.emulator.state(scan_id - 1);
        let mut state = state.ok_or("the next sweep has begun; the scan before or after may do")?;
        let mut emulator = Emulator::new(&scenario, period_ns);
        state.appearing = emulator.state(0).map_or(0, |beginning| beginning.appearing);
        emulator.resume(&state).map_err(|fault| fault.to_string())?;
        Ok(Self { emulator, ..self.clone() })
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
