//! Whether one command may move the wheels.

use shared_types::{BlockReason, Command, CommandKind, Level, SolveStatus, StopReason};
use vehicle::{Bounds, Control};

/// How far desired values may be outside their hard limits [m/s, rad]: the rounding of a solver, no more.
pub(crate) const TOLERANCE: f64 = 1e-6;

/// What a valid command asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Wish {
    /// Turn the wheels; the control is finite and within the limits.
    Drive(Control),
    /// Block the wheels.
    Block(BlockReason),
}

/// What a command asks for, judged by its content alone, or `InvalidCommand`.
///
/// A command to stop or land needs no verification and no limits, but its numbers must be numbers: where they are
/// not, its producer is broken, and the wheels are blocked for that reason.
pub(crate) fn judge(command: &Command, bounds: &Bounds) -> Result<Wish, BlockReason> {
    let known = Level::try_from(command.level).is_ok()
        && SolveStatus::try_from(command.status).is_ok()
        && StopReason::try_from(command.reason).is_ok();
    let desired = Control { velocity: command.velocity_mps, steering: command.steering_rad };
    match CommandKind::try_from(command.kind) {
        Ok(kind) if known && desired.is_finite() => match kind {
            CommandKind::Stop => Ok(Wish::Block(BlockReason::Commanded)),
            CommandKind::Land => Ok(Wish::Block(BlockReason::Landed)),
            CommandKind::Drive if command.verified == 1 && bounds.contains(desired, TOLERANCE) => {
                Ok(Wish::Drive(bounds.clamp(desired)))
            }
            CommandKind::Drive => Err(BlockReason::InvalidCommand),
        },
        _ => Err(BlockReason::InvalidCommand),
    }
}
