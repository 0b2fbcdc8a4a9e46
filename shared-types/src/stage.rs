//! A stage of the loop: what one process computes, without bus, clock or file.
//!
//! A [`Stage`] is written once and run three times: on the bus, in simulated time, and from journals in a replay. All
//! three hand it the same samples and times in the same order, so it gives the same bits.

use std::any::Any;
use std::cell::Cell;
use std::fmt::Display;

use bytemuck::Pod;

use crate::{Checkpoint, Described, Fault, Header, JournalKind, Role, Sample, SampleType};

/// What one process computes: samples in, one sample out for each scan.
///
/// Its outputs follow from what it is handed here and from nothing else: it reads no clock and no file. What is written
/// into header and stamps of an output is completed when it is published.
pub trait Stage: Clone + Send + Sync + 'static {
    /// Its table of settings.
    type Settings;
    /// What is wrong with settings.
    type Invalid: Display;
    /// What it publishes.
    type Output: Sample;
    /// All that its next output depends on, besides the samples to come; `[u8; 0]` for nothing.
    type State: Pod + Described;

    /// Its role in the loop.
    const ROLE: Role;
    /// The inputs of one scan that together give an output. With several, the one that comes last should stand last: it
    /// wakes the process.
    const ANSWERS: &'static [&'static SampleType];
    /// Inputs that are handed over one by one as they come, before newer ones of [`Stage::ANSWERS`]. In lock-step the
    /// stage gets those of the scan before first.
    const NOTES: &'static [&'static SampleType] = &[];
    /// Fields of type f64 that it reads of a topic of your own, if the system file gives it one: for each sample a
    /// [`StageEvent::Own`] and a [`StageEvent::Number`] per field, before the next of [`Stage::ANSWERS`]. In lock-step
    /// the stage gets those up to its scan first, in real time those that have come.
    const OWN_FIELDS: &'static [&'static str] = &[];
    /// Whether it takes each [`crate::Directive`] with other [`crate::Directive::orders`].
    const TAKES_ORDERS: bool = false;
    /// Whether the wheels obey its outputs: it is told to stop, and looks at its timeouts ten times per scan.
    const HOLDS_WHEELS: bool = false;

    /// A stage that has seen nothing, for scans every `period_ns`.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    fn begin(settings: Self::Settings, period_ns: u64) -> Result<Self, Self::Invalid>;

    /// Inputs that are handed over once the [`Stage::NOTES`] of their scan were: what is worked off while no process waits for
    /// it. In lock-step the stage gets those of the scan before first.
    fn later(&self) -> &'static [&'static SampleType] {
        &[]
    }

    /// Continues from the state of another stage; false, and unchanged, when it can't be used.
    fn resume(&mut self, _state: &Self::State) -> bool {
        false
    }

    /// What a successor resumes from; `None` while there is nothing worth it.
    fn state(&self) -> Option<Self::State> {
        None
    }

    /// Takes a sample at `now_ns` of the loop's clock.
    fn take(&mut self, sample: AnySample<'_>, now_ns: u64);

    /// The output that follows from what was taken, or from an event; `None` for none. `scan_id` is the scan of what was
    /// taken last.
    fn output(&mut self, scan_id: u64, watch: &Stopwatch<'_>) -> Option<Self::Output>;

    /// Follows what is no sample; false when it changed nothing and gives no output.
    fn follow(&mut self, _event: StageEvent) -> bool {
        false
    }

    /// Sees an output after it was published: for logs.
    fn published(&mut self, _output: &Self::Output) {}

    /// Sees a sample of [`Stage::ANSWERS`] again after the output was published, on the bus only: to copy what a rehearsal
    /// needs, while no process waits for it.
    fn keep(&mut self, _sample: AnySample<'_>) {}

    /// Makes the next output faster, for example by computing one on the inputs that are expected at `due_ns`; what
    /// follows gives the same bits as without. The clock is `now_ns`.
    fn rehearse(&mut self, _due_ns: u64, _now_ns: &dyn Fn() -> u64) {}

    /// Why it refuses what it took last.
    fn refusal(&self) -> Option<&Fault> {
        None
    }

    /// Whether its state contains a sample of [`Stage::ANSWERS`] already; asked after a [`Stage::resume`] in a stage
    /// with [`Stage::NOTES`], whose state may be newer than the scan it was saved for.
    fn contains(&self, _sample: AnySample<'_>) -> bool {
        false
    }

    /// Whether it holds the wheels for a stop.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// A sample of any topic, in its bytes.
#[derive(Debug, Clone, Copy)]
pub struct AnySample<'a> {
    of: &'static SampleType,
    bytes: &'a [u8],
}

impl<'a> AnySample<'a> {
    /// A sample of a known type.
    pub fn of<S: Sample>(sample: &'a S) -> Self {
        Self { of: S::TYPE, bytes: bytemuck::bytes_of(sample) }
    }

    /// The bytes of a sample; they have length and alignment of its type.
    pub fn new(of: &'static SampleType, bytes: &'a [u8]) -> Self {
        Self { of, bytes }
    }

    /// The sample, if it is one of `S`.
    pub fn get<S: Sample>(&self) -> Option<&'a S> {
        if self.of.topic == S::TOPIC { bytemuck::try_from_bytes(self.bytes).ok() } else { None }
    }

    /// Its type.
    pub fn sample_type(&self) -> &'static SampleType {
        self.of
    }

    /// Its bytes.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Its header.
    pub fn header(&self) -> &'a Header {
        (self.of.header)(self.bytes)
    }
}

