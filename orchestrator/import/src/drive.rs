//! The drive that is made of imported scans: estimator and obstacle detector run over them in simulated time, and all is recorded
//! as in a run in lock-step.

use std::io;

use bytemuck::bytes_of;
use estimator::EstimatorStage;
use obstacles::DetectorStage;
use pipeline::{SimulatedWriter, Tuning, first_incarnation};
use recording::{Tape, TapeTarget};
use serde::Serialize;
use shared_types::{
    AnySample, Authority, Checkpoint, Directive, Header, Journal, JournalEntry, JournalKind, Obstacles,
    Odometry, Phase, Pose, Role, SLOTS, Sample, Scan, ScannerState, Stage, Stopwatch,
};
use vehicle::Invalid;

/// Whose samples count is said once in this time, so that a part that is cut out also has it [ns].
const DIRECTIVE_NS: u64 = 1_000_000_000;

/// What the stages made of the scans.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Computed {
    /// Poses of the estimator.
    pub poses: u64,
    /// Outputs of the obstacle detector.
    pub obstacles: u64,
    /// Bodies in all of them.
    pub bodies: u64,
    /// Scans for which the scanner was healthy.
    pub healthy: u64,
    /// Scans for which it was degraded.
    pub degraded: u64,
    /// Scans for which the wheels would have been blocked: blind, stuck or contradictory.
    pub stopping: u64,
}

/// A drive that is recorded.
pub(crate) struct Drive<T: TapeTarget> {
    tape: Tape<T>,
    robot: [SimulatedWriter; 2],
    estimator: Runner<EstimatorStage>,
    detector: Runner<DetectorStage>,
    /// Directives until now, and when the next one is due [ns].
    directives: (u64, u64),
    pub(crate) computed: Computed,
}

impl<T: TapeTarget> Drive<T> {
    /// A drive without a scan yet.
    ///
    /// # Errors
    /// Settings that are not allowed.
    pub(crate) fn new(target: T, tuning: &Tuning, period_ns: u64) -> Result<Self, Invalid> {
        let writer = || SimulatedWriter::new(Role::Robot, first_incarnation(Role::Robot));
        Ok(Self {
            tape: Tape::new(target, true, 0),
            robot: [writer(), writer()],
            estimator: Runner::new(tuning.estimator.clone(), period_ns)?,
            detector: Runner::new(tuning.obstacles.clone(), period_ns)?,
            directives: (0, 0),
            computed: Computed::default(),
        })
    }

    /// Records a scan with its odometry, which come at `now_ns`, and what the stages make of them.
    ///
    /// # Errors
    /// Those of the output.
    pub(crate) fn add(&mut self, scan: &mut Scan, odometry: &mut Odometry, now_ns: u64) -> io::Result<()> {
        let [scans, odometries] = &mut self.robot;
        let (number, due_ns) = &mut self.directives;
        if now_ns >= *due_ns {
            (*number, *due_ns) = (*number + 1, now_ns + DIRECTIVE_NS);
            self.tape.sample(Directive::TOPIC, bytes_of(&directive(*number, now_ns)))?;
        }
        odometries.complete(Odometry::TYPE, bytemuck::bytes_of_mut(odometry), now_ns);
        scans.complete(Scan::TYPE, bytemuck::bytes_of_mut(scan), now_ns);
        self.tape.sample(Odometry::TOPIC, bytes_of(odometry))?;
        self.tape.sample(Scan::TOPIC, bytes_of(scan))?;
        self.estimator.take(odometry, now_ns);
        let Some(pose) = self.estimator.answer(&scan.header, now_ns, &mut self.tape)? else { return Ok(()) };
        self.computed.poses += 1;
        if self.estimator.stage.later().iter().any(|of| of.topic == Scan::TOPIC) {
            // The next pose is corrected by it.
            self.estimator.take(scan, now_ns);
            self.estimator.used(now_ns);
        }
        self.detector.take(scan, now_ns);
        self.detector.take::<Pose>(&pose, now_ns);
        let described: Option<Obstacles> = self.detector.answer(&scan.header, now_ns, &mut self.tape)?;
        if let Some(obstacles) = described {
            self.computed.obstacles += 1;
            self.computed.bodies += obstacles.list().len() as u64;
            let state = obstacles.scanner.state();
            let count = match state {
                ScannerState::Healthy => &mut self.computed.healthy,
                ScannerState::Degraded => &mut self.computed.degraded,
                _ => &mut self.computed.stopping,
            };
            *count += 1;
        }
        Ok(())
    }

