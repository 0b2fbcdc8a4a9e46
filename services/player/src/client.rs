//! The connection to the server: a thread that connects, reads, and renews the connection when it is lost.
//!
//! The thread reads whatever comes at once, so the server's queue never fills. It hands the newest data over through a
//! queue of fixed size and wakes the process. It never writes after the conversation at the start: its guard does.

mod connection;
mod lost;

use std::path::Path;
use std::time::{Duration, Instant};

use driver::beams::SweepRanges;
use driver::event::RobotEvent;
use driver::feed::Feed;
use driver::guard::Orders;
use driver::motion::BaseState;
use driver::scanner;
use vehicle::ScannerDescription;

use crate::PlayerConfig;
use crate::config::ScanSource;
use crate::handshake::PlayerSession;

pub use lost::Lost;

/// Time before the next attempt to connect; it doubles from the first to the second.
const PAUSES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];

/// What the connection reports.
#[derive(Debug)]
pub enum ClientEvent {
    /// Base and scanner are open; orders may be given.
    Connected(Orders, PlayerSession),
    /// The state of the base.
    State {
        /// What it reports.
        state: BaseState,
        /// Time stamp of the server [s].
        time_s: f64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// A sweep.
    Sweep {
        /// Its ranges, by beam of a scan [mm].
        ranges_mm: SweepRanges,
        /// Time stamp of the server [s].
        time_s: f64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// What a scanner at this computer reports.
    Scanner(RobotEvent),
    /// There is no connection, and why.
    Lost(Lost),
}

/// Where the threads put their events.
type Outlet = driver::feed::Outlet<ClientEvent>;

/// The running connection.
#[derive(Debug)]
pub struct Client {
    feed: Feed<ClientEvent>,
}

impl Client {
    /// Connects to a robot with this scanner, in a thread of its own; `wake` is called there when there is an event. The guard is `scanloop`, or another
    /// program with its services; it stops the wheels after `timeout_ns` without an order.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn start(
        config: &PlayerConfig,
        described: ScannerDescription,
        timeout_ns: u64,
        scanloop: &Path,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let (mut feed, outlet) = Feed::new(wake);
        if config.scan == ScanSource::Urg {
            let (settings, outlet) = (config.scanner_settings(), outlet.clone());
            feed.spawn("scanner", move || {
                scanner::read(&settings, &described, timeout_ns, &outlet, ClientEvent::Scanner);
            })?;
        }
        let (config, scanloop) = (config.clone(), scanloop.to_owned());
        feed.spawn("player", move || keep_connected(&config, &described, timeout_ns, &scanloop, &outlet))?;
        Ok(Self { feed })
    }

    /// The next event, if there is one.
    pub fn next(&self) -> Option<ClientEvent> {
        self.feed.next()
    }

    /// Waits for the first connection, but not longer than `limit_s` [s].
    ///
    /// # Errors
    /// Why there is none after that time.
    pub fn connected(&self, limit_s: f64) -> Result<(Orders, PlayerSession), Option<Lost>> {
        let (end, mut reason) = (Instant::now() + Duration::from_secs_f64(limit_s), None);
        loop {
            match self.feed.wait(end) {
                Some(ClientEvent::Connected(orders, session)) => return Ok((orders, session)),
                Some(ClientEvent::Lost(lost)) => reason = Some(lost),
                // A state of the scanner that came before the first connection still counts.
                Some(event @ ClientEvent::Scanner(RobotEvent::Scanner(_))) => self.feed.put_back(event),
                Some(_) => {}
                None => return Err(reason),
            }
        }
    }
}

/// Connects, and connects again after each loss with growing pauses.
fn keep_connected(
    config: &PlayerConfig,
    described: &ScannerDescription,
    timeout_ns: u64,
    scanloop: &Path,
    outlet: &Outlet,
) {
    let [shortest, longest] = PAUSES;
    let mut pause = shortest;
    while !outlet.is_ended() {
        let begun = Instant::now();
        let Err(lost) = connection::serve(config, described, timeout_ns, scanloop, outlet) else { return };
        if !outlet.put(ClientEvent::Lost(lost)) {
            return;
        }
        // A connection that has worked is renewed at once.
        pause = if begun.elapsed() > 2 * longest { shortest } else { (2 * pause).min(longest) };
        let until = Instant::now() + pause;
        while Instant::now() < until && !outlet.is_ended() {
            runtime::wait_for(&[], 10_000_000);
        }
    }
}
