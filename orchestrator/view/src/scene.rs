//! The newest samples of a drive, and when they make a frame. Samples come from a running system or from a recording.

use std::collections::{BTreeMap, VecDeque};

use report::latency::Latencies;
use serde_json::Value;
use shared_types::{Command, Directive, GivenGoal, Header};

use crate::course::Goals;
use crate::events::Events;
use crate::follower::News;
use crate::frame::Samples;
use crate::history::Row;

/// Least time between two frames [s].
const FRAME_S: f64 = 0.1;
/// A frame may come this much earlier, so that scans at 10 Hz have one each [s].
const EARLY_S: f64 = 0.03;
/// A scan that is not answered is shown after this time [s].
const UNANSWERED_S: f64 = 0.15;
/// Percentiles are those of so many scans: a minute at 10 Hz.
const CHAINS: usize = 600;

/// The newest samples.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scene {
    pub(crate) samples: Samples,
    pub(crate) directive: Directive,
    /// The goal that was given last; it counts from its scan on.
    given: GivenGoal,
    /// Those before it, by their index.
    given_before: BTreeMap<u32, GivenGoal>,
    /// Headers of the newest actuations.
    chains: VecDeque<Header>,
    /// When the newest scan came that no frame shows yet [s].
    scan_came_s: Option<f64>,
    has_actuation: bool,
    frames: u64,
    next_frame_s: f64,
}

impl Scene {
    /// Takes what has come at `now_s`, and finds what happens in it.
    pub(crate) fn take(&mut self, news: News<'_>, events: &mut Events, now_s: f64) {
        let Self { samples, .. } = self;
        let newest = samples.newest_scan();
        match news {
            News::Found(_) => {
                *self = Self { frames: self.frames, next_frame_s: self.next_frame_s, ..Self::default() };
                return;
            }
            News::Gone => {}
            News::Status(status) => {
                samples.simulated = status.lockstep;
                events.status(status);
            }
            News::Directive(new) => {
                events.directive(new);
                self.directive = *new;
                self.give(&new.goal);
            }
            News::Scan(new) => keep(&mut samples.scan, new),
            News::Pose(new) => keep(&mut samples.pose, new),
            News::Obstacles(new) => {
                events.obstacles(new);
                keep(&mut samples.obstacles, new);
            }
            News::Command(new) => keep(&mut samples.command, new),
            News::Truth(new) => samples.truth = Some(*new),
            News::Actuation(new) => {
                events.actuation(new, samples.command.as_deref().unwrap_or(&Command::default()));
                samples.act(new);
                self.has_actuation = true;
                if new.answers == 1 {
                    if self.chains.len() == CHAINS {
                        self.chains.pop_front();
                    }
                    self.chains.push_back(new.header);
                }
            }
        }
        if self.samples.newest_scan() != newest || self.has_actuation {
            self.scan_came_s.get_or_insert(now_s);
        }
    }

    /// The figures of the next frame: when there is something new to show, and the chain of the newest scan is complete
    /// or late.
    pub(crate) fn next_row(&mut self, now_s: f64) -> Option<Row> {
        let is_due = |came_s: f64| self.samples.is_whole() || now_s - came_s > UNANSWERED_S;
        if now_s < self.next_frame_s - EARLY_S || !self.scan_came_s.is_some_and(is_due) {
            return None;
        }
        self.frames += 1;
        self.next_frame_s = (self.next_frame_s + FRAME_S).max(now_s);
        let row = self.samples.row(self.frames, now_s);
        (self.scan_came_s, self.has_actuation, self.samples.reaction_ns) = (None, false, None);
        Some(row)
    }

    /// Takes a goal that counts from its scan on; one that is not newer than the last is no other.
    pub(crate) fn give(&mut self, goal: &GivenGoal) {
        if goal.is_newer(&self.given) {
            let before = std::mem::replace(&mut self.given, *goal);
            self.given_before.insert(before.index, before);
        }
    }

    /// Shows the goals that count for the newest scan, where they are not those of the start.
    pub(crate) fn show_goals(&mut self, goals: &Goals) {
        let newest = self.samples.newest_scan();
        let all = self.given_before.values().chain([&self.given]);
        let mut counting = all.filter(|given| (1..=newest).contains(&given.from_scan)).peekable();
        self.samples.goals = counting.peek().is_some().then(|| goals.with(counting));
    }

    /// The incarnations in charge, in the order of the roles.
    pub(crate) fn authority(&self) -> Vec<u32> {
        self.directive.authority.iter().map(|authority| authority.incarnation).collect()
    }

    /// The figures of the newest scans, as in `report.json`; `None` in simulated time.
    pub(crate) fn latency(&self) -> Option<Value> {
        if self.samples.simulated || self.chains.is_empty() {
            return None;
        }
        let mut latencies = Latencies::new(false);
        self.chains.iter().for_each(|header| latencies.record(header));
        serde_json::to_value(latencies.report()).ok()
    }
}

/// Keeps the newest sample without another allocation.
fn keep<S: Copy>(place: &mut Option<Box<S>>, new: &S) {
    match place {
        Some(place) => **place = *new,
        None => *place = Some(Box::new(*new)),
    }
}
