//! The decision of the controller in one scan, decided again with something changed.

use anyhow::Context;
use nmpc::{ControllerConfig, ControllerStage};
use shared_types::{AnySample, Command, CommandKind, Obstacles, Pose, Role, Stage, StopReason, Stopwatch};

use super::Alternative;
use crate::ReplayDrive;
use crate::stage::{Recomputed, lead};

/// Reasons that place, speed and margin have a part in.
const OF_THE_PLACE: [StopReason; 5] = [
    StopReason::None,
    StopReason::Blocked,
    StopReason::Unverified,
    StopReason::NoSafeSpeed,
    StopReason::Covered,
];
/// A range is tried at so many places, then the first part of it with another decision is halved so often: 128 steps.
const PLACES: u32 = 8;
const HALVINGS: u32 = 4;
/// Largest clearance that is tried [m], and longest time on the way [s].
const MAX_CLEARANCE_M: f64 = 0.5;
const MAX_TIME_S: f64 = 2.0;

/// The controller before a scan, and what it then got.
pub(super) struct Decision {
    stage: ControllerStage,
    config: ControllerConfig,
    pose: Pose,
    obstacles: Obstacles,
    command: Command,
    period_ns: u64,
}

/// Changes of a decision.
#[derive(Debug, Clone, Copy)]
struct Changed {
    clearance_m: f64,
    /// On its way by so much, negative for back [s].
    moved_s: f64,
}

impl Decision {
    /// The decision of a scan.
    ///
    /// # Errors
    /// Why it can't be decided again.
    pub(super) fn of(drive: &ReplayDrive, scan: u64) -> anyhow::Result<Self> {
        let command = drive.counted(&drive.commands, scan).context("the controller gave no command")?;
        let process = command.header.incarnation;
        let stage = lead::<ControllerStage>((process, &drive.commands), drive, None, scan)?.stage;
        let pose = drive.counted(&drive.poses, scan).context("no pose was recorded")?;
        let obstacles = drive.counted(&drive.obstacles, scan).context("no obstacles were recorded")?;
        let config = drive.settings.of_process(process, Role::Controller)?;
        let (pose, obstacles, command) = (*pose, *obstacles, *command);
        Ok(Self { stage, config, pose, obstacles, command, period_ns: drive.period_ns })
    }

    fn unchanged(&self) -> Changed {
        Changed { clearance_m: self.config.clearance_m, moved_s: 0.0 }
    }

    /// Whether the robot drives with a change; `None` where the controller refuses it.
    fn drives(&self, changed: Changed) -> Option<bool> {
        let Changed { clearance_m, moved_s } = changed;
        let config = ControllerConfig { clearance_m, ..self.config.clone() };
        let mut stage = self.stage.with_settings(config, self.period_ns, 0).ok()?;
        let mut pose = self.pose;
        let way_m = moved_s * pose.speed_mps;
        for (x, y, yaw) in [
            (&mut pose.x_m, &mut pose.y_m, pose.yaw_rad),
            (&mut pose.predicted_x_m, &mut pose.predicted_y_m, pose.predicted_yaw_rad),
        ] {
            (*x, *y) = (*x + way_m * yaw.cos(), *y + way_m * yaw.sin());
        }
        Stage::take(&mut stage, AnySample::of(&pose), 0);
        Stage::take(&mut stage, AnySample::of(&self.obstacles), 0);
        let command = stage.output(pose.header.scan_id, &Stopwatch::standing())?;
        Some(command.kind == CommandKind::Drive.wire())
    }
}

/// What would have changed the decision, by bisection: other clearance, earlier or later on its way.
pub(super) fn changes(decision: &Decision) -> Vec<Alternative> {
    let drove = decision.command.kind == CommandKind::Drive.wire();
    let is_of_the_place = OF_THE_PLACE.iter().any(|reason| decision.command.reason == reason.wire());
    let same = decision.unchanged();
    // In real time the budget may have ended it.
    if !is_of_the_place || decision.drives(same) != Some(drove) {
        return Vec::new();
    }
    let flips = |changed: Changed| decision.drives(changed) == Some(!drove);
    let speed_mps = decision.pose.predicted_speed_mps.abs();
    let at_clearance = |clearance_m| Changed { clearance_m, ..same };
    let clearance = nearest(same.clearance_m, if drove { MAX_CLEARANCE_M } else { 0.0 }, |value| {
        flips(at_clearance(value))
    });
    let sign = if drove { 1.0 } else { -1.0 };
    let moved = |time_s: f64| Changed { moved_s: sign * time_s, ..same };
    let time = if speed_mps > 0.05 { nearest(0.0, MAX_TIME_S, |value| flips(moved(value))) } else { None };
    let by_time = if drove { "later_s" } else { "earlier_s" };
    [("controller.clearance_m", clearance), (by_time, time)]
        .into_iter()
        .filter_map(|(by, value)| Some(Alternative { by, value: value?, drives: !drove }))
        .collect()
}

/// The value nearest to `from` that flips, towards `to`: of a few places the first that does, and the part before it halved.
fn nearest(from: f64, to: f64, flips: impl Fn(f64) -> bool) -> Option<f64> {
    let place = |index: u32| from + (to - from) * f64::from(index) / f64::from(PLACES);
    let first = (1..=PLACES).filter(|_| from != to).find(|index| flips(place(*index)))?;
    let (mut keeps, mut found) = (place(first - 1), place(first));
    for _ in 0..HALVINGS {
        let between = f64::midpoint(keeps, found);
        if flips(between) { found = between } else { keeps = between }
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_value_that_is_found_flips_and_one_nearer_by_the_resolution_does_not() {
        for (from, to, limit) in [(0.05, 0.5, 0.21), (1.0, 0.0, 0.37)] {
            let flips = |value: f64| if to > from { value >= limit } else { value <= limit };
            let found = nearest(from, to, flips).unwrap();
            assert!(flips(found) && (found - limit).abs() <= (from - to).abs() / 128.0, "{found}");
        }
        // The far end need not flip.
        assert_eq!(nearest(0.0, 1.0, |value| (0.3..0.6).contains(&value)), Some(0.3046875));
        assert_eq!(nearest(0.0, 1.0, |_| false), None);
        assert_eq!(nearest(0.0, 0.0, |_| true), None);
    }
}
