//! The frames of the last five minutes, and their figures as rows for charts.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;

/// Frames older than this are dropped [s].
pub(crate) const HISTORY_S: f64 = 300.0;
/// Maximum number of frames: ten a second, and some that came early.
const MAX_FRAMES: usize = 3600;

/// The figures of one frame that charts show over time; NaN is written as `null`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Row {
    pub(crate) number: u64,
    pub(crate) time_s: f64,
    pub(crate) scan_id: u64,
    /// Estimated position.
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) yaw_rad: f64,
    pub(crate) true_x_m: f64,
    pub(crate) true_y_m: f64,
    pub(crate) speed_mps: f64,
    pub(crate) desired_velocity_mps: f64,
    pub(crate) desired_steering_rad: f64,
    pub(crate) clearance_m: f64,
    pub(crate) margin_m: f64,
    pub(crate) reaction_us: f64,
    /// 0: the wheels turn; 1: they are blocked; 2: they are blocked at the start, at the goal or because the run ends.
    pub(crate) blocked: u32,
}

/// A frame as it is sent.
#[derive(Debug, Clone)]
pub(crate) struct Stored {
    pub(crate) row: Row,
    pub(crate) text: Arc<str>,
}

/// The frames, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct History(VecDeque<Stored>);

impl History {
    /// Adds a frame.
    pub(crate) fn push(&mut self, stored: Stored) {
        if self.0.len() >= MAX_FRAMES {
            self.0.pop_front();
        }
        self.0.push_back(stored);
    }

    /// Drops what is too old.
    pub(crate) fn prune(&mut self, now_s: f64) {
        while self.0.front().is_some_and(|first| first.row.time_s < now_s - HISTORY_S) {
            self.0.pop_front();
        }
        // A long wait would otherwise hold the memory of the busiest time.
        if self.0.is_empty() {
            self.0.shrink_to(0);
        }
    }

    /// The newest one.
    pub(crate) fn newest(&self) -> Option<&Stored> {
        self.0.back()
    }

    /// The frame of that number, or the next one that is still there.
    pub(crate) fn frame(&self, number: u64) -> Option<&Stored> {
        let index = self.0.partition_point(|stored| stored.row.number < number);
        self.0.get(index)
    }

    /// The rows after that number.
    pub(crate) fn rows(&self, after: u64) -> Vec<Row> {
        let first = self.0.partition_point(|stored| stored.row.number <= after);
        self.0.range(first..).map(|stored| stored.row).collect()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn stored(number: u64, time_s: f64) -> Stored {
        let row = Row {
            number,
            time_s,
            scan_id: number,
            x_m: 0.0,
            y_m: 0.0,
            yaw_rad: 0.0,
            true_x_m: f64::NAN,
            true_y_m: f64::NAN,
            speed_mps: 0.0,
            desired_velocity_mps: 0.0,
            desired_steering_rad: 0.0,
            clearance_m: f64::NAN,
            margin_m: 0.0,
            reaction_us: 0.0,
            blocked: 0,
        };
        Stored { row, text: format!("{number}").into() }
    }

    #[test]
    fn frames_older_than_five_minutes_are_dropped() {
        let mut history = History::default();
        (0..100).for_each(|number| history.push(stored(number, number as f64 * 10.0)));
        history.prune(990.0);
        assert_eq!(history.rows(0).first().map(|row| row.number), Some(69));
        assert_eq!(history.frame(3).map(|stored| stored.row.number), Some(69), "the oldest that is there");
        assert_eq!(history.frame(80).map(|stored| &*stored.text), Some("80"));
        assert!(history.frame(100).is_none());
        assert_eq!(history.rows(97).len(), 2);
        history.prune(1e6);
        assert!(history.newest().is_none());
    }

    #[test]
    fn the_number_of_frames_is_limited() {
        let mut history = History::default();
        (0..10_000).for_each(|number| history.push(stored(number, 0.0)));
        assert_eq!(history.0.len(), MAX_FRAMES);
    }

    #[test]
    fn a_figure_that_is_unknown_is_null() {
        let text = serde_json::to_string(&stored(1, 0.5).row).unwrap();
        assert!(text.contains("\"clearance_m\":null"), "{text}");
    }
}