    /// Where it was recorded.
    pub(crate) fn into_target(self) -> T {
        self.tape.into_target()
    }
}

/// A stage with what it publishes, and the journal of what it took.
struct Runner<S> {
    stage: S,
    outputs: SimulatedWriter,
    states: SimulatedWriter,
    journals: u64,
    open: Journal,
}

impl<S: Stage<Invalid = Invalid>> Runner<S> {
    fn new(settings: S::Settings, period_ns: u64) -> Result<Self, Invalid> {
        let open = Journal { role: S::ROLE.wire(), ..Journal::default() };
        let writer = || SimulatedWriter::new(S::ROLE, first_incarnation(S::ROLE));
        let (outputs, states) = (writer(), writer());
        Ok(Self { stage: S::begin(settings, period_ns)?, outputs, states, journals: 0, open })
    }

    /// Hands over a sample. A journal has places for many more entries than there are between two outputs.
    fn take<I: Sample>(&mut self, sample: &I, now_ns: u64) {
        let Header { incarnation, sequence, .. } = *sample.header();
        let (kind, topic) = (JournalKind::Taken.wire() as u16, I::TOPIC as u16);
        self.open.push(JournalEntry { kind, topic, incarnation, value: sequence });
        self.stage.take(AnySample::of(sample), now_ns);
    }

    /// Notes that what was taken is used.
    fn used(&mut self, now_ns: u64) {
        self.note(JournalKind::Used, now_ns);
    }

    fn note(&mut self, kind: JournalKind, value: u64) {
        let kind = kind.wire() as u16;
        self.open.push(JournalEntry { kind, value, ..JournalEntry::default() });
    }

    /// The output for a scan; it is recorded behind its journal, and then the state.
    fn answer(
        &mut self,
        scan: &Header,
        now_ns: u64,
        tape: &mut Tape<impl TapeTarget>,
    ) -> io::Result<Option<S::Output>> {
        self.used(now_ns);
        let mut output = self.stage.output(scan.scan_id, &Stopwatch::standing());
        if let Some(output) = &mut output {
            self.outputs.complete(S::Output::TYPE, bytemuck::bytes_of_mut(output), now_ns);
        }
        self.journals += 1;
        self.open.header = Header {
            layout: Journal::LAYOUT,
            incarnation: first_incarnation(S::ROLE),
            scan_id: scan.scan_id,
            sequence: self.journals,
            ..Header::default()
        };
        // Without an output, more entries follow.
        self.open.output = output.as_ref().map_or(0, |output| output.header().sequence);
        tape.sample(Journal::TOPIC, bytes_of(&self.open))?;
        self.open = Journal { role: self.open.role, ..Journal::default() };
        let Some(output) = output else { return Ok(None) };
        tape.sample(S::Output::TOPIC, bytes_of(&output))?;
        if let Some(state) = self.stage.state() {
            let header = output.header().answer();
            let mut checkpoint = Checkpoint { header, issued_ns: now_ns, ..Checkpoint::of(S::ROLE, &state) };
            self.states.complete(Checkpoint::TYPE, bytemuck::bytes_of_mut(&mut checkpoint), now_ns);
            tape.sample(Checkpoint::TOPIC, bytes_of(&checkpoint))?;
            self.note(JournalKind::Saved, checkpoint.header.sequence);
        }
        Ok(Some(output))
    }
}

/// Says whose samples count.
fn directive(sequence: u64, now_ns: u64) -> Directive {
    let of_slot = |slot: usize| {
        let role = Role::ALL.get(slot);
        role.map_or_else(Authority::default, |role| Authority {
            incarnation: first_incarnation(*role),
            ..Authority::default()
        })
    };
    let authority: [Authority; SLOTS] = std::array::from_fn(of_slot);
    let header = Header { layout: Directive::LAYOUT, sequence, ..Header::default() };
    Directive { header, phase: Phase::Driving.wire(), issued_ns: now_ns, authority, ..Directive::default() }
}
