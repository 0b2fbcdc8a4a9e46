//! The topics and companions of a system file: read, checked, and handed to the processes as one table.

use std::collections::BTreeMap;
use std::path::Path;

use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use estimator::EstimatorStage;
use runtime::{AlsoReads, CompanionRow, LayoutFile, MAX_COMPANIONS, OPERATOR, OwnTopics, TopicRow};
use shared_types::{Role, Stage, TOPICS, Topic, did_you_mean};
use supervision::entry::{NAME, NAME_RULE, ProcessEntry, is_name};
use vehicle::{Invalid, settings};

use crate::System;

settings! {
    /// How far a new process of the writer may differ from the old one in one field, to take over from it.
    pub struct Agreement {
        /// Name of the field.
        pub field: String = String::new(), "a field of the layout";
        /// Largest difference of its numbers, in their unit.
        pub bound: f64 = 0.0, 0.0..=1e12;
    }
}

settings! {
    /// A topic that the system adds to those of the loop.
    pub struct TopicEntry {
        /// Name of the topic.
        pub name: String = String::new(), (NAME, "must be given");
        /// File with the fields of its samples, relative to the folder of the system file.
        pub layout: String = String::new(), "a layout file, must be given";
        /// Name of the companion that writes it, or `operator` for `scanloop topic pub`; without the key the companion
        /// that names it in `writes`.
        pub writer: Option<String> = None, "name of a companion, or operator";
        /// Samples that wait at one reader; the oldest is replaced.
        pub queue: u32 = 4, 1.0..=256.0;
        /// Readers and observers that may open it at a time.
        pub readers: u32 = 8, 1.0..=24.0;
        /// With bounds, `scanloop swap` of the writer first compares both processes scan by scan.
        pub agree: Vec<Agreement> = Vec::new();
    }
}

/// The layout in the text of a file.
///
/// # Errors
/// A text that is no layout, and fields that make no type of samples.
pub fn read_layout(path: &Path) -> Result<LayoutFile, String> {
    let text = user_file::read(path, TEXT_BYTES).map_err(|error| error.to_string())?;
    text.parse()
}

/// The topics and companions of a checked system, as its processes get them; `file` is the system file.
///
/// # Errors
/// The first layout that is missing or not allowed, and topics that take too much memory; exit code 2.
pub fn read(system: &System, file: &str) -> anyhow::Result<OwnTopics> {
    let table = table(system, read_layouts(system, file)?);
    for (role, fields, kind) in [
        (Role::Actuator, runtime::EMERGENCY_STOP_FIELDS, "u8"),
        (Role::Estimator, EstimatorStage::OWN_FIELDS, "f64"),
    ] {
        let built_in = system.entry(role).filter(|entry| entry.command.is_none());
        for also in built_in.iter().flat_map(|entry| &entry.also_reads) {
            let offsets = table.find(&also.topic).map(|row| row.offsets_of(fields, kind));
            offsets
                .transpose()
                .map_err(|error| Failure::bad_input(format!("{file}: also_reads: {error}")))?;
        }
        if let Some([_, second, ..]) =
            built_in.map(|entry| &*entry.also_reads).filter(|_| role == Role::Estimator)
        {
            let invalid =
                Invalid::new("also_reads.topic", &second.topic, "one topic: the estimator reads one gyro");
            return Err(Failure::bad_input(format!("{file}: {invalid}")));
        }
    }
    if !table.topic.is_empty() {
        require_memory(&table, file)?;
    }
    Ok(table)
}

fn read_layouts(system: &System, file: &str) -> anyhow::Result<Vec<LayoutFile>> {
    let folder = Path::new(file).parent().unwrap_or(Path::new(""));
    let read = |entry: &TopicEntry| {
        let path = folder.join(&entry.layout);
        read_layout(&path).map_err(|reason| Failure::bad_input(format!("{}: {reason}", path.display())))
    };
    let layouts: Vec<LayoutFile> = system.topics.iter().map(read).collect::<Result<_, _>>()?;
    for (index, (entry, layout)) in system.topics.iter().zip(&layouts).enumerate() {
        let is_field = |name: &str| layout.field.iter().any(|field| field.name == name);
        if let Some(agree) = entry.agree.iter().find(|agree| !is_field(&agree.field)) {
            let names: Vec<&str> = layout.field.iter().map(|field| field.name.as_str()).collect();
            let meant = did_you_mean(&agree.field, names.iter().copied());
            let allowed = format!("one of {}.{meant}", names.join(", "));
            let key = format!("topic[{index}].agree.field");
            return Err(Failure::bad_input(format!("{file}: {}", Invalid::new(&key, &agree.field, allowed))));
        }
    }
    Ok(layouts)
}

