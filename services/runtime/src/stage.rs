//! Runs a [`Stage`] as a process of the loop: live, in lock-step, and for a simulation.
//!
//! ```no_run
//! use runtime::stage::NoSettings;
//! use shared_types::{AnySample, Odometry, Pose, Role, Sample, SampleType, Stage, Stopwatch};
//!
//! /// An estimator that believes the odometer.
//! #[derive(Clone, Default)]
//! struct Believer(Option<Pose>);
//!
//! impl Stage for Believer {
//!     type Settings = NoSettings;
//!     type Invalid = std::convert::Infallible;
//!     type Output = Pose;
//!     type State = [u8; 0];
//!     const ROLE: Role = Role::Estimator;
//!     const ANSWERS: &'static [&'static SampleType] = &[Odometry::TYPE];
//!
//!     fn begin(_: NoSettings, _period_ns: u64) -> Result<Self, Self::Invalid> {
//!         Ok(Self::default())
//!     }
//!
//!     fn take(&mut self, sample: AnySample<'_>, _now_ns: u64) {
//!         let pose_of = |measured: &Odometry| Pose {
//!             header: measured.header.answer(),
//!             yaw_rad: measured.yaw_rad,
//!             x_m: measured.x_m,
//!             y_m: measured.y_m,
//!             ..Pose::default()
//!         };
//!         self.0 = sample.get().map(pose_of);
//!     }
//!
//!     fn output(&mut self, _scan_id: u64, _: &Stopwatch<'_>) -> Option<Pose> {
//!         self.0.take()
//!     }
//! }
//!
//! fn main() -> std::process::ExitCode {
//!     runtime::stage::main::<Believer>()
//! }
//! ```

pub mod pipe;

use std::process::ExitCode;
use std::rc::Rc;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use shared_types::{
    Actuation, AnySample, AnyStage, Directive, DrivenBy, Header, JournalKind, SampleType, Stage, StageEvent,
    Stopwatch, Topic,
};

use crate::enclosed::Enclosed;
use crate::handover::Handover;
use crate::input::{Reader, join_readers};
use crate::output::Writer;
use crate::own::{EMERGENCY_STOP_FIELDS, EmergencyStop, OwnFields};
use crate::port::Received;
use crate::settings::settings_table;
use crate::{Process, RuntimeError, monotonic_ns};

/// A stage that holds the wheels looks at its timeouts so often per scan: a block is late by a tenth at most.
const POLLS: u64 = 10;

/// Settings of a stage that reads none: every table is accepted.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
pub struct NoSettings {}

/// The whole program of a stage: [`run`], with its messages and exit code.
///
/// Exit code 2 when it was not started by an orchestrator, or was built against other samples; 1 for other errors.
pub fn main<T: Stage>() -> ExitCode
where
    T::Settings: DeserializeOwned,
{
    crate::start_logging();
    match run::<T>() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            crate::print(crate::Priority::Error, &format!("error: {error}"));
            let is_usage = matches!(error, RuntimeError::NotInASystem(_) | RuntimeError::Layout(_));
            ExitCode::from(if is_usage { 2 } else { 1 })
        }
    }
}

/// Runs a stage as the process that the orchestrator has started, until it is asked to end; or for a simulation, which
/// hands it samples through standard input.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run<T: Stage>() -> Result<(), RuntimeError>
where
    T::Settings: DeserializeOwned,
{
    if pipe::is_wanted() {
        return pipe::serve(&mut pipe::begin::<T>);
    }
    let process = Process::attach(T::ROLE)?;
    let table = settings_table(T::ROLE);
    let mut stage = T::begin(process.settings(table)?, process.period_ns())
        .map_err(|invalid| process.refuse_settings(table, &invalid))?;
    run_any(process, &mut stage)
}

/// Runs any stage.
fn run_any(process: Process, stage: &mut dyn AnyStage) -> Result<(), RuntimeError> {
    let Some(mut runner) = Runner::start(process, stage)? else { return Ok(()) };
    while runner.wait()? {
        runner.follow_directive()?;
        runner.answer()?;
        runner.look_at_timeouts()?;
    }
    runner.end()
}

