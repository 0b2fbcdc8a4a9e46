//! The sample audit on a small model of the loop, with and without a hidden fault: thousands of runs.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, VecDeque};

use audit::ledger::{AUDITED_TOPICS, DeliveryFault, DeliveryFaultKind, SampleAudit};
use proptest::prelude::*;
use runtime::PROCESS_QUEUE;
use shared_types::{
    Actuation, Command, Fate, Header, Heartbeat, InputAccount, Obstacles, Odometry, Pose, ProcessState,
    QUEUE_DEPTH, Role, Sample, Scan, Topic, Truth,
};

const PERIOD_NS: u64 = 100_000_000;
/// Scans of a run with a hidden fault.
const SCANS: u64 = 50;

/// A fault that is hidden at one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Hidden {
    /// It gets a number and is not sent.
    Drop,
    /// It gets no number.
    Omit,
    /// It is sent twice under one number.
    Repeat,
    /// It is published twice under two numbers.
    Double,
    /// It is sent after the next one.
    Swap,
    /// It is published after the next one, numbers in the order of publication.
    Mix,
    /// It does not reach one of its readers.
    DropAt(usize),
    /// It reaches one of its readers twice.
    RepeatAt(usize),
    /// It reaches one of its readers after the next one.
    SwapAt(usize),
    /// One of its readers forgets it.
    ForgetAt(usize),
}

/// A disturbance of a run without faults.
#[derive(Debug, Clone, Copy)]
enum Event {
    /// The orchestrator does not poll for some scans.
    Away(u64),
    /// A process does not poll for some scans.
    Stall(usize, u64),
    /// A process sends no heartbeat for some scans.
    Mute(usize, u64),
    /// A process dies and is started again.
    Kill(usize),
}

struct Process {
    role: Role,
    incarnation: u32,
    busy_until: u64,
    mute_until: u64,
    looked_ns: u64,
    written: BTreeMap<Topic, u64>,
    taken: (u64, u64),
    answered: (u64, u64),
    newest: u64,
    inputs: Vec<Port>,
}

struct Port {
    topic: Topic,
    account: InputAccount,
    inbox: VecDeque<Header>,
    kept: VecDeque<Header>,
    late: Option<Header>,
}

/// Five processes and the orchestrator's view of them.
struct Model {
    sample_audit: SampleAudit,
    processes: Vec<Process>,
    bus: BTreeMap<Topic, VecDeque<Header>>,
    late: BTreeMap<Topic, Header>,
    held: BTreeMap<Topic, u64>,
    hidden: Option<(Topic, u64, Hidden)>,
    scan: u64,
    next_incarnation: u32,
    away_until: u64,
}

impl Process {
    fn new(role: Role, incarnation: u32) -> Self {
        let inputs = role.reads().iter().map(|topic| Port {
            topic: *topic,
            account: InputAccount::default(),
            inbox: VecDeque::new(),
            kept: VecDeque::new(),
            late: None,
        });
        Self {
            role,
            incarnation,
            busy_until: 0,
            mute_until: 0,
            looked_ns: 1,
            written: BTreeMap::new(),
            taken: (0, 0),
            answered: (0, 0),
            newest: 0,
            inputs: inputs.collect(),
        }
    }

