//! A swap of the controller for one of the same kind, by the state machine of the orchestrator.

use handover::swap::{
    Meant, OutputSummary, Party, RecordedScan, Swap, SwapAction, SwapEvent, SwapOutput, SwapPlan,
};
use pipeline::{SimulatedLoop, first_incarnation};
use shared_types::{Actuation, AnyStage, Authority, Command, Role, Sample};

/// Incarnation of the process that takes over.
const NEW: u32 = 6;
/// Its outputs are stamped so much later, by which they are told apart [ns].
const LATER_NS: u64 = 1_000;
/// Good scans before the change and after it, as `scanloop swap` has them by default.
const SHADOW_SCANS: u64 = 10;

/// What is seen of commands and of the actuator.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// Whose commands count.
    pub(super) authority: Authority,
    /// The incarnation of the controller that is not a candidate.
    pub(super) in_charge: u32,
    pub(super) is_swap: bool,
    /// Commands that have arrived since the last turn, and when [ns].
    pub(super) commands: Vec<(u64, Command)>,
    /// What the actuator has answered since then.
    pub(super) answered: Vec<RecordedScan>,
}

impl Default for Seen {
    fn default() -> Self {
        let in_charge = first_incarnation(Role::Controller);
        let authority = Authority { incarnation: in_charge, previous: 0, from_scan: 0 };
        Self { authority, in_charge, is_swap: false, commands: Vec::new(), answered: Vec::new() }
    }
}

impl Seen {
    /// Forgets what was seen before a swap.
    pub(super) fn begin(&mut self) {
        self.is_swap = true;
        self.commands.clear();
        self.answered.clear();
    }

    /// Notes an answer of the actuator.
    pub(super) fn record(&mut self, actuation: &Actuation) {
        if self.is_swap && actuation.answers == 1 {
            self.answered.push(RecordedScan {
                scan: actuation.header.scan_id,
                answers: 1,
                desired: [actuation.desired_steering_rad, actuation.desired_velocity_mps],
                stamp_ns: actuation.header.stage(Role::Controller).published_ns,
            });
        }
    }
}

/// The swap of a drive, at most one.
#[derive(Debug, Clone)]
pub(super) struct ControllerSwap {
    period_ns: u64,
    swap: Option<Swap>,
    /// Whether the new process is in charge for good.
    pub(super) is_swapped: bool,
}

impl ControllerSwap {
    pub(super) fn new(period_ns: u64) -> Self {
        Self { period_ns, swap: None, is_swapped: false }
    }

    /// Starts a new process from the state of the one in charge.
    pub(super) fn begin(&mut self, simulation: &mut SimulatedLoop) {
        let old = first_incarnation(Role::Controller);
        let Some(stage) = simulation.stage(old).map(AnyStage::copy) else { return };
        simulation.add(stage, NEW, LATER_NS);
        let plan = SwapPlan {
            role: Role::Controller,
            from: "nmpc".to_owned(),
            to: "nmpc".to_owned(),
            old,
            new: NEW,
            shadow_scans: SHADOW_SCANS,
            standby_scans: SHADOW_SCANS,
            tolerance: 1.0,
            meant: Meant::default(),
            period_ns: self.period_ns,
            lockstep: false,
            is_acknowledged: true,
        };
        self.swap = Some(Swap::new(simulation.now_ns(), plan));
    }

    /// Lets the swap decide, and carries out what it decides; true when the new process is refused.
    pub(super) fn turn(&mut self, simulation: &mut SimulatedLoop, seen: &mut Seen, answered: u64) -> bool {
        let (commands, recorded) = (std::mem::take(&mut seen.commands), std::mem::take(&mut seen.answered));
        let Some(swap) = &mut self.swap else { return false };
        let now_ns = simulation.now_ns();
        for (at_ns, command) in &commands {
            let party = if command.header.incarnation == NEW { Party::New } else { Party::Old };
            swap.handle(*at_ns, SwapEvent::Output(party, output(command)));
        }
        let mut actions =
            swap.handle(now_ns, SwapEvent::Scans { newest: simulation.next_scan() - 1, answered });
        for recorded in recorded {
            actions.extend(swap.handle(now_ns, SwapEvent::Recorded(recorded)));
        }
        actions.extend(swap.handle(now_ns, SwapEvent::Tick));
        let (mut is_over, mut is_refused) = (false, false);
        for action in actions {
            match action {
                SwapAction::Authorise(authority) => {
                    seen.authority = authority;
                    simulation.authorise(Role::Controller, authority);
                }
                SwapAction::KillNew => {
                    simulation.remove(NEW);
                    is_refused = true;
                }
                SwapAction::Commit => {
                    simulation.remove(first_incarnation(Role::Controller));
                    (self.is_swapped, seen.in_charge) = (true, NEW);
                }
                SwapAction::Finish(_) => is_over = true,
            }
        }
        if is_over {
            (self.swap, seen.is_swap) = (None, false);
            if !self.is_swapped && simulation.stage(NEW).is_some() {
                simulation.remove(NEW);
                is_refused = true;
            }
        }
        is_refused
    }
}

/// A command as the orchestrator sees it on the bus.
fn output(command: &Command) -> SwapOutput {
    let header = &command.header;
    let published_ns = header.stage(Role::Controller).published_ns;
    SwapOutput {
        scan: header.scan_id,
        sequence: header.sequence,
        scan_published_ns: header.scan_published_ns(),
        published_ns,
        compute_ns: 0,
        stamps_ns: [published_ns; 2],
        content: command.check().map(|()| OutputSummary::from(command)).map_err(|fault| fault.to_string()),
    }
}
