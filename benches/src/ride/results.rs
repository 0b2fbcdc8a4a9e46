//! The figures of all courses.

use std::collections::BTreeMap;

use console::exit::Exit;
use emulator::Outcome;
use report::ride::RideFigures;
use serde::Serialize;

/// A drive can't be better than its optimum: a smaller regret is a fault of the bench. The hundredth is for what a
/// drive gains between the nodes of the optimum, and from descriptions that changed.
const SMALLEST_REGRET: f64 = 0.99;
/// An optimum that costs less has nothing to steer past: J of the drive is then its noise, and a ratio has no meaning.
const CLEAR_OBJECTIVE: f64 = 0.1;
/// Number of courses with the largest regret that are listed.
const WORST: usize = 5;

/// The figures of one course.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(super) struct Row {
    pub(super) name: String,
    /// Seed and family of a random course.
    pub(super) seed: Option<u64>,
    pub(super) family: Option<&'static str>,
    pub(super) outcome: Outcome,
    /// Drive commands whose plan was solved.
    pub(super) plans: usize,
    /// Those with a node at the edge of an ellipse, (7.34).
    pub(super) active_ellipse_plans: usize,
    /// J driven over J of the optimum.
    pub(super) regret: Option<f64>,
    pub(super) driven: Option<RideFigures>,
    pub(super) optimum: Option<RideFigures>,
    /// The figures of `driven` and `optimum` that the goals are about, side by side.
    #[serde(flatten)]
    pub(super) goals: Goals,
    /// Why there is no regret.
    pub(super) note: String,
}

/// What the goals of a ride are about; `None` without a drive to the goal or an optimum.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Goals {
    steering_total_variation_rad: Option<f64>,
    optimum_total_variation_rad: Option<f64>,
    second_difference_rad: Option<f64>,
    optimum_second_difference_rad: Option<f64>,
    step_max_rad: Option<f64>,
    clearance_m: Option<f64>,
    optimum_clearance_m: Option<f64>,
}

/// The distribution of one figure over the courses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) mean: f64,
    pub(super) p95: f64,
    pub(super) max: f64,
}

/// The goals of a ride over all courses that have a regret.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Summary {
    pub(super) courses: usize,
    pub(super) regret: Spread,
    /// The regret of each family of random courses.
    pub(super) families: BTreeMap<&'static str, Spread>,
    /// Sum of second differences, as a multiple of the optimum's.
    pub(super) second_difference_ratio: Option<Spread>,
    pub(super) steering_step_max_rad: Option<Spread>,
    /// Clearance of the optimum minus that of the drive.
    pub(super) clearance_loss_m: Option<Spread>,
    /// Time of the drive minus that of the optimum.
    pub(super) time_loss_s: Option<Spread>,
    /// Largest J of the drives whose line is clear; they have no regret.
    pub(super) clear_objective_max: Option<f64>,
    /// Names of the courses with the largest regret, the worst first.
    pub(super) worst: Vec<String>,
}

/// What the command prints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Results {
    #[serde(rename = "scenarios")]
    pub(super) rows: Vec<Row>,
    pub(super) summary: Option<Summary>,
    /// Names of the courses whose drive is better than the optimum.
    pub(super) faults: Vec<String>,
    #[serde(skip)]
    pub(super) is_random: bool,
}

impl Results {
    pub(super) fn new(rows: Vec<Row>, is_random: bool) -> Self {
        let faulty =
            |row: &&Row| row.regret.is_some_and(|regret| regret.is_nan() || regret < SMALLEST_REGRET);
        let faults = rows.iter().filter(faulty).map(|row| row.name.clone()).collect();
        Self { summary: Summary::of(&rows), rows, faults, is_random }
    }

    /// 1 when an optimum is worse than its drive.
    pub(super) fn exit(&self) -> Exit {
        if self.faults.is_empty() { Exit::Done } else { Exit::NotReached }
    }
}

impl Row {
    /// Compares a drive with the optimum, where there is something to steer past.
    pub(super) fn compare(&mut self, driven: RideFigures, optimum: Option<RideFigures>) {
        (self.optimum, self.goals) = (optimum, Goals::of(&driven, optimum));
        match optimum {
            Some(optimum) if optimum.min_clearance_m < 0.0 => {
                self.note = "the optimum touches a body that was described too late".to_owned();
            }
            Some(optimum) if optimum.objective >= CLEAR_OBJECTIVE => {
                self.regret = Some(driven.objective / optimum.objective);
            }
            _ => self.note = "the line is clear".to_owned(),
        }
    }

    /// Sum of second differences as a multiple of the optimum's.
    fn second_difference_ratio(&self) -> Option<f64> {
        let (driven, optimum) = (self.driven?, self.optimum?);
        Some(driven.steering_second_difference_rad / optimum.steering_second_difference_rad)
    }

    /// Clearance of the optimum minus that of the drive.
    fn clearance_loss_m(&self) -> Option<f64> {
        Some(self.optimum?.min_clearance_m - self.driven?.min_clearance_m)
    }
}

impl Goals {
    pub(super) fn of(driven: &RideFigures, optimum: Option<RideFigures>) -> Self {
        Self {
            steering_total_variation_rad: Some(driven.steering_total_variation_rad),
            optimum_total_variation_rad: optimum.map(|best| best.steering_total_variation_rad),
            second_difference_rad: Some(driven.steering_second_difference_rad),
            optimum_second_difference_rad: optimum.map(|best| best.steering_second_difference_rad),
            step_max_rad: Some(driven.steering_step_max_rad),
            clearance_m: Some(driven.min_clearance_m),
            optimum_clearance_m: optimum.map(|best| best.min_clearance_m),
        }
    }
}