pub(crate) fn table(system: &System, layouts: Vec<LayoutFile>) -> OwnTopics {
    let row = |(entry, layout): (&TopicEntry, LayoutFile)| TopicRow {
        name: entry.name.clone(),
        writer: writer_of(system, entry).unwrap_or(OPERATOR).to_owned(),
        queue: entry.queue as usize,
        readers: entry.readers as usize,
        layout,
        agree: entry.agree.iter().map(|agree| (agree.field.clone(), agree.bound)).collect(),
    };
    let companion = |entry: &ProcessEntry| CompanionRow {
        name: entry.name().to_owned(),
        reads: entry.reads().to_vec(),
        writes: entry.writes().to_vec(),
        lockstep: entry.is_in_lockstep(),
    };
    let also = |entry: &ProcessEntry| {
        let role = entry.role.clone();
        let reads = entry.also_reads.clone().into_iter();
        reads.map(move |also| AlsoReads {
            role: role.clone(),
            topic: also.topic,
            max_age_ms: also.max_age_ms,
        })
    };
    OwnTopics {
        run: system.run_settings(false),
        topic: system.topics.iter().zip(layouts).map(row).collect(),
        companion: system.companions().map(companion).collect(),
        also_reads: system.processes.iter().flat_map(also).collect(),
    }
}

/// The companion that writes a topic, or the operator.
fn writer_of<'a>(system: &'a System, entry: &'a TopicEntry) -> Option<&'a str> {
    let writes = |companion: &&ProcessEntry| companion.writes().contains(&entry.name);
    system.companions().find(writes).map(ProcessEntry::name).or(entry.writer.as_deref())
}

/// Checks names, writers, readers and circles of the topics and companions of a system.
///
/// # Errors
/// The first key that is not allowed.
pub(crate) fn validate(system: &System) -> Result<(), Invalid> {
    let companions: Vec<(usize, &ProcessEntry)> =
        system.processes.iter().enumerate().filter(|(_, entry)| entry.is_companion()).collect();
    if companions.len() > MAX_COMPANIONS {
        let allowed = format!("at most {MAX_COMPANIONS} companions");
        return Err(Invalid::new("process", companions.len(), allowed));
    }
    for (place, (index, entry)) in companions.iter().enumerate() {
        if companions[..place].iter().any(|(_, other)| other.name() == entry.name()) {
            return Err(Invalid::new(&format!("process[{index}].name"), entry.name(), "each name once"));
        }
    }
    for (index, entry) in system.topics.iter().enumerate() {
        topic(system, entry).map_err(|invalid| invalid.within(&format!("topic[{index}]")))?;
        if system.topics[..index].iter().any(|other| other.name == entry.name) {
            return Err(Invalid::new(&format!("topic[{index}].name"), &entry.name, "each name once"));
        }
    }
    for (index, entry) in system.processes.iter().enumerate() {
        uses(system, entry).map_err(|invalid| invalid.within(&format!("process[{index}]")))?;
    }
    no_circle(system)
}

fn topic(system: &System, entry: &TopicEntry) -> Result<(), Invalid> {
    let TopicEntry { name, writer, .. } = entry;
    if !is_name(name) {
        return Err(Invalid::new("name", if name.is_empty() { "(missing)" } else { name }, NAME_RULE));
    }
    if name.parse::<Topic>().is_ok() {
        return Err(Invalid::new("name", name, "another name: the loop has this topic"));
    }
    let mut writers: Vec<&str> = system
        .companions()
        .filter(|companion| companion.writes().contains(name))
        .map(ProcessEntry::name)
        .collect();
    if let Some(writer) = writer.as_deref().filter(|writer| !writers.contains(writer)) {
        if writer != OPERATOR {
            let allowed = format!("`{OPERATOR}`, or a companion that names {name} in `writes`");
            return Err(Invalid::new("writer", writer, allowed));
        }
        writers.push(writer);
    }
    match writers.as_slice() {
        [_] => Ok(()),
        [] => Err(Invalid::new("name", name, format!("a writer: no process writes topic {name}"))),
        several => {
            Err(Invalid::new("name", name, format!("one writer; {} would write it", several.join(" and "))))
        }
    }
}