/// A stage between its ports.
struct Runner<'s> {
    process: Process,
    stage: &'s mut dyn AnyStage,
    /// Inputs that give an output together, one or two.
    answers: Vec<Enclosed<Rc<Reader>>>,
    /// Inputs that are handed over as they come.
    notes: Vec<Enclosed<Rc<Reader>>>,
    /// Inputs that are handed over after the notes of their scan.
    later: Vec<Enclosed<Rc<Reader>>>,
    output: Enclosed<Rc<Writer>>,
    output_type: &'static SampleType,
    holds_wheels: bool,
    takes_orders: bool,
    /// [`Directive::orders`] that were handed over last; `None` after a state that has some of its own.
    orders: Option<(u64, u32, u64)>,
    /// The scan of what was noted last.
    noted: u64,
    /// Its header.
    noted_header: Option<Header>,
    /// The scan of what was worked off last, and whether there was any.
    worked_off: u64,
    has_worked: bool,
    /// The scan that was answered last.
    answered: u64,
    dropped: u64,
    /// Buttons of a stage that holds the wheels.
    emergency_stops: Vec<EmergencyStop>,
    /// Topics of your own of another stage, with the fields that it reads.
    own: Vec<OwnFields>,
    /// One of them was pressed, and the orchestrator has not seen it.
    is_emergency: bool,
}

impl<'s> Runner<'s> {
    /// Opens the ports, hands over what the process before has left, and waits for the loop; `None` when it was asked
    /// to end before.
    fn start(mut process: Process, stage: &'s mut dyn AnyStage) -> Result<Option<Self>, RuntimeError> {
        let shape = stage.shape();
        let mut open = |of: &[&'static SampleType]| -> Result<Vec<_>, RuntimeError> {
            of.iter().map(|of| process.open_input(of)).collect()
        };
        let (answers, notes, later) = (open(shape.answers)?, open(shape.notes)?, open(shape.later)?);
        let output = process.open_output(shape.output)?;
        let mut own = match (shape.holds_wheels, shape.own_fields) {
            (true, _) => process.open_own_fields((EMERGENCY_STOP_FIELDS, "u8"))?,
            (false, []) => Vec::new(),
            (false, fields) => process.open_own_fields((fields, "f64"))?,
        };
        let buttons = if shape.holds_wheels { std::mem::take(&mut own) } else { Vec::new() };
        let emergency_stops = buttons.into_iter().map(EmergencyStop::of).collect();
        let mut runner = Self {
            process,
            stage,
            answers,
            notes,
            later,
            output,
            output_type: shape.output,
            holds_wheels: shape.holds_wheels,
            takes_orders: shape.takes_orders,
            orders: Some(Directive::default().orders()),
            noted: 0,
            noted_header: None,
            worked_off: 0,
            has_worked: false,
            answered: 0,
            dropped: 0,
            emergency_stops,
            own,
            is_emergency: false,
        };
        let is_lost = match runner.process.resume_checkpoint()? {
            Handover::FirstStart => false,
            Handover::Lost => true,
            Handover::State(checkpoint) => match runner.stage.resume(&checkpoint) {
                Ok(()) => {
                    runner.orders = None;
                    false
                }
                Err(error) => {
                    tracing::warn!(%error, "the state of the process before this one can't be used");
                    true
                }
            },
        };
        if shape.notes.iter().any(|of| of.topic == Topic::Actuation) {
            runner.take_handed();
        }
        if is_lost && runner.holds_wheels {
            // A robot that drives is stopped first; valid inputs release it.
            runner.follow(StageEvent::Stopped(runner.process.clock().now_ns()))?;
        }
        if !runner.process.start()? {
            return Ok(None);
        }
        if is_lost {
            runner.follow(StageEvent::StateLost { in_charge: runner.process.is_in_charge() })?;
        }
        runner.noted = runner.process.handed_scan();
        runner.worked_off = runner.noted;
        runner.join()?;
        Ok(Some(runner))
    }

    /// Notes actuations that the process before did not receive, such as the block that followed its silence.
    fn take_handed(&mut self) {
        for actuation in self.process.handed_actuations() {
            self.stage.take(AnySample::of::<Actuation>(&actuation), self.process.now_ns());
        }
    }

    /// In a swap, continues from the newest state of the process in charge.
    fn join(&mut self) -> Result<(), RuntimeError> {
        let Self { process, stage, answers, notes, orders, .. } = self;
        let mut joined = None;
        process.join_checkpoint(&mut |checkpoint| {
            if stage.resume(checkpoint).is_ok() {
                joined = Some(checkpoint.header.scan_id);
            }
            joined.is_some()
        })?;
        let (Some(scan_id), Some(first)) = (joined, answers.first()) else { return Ok(()) };
        *orders = None;
        match notes.is_empty() {
            true => first.skip_to(scan_id),
            false => first.skip(&|bytes| stage.contains(AnySample::new(first.of(), bytes))),
        }
        Ok(())
    }