/// What a stage follows besides its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StageEvent {
    /// The process begins, at this time [ns].
    Begun(u64),
    /// A time to look at timeouts [ns].
    Timer(u64),
    /// The wheels have to be blocked, at this time [ns].
    Stopped(u64),
    /// An emergency stop from outside asks for it, at this time [ns].
    EmergencyStop(u64),
    /// They need not any more.
    Released,
    /// A sample of a topic of your own, of this scan; its fields follow.
    Own(u64),
    /// The next field of that sample, as bits of an f64.
    Number(u64),
    /// Samples of its inputs were dropped because of their content.
    Dropped,
    /// The process before this one left no state that can be used. One in charge moves the robot again only when that
    /// needs no state; another may begin afresh, because it takes over only when it agrees.
    StateLost {
        /// Whether its outputs count at once.
        in_charge: bool,
    },
}

impl StageEvent {
    /// The event that an entry of a journal states, if it states one.
    pub fn of(kind: JournalKind, value: u64) -> Option<Self> {
        Some(match kind {
            JournalKind::Begun => Self::Begun(value),
            JournalKind::Timer => Self::Timer(value),
            JournalKind::Stopped => Self::Stopped(value),
            JournalKind::EmergencyStop => Self::EmergencyStop(value),
            JournalKind::Released => Self::Released,
            JournalKind::Own => Self::Own(value),
            JournalKind::Number => Self::Number(value),
            JournalKind::Dropped => Self::Dropped,
            JournalKind::BegunInStop => Self::StateLost { in_charge: true },
            _ => return None,
        })
    }

    /// Kind and value of its entry in a journal.
    pub fn entry(self) -> (JournalKind, u64) {
        match self {
            Self::Begun(at_ns) => (JournalKind::Begun, at_ns),
            Self::Timer(at_ns) => (JournalKind::Timer, at_ns),
            Self::Stopped(at_ns) => (JournalKind::Stopped, at_ns),
            Self::EmergencyStop(at_ns) => (JournalKind::EmergencyStop, at_ns),
            Self::Released => (JournalKind::Released, 0),
            Self::Own(scan_id) => (JournalKind::Own, scan_id),
            Self::Number(bits) => (JournalKind::Number, bits),
            Self::Dropped => (JournalKind::Dropped, 0),
            Self::StateLost { .. } => (JournalKind::BegunInStop, 0),
        }
    }
}

/// How long an output takes, for a stage that ends its work in time.
pub struct Stopwatch<'c> {
    runs: Runs<'c>,
    readings: Cell<u64>,
    over_after: Cell<Option<u64>>,
}

