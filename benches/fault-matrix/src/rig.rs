//! The loop of `services/pipeline` in simulated time, with the readers, timeouts and dead man of the live system.
//!
//! The stages, the rules of readers, the authority filter and the state machine of a swap are the shipped ones. Between
//! two stages stands a [`Wire`], which may carry a fault. A stage computes in no time; without a fault each scan gives
//! the bits of `pipeline`, which a test compares. The actuator is polled ten times per scan, as its process is.
//!
//! What is not modelled: processes that die or hang, and their supervisor. Such cells run with real processes.

mod controllers;
mod inject;
mod stages;

use actuation::Actuator;
use emulator::{Emulator, Outcome, Referee, Scenario};
use estimator::Estimator;
use nmpc::Budget;
use obstacles::ObstacleDetector;
use pipeline::PipelineSettings;
use shared_types::{
    Actuation, Authority, Command, Header, Obstacles, Odometry, Pose, Role, Sample, Scan, StopReason, Truth,
};
use vehicle::Invalid;

use self::controllers::Controllers;
use crate::finding::{FindingPlace, Findings};
use crate::reader::Reader;
use crate::wire::{Wire, Writer};

/// The actuator looks at its timeouts so many times per scan.
const POLLS: u64 = 10;
/// Commands that are kept to compare the actuations with.
const COMMANDS: usize = 8;
/// From an actuation that disobeys its command to the wheels that the robot blocks by the stop word, in scan periods: a
/// turn of the orchestrator, and what the robot takes at most.
const HALT_PERIODS: f64 = 1.2;
/// A scan is published this much after the time from which a fault acts on it [ns].
const LEAD_NS: u64 = 1_000;

/// All stages, their connections, and the judge of the drive.
#[derive(Debug, Clone)]
pub struct Rig {
    period_ns: u64,
    now_ns: u64,
    next_scan: u64,
    scenario: Scenario,
    emulator: Emulator,
    estimator: Estimator,
    detector: ObstacleDetector,
    controllers: Controllers,
    actuator: Actuator,
    referee: Referee,
    ends: Ends,
    wires: Wires,
    authority: Authority,
    /// Notes what is found.
    pub findings: Findings,
    truth: Truth,
    actuation: Option<Actuation>,
    /// Way driven, and where the robot was then.
    way_m: f64,
    at_m: [f64; 2],
    /// The robot as it was before a fault, and when it is so again.
    repaired: Option<(u64, Scenario)>,
    /// What the estimator had refused, and how often it had restarted.
    refused: [u64; 4],
    outcome: Option<Outcome>,
    /// The newest commands that count.
    commands: Vec<Command>,
    /// Scans in a row in which the actuator turned the wheels otherwise than commanded.
    deviating: u32,
    /// When the robot sees the stop word that the orchestrator has overwritten [ns].
    halted_ns: Option<u64>,
    /// Whether it has.
    is_halted: bool,
}

/// Writing and reading ends of the stages; those of the controllers are theirs.
#[derive(Debug, Clone)]
struct Ends {
    scans: Writer,
    odometries: Writer,
    poses: Writer,
    obstacles: Writer,
    actuations: Writer,
    to_estimator: (Reader<Odometry>, Reader<Actuation>),
    to_detector: (Reader<Scan>, Reader<Pose>),
    to_actuator: Reader<Command>,
    to_robot: Reader<Actuation>,
}

#[derive(Debug, Clone, Default)]
struct Wires {
    scan: Wire<Scan>,
    odometry: Wire<Odometry>,
    pose: Wire<Pose>,
    obstacles: Wire<Obstacles>,
    command: Wire<Command>,
    actuation: Wire<Actuation>,
    /// The last part of the way of an actuation, behind the other readers.
    to_robot: Wire<Actuation>,
}

