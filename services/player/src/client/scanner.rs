//! A Hokuyo scanner at this computer, beside a base at the server: read by a thread of its own.

use runtime::monotonic_ns;
use shared_types::Scan;
use urg::{Place, Source, UrgError};

use super::{Event, Outlet};
use crate::Config;

/// Longest time in one call [ns].
const WAIT_NS: u64 = 20_000_000;

/// Hands the scans over until the driver ends, or until the scanner can't be used. The crate `urg` connects again by itself.
pub(super) fn read(config: &Config, rate_hz: f64, outlet: &Outlet) {
    if let Err(error) = follow(config, rate_hz, outlet) {
        tracing::error!(%error, "the scanner can't be used: there are no scans");
    }
}

fn follow(config: &Config, rate_hz: f64, outlet: &Outlet) -> Result<(), UrgError> {
    let place = Place::parse(&config.urg)?;
    let mut source =
        Source::open(urg::Config { rate_hz: Some(rate_hz), ..urg::Config::new(place) }, monotonic_ns);
    let (mut scan, mut state) = (Scan::default(), source.state());
    while !outlet.is_ended() {
        if source.next(WAIT_NS, &mut scan)?.is_some() {
            outlet.offer(Event::Scan {
                ranges_mm: scan.ranges_mm,
                front_ns: scan.header.acquired_ns,
                sweep_ns: scan.sweep_ns,
                arrived_ns: monotonic_ns(),
            });
        }
        if source.state() != state {
            state = source.state();
            tracing::info!(state = state.name(), message = source.message(), "scanner");
        }
    }
    Ok(())
}
