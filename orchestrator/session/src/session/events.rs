//! The last events of a run: what the session told its user, for `status` and the displays.

use std::collections::VecDeque;

use crate::control::EventRow;

/// How many are kept.
const MAX_EVENTS: usize = 32;

/// The last events of a run.
#[derive(Debug, Default)]
pub(super) struct Events {
    rows: VecDeque<EventRow>,
    count: u64,
}

impl Events {
    /// Adds an event at a driven time [s]; the oldest one goes when there are too many.
    pub(super) fn push(&mut self, time_s: f64, warning: bool, text: String) {
        self.count += 1;
        if self.rows.len() == MAX_EVENTS {
            self.rows.pop_front();
        }
        self.rows.push_back(EventRow { number: self.count, time_s, warning, text });
    }

    /// All that are kept, the oldest first.
    pub(super) fn rows(&self) -> Vec<EventRow> {
        self.rows.iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_events_are_kept_and_numbered() {
        let mut events = Events::default();
        (0..40).for_each(|number| events.push(f64::from(number), number % 2 == 1, format!("event {number}")));
        let rows = events.rows();
        assert_eq!((rows.len(), rows[0].number, rows[31].number), (MAX_EVENTS, 9, 40));
        assert_eq!((rows[31].text.as_str(), rows[31].warning, rows[31].time_s), ("event 39", true, 39.0));
    }
}
