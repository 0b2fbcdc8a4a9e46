//! A scanner that a command has opened.

use console::exit::Failure;
use console::note;
use runtime::{Shutdown, monotonic_ns};
use session::arguments::check_duration;
use shared_types::Scan;
use urg::{Coding, Reading, ScannerConfig, ScannerConnection, ScannerPlace, SourceState};

use super::arguments::{PlaceArguments, ScannerArguments};

/// A scanner that is reached gives its first scan, or answers, within this time [ns].
const START_NS: u64 = 10_000_000_000;
/// Longest wait between two checks for Ctrl-C [ns].
const CHECK_NS: u64 = 100_000_000;

/// The source of scans with the limits of the command.
pub(super) struct Scanner {
    source: ScannerConnection,
    shutdown: Shutdown,
    started_ns: u64,
    end_ns: u64,
    left: u64,
    state: SourceState,
}

impl Scanner {
    /// Opens a scanner to measure.
    pub(super) fn open(arguments: &ScannerArguments) -> anyhow::Result<Self> {
        let ScannerArguments { place, bit_rate, two_characters, skip, cluster, count, duration } = arguments;
        check_duration(*duration)?;
        let coding = if *two_characters { Coding::Two } else { Coding::Three };
        let config =
            ScannerConfig { coding, skip: *skip, cluster: *cluster, bit_rate: *bit_rate, ..config(place)? };
        let mut scanner = Self::of(config)?;
        scanner.left = count.unwrap_or(u64::MAX);
        if let Some(duration) = duration {
            scanner.end_ns = scanner.started_ns.saturating_add((duration * 1e9) as u64);
        }
        Ok(scanner)
    }

    /// Opens a scanner for its identification only.
    pub(super) fn identify(place: &PlaceArguments) -> anyhow::Result<ScannerConnection> {
        let mut scanner = Self::of(ScannerConfig { identify_only: true, ..config(place)? })?;
        let mut scan = Scan::default();
        while !scanner.source.is_identified() {
            scanner.source.next(CHECK_NS, &mut scan).map_err(Failure::bad_input)?;
            scanner.require_start()?;
            if scanner.shutdown.requested() {
                return Err(Failure::interrupted());
            }
        }
        Ok(scanner.source)
    }

    fn of(config: ScannerConfig) -> anyhow::Result<Self> {
        let started_ns = monotonic_ns();
        Ok(Self {
            source: ScannerConnection::open(config, monotonic_ns),
            shutdown: Shutdown::on_signals()?,
            started_ns,
            end_ns: u64::MAX,
            left: u64::MAX,
            state: SourceState::Connecting,
        })
    }

    /// The source.
    pub(super) fn source(&self) -> &ScannerConnection {
        &self.source
    }

    /// Waits for the next scan; `None` at the end.
    pub(super) fn next(&mut self, scan: &mut Scan) -> anyhow::Result<Option<Reading>> {
        while self.left > 0 && !self.shutdown.requested() && monotonic_ns() < self.end_ns {
            let reading = self.source.next(CHECK_NS, scan).map_err(Failure::bad_input)?;
            self.require_start()?;
            self.tell_state();
            if reading.is_some() {
                self.left -= 1;
                return Ok(reading);
            }
        }
        Ok(None)
    }

    /// Passes unless the scanner was never reached, or has given nothing for too long.
    fn require_start(&self) -> anyhow::Result<()> {
        let has_worked = self.source.counters().scans > 0 || self.source.is_identified();
        if has_worked {
            return Ok(());
        }
        let message = self.source.message();
        if self.source.failed_connections() > 0 && self.source.state() == SourceState::Connecting {
            return Err(Failure::bad_input(format!("scanner {message}")));
        }
        if monotonic_ns().saturating_sub(self.started_ns) > START_NS {
            let reason = if message.is_empty() { "no scan comes" } else { message };
            return Err(Failure { exit: console::exit::Exit::NotReached, message: reason.to_owned() }.into());
        }
        Ok(())
    }

    /// Prints when scans stop coming, and when they come again.
    fn tell_state(&mut self) {
        let before = std::mem::replace(&mut self.state, self.source.state());
        if before == self.state || self.source.counters().scans == 0 {
            return;
        }
        match self.source.message() {
            "" => note!("scanner: {}", self.state.name()),
            message => note!("scanner: {}: {message}", self.state.name()),
        }
    }
}

fn config(place: &PlaceArguments) -> anyhow::Result<ScannerConfig> {
    let place = match place {
        PlaceArguments { tcp: Some(address), .. } if !address.starts_with('/') => {
            ScannerPlace::parse(address)
        }
        PlaceArguments { device: Some(path), .. } => Ok(ScannerPlace::Device(path.clone())),
        PlaceArguments { tcp, .. } => {
            let path = tcp.as_deref().unwrap_or_default();
            return Err(Failure::bad_input(format!("--tcp {path} is a device: name it by --device")));
        }
    };
    Ok(ScannerConfig::new(place.map_err(Failure::bad_input)?))
}
