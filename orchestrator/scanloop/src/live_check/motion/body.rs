//! What the scans show of the body's motion, for comparison with the odometry.

use std::collections::VecDeque;

use shared_types::Scan;
use vehicle::Description;

use super::super::feed::{Feed, Point};
use super::halt::{self, Halt};
use super::registration::{Shift, Surroundings};

/// Scans at rest whose ranges are averaged.
const AVERAGED: usize = 4;
/// Between the first and the last of these scans a body at rest has moved less [m].
const REST_M: f64 = 0.01;

/// One stop.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stop {
    /// By the odometry.
    pub(super) counted: Halt,
    /// By the scans, with the standard error of the distance [m]; `None` where they do not show it.
    pub(super) seen: Option<(Halt, f64)>,
}

/// The stop that was ordered at `blocked_ns`, by the scans.
pub(super) fn stop(feed: &Feed, blocked_ns: u64, vehicle: &Description) -> Option<(Halt, f64)> {
    let (way, scans) = (&feed.observed.way, &feed.scans_seen);
    let surroundings = at_rest(scans, blocked_ns, vehicle)?;
    let rest = way.last()?;
    let speed_mps = halt::measure(way, blocked_ns, vehicle.command_delay_s)?.speed_mps;
    let is_before = |scan: &&Scan| {
        let end_ns = scan.header.acquired_ns + scan.sweep_ns / 2;
        end_ns <= blocked_ns && scan.header.acquired_ns + halt::SPEED_NS >= blocked_ns
    };
    let (mut places, mut errors) = (Vec::new(), Vec::new());
    for scan in scans.iter().filter(is_before) {
        let counted = way.iter().find(|point| point.at_ns == scan.header.acquired_ns)?;
        let guess = [counted.ahead_m - rest.ahead_m, 0.0, counted.left_rad - rest.left_rad];
        let Shift { pose, error_m } = surroundings.locate(scan, speed_mps, guess, vehicle)?;
        places.push((scan.header.acquired_ns, -pose[0]));
        errors.push(error_m);
    }
    let halt = halt::of_body(&places, blocked_ns, vehicle.command_delay_s)?;
    Some((halt, errors.iter().copied().fold(0.0, f64::max)))
}

/// What the newest scans show, all taken at one place after `since_ns`.
fn at_rest(scans: &VecDeque<Scan>, since_ns: u64, vehicle: &Description) -> Option<Surroundings> {
    let newest: Vec<&Scan> = scans.iter().rev().take(AVERAGED).collect();
    if newest.len() < AVERAGED || newest[AVERAGED - 1].header.acquired_ns <= since_ns {
        return None;
    }
    let surroundings = Surroundings::of(&newest, vehicle);
    let first = surroundings.locate(newest[AVERAGED - 1], 0.0, [0.0; 3], vehicle)?;
    (first.pose[0].abs() <= REST_M).then_some(surroundings)
}

/// Follows the body from a place at rest.
pub(super) struct Track {
    surroundings: Option<Surroundings>,
    pose: [f64; 3],
    /// Time of the newest scan that was followed [ns].
    at_ns: u64,
    /// Whether that scan showed the body.
    is_seen: bool,
}

impl Track {
    /// Begins where the body rests now.
    pub(super) fn begin(feed: &Feed, vehicle: &Description) -> Self {
        let at_ns = feed.newest_scan().map_or(0, |scan| scan.header.acquired_ns);
        Self { surroundings: at_rest(&feed.scans_seen, 0, vehicle), pose: [0.0; 3], at_ns, is_seen: false }
    }

    /// Follows the scans until `until_ns`; how far the body is ahead of where it began [m] and how far it has turned to
    /// the left [rad], `None` where the scans do not show it. Takes long: call it while the robot rests.
    pub(super) fn follow(
        &mut self,
        feed: &Feed,
        until_ns: u64,
        speed_mps: f64,
        vehicle: &Description,
    ) -> Option<Point> {
        let surroundings = self.surroundings.as_ref()?;
        let is_next = |scan: &&Scan| (self.at_ns + 1..=until_ns).contains(&scan.header.acquired_ns);
        for scan in feed.scans_seen.iter().filter(is_next) {
            let found = surroundings.locate(scan, speed_mps, self.pose, vehicle);
            self.is_seen = found.is_some();
            self.pose = found.map_or(self.pose, |shift| shift.pose);
        }
        self.at_ns = until_ns;
        let [ahead_m, _, left_rad] = self.pose;
        self.is_seen.then_some(Point { at_ns: self.at_ns, ahead_m, left_rad })
    }
}