enum Runs<'c> {
    Not,
    By { started_ns: u64, now_ns: &'c dyn Fn() -> u64 },
    Again(Option<u64>),
}

impl<'c> Stopwatch<'c> {
    fn new(runs: Runs<'c>) -> Self {
        Self { runs, readings: Cell::new(0), over_after: Cell::new(None) }
    }

    /// One that stands: in simulated time a stage takes no time.
    pub fn standing() -> Self {
        Self::new(Runs::Not)
    }

    /// One that was started at a time of a clock [ns].
    pub fn running(started_ns: u64, now_ns: &'c dyn Fn() -> u64) -> Self {
        Self::new(Runs::By { started_ns, now_ns })
    }

    /// One that repeats what another has shown: the time was over after so many readings, or never.
    pub fn recorded(over_after: Option<u64>) -> Self {
        Self::new(Runs::Again(over_after))
    }

    /// Whether it stands.
    pub fn stands(&self) -> bool {
        matches!(self.runs, Runs::Not)
    }

    /// Time since its start [ns]; 0 unless it runs.
    pub fn elapsed_ns(&self) -> u64 {
        match self.runs {
            Runs::By { started_ns, now_ns } => now_ns().saturating_sub(started_ns),
            Runs::Not | Runs::Again(_) => 0,
        }
    }

    /// Reads it: whether `limit_ns` have passed since its start.
    pub fn is_over(&self, limit_ns: u64) -> bool {
        let before = self.readings.get();
        let is_over = match self.runs {
            Runs::Not => false,
            Runs::By { .. } => self.elapsed_ns() >= limit_ns,
            Runs::Again(after) => after.is_some_and(|readings| before >= readings),
        };
        if is_over && self.over_after.get().is_none() {
            self.over_after.set(Some(before));
        }
        self.readings.set(before + 1);
        is_over
    }

    /// How often it was read before the time was over, if it was.
    pub fn over_after(&self) -> Option<u64> {
        self.over_after.get()
    }
}

/// What a runner of stages knows of one.
#[derive(Debug, Clone, Copy)]
pub struct StageShape {
    /// [`Stage::ROLE`].
    pub role: Role,
    /// [`Stage::ANSWERS`].
    pub answers: &'static [&'static SampleType],
    /// [`Stage::NOTES`].
    pub notes: &'static [&'static SampleType],
    /// [`Stage::later`].
    pub later: &'static [&'static SampleType],
    /// [`Stage::OWN_FIELDS`].
    pub own_fields: &'static [&'static str],
    /// The type of [`Stage::Output`].
    pub output: &'static SampleType,
    /// [`Stage::HOLDS_WHEELS`].
    pub holds_wheels: bool,
    /// [`Stage::TAKES_ORDERS`].
    pub takes_orders: bool,
}

