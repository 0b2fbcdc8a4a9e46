//! The cases of all roles: what `cases.toml` requires, and the functions that play them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use anyhow::Context;
use console::exit::Failure;
use serde::Deserialize;
use shared_types::{Role, did_you_mean};

use super::case::{After, Case, Entry, Own, Play, Started};
use super::controller::not_driven_on;
use super::obstacles::scanner;
use super::robot::{device, motion};
use super::{actuator, answers, controller, estimator, intake, lifecycle, obstacles, person, robot};

/// How each case is played, by group and name.
const FUNCTIONS: [(&str, &str, Play); 90] = [
    ("every role", "states", Own(lifecycle::states)),
    ("every role", "heartbeats", Started(lifecycle::heartbeats)),
    ("every role", "joins-late", Started(lifecycle::joins_late)),
    ("every role", "pause", Started(lifecycle::pause)),
    ("every role", "ends-on-request", Started(lifecycle::ends_on_request)),
    ("every role", "ends-as-orphan", Started(lifecycle::ends_as_orphan)),
    ("every role", "survives-a-new-orchestrator", Started(lifecycle::survives_a_new_orchestrator)),
    ("every role", "leaves-nothing", Own(lifecycle::leaves_nothing)),
    ("every stage", "every-scan", Started(answers::every_scan)),
    ("every stage", "in-time", Started(answers::in_time)),
    ("every stage", "header", Started(answers::header)),
    ("every stage", "valid-values", Own(answers::valid_values)),
    ("every stage", "repeatable", Own(answers::repeatable)),
    ("every stage", "state", Started(answers::state)),
    ("every stage", "resume", Own(answers::resume)),
    ("every stage", "authority", After(intake::mid_drive, intake::authority)),
    ("every stage", "exchange", After(intake::mid_drive, intake::swap)),
    ("every stage", "repeated", After(intake::mid_drive, intake::repeated)),
    ("every stage", "stale", After(intake::mid_drive, intake::stale)),
    ("every stage", "garbage", After(intake::mid_drive, intake::garbage)),
    ("every stage", "counts", After(intake::mid_drive, intake::counts)),
    ("estimator, obstacles, controller", "missing-input", After(intake::mid_drive, intake::missing_input)),
    ("estimator, obstacles", "lost-state", Started(answers::lost_state)),
    ("robot", "scans", Started(robot::scans)),
    ("robot", "header", Started(robot::header)),
    ("robot", "valid-values", Started(robot::valid_values)),
    ("robot", "increments", Started(robot::increments)),
    ("robot", "drives", Started(motion::drives)),
    ("robot", "blocks", After(motion::driving, motion::blocks)),
    ("robot", "dead-man", After(motion::driving, motion::dead_man)),
    ("robot", "authority", After(motion::standing, motion::authority)),
    ("robot", "nonsense", After(motion::standing, motion::nonsense)),
    ("robot", "repeated", After(motion::driving, motion::repeated)),
    ("robot", "stopping", After(motion::driving, robot::stopping)),
    ("robot", "truth", Started(robot::truth)),
    ("robot", "grants", Started(robot::grants)),
    ("robot", "repeatable", Own(robot::repeatable)),
    ("robot", "foreign-clock", Started(device::foreign_clock)),
    ("robot", "jitter", Started(device::jitter)),
    ("robot", "gaps", Started(device::gaps)),
    ("robot", "device-restart", Started(device::device_restart)),
    ("robot", "half-a-scan", Started(device::half_a_scan)),
    ("robot", "counts-up", Started(device::counts_up)),
    ("estimator", "near-the-truth", Started(estimator::follow)),
    ("estimator", "looks-ahead", Started(estimator::looks_ahead)),
    ("estimator", "corrects-odometry", Started(estimator::follow)),
    ("estimator", "outlier", Started(estimator::outlier)),
    ("estimator", "covariance", Started(estimator::covariance)),
    ("obstacles", "sees-a-box", Own(obstacles::sees_a_box)),
    ("obstacles", "no-phantoms", Own(obstacles::no_phantoms)),
    ("obstacles", "nearest-first", Own(obstacles::nearest_first)),
    ("obstacles", "keeps-identity", Own(obstacles::keeps_identity)),
    ("obstacles", "no-returns", Own(scanner::no_returns)),
    ("obstacles", "covered-sector", Own(scanner::covered_sector)),
    ("obstacles", "stuck", Own(scanner::stuck)),
    ("obstacles", "range-factor", Own(scanner::range_factor)),
    ("obstacles", "mounting-angle", Own(scanner::mounting_angle)),
    ("obstacles", "random-ranges", Own(scanner::random_ranges)),
    ("obstacles", "noisy-scanner", Own(scanner::noisy_scanner)),
    ("obstacles", "missing-scan", Own(scanner::missing_scan)),
    ("obstacles", "silent-body", Own(scanner::silent_body)),
    ("obstacles", "seen-free", Own(scanner::seen_free)),
    ("controller", "drives", Started(controller::drives)),
    ("controller", "stops-before-a-barrier", Own(controller::stops_before_a_barrier)),
    ("controller", "lands", Own(controller::lands)),
    ("controller", "off-the-track", Own(|suite| not_driven_on(suite, &controller::OFF_THE_TRACK))),
    ("controller", "obstacle-inside", Own(|suite| not_driven_on(suite, &controller::OBSTACLE_INSIDE))),
    ("controller", "verified", Started(controller::verified)),
    ("controller", "obeys-alarm", Own(|suite| not_driven_on(suite, &controller::ALARM))),
    ("controller", "obeys-the-scanner", Own(|suite| not_driven_on(suite, &controller::BAD_SCANNERS))),
    ("controller", "degraded-scanner", Started(controller::degraded_scanner)),
    ("controller", "by-hand", After(person::commanded, person::follows)),
    ("controller", "new-goal", After(person::commanded, controller::new_goal)),
    ("controller", "bend", Own(controller::bend)),
    ("controller", "names-its-reason", Own(controller::names_its_reason)),
    ("controller", "plan", Started(controller::plan)),
    ("actuator", "limits", After(actuator::driving, actuator::limits)),
    ("actuator", "sends-what-is-desired", Started(actuator::sends)),
    ("actuator", "calibration", Started(actuator::sends)),
    ("actuator", "obeys-stop", Own(actuator::obeys_stop)),
    ("actuator", "stop-wins", After(actuator::driving, actuator::stop_wins)),
    ("actuator", "paused", After(actuator::driving, person::paused)),
    ("actuator", "by-hand", After(actuator::driving, person::by_hand)),
    ("actuator", "emergency-stop", Started(person::emergency_stop)),
    ("actuator", "silence", After(actuator::driving, actuator::silence)),
    ("actuator", "two-after-silence", After(actuator::driving, actuator::two_after_silence)),
    ("actuator", "gap", After(actuator::driving, actuator::gap)),
    ("actuator", "future", After(actuator::driving, actuator::future)),
    ("actuator", "last-word", After(actuator::driving, actuator::last_message)),
    ("actuator", "first-word", After(actuator::driving, actuator::first_message)),
];

