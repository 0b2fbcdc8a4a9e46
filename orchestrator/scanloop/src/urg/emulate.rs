//! `scanloop urg emulate`: a scanner for a try without hardware.

use anyhow::Context;
use console::exit::{Exit, Failure};
use console::note;
use console::output::data;
use runtime::{Shutdown, monotonic_ns};
use session::arguments::check_duration;
use shared_types::did_you_mean;
use urg::{DeviceFault, Emulator, Port};

use super::arguments::EmulateArguments;

/// Longest wait between two checks for Ctrl-C [ns].
const CHECK_NS: u64 = 50_000_000;

/// Serves an emulated scanner until the end.
pub(super) fn emulate(arguments: &EmulateArguments) -> anyhow::Result<Exit> {
    check_duration(arguments.duration)?;
    let started_ns = monotonic_ns();
    let mut faults = arguments.fault.iter().map(|text| fault(text)).collect::<anyhow::Result<Vec<_>>>()?;
    let emulator = Emulator::in_a_room(started_ns);
    let (mut port, place) = match &arguments.tcp {
        Some(address) => {
            let refused = |error: std::io::Error| Failure::bad_input(format!("--tcp {address}: {error}"));
            let port = Port::tcp(address, emulator).map_err(refused)?;
            let place = port.address().map(|address| address.to_string()).unwrap_or_default();
            (port, place)
        }
        None => Port::terminal(emulator).context("pseudo terminal")?,
    };
    let shutdown = Shutdown::on_signals()?;
    data(&place)?;
    let seconds = || (monotonic_ns() - started_ns) as f64 * 1e-9;
    while !shutdown.requested() && arguments.duration.is_none_or(|duration| seconds() < duration) {
        for (_, name, fault) in faults.extract_if(.., |(at_s, ..)| *at_s <= seconds()) {
            note!("{:.1} s: {name}", seconds());
            port.emulator.inject(fault, monotonic_ns());
        }
        port.serve(CHECK_NS, monotonic_ns)?;
    }
    Ok(Exit::Done)
}

/// The faults by their names in `--fault`; some last so long [ms], or as many bytes.
const FAULTS: [(&str, DeviceFault); 7] = [
    ("checksum", DeviceFault::Checksum),
    ("half-scan", DeviceFault::HalfScan),
    ("stall", DeviceFault::Stall(1_000)),
    ("stuck", DeviceFault::Stuck),
    ("garbage", DeviceFault::Garbage(2_000)),
    ("restart", DeviceFault::Restart),
    ("backwards", DeviceFault::Backwards(5_000)),
];

/// When a fault happens [s], its name, and which.
fn fault(text: &str) -> anyhow::Result<(f64, &'static str, DeviceFault)> {
    let names = FAULTS.map(|(name, _)| name);
    let allowed = || {
        let meant = did_you_mean(text.split('@').next().unwrap_or_default(), names);
        let names = names.join(", ");
        Failure::bad_input(format!(
            "--fault {text} is not allowed: {names}, and a time, as in stall@5.{meant}"
        ))
    };
    let (name, at_s) = text.split_once('@').ok_or_else(allowed)?;
    let at_s = at_s.parse().ok().filter(|at_s: &f64| (0.0..=1e9).contains(at_s)).ok_or_else(allowed)?;
    let (name, fault) = FAULTS.into_iter().find(|(known, _)| *known == name).ok_or_else(allowed)?;
    Ok((at_s, name, fault))
}
