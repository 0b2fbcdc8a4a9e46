//! The last check before the wheels.
//!
//! A command passes when it is for a scan not answered before, its scan is young enough, and its content is valid
//! ([`crate::verdict`]); then it is corrected and sent. Anything else blocks the wheels, with the reason. A block ends
//! when its reason does:
//!
//! * commanded or landed: with the next command that passes;
//! * silence: after [`ActuatorConfig::recovery`] valid commands in a row without another silence, where commands that
//!   come within half a period count as one, because they were delayed together;
//! * gap, a silence because the scanner took no scan: with the next command that passes;
//! * refused: with the next command that passes; when the scan has no other, its refusal is a silence as well;
//! * paused: when the controller or a person drives, [`Actuator::obey`];
//! * released: with a command that a person asks for anew;
//! * explicit stop: with [`Actuator::release`] only.
//!
//! Who drives is told by the orchestrator. While a person does, only commands that state it turn the wheels, and only
//! for so long as what was given is fresh.
//!
//! The other way is driven from rest only: until blocked wheels have had the time to stop the robot, a command to drive
//! backwards after one to drive forwards is refused, and the reverse.
//!
//! Blocked wheels keep their steering angle, so that a robot which still turns its axles does not swerve while it
//! brakes. Assumption: `now_ns` and the stamps of commands are of one clock. If the clock jumps ahead, the wheels are
//! blocked for silence; if it jumps back, commands seem to come from the future and are refused.

use std::hint::black_box;

use shared_types::{
    Actuation, ActuationKind, BlockReason, Command, DrivenBy, Fault, GivenControl, Header, Level, StopReason,
    YOUNG_NS,
};
use vehicle::correction::{CommandCorrection, Correction, Linkage};
use vehicle::{Control, Invalid};

use crate::verdict::{DesiredCommand, block_reason, judge};
use crate::{ActuatorConfig, ActuatorState};

/// Decides what is sent to the robot.
#[derive(Debug, Clone)]
pub struct Actuator {
    config: ActuatorConfig,
    correction: CommandCorrection,
    period_ns: u64,
    timeout_ns: u64,
    max_age_ns: u64,
    state: ActuatorState,
    /// Why the last command was refused, if it was.
    refusal: Option<Fault>,
    /// Whether commands were dropped before they arrived, since the last valid one.
    dropped: bool,
}

impl Actuator {
    /// An actuator that has not been commanded yet, for scans every `period_ns`.
    ///
    /// # Errors
    /// [`Invalid`] when a setting is outside its range, or the period is not 1 ms to 10 s.
    pub fn new(config: ActuatorConfig, period_ns: u64) -> Result<Self, Invalid> {
        config.validate()?;
        if !(1_000_000..=10_000_000_000).contains(&period_ns) {
            return Err(Invalid::new("period_ns", period_ns, "1000000 to 10000000000"));
        }
        let periods = |count: f64| (count * period_ns as f64).round() as u64;
        Ok(Self {
            correction: config.calibration.correction(),
            timeout_ns: periods(config.timeout_periods),
            max_age_ns: periods(config.max_age_periods).max(YOUNG_NS),
            period_ns,
            config,
            state: ActuatorState::default(),
            refusal: None,
            dropped: false,
        })
    }

