//! What the page shows comes from a source: a running system is one, `live`.

use crate::events::Event;
use crate::history::Stored;

/// Something that can be watched: it is polled forty times a second by the collector.
pub(crate) trait Source {
    /// What is new at `now_s`, the time since the server started [s].
    fn poll(&mut self, now_s: f64) -> Update;
}

/// What a source has to show.
#[derive(Debug, Default)]
pub(crate) struct Update {
    /// A new frame, at most ten a second.
    pub(crate) frame: Option<Stored>,
    /// The state of the system as JSON, at most a few times a second.
    pub(crate) system: Option<String>,
    /// What has happened.
    pub(crate) events: Vec<Event>,
}
