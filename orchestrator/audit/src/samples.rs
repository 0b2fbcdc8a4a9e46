//! The orchestrator's view of the loop: all topics, in the order of scans.
//!
//! Topics are polled one after the other, so their samples come in any order. Here they wait until their scan is
//! complete: its truth and its actuation have arrived, or later scans show that no answer will come. Of a robot that
//! publishes no truth, scan and actuation complete it; a scan that was not observed is known by its actuation.
//! In lock-step the result does not depend on when the topics were polled.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use runtime::{Bus, Observer, RuntimeError, monotonic_ns};
use shared_types::{
    Actuation, ActuationKind, Admission, AuthorityFilter, Command, CommandKind, Directive, Fault, Header,
    KnownScan, Obstacles, Odometry, Phase, Pose, Rule, Sample, Scan, Truth, YOUNG_NS,
};

use crate::ledger::SampleAudit;

/// A scan without an answer is given up when this many newer scans have been published, and at high rates as many as
/// may come late together.
const TIMEOUT_SCANS: u64 = 3;

/// Number of actuations that are stored for a process that starts: those that may be on their way to the robot
/// (`vehicle::MAX_ON_THE_WAY`), and more than are sent until a hung process is noticed, because repetitions are not stored.
const RECENT: usize = 72;

/// Number of samples that are stored of the other process of a swap; more than processes store, because the
/// orchestrator polls less often.
const ASIDE: usize = 16;

/// Scans with an invalid sample that are stored until they are taken.
const MAX_REFUSED: usize = 1024;

/// So many scans in a row with an actuation that [`deviates`] are no limit of the actuator.
pub const MAX_DEVIATING: u32 = 2;
/// Velocity beyond that of the command that deviates [m/s].
const FASTER_MPS: f64 = 0.2;
/// Difference to the steering angle of the command that deviates, a quarter of the largest angle [rad].
const OTHERWISE_RAD: f64 = 0.015;

/// What is stored of a sample until its scan is complete.
trait Stored<S> {
    fn of(sample: &S) -> Self;
    fn header(&self) -> &Header;
}

impl<S: Sample> Stored<S> for S {
    fn of(sample: &S) -> Self {
        *sample
    }

    fn header(&self) -> &Header {
        Sample::header(self)
    }
}

/// A scan without its ranges.
struct Swept {
    header: Header,
    /// Whether the scanner gave no ranges.
    missing: bool,
}

impl Stored<Scan> for Swept {
    fn of(scan: &Scan) -> Self {
        Self { header: scan.header, missing: scan.missing.is_set() }
    }

    fn header(&self) -> &Header {
        &self.header
    }
}

/// Samples of one topic that wait for their scan.
struct Queue<S: Sample, T = S> {
    observer: Observer<S>,
    waiting: VecDeque<T>,
    aside: VecDeque<T>,
    filter: AuthorityFilter,
}

impl<S: Sample, T: Stored<S>> Queue<S, T> {
    fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self {
            observer: Observer::new(bus)?,
            waiting: VecDeque::with_capacity(64),
            aside: VecDeque::with_capacity(ASIDE),
            filter: AuthorityFilter::default(),
        })
    }

    fn poll(
        &mut self,
        directive: &Directive,
        sample_audit: &mut SampleAudit,
        scans: &mut Scans,
    ) -> Result<(), RuntimeError> {
        let Self { observer, waiting, aside, filter } = self;
        let before = std::mem::take(aside);
        let authority = directive.authority_over(S::TOPIC);
        let mut put = |stored: T, was_aside: bool| match filter.admit(authority, stored.header(), was_aside) {
            Admission::Counts => waiting.push_back(stored),
            Admission::Aside => {
                if aside.len() == ASIDE {
                    aside.pop_front();
                }
                aside.push_back(stored);
            }
            Admission::Foreign => {}
        };
        before.into_iter().for_each(|stored| put(stored, true));
        poll(observer, directive, sample_audit, scans, |sample| put(T::of(sample), false))
    }

    /// The newest scan that waits; 0 without one.
    fn newest(&self) -> u64 {
        self.waiting.back().map_or(0, |stored| stored.header().scan_id)
    }

    fn pop_up_to(&mut self, scan_id: u64) -> Option<T> {
        self.waiting.pop_front_if(|stored| stored.header().scan_id <= scan_id)
    }
}

/// Which scans can exist, and which had an invalid sample that would have counted.
struct Scans {
    period_ns: u64,
    known: KnownScan,
    refused: Vec<(u64, Rule)>,
}

impl Scans {
    /// Passes when the scan of a sample can exist: it was granted, as each is in lock-step, or the scanner can have come
    /// so far.
    fn judge(&self, header: &Header, directive: &Directive, now_ns: u64) -> Result<(), Fault> {
        if header.scan_id <= directive.granted_scan {
            return Ok(());
        }
        self.known.judge(header, now_ns, self.period_ns, self.period_ns)
    }

