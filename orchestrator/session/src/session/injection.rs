//! Faults that a command injects into the running system.

use faults::{ActiveFault, PERMIT_FILE, fault_file, live_names};
use runtime::{Domain, monotonic_ns};
use shared_types::{Role, did_you_mean};
use vehicle::text_of;

use super::candidates::Live;
use crate::control::Reply;

/// Longest time of a fault [s].
const MAX_S: f64 = 600.0;
/// The only implementation of the role robot that is no real robot.
const EMULATOR: &str = "emulator";

/// Tells the process of a fault of its fault, and returns the answer and a line for the user.
///
/// # Errors
/// A run without `--allow-inject`, a robot that is not emulated, an unknown fault or one that can't be injected live, with
/// those that can, and a time that is not allowed.
pub(super) fn inject<'a>(
    domain: &Domain,
    period_ns: u64,
    name: &str,
    for_s: Option<f64>,
    live: impl Fn(Role) -> Result<Live<'a>, String>,
) -> Result<(Reply, String), String> {
    if !domain.folder().contains(PERMIT_FILE) {
        return Err("this run takes no faults: start it with `scanloop run --allow-inject`".to_owned());
    }
    if live(Role::Robot)?.entry.implementation.as_deref() != Some(EMULATOR) {
        return Err("faults are injected with the emulated robot only".to_owned());
    }
    let names = live_names().unwrap_or_default();
    let known = || names.join(", ");
    let fault = faults::find(name).map_err(|error| error.to_string())?;
    let fault = fault.ok_or_else(|| {
        let meant = did_you_mean(name, names.iter().map(String::as_str));
        format!("fault `{name}` is unknown.{meant} Expected one of {}", known())
    })?;
    if let Some(reason) = fault.refused_live() {
        return Err(format!(
            "{name} can't be injected while the robot drives: {reason}; these can: {}",
            known()
        ));
    }
    let for_s = for_s.unwrap_or_else(|| fault.lasts_s(period_ns as f64 * 1e-9));
    // Whole milliseconds: three scans are not 0.30000000000000004 s.
    let for_s = (for_s * 1e3).round() / 1e3;
    if !(for_s > 0.0 && for_s <= MAX_S) {
        return Err(format!("--for {for_s} s is not allowed: above 0, up to {MAX_S} s"));
    }
    if let Some(role) = fault.acts_in() {
        let process = live(role)?;
        process.require_ready("for a fault")?;
        if process.entry.implementation.is_none() {
            return Err(format!("{name}: {role} is a program of your own, which does not take this fault"));
        }
        let until_ns = monotonic_ns() + (for_s * 1e9) as u64;
        let text = text_of(&ActiveFault { name: name.to_owned(), until_ns });
        let text = text.map_err(|error| error.to_string())?;
        let written = domain.folder().write(&fault_file(role), text.as_bytes());
        written.map_err(|error| error.to_string())?;
    }
    let text = format!("fault injected for {for_s} s: {name}: {} ({})", fault.title, fault.magnitude);
    Ok((Reply::Injected { for_s, orchestrator: std::process::id() }, text))
}