    /// Takes all from the bus, then finds the scans it can work on: those for which it has all it waits for.
    fn work(&mut self, hidden: Option<(Topic, u64, Hidden)>) -> Vec<u64> {
        for port in &mut self.inputs {
            let (before, came) = (port.account, port.inbox.len());
            while let Some(header) = port.inbox.pop_front() {
                if let Some(fate) = port.account.arrive(&header) {
                    port.account.settle(fate, &header);
                } else {
                    if port.kept.len() == QUEUE_DEPTH {
                        let oldest = port.kept.pop_front().unwrap();
                        port.account.settle(Fate::Replaced, &oldest);
                    }
                    port.kept.push_back(header);
                }
            }
            if came >= PROCESS_QUEUE {
                port.account.overflowed_since(&before, PROCESS_QUEUE as u64, true);
            }
            let forgets = |header: &Header| {
                let me = Role::ALL.iter().position(|role| *role == self.role).unwrap();
                hidden == Some((port.topic, header.scan_id, Hidden::ForgetAt(me)))
            };
            port.kept.retain(|header| !forgets(header));
        }
        let joins = [Role::Obstacles, Role::Controller].contains(&self.role);
        if joins {
            let [one, other] = self.inputs.as_mut_slice() else { unreachable!() };
            let common = |scan: &u64| other.kept.iter().any(|header| header.scan_id == *scan);
            let Some(scan) = one.kept.iter().rev().map(|header| header.scan_id).find(common) else {
                return Vec::new();
            };
            for port in [one, other] {
                while port.kept.front().is_some_and(|header| header.scan_id < scan) {
                    let older = port.kept.pop_front().unwrap();
                    port.account.settle(Fate::Replaced, &older);
                }
                let used = port.kept.pop_front().unwrap();
                port.account.settle(Fate::Used, &used);
            }
            self.taken = (self.taken.0 + 1, self.taken.1 + scan);
            return vec![scan];
        }
        let mut scans = Vec::new();
        for port in &mut self.inputs {
            for header in std::mem::take(&mut port.kept) {
                port.account.settle(Fate::Used, &header);
                if self.role.answers() == Some(port.topic) {
                    self.taken = (self.taken.0 + 1, self.taken.1 + header.scan_id);
                    // A scan that comes again or too late is not answered.
                    if scans.last().copied().unwrap_or(self.newest) < header.scan_id {
                        scans.push(header.scan_id);
                    }
                }
            }
        }
        scans
    }

    fn heartbeat(&self, state: ProcessState, now_ns: u64) -> Heartbeat {
        let mut heartbeat = Heartbeat {
            role: self.role.wire(),
            state: state.wire(),
            issued_ns: now_ns,
            looked_ns: self.looked_ns,
            taken: self.taken.0,
            taken_scans: self.taken.1,
            answered: self.answered.0,
            answered_scans: self.answered.1,
            ..Heartbeat::default()
        };
        heartbeat.header.incarnation = self.incarnation;
        heartbeat.header.scan_id = self.newest;
        for (place, topic) in heartbeat.written.iter_mut().zip(self.role.writes()) {
            *place = self.written.get(topic).copied().unwrap_or(0);
        }
        for (place, port) in heartbeat.inputs.iter_mut().zip(&self.inputs) {
            *place = port.account;
            place.waiting = port.kept.len() as u64;
            place.waiting_sum = port.kept.iter().map(|header| header.sequence).sum();
        }
        heartbeat
    }
}

impl Model {
    fn new(hidden: Option<(Topic, u64, Hidden)>) -> Self {
        let mut model = Self {
            sample_audit: SampleAudit::new(false),
            processes: Role::ALL.iter().zip(1..).map(|(role, number)| Process::new(*role, number)).collect(),
            bus: BTreeMap::new(),
            late: BTreeMap::new(),
            held: BTreeMap::new(),
            hidden,
            scan: 0,
            next_incarnation: 6,
            away_until: 0,
        };
        for process in &model.processes {
            model.sample_audit.receive(&process.heartbeat(ProcessState::Connected, 1), 1);
        }
        model.sample_audit.driving();
        model
    }

    fn now_ns(&self) -> u64 {
        self.scan * PERIOD_NS
    }

    /// One scan, from the robot round to the robot.
    fn step(&mut self) {
        self.scan += 1;
        for topic in [Topic::Truth, Topic::Scan, Topic::Odometry] {
            self.publish(0, topic, self.scan);
        }
        for index in [1, 2, 3, 4, 0] {
            if self.processes[index].busy_until > self.scan {
                continue;
            }
            self.processes[index].looked_ns = self.now_ns();
            for scan in self.processes[index].work(self.hidden) {
                let topic = self.processes[index].role.writes()[0];
                self.publish(index, topic, scan);
            }
        }
        if self.away_until > self.scan {
            return;
        }
        self.poll();
        let now_ns = self.now_ns();
        for process in &self.processes {
            if process.busy_until <= self.scan && process.mute_until <= self.scan {
                self.sample_audit.receive(&process.heartbeat(ProcessState::Ready, now_ns), now_ns);
            }
        }
        if self.scan.is_multiple_of(10) {
            self.sample_audit.reconcile(false);
        }
    }