/// Cases of the same roles.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    name: String,
    roles: Vec<String>,
    #[serde(rename = "case")]
    entries: Vec<Entry>,
}

/// The groups of the file.
fn groups() -> anyhow::Result<Vec<Group>> {
    let mut file: BTreeMap<String, Vec<Group>> = toml::from_str(include_str!("cases.toml"))?;
    file.remove("group").context("cases.toml has no group")
}

/// The groups of a role.
fn groups_of(role: Role) -> anyhow::Result<impl Iterator<Item = Group>> {
    let is_its = move |group: &Group| group.roles.iter().any(|name| name == role.name());
    Ok(groups()?.into_iter().filter(is_its))
}

/// The cases of a role in the order in which they are played.
fn cases(role: Role) -> anyhow::Result<Vec<Case>> {
    let mut cases = Vec::new();
    for Group { name, entries, .. } in groups_of(role)? {
        for entry in entries {
            let function = FUNCTIONS.iter().find(|(group, case, _)| *group == name && *case == entry.name);
            let (_, _, play) =
                function.with_context(|| format!("case {} of {name} has no function", entry.name))?;
            cases.push(Case { entry, play: *play });
        }
    }
    Ok(cases)
}

/// The cases that were asked for.
///
/// # Errors
/// A name that no case of the role has.
pub(crate) fn chosen(role: Role, only: &[String]) -> anyhow::Result<Vec<Case>> {
    let mut all = cases(role)?;
    if let Some(unknown) = only.iter().find(|name| all.iter().all(|case| case.entry.name != **name)) {
        let names: Vec<&str> = all.iter().map(|case| case.entry.name.as_str()).collect();
        let known = names.join(", ");
        let meant = did_you_mean(unknown, names);
        return Err(Failure::bad_input(format!(
            "--only {unknown}: role {role} has no such case, it has {known}.{meant}"
        )));
    }
    all.retain(|case| only.is_empty() || only.contains(&case.entry.name));
    Ok(all)
}