    /// Sleeps until there is something to do; false when the process is to end.
    fn wait(&mut self) -> Result<bool, RuntimeError> {
        let Self { process, stage, .. } = self;
        let mut prepare = |due_ns| stage.rehearse(due_ns, &monotonic_ns);
        if self.answers.len() > 1 && self.notes.is_empty() {
            return process.wait_joined_preparing(&mut prepare);
        }
        let poll_ns = process.period_ns() / POLLS;
        let deadline_ns = self.holds_wheels.then(|| process.clock().now_ns() + poll_ns);
        process.wait_preparing(deadline_ns, &mut prepare)
    }

    /// Tells the stage to stop or to continue, its orders, and that samples were dropped.
    fn follow_directive(&mut self) -> Result<(), RuntimeError> {
        if self.takes_orders {
            let directive = self.process.directive();
            if self.orders != Some(directive.orders()) {
                self.orders = Some(directive.orders());
                let now_ns = self.process.clock().now_ns();
                self.process.note_taken(&directive.header);
                self.process.note(JournalKind::Used, now_ns);
                self.stage.take(AnySample::of(&directive), now_ns);
            }
        }
        if self.holds_wheels {
            let was_emergency = self.is_emergency;
            self.look_at_emergency_stops()?;
            let now_ns = self.process.clock().now_ns();
            let is_stop = self.process.directive().stop == 1;
            match (is_stop || self.is_emergency, self.stage.is_stopped()) {
                (true, false) if !is_stop => self.follow(StageEvent::EmergencyStop(now_ns))?,
                (true, false) => self.follow(StageEvent::Stopped(now_ns))?,
                // The stop of the user or the orchestrator is named first.
                (true, true) if is_stop && was_emergency && !self.is_emergency => {
                    self.follow(StageEvent::Stopped(now_ns))?
                }
                (false, true) => self.follow(StageEvent::Released)?,
                _ => {}
            }
        }
        let dropped = self.answers.iter().map(|input| input.dropped()).sum();
        if dropped > self.dropped {
            self.dropped = dropped;
            self.follow(StageEvent::Dropped)?;
        }
        Ok(())
    }

    /// A button that was pressed holds the wheels also when it is released, until the orchestrator has seen it: then nobody
    /// drives, or a person, and the controller does not drive on by itself.
    fn look_at_emergency_stops(&mut self) -> Result<(), RuntimeError> {
        let mut is_pressed = false;
        for stop in &mut self.emergency_stops {
            is_pressed |= stop.blocks(monotonic_ns())?;
        }
        let is_seen = self.process.directive().driven_by != DrivenBy::Controller.wire();
        self.is_emergency = is_pressed || self.is_emergency && !is_seen;
        Ok(())
    }

    /// Hands over all samples that wait, and publishes what the stage answers.
    fn answer(&mut self) -> Result<(), RuntimeError> {
        loop {
            self.note()?;
            // Published before the next scan, but perhaps after this input was emptied.
            if self.process.clock().is_simulated() && self.is_early(self.worked_off) {
                self.later.iter().try_for_each(|input| input.drain())?;
                self.note()?;
            }
            if self.awaits_notes() {
                return Ok(());
            }
            let Some(samples) = self.take() else { return Ok(()) };
            self.take_own(&samples)?;
            let now_ns = self.process.now_ns();
            let mut first: Option<Header> = None;
            for (input, sample) in self.answers.iter().zip(samples.iter().flatten()) {
                let sample = AnySample::new(input.of(), sample);
                self.stage.take(sample, now_ns);
                first.get_or_insert(*sample.header());
            }
            if let Some(((fault, input), header)) =
                self.stage.refusal().zip(self.answers.first()).zip(first.as_ref())
            {
                input.refuse(header, fault);
            }
            self.answered = first.map_or(self.answered, |header| header.scan_id);
            if let Some(header) = self.publish(now_ns)? {
                self.save(&header)?;
            }
            for (input, sample) in self.answers.iter().zip(samples.iter().flatten()) {
                self.stage.keep(AnySample::new(input.of(), sample));
            }
        }
    }

    /// Hands over the fields of topics of your own, before the samples of a scan.
    fn take_own(&mut self, samples: &[Option<Enclosed<Received>>; 2]) -> Result<(), RuntimeError> {
        let Self { process, stage, answers, own, .. } = self;
        let mut follow = |event: StageEvent| {
            if stage.follow(event) {
                let (kind, value) = event.entry();
                process.note(kind, value);
            }
        };
        let Some((input, sample)) = answers.first().zip(samples[0].as_ref()) else { return Ok(()) };
        let scan_id = AnySample::new(input.of(), sample).header().scan_id;
        for topic in own {
            while let Some(sample) = topic.up_to(scan_id)? {
                follow(StageEvent::Own(sample.header().scan_id));
                topic.bits(&sample).for_each(|bits| follow(StageEvent::Number(bits)));
            }
        }
        Ok(())
    }

