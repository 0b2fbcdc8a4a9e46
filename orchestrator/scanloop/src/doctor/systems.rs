//! Systems of this user that run, and what dead ones have left.

use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::MetadataExt;

use runtime::{Domain, RuntimeError};
use supervision::lock::is_hidden;
use supervision::runs::{LivingRun, RunProcess};

use super::check::Check;

/// A system as it is seen from here.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Seen {
    system_id: String,
    /// What it is.
    what: What,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum What {
    /// It runs, with so many processes; it has none while it starts or ends.
    Running(usize),
    /// It runs in another namespace, where its processes are not seen.
    Elsewhere,
    /// Its orchestrator died, and these processes drive on.
    Orphaned(String),
    /// Its run is over, and these processes live.
    Strays(String),
    /// Nothing lives of it, and its files are left.
    Files,
    /// Files in shared memory of a run, by its id, of which nothing else is found here.
    Bus,
}

/// The systems that run.
pub(super) fn running() -> Check {
    running_of(&all())
}

/// What dead systems have left, with the commands that clear it.
pub(super) fn left_overs() -> Check {
    left_overs_of(&all())
}

/// Why no system of the chosen id can be made; `None` where it can, or where one runs.
pub(super) fn id(found: Result<Option<Domain>, RuntimeError>) -> Option<Check> {
    let error = found.err()?;
    Some(Check::fail(
        "system_id",
        error.to_string(),
        "`--system-id NAME`, or `SCANLOOP_SYSTEM_ID`, with another name",
    ))
}

/// All systems of this user.
fn all() -> Vec<Seen> {
    let runs = LivingRun::with_strays(rustix::process::geteuid().as_raw());
    let list = |processes: Vec<String>| processes.join(", ");
    let mut found: BTreeMap<String, What> = BTreeMap::new();
    // The page of a run that has just ended may still be open: it has no name any more.
    for run in runs.iter().filter(|run| !run.system_id.is_empty()) {
        let what = if run.is_over() {
            What::Strays(list(run.strays().map(RunProcess::description).collect()))
        } else if run.orchestrator().is_none() {
            What::Orphaned(list(run.alive()))
        } else {
            What::Running(run.members().count())
        };
        found.insert(run.system_id.clone(), what);
    }
    let (domains, _) = Domain::all_found();
    let run_ids: Vec<String> = domains.iter().map(|domain| domain.run_id().to_owned()).collect();
    for domain in domains {
        let what = if is_hidden(&domain) { What::Elsewhere } else { What::Files };
        found.entry(domain.system_id().to_owned()).or_insert(what);
    }
    let known: BTreeSet<String> = runs.iter().map(|run| run.run_id.clone()).chain(run_ids).collect();
    let named = found.into_iter().map(|(system_id, what)| Seen { system_id, what });
    let of_bus = runs_of_bus().difference(&known).cloned().collect::<Vec<_>>();
    named.chain(of_bus.into_iter().map(|run_id| Seen { system_id: run_id, what: What::Bus })).collect()
}

/// Ids of the runs of this user that have files in shared memory.
fn runs_of_bus() -> BTreeSet<String> {
    let own = rustix::process::geteuid().as_raw();
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    let own = entries.filter(|entry| entry.metadata().is_ok_and(|file| file.uid() == own));
    let names = own.filter_map(|entry| entry.file_name().into_string().ok());
    let ids = names.filter_map(|name| Some(name.strip_prefix("scanloop-")?.split('_').next()?.to_owned()));
    ids.filter(|id| Domain::is_run_id(id)).collect()
}

fn running_of(systems: &[Seen]) -> Check {
    let text = |seen: &Seen| match seen.what {
        What::Elsewhere => Some(format!("`{}` in another namespace", seen.system_id)),
        What::Running(1) => Some(format!("`{}` with 1 process", seen.system_id)),
        What::Running(count) => Some(format!("`{}` with {count} processes", seen.system_id)),
        _ => None,
    };
    let texts: Vec<String> = systems.iter().filter_map(text).collect();
    match texts.is_empty() {
        true => Check::ok("running", "no system"),
        false => Check::ok("running", format!("{}; another one needs `--system-id`", texts.join(", "))),
    }
}

fn left_overs_of(systems: &[Seen]) -> Check {
    let found: Vec<[String; 2]> = systems.iter().filter_map(left_over).collect();
    if found.is_empty() {
        return Check::ok("left_overs", "none");
    }
    let joined = |index: usize, separator| {
        found.iter().map(|pair| pair[index].as_str()).collect::<Vec<_>>().join(separator)
    };
    Check::warn("left_overs", joined(0, "; "), joined(1, ", "))
}

/// What a dead system has left, and the command that clears it.
fn left_over(seen: &Seen) -> Option<[String; 2]> {
    let id = &seen.system_id;
    let stop = format!("`scanloop stop --system-id {id}`");
    Some(match &seen.what {
        What::Running(_) | What::Elsewhere => return None,
        What::Orphaned(alive) => [format!("`{id}` has lost its orchestrator, but drives: {alive}"), stop],
        What::Strays(strays) => [format!("`{id}` is over, and has left {strays}"), stop],
        What::Files => [format!("files of `{id}`, of which nothing lives"), stop],
        What::Bus => [
            format!("files of run {id} in shared memory, of which nothing else is found here"),
            format!("`rm -r /dev/shm/scanloop-{id}*`, if no container shares /dev/shm"),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::super::check::State;
    use super::*;

    fn seen(system_id: &str, what: What) -> Seen {
        Seen { system_id: system_id.to_owned(), what }
    }

    #[test]
    fn running_systems_are_no_left_overs() {
        let systems = [seen("a", What::Running(5)), seen("b", What::Elsewhere), seen("c", What::Running(1))];
        assert_eq!(left_overs_of(&systems), Check::ok("left_overs", "none"));
        let detail = running_of(&systems).detail;
        let expected = "`a` with 5 processes, `b` in another namespace, `c` with 1 process; another one needs `--system-id`";
        assert_eq!(detail, expected);
        assert_eq!(running_of(&[seen("c", What::Files)]).detail, "no system");
    }

    #[test]
    fn an_id_that_no_system_can_have_stops_a_drive() {
        assert!(id(Ok(None)).is_none());
        let refused = id(Err(RuntimeError::SystemId("a b".to_owned()))).unwrap();
        assert_eq!(refused.state, State::Fail);
        assert!(refused.detail.starts_with("system id `a b` is not allowed"), "{}", refused.detail);
    }

    #[test]
    fn each_left_over_is_named_with_the_command_that_clears_it() {
        let systems = [
            seen("a", What::Files),
            seen("b", What::Orphaned("robot 7".to_owned())),
            seen("c", What::Strays("process 9 (sleep)".to_owned())),
            seen("0123", What::Bus),
        ];
        let found = left_overs_of(&systems);
        assert_eq!(found.state, State::Warn);
        for id in ["a", "b", "c"] {
            assert!(
                found
                    .fix
                    .as_ref()
                    .is_some_and(|fix| fix.contains(&format!("`scanloop stop --system-id {id}`")))
            );
        }
        assert!(found.fix.as_ref().is_some_and(|fix| fix.contains("`rm -r /dev/shm/scanloop-0123*`")));
        assert!(found.detail.contains("robot 7") && found.detail.contains("process 9 (sleep)"));
    }
}
