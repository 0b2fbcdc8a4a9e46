//! The courses of a campaign: which families, which seeds, and what is driven on each.

use console::exit::Failure;
use courses::course::hostile::hostile;
use courses::course::{curved, of_campaign, reversing};
use emulator::Scenario;
use plan::{Choice, Plan};

use super::arguments::CampaignArguments;
use super::kind::{Kind, named};

/// A course: its family and its seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Course {
    pub(super) kind: Kind,
    pub(super) seed: u64,
}

/// What is driven on a course.
#[derive(Debug, Clone)]
pub(super) struct Drive {
    pub(super) plan: Plan,
    /// Before any override.
    pub(super) scenario: Scenario,
    /// Width of the narrowest place, where the family has one [m].
    pub(super) gap_m: Option<f64>,
}

/// The chosen courses: without `--family` those of the mixed campaign, else `--runs` of each family.
pub(super) fn all(arguments: &CampaignArguments) -> Vec<Course> {
    let seeds = || (0..).map(|index| arguments.seed.wrapping_add(index));
    let count = usize::try_from(arguments.runs).unwrap_or(usize::MAX);
    if !arguments.scenarios.is_empty() {
        let kinds = (0..arguments.scenarios.len()).map(Kind::Given);
        return kinds.flat_map(|kind| seeds().take(count).map(move |seed| Course { kind, seed })).collect();
    }
    if arguments.families.is_empty() {
        let mixed = |seed| Course { kind: Kind::Mixed(of_campaign(seed).0), seed };
        return seeds().take(count).map(mixed).collect();
    }
    let mut kinds: Vec<Kind> = arguments.families.iter().flat_map(|name| named(name)).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let of_kind = |kind| {
        let belongs = move |seed: &u64| match kind {
            Kind::Mixed(family) => of_campaign(*seed).0 == family,
            _ => true,
        };
        seeds().filter(belongs).take(count).map(move |seed| Course { kind, seed }).collect::<Vec<_>>()
    };
    kinds.into_iter().flat_map(of_kind).collect()
}

impl Course {
    /// The course with the chosen robot, before any override, and the width of its narrowest place if it has one [m].
    ///
    /// Values that the preset draws are left open: explicit ones would become known to the stages.
    ///
    /// # Errors
    /// A scenario that is not allowed; exit code 2.
    fn scenario(self, arguments: &CampaignArguments) -> anyhow::Result<(Scenario, Option<f64>)> {
        let (scenario, gap_m) = match self.kind {
            Kind::Mixed(_) => (of_campaign(self.seed).1, None),
            Kind::Hostile(family) => {
                let course = hostile(family, self.seed);
                (course.scenario, course.gap_m)
            }
            Kind::Curved => (curved(self.seed), None),
            Kind::Reversing => (reversing(self.seed), None),
            Kind::Given(index) => {
                let scenario = plan::scenario(&arguments.scenarios[index])?;
                let name = format!("{}-{}", scenario.name, self.seed);
                (Scenario { name, seed: self.seed & i64::MAX as u64, ..scenario }, None)
            }
        };
        let scenario = Scenario { robot: arguments.robot.of(scenario.robot), ..scenario };
        let Some(scale) = arguments.scale else { return Ok((scenario, gap_m)) };
        let scenario = scenario
            .scaled(scale)
            .map_err(|error| Failure::bad_input(format!("--scale {scale}: {error}")))?;
        Ok((scenario, gap_m.map(|gap_m| gap_m * scale)))
    }

    /// The name of its family or scenario.
    pub(super) fn family(self, arguments: &CampaignArguments) -> &str {
        self.kind.name(&arguments.scenarios)
    }

    /// What is driven, with the overrides.
    ///
    /// # Errors
    /// One message with key, value and allowed range; exit code 2.
    pub(super) fn drive(self, arguments: &CampaignArguments) -> anyhow::Result<Drive> {
        let (scenario, gap_m) = self.scenario(arguments)?;
        let (system, overrides) = (arguments.system.clone(), arguments.overrides.clone());
        let choice = Choice { system, overrides, ..Choice::default() };
        Ok(Drive { plan: Plan::of(&scenario, &choice)?, scenario, gap_m })
    }
}

#[cfg(test)]
mod tests {
    use courses::course::Family;
    use courses::course::hostile::Hostile;

    use super::super::arguments::CampaignRobot;
    use super::super::kind::family_names;
    use super::*;

    fn arguments(families: &[&str], runs: u64) -> CampaignArguments {
        let families = families.iter().map(|name| (*name).to_owned()).collect();
        CampaignArguments { families, runs, ..CampaignArguments::default() }
    }

    #[test]
    fn without_a_family_seeds_are_those_of_the_mixed_campaign() {
        let courses = all(&arguments(&[], 100));
        for (course, seed) in courses.iter().zip(0..) {
            assert_eq!(*course, Course { kind: Kind::Mixed(of_campaign(seed).0), seed });
        }
        let blocked = all(&arguments(&["blocked"], 3));
        let expected: Vec<Course> =
            courses.iter().copied().filter(|course| course.kind == Kind::Mixed(Family::Blocked)).collect();
        assert_eq!(blocked, expected[..3]);
    }

    #[test]
    fn each_family_has_its_runs_once() {
        let courses = all(&arguments(&["gap", "hostile", "gap"], 2));
        assert_eq!(courses.len(), 2 * Hostile::ALL.len());
        for name in family_names() {
            assert!(!named(name).is_empty(), "{name}");
        }
    }

    #[test]
    fn a_scenario_is_driven_with_its_seeds_by_another_vehicle_and_larger() {
        let scenarios = vec!["slalom".to_owned(), "bend".to_owned()];
        let system = Some("../examples/vehicles/car.toml".into());
        let arguments = CampaignArguments { scenarios, system, scale: Some(2.0), ..arguments(&[], 3) };
        let courses = all(&arguments);
        let seeds = courses.iter().map(|course| (course.family(&arguments), course.seed));
        let expected = ["slalom", "bend"].iter().flat_map(|name| (0..3).map(move |seed| (*name, seed)));
        assert!(seeds.eq(expected), "{courses:?}");
        let plan = courses[1].drive(&arguments).unwrap().plan;
        let slalom = plan::scenario("slalom").unwrap();
        assert_eq!(plan.scenario.goal.last().x_m, 2.0 * slalom.goal.last().x_m);
        assert_eq!((plan.scenario.name.as_str(), plan.scenario.robot.width_m), ("slalom-1", 1.24));
        let message = |scale| {
            courses[0].drive(&CampaignArguments { scale: Some(scale), ..arguments.clone() }).unwrap_err()
        };
        for scale in [f64::NAN, 0.0, -1.0, 1e9] {
            assert!(message(scale).to_string().starts_with(&format!("--scale {scale}: ")), "{scale}");
        }
    }

    #[test]
    fn a_random_robot_is_within_a_fifth_of_its_description_and_has_the_usual_velocity_factor() {
        for seed in 0..20 {
            let course = Course { kind: Kind::Hostile(Hostile::Gap), seed };
            let arguments = CampaignArguments { robot: CampaignRobot::Random, ..arguments(&[], 1) };
            let values = course.drive(&arguments).unwrap().plan.scenario.robot_values();
            assert!((0.12..=0.18).contains(&values.velocity_lag_s) && values.velocity_factor == 1.4);
            assert!(
                (0.0..=0.02).contains(&values.odometry_longitudinal) && values.steering_offset_rad == 0.0
            );
        }
    }
}
