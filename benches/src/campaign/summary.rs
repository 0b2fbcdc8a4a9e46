//! The figures of a campaign, over all courses and per family.

use std::collections::BTreeMap;

use audit::digest::digest_of_texts;
use courses::course::Family;
use courses::judge::Verdict;
use emulator::Outcome;
use figures::upper_bound_95;
use report::NO_OBSTACLE_M;
use serde::Serialize;

use super::failures::BadCourse;
use super::kind::Kind;
use super::run::CourseRun;

/// Width of a class of gaps [m].
const CLASS_M: f64 = 0.1;

/// The result of a campaign.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Summary {
    pub(super) runs: u64,
    pub(super) reached: u64,
    pub(super) missed: u64,
    pub(super) stopped: u64,
    pub(super) timeout: u64,
    /// Contacts of the moving robot that are not excused.
    pub(super) collision: u64,
    pub(super) collision_excused: u64,
    pub(super) passable: u64,
    pub(super) passable_reached: u64,
    pub(super) blocked: u64,
    pub(super) blocked_stopped: u64,
    pub(super) min_clearance_m: f64,
    pub(super) min_rest_clearance_m: f64,
    pub(super) without_rest: u64,
    /// Of the digests of all courses in their order.
    pub(super) digest: String,
    pub(super) time_to_goal_s: BTreeMap<&'static str, f64>,
    pub(super) families: Vec<FamilySummary>,
    /// Number of bad courses per cause.
    pub(super) causes: BTreeMap<String, u64>,
    pub(super) bad: Vec<BadCourse>,
}

/// The figures of one family.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(super) struct FamilySummary {
    pub(super) name: String,
    pub(super) runs: u64,
    pub(super) reached: u64,
    pub(super) stopped_rightly: u64,
    pub(super) stopped_wrongly: u64,
    pub(super) missed: u64,
    pub(super) missed_by_estimate: u64,
    pub(super) impassable: u64,
    pub(super) collision: u64,
    pub(super) collision_excused: u64,
    /// Wrong stops in which a moving body struck the robot.
    pub(super) struck: u64,
    /// Largest probability of a contact that is not excused, moving or standing, which agrees with the runs, with 95 %
    /// confidence.
    pub(super) collision_bound_95: f64,
    pub(super) min_clearance_m: f64,
    /// Classes of gaps, where the family has them.
    pub(super) gaps: Vec<GapClass>,
}

/// Courses with gaps of about one width.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(super) struct GapClass {
    /// Middle of the class.
    pub(super) gap_m: f64,
    pub(super) runs: u64,
    /// Courses on which the robot got through.
    pub(super) passed: u64,
}

impl Summary {
    /// The figures of all runs; bad courses are added later.
    pub(super) fn of(runs: &[CourseRun]) -> Self {
        let mut summary = Self {
            min_clearance_m: NO_OBSTACLE_M,
            min_rest_clearance_m: NO_OBSTACLE_M,
            families: families(runs),
            digest: digest_of_texts(runs.iter().map(|run| run.digest.as_str())),
            ..Self::default()
        };
        runs.iter().for_each(|run| summary.add(run));
        let mut times: Vec<f64> =
            runs.iter().filter(|run| run.outcome == Outcome::Reached).map(|run| run.time_s).collect();
        times.sort_by(f64::total_cmp);
        if let (Some(first), Some(last)) = (times.first(), times.last()) {
            summary.time_to_goal_s =
                BTreeMap::from([("min", *first), ("p50", times[times.len() / 2]), ("max", *last)]);
        }
        summary
    }

    fn add(&mut self, run: &CourseRun) {
        self.runs += 1;
        let count = match (run.judgement.verdict, run.outcome) {
            (Verdict::Collision, _) => &mut self.collision,
            (Verdict::CollisionExcused, _) => &mut self.collision_excused,
            (_, Outcome::Reached) => &mut self.reached,
            (_, Outcome::Missed) => &mut self.missed,
            (_, Outcome::Stopped) => &mut self.stopped,
            _ => &mut self.timeout,
        };
        *count += 1;
        let (passable, kind) = (run.judgement.passable, run.course.kind);
        let is_hostile = matches!(kind, Kind::Hostile(_) | Kind::Curved | Kind::Given(_));
        if passable && (is_hostile || matches!(kind, Kind::Mixed(Family::Plain | Family::Symmetric))) {
            self.passable += 1;
            self.passable_reached += u64::from(run.outcome == Outcome::Reached);
        }
        if !passable && (is_hostile || kind == Kind::Mixed(Family::Blocked)) {
            self.blocked += 1;
            self.blocked_stopped += u64::from(run.outcome == Outcome::Stopped);
        }
        self.min_clearance_m = self.min_clearance_m.min(run.min_clearance_m);
        self.min_rest_clearance_m = self.min_rest_clearance_m.min(run.min_rest_clearance_m);
        self.without_rest += run.without_rest;
    }

