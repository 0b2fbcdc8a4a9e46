//! What the collector hands to the connections: the newest of everything, and what is kept of the past.
//!
//! The collector never waits for a connection: it replaces the newest frame and wakes those that wait.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;

use crate::events::Event;
use crate::history::History;
use crate::source::Update;

/// Maximum number of events that are remembered.
const MAX_EVENTS: usize = 300;

/// Shared by the collector and all connections.
#[derive(Debug, Default)]
pub(crate) struct Hub {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    history: History,
    events: VecDeque<Event>,
    system: Option<Arc<str>>,
    system_number: u64,
    has_ended: bool,
}

/// What a connection has already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Cursor {
    frame: u64,
    event: u64,
    system: u64,
}

/// A server-sent event: its name and its JSON.
pub(crate) type Message = (&'static str, Arc<str>);

/// The server ends.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Ended;

impl Hub {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes what a source has found at `now_s`.
    pub(crate) fn publish(&self, update: Update, now_s: f64) {
        let mut state = self.lock();
        state.history.prune(now_s);
        let is_new = update.frame.is_some() || update.system.is_some() || !update.events.is_empty();
        if let Some(frame) = update.frame {
            state.history.push(frame);
        }
        if let Some(system) = update.system {
            state.system = Some(system.into());
            state.system_number += 1;
        }
        for event in update.events {
            if state.events.len() >= MAX_EVENTS {
                state.events.pop_front();
            }
            state.events.push_back(event);
        }
        drop(state);
        if is_new {
            self.changed.notify_all();
        }
    }

    /// Lets all connections end.
    pub(crate) fn end(&self) {
        self.lock().has_ended = true;
        self.changed.notify_all();
    }

    /// What is newer than the cursor, which moves; empty when nothing came within `timeout`.
    ///
    /// # Errors
    /// [`Ended`].
    pub(crate) fn next(&self, cursor: &mut Cursor, timeout: Duration) -> Result<Vec<Message>, Ended> {
        let waits = |state: &mut State| !state.has_ended && !state.is_newer(*cursor);
        let waited = self.changed.wait_timeout_while(self.lock(), timeout, waits);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if state.has_ended { Err(Ended) } else { Ok(state.after(cursor)) }
    }

    /// The newest state of the system as JSON; `null` at the start.
    pub(crate) fn system(&self) -> Arc<str> {
        self.lock().system.clone().unwrap_or_else(|| "null".into())
    }

    /// The frame of that number or, if it is dropped, the oldest one after it.
    pub(crate) fn frame(&self, number: u64) -> Option<Arc<str>> {
        self.lock().history.frame(number).map(|stored| Arc::clone(&stored.text))
    }

    /// Rows and events after those numbers as JSON.
    pub(crate) fn history(&self, row: u64, event: u64) -> String {
        let state = self.lock();
        let rows = state.history.rows(row);
        let events: Vec<Event> = state.events.iter().filter(|known| known.number > event).cloned().collect();
        drop(state);
        json!({ "rows": rows, "events": events }).to_string()
    }
}

impl State {
    fn is_newer(&self, cursor: Cursor) -> bool {
        self.system_number > cursor.system
            || self.history.newest().is_some_and(|newest| newest.row.number > cursor.frame)
            || self.events.back().is_some_and(|newest| newest.number > cursor.event)
    }

    fn after(&self, cursor: &mut Cursor) -> Vec<Message> {
        let mut messages: Vec<Message> = Vec::new();
        if let Some(system) = self.system.as_ref().filter(|_| self.system_number > cursor.system) {
            cursor.system = self.system_number;
            messages.push(("system", Arc::clone(system)));
        }
        let events: Vec<&Event> = self.events.iter().filter(|event| event.number > cursor.event).collect();
        if let Some(newest) = events.last() {
            cursor.event = newest.number;
            messages.push(("events", json!(events).to_string().into()));
        }
        if let Some(newest) = self.history.newest().filter(|newest| newest.row.number > cursor.frame) {
            cursor.frame = newest.row.number;
            messages.push(("frame", Arc::clone(&newest.text)));
        }
        messages
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::Kind;
    use crate::history::tests::stored;

    const NOW: Duration = Duration::ZERO;

    fn update(frame: u64) -> Update {
        Update { frame: Some(stored(frame, 0.1)), ..Update::default() }
    }

    #[test]
    fn a_slow_connection_gets_the_newest_frame_only() {
        let hub = Hub::default();
        let mut cursor = Cursor::default();
        (1..=50).for_each(|frame| hub.publish(update(frame), 0.1));
        assert_eq!(hub.next(&mut cursor, NOW).unwrap(), [("frame", "50".into())]);
        assert_eq!(hub.next(&mut cursor, NOW).unwrap(), []);
        hub.publish(update(51), 0.1);
        assert_eq!(hub.next(&mut cursor, NOW).unwrap().len(), 1);
    }

    #[test]
    fn all_events_are_sent_and_only_so_many_are_remembered() {
        let hub = Hub::default();
        for number in 1..=1000 {
            let event = Event { number, time_s: 0.0, kind: Kind::Info, text: String::new(), scan_id: None };
            hub.publish(Update { events: vec![event], ..Update::default() }, 0.0);
        }
        let messages = hub.next(&mut Cursor::default(), NOW).unwrap();
        let events: Vec<serde_json::Value> = serde_json::from_str(&messages[0].1).unwrap();
        assert_eq!((events.len(), &events[0]["number"]), (MAX_EVENTS, &json!(701)));
        assert!(hub.history(0, 999).contains("\"number\":1000"));
    }

    #[test]
    fn the_end_wakes_a_connection_that_waits() {
        let hub = Hub::default();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| hub.next(&mut Cursor::default(), Duration::from_secs(60)));
            hub.end();
            assert_eq!(waiting.join().unwrap(), Err(Ended));
        });
    }
}
