//! The connection to the server: a thread that connects, reads, and renews the connection when it is lost.
//!
//! The thread reads whatever comes at once, so the server's queue never fills. It hands the newest data over through a
//! queue of fixed size and wakes the process. It never writes after the conversation at the start: its guard does.

mod connection;
mod guarded;
mod lost;
mod scanner;

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use shared_types::{BEAMS, Device};

use crate::PlayerConfig;
use crate::config::ScanSource;
use crate::handshake::PlayerSession;
use crate::message::BaseState;

pub use guarded::Orders;
pub use lost::Lost;

/// Events that wait for the process: more than a second of data.
const QUEUED: usize = 32;
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
        ranges_mm: [u32; BEAMS],
        /// Time stamp of the server [s].
        time_s: f64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// A scan of a scanner at this computer.
    Scan {
        /// Its ranges, by beam [mm].
        ranges_mm: [u32; BEAMS],
        /// The ranges were damaged on the way, and are all zero.
        is_missing: bool,
        /// Time of the front beam, on CLOCK_MONOTONIC [ns].
        front_ns: u64,
        /// Duration of the sweep [ns].
        sweep_ns: u64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// The state of a scanner at this computer has changed.
    Scanner(Device),
    /// There is no connection, and why.
    Lost(Lost),
}

/// The running connection.
#[derive(Debug)]
pub struct Client {
    events: Receiver<ClientEvent>,
    /// A state of the scanner that came before the first connection.
    scanner: Cell<Option<Device>>,
    is_ended: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Client {
    /// Connects, in a thread of its own; `wake` is called there when there is an event. The guard is `scanloop`, or another
    /// program with its services; it stops the wheels after `timeout_ns` without an order.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn start(
        config: &PlayerConfig,
        timeout_ns: u64,
        scanloop: &Path,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let (sender, events) = sync_channel(QUEUED);
        let is_ended = Arc::new(AtomicBool::new(false));
        let scanloop = scanloop.to_owned();
        let outlet =
            Outlet { events: sender, wake: Arc::new(wake), scanloop, is_ended: Arc::clone(&is_ended) };
        let named = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let mut threads = Vec::new();
        if config.scan == ScanSource::Urg {
            let (config, outlet) = (config.clone(), outlet.clone());
            // Two periods are the time without an order.
            let rate_hz = 2e9 / timeout_ns as f64;
            threads.push(named("scanner").spawn(move || scanner::read(&config, rate_hz, &outlet))?);
        }
        let config = config.clone();
        threads.push(named("player").spawn(move || keep_connected(&config, timeout_ns, &outlet))?);
        Ok(Self { events, scanner: Cell::default(), is_ended, threads })
    }

    /// The next event, if there is one.
    pub fn next(&self) -> Option<ClientEvent> {
        self.scanner.take().map(ClientEvent::Scanner).or_else(|| self.events.try_recv().ok())
    }

    /// Waits for the first connection, but not longer than `limit_s` [s].
    ///
    /// # Errors
    /// Why there is none after that time.
    pub fn connected(&self, limit_s: f64) -> Result<(Orders, PlayerSession), Option<Lost>> {
        let (end, mut reason) = (Instant::now() + Duration::from_secs_f64(limit_s), None);
        loop {
            match self.events.recv_timeout(end.saturating_duration_since(Instant::now())) {
                Ok(ClientEvent::Connected(orders, session)) => return Ok((orders, session)),
                Ok(ClientEvent::Lost(lost)) => reason = Some(lost),
                Ok(ClientEvent::Scanner(device)) => self.scanner.set(Some(device)),
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return Err(reason),
            }
        }
    }
}

impl Drop for Client {
    /// Ends the guard, which stops the wheels, and closes the connection.
    fn drop(&mut self) {
        self.is_ended.store(true, Ordering::SeqCst);
        // A thread may wait for a place in the queue.
        while self.threads.iter().any(|thread| !thread.is_finished()) {
            let _ = self.events.recv_timeout(Duration::from_millis(5));
        }
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}

/// Where the threads put their events.
#[derive(Clone)]
struct Outlet {
    events: SyncSender<ClientEvent>,
    wake: Arc<dyn Fn() + Send + Sync>,
    /// The program of the guard.
    scanloop: PathBuf,
    is_ended: Arc<AtomicBool>,
}

impl Outlet {
    /// Hands data over; they are dropped when the process does not take them.
    fn offer(&self, event: ClientEvent) {
        let _ = self.events.try_send(event);
        (self.wake)();
    }

    /// Hands over what must not be lost; false when the process has ended.
    fn put(&self, event: ClientEvent) -> bool {
        let is_there = self.events.send(event).is_ok();
        (self.wake)();
        is_there
    }

    fn is_ended(&self) -> bool {
        self.is_ended.load(Ordering::SeqCst)
    }
}

/// Connects, and connects again after each loss with growing pauses.
fn keep_connected(config: &PlayerConfig, timeout_ns: u64, outlet: &Outlet) {
    let [shortest, longest] = PAUSES;
    let mut pause = shortest;
    while !outlet.is_ended() {
        let begun = Instant::now();
        let Err(lost) = connection::serve(config, timeout_ns, outlet) else { return };
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