impl Summary {
    fn of(rows: &[Row]) -> Option<Self> {
        let mut with: Vec<&Row> = rows.iter().filter(|row| row.regret.is_some()).collect();
        let spread = |figure: &dyn Fn(&Row) -> Option<f64>| {
            Spread::of(with.iter().filter_map(|row| figure(row)).collect())
        };
        let regret = spread(&|row| row.regret)?;
        let step = spread(&|row| Some(row.driven?.steering_step_max_rad));
        let time = spread(&|row| Some(row.driven?.time_s - row.optimum?.time_s));
        let (ratio, clearance) = (spread(&Row::second_difference_ratio), spread(&Row::clearance_loss_m));
        let is_clear = |row: &&Row| row.regret.is_none() && row.optimum.is_some();
        let clear = rows.iter().filter(is_clear).filter_map(|row| row.driven).map(|driven| driven.objective);
        let clear = clear.reduce(f64::max);
        with.sort_by(|one, other| other.regret.unwrap_or(0.0).total_cmp(&one.regret.unwrap_or(0.0)));
        Some(Self {
            courses: with.len(),
            regret,
            families: families(&with),
            second_difference_ratio: ratio,
            steering_step_max_rad: step,
            clearance_loss_m: clearance,
            time_loss_s: time,
            clear_objective_max: clear,
            worst: with.iter().take(WORST).map(|row| row.name.clone()).collect(),
        })
    }
}

/// The regret of each family.
fn families(rows: &[&Row]) -> BTreeMap<&'static str, Spread> {
    let mut regrets: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    for row in rows {
        if let (Some(family), Some(regret)) = (row.family, row.regret) {
            regrets.entry(family).or_default().push(regret);
        }
    }
    regrets.into_iter().filter_map(|(family, regrets)| Some((family, Spread::of(regrets)?))).collect()
}

impl Spread {
    /// Of values; those that are not finite are left out.
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.retain(|value| value.is_finite());
        values.sort_by(f64::total_cmp);
        let max = *values.last()?;
        let p95 = values[(0.95 * (values.len() - 1) as f64).round() as usize];
        Some(Self { mean: values.iter().sum::<f64>() / values.len() as f64, p95, max })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, driven: f64, optimum: f64) -> Row {
        let figures = |objective| {
            Some(RideFigures {
                objective,
                steering_second_difference_rad: objective,
                ..RideFigures::default()
            })
        };
        Row {
            name: name.to_owned(),
            regret: Some(driven / optimum),
            driven: figures(driven),
            optimum: figures(optimum),
            ..Row::default()
        }
    }

    #[test]
    fn a_drive_that_is_better_than_its_optimum_is_a_fault() {
        let results = |driven| Results::new(vec![row("good", 2.0, 1.0), row("odd", driven, 1.0)], false);
        assert_eq!((results(0.991).faults.len(), results(0.991).exit()), (0, Exit::Done));
        assert_eq!(
            (results(0.989).faults, results(0.989).exit()),
            (vec!["odd".to_owned()], Exit::NotReached)
        );
        assert_eq!(results(f64::NAN).exit(), Exit::NotReached);
    }

    #[test]
    fn a_clear_line_has_no_regret() {
        let compare = |objective| {
            let figures = |objective| RideFigures { objective, ..RideFigures::default() };
            let mut row = Row { driven: Some(figures(0.2)), ..Row::default() };
            row.compare(figures(0.2), Some(figures(objective)));
            row
        };
        assert_eq!((compare(0.1).regret, compare(0.09).regret), (Some(2.0), None));
        let touches = RideFigures { objective: 0.1, min_clearance_m: -0.01, ..RideFigures::default() };
        let mut row = Row::default();
        row.compare(touches, Some(touches));
        assert!(row.regret.is_none() && row.note.contains("touches"));
        let results = Results::new(vec![compare(0.1), compare(0.0)], true);
        assert_eq!(results.summary.unwrap().clear_objective_max, Some(0.2));
    }

    #[test]
    fn families_of_random_courses_have_their_own_regret() {
        let of = |family, driven| Row { family: Some(family), ..row(family, driven, 1.0) };
        let rows = vec![of("plain", 1.0), of("plain", 3.0), of("moving", 5.0)];
        let families = Results::new(rows, true).summary.unwrap().families;
        assert_eq!(families["plain"], Spread { mean: 2.0, p95: 3.0, max: 3.0 });
        assert_eq!(families["moving"].mean, 5.0);
    }

    #[test]
    fn the_summary_is_over_the_courses_that_have_a_regret() {
        let rows: Vec<Row> =
            (0..=20).map(|index| row(&index.to_string(), 1.0 + f64::from(index), 1.0)).collect();
        let rows = rows.into_iter().chain([Row::default()]).collect();
        let summary = Results::new(rows, true).summary.unwrap();
        assert_eq!((summary.courses, summary.regret), (21, Spread { mean: 11.0, p95: 20.0, max: 21.0 }));
        assert!(summary.families.is_empty());
        assert_eq!(summary.worst, ["20", "19", "18", "17", "16"]);
        assert!(Results::new(vec![Row::default()], true).summary.is_none());
    }
}