    /// Hands over what is noted as it comes, then what is worked off after it; the state is saved when all of a scan is in it.
    fn note(&mut self) -> Result<(), RuntimeError> {
        let mut header = None;
        for input in &self.notes {
            while let Some(sample) = input.take() {
                let sample = AnySample::new(input.of(), &sample);
                self.noted = sample.header().scan_id;
                self.stage.take(sample, self.process.now_ns());
                header = Some(*sample.header());
            }
        }
        self.noted_header = header.or(self.noted_header);
        let has_worked = self.work_off();
        let is_whole = !self.has_more() || self.worked_off >= self.noted;
        match self.noted_header {
            Some(noted) if is_whole && (has_worked || header.is_some()) => self.save(&noted),
            _ => Ok(()),
        }
    }

    /// Hands over what is worked off after the answer and the notes of its scan; whether there was any. A process beside the
    /// one in charge may have the notes before it has answered.
    fn work_off(&mut self) -> bool {
        let (before, up_to) = (self.worked_off, self.noted.min(self.answered));
        for input in &self.later {
            while let Some(sample) = input.take_up_to(up_to) {
                let sample = AnySample::new(input.of(), &sample);
                (self.worked_off, self.has_worked) = (sample.header().scan_id, true);
                self.stage.take(sample, self.process.now_ns());
            }
        }
        self.worked_off != before
    }

    /// Whether there is something to work off with each scan. Where none has come, there is none: a robot without a scanner,
    /// or a test of this stage alone.
    fn has_more(&self) -> bool {
        self.has_worked || self.later.iter().any(|input| input.next_scan().is_some())
    }

    /// Whether the next scan is not the one after `done`.
    fn is_early(&self, done: u64) -> bool {
        let next = self.answers.first().and_then(|input| input.next_scan());
        next.is_some_and(|scan_id| done < scan_id.saturating_sub(1))
    }

    /// Whether something has to be noted before the next scan, in lock-step: the result must not depend on when it
    /// arrives.
    fn awaits_notes(&self) -> bool {
        let awaits_notes = !self.notes.is_empty() && self.is_early(self.noted);
        let awaits_more = self.has_more() && self.is_early(self.worked_off);
        self.process.clock().is_simulated() && (awaits_notes || awaits_more)
    }

    /// The samples of one scan that give an output.
    fn take(&self) -> Option<[Option<Enclosed<Received>>; 2]> {
        match &*self.answers {
            [only] => only.take().map(|sample| [Some(sample), None]),
            [one, other] => join_readers(one, other).map(|(one, other)| [Some(one), Some(other)]),
            _ => None,
        }
    }

    fn look_at_timeouts(&mut self) -> Result<(), RuntimeError> {
        if !self.holds_wheels || self.process.clock().is_simulated() {
            return Ok(());
        }
        self.follow(StageEvent::Timer(self.process.clock().now_ns()))
    }

    /// Hands an event to the stage, and publishes what it gives.
    fn follow(&mut self, event: StageEvent) -> Result<(), RuntimeError> {
        if self.stage.follow(event) {
            let (kind, value) = event.entry();
            self.process.note(kind, value);
            self.publish(self.process.clock().now_ns())?;
        }
        Ok(())
    }

    /// Publishes the output of the stage, which began at `started_ns`; returns its header when there was one.
    fn publish(&mut self, started_ns: u64) -> Result<Option<Header>, RuntimeError> {
        let Self { process, stage, output, .. } = self;
        let watch = match process.clock().is_simulated() {
            true => Stopwatch::standing(),
            false => Stopwatch::running(started_ns, &monotonic_ns),
        };
        let (mut published, mut header) = (Ok(()), None);
        stage.publish(self.answered, &watch, &mut |bytes| {
            if let Some(readings) = watch.over_after() {
                process.note(JournalKind::Budget, readings);
            }
            published = output.publish(bytes);
            header = Some(*(self.output_type.header)(bytes));
        });
        published.map(|()| header)
    }

    /// Publishes the state after a sample of this header.
    fn save(&self, header: &Header) -> Result<(), RuntimeError> {
        match self.stage.checkpoint() {
            Some(checkpoint) => self.process.save_checkpoint(header, checkpoint),
            None => Ok(()),
        }
    }

    /// The last output of a stage that holds the wheels blocks them.
    fn end(mut self) -> Result<(), RuntimeError> {
        if self.holds_wheels {
            self.follow(StageEvent::Stopped(self.process.clock().now_ns()))?;
        }
        Ok(())
    }
}
