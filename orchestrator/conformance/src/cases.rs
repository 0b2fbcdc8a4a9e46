//! The cases of all roles: what `cases.toml` requires, and the functions that play them.

use std::fmt::Write as _;

use anyhow::Context;
use console::exit::Failure;
use serde::Deserialize;
use shared_types::{Role, did_you_mean};

use super::case::{Case, Entry, Play};
use super::robot::device;
use super::{actuator, answers, controller, estimator, intake, lifecycle, obstacles, robot};

/// The functions of the cases, by group and name.
const FUNCTIONS: [(&str, &[(&str, Play)]); 12] = [
    ("every role", &lifecycle::CASES),
    ("every stage", &answers::CASES),
    ("every stage", &intake::CASES),
    ("estimator, obstacles, controller", &[("missing-input", intake::missing_input)]),
    ("estimator, obstacles", &[("lost-state", answers::lost_state)]),
    ("robot", &robot::CASES),
    ("robot", &device::CASES),
    ("estimator", &estimator::CASES),
    ("obstacles", &obstacles::CASES),
    ("obstacles", &obstacles::scanner::CASES),
    ("controller", &controller::CASES),
    ("actuator", &actuator::CASES),
];

/// The file of all cases.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cases {
    #[serde(rename = "group")]
    groups: Vec<Group>,
}

/// Cases of the same roles.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    name: String,
    roles: Vec<String>,
    #[serde(rename = "case")]
    entries: Vec<Entry>,
}

impl Cases {
    fn read() -> anyhow::Result<Self> {
        toml::from_str(include_str!("cases.toml")).context("cases.toml")
    }

    /// The groups of a role.
    fn of(self, role: Role) -> impl Iterator<Item = Group> {
        self.groups.into_iter().filter(move |group| group.roles.iter().any(|name| name == role.name()))
    }
}

/// The cases of a role in the order in which they are played.
fn cases(role: Role) -> anyhow::Result<Vec<Case>> {
    let mut cases = Vec::new();
    for Group { name, entries, .. } in Cases::read()?.of(role) {
        for entry in entries {
            let play = function(&name, &entry.name);
            let play = play.with_context(|| format!("case {} of {name} has no function", entry.name))?;
            cases.push(Case { entry, play });
        }
    }
    Ok(cases)
}

/// The function that plays a case of a group.
fn function(group: &str, case: &str) -> Option<Play> {
    let functions = FUNCTIONS.iter().filter(|(name, _)| *name == group).flat_map(|(_, functions)| *functions);
    functions.clone().find(|(name, _)| *name == case).map(|(_, play)| *play)
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
    let cases = Cases::read()?;
    let Some(role) = role else {
        return Ok(cases.groups.iter().map(Group::section).collect::<Vec<_>>().join("\n"));
    };
    let entries = cases.of(role).flat_map(|group| group.entries).collect();
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
        let groups = Cases::read().unwrap().groups;
        for (group, functions) in FUNCTIONS {
            let group = groups.iter().find(|known| known.name == group).expect(group);
            for (name, _) in functions {
                assert!(group.entries.iter().any(|entry| entry.name == *name), "{}: {name}", group.name);
            }
        }
        // No case stands twice, so equal numbers leave none without a function.
        let functions: usize = FUNCTIONS.iter().map(|(_, functions)| functions.len()).sum();
        assert_eq!(functions, groups.iter().map(|group| group.entries.len()).sum::<usize>());
        for role in Role::ALL {
            assert!(cases(*role).unwrap().len() > lifecycle::CASES.len(), "{role}");
        }
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
        for Group { name, roles, entries } in Cases::read().unwrap().groups {
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