    /// One process publishes, rightly or not.
    fn publish(&mut self, index: usize, topic: Topic, scan: u64) {
        let hidden = self.hidden.filter(|(at, when, _)| (*at, *when) == (topic, scan)).map(|(.., what)| what);
        match hidden {
            Some(Hidden::Omit) => {}
            Some(Hidden::Mix) => {
                self.held.insert(topic, scan);
            }
            Some(Hidden::Double) => {
                self.number_and_send(index, topic, scan, hidden);
                self.number_and_send(index, topic, scan, hidden);
            }
            _ => self.number_and_send(index, topic, scan, hidden),
        }
        if hidden.is_some() {
            return;
        }
        if let Some(late) = self.late.remove(&topic) {
            self.send(late, topic, None);
        }
        if let Some(held) = self.held.remove(&topic) {
            self.number_and_send(index, topic, held, None);
        }
    }

    fn number_and_send(&mut self, index: usize, topic: Topic, scan: u64, hidden: Option<Hidden>) {
        let process = &mut self.processes[index];
        let sequence = process.written.entry(topic).or_default();
        *sequence += 1;
        let header = Header {
            incarnation: process.incarnation,
            sequence: *sequence,
            scan_id: scan,
            ..Header::default()
        };
        if process.role.writes()[0] == topic {
            process.newest = scan;
            if process.answered.0 < process.taken.0 {
                process.answered = (process.answered.0 + 1, process.answered.1 + scan);
            }
        }
        match hidden {
            Some(Hidden::Drop) => {}
            Some(Hidden::Swap) => {
                self.late.insert(topic, header);
            }
            Some(Hidden::Repeat) => {
                self.send(header, topic, None);
                self.send(header, topic, None);
            }
            other => self.send(header, topic, other),
        }
    }

    fn send(&mut self, header: Header, topic: Topic, hidden: Option<Hidden>) {
        push(self.bus.entry(topic).or_default(), header);
        for (reader, process) in self.processes.iter_mut().enumerate() {
            for port in process.inputs.iter_mut().filter(|port| port.topic == topic) {
                match hidden {
                    Some(Hidden::DropAt(at)) if at == reader => {}
                    Some(Hidden::SwapAt(at)) if at == reader => port.late = Some(header),
                    Some(Hidden::RepeatAt(at)) if at == reader => {
                        push(&mut port.inbox, header);
                        push(&mut port.inbox, header);
                    }
                    _ => {
                        push(&mut port.inbox, header);
                        port.late.take().into_iter().for_each(|late| push(&mut port.inbox, late));
                    }
                }
            }
        }
    }

    fn poll(&mut self) {
        let now_ns = self.now_ns();
        for topic in AUDITED_TOPICS {
            self.sample_audit.poll(topic, now_ns);
            let came = self.bus.remove(&topic).unwrap_or_default();
            came.iter().for_each(|header| see(&mut self.sample_audit, topic, *header, now_ns));
            if came.len() >= PROCESS_QUEUE {
                self.sample_audit.overflowed(topic, PROCESS_QUEUE);
            }
        }
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Away(scans) => self.away_until = self.scan + scans,
            Event::Stall(index, scans) => self.processes[index].busy_until = self.scan + scans,
            Event::Mute(index, scans) => self.processes[index].mute_until = self.scan + scans,
            Event::Kill(index) => {
                self.sample_audit.ended(self.processes[index].incarnation, self.now_ns());
                self.processes[index] = Process::new(self.processes[index].role, self.next_incarnation);
                self.next_incarnation += 1;
                let heartbeat = self.processes[index].heartbeat(ProcessState::Connected, self.now_ns());
                self.sample_audit.receive(&heartbeat, self.now_ns());
            }
        }
    }

    /// Ends the run and returns what was found.
    fn end(mut self) -> Vec<DeliveryFault> {
        self.sample_audit.run_ended();
        let now_ns = self.now_ns();
        for process in &self.processes {
            self.sample_audit.receive(&process.heartbeat(ProcessState::Ending, now_ns), now_ns);
        }
        self.poll();
        self.sample_audit.reconcile(true);
        let report = self.sample_audit.report();
        for row in &report.topics {
            let sum = row.used + row.replaced + row.lost + row.in_flight + row.residual;
            assert_eq!(row.published, sum, "{row:?}");
        }
        if report.faults.is_empty() {
            assert!(report.topics.iter().all(|row| row.residual == 0), "{report:?}");
        }
        report.faults
    }
}

/// Puts a sample into a buffer; one that is full of a writer's samples loses the oldest of them.
fn push(waiting: &mut VecDeque<Header>, header: Header) {
    let same = |other: &Header| other.incarnation == header.incarnation;
    if waiting.iter().filter(|other| same(other)).count() == PROCESS_QUEUE
        && let Some(oldest) = waiting.iter().position(same)
    {
        waiting.remove(oldest);
    }
    waiting.push_back(header);
}

