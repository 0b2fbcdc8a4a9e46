//! `scanloop latency`: where the time of each scan goes, from the headers of the actuations on the bus.

use console::answer;
use console::exit::Exit;
use report::LatencyReport;
use report::latency::Latencies;
use report::summary::latency_table;
use runtime::{Bus, Observer, Shutdown, monotonic_ns, wait_for};
use session::arguments::check_duration;
use session::companion_delays;
use session::control::{Reply, Request, ask};
use shared_types::Actuation;

use crate::print_json;

/// Longest sleep between two polls; the buffer of 256 actuations lasts a quarter of a second at 1 kHz.
const POLL_NS: u64 = 20_000_000;
/// Time between two tables.
const TABLE_NS: u64 = 1_000_000_000;

/// Prints the latencies of each second, and those of the whole time at the end.
///
/// # Errors
/// A time that is not allowed or a system that is not running (exit code 2), and errors of the bus.
pub(crate) fn watch(system_id: &str, duration_s: f64, json: bool) -> anyhow::Result<Exit> {
    check_duration(Some(duration_s))?;
    let domain = &supervision::runs::existing(system_id)?;
    let Reply::Status(status) = ask(domain, &Request::Status)? else {
        anyhow::bail!("the orchestrator did not answer with a status");
    };
    let shutdown = Shutdown::on_signals()?;
    let bus = Bus::open(domain, "observer")?;
    let actuations = Observer::<Actuation>::new(&bus)?;
    let (mut all, mut second) = (Latencies::new(status.lockstep), Latencies::new(status.lockstep));
    let started = monotonic_ns();
    let end = started.saturating_add((duration_s * 1e9) as u64);
    let mut next = started + TABLE_NS;
    while monotonic_ns() < end && !shutdown.requested() {
        wait_for(&[shutdown.descriptor()], POLL_NS);
        actuations.poll(|actuation| {
            if actuation.answers == 1 {
                all.record(&actuation.header);
                second.record(&actuation.header);
            }
        })?;
        if monotonic_ns() >= next {
            next += TABLE_NS;
            if !answer!(json, "{}", latency_table(&second.report()))? {
                return Ok(Exit::Done);
            }
            second = Latencies::new(status.lockstep);
        }
    }
    let report = LatencyReport { companions: companion_delays(domain)?, ..all.report() };
    let table = latency_table(&report);
    answer!(json, "system {}, {}, whole time:\n{table}", status.system_id, status.scenario)?;
    print_json(json, &serde_json::json!({ "latency_us": report }))?;
    Ok(Exit::Done)
}
