//! One process of the simulated loop: a stage between its inputs and its writer.

use std::cell::Cell;

use shared_types::{
    AnySample, AnyStage, Authority, Directive, Fate, Header, Inbox, InboxArrival, InboxRules, KnownScan,
    Role, SampleType, StageEvent, StageShape, StageStamps, Stopwatch, Topic, YOUNG_NS,
};

use crate::wire::SampleBytes;

/// Scan periods after which a sample is too old.
const MAX_AGE_PERIODS: u64 = 3;

/// The end of a topic at its writer: numbers samples and completes their headers as the runtime does.
#[derive(Debug, Clone)]
pub struct SimulatedWriter {
    pub(crate) role: Role,
    pub(crate) incarnation: u32,
    pub(crate) sequence: u64,
    /// By how much later than now its samples are stamped [ns].
    pub(crate) later_ns: u64,
}

impl SimulatedWriter {
    /// The first process of a role, or another one.
    pub fn new(role: Role, incarnation: u32) -> Self {
        Self { role, incarnation, sequence: 0, later_ns: 0 }
    }

    /// Completes the header: layout, incarnation, number and stamps of the stage.
    pub fn complete(&mut self, of: &SampleType, sample: &mut [u8], now_ns: u64) {
        self.sequence += 1;
        let (header, now) = ((of.header_mut)(sample), now_ns + self.later_ns);
        (header.layout, header.incarnation, header.sequence) = (of.layout, self.incarnation, self.sequence);
        *header.stage_mut(self.role) =
            StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
    }
}

/// What the rules of all inputs depend on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LoopTime {
    pub(crate) now_ns: u64,
    pub(crate) period_ns: u64,
    pub(crate) is_lockstep: bool,
}

impl LoopTime {
    fn max_age_ns(&self) -> u64 {
        (MAX_AGE_PERIODS * self.period_ns).max(YOUNG_NS)
    }
}

/// The end of a topic at one of its readers.
#[derive(Debug, Clone)]
pub(crate) struct SimulatedInput {
    pub(crate) inbox: Inbox<SampleBytes>,
    /// When the newest sample came [ns].
    arrived_ns: u64,
    is_record: bool,
    known_scan: KnownScan,
}

impl SimulatedInput {
    pub(crate) fn new(role: Role, of: &'static SampleType) -> Self {
        let is_record = of.topic == Topic::Actuation && role != Role::Robot;
        Self { inbox: Inbox::new(of), arrived_ns: 0, is_record, known_scan: KnownScan::default() }
    }

    fn rules<'a>(
        &self,
        known_scan: &'a Cell<KnownScan>,
        authority: Authority,
        time: LoopTime,
    ) -> InboxRules<'a> {
        InboxRules {
            authority: Some(authority),
            known_scan,
            polled_ns: [self.arrived_ns, time.now_ns],
            now_ns: time.now_ns,
            period_ns: time.period_ns,
            max_age_ns: time.max_age_ns(),
            is_lockstep: time.is_lockstep,
            is_record: self.is_record,
        }
    }

    /// Takes in a sample.
    pub(crate) fn arrive(
        &mut self,
        sample: SampleBytes,
        authority: Authority,
        time: LoopTime,
    ) -> InboxArrival<SampleBytes> {
        let known_scan = Cell::new(self.known_scan);
        let arrival = self.inbox.arrive(sample, &self.rules(&known_scan, authority, time));
        self.known_scan = known_scan.get();
        if arrival.fault.is_none() || arrival.fate.is_some() {
            self.arrived_ns = time.now_ns;
        }
        arrival
    }

    /// Looks again at what was kept aside.
    pub(crate) fn review(&mut self, authority: Authority, time: LoopTime) {
        let known_scan = Cell::new(self.known_scan);
        let rules = self.rules(&known_scan, authority, time);
        self.inbox.review(&rules, |_| {});
        self.known_scan = known_scan.get();
    }
}

/// What is found when a sample arrives, like `not_finite` or `missing`.
pub(crate) fn finding(arrival: &InboxArrival<SampleBytes>) -> Option<&'static str> {
    match (&arrival.fault, arrival.fate) {
        (Some(fault), _) => Some(fault.rule().name()),
        (None, Some(Fate::Duplicate)) => Some("duplicate"),
        (None, Some(Fate::Reordered)) => Some("reordered"),
        (None, _) => arrival.is_after_gap.then_some("missing"),
    }
}

/// A process.
pub(crate) struct Node {
    pub(crate) stage: Box<dyn AnyStage>,
    shape: StageShape,
    pub(crate) writer: SimulatedWriter,
    answers: Vec<SimulatedInput>,
    notes: Vec<SimulatedInput>,
    later: Vec<SimulatedInput>,
    /// The scan of what was noted last.
    noted: u64,
    /// Samples of its inputs were dropped.
    is_dropped: bool,
}

impl Clone for Node {
    fn clone(&self) -> Self {
        Self {
            stage: self.stage.copy(),
            shape: self.shape,
            writer: self.writer.clone(),
            answers: self.answers.clone(),
            notes: self.notes.clone(),
            later: self.later.clone(),
            noted: self.noted,
            is_dropped: self.is_dropped,
        }
    }
}