    /// The answer to a command at `now_ns`.
    ///
    /// `answers` is 1 once per scan. A command for a scan answered before, or for one that lies in the future, gets
    /// a block that the actuator decides by itself (`answers` = 0), because its header cannot be trusted.
    pub fn answer(&mut self, command: &Command, now_ns: u64) -> Actuation {
        let is_silence = self.state.commanded.is_set() && self.silence_ns(now_ns) > self.timeout_ns;
        let is_gap = is_silence && self.is_gap(&command.header, now_ns);
        if is_silence && !is_gap {
            self.state.silenced = true.into();
            self.state.streak = 0;
        }
        self.state.told_ns = now_ns;
        self.state.awake = true.into();
        self.state.turning = 0;

        self.refusal = None;
        if let Some(fault) = self.distrust(&command.header, now_ns) {
            self.refuse(fault);
            return self.block_by_itself(block_reason(&fault));
        }

        self.state.header = command.header.answer();
        let stop_reason = StopReason::try_from(command.reason).unwrap_or(StopReason::None);
        let age_ns = now_ns.saturating_sub(command.header.acquired_ns);
        let verdict = if age_ns > self.max_age_ns {
            Err(Fault::TooOld { age_ms: milliseconds(age_ns) })
        } else {
            judge(command, &self.config.vehicle.bounds).and_then(|desired| self.require_rest(desired, now_ns))
        };
        match verdict {
            Err(fault) => {
                self.refuse(fault);
                self.block(block_reason(&fault), stop_reason)
            }
            Ok(desired) => {
                self.accept(now_ns);
                self.state.gaps += u64::from(is_gap);
                let by_person = command.level == Level::Person.wire();
                let held = self.hold(by_person, now_ns);
                match desired {
                    DesiredCommand::Block(reason) => self.block(reason, stop_reason),
                    DesiredCommand::Drive(_) if self.state.silenced.is_set() => {
                        self.block(BlockReason::NoCommand, stop_reason)
                    }
                    DesiredCommand::Drive(desired) => match held {
                        Some(reason) => self.block(reason, stop_reason),
                        None => {
                            let driver = if by_person { DrivenBy::Person.wire() } else { 1 };
                            self.drive(desired, stop_reason, driver)
                        }
                    },
                }
            }
        }
    }

    /// Makes the next answer faster: answers the command that is expected `period_ns` after `last`, and puts the state
    /// back. What follows gives the same bits as without.
    pub fn rehearse(&mut self, last: &Command, period_ns: u64, now_ns: u64) {
        let before = (self.state, self.refusal, self.dropped);
        black_box(self.answer(&Command { header: last.header.next(period_ns), ..*last }, now_ns));
        (self.state, self.refusal, self.dropped) = before;
    }

    /// The rule that the last command failed, if it was refused.
    pub fn refusal(&self) -> Option<&Fault> {
        self.refusal.as_ref()
    }

    /// Notes that commands were dropped before they arrived: they are the reason for the silence that follows.
    pub fn note_dropped(&mut self) {
        self.dropped = true;
    }

    /// A block that the actuator decides by itself, when there has been no valid command for
    /// [`ActuatorConfig::timeout_periods`]; once per period while the silence lasts.
    ///
    /// The first call before any command starts the timeout.
    pub fn tick(&mut self, now_ns: u64) -> Option<Actuation> {
        if !self.state.awake.is_set() {
            self.state.awake = true.into();
            self.state.told_ns = now_ns;
            self.state.valid_ns = now_ns;
            return None;
        }
        if self.silence_ns(now_ns) <= self.timeout_ns {
            return self.look_at_driver(now_ns);
        }
        let reason = match self.state.commanded.is_set() {
            _ if self.dropped => BlockReason::InvalidCommand,
            true => BlockReason::NoCommand,
            false => BlockReason::Start,
        };
        if now_ns.saturating_sub(self.state.told_ns) < self.period_ns {
            return None;
        }
        self.state.told_ns = now_ns;
        self.state.turning = 0;
        Some(self.block_by_itself(reason))
    }

    /// The block when wheels turn that must not any more: the drive was paused, another drives, or the person who drives is
    /// silent.
    fn look_at_driver(&mut self, now_ns: u64) -> Option<Actuation> {
        let by_person = self.state.turning == DrivenBy::Person.wire();
        let reason = self.hold(by_person, now_ns).filter(|_| self.state.turning != 0)?;
        self.state.turning = 0;
        self.state.told_ns = now_ns;
        Some(self.block_by_itself(reason))
    }

    /// Whether the timeout runs: a command was answered, or [`Self::tick`] was called.
    pub fn is_awake(&self) -> bool {
        self.state.awake.is_set()
    }