    fn refuse(&mut self, scan_id: u64, rule: Rule) {
        if self.refused.len() < MAX_REFUSED {
            self.refused.push((scan_id, rule));
        }
    }
}

/// Passes the valid samples of a topic to `each`, and all samples to the audit.
fn poll<S: Sample>(
    observer: &Observer<S>,
    directive: &Directive,
    sample_audit: &mut SampleAudit,
    scans: &mut Scans,
    mut each: impl FnMut(&S),
) -> Result<(), RuntimeError> {
    let now_ns = monotonic_ns();
    let mut arrived = 0;
    sample_audit.poll(S::TOPIC, now_ns);
    observer.poll_checked(|sample, check| {
        arrived += 1;
        let header = sample.header();
        let check = check.and_then(|()| scans.judge(header, directive, now_ns));
        match check {
            Err(Fault::Layout { .. }) => {}
            Err(Fault::ImpossibleNumber { .. }) => sample_audit.see_impossible(sample, now_ns),
            _ => sample_audit.see(sample, now_ns),
        }
        let counts = directive.counts(S::TOPIC, header);
        match check {
            Ok(()) => {
                if counts {
                    scans.known = scans.known.and(header, now_ns);
                }
                each(sample);
            }
            Err(fault) if counts => scans.refuse(header.scan_id, fault.rule()),
            Err(_) => {}
        }
    })?;
    if arrived >= observer.capacity() {
        sample_audit.overflowed(S::TOPIC, observer.capacity());
    }
    Ok(())
}

/// Adds an actuation, unless it repeats the one before it.
fn remember(recent: &mut VecDeque<Actuation>, actuation: &Actuation) {
    let asks = |of: &Actuation| (of.kind, of.desired_velocity_mps, of.desired_steering_rad);
    if recent.back().is_some_and(|newest| asks(newest) == asks(actuation)) {
        return;
    }
    if recent.len() == RECENT {
        recent.pop_front();
    }
    recent.push_back(*actuation);
}

/// All samples of one scan, and those without a scan since the scan before.
pub struct ScanRecord {
    /// Identity and stamps of the scan.
    pub header: Header,
    /// The true state of the robot; `None` when the robot publishes none.
    pub truth: Option<Truth>,
    /// Poses of the scan in the order of arrival; one unless something is wrong.
    pub poses: Vec<Pose>,
    /// Obstacles of the scan.
    pub obstacles: Vec<Obstacles>,
    /// Commands of the scan.
    pub commands: Vec<Command>,
    /// Actuations of the scan.
    pub actuations: Vec<Actuation>,
    /// Whether the scanner gave no ranges.
    pub missing: bool,
}

impl ScanRecord {
    /// Whether the actuator turns the wheels clearly otherwise than each command of the scan.
    pub fn deviates(&self) -> bool {
        self.answers().any(|actuation| deviates(&self.commands, actuation))
    }

    /// Whether the actuator turns the wheels although every command of the scan blocks them.
    pub fn is_disobeyed(&self) -> bool {
        self.answers().any(|actuation| is_disobedient(&self.commands, actuation))
    }

    /// Actuations of this scan: those of earlier scans that came again are among `actuations` as well.
    fn answers(&self) -> impl Iterator<Item = &Actuation> {
        self.actuations.iter().filter(|actuation| actuation.header.scan_id == self.header.scan_id)
    }
}

/// Whether an answer turns the wheels clearly otherwise than each of the commands that it may answer: faster, or in another
/// direction. A single one may be a limit of the actuator.
pub fn deviates(commands: &[Command], actuation: &Actuation) -> bool {
    let differs = |command: &Command| {
        command.kind == CommandKind::Drive.wire()
            && (is_faster(actuation.desired_velocity_mps, command.velocity_mps)
                || (actuation.desired_steering_rad - command.steering_rad).abs() > OTHERWISE_RAD)
    };
    actuation.answers == 1
        && actuation.kind == ActuationKind::Drive.wire()
        && !commands.is_empty()
        && commands.iter().all(differs)
}

/// Whether a velocity is clearly larger than the one asked for, or in the other direction.
fn is_faster(driven_mps: f64, asked_mps: f64) -> bool {
    driven_mps * 1.0_f64.copysign(asked_mps) > asked_mps.abs() + FASTER_MPS || driven_mps * asked_mps < 0.0
}

/// Whether an answer turns the wheels although none of the commands that it may answer asks for that.
pub fn is_disobedient(commands: &[Command], actuation: &Actuation) -> bool {
    let drives = |command: &Command| command.kind == CommandKind::Drive.wire();
    actuation.answers == 1
        && actuation.kind == ActuationKind::Drive.wire()
        && !commands.is_empty()
        && !commands.iter().any(drives)
}