/// Checks the topics that one process reads and writes.
fn uses(system: &System, entry: &ProcessEntry) -> Result<(), Invalid> {
    let is_own = |name: &str| system.topics.iter().any(|topic| topic.name == name);
    let names: Vec<&str> = system.topics.iter().map(|topic| topic.name.as_str()).collect();
    let known = |name: &str| {
        let meant = did_you_mean(name, names.iter().copied().chain(TOPICS.map(|topic| topic.name())));
        let has = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        format!("a [[topic]] of the file; it has {has}{}{meant}", if meant.is_empty() { "" } else { "." })
    };
    for name in entry.writes() {
        if name.parse::<Topic>().is_ok() {
            return Err(Invalid::new("writes", name, "a topic of your own: a role writes those of the loop"));
        }
        if !is_own(name) {
            return Err(Invalid::new("writes", name, known(name)));
        }
    }
    for (place, name) in entry.reads().iter().enumerate() {
        if name == Topic::Truth.name() && !entry.reads_truth.unwrap_or(false) {
            return Err(Invalid::new("reads", name, "with `reads_truth = true` only: no robot has a truth"));
        }
        if name.parse::<Topic>().is_err() && !is_own(name) {
            return Err(Invalid::new("reads", name, format!("a topic of the loop, or {}", known(name))));
        }
        if entry.reads()[..place].contains(name) {
            return Err(Invalid::new("reads", name, "each topic once"));
        }
    }
    for also in &entry.also_reads {
        if !is_own(&also.topic) {
            return Err(Invalid::new("also_reads.topic", &also.topic, known(&also.topic)));
        }
    }
    Ok(())
}

/// A circle of processes of which each waits for a sample of the one before.
fn no_circle(system: &System) -> Result<(), Invalid> {
    let mut writers: BTreeMap<&str, &str> = BTreeMap::new();
    let mut reads: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for role in Role::ALL.iter().filter(|role| **role != Role::Robot) {
        // Actuations are of the scan before: no estimator waits for those of its own scan.
        let inputs =
            role.reads().iter().filter(|topic| **topic != Topic::Actuation).map(|topic| topic.name());
        let also = system.entry(*role).into_iter().flat_map(|entry| &entry.also_reads);
        reads.insert(role.name(), inputs.chain(also.map(|also| also.topic.as_str())).collect());
        writers.extend(role.writes().iter().map(|topic| (topic.name(), role.name())));
    }
    for companion in system.companions() {
        reads.insert(companion.name(), companion.reads().iter().map(String::as_str).collect());
        writers.extend(companion.writes().iter().map(|topic| (topic.as_str(), companion.name())));
    }
    // Removes all processes whose writers are removed; a circle stays.
    let mut left: Vec<&str> = reads.keys().copied().collect();
    loop {
        let waits = |process: &&str| {
            let of = &reads[*process];
            of.iter().any(|topic| writers.get(topic).is_some_and(|writer| left.contains(writer)))
        };
        let rest: Vec<&str> = left.iter().copied().filter(|process| waits(process)).collect();
        if rest.len() == left.len() {
            break;
        }
        left = rest;
    }
    let Some(first) = left.first() else { return Ok(()) };
    let mut way = vec![*first];
    // Back from writer to writer until one comes again.
    let circle = loop {
        let last = way[way.len() - 1];
        let next = reads[last].iter().filter_map(|topic| writers.get(topic)).find(|name| left.contains(name));
        let Some(next) = next else { return Ok(()) };
        if let Some(start) = way.iter().position(|process| process == next) {
            break &way[start..];
        }
        way.push(next);
    };
    let mut named: Vec<&str> = circle.iter().rev().copied().collect();
    named.push(named[0]);
    Err(Invalid::new("process.reads", named.join(" -> "), "no circle of processes that wait for each other"))
}

/// Checks that the topics take at most half of shared memory.
fn require_memory(table: &OwnTopics, file: &str) -> anyhow::Result<()> {
    let needed = table.bytes()?;
    match runtime::memory_limit()? {
        Some(limit) if needed > limit => Err(Failure::bad_input(format!(
            "{file}: topic = {} topics with {} MiB is not allowed: at most half of /dev/shm, {} MiB",
            table.topic.len(),
            needed.div_ceil(1 << 20),
            limit >> 20
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
