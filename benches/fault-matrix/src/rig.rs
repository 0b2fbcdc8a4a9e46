//! The simulated loop of `services/pipeline` with a fault in it, its judge, and a swap of the controller.
//!
//! The stages, the rules of readers, the authority filter and the state machine of a swap are the shipped ones.
//! Connections may carry a fault. A stage computes in no time; without a fault each scan gives the bits of
//! [`pipeline::Pipeline`], which a test compares. The actuator is polled ten times per scan, as its process is.
//!
//! What is not modelled: processes that die or hang, and their supervisor. Such cells run with real processes.

mod inject;
mod judge;
mod person;
mod swap;

use emulator::{Outcome, Referee, Scenario};
use pipeline::{PipelineSettings, SimulatedLoop};
use shared_types::{Actuation, AnyStage, Truth};
use vehicle::Invalid;

use self::judge::Judge;
use self::person::Person;
use self::swap::ControllerSwap;
use crate::finding::{FindingPlace, Findings};

/// A scan is published this much after the time from which a fault acts on it [ns].
const LEAD_NS: u64 = 1_000;

/// All stages, their connections, and the judge of the drive.
#[derive(Clone)]
pub struct Rig {
    simulation: SimulatedLoop,
    judge: Judge,
    swap: ControllerSwap,
    person: Option<Person>,
    scenario: Scenario,
    period_ns: u64,
    referee: Referee,
    /// The robot as it was before a fault, and when it is so again.
    repaired: Option<(u64, Scenario)>,
    outcome: Option<Outcome>,
    /// Whether the robot has seen the stop word.
    is_halted: bool,
}

impl Rig {
    /// A robot at its start, and four stages without any input yet.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn new(settings: &PipelineSettings) -> Result<Self, Invalid> {
        let PipelineSettings { scenario, period_ns, .. } = settings;
        let simulation = SimulatedLoop::new(settings, false)?;
        Ok(Self {
            judge: Judge::new(*period_ns),
            swap: ControllerSwap::new(*period_ns),
            person: None,
            simulation,
            scenario: scenario.clone(),
            period_ns: *period_ns,
            referee: Referee::new(scenario),
            repaired: None,
            outcome: None,
            is_halted: false,
        })
    }

    /// The same with another stage in the place of the one of its role.
    #[must_use]
    pub fn with(mut self, stage: Box<dyn AnyStage>) -> Self {
        self.simulation.replace_stage(stage);
        self
    }

    /// Runs until the next scan was answered, as far as it is answered at once; returns the outcome once there is one.
    pub fn scan(&mut self) -> Option<Outcome> {
        let scan_id = self.simulation.next_scan();
        while self.simulation.next_scan() == scan_id && self.outcome.is_none() {
            self.advance();
        }
        self.outcome
    }

    /// The truth of the last scan.
    pub fn truth(&self) -> &Truth {
        &self.judge.truth
    }

    /// The newest actuation.
    pub fn actuation(&self) -> Option<&Actuation> {
        self.judge.actuation.as_ref()
    }

    /// What was found.
    pub fn findings(&mut self) -> &mut Findings {
        &mut self.judge.findings
    }

    /// Now, and the way driven until now.
    pub fn place(&self) -> FindingPlace {
        FindingPlace { at_ns: self.simulation.now_ns(), way_m: self.simulation.way_m() }
    }

    /// How the drive ended, as text.
    pub fn reason(&self) -> &str {
        self.referee.reason()
    }

    /// Requests that the controller be replaced by another one of the same kind.
    pub fn begin_swap(&mut self) {
        self.judge.seen.begin();
        self.swap.begin(&mut self.simulation);
    }

    /// Whether the new controller of a swap is in charge for good.
    pub fn is_swapped(&self) -> bool {
        self.swap.is_swapped
    }

    /// Lets a person drive, who hands back after so many scans.
    pub fn take_over(&mut self, hands_back: u64) {
        self.person = Some(Person::new(hands_back));
    }

    /// Goes to the next time at which something happens, and lets it happen.
    fn advance(&mut self) {
        let is_scan = self.simulation.move_on();
        self.judge.place = self.place();
        if is_scan {
            if let Some(directive) =
                self.person.as_mut().and_then(|person| person.asks(self.simulation.now_ns()))
            {
                self.simulation.order(&directive);
            }
            self.simulation.measure(&mut self.judge);
        }
        self.simulation.settle(&mut self.judge);
        self.judge.is_poll = true;
        self.simulation.poll(&mut self.judge);
        self.judge.is_poll = false;
        self.turn_swap();
        self.simulation.settle(&mut self.judge);
        let now_ns = self.simulation.now_ns();
        if !self.is_halted && self.judge.halted_ns.is_some_and(|halted_ns| now_ns >= halted_ns) {
            self.is_halted = true;
            self.simulation.halt();
        }
        if self.is_halted && self.simulation.speed_mps() == 0.0 {
            self.outcome = Some(Outcome::Failed);
        } else if is_scan {
            self.outcome = self.referee.observe(&self.judge.truth, self.judge.actuation.as_ref());
            let next_scan = self.simulation.next_scan();
            if let Some((scan_id, scenario)) = self.repaired.take_if(|(scan_id, _)| *scan_id <= next_scan)
                && !self.simulation.replace_robot(&scenario)
            {
                self.repaired = Some((scan_id, scenario));
            }
        }
    }

    /// Lets the state machine of a swap decide.
    fn turn_swap(&mut self) {
        let answered = self.judge.actuation.map_or(0, |actuation| actuation.header.scan_id);
        if self.swap.turn(&mut self.simulation, &mut self.judge.seen, answered) {
            self.judge.findings.note("orchestrator", "swap_refused", self.judge.place);
        }
    }
}