/// All topics of the loop.
pub struct Samples {
    scans: Queue<Scan, Swept>,
    /// Whether the robot publishes its true state.
    has_truth: bool,
    /// The oldest scan that was found, and the newest one that the polls before the last one found.
    swept: Option<RangeInclusive<u64>>,
    odometries: Observer<Odometry>,
    truths: Queue<Truth>,
    poses: Queue<Pose>,
    obstacles: Queue<Obstacles>,
    commands: Queue<Command>,
    actuations: Queue<Actuation>,
    /// The newest of them without repetitions, including those of scans that were returned.
    recent: VecDeque<Actuation>,
    timeout_scans: u64,
    newest_scan: u64,
    answered_scan: u64,
    returned_scan: u64,
    known: Scans,
}

impl Samples {
    /// Starts observing a loop with this time between two scans [ns].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn new(bus: &Bus, period_ns: u64) -> Result<Self, RuntimeError> {
        // The truth last: an observer that joins a running loop receives all answers to the first scan that it sees.
        let (actuations, commands) = (Queue::new(bus)?, Queue::new(bus)?);
        let (obstacles, poses) = (Queue::new(bus)?, Queue::new(bus)?);
        Ok(Self {
            scans: Queue::new(bus)?,
            has_truth: true,
            swept: None,
            odometries: Observer::new(bus)?,
            truths: Queue::new(bus)?,
            poses,
            obstacles,
            commands,
            actuations,
            recent: VecDeque::with_capacity(RECENT),
            timeout_scans: TIMEOUT_SCANS.max(YOUNG_NS / period_ns.max(1) + 1),
            newest_scan: 0,
            answered_scan: 0,
            returned_scan: 0,
            known: Scans { period_ns, known: KnownScan::default(), refused: Vec::new() },
        })
    }

    /// The robot publishes no truth: scan and actuation complete a scan. For the time before the first sample.
    pub fn expect_no_truth(&mut self) {
        self.has_truth = false;
    }

    /// Connects to all writers: first to that of the truth, so that no scan is observed without it.
    pub fn connect(&self) {
        self.truths.observer.connect();
        self.scans.observer.connect();
        self.odometries.connect();
        self.poses.observer.connect();
        self.obstacles.observer.connect();
        self.commands.observer.connect();
        self.actuations.observer.connect();
    }

    /// Takes new samples from the bus, and passes them to the audit.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn poll(
        &mut self,
        directive: &Directive,
        sample_audit: &mut SampleAudit,
    ) -> Result<(), RuntimeError> {
        let Self { known, .. } = self;
        if directive.phase < Phase::Driving.wire() {
            known.known = KnownScan::start(monotonic_ns());
        }
        if let Some(oldest) = self.scans.waiting.front() {
            let first = self.swept.as_ref().map_or(oldest.header.scan_id, |swept| *swept.start());
            self.swept = Some(first..=self.scans.newest());
        }
        self.truths.poll(directive, sample_audit, known)?;
        poll(&self.odometries, directive, sample_audit, known, |_| ())?;
        // In reverse order of the data flow: when an answer has arrived, so have the samples that led to it.
        let before = self.actuations.waiting.len();
        self.actuations.poll(directive, sample_audit, known)?;
        self.actuations
            .waiting
            .iter()
            .skip(before)
            .for_each(|actuation| remember(&mut self.recent, actuation));
        self.commands.poll(directive, sample_audit, known)?;
        self.obstacles.poll(directive, sample_audit, known)?;
        self.poses.poll(directive, sample_audit, known)?;
        self.scans.poll(directive, sample_audit, known)?;
        for actuation in &self.actuations.waiting {
            if actuation.answers == 1 {
                self.answered_scan = self.answered_scan.max(actuation.header.scan_id);
            }
        }
        if self.has_truth {
            self.newest_scan = self.newest_scan.max(self.truths.newest());
        } else {
            // A truth that no one promised is not used.
            self.truths.waiting.clear();
            self.newest_scan = self.newest_scan.max(self.scans.newest()).max(self.answered_scan);
        }
        Ok(())
    }

    /// The scan from which on a robot that publishes its true state has published none, when so many scans have come
    /// without one that no delay explains it, or, with `is_stalled`, a single one: a truth is published before its scan.
    pub fn truth_missing(&self, is_stalled: bool) -> Option<u64> {
        let swept = self.swept.as_ref().filter(|_| self.has_truth)?;
        let newest = self.newest_scan.max(swept.start().saturating_sub(1));
        let enough = if is_stalled { 1 } else { self.timeout_scans };
        (*swept.end() >= newest.saturating_add(enough)).then_some(newest + 1)
    }

    /// The newest actuations without repetitions, oldest first.
    pub fn recent_actuations(&self) -> impl Iterator<Item = &Actuation> {
        self.recent.iter()
    }

    /// Scans with an invalid sample that would have counted, since the last call, and the rule that it failed.
    pub fn take_refused(&mut self) -> Vec<(u64, Rule)> {
        std::mem::take(&mut self.known.refused)
    }

    /// The newest scan published.
    pub fn newest_scan(&self) -> u64 {
        self.newest_scan
    }

    /// The newest truth, even if its scan is not complete.
    pub fn newest_truth(&self) -> Option<&Truth> {
        self.truths.waiting.back()
    }

    /// The newest scan answered.
    pub fn answered_scan(&self) -> u64 {
        self.answered_scan
    }

    /// The next complete scan; with `flush` also a scan without an answer.
    pub fn next(&mut self, flush: bool) -> Option<ScanRecord> {
        let first = self.first_waiting()?;
        let scan_id = first.scan_id;
        let answered = self.answered_scan >= scan_id;
        if !answered && !flush && self.newest_scan < scan_id + self.timeout_scans {
            return None;
        }
        self.returned_scan = scan_id;
        let swept = std::iter::from_fn(|| self.scans.pop_up_to(scan_id)).last();
        Some(ScanRecord {
            header: first,
            missing: swept.is_some_and(|swept| swept.header.scan_id == scan_id && swept.missing),
            truth: self.truths.waiting.pop_front(),
            poses: std::iter::from_fn(|| self.poses.pop_up_to(scan_id)).collect(),
            obstacles: std::iter::from_fn(|| self.obstacles.pop_up_to(scan_id)).collect(),
            commands: std::iter::from_fn(|| self.commands.pop_up_to(scan_id)).collect(),
            actuations: std::iter::from_fn(|| self.actuations.pop_up_to(scan_id)).collect(),
        })
    }

    /// The first scan that was not returned: by its truth; without one by the scan itself, or by its answer if the scan was
    /// not observed.
    fn first_waiting(&mut self) -> Option<Header> {
        if self.has_truth {
            return self.truths.waiting.front().map(|truth| truth.header);
        }
        let returned = self.returned_scan;
        while self.scans.pop_up_to(returned).is_some() {}
        let is_new = |actuation: &&Actuation| actuation.answers == 1 && actuation.header.scan_id > returned;
        let answered = self.actuations.waiting.iter().find(is_new).map(|actuation| actuation.header);
        let swept = self.scans.waiting.front().map(|swept| swept.header);
        swept.into_iter().chain(answered).min_by_key(|header| header.scan_id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_to_an_earlier_scan_that_comes_again_is_no_disobedience() {
        let header = |scan_id| Header { scan_id, ..Header::default() };
        let kind = ActuationKind::Drive.wire();
        let land = Command { kind: CommandKind::Land.wire(), header: header(39), ..Command::default() };
        let record = |scan_id| ScanRecord {
            header: header(39),
            truth: None,
            poses: Vec::new(),
            obstacles: Vec::new(),
            commands: vec![land],
            actuations: vec![Actuation { kind, answers: 1, header: header(scan_id), ..Actuation::default() }],
            missing: false,
        };
        assert!(record(39).is_disobeyed() && !record(38).is_disobeyed());
    }

    #[test]
    fn an_answer_that_drives_although_the_command_blocks_is_disobedient() {
        let command = |kind: CommandKind| Command { kind: kind.wire(), ..Command::default() };
        let actuation =
            |kind: ActuationKind, answers| Actuation { kind: kind.wire(), answers, ..Actuation::default() };
        let (drive, block) = (actuation(ActuationKind::Drive, 1), actuation(ActuationKind::Block, 1));
        let [stop, land, go] = [CommandKind::Stop, CommandKind::Land, CommandKind::Drive].map(command);
        assert!(is_disobedient(&[stop], &drive) && is_disobedient(&[land], &drive));
        assert!(!is_disobedient(&[stop], &block) && !is_disobedient(&[go], &drive));
        // In a swap both controllers answer, and the actuator one of them.
        assert!(!is_disobedient(&[stop, go], &drive));
        assert!(!is_disobedient(&[], &drive), "a command that was not seen may have driven");
        assert!(!is_disobedient(&[stop], &actuation(ActuationKind::Drive, 0)), "it repeats an older scan");
        let left = Command { velocity_mps: 0.5, steering_rad: 0.016, ..go };
        let straight = |velocity| Actuation { desired_velocity_mps: velocity, ..drive };
        assert!(deviates(&[left], &straight(0.5)) && !deviates(&[left, go], &straight(0.1)));
        assert!(deviates(&[go], &straight(0.21)) && !deviates(&[left], &block));
        assert!(!deviates(&[Command { steering_rad: 0.014, ..left }], &straight(0.0)), "slower is allowed");
    }
}
