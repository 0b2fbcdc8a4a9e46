//! `scanloop check`: validates files and prints the graph of processes and topics.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use console::answer;
use console::exit::{Exit, Failure};
use console::new_file;
use console::output::data;
use console::user_file::{self, TEXT_BYTES};
use emulator::Scenario;
use plan::system::System;
use plan::{Choice, Plan, difference, hosts};
use runtime::{OPERATOR, Reserve, printable};
use shared_types::{Role, TOPICS, Topic};
use toml::Table;
use vehicle::Setting;

use crate::cli::CheckArguments;

/// What some editors write before the text of a file.
const MARK: &[u8] = "\u{feff}".as_bytes();

/// Validates all files named, or the default scenario and system, and prints the graph.
///
/// # Errors
/// The first bad file, with key, value and range; exit code 2.
pub(crate) fn check(arguments: &CheckArguments) -> anyhow::Result<Exit> {
    if arguments.list {
        data(&Scenario::names().collect::<Vec<_>>().join("\n"))?;
        return Ok(Exit::Done);
    }
    if arguments.migrate {
        arguments.files.iter().try_for_each(|file| migrate(file))?;
    }
    let mut choice = arguments.choice.clone();
    let mut scenarios = Vec::new();
    let mut shown = BTreeSet::new();
    for file in &arguments.files {
        if is_system(file) {
            choice.system = Some(PathBuf::from(file));
            let plan = Plan::read(None, &Choice { overrides: Vec::new(), ..choice.clone() })?;
            answer!(false, "{file}: a valid system")?;
            warn(&plan, &mut shown);
        } else {
            scenarios.push(file.as_str());
        }
    }
    let mut plan = None;
    for scenario in &scenarios {
        let checked = Plan::read(Some(scenario), &choice)?;
        let (obstacles, goals) = (checked.scenario.placed_obstacles().len(), checked.scenario.goal.all());
        let places: Vec<_> = goals.iter().map(|goal| format!("({}, {})", goal.x_m, goal.y_m)).collect();
        let name = if let [_] = goals { "goal" } else { "goals" };
        answer!(
            false,
            "{scenario}: a valid scenario, {obstacles} obstacles, {name} at {}",
            places.join(", ")
        )?;
        remark(&checked, &mut shown)?;
        plan = Some(checked);
    }
    let plan = match plan {
        Some(plan) => plan,
        None => {
            let plan = Plan::read(None, &choice)?;
            remark(&plan, &mut shown)?;
            plan
        }
    };
    data(&printable(&(graph(&plan.system) + &hosts::describe(&plan.system) + &own_graph(&plan)?)))?;
    Ok(Exit::Done)
}

/// Rewrites a file that has keys of an older version, and prints what has changed.
fn migrate(file: &str) -> anyhow::Result<()> {
    let refuse = |reason: String| Failure::bad_input(format!("{file}: {reason}"));
    // Of a link, the file that it leads to.
    let path = Path::new(file).canonicalize().map_err(|error| refuse(error.to_string()))?;
    let text = user_file::read(&path, TEXT_BYTES).map_err(refuse)?;
    let migration = plan::migrate::migrate(&text).map_err(refuse)?;
    if migration.changes.is_empty() {
        answer!(false, "{file}: nothing to change")?;
        return Ok(());
    }
    let (owner, user) = (path.metadata()?.uid(), rustix::process::geteuid());
    if owner != user.as_raw() && !user.is_root() {
        return Err(refuse(format!(
            "it belongs to the user {owner}, who has to migrate it: no other one can keep it theirs"
        )));
    }
    // A byte order mark is no part of the text.
    let mark = user_file::read_start(&path, MARK.len() as u64).is_ok_and(|start| start == MARK);
    new_file::write(&path, &[if mark { MARK } else { &[] }, migration.text.as_bytes()].concat())?;
    migration.changes.iter().try_for_each(|change| answer!(false, "{file}: {change}").map(drop))
}

/// Prints the warnings of a plan, where its scenario differs from the description, and what limits the speed.
fn remark(plan: &Plan, shown: &mut BTreeSet<String>) -> anyhow::Result<()> {
    warn(plan, shown);
    let mut lines = difference::list(&plan.differences_of_truth()).into_iter().chain(plan.careful());
    lines.try_for_each(|line| answer!(false, "  {line}").map(drop))
}

/// Prints the warnings of a plan that were not shown before: those of a system belong to each of its scenarios.
fn warn(plan: &Plan, shown: &mut BTreeSet<String>) {
    for warning in plan.warnings.iter().filter(|warning| shown.insert((*warning).clone())) {
        runtime::print(runtime::Priority::Warning, &format!("  warning: {warning}"));
    }
}

/// The processes in the order of the data flow, each with what it reads and writes.
pub(crate) fn graph(system: &System) -> String {
    let mut text = format!("{} Hz, {} processes\n", system.rate_hz, system.processes.len());
    for role in Role::ALL {
        let label = system.entry(*role).map_or_else(String::new, |entry| entry.label());
        let (inputs, outputs) = (names(role.reads()), names(role.writes()));
        let also = system.entry(*role).into_iter().flat_map(|entry| &entry.also_reads);
        let inputs = also.fold(inputs, |text, also| format!("{text}, {}", also.topic));
        let _ = writeln!(text, "  {inputs:<22} -> [{role} = {label}] -> {outputs}");
    }
    let latched: Vec<Topic> = TOPICS.into_iter().filter(|topic| topic.writer().is_none()).collect();
    let _ = writeln!(text, "  outside the loop: {}, truth", names(&latched));
    text
}

/// The companions with what they read and write, the topics that the operator writes, and the memory of all.
fn own_graph(plan: &Plan) -> anyhow::Result<String> {
    let (mut text, own) = (String::new(), &plan.own_topics);
    for entry in plan.system.companions() {
        let (inputs, outputs) = (entry.reads().join(", "), entry.writes().join(", "));
        let needed = if entry.is_needed() { ", needed" } else { "" };
        let _ =
            writeln!(text, "  {inputs:<22} -> ({} = {}{needed}) -> {outputs}", entry.name(), entry.label());
    }
    for row in own.topic.iter().filter(|row| row.writer == OPERATOR) {
        let _ = writeln!(text, "  {:<22} -> {}", "operator", row.name);
    }
    let (own_bytes, system_bytes) = (own.bytes()?, Reserve::of_a_system(plan.system.period_ns()));
    let _ = write!(text, "  shared memory: {} KiB", (own_bytes + system_bytes).div_ceil(1024));
    if !own.topic.is_empty() || !own.companion.is_empty() {
        let (kib, topics, companions) = (own_bytes.div_ceil(1024), own.topic.len(), own.companion.len());
        let _ = write!(text, ", of these {kib} KiB for {topics} topics and {companions} companions");
    }
    Ok(text + "\n")
}

fn names(topics: &[Topic]) -> String {
    topics.iter().map(|topic| topic.name()).collect::<Vec<_>>().join(", ")
}

/// A file with processes or a rate is a system; anything else, and every shipped name, is a scenario.
fn is_system(file: &str) -> bool {
    let path = Path::new(file);
    if !path.is_file() && Scenario::shipped(file).is_some() {
        return false;
    }
    // A file that can't be read or is not TOML is refused as a scenario, with the line.
    let text = user_file::read(path, TEXT_BYTES).unwrap_or_default();
    let table = text.parse::<Table>().unwrap_or_default();
    System::keys().iter().any(|key| table.contains_key(key.name))
}