/// The requirements as Markdown: of one role, or of all, where cases of several roles stand once.
///
/// # Errors
/// A mistake in the file of the cases, which is a part of the program.
pub fn list(role: Option<Role>) -> anyhow::Result<String> {
    let Some(role) = role else {
        return Ok(groups()?.iter().map(Group::section).collect::<Vec<_>>().join("\n"));
    };
    let entries = groups_of(role)?.flat_map(|group| group.entries).collect();
    Ok(Group { name: role.to_string(), roles: vec![role.to_string()], entries }.section())
}

impl Group {
    /// The group as Markdown.
    fn section(&self) -> String {
        let Self { name, roles, entries } = self;
        let mut text = format!("## {name}\n\n");
        let roles = roles.join(", ");
        if roles != *name {
            let _ = writeln!(text, "For {roles}.\n");
        }
        text.push_str("| case | level | requirement | because |\n|---|---|---|---|\n");
        for Entry { name, level, requirement, because, .. } in entries {
            let _ = writeln!(text, "| `{name}` | {} | {requirement} | {because} |", level.name());
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_case_has_a_function_and_every_function_a_case() {
        let groups = groups().unwrap();
        let in_file = |(group, case, _): &(&str, &str, Play)| {
            let of_group =
                groups.iter().filter(|known| known.name == *group).flat_map(|group| &group.entries);
            of_group.filter(|entry| entry.name == *case).count() == 1
        };
        for function in &FUNCTIONS {
            assert!(in_file(function), "{}: {}", function.0, function.1);
        }
        // Each case of a role has a function, or this fails.
        let played: BTreeSet<String> = Role::ALL
            .iter()
            .flat_map(|role| cases(*role).unwrap())
            .map(|case| case.entry.requirement)
            .collect();
        assert_eq!(played.len(), FUNCTIONS.len(), "two functions of one case, or a case of no role");
        let of_every_role = FUNCTIONS.iter().filter(|(group, ..)| *group == "every role").count();
        for role in Role::ALL {
            assert!(cases(*role).unwrap().len() > of_every_role, "{role}");
        }
    }

    #[test]
    fn the_file_of_the_cases_has_groups_alone() {
        let file: toml::Table = include_str!("cases.toml").parse().unwrap();
        assert_eq!(file.keys().collect::<Vec<_>>(), ["group"]);
    }

    #[test]
    fn names_of_cases_are_unique_within_a_role() {
        for role in Role::ALL {
            let all = cases(*role).unwrap();
            let names: BTreeSet<&str> = all.iter().map(|case| case.entry.name.as_str()).collect();
            assert_eq!(names.len(), all.len(), "{role}");
        }
    }

    #[test]
    fn a_case_of_several_roles_stands_once_with_all_its_roles() {
        let (mut names, mut requirements) = (BTreeSet::new(), BTreeSet::new());
        for Group { name, roles, entries } in groups().unwrap() {
            let known: Vec<&str> = Role::ALL.iter().map(|role| role.name()).collect();
            let in_order = known.iter().filter(|role| roles.iter().any(|name| name == *role));
            assert!(
                !roles.is_empty() && in_order.eq(&roles),
                "{name}: {roles:?} are not all roles, in order"
            );
            assert!(names.insert(name.clone()), "two groups `{name}`");
            for Entry { name, requirement, because, .. } in entries {
                assert!(requirement.ends_with('.') && because.ends_with('.'), "{name}");
                assert!(requirements.insert(requirement), "{name} stands twice");
            }
        }
    }

    #[test]
    fn an_unknown_case_is_refused_with_the_known_ones() {
        let Err(error) = chosen(Role::Robot, &["sings".to_owned()]) else { panic!("chosen") };
        assert!(error.to_string().contains("has no such case, it has states,"), "{error}");
    }
}
