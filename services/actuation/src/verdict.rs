//! Whether one command may move the wheels.

use shared_types::{BlockReason, Command, CommandKind, Fault, Level, Rule, SolveStatus, StopReason, finite};
use vehicle::bounds::ROUNDING;
use vehicle::{Bounds, Control};

/// Longest time from a scan to the first node of its plan [ns]: a plan that starts later, or before its scan, is another
/// scan's.
const MAX_PLAN_LEAD_NS: u64 = 1_000_000_000;

/// The content of a valid command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum DesiredCommand {
    /// Turn the wheels; the control is finite and within the limits.
    Drive(Control),
    /// Block the wheels.
    Block(BlockReason),
}

/// What a command demands, judged by its content alone, or the rule that it fails.
///
/// A command to stop or land needs no verification and no limits, but its numbers must be finite: if they are not, its
/// publisher is faulty, and the wheels are blocked for that reason.
pub(crate) fn judge(command: &Command, bounds: &Bounds) -> Result<DesiredCommand, Fault> {
    let kind = CommandKind::try_from(command.kind)?;
    Level::try_from(command.level)?;
    SolveStatus::try_from(command.status)?;
    let stop_reason = StopReason::try_from(command.reason)?;
    let desired = Control { velocity: command.velocity_mps, steering: command.steering_rad };
    finite("velocity_mps", &[desired.velocity])?;
    finite("steering_rad", &[desired.steering])?;
    if kind == CommandKind::Drive {
        require_own_plan(command)?;
    }
    match kind {
        CommandKind::Stop => Ok(DesiredCommand::Block(BlockReason::Commanded)),
        CommandKind::Land => Ok(DesiredCommand::Block(BlockReason::Landed)),
        CommandKind::Drive if command.verified != 1 => Err(Fault::NotVerified { value: command.verified }),
        // It contradicts itself: the reason to stop counts.
        CommandKind::Drive if stop_reason != StopReason::None => {
            Err(Fault::OutOfRange { field: "reason", value: f64::from(command.reason) })
        }
        CommandKind::Drive => within(desired, bounds).map(DesiredCommand::Drive),
    }
}

/// The control without the rounding beyond its limits; backwards, by those of the vehicle turned round.
fn within(desired: Control, bounds: &Bounds) -> Result<Control, Fault> {
    match bounds.mirrored().filter(|_| desired.velocity < 0.0) {
        Some(backwards) if backwards.contains(desired.mirrored(), ROUNDING) => {
            Ok(backwards.clamp(desired.mirrored()).mirrored())
        }
        None if bounds.contains(desired, ROUNDING) => Ok(bounds.clamp(desired)),
        backwards => Err(outside(desired, bounds, backwards)),
    }
}

/// Passes when the plan, if there is one, begins after the scan of the command: one that repeats an earlier command does
/// not.
fn require_own_plan(command: &Command) -> Result<(), Fault> {
    let acquired_ns = command.header.acquired_ns;
    let is_own =
        (acquired_ns..=acquired_ns.saturating_add(MAX_PLAN_LEAD_NS)).contains(&command.plan_start_ns);
    if command.plan_length == 0 || is_own {
        return Ok(());
    }
    let value = (command.plan_start_ns as f64 - acquired_ns as f64) * 1e-6;
    Err(Fault::OutOfRange { field: "plan_start_ms", value })
}

/// Which of the two is outside of its limits; `backwards` has those of a velocity backwards.
fn outside(desired: Control, bounds: &Bounds, backwards: Option<Bounds>) -> Fault {
    let Bounds { velocity_min_mps, velocity_max_mps, steering_max_rad, .. } = *bounds;
    let [velocity_min_mps, velocity_max_mps] = match backwards {
        Some(backwards) => [-backwards.velocity_max_mps, -velocity_min_mps],
        None => [velocity_min_mps, velocity_max_mps],
    };
    let velocities = velocity_min_mps - ROUNDING..=velocity_max_mps + ROUNDING;
    let (field, value, lowest, highest) = if velocities.contains(&desired.velocity) {
        ("steering_rad", desired.steering, -steering_max_rad, steering_max_rad)
    } else {
        ("velocity_mps", desired.velocity, velocity_min_mps, velocity_max_mps)
    };
    Fault::OutsideBounds { field, value, lowest, highest }
}

/// Why the wheels are blocked in answer to a command that fails a rule.
pub(crate) fn block_reason(fault: &Fault) -> BlockReason {
    match fault.rule() {
        Rule::TooOld | Rule::AnsweredBefore => BlockReason::StaleCommand,
        _ => BlockReason::InvalidCommand,
    }
}
