//! `scanloop urg emulate`: a scanner for a try without hardware.

use anyhow::Context;
use console::exit::{Exit, Failure};
use console::note;
use console::output::data;
use runtime::{Shutdown, monotonic_ns};
use session::arguments::check_duration;
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
        for (_, fault) in faults.extract_if(.., |(at_s, _)| *at_s <= seconds()) {
            note!("{:.1} s: {}", seconds(), fault_name(fault));
            port.emulator.inject(fault, monotonic_ns());
        }
        port.serve(CHECK_NS, monotonic_ns)?;
    }
    Ok(Exit::Done)
}

/// The faults, with the time that some last [ms].
const FAULTS: [DeviceFault; 7] = [
    DeviceFault::Checksum,
    DeviceFault::HalfScan,
    DeviceFault::Stall(1_000),
    DeviceFault::Stuck,
    DeviceFault::Garbage(2_000),
    DeviceFault::Restart,
    DeviceFault::Backwards(5_000),
];

/// Its name in `--fault`.
fn fault_name(fault: DeviceFault) -> &'static str {
    match fault {
        DeviceFault::Checksum => "checksum",
        DeviceFault::HalfScan => "half-scan",
        DeviceFault::Stall(_) => "stall",
        DeviceFault::Stuck => "stuck",
        DeviceFault::Garbage(_) => "garbage",
        DeviceFault::Restart => "restart",
        DeviceFault::Backwards(_) => "backwards",
    }
}

/// When a fault happens [s], and which.
fn fault(text: &str) -> anyhow::Result<(f64, DeviceFault)> {
    let allowed = || {
        Failure::bad_input(format!(
            "--fault {text} is not allowed: {} and a time, as in stall@5.{}",
            FAULTS.map(fault_name).join(", "),
            did_you_mean(text.split('@').next().unwrap_or_default(), FAULTS.map(fault_name))
        ))
    };
    let (name, at_s) = text.split_once('@').ok_or_else(allowed)?;
    let at_s = at_s.parse().ok().filter(|at_s: &f64| (0.0..=1e9).contains(at_s)).ok_or_else(allowed)?;
    let fault = FAULTS.into_iter().find(|fault| fault_name(*fault) == name).ok_or_else(allowed)?;
    Ok((at_s, fault))
}
