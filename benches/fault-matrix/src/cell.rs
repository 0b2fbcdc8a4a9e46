//! One cell of the matrix and its verdict.

use faults::{DrivePhase, Expectation, InjectedFault};
use pipeline::PipelineSettings;
use serde::{Deserialize, Serialize};
use vehicle::Description;

use crate::finding::Finding;

/// Wheels that stay this near to those of the drive without the fault are not affected, at 1 m/s on the usual course [m].
const UNAFFECTED_M: f64 = 0.05;
/// Scan periods that the wheels may turn before a fault that acts is detected.
const BLIND_PERIODS: f64 = 3.0;

/// Whether a cell passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CellVerdict {
    /// All expectations are met.
    Pass,
    /// One is not.
    Fail,
}

/// The result of one cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Name of the fault.
    pub fault: String,
    /// Phase in which it begins.
    pub phase: DrivePhase,
    /// Whether it was driven with real processes.
    pub live: bool,
    /// The role that detected it, or `orchestrator`; empty when none did.
    pub detected_by: String,
    /// What was found, like `not_finite`.
    pub detection: String,
    /// Time from the beginning of the fault to its detection [ms].
    pub detected_after_ms: Option<f64>,
    /// Way of the true wheels from when the fault could be detected to its detection; 0 where it had no effect [m].
    pub blind_m: f64,
    /// The most that is allowed [m].
    pub blind_limit_m: f64,
    /// Largest distance to the way of the drive without the fault, and of the ends of both [m].
    pub deviation_m: f64,
    /// Smallest clearance of the drive [m].
    pub min_clearance_m: f64,
    /// How the drive ended.
    pub outcome: String,
    /// Digest of the truth, from the beginning of the phase; empty for one with real processes.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub digest: String,
    /// Whether all is as expected.
    pub verdict: CellVerdict,
    /// Why it fails; empty when it passes.
    pub reason: String,
}

/// What was observed in the drive of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// When the fault began [ns].
    pub from_ns: u64,
    /// Findings that the drive without the fault does not have, in the order of time.
    pub findings: Vec<Finding>,
    /// The robot since then.
    pub course: DrivenWay,
    /// The same without the fault; empty where there is no such drive.
    pub unaffected: DrivenWay,
    /// How the drive ended.
    pub outcome: String,
    /// [`Cell::digest`].
    pub digest: String,
    /// Whether it was driven to its end, and not only for some seconds.
    pub ended: bool,
    /// Whether the body touched something.
    pub touched: bool,
    /// Smallest clearance [m].
    pub min_clearance_m: f64,
}

/// Where a robot was, at ascending times.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DrivenWay(pub Vec<Passed>);

/// One place of a [`DrivenWay`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// Time [ns].
    pub at_ns: u64,
    /// True position [m].
    pub at_m: [f64; 2],
    /// Way driven [m].
    pub way_m: f64,
    /// True speed [m/s].
    pub speed_mps: f64,
}

impl DrivenWay {
    /// Way driven until a time [m]; linear between two places, constant beyond them.
    pub fn way_m(&self, at_ns: u64) -> f64 {
        let next = self.0.partition_point(|passed| passed.at_ns < at_ns);
        match (next.checked_sub(1).map(|index| self.0[index]), self.0.get(next)) {
            (Some(before), Some(after)) => {
                let share = (at_ns - before.at_ns) as f64 / (after.at_ns - before.at_ns).max(1) as f64;
                before.way_m + share * (after.way_m - before.way_m)
            }
            (Some(passed), None) | (None, Some(&passed)) => passed.way_m,
            (None, None) => 0.0,
        }
    }

    /// Largest distance to the way of another robot [m]. Where both drives have ended, also between their ends.
    ///
    /// A robot that is late on the same way does not deviate; one that stops elsewhere does.
    pub fn deviation_m(&self, other: &Self, both_ended: bool) -> f64 {
        let ends = [self, other].map(|course| course.0.last().map(|passed| passed.at_m));
        let apart_m = match ends {
            [Some(one), Some(two)] if both_ended => distance(one, two),
            _ => 0.0,
        };
        self.0.iter().map(|passed| other.distance_to(passed.at_m)).fold(apart_m, f64::max)
    }

    /// When the robot is first so far away from another's way [ns].
    fn leaves_ns(&self, other: &Self, away_m: f64) -> Option<u64> {
        let is_away = |passed: &&Passed| other.distance_to(passed.at_m) >= away_m;
        self.0.iter().find(is_away).map(|passed| passed.at_ns)
    }

    /// Distance of a place to this way [m]; zero if there is none.
    fn distance_to(&self, place: [f64; 2]) -> f64 {
        let parts = self.0.windows(2).map(|ends| distance_to_part(place, ends[0].at_m, ends[1].at_m));
        let nearest = parts.fold(f64::INFINITY, f64::min);
        match self.0.first() {
            Some(only) if self.0.len() == 1 => distance(place, only.at_m),
            Some(_) => nearest,
            None => 0.0,
        }
    }