/// Any [`Stage`], so that a runner is compiled once for all; the methods that are not explained are those of the stage.
#[expect(missing_docs, reason = "explained at the trait `Stage`")]
pub trait AnyStage: Any + Send + Sync {
    fn shape(&self) -> StageShape;
    fn take(&mut self, sample: AnySample<'_>, now_ns: u64);
    fn follow(&mut self, event: StageEvent) -> bool;
    fn keep(&mut self, _sample: AnySample<'_>) {}
    fn rehearse(&mut self, due_ns: u64, now_ns: &dyn Fn() -> u64);
    fn refusal(&self) -> Option<&Fault>;
    fn contains(&self, sample: AnySample<'_>) -> bool;
    fn is_stopped(&self) -> bool;

    /// [`Stage::resume`] from the state in a checkpoint, with its times on the clock of this host.
    ///
    /// # Errors
    /// Why it can't be used.
    fn resume(&mut self, checkpoint: &Checkpoint) -> Result<(), String>;

    /// A copy with the same state.
    fn copy(&self) -> Box<dyn AnyStage>;

    /// [`Stage::state`] as a checkpoint, without a header.
    fn checkpoint(&self) -> Option<Checkpoint>;

    /// Hands the output to `publish`, which completes its header, then to [`Stage::published`]; false for no output.
    fn publish(&mut self, scan_id: u64, watch: &Stopwatch<'_>, publish: &mut dyn FnMut(&mut [u8])) -> bool;
}

impl<T: Stage> AnyStage for T {
    fn shape(&self) -> StageShape {
        StageShape {
            role: T::ROLE,
            answers: T::ANSWERS,
            notes: T::NOTES,
            later: Stage::later(self),
            own_fields: T::OWN_FIELDS,
            output: T::Output::TYPE,
            holds_wheels: T::HOLDS_WHEELS,
            takes_orders: T::TAKES_ORDERS,
        }
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        Stage::take(self, sample, now_ns);
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        Stage::follow(self, event)
    }

    fn keep(&mut self, sample: AnySample<'_>) {
        Stage::keep(self, sample);
    }

    fn rehearse(&mut self, due_ns: u64, now_ns: &dyn Fn() -> u64) {
        Stage::rehearse(self, due_ns, now_ns);
    }

    fn refusal(&self) -> Option<&Fault> {
        Stage::refusal(self)
    }

    fn contains(&self, sample: AnySample<'_>) -> bool {
        Stage::contains(self, sample)
    }

    fn is_stopped(&self) -> bool {
        Stage::is_stopped(self)
    }

    fn resume(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        let state = checkpoint.state_here::<T::State>().map_err(|error| error.to_string())?;
        if Stage::resume(self, &state) { Ok(()) } else { Err("a number in it is impossible".to_owned()) }
    }

    fn copy(&self) -> Box<dyn AnyStage> {
        Box::new(self.clone())
    }

    fn checkpoint(&self) -> Option<Checkpoint> {
        self.state().map(|state| Checkpoint::of(T::ROLE, &state))
    }

    fn publish(&mut self, scan_id: u64, watch: &Stopwatch<'_>, publish: &mut dyn FnMut(&mut [u8])) -> bool {
        let Some(mut output) = self.output(scan_id, watch) else { return false };
        publish(bytemuck::bytes_of_mut(&mut output));
        self.published(&output);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Odometry, Pose};

    #[test]
    fn a_sample_is_got_as_its_own_type_only() {
        let pose = Pose { x_m: 3.0, ..Pose::default() };
        let any = AnySample::of(&pose);
        assert_eq!(any.get::<Pose>().map(|pose| pose.x_m), Some(3.0));
        assert!(any.get::<Odometry>().is_none());
    }

    #[test]
    fn a_watch_that_repeats_another_is_over_at_the_same_reading() {
        let now_ns = Cell::new(1_000);
        let clock = || now_ns.replace(now_ns.get() + 100);
        let watch = Stopwatch::running(clock(), &clock);
        let shown: Vec<bool> = (0..5).map(|_| watch.is_over(300)).collect();
        assert_eq!(shown, [false, false, true, true, true]);
        assert_eq!(watch.over_after(), Some(2));
        let again = Stopwatch::recorded(watch.over_after());
        assert_eq!((0..5).map(|_| again.is_over(300)).collect::<Vec<_>>(), shown);
        let never = Stopwatch::recorded(None);
        assert!((0..100).all(|_| !never.is_over(0)) && never.over_after().is_none());
        assert!(!Stopwatch::standing().is_over(0));
    }

    #[test]
    fn events_are_read_back_from_a_journal() {
        for event in [
            StageEvent::Begun(7),
            StageEvent::Timer(8),
            StageEvent::Stopped(9),
            StageEvent::EmergencyStop(10),
            StageEvent::Released,
            StageEvent::Own(11),
            StageEvent::Number(12),
            StageEvent::Dropped,
            StageEvent::StateLost { in_charge: true },
        ] {
            let (kind, value) = event.entry();
            assert_eq!(StageEvent::of(kind, value), Some(event));
        }
        assert_eq!(StageEvent::of(JournalKind::Used, 1), None);
    }
}