impl Rig {
    /// A robot at its start, and four stages without any input yet.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn new(settings: &PipelineSettings) -> Result<Self, Invalid> {
        let PipelineSettings { scenario, tuning, period_ns } = settings;
        let (tuning, period_ns) = (tuning.clone().for_scenario(scenario), *period_ns);
        let writer = |role: Role| Writer::new(role, incarnation(role));
        Ok(Self {
            emulator: Emulator::new(scenario, period_ns),
            estimator: Estimator::new(&tuning.estimator)?,
            detector: ObstacleDetector::new(tuning.obstacles)?,
            controllers: Controllers::new(tuning.controller, period_ns)?,
            actuator: Actuator::new(tuning.actuator, period_ns)?,
            referee: Referee::new(scenario),
            ends: Ends {
                scans: writer(Role::Robot),
                odometries: writer(Role::Robot),
                poses: writer(Role::Estimator),
                obstacles: writer(Role::Obstacles),
                actuations: writer(Role::Actuator),
                to_estimator: (
                    Reader::new(Role::Estimator, period_ns),
                    Reader::new(Role::Estimator, period_ns),
                ),
                to_detector: (
                    Reader::new(Role::Obstacles, period_ns),
                    Reader::new(Role::Obstacles, period_ns),
                ),
                to_actuator: Reader::new(Role::Actuator, period_ns),
                to_robot: Reader::new(Role::Robot, period_ns),
            },
            wires: Wires::default(),
            authority: alone(Role::Controller),
            period_ns,
            now_ns: 0,
            next_scan: 1,
            scenario: scenario.clone(),
            findings: Findings::default(),
            truth: Truth::default(),
            actuation: None,
            way_m: 0.0,
            at_m: [scenario.start.x_m, scenario.start.y_m],
            repaired: None,
            refused: [0; 4],
            outcome: None,
            commands: Vec::with_capacity(COMMANDS),
            deviating: 0,
            halted_ns: None,
            is_halted: false,
        })
    }

    /// Runs until the next scan was answered, as far as it is answered at once; returns the outcome once there is one.
    pub fn scan(&mut self) -> Option<Outcome> {
        let scan_id = self.next_scan;
        while self.next_scan == scan_id && self.outcome.is_none() {
            self.advance();
        }
        self.outcome
    }

    /// The truth of the last scan.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// The newest actuation.
    pub fn actuation(&self) -> Option<&Actuation> {
        self.actuation.as_ref()
    }

    /// The next scan.
    pub fn next_scan(&self) -> u64 {
        self.next_scan
    }

    /// Now, and the way driven until now.
    pub fn place(&self) -> FindingPlace {
        FindingPlace { at_ns: self.now_ns, way_m: self.way_m }
    }

    /// How the drive ended, as text.
    pub fn reason(&self) -> &str {
        self.referee.reason()
    }

    /// Requests that the controller be replaced by another one of the same kind.
    pub fn begin_swap(&mut self) {
        self.controllers.begin_swap(self.now_ns);
    }

    /// Whether the new controller of a swap is in charge for good.
    pub fn is_swapped(&self) -> bool {
        self.controllers.is_swapped()
    }

    /// Goes to the next time at which something happens, and lets it happen.
    fn advance(&mut self) {
        let poll_ns = self.period_ns / POLLS;
        let ready_ns = self.emulator.scan_ready_ns(self.next_scan);
        let next_poll_ns = (self.now_ns / poll_ns + 1) * poll_ns;
        let arrivals = [
            self.wires.scan.next_ns(),
            self.wires.odometry.next_ns(),
            self.wires.pose.next_ns(),
            self.wires.obstacles.next_ns(),
            self.wires.command.next_ns(),
            self.wires.actuation.next_ns(),
            self.wires.to_robot.next_ns(),
        ];
        let next_ns = arrivals.into_iter().flatten().fold(ready_ns.min(next_poll_ns), u64::min);
        self.now_ns = next_ns.max(self.now_ns);
        self.emulator.advance_to(self.now_ns);
        let state = self.emulator.plant().state();
        self.way_m += (state.x - self.at_m[0]).hypot(state.y - self.at_m[1]);
        self.at_m = [state.x, state.y];
        let is_scan = self.now_ns >= ready_ns;
        if is_scan {
            self.measure();
        }
        while self.deliver() || self.step() {}
        self.poll_actuator();
        self.turn_swap();
        while self.deliver() || self.step() {}
        if !self.is_halted && self.halted_ns.is_some_and(|halted_ns| self.now_ns >= halted_ns) {
            self.is_halted = true;
            self.emulator.block_at_once();
        }
        if self.is_halted && self.emulator.plant().speed() <= 0.0 {
            self.outcome = Some(Outcome::Failed);
        } else if is_scan {
            self.outcome = self.referee.observe(&self.truth, self.actuation.as_ref());
            if let Some((scan_id, scenario)) =
                self.repaired.take_if(|(scan_id, _)| *scan_id <= self.next_scan)
                && !self.replace_robot(&scenario)
            {
                self.repaired = Some((scan_id, scenario));
            }
        }
    }

    fn measure(&mut self) {
        let scan_id = self.next_scan;
        let (mut scan, mut odometry) = (Scan::default(), Odometry::default());
        self.emulator.measure(scan_id, &mut scan, &mut odometry, &mut self.truth);
        let acquired_ns = self.emulator.stamp_ns(scan_id);
        for header in [&mut scan.header, &mut odometry.header, &mut self.truth.header] {
            *header = Header { scan_id, acquired_ns, ..Header::default() };
        }
        self.ends.scans.complete(&mut scan, self.now_ns);
        self.wires.scan.send(scan, self.now_ns, &mut self.ends.scans);
        self.ends.odometries.complete(&mut odometry, self.now_ns);
        self.wires.odometry.send(odometry, self.now_ns, &mut self.ends.odometries);
        if self.truth.dead_man == 1 {
            self.note(Role::Robot, "dead_man");
        }
        self.next_scan += 1;
    }

    /// Lets the state machine of a swap decide.
    fn turn_swap(&mut self) {
        let answered = self.actuation.map_or(0, |actuation| actuation.header.scan_id);
        let turn = self.controllers.turn(self.now_ns, self.next_scan - 1, answered);
        if let Some(authority) = turn.authority {
            self.authority = authority;
            self.ends.to_actuator.review(self.now_ns, &authority);
        }
        if turn.is_refused {
            self.findings.note("orchestrator", "swap_refused", self.place());
        }
    }

    fn note(&mut self, role: Role, what: &'static str) {
        self.findings.note(role.name(), what, self.place());
    }

    fn note_some(&mut self, role: Role, what: Option<&'static str>) {
        if let Some(what) = what {
            self.note(role, what);
        }
    }
}

/// The incarnation of the first process of a role, as in a run: the roles are started from the actuator backwards.
const fn incarnation(role: Role) -> u32 {
    5 - role as u32
}

/// The first process of a role counts for all scans.
const fn alone(role: Role) -> Authority {
    Authority { incarnation: incarnation(role), previous: 0, from_scan: 0 }
}

/// The budget of the solver in simulated time.
fn budget(iterations: u32) -> Budget<'static> {
    Budget::Iterations(iterations)
}

/// Whether a command asks for a stop, and why.
fn stop_reason(command: &Command) -> Option<StopReason> {
    StopReason::try_from(command.reason).ok().filter(|reason| *reason != StopReason::None)
}

/// What a reader finds wrong with a sample as it is on the bus.
fn content_of(command: &Command) -> Result<(), String> {
    command.check().map_err(|fault| fault.to_string())
}