fn see(sample_audit: &mut SampleAudit, topic: Topic, header: Header, now_ns: u64) {
    fn of<S: Sample + Default>(sample_audit: &mut SampleAudit, header: Header, now_ns: u64) {
        let mut sample = S::default();
        *sample.header_mut() = header;
        sample_audit.see(&sample, now_ns);
    }
    match topic {
        Topic::Scan => of::<Scan>(sample_audit, header, now_ns),
        Topic::Odometry => of::<Odometry>(sample_audit, header, now_ns),
        Topic::Pose => of::<Pose>(sample_audit, header, now_ns),
        Topic::Obstacles => of::<Obstacles>(sample_audit, header, now_ns),
        Topic::Command => of::<Command>(sample_audit, header, now_ns),
        Topic::Actuation => {
            sample_audit.see(&Actuation { header, answers: 1, ..Actuation::default() }, now_ns)
        }
        _ => of::<Truth>(sample_audit, header, now_ns),
    }
}

/// The processes that read a topic, by their place in [`Role::ALL`].
fn readers(topic: Topic) -> Vec<usize> {
    (0..Role::ALL.len()).filter(|index| Role::ALL[*index].reads().contains(&topic)).collect()
}

fn hidden() -> impl Strategy<Value = (Topic, u64, Hidden)> {
    (0..AUDITED_TOPICS.len(), 1..=SCANS, 0..10_usize, 0..2_usize).prop_map(|(topic, scan, what, reader)| {
        let topic = AUDITED_TOPICS[topic];
        let readers = readers(topic);
        let anywhere =
            [Hidden::Drop, Hidden::Omit, Hidden::Repeat, Hidden::Double, Hidden::Swap, Hidden::Mix];
        let what = match readers.get(reader % readers.len().max(1)) {
            Some(&at) => *[
                &anywhere[..],
                &[Hidden::DropAt(at), Hidden::RepeatAt(at), Hidden::SwapAt(at), Hidden::ForgetAt(at)],
            ]
            .concat()
            .get(what)
            .unwrap(),
            None => anywhere[what % anywhere.len()],
        };
        // What a reader lacks at the end was on its way; it takes an actuation with the next scan.
        let last = if anywhere.contains(&what) { SCANS } else { SCANS - 2 };
        (topic, scan.min(last), what)
    })
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        (1..40_u64).prop_map(Event::Away),
        (0..5_usize, 1..40_u64).prop_map(|(index, scans)| Event::Stall(index, scans)),
        (0..5_usize, 1..20_u64).prop_map(|(index, scans)| Event::Mute(index, scans)),
        (1..5_usize).prop_map(Event::Kill),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn whatever_is_hidden_is_found_and_named(
        hidden in hidden(),
        mute in prop::option::of((0..SCANS, 0..5_usize, 1..9_u64)),
    ) {
        let mut model = Model::new(Some(hidden));
        for scan in 0..SCANS {
            if let Some((at, index, scans)) = mute && at == scan {
                model.happen(Event::Mute(index, scans));
            }
            model.step();
        }
        let (topic, scan, what) = hidden;
        let faults = model.end();
        let kind = match what {
            Hidden::Drop | Hidden::Omit | Hidden::DropAt(_) => DeliveryFaultKind::Missing,
            // Nothing follows that it could come after.
            Hidden::Swap | Hidden::Mix if scan == SCANS => DeliveryFaultKind::Missing,
            Hidden::Repeat | Hidden::Double | Hidden::RepeatAt(_) => DeliveryFaultKind::Duplicate,
            Hidden::Swap | Hidden::Mix | Hidden::SwapAt(_) => DeliveryFaultKind::Reordered,
            Hidden::ForgetAt(_) => DeliveryFaultKind::Vanished,
        };
        prop_assert_eq!(faults.len(), 1, "{:?}", faults);
        prop_assert_eq!((faults[0].topic.as_str(), faults[0].kind, faults[0].scan_id), (topic.name(), kind, scan));
    }

    #[test]
    fn a_clean_run_is_never_suspected(events in prop::collection::vec((0..120_u64, event()), 0..6)) {
        let mut model = Model::new(None);
        for scan in 0..120 {
            for (at, event) in &events {
                if *at == scan {
                    model.happen(*event);
                }
            }
            model.step();
        }
        prop_assert_eq!(model.end(), vec![]);
    }
}
