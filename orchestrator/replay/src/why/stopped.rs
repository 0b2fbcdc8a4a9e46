//! The number behind blocked wheels, with its limit.

use actuation::{ActuatorConfig, ActuatorStage};
use estimator::EstimatorStage;
use nmpc::{ControllerStage, StopNumber};
use shared_types::{Actuation, BlockReason, Command, Role, Stage, StopReason, Topic};

use super::{Seen, newest_in_period};
use crate::ReplayDrive;
use crate::drive::Lane;
use crate::stage::{Recomputed, lead};

/// The number that blocks the wheels in a scan; `None` where there is none, or it is not known.
pub(super) fn limit(drive: &ReplayDrive, seen: &Seen<'_>, decided_at: u64) -> Option<String> {
    let sent = seen.actuation.or_else(|| newest_in_period(drive, seen.scan)).filter(|sent| !sent.drives())?;
    match BlockReason::try_from(sent.reason).ok()? {
        BlockReason::Landed => of_controller(drive, StopReason::Landed, decided_at),
        BlockReason::Commanded => match StopReason::try_from(sent.stop_reason).ok()? {
            StopReason::SelfCheck => of_estimator(drive, decided_at),
            reason => of_controller(drive, reason, decided_at),
        },
        BlockReason::NoCommand => silence(drive, sent),
        BlockReason::StaleCommand => age(drive, sent),
        BlockReason::InvalidCommand => refused(drive, seen),
        _ => None,
    }
}

/// The stage of the process in charge, right after its output for a scan.
fn after<T: Recomputed>(drive: &ReplayDrive, lane: &Lane<T::Output>, scan: u64) -> Option<T>
where
    T::Settings: serde::de::DeserializeOwned,
{
    let process = drive.in_charge(lane, scan)?;
    lead::<T>((process, lane), drive, None, scan + 1).ok().map(|led| led.stage)
}

fn of_controller(drive: &ReplayDrive, reason: StopReason, scan: u64) -> Option<String> {
    let (pose, obstacles) = (drive.counted(&drive.poses, scan)?, drive.counted(&drive.obstacles, scan)?);
    let stage = after::<ControllerStage>(drive, &drive.commands, scan)?;
    let period_s = drive.period_ns as f64 * 1e-9;
    let StopNumber { what, value, unit, allowed, limit, id } =
        stage.controller().stop_number(reason, pose, obstacles, period_s)?;
    let of = if id > 0 { format!("obstacle {id}: ") } else { String::new() };
    Some(format!("{of}{what} {value:.3} {unit}, {allowed} {limit:.3} {unit}"))
}

fn of_estimator(drive: &ReplayDrive, scan: u64) -> Option<String> {
    let stage = after::<EstimatorStage>(drive, &drive.poses, scan)?;
    let (what, value, limit) = Stage::state(&stage)?.self_check.number()?;
    Some(format!("{what}: {value:.3}, at most {limit}"))
}

/// How long no valid command had come when the wheels were blocked for it.
fn silence(drive: &ReplayDrive, sent: &Actuation) -> Option<String> {
    let at_ns = |sent: &Actuation| sent.header.stage(Role::Actuator).published_ns;
    let counted = drive.actuations.samples.iter().filter(|sent| drive.counts(Role::Actuator, &sent.header));
    let mut until: Vec<&Actuation> = counted.filter(|other| at_ns(other) <= at_ns(sent)).collect();
    until.sort_by_key(|sent| at_ns(sent));
    // Since then the wheels are blocked.
    let first = until.into_iter().rev().take_while(|other| other.reason == sent.reason).last()?;
    let blocked_ns = at_ns(first);
    let published_ns = |command: &Command| command.header.stage(Role::Controller).published_ns;
    let commands = drive.commands.samples.iter().filter(|sent| drive.counts(Role::Controller, &sent.header));
    let last = commands
        .filter(|command| published_ns(command) < blocked_ns)
        .max_by_key(|sent| published_ns(sent))?;
    let config: ActuatorConfig = drive.settings.of_process(sent.header.incarnation, Role::Actuator).ok()?;
    let [since_ms, limit_ms] =
        [blocked_ns - published_ns(last), (config.timeout_periods * drive.period_ns as f64) as u64]
            .map(|ns| ns as f64 * 1e-6);
    Some(format!(
        "no command for {since_ms:.1} ms after that of scan {}, at most {limit_ms:.1} ms; {} in a row end it",
        last.header.scan_id, config.recovery
    ))
}

/// How old the scan behind a command was.
fn age(drive: &ReplayDrive, sent: &Actuation) -> Option<String> {
    let header = &sent.header;
    let config: ActuatorConfig = drive.settings.of_process(header.incarnation, Role::Actuator).ok()?;
    let age_ms = header.stage(Role::Actuator).taken_ns.saturating_sub(header.acquired_ns) as f64 * 1e-6;
    let limit_ms = (config.max_age_periods * drive.period_ns as f64 * 1e-6).max(25.0);
    Some(format!("age of the scan behind the command {age_ms:.1} ms, at most {limit_ms:.1} ms"))
}

/// The rule that the command of a scan fails: of its content, or that of the actuator.
fn refused(drive: &ReplayDrive, seen: &Seen<'_>) -> Option<String> {
    let kind = Topic::Command.sample_type();
    let content = seen.command.and_then(|command| (kind.check)(bytemuck::bytes_of(command)).err());
    let stage = after::<ActuatorStage>(drive, &drive.actuations, seen.scan.header.scan_id);
    let fault = content.or_else(|| Stage::refusal(&stage?).copied())?;
    Some(format!("the command is {fault}"))
}
