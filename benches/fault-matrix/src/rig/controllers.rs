//! The controller in charge, and in a swap the one that is to take its place.

use handover::swap::{
    Meant, OutputSummary, Party, RecordedScan, Swap, SwapAction, SwapEvent, SwapOutput, SwapPlan,
};
use nmpc::{Controller, ControllerConfig};
use shared_types::{Actuation, Authority, Command, Obstacles, Pose, Role, StopReason};
use vehicle::Invalid;

use super::{budget, content_of, incarnation, stop_reason};
use crate::reader::{Reader, join};
use crate::wire::{Wire, Writer};

/// Incarnation of the process that takes over.
const NEW: u32 = 6;
/// Its outputs are stamped so much later, by which they are told apart [ns].
const LATER_NS: u64 = 1_000;
/// Good scans before the change and after it, as `scanloop swap` has them by default.
const SHADOW_SCANS: u64 = 10;

/// The processes of the role.
#[derive(Debug, Clone)]
pub(super) struct Controllers {
    config: ControllerConfig,
    period_ns: u64,
    in_charge: Process,
    new: Option<Process>,
    swap: Option<Swap>,
    recorded: Vec<RecordedScan>,
}

/// One process: the stage and its ends.
#[derive(Debug, Clone)]
struct Process {
    controller: Controller,
    poses: Reader<Pose>,
    obstacles: Reader<Obstacles>,
    writer: Writer,
}

/// What a turn of the swap decided.
#[derive(Debug, Default)]
pub(super) struct Turn {
    /// Whose commands count from now on.
    pub(super) authority: Option<Authority>,
    /// Whether the new process was refused or rolled back.
    pub(super) is_refused: bool,
}

impl Process {
    fn new(config: ControllerConfig, incarnation: u32, period_ns: u64) -> Result<Self, Invalid> {
        Ok(Self {
            controller: Controller::new(config)?,
            poses: Reader::new(Role::Controller, period_ns),
            obstacles: Reader::new(Role::Controller, period_ns),
            writer: Writer::new(Role::Controller, incarnation),
        })
    }
}

impl Controllers {
    pub(super) fn new(config: ControllerConfig, period_ns: u64) -> Result<Self, Invalid> {
        let in_charge = Process::new(config.clone(), incarnation(Role::Controller), period_ns)?;
        Ok(Self { config, period_ns, in_charge, new: None, swap: None, recorded: Vec::new() })
    }

    /// Starts a new process from the state of the one in charge.
    pub(super) fn begin_swap(&mut self, now_ns: u64) {
        // The settings are those of the process in charge, which were allowed.
        let Ok(mut new) = Process::new(self.config.clone(), NEW, self.period_ns) else { return };
        new.controller.resume(&self.in_charge.controller.state());
        self.new = Some(new);
        let plan = SwapPlan {
            role: Role::Controller,
            from: "nmpc".to_owned(),
            to: "nmpc".to_owned(),
            old: incarnation(Role::Controller),
            new: NEW,
            shadow_scans: SHADOW_SCANS,
            standby_scans: SHADOW_SCANS,
            tolerance: 1.0,
            meant: Meant::default(),
            period_ns: self.period_ns,
            lockstep: false,
            is_acknowledged: true,
        };
        self.swap = Some(Swap::new(now_ns, plan));
    }

    pub(super) fn receive_pose(
        &mut self,
        pose: &Pose,
        now_ns: u64,
        authority: &Authority,
    ) -> Option<&'static str> {
        if let Some(new) = &mut self.new {
            new.poses.arrive(*pose, now_ns, authority);
        }
        self.in_charge.poses.arrive(*pose, now_ns, authority)
    }

    pub(super) fn receive_obstacles(
        &mut self,
        obstacles: &Obstacles,
        now_ns: u64,
        authority: &Authority,
    ) -> Option<&'static str> {
        if let Some(new) = &mut self.new {
            new.obstacles.arrive(*obstacles, now_ns, authority);
        }
        self.in_charge.obstacles.arrive(*obstacles, now_ns, authority)
    }

    /// Answers all scans whose inputs are there; whether there was one. `stops` gets the reasons of stops.
    pub(super) fn step(
        &mut self,
        now_ns: u64,
        wire: &mut Wire<Command>,
        mut stops: impl FnMut(StopReason),
    ) -> bool {
        let budget = budget(self.config.budget_iterations);
        let mut any = false;
        for process in [Some(&mut self.in_charge), self.new.as_mut()].into_iter().flatten() {
            while let Some((pose, obstacles)) = join(&mut process.poses, &mut process.obstacles, now_ns) {
                let mut command = process.controller.step(&pose, &obstacles, &budget);
                if let Some(reason) = stop_reason(&command) {
                    stops(reason);
                }
                let later_ns = if process.writer.incarnation == NEW { LATER_NS } else { 0 };
                process.writer.complete(&mut command, now_ns + later_ns);
                wire.send(command, now_ns, &mut process.writer);
                any = true;
            }
        }
        any
    }

    /// Shows a command on the bus to the swap.
    pub(super) fn observe(&mut self, now_ns: u64, command: &Command) {
        let Some(swap) = &mut self.swap else { return };
        let header = &command.header;
        let party = if header.incarnation == NEW { Party::New } else { Party::Old };
        let published_ns = header.stage(Role::Controller).published_ns;
        let output = SwapOutput {
            scan: header.scan_id,
            sequence: header.sequence,
            scan_published_ns: header.scan_published_ns(),
            published_ns,
            compute_ns: 0,
            stamps_ns: [published_ns; 2],
            content: content_of(command).map(|()| OutputSummary::from(command)),
        };
        swap.handle(now_ns, SwapEvent::Output(party, output));
    }

    /// Shows an answer of the actuator to the swap.
    pub(super) fn record(&mut self, command: &Command, actuation: &Actuation) {
        if self.swap.is_some() && actuation.answers == 1 {
            self.recorded.push(RecordedScan {
                scan: command.header.scan_id,
                answers: 1,
                desired: [actuation.desired_steering_rad, actuation.desired_velocity_mps],
                stamp_ns: command.header.stage(Role::Controller).published_ns,
            });
        }
    }

    /// Lets the swap decide, and carries out what it decides.
    pub(super) fn turn(&mut self, now_ns: u64, newest: u64, answered: u64) -> Turn {
        let mut turn = Turn::default();
        let Some(swap) = &mut self.swap else { return turn };
        let mut actions = swap.handle(now_ns, SwapEvent::Scans { newest, answered });
        for recorded in self.recorded.drain(..) {
            actions.extend(swap.handle(now_ns, SwapEvent::Recorded(recorded)));
        }
        actions.extend(swap.handle(now_ns, SwapEvent::Tick));
        let mut is_over = false;
        for action in actions {
            match action {
                SwapAction::Authorise(authority) => turn.authority = Some(authority),
                SwapAction::KillNew => (self.new, turn.is_refused) = (None, true),
                SwapAction::Commit => {
                    if let Some(new) = self.new.take() {
                        self.in_charge = new;
                    }
                }
                SwapAction::Finish(_) => is_over = true,
            }
        }
        if is_over {
            self.swap = None;
            turn.is_refused |= self.new.take().is_some();
        }
        turn
    }

    /// Whether the process that was started for a swap is in charge.
    pub(super) fn is_swapped(&self) -> bool {
        self.in_charge.writer.incarnation == NEW
    }
}