    /// Adds a bad course.
    pub(super) fn add_bad(&mut self, bad: BadCourse) {
        *self.causes.entry(bad.cause.clone()).or_default() += 1;
        self.bad.push(bad);
    }
}

/// One entry per family that was driven, in the order of the families.
fn families(runs: &[CourseRun]) -> Vec<FamilySummary> {
    let mut families: BTreeMap<Kind, Vec<&CourseRun>> = BTreeMap::new();
    for run in runs {
        families.entry(run.course.kind).or_default().push(run);
    }
    families.into_values().map(|runs| FamilySummary::of(&runs)).collect()
}

impl FamilySummary {
    pub(super) fn of(runs: &[&CourseRun]) -> Self {
        let count =
            |wanted: &dyn Fn(&CourseRun) -> bool| runs.iter().filter(|run| wanted(run)).count() as u64;
        let verdict = |verdict| count(&move |run| run.judgement.verdict == verdict);
        let (total, collision) = (runs.len() as u64, verdict(Verdict::Collision));
        let struck = count(&|run| run.judgement.is_struck());
        Self {
            name: runs.first().map(|run| run.family.clone()).unwrap_or_default(),
            runs: total,
            reached: verdict(Verdict::Reached),
            stopped_rightly: verdict(Verdict::StoppedRightly),
            stopped_wrongly: verdict(Verdict::StoppedWrongly),
            missed: verdict(Verdict::Missed),
            missed_by_estimate: count(&|run| run.judgement.missed_by_estimate),
            impassable: count(&|run| !run.judgement.passable),
            collision,
            collision_excused: verdict(Verdict::CollisionExcused),
            struck,
            collision_bound_95: upper_bound_95(collision + struck, total),
            min_clearance_m: runs.iter().map(|run| run.min_clearance_m).fold(NO_OBSTACLE_M, f64::min),
            gaps: gaps(runs),
        }
    }
}

/// The classes of gaps in ascending order.
fn gaps(runs: &[&CourseRun]) -> Vec<GapClass> {
    let mut classes: BTreeMap<i64, GapClass> = BTreeMap::new();
    for (gap_m, run) in runs.iter().filter_map(|run| Some((run.gap_m?, run))) {
        let number = (gap_m / CLASS_M).floor();
        let class = classes.entry(number as i64).or_default();
        class.gap_m = (number + 0.5) * CLASS_M;
        class.runs += 1;
        class.passed += u64::from(run.passed());
    }
    classes.into_values().collect()
}

#[cfg(test)]
mod tests {
    use courses::course::hostile::Hostile;
    use courses::judge::Judgement;

    use super::super::course::Course;
    use super::*;

    fn run(verdict: Verdict, outcome: Outcome, gap_m: f64) -> CourseRun {
        let cause = if gap_m == 1.23 { "struck-moving" } else { "none" }.to_owned();
        let passable = verdict != Verdict::StoppedRightly;
        let judgement = Judgement { verdict, missed_by_estimate: false, passable, cause };
        CourseRun {
            course: Course { kind: Kind::Hostile(Hostile::Gap), seed: 1 },
            scenario: plan::scenario("corridor").unwrap(),
            family: "gap".to_owned(),
            gap_m: Some(gap_m),
            outcome,
            reason: String::new(),
            judgement,
            time_s: 10.0,
            min_clearance_m: gap_m / 4.0,
            min_rest_clearance_m: 0.1,
            without_rest: 0,
            digest: String::new(),
        }
    }

    #[test]
    fn verdicts_are_counted_once_and_gaps_are_classed() {
        let runs = [
            run(Verdict::Reached, Outcome::Reached, 0.91),
            run(Verdict::StoppedWrongly, Outcome::Stopped, 0.99),
            run(Verdict::StoppedRightly, Outcome::Stopped, 0.5),
            run(Verdict::StoppedWrongly, Outcome::Stopped, 1.23),
            run(Verdict::Collision, Outcome::Collision, 1.21),
            run(Verdict::CollisionExcused, Outcome::Stopped, 1.25),
            run(Verdict::Missed, Outcome::Missed, 1.22),
        ];
        let summary = Summary::of(&runs);
        let Summary { runs, reached, missed, stopped, collision, collision_excused, .. } = summary;
        assert_eq!((runs, reached, missed, stopped, collision, collision_excused), (7, 1, 1, 3, 1, 1));
        let family = &summary.families[0];
        assert_eq!((family.name.as_str(), family.runs, family.reached, family.missed), ("gap", 7, 1, 1));
        assert_eq!((family.stopped_rightly, family.stopped_wrongly, family.impassable), (1, 2, 1));
        assert_eq!((family.collision, family.struck), (1, 1));
        assert_eq!(family.collision_bound_95, upper_bound_95(2, 7));
        assert_eq!(family.min_clearance_m, 0.125);
        let classes: Vec<(u64, u64)> = family.gaps.iter().map(|class| (class.runs, class.passed)).collect();
        assert_eq!(classes, [(1, 0), (2, 1), (4, 1)]);
        assert!((family.gaps[1].gap_m - 0.95).abs() < 1e-12);
    }
}
