//! Notifies systemd of a run: ready, status line, watchdog, stopping.
//!
//! Without systemd (`NOTIFY_SOCKET` is not set) nothing is sent. The loop of the session feeds the watchdog, so systemd
//! kills an orchestrator that hangs and starts a new one, which adopts the processes; they drove on meanwhile. A thread
//! of its own sends, because a service manager that does not read would block the loop.

use runtime::monotonic_ns;
use sd_notify::{NotifyState, notify, watchdog_enabled};
use supervision::background::Background;

/// Time between two lines of status [ns].
const STATUS_NS: u64 = 1_000_000_000;

/// The service manager, if there is one.
#[derive(Debug)]
pub(crate) struct ServiceManager {
    /// The watchdog is fed this often [ns]; `None` without one.
    feed_ns: Option<u64>,
    fed_ns: u64,
    status_ns: u64,
    is_ready: bool,
    is_stopping: bool,
    sender: Background,
}

impl ServiceManager {
    /// The service manager named by the environment.
    pub(crate) fn new() -> Self {
        // Half of the time, as sd_watchdog_enabled(3) recommends.
        let feed_ns = watchdog_enabled().map(|limit| limit.as_nanos() as u64 / 2);
        Self {
            feed_ns,
            fed_ns: 0,
            status_ns: 0,
            is_ready: false,
            is_stopping: false,
            sender: Background::new("notify"),
        }
    }

    /// The robot drives. Repeats have no effect.
    pub(crate) fn ready(&mut self) {
        if !std::mem::replace(&mut self.is_ready, true) {
            self.send("READY=1".to_owned());
        }
    }

    /// The run ends. Repeats have no effect.
    pub(crate) fn stopping(&mut self) {
        if !std::mem::replace(&mut self.is_stopping, true) {
            self.send("STOPPING=1".to_owned());
        }
    }

    /// The loop has completed a turn.
    pub(crate) fn turn(&mut self, status: impl FnOnce() -> String) {
        let now = monotonic_ns();
        if self.feed_ns.is_some_and(|feed_ns| now.saturating_sub(self.fed_ns) >= feed_ns) {
            self.fed_ns = now;
            self.send("WATCHDOG=1".to_owned());
        }
        if now.saturating_sub(self.status_ns) >= STATUS_NS {
            self.status_ns = now;
            self.send(format!("STATUS={}", status()));
        }
    }

    fn send(&self, state: String) {
        self.sender.post(move || {
            if let Err(error) = notify(&[NotifyState::Custom(&state)]) {
                tracing::debug!(%error, "the service manager was not notified");
            }
        });
    }
}
