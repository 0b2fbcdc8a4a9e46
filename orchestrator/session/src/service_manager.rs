//! What systemd is told of a run: that it drives, what it does, that it lives, that it stops.
//!
//! Without systemd (`NOTIFY_SOCKET` is not set) nothing is said. The watchdog is fed by the loop of the session, so an
//! orchestrator that hangs is killed and started anew, and adopts the processes, which drove on meanwhile. A thread of its
//! own sends, because a service manager that does not read would hold up the loop.

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
    told_ns: u64,
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
            told_ns: 0,
            is_ready: false,
            is_stopping: false,
            sender: Background::new("notify"),
        }
    }

    /// The robot drives. Repeats say nothing.
    pub(crate) fn ready(&mut self) {
        if !std::mem::replace(&mut self.is_ready, true) {
            self.tell("READY=1".to_owned());
        }
    }

    /// The run ends. Repeats say nothing.
    pub(crate) fn stopping(&mut self) {
        if !std::mem::replace(&mut self.is_stopping, true) {
            self.tell("STOPPING=1".to_owned());
        }
    }

    /// The loop went round once more.
    pub(crate) fn turn(&mut self, status: impl FnOnce() -> String) {
        let now = monotonic_ns();
        if self.feed_ns.is_some_and(|feed_ns| now.saturating_sub(self.fed_ns) >= feed_ns) {
            self.fed_ns = now;
            self.tell("WATCHDOG=1".to_owned());
        }
        if now.saturating_sub(self.told_ns) >= STATUS_NS {
            self.told_ns = now;
            self.tell(format!("STATUS={}", status()));
        }
    }

    fn tell(&self, state: String) {
        self.sender.post(move || {
            if let Err(error) = notify(&[NotifyState::Custom(&state)]) {
                tracing::debug!(%error, "the service manager was not told");
            }
        });
    }
}