    /// Blocks the wheels until [`Self::release`], whatever is commanded; for an emergency stop from outside, or because the
    /// user or the orchestrator asked for it.
    pub fn stop(&mut self, now_ns: u64, is_emergency: bool) -> Actuation {
        self.state.stopped = true.into();
        self.state.emergency = is_emergency.into();
        self.state.turning = 0;
        self.state.told_ns = now_ns;
        self.block_by_itself(BlockReason::StopRequested)
    }

    /// Who drives from now on, and what a person asks for.
    pub fn obey(&mut self, driven_by: u32, person: &GivenControl) {
        self.state.driven_by = driven_by;
        self.state.given_ns = if person.number == 0 { 0 } else { person.given_ns };
    }

    /// Ends an explicit stop: the next valid command drives again.
    pub fn release(&mut self) {
        self.state.stopped = false.into();
    }

    /// Whether an explicit stop holds.
    pub fn is_stopped(&self) -> bool {
        self.state.stopped.is_set()
    }

    /// What a restarted actuator resumes from.
    pub fn state(&self) -> ActuatorState {
        self.state
    }

    /// Continues from the state of another actuator. A stop that held there holds here.
    ///
    /// # Errors
    /// [`Fault`] when the state is not usable; the actuator is unchanged then.
    pub fn resume(&mut self, state: &ActuatorState) -> Result<(), Fault> {
        state.check(&self.config.vehicle.bounds)?;
        self.state = *state;
        Ok(())
    }

