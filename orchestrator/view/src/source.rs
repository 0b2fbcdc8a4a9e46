//! What the page shows comes from a source: a running system, `live`, or a recording, `recorded`.

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

/// A source that has one state and no frames: those of a recording are made when they are asked for.
pub(crate) struct Still(pub(crate) Option<String>);

impl Source for Still {
    fn poll(&mut self, _now_s: f64) -> Update {
        Update { system: self.0.take(), ..Update::default() }
    }
}