    fn fastest_mps(&self) -> f64 {
        self.0.iter().map(|passed| passed.speed_mps).fold(0.0, f64::max)
    }
}

fn distance(one: [f64; 2], two: [f64; 2]) -> f64 {
    (one[0] - two[0]).hypot(one[1] - two[1])
}

/// Distance of a place to the straight line between two others [m].
fn distance_to_part(place: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let (along, across) = (to[0] - from[0], to[1] - from[1]);
    let length = (along * along + across * across).max(f64::MIN_POSITIVE);
    let share = ((place[0] - from[0]) * along + (place[1] - from[1]) * across) / length;
    let share = share.clamp(0.0, 1.0);
    distance(place, [from[0] + share * along, from[1] + share * across])
}

/// What limits the way until a detection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectionLimits {
    /// Scan period [s].
    pub period_s: f64,
    /// Deceleration of blocked wheels [m/s^2].
    pub deceleration_mps2: f64,
    /// Wheels that stay this near to those of the drive without the fault are not affected [m].
    pub unaffected_m: f64,
}

impl DetectionLimits {
    /// Those of a robot, on a course whose lengths are `scale` times as large.
    pub fn of(settings: &PipelineSettings, scale: f64) -> Self {
        let Description { bounds, blocked_deceleration_mps2: deceleration_mps2, .. } =
            settings.tuning.vehicle;
        let unaffected_m = UNAFFECTED_M * scale.max(bounds.velocity_max_mps).max(1.0);
        Self { period_s: settings.period_ns as f64 * 1e-9, deceleration_mps2, unaffected_m }
    }

    /// Three scan periods at a speed, and the braking way from it [m].
    pub fn blind_m(&self, speed_mps: f64) -> f64 {
        BLIND_PERIODS * self.period_s * speed_mps + speed_mps * speed_mps / (2.0 * self.deceleration_mps2)
    }
}

/// The verdict on one drive.
pub fn judge(
    fault: &InjectedFault,
    phase: DrivePhase,
    observed: &Observed,
    limits: &DetectionLimits,
) -> Cell {
    let expected = fault.expected(phase);
    let Observed { from_ns, findings, course, unaffected, .. } = observed;
    let is_expected = |finding: &&Finding| expected.detected_by.iter().any(|name| name == finding.by);
    let found = findings.iter().find(is_expected);
    let detectable_ns = match (expected.from_effect, course.leaves_ns(unaffected, limits.unaffected_m)) {
        (true, Some(leaves_ns)) => leaves_ns.max(*from_ns),
        (true, None) => u64::MAX,
        (false, _) => from_ns + (expected.detectable_ms * 1e6) as u64,
    };
    let latest_ns = detectable_ns.saturating_add((expected.within_ms * 1e6) as u64);
    let deviation_m = course.deviation_m(unaffected, observed.ended);
    let has_no_effect = !unaffected.0.is_empty() && deviation_m < limits.unaffected_m;
    let until_m = found.map(|finding| finding.place.way_m).or(course.0.last().map(|passed| passed.way_m));
    let blind_m = match found {
        None if has_no_effect => 0.0,
        _ => (until_m.unwrap_or(0.0) - course.way_m(detectable_ns)).max(0.0),
    };
    let blind_limit_m = limits.blind_m(course.fastest_mps());
    let late_ms = found.map(|finding| (finding.place.at_ns as f64 - latest_ns as f64).max(0.0) * 1e-6);
    let reason = wrong(&expected, observed, late_ms, [blind_m, blind_limit_m], has_no_effect, deviation_m);
    let shown = found.or_else(|| findings.first());
    Cell {
        fault: fault.name.clone(),
        phase,
        live: fault.is_live(),
        detected_by: shown.map_or("", |finding| finding.by).to_owned(),
        detection: shown.map_or("", |finding| finding.what).to_owned(),
        detected_after_ms: shown.map(|finding| finding.place.at_ns.saturating_sub(*from_ns) as f64 * 1e-6),
        blind_m,
        blind_limit_m,
        deviation_m,
        min_clearance_m: observed.min_clearance_m,
        outcome: observed.outcome.clone(),
        digest: observed.digest.clone(),
        verdict: if reason.is_empty() { CellVerdict::Pass } else { CellVerdict::Fail },
        reason,
    }
}