    fn silence_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.state.valid_ns)
    }

    /// Why a valid command must not turn the wheels, as another drives than it states; `None` where it may.
    fn hold(&self, by_person: bool, now_ns: u64) -> Option<BlockReason> {
        match DrivenBy::try_from(self.state.driven_by) {
            Ok(DrivenBy::Controller) if !by_person => None,
            Ok(DrivenBy::Person) if by_person && self.is_fresh(now_ns) => None,
            Ok(DrivenBy::Person) if by_person => Some(BlockReason::Released),
            _ => Some(BlockReason::Paused),
        }
    }

    /// Whether the person who drives has given a control lately.
    fn is_fresh(&self, now_ns: u64) -> bool {
        let age_ns = now_ns.saturating_sub(self.state.given_ns);
        self.state.given_ns != 0 && age_ns <= GivenControl::valid_ns(self.period_ns)
    }

    /// Whether the scanner explains a silence: the command answers the very next scan, and the scans are as far apart as
    /// the commands. Without a scan no process could command anything.
    fn is_gap(&self, header: &Header, now_ns: u64) -> bool {
        let last = &self.state.header;
        let apart_ns = header.acquired_ns.saturating_sub(last.acquired_ns);
        header.scan_id == last.scan_id.saturating_add(1)
            && self.silence_ns(now_ns) <= apart_ns + self.period_ns / 2
    }

    /// Why the header of a command cannot be trusted; `None` when it can.
    fn distrust(&mut self, header: &Header, now_ns: u64) -> Option<Fault> {
        if header.acquired_ns > now_ns.saturating_add(self.period_ns) {
            return Some(Fault::FromTheFuture { ahead_ms: milliseconds(header.acquired_ns - now_ns) });
        }
        let Header { scan_id: newest, acquired_ns, .. } = self.state.header;
        // Stamps ascend as scans do: the second in a row below the last one answered that was taken after it shows that
        // the number of that one was wrong.
        let is_doubt = header.scan_id < newest && header.acquired_ns > acquired_ns;
        let doubted = if is_doubt { header.scan_id } else { 0 };
        let before = std::mem::replace(&mut self.state.doubted, doubted);
        let passes = header.scan_id > newest || is_doubt && (1..header.scan_id).contains(&before);
        (!passes).then_some(Fault::AnsweredBefore { newest })
    }

    /// Passes a command unless it drives the other way while the robot may still roll.
    fn require_rest(&self, desired: DesiredCommand, now_ns: u64) -> Result<DesiredCommand, Fault> {
        let rolling_mps = self.state.velocity_mps;
        match desired {
            DesiredCommand::Drive(Control { velocity: value, .. })
                if value * rolling_mps < 0.0 && now_ns < self.state.rolls_until_ns =>
            {
                Err(Fault::StillRolling { value, rolling_mps })
            }
            _ => Ok(desired),
        }
    }

    /// Time in which blocked wheels stop the robot, from when the block is sent [ns].
    fn slide_ns(&self) -> u64 {
        let vehicle = &self.config.vehicle;
        let slide_s = self.state.velocity_mps.abs() / vehicle.blocked_deceleration_mps2;
        ((vehicle.command_delay_s + slide_s) * 1e9) as u64
    }

    fn refuse(&mut self, fault: Fault) {
        self.refusal = Some(fault);
        self.state.refused += 1;
        self.state.streak = 0;
    }

    fn accept(&mut self, now_ns: u64) {
        let is_apart = now_ns.saturating_sub(self.state.valid_ns) >= self.period_ns / 2;
        self.dropped = false;
        self.state.commanded = true.into();
        self.state.valid_ns = now_ns;
        if is_apart || self.state.streak == 0 {
            self.state.streak = self.state.streak.saturating_add(1);
        }
        if self.state.streak >= self.config.recovery {
            self.state.silenced = false.into();
        }
    }

    fn drive(&mut self, desired: Control, stop_reason: StopReason, driver: u32) -> Actuation {
        let linkage = Linkage { shaft: self.state.shaft_rad, wheels: self.state.wheels_rad };
        let Correction { velocity, steering, linkage } =
            self.correction.correct(&self.config.vehicle.bounds, desired, linkage);
        let sendable = velocity.is_finite() && steering.is_finite();
        if self.is_stopped() || !sendable {
            return self.block(BlockReason::InvalidCommand, stop_reason);
        }
        self.state.turning = driver;
        (self.state.velocity_mps, self.state.rolls_until_ns) = (desired.velocity, u64::MAX);
        self.state.steering_rad = desired.steering;
        self.state.sent_steering_rad = steering;
        (self.state.shaft_rad, self.state.wheels_rad) = (linkage.shaft, linkage.wheels);
        let velocities = [desired.velocity, velocity];
        self.actuation(ActuationKind::Drive, BlockReason::None, stop_reason, velocities)
    }

    /// Blocked wheels that answer no command.
    fn block_by_itself(&mut self, reason: BlockReason) -> Actuation {
        Actuation { answers: 0, ..self.block(reason, StopReason::None) }
    }

    /// Blocked wheels in answer to a command; an explicit stop is named before any other reason.
    fn block(&mut self, reason: BlockReason, stop_reason: StopReason) -> Actuation {
        let rests_ns = self.state.told_ns.saturating_add(self.slide_ns());
        self.state.rolls_until_ns = self.state.rolls_until_ns.min(rests_ns);
        let reason = match DrivenBy::try_from(self.state.driven_by) {
            _ if self.is_stopped() && self.state.emergency.is_set() => BlockReason::EmergencyStop,
            _ if self.is_stopped() => BlockReason::StopRequested,
            Ok(DrivenBy::Nobody) => BlockReason::Paused,
            _ => reason,
        };
        self.actuation(ActuationKind::Block, reason, stop_reason, [0.0; 2])
    }

    /// The answer to the last command, with the velocities desired and sent and the last steering angles.
    fn actuation(
        &self,
        kind: ActuationKind,
        reason: BlockReason,
        stop_reason: StopReason,
        [desired_velocity_mps, sent_velocity_mps]: [f64; 2],
    ) -> Actuation {
        Actuation {
            header: self.state.header,
            kind: kind.wire(),
            reason: reason.wire(),
            stop_reason: stop_reason.wire(),
            answers: 1,
            desired_velocity_mps,
            desired_steering_rad: self.state.steering_rad,
            sent_velocity_mps,
            sent_steering_rad: self.state.sent_steering_rad,
            refused: self.state.refused,
            gaps: self.state.gaps,
            driven_by: self.state.driven_by,
            reserved: 0,
        }
    }
}

fn milliseconds(time_ns: u64) -> f64 {
    time_ns as f64 * 1e-6
}

#[cfg(test)]
mod tests;