/// Sees what a node does: the output of a turn, if there is one, and where to send it.
pub(crate) type Publish<'p> = dyn FnMut(&mut SimulatedWriter, &dyn AnyStage, Option<&mut [u8]>) + 'p;

impl Node {
    /// A process of this incarnation.
    pub(crate) fn new(stage: Box<dyn AnyStage>, incarnation: u32) -> Self {
        let shape = stage.shape();
        let inputs = |of: &[&'static SampleType]| {
            of.iter().map(|of| SimulatedInput::new(shape.role, of)).collect::<Vec<_>>()
        };
        let [answers, notes, later] = [shape.answers, shape.notes, shape.later].map(inputs);
        let writer = SimulatedWriter::new(shape.role, incarnation);
        Self { stage, shape, writer, answers, notes, later, noted: 0, is_dropped: false }
    }

    /// Its role.
    pub(crate) fn role(&self) -> Role {
        self.shape.role
    }

    /// Whether the wheels obey it.
    pub(crate) fn holds_wheels(&self) -> bool {
        self.shape.holds_wheels
    }

    /// Its inputs of a topic.
    pub(crate) fn inputs(&mut self, topic: Topic) -> impl Iterator<Item = &mut SimulatedInput> {
        let all = self.answers.iter_mut().chain(&mut self.notes).chain(&mut self.later);
        all.filter(move |input| input.inbox.of().topic == topic)
    }

    /// Takes in a sample; returns what is found.
    pub(crate) fn arrive(
        &mut self,
        of: &SampleType,
        sample: &SampleBytes,
        authority: Authority,
        time: LoopTime,
    ) -> Option<&'static str> {
        let (mut found, mut is_dropped) = (None, false);
        for input in self.inputs(of.topic) {
            let arrival = input.arrive(sample.clone(), authority, time);
            is_dropped |= arrival.fault.is_some();
            found = finding(&arrival);
        }
        self.is_dropped |= is_dropped;
        found
    }

    /// Takes in the orders of a directive, if its stage takes any.
    pub(crate) fn order(&mut self, directive: &Directive, now_ns: u64) {
        if self.shape.takes_orders {
            self.stage.take(AnySample::of(directive), now_ns);
        }
    }

    /// Does all that its inputs allow; whether it did something.
    pub(crate) fn step(
        &mut self,
        time: LoopTime,
        publish: &mut Publish<'_>,
        refuse: &mut dyn FnMut(&'static str),
    ) -> bool {
        let (now_ns, mut any) = (time.now_ns, false);
        if std::mem::take(&mut self.is_dropped) && self.stage.follow(StageEvent::Dropped) {
            self.publish(0, publish);
        }
        for input in &mut self.notes {
            while let Some(sample) = input.inbox.pop() {
                let sample = AnySample::new(input.inbox.of(), &sample);
                self.noted = sample.header().scan_id;
                self.stage.take(sample, now_ns);
                any = true;
            }
        }
        for input in &mut self.later {
            while let Some(sample) = input.inbox.pop_up_to(self.noted) {
                self.stage.take(AnySample::new(input.inbox.of(), &sample), now_ns);
                any = true;
            }
        }
        while let Some(samples) = self.take(time) {
            let mut scan_id = 0;
            for (input, sample) in self.answers.iter().zip(samples.iter().flatten()) {
                let sample = AnySample::new(input.inbox.of(), sample);
                self.stage.take(sample, now_ns);
                scan_id = sample.header().scan_id;
            }
            if let Some(fault) = self.stage.refusal() {
                refuse(fault.rule().name());
            }
            self.publish(scan_id, publish);
            any = true;
        }
        any
    }

    /// Lets a stage that holds the wheels look at its timeouts.
    pub(crate) fn poll(&mut self, now_ns: u64, publish: &mut Publish<'_>) {
        if self.shape.holds_wheels && self.stage.follow(StageEvent::Timer(now_ns)) {
            self.publish(0, publish);
        }
    }

    /// The samples of one scan that give an output.
    fn take(&mut self, time: LoopTime) -> Option<[Option<SampleBytes>; 2]> {
        match &mut *self.answers {
            [only] => only.inbox.pop().map(|sample| [Some(sample), None]),
            [one, other] => {
                // It takes no time to answer.
                let is_young =
                    |header: &Header| time.now_ns.saturating_sub(header.acquired_ns) < time.max_age_ns();
                let scan_id = one.inbox.joint_scan(&other.inbox, |_| true, is_young)?;
                let first = one.inbox.pop_scan(scan_id)?;
                Some([Some(first), Some(other.inbox.pop_scan(scan_id)?)])
            }
            _ => None,
        }
    }

    fn publish(&mut self, scan_id: u64, publish: &mut Publish<'_>) {
        let Self { stage, writer, .. } = self;
        let mut output: Option<Vec<u64>> = None;
        stage.publish(scan_id, &Stopwatch::standing(), &mut |bytes| {
            output = Some(bytemuck::cast_slice(bytes).to_vec());
        });
        publish(writer, &**stage, output.as_mut().map(|output| bytemuck::cast_slice_mut(output)));
    }
}