/// The first expectation that is not met; empty when all are. `late_ms` is by how much a detection is late.
fn wrong(
    expected: &Expectation,
    observed: &Observed,
    late_ms: Option<f64>,
    [blind_m, limit_m]: [f64; 2],
    has_no_effect: bool,
    deviation_m: f64,
) -> String {
    if observed.touched {
        return "the body touched something".to_owned();
    }
    if !expected.outcomes.contains(&observed.outcome) {
        return format!("outcome {}, allowed: {}", observed.outcome, expected.outcomes.join(", "));
    }
    if has_no_effect {
        return String::new();
    }
    match late_ms {
        None => format!("not detected, the wheels deviate by {deviation_m:.3} m"),
        Some(late_ms) if late_ms > 0.0 => format!("detected {late_ms:.0} ms too late"),
        Some(_) if blind_m > limit_m => {
            format!("{blind_m:.3} m driven until it was detected, allowed: {limit_m:.3} m")
        }
        Some(_) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::FindingPlace;

    const LIMITS: DetectionLimits =
        DetectionLimits { period_s: 0.1, deceleration_mps2: 5.0, unaffected_m: UNAFFECTED_M };

    fn fault(expect: &str) -> InjectedFault {
        let text =
            format!("title = \"\"\nmagnitude = \"\"\n[inject.scenario]\nset = {{}}\n[expect]\n{expect}");
        InjectedFault::parse("test", &text).unwrap_or_else(|error| panic!("{error}"))
    }

    /// A robot that drives along x with 1 m/s for a second, `y_m` beside its line.
    fn course(y_m: f64) -> DrivenWay {
        let at = |tenth: u64| Passed {
            at_ns: tenth * 100_000_000,
            at_m: [tenth as f64 / 10.0, y_m],
            way_m: tenth as f64 / 10.0,
            speed_mps: 1.0,
        };
        DrivenWay((0..=10).map(at).collect())
    }

    fn observed(y_m: f64, found: &[(&'static str, u64)]) -> Observed {
        let finding = |(by, at_ms): &(&'static str, u64)| Finding {
            by,
            what: "late",
            place: FindingPlace { at_ns: at_ms * 1_000_000, way_m: *at_ms as f64 * 1e-3 },
        };
        Observed {
            from_ns: 0,
            findings: found.iter().map(finding).collect(),
            course: course(y_m),
            unaffected: course(0.0),
            outcome: "reached".to_owned(),
            digest: String::new(),
            ended: true,
            touched: false,
            min_clearance_m: 0.3,
        }
    }

    fn reason(expect: &str, observed: &Observed) -> String {
        judge(&fault(expect), DrivePhase::Straight, observed, &LIMITS).reason
    }

    const EXPECT: &str = "outcomes = [\"reached\"]\ndetected_by = [\"robot\", \"actuator\"]\nwithin_ms = 350";

    #[test]
    fn a_detection_in_time_by_one_that_must_passes_and_another_does_not() {
        assert_eq!(reason(EXPECT, &observed(0.1, &[("actuator", 300)])), "");
        let by_another = observed(0.1, &[("estimator", 300)]);
        assert_eq!(reason(EXPECT, &by_another), "not detected, the wheels deviate by 0.100 m");
        assert_eq!(reason(EXPECT, &observed(0.1, &[("actuator", 400)])), "detected 50 ms too late");
    }

    #[test]
    fn what_is_not_detected_passes_only_where_it_has_no_effect() {
        assert_eq!(reason(EXPECT, &observed(0.049, &[])), "");
        assert_eq!(reason(EXPECT, &observed(0.051, &[])), "not detected, the wheels deviate by 0.051 m");
        let never = "outcomes = [\"reached\"]\ndetected_by = []\nwithin_ms = 0";
        assert_ne!(reason(never, &observed(0.051, &[("actuator", 1)])), "");
    }

    #[test]
    fn a_robot_that_is_late_does_not_deviate_and_one_that_stops_early_does() {
        let (whole, short) = (course(0.0), DrivenWay(course(0.0).0[..5].to_vec()));
        assert_eq!(short.deviation_m(&whole, false), 0.0);
        assert!((short.deviation_m(&whole, true) - 0.6).abs() < 1e-12);
        assert!((course(0.2).deviation_m(&whole, false) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn the_way_until_the_detection_is_three_periods_and_the_braking_way() {
        let late = EXPECT.replace("350", "900");
        assert_eq!(reason(&late, &observed(0.1, &[("robot", 400)])), "");
        let allowed = "allowed: 0.400 m";
        let found = reason(&late, &observed(0.1, &[("robot", 401)]));
        assert_eq!(found, format!("0.401 m driven until it was detected, {allowed}"));
        // Counted from when it can be detected.
        let grows = format!("{late}\ndetectable_ms = 300");
        assert_eq!(reason(&grows, &observed(0.1, &[("robot", 650)])), "");
        // Counted from when it has an effect, which this one has at once.
        let effect = format!("{late}\nfrom_effect = true");
        assert_ne!(reason(&effect, &observed(0.1, &[("robot", 401)])), "");
    }

    #[test]
    fn contact_and_an_outcome_that_is_not_allowed_fail_in_any_case() {
        let touched = Observed { touched: true, ..observed(0.0, &[("robot", 1)]) };
        assert_eq!(reason(EXPECT, &touched), "the body touched something");
        let missed = Observed { outcome: "missed".to_owned(), ..observed(0.0, &[("robot", 1)]) };
        assert_eq!(reason(EXPECT, &missed), "outcome missed, allowed: reached");
    }
}
