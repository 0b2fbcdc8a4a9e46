//! What the scans show of the body's motion, for comparison with the odometry.

use std::collections::VecDeque;

use estimator::laser::outline::{Laid, Outline};
use nalgebra::{Matrix3, Vector2, Vector3};
use shared_types::Scan;
use vehicle::Description;

use super::super::feed::{Feed, Point, is_ahead};
use super::halt::{self, Halt};

/// Scans at rest whose ranges are averaged.
const AVERAGED: usize = 4;
/// Between the first and the last of these scans a body at rest has moved less [m].
const REST_M: f64 = 0.01;
/// A motion ahead with a larger standard error was not seen [m].
const MAX_ERROR_M: f64 = 0.01;

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
        let guess = Vector3::new(counted.left_rad - rest.left_rad, counted.ahead_m - rest.ahead_m, 0.0);
        let laid = locate(&surroundings, scan, speed_mps, guess, vehicle)?;
        places.push((scan.header.acquired_ns, -laid.pose[1]));
        errors.push(laid.ahead_error_m);
    }
    let halt = halt::of_body(&places, blocked_ns, vehicle.command_delay_s)?;
    Some((halt, errors.iter().copied().fold(0.0, f64::max)))
}

/// What the newest scans show, all taken at one place after `since_ns`.
fn at_rest(scans: &VecDeque<Scan>, since_ns: u64, vehicle: &Description) -> Option<Outline> {
    let newest: Vec<&Scan> = scans.iter().rev().take(AVERAGED).collect();
    if newest.len() < AVERAGED || newest[AVERAGED - 1].header.acquired_ns <= since_ns {
        return None;
    }
    let mean = |beam: usize| {
        let ranges: Option<Vec<f64>> = newest.iter().map(|scan| scan.range_m(beam)).collect();
        ranges.map(|ranges| ranges.iter().sum::<f64>() / AVERAGED as f64)
    };
    let mut surroundings = Outline::default();
    surroundings.show(newest[0].geometry(), 1, vehicle, mean, |_, place| place);
    let first = locate(&surroundings, newest[AVERAGED - 1], 0.0, Vector3::zeros(), vehicle)?;
    (first.pose[1].abs() <= REST_M).then_some(surroundings)
}

/// Where the body was at the front beam of a scan, from which it drove at `speed_mps`; near `guess`.
///
/// `None` when the surroundings do not show how far ahead.
fn locate(
    surroundings: &Outline,
    scan: &Scan,
    speed_mps: f64,
    guess: Vector3<f64>,
    vehicle: &Description,
) -> Option<Laid> {
    let mut seen = Outline::default();
    let ahead = |beam: usize| is_ahead(scan, beam, vehicle.scanner_yaw_rad);
    let range_m = |beam: usize| scan.range_m(beam).filter(|_| ahead(beam));
    let moved = |beam: usize, place| place + Vector2::new(speed_mps * scan.beam_time_s(beam), 0.0);
    seen.show(scan.geometry(), 1, vehicle, range_m, moved);
    // Nothing is expected: only directions that nothing shows stay where the guess has them.
    let laid = surroundings.locate(&seen, &guess, &Matrix3::identity())?;
    (laid.ahead_error_m <= MAX_ERROR_M).then_some(laid)
}

/// Follows the body from a place at rest.
pub(super) struct Track {
    surroundings: Option<Outline>,
    /// Turn, and how far ahead and to the left [rad, m, m].
    pose: Vector3<f64>,
    /// Time of the newest scan that was followed [ns].
    at_ns: u64,
    /// Whether that scan showed the body.
    is_seen: bool,
}

impl Track {
    /// Begins where the body rests now.
    pub(super) fn begin(feed: &Feed, vehicle: &Description) -> Self {
        let at_ns = feed.newest_scan().map_or(0, |scan| scan.header.acquired_ns);
        Self {
            surroundings: at_rest(&feed.scans_seen, 0, vehicle),
            pose: Vector3::zeros(),
            at_ns,
            is_seen: false,
        }
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
            let found = locate(surroundings, scan, speed_mps, self.pose, vehicle);
            self.is_seen = found.is_some();
            self.pose = found.map_or(self.pose, |laid| laid.pose);
        }
        self.at_ns = until_ns;
        let [left_rad, ahead_m, _] = self.pose.into();
        self.is_seen.then_some(Point { at_ns: self.at_ns, ahead_m, left_rad })
    }
}
