//! The loop in simulated time: the stages of a run with the rules of its readers, and connections that may be faulty.
//!
//! A stage computes in no time. In lock-step there are no timeouts, and no sample is too old, as in a run in lock-step.
//! Else all is as in real time: the process that holds the wheels looks at its timeouts ten times per scan.

use emulator::{Emulator, Received};
use estimator::EstimatorStage;
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use shared_types::{
    Actuation, AnySample, AnyStage, Authority, Directive, GivenGoal, Header, Odometry, Role, SLOTS, Sample,
    Scan, Stage, TOPICS, Topic, Truth,
};
use vehicle::Invalid;

use crate::PipelineSettings;
use crate::node::{LoopTime, Node, SimulatedInput, SimulatedWriter, finding};
use crate::wire::{SampleBytes, Wire};

/// A stage that holds the wheels looks at its timeouts so many times per scan.
const POLLS: u64 = 10;

/// Watches a loop.
pub trait LoopWatch {
    /// The robot has measured; the headers are complete.
    fn measured(&mut self, _scan: &Scan, _odometry: &Odometry, _truth: &Truth) {}

    /// A process has used its inputs, or followed a timeout; its output with a complete header, if there is one.
    fn stepped(&mut self, _stage: &dyn AnyStage, _output: Option<AnySample<'_>>) {}

    /// A sample has arrived at its readers.
    fn arrived(&mut self, _sample: AnySample<'_>) {}

    /// A process found something wrong with a sample, like `not_finite`, or refuses it.
    fn found(&mut self, _role: Role, _incarnation: u32, _what: &'static str) {}
}

/// A robot and the processes of the other roles.
#[derive(Clone)]
pub struct SimulatedLoop {
    time: LoopTime,
    /// When the run began on the clock of the loop [ns].
    origin_ns: u64,
    next_scan: u64,
    emulator: Emulator,
    /// The goal that was set last.
    goal: GivenGoal,
    scans: SimulatedWriter,
    odometries: SimulatedWriter,
    truths: SimulatedWriter,
    robot: SimulatedInput,
    nodes: Vec<Node>,
    /// The ways of the topics, by number.
    wires: Vec<Wire>,
    /// The last part of the way of an actuation, behind the other readers.
    to_robot: Wire,
    authority: [Authority; SLOTS],
    /// The robot blocks its wheels for good.
    is_halted: bool,
    /// Way driven, and where the robot was then.
    way_m: f64,
    at_m: [f64; 2],
}

impl SimulatedLoop {
    /// A robot at its start, and four stages without any input yet.
    ///
    /// # Errors
    /// The first setting that is not allowed, with the table it stands in.
    pub fn new(settings: &PipelineSettings, is_lockstep: bool) -> Result<Self, Invalid> {
        let PipelineSettings { scenario, tuning, period_ns } = settings;
        let (tuning, period_ns) = (tuning.clone().for_scenario(scenario), *period_ns);
        let stages = [
            begin::<EstimatorStage>(tuning.estimator, period_ns)?,
            begin::<DetectorStage>(tuning.obstacles, period_ns)?,
            begin::<ControllerStage>(tuning.controller, period_ns)?,
            begin::<actuation::ActuatorStage>(tuning.actuator, period_ns)?,
        ];
        let emulator = Emulator::new(scenario, period_ns);
        let time = LoopTime { now_ns: 0, period_ns, is_lockstep };
        Ok(Self::of(emulator, stages.into(), time))
    }

    /// What another loop has driven so far, continued in lock-step: the robot and the four stages before the scan
    /// `next_scan`. The run began at `origin_ns` on the clock of that loop; `last` is what was published last on a topic.
    pub fn continued(
        emulator: Emulator,
        stages: Vec<Box<dyn AnyStage>>,
        period_ns: u64,
        origin_ns: u64,
        next_scan: u64,
        last: &dyn Fn(Topic) -> Option<Header>,
    ) -> Self {
        let now_ns = origin_ns + emulator.now_ns();
        let time = LoopTime { now_ns, period_ns, is_lockstep: true };
        let mut continued = Self { origin_ns, next_scan, ..Self::of(emulator, stages, time) };
        let robot = [&mut continued.scans, &mut continued.odometries, &mut continued.truths];
        let robot = robot.into_iter().zip([Topic::Scan, Topic::Odometry, Topic::Truth]);
        let nodes = continued.nodes.iter_mut().map(|node| {
            let topic = node.stage.shape().output.topic;
            (&mut node.writer, topic)
        });
        for (writer, topic) in robot.chain(nodes) {
            let Some(Header { incarnation, sequence, .. }) = last(topic) else { continue };
            (writer.incarnation, writer.sequence) = (incarnation, sequence);
            let authority = Authority { incarnation, previous: 0, from_scan: 0 };
            continued.authority[writer.role.index()] = authority;
        }
        continued
    }

    fn of(emulator: Emulator, stages: Vec<Box<dyn AnyStage>>, time: LoopTime) -> Self {
        let node = |stage: Box<dyn AnyStage>| {
            let incarnation = first_incarnation(stage.shape().role);
            Node::new(stage, incarnation)
        };
        let state = emulator.plant().state();
        let writer = || SimulatedWriter::new(Role::Robot, first_incarnation(Role::Robot));
        Self {
            time,
            origin_ns: 0,
            next_scan: 1,
            goal: GivenGoal::default(),
            at_m: [state.x, state.y],
            emulator,
            scans: writer(),
            odometries: writer(),
            truths: writer(),
            robot: SimulatedInput::new(Role::Robot, Actuation::TYPE),
            nodes: stages.into_iter().map(node).collect(),
            wires: TOPICS.map(|topic| Wire::new(topic.sample_type())).into(),
            to_robot: Wire::new(Actuation::TYPE),
            authority: std::array::from_fn(|slot| {
                Role::ALL.get(slot).copied().map_or_else(Authority::default, alone)
            }),
            is_halted: false,
            way_m: 0.0,
        }
    }

    /// Puts another stage in the place of the first one of its role.
    pub fn replace_stage(&mut self, stage: Box<dyn AnyStage>) {
        let role = stage.shape().role;
        if let Some(node) = self.nodes.iter_mut().find(|node| node.role() == role) {
            *node = Node::new(stage, first_incarnation(role));
        }
    }

    /// The next scan.
    pub fn next_scan(&self) -> u64 {
        self.next_scan
    }

    /// Now [ns].
    pub fn now_ns(&self) -> u64 {
        self.time.now_ns
    }

    /// When a scan is published [ns].
    pub fn scan_ready_ns(&self, scan_id: u64) -> u64 {
        self.origin_ns + self.emulator.scan_ready_ns(scan_id)
    }

    /// Way that the robot has driven [m].
    pub fn way_m(&self) -> f64 {
        self.way_m
    }

    /// True speed of the robot [m/s].
    pub fn speed_mps(&self) -> f64 {
        self.emulator.plant().speed()
    }

    /// The stage of a process.
    pub fn stage(&self, incarnation: u32) -> Option<&dyn AnyStage> {
        self.nodes.iter().find(|node| node.writer.incarnation == incarnation).map(|node| &*node.stage)
    }

    /// The way of the samples of a topic.
    pub fn wire(&mut self, topic: Topic) -> &mut Wire {
        &mut self.wires[topic as usize]
    }

    /// The last part of the way of an actuation, which only the robot sees.
    pub fn wire_to_robot(&mut self) -> &mut Wire {
        &mut self.to_robot
    }

    /// Puts another robot in the place of this one: where it is and what it has measured stays. False when it can't.
    pub fn replace_robot(&mut self, scenario: &emulator::Scenario) -> bool {
        let Some(state) = self.emulator.state(self.next_scan - 1) else { return false };
        let mut emulator = Emulator::new(scenario, self.time.period_ns);
        let continues = emulator.resume(&state).is_ok();
        if continues {
            self.emulator = emulator;
        }
        continues
    }

    /// The robot blocks its wheels, whatever the actuator commands.
    pub fn halt(&mut self) {
        self.is_halted = true;
        self.emulator.block_at_once();
    }

    /// Adds a process of a role beside the one in charge; its samples are stamped later by this [ns].
    pub fn add(&mut self, stage: Box<dyn AnyStage>, incarnation: u32, later_ns: u64) {
        let mut node = Node::new(stage, incarnation);
        node.writer.later_ns = later_ns;
        let behind = self.nodes.iter().rposition(|other| other.role() == node.role());
        self.nodes.insert(behind.map_or(self.nodes.len(), |index| index + 1), node);
    }

    /// Ends a process.
    pub fn remove(&mut self, incarnation: u32) {
        self.nodes.retain(|node| node.writer.incarnation != incarnation);
    }

    /// Whose samples of a role count; 0 is the first scan.
    pub fn authority(&self, role: Role) -> Authority {
        self.authority[role.index()]
    }

    /// Changes whose samples of a role count.
    pub fn authorise(&mut self, role: Role, authority: Authority) {
        self.authority[role.index()] = authority;
        for node in &mut self.nodes {
            for topic in TOPICS.into_iter().filter(|topic| topic.writer() == Some(role)) {
                node.inputs(topic).for_each(|input| input.review(authority, self.time));
            }
        }
    }

    /// Tells the stages that take orders who drives, what a person asks for and where to; the robot is told the goal.
    pub fn order(&mut self, directive: &Directive) {
        self.give(&directive.goal);
        for node in &mut self.nodes {
            node.order(directive, self.time.now_ns);
        }
    }

    /// Tells the robot a goal, which its truth shows from its scan on.
    pub fn give(&mut self, goal: &GivenGoal) {
        self.goal = *goal;
    }

    /// Goes to the next time at which something happens; true when that is a scan.
    pub fn move_on(&mut self) -> bool {
        let ready_ns = self.scan_ready_ns(self.next_scan);
        let mut next_ns = ready_ns;
        if !self.time.is_lockstep {
            let poll_ns = self.time.period_ns / POLLS;
            let arrivals = self.wires.iter().chain([&self.to_robot]).filter_map(Wire::next_ns);
            next_ns = arrivals.fold(ready_ns.min((self.time.now_ns / poll_ns + 1) * poll_ns), u64::min);
        }
        self.time.now_ns = next_ns.max(self.time.now_ns);
        self.emulator.advance_to(self.time.now_ns - self.origin_ns);
        let state = self.emulator.plant().state();
        self.way_m += (state.x - self.at_m[0]).hypot(state.y - self.at_m[1]);
        self.at_m = [state.x, state.y];
        self.time.now_ns >= ready_ns
    }

    /// Takes the next scan.
    pub fn measure(&mut self, watch: &mut dyn LoopWatch) {
        let (scan_id, now_ns) = (self.next_scan, self.time.now_ns);
        let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
        self.emulator.give(&self.goal, scan_id);
        self.emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        let acquired_ns = self.origin_ns.wrapping_add(self.emulator.stamp_ns(scan_id));
        for header in [&mut scan.header, &mut odometry.header, &mut truth.header] {
            *header = Header { scan_id, acquired_ns, ..Header::default() };
        }
        self.truths.complete(Truth::TYPE, bytemuck::bytes_of_mut(&mut truth), now_ns);
        self.scans.complete(Scan::TYPE, bytemuck::bytes_of_mut(&mut scan), now_ns);
        self.odometries.complete(Odometry::TYPE, bytemuck::bytes_of_mut(&mut odometry), now_ns);
        watch.measured(&scan, &odometry, &truth);
        let Self { wires, scans, odometries, .. } = self;
        wires[Topic::Scan as usize].send(bytemuck::bytes_of_mut(&mut scan), now_ns, |sample| {
            scans.complete(Scan::TYPE, sample, now_ns);
        });
        wires[Topic::Odometry as usize].send(bytemuck::bytes_of_mut(&mut odometry), now_ns, |sample| {
            odometries.complete(Odometry::TYPE, sample, now_ns);
        });
        self.next_scan += 1;
    }

    /// Hands over and answers samples until nothing more happens now.
    pub fn settle(&mut self, watch: &mut dyn LoopWatch) {
        while self.deliver(watch) || self.step(watch) {}
    }

    /// Hands samples that have arrived to their readers; whether there were any.
    fn deliver(&mut self, watch: &mut dyn LoopWatch) -> bool {
        let mut any = false;
        for topic in TOPICS {
            while let Some(sample) = self.wires[topic as usize].receive(self.time.now_ns) {
                self.hand_over(topic, &sample, watch);
                any = true;
            }
        }
        while let Some(sample) = self.to_robot.receive(self.time.now_ns) {
            let arrival = self.robot.arrive(sample, self.authority[Role::Actuator.index()], self.time);
            if let Some(what) = finding(&arrival) {
                watch.found(Role::Robot, first_incarnation(Role::Robot), what);
            }
            any = true;
        }
        any
    }

    fn hand_over(&mut self, topic: Topic, sample: &SampleBytes, watch: &mut dyn LoopWatch) {
        let Some(writer) = topic.writer() else { return };
        let (of, authority) = (topic.sample_type(), self.authority[writer.index()]);
        for node in &mut self.nodes {
            if let Some(what) = node.arrive(of, sample, authority, self.time) {
                watch.found(node.role(), node.writer.incarnation, what);
            }
        }
        watch.arrived(AnySample::new(of, sample));
        if topic == Topic::Actuation {
            let Self { nodes, to_robot, time, .. } = self;
            let mut writer = nodes.iter_mut().find(|node| node.holds_wheels()).map(|node| &mut node.writer);
            let mut bytes: Vec<u64> = bytemuck::cast_slice(sample).to_vec();
            to_robot.send(bytemuck::cast_slice_mut(&mut bytes), time.now_ns, |sample| {
                if let Some(writer) = &mut writer {
                    writer.complete(of, sample, time.now_ns);
                }
            });
        }
    }

    /// Lets each process do what its inputs allow; whether one did something.
    fn step(&mut self, watch: &mut dyn LoopWatch) -> bool {
        let mut any = false;
        while let Some(sample) = self.robot.inbox.pop() {
            any = true;
            if let Some(actuation) = AnySample::new(Actuation::TYPE, &sample).get()
                && !self.is_halted
                && self.emulator.actuate(actuation) == Received::Refused
            {
                watch.found(Role::Robot, first_incarnation(Role::Robot), "refused");
            }
        }
        let Self { nodes, wires, time, .. } = self;
        for node in nodes {
            let (role, incarnation) = (node.role(), node.writer.incarnation);
            let watch = std::cell::RefCell::new(&mut *watch);
            any |= node.step(
                *time,
                &mut |writer, stage, output| {
                    send(wires, *time, writer, stage, output, &mut **watch.borrow_mut())
                },
                &mut |what| watch.borrow_mut().found(role, incarnation, what),
            );
        }
        any
    }

    /// Lets the process that holds the wheels look at its timeouts.
    pub fn poll(&mut self, watch: &mut dyn LoopWatch) {
        let Self { nodes, wires, time, .. } = self;
        for node in nodes {
            node.poll(time.now_ns, &mut |writer, stage, output| {
                send(wires, *time, writer, stage, output, watch)
            });
        }
    }
}

/// Sends the output of a stage on its way.
fn send(
    wires: &mut [Wire],
    time: LoopTime,
    writer: &mut SimulatedWriter,
    stage: &dyn AnyStage,
    output: Option<&mut [u8]>,
    watch: &mut dyn LoopWatch,
) {
    let of = stage.shape().output;
    let Some(output) = output else { return watch.stepped(stage, None) };
    writer.complete(of, output, time.now_ns);
    watch.stepped(stage, Some(AnySample::new(of, output)));
    wires[of.topic as usize].send(output, time.now_ns, |sample| writer.complete(of, sample, time.now_ns));
}

/// A stage at its beginning.
fn begin<T: Stage<Invalid = Invalid>>(
    settings: T::Settings,
    period_ns: u64,
) -> Result<Box<dyn AnyStage>, Invalid> {
    let stage = T::begin(settings, period_ns).map_err(|error| error.within(T::ROLE.name()))?;
    Ok(Box::new(stage))
}

/// The incarnation of the first process of a role: the supervisor starts the roles from the actuator backwards.
pub const fn first_incarnation(role: Role) -> u32 {
    5 - role as u32
}

/// The first process of a role counts for all scans.
const fn alone(role: Role) -> Authority {
    Authority { incarnation: first_incarnation(role), previous: 0, from_scan: 0 }
}
