//! `scanloop urg emulate`: a scanner for a try without hardware.

use std::io;

use anyhow::Context;
use console::exit::{Exit, Failure};
use console::note;
use console::output::data;
use runtime::{Shutdown, monotonic_ns};
use session::arguments::check_duration;
use shared_types::did_you_mean;
use urg::{DeviceFault, Port, ScannerEmulator};

use super::arguments::{EmulateArguments, EmulatedModel};

/// Longest wait between two checks for Ctrl-C [ns].
const CHECK_NS: u64 = 50_000_000;

/// Serves an emulated scanner until the end.
pub(super) fn emulate(arguments: &EmulateArguments) -> anyhow::Result<Exit> {
    check_duration(arguments.duration)?;
    let started_ns = monotonic_ns();
    let mut faults = arguments.fault.iter().map(|text| fault(text)).collect::<anyhow::Result<Vec<_>>>()?;
    let emulator = match arguments.model {
        EmulatedModel::Urg04lx => ScannerEmulator::in_a_room(started_ns),
        EmulatedModel::Ust10lx => ScannerEmulator::ust_10lx_in_a_room(started_ns),
    };
    let (mut port, place) = match &arguments.tcp {
        Some(address) => {
            let refused = |error| Failure::bad_input(format!("--tcp {address}: {}", refusal(&error)));
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

/// Why an address can't be used, and what can.
fn refusal(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::AddrInUse => "the port is in use; name another one, or 0 for any free one".to_owned(),
        io::ErrorKind::AddrNotAvailable => {
            "not an address of this machine; allowed: 127.0.0.1, 0.0.0.0 or one of its own".to_owned()
        }
        _ => format!("{error}; expected HOST:PORT, for example 127.0.0.1:0"),
    }
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
        let name = text.split('@').next().unwrap_or_default();
        let meant = if names.contains(&name) { String::new() } else { did_you_mean(name, names) };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_can_not_be_used_is_refused_with_one_that_can() {
        let refused = |address: &str| {
            let arguments = EmulateArguments {
                tcp: Some(address.to_owned()),
                model: EmulatedModel::Urg04lx,
                fault: Vec::new(),
                duration: Some(0.001),
            };
            emulate(&arguments).unwrap_err().to_string()
        };
        let held = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = held.local_addr().unwrap().to_string();
        let advice = "the port is in use; name another one, or 0 for any free one";
        assert_eq!(refused(&address), format!("--tcp {address}: {advice}"));
        assert!(refused("192.0.2.1:7000").contains("not an address of this machine"));
        assert!(refused("nonsense").ends_with("expected HOST:PORT, for example 127.0.0.1:0"));
    }
}
