//! What was imported, for a person and as JSON.

use std::fmt;

use serde::Serialize;

use crate::drive::Computed;
use crate::times::StampCounts;

/// What was imported.
#[derive(Debug, Clone, Serialize)]
pub struct Imported {
    /// The source.
    pub file: String,
    /// What it is.
    pub kind: &'static str,
    /// Its topics with scans and odometry; empty for a log.
    pub topics: Vec<String>,
    /// Whether its end is missing.
    pub cut_off: bool,
    /// From the first to the last scan [s].
    pub duration_s: f64,
    /// Scans in it.
    pub scans: u64,
    /// Scans in the recording.
    pub taken: u64,
    /// Scans that were left out, because no odometry is near in time.
    pub without_odometry: u64,
    /// Scans that were left out, because their rays are impossible.
    pub impossible: u64,
    /// Stamps of the scans.
    pub scan_stamps: StampCounts,
    /// Messages of the odometry.
    pub odometry: u64,
    /// Of them, those with numbers that are not finite, or beyond ten thousand kilometres.
    pub not_finite: u64,
    /// Places where the odometry jumps: the robot is taken to be where it was.
    pub jumps: u64,
    /// Stamps of the odometry.
    pub odometry_stamps: StampCounts,
    /// Beams of a scan.
    pub beams: usize,
    /// Rays that were merged to each.
    pub merged: usize,
    /// Angles of the first and the last beam, and from one to the next [deg].
    pub angles_deg: [f64; 3],
    /// Largest range [m].
    pub range_m: f64,
    /// Scans per second.
    pub rate_hz: f64,
    /// Share of the beams that are returns.
    pub valid_share: f64,
    /// What the stages made of them.
    pub computed: Computed,
}

impl Imported {
    /// Why scans were left out.
    pub(crate) fn left_out(&self) -> String {
        let reasons = [
            (self.without_odometry, "without odometry near in time"),
            (self.impossible, "with impossible rays"),
            (self.scan_stamps.left_out, "not later than the one before"),
        ];
        let some = reasons.into_iter().filter(|(count, _)| *count > 0);
        some.map(|(count, why)| format!("{count} {why}")).collect::<Vec<_>>().join(", ")
    }
}

impl fmt::Display for Imported {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, kind, duration_s, scans, taken, beams, computed, .. } = self;
        let cut_off = if self.cut_off { ", cut off" } else { "" };
        writeln!(formatter, "{file}: {kind}{cut_off}, {duration_s:.1} s")?;
        let topic = |index: usize| {
            self.topics
                .get(index)
                .map(|topic| format!(" of {}", runtime::one_line(topic)))
                .unwrap_or_default()
        };
        let left_out = Some(self.left_out()).filter(|reasons| !reasons.is_empty());
        let left_out = left_out.map(|reasons| format!("; left out: {reasons}")).unwrap_or_default();
        writeln!(formatter, "{taken} of {scans} scans{}{left_out}", topic(0))?;
        let not_finite =
            if self.not_finite > 0 { format!("; not finite: {}", self.not_finite) } else { String::new() };
        let jumps = if self.jumps > 0 { format!("; jumps: {}", self.jumps) } else { String::new() };
        writeln!(formatter, "{} messages with odometry{}{not_finite}{jumps}", self.odometry, topic(1))?;
        for (name, StampCounts { zero, wrong, left_out }) in
            [("scans", self.scan_stamps), ("odometry", self.odometry_stamps)]
        {
            if zero + wrong > 0 {
                let text = format!("{zero} without a stamp, {wrong} with a wrong one: the log time holds");
                writeln!(formatter, "{name}: {text}; {left_out} left out")?;
            }
        }
        let [first, last, step] = self.angles_deg;
        let merged = if self.merged > 1 { format!(", {} rays each", self.merged) } else { String::new() };
        let (range_m, rate_hz) = (self.range_m, self.rate_hz);
        writeln!(
            formatter,
            "scanner: {beams} beams{merged}, {first:.1} to {last:.1} degrees by {step:.3}, up to {range_m} m, {rate_hz:.2} Hz, \
             {:.1} % are returns",
            1e2 * self.valid_share
        )?;
        let Computed { poses, obstacles, bodies, healthy, degraded, stopping } = computed;
        write!(
            formatter,
            "computed: {poses} poses, {obstacles} descriptions of obstacles with {bodies} bodies; scanner healthy in {healthy}, \
             degraded in {degraded}, to be stopped for in {stopping}"
        )
    }
}
