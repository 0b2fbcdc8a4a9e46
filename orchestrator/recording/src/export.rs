//! Recordings for other programs: tables of comma-separated values, and bags of ROS 2.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

use console::exit::Failure;
use console::new_file::{Existing, NewFile, finish_all, make_folder};
use shared_types::{Field, Kind, Topic};

use crate::copy::{Summary, prepare};
use crate::foxglove;
use crate::mcap::{Channel, Contents};
use crate::read::Recording;
use crate::tape::PREFIX;

/// What became tables.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Rows of all tables.
    pub rows: u64,
    /// Topics of other programs, and those whose samples have another layout: they have no table.
    pub left_out: Vec<String>,
}

/// Exports a recording as tables in one folder, as a bag of ROS 2 in another one, or both: whole, or not at all. Returns what
/// became tables, and the number of messages in the bag.
///
/// # Errors
/// A recording that can't be read, and a folder or file that can't be written; exit code 2.
pub fn export(
    from: &Path,
    tables: Option<&Path>,
    bag: Option<&Path>,
    force: bool,
) -> anyhow::Result<(Option<Exported>, Option<u64>)> {
    let (exported, mut files) = tables.map(|folder| csv(from, folder, force)).transpose()?.unzip();
    let (messages, of_bag) = bag.map(|folder| rosbag2(from, folder, force)).transpose()?.unzip();
    files.get_or_insert_default().extend(of_bag.into_iter().flatten());
    finish_all(files.unwrap_or_default())?;
    Ok((exported, messages))
}

/// Exports each topic as a table, one column per number. Checkpoints have no columns. Where joined recordings have other
/// columns of a topic, these are a table of their own: `TOPIC.2.csv`. The files have no names yet.
fn csv(from: &Path, folder: &Path, force: bool) -> anyhow::Result<(Exported, Vec<NewFile>)> {
    let mut recording = Recording::open(from)?;
    make(folder)?;
    let mut tables = Tables { from, folder, force, of_topics: BTreeMap::new(), rows: 0 };
    recording.samples(|_, sample| match sample.topic {
        Topic::Checkpoint => Ok(()),
        topic => tables.add(topic.name(), topic.fields(), sample.log_ns, sample.bytes),
    })?;
    recording.own_samples(|name, fields, log_ns, bytes| tables.add(name, fields, log_ns, bytes))?;
    let left_out = tables.left_out(recording.files());
    let files = tables.of_topics.into_values().flatten();
    let files = files.map(|table| table.file.into_inner().map_err(IntoInnerError::into_error));
    let files = files.collect::<Result<_, _>>()?;
    Ok((Exported { rows: tables.rows, left_out }, files))
}

/// The tables of an export, by topic.
struct Tables<'a> {
    from: &'a Path,
    folder: &'a Path,
    force: bool,
    of_topics: BTreeMap<String, Vec<Table>>,
    rows: u64,
}

/// A table of one topic.
struct Table {
    names: String,
    /// The layouts with these columns; one per joined recording.
    layouts: Vec<&'static [Field]>,
    file: BufWriter<NewFile>,
}

impl Tables<'_> {
    /// Adds a row, and makes the table when it is the first.
    fn add(
        &mut self,
        topic: &str,
        fields: &'static [Field],
        log_ns: u64,
        bytes: &[u8],
    ) -> anyhow::Result<()> {
        // The name may be that of a file of another program.
        let is_name = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
        if !topic.chars().all(is_name) {
            return Ok(());
        }
        let table = self.table(topic, fields)?;
        let mut row = log_ns.to_string();
        values(fields, bytes, &mut row);
        writeln!(table.file, "{row}")?;
        self.rows += 1;
        Ok(())
    }

    /// The topics with messages that have no table, but for states and for what is drawn of samples.
    fn left_out(&self, files: &[Contents]) -> Vec<String> {
        let mut found = BTreeSet::new();
        for contents in files {
            let counts = contents.statistics.as_ref().map(|counted| &counted.channels);
            let counts = counts.filter(|counts| !counts.is_empty());
            let has_messages = |number| counts.is_none_or(|counts| counts.contains_key(number));
            let channels = contents.channels.iter().filter(|(number, _)| has_messages(number));
            for (_, Channel { topic, .. }) in channels {
                let name = topic.strip_prefix(PREFIX);
                let is_known = name.is_some_and(|name| {
                    name == Topic::Checkpoint.name() || self.of_topics.contains_key(name)
                });
                if !is_known && !foxglove::CHANNELS.iter().any(|(drawn, ..)| drawn == topic) {
                    found.insert(topic.clone());
                }
            }
        }
        found.into_iter().collect()
    }

    /// The table of a topic with these columns.
    fn table(&mut self, topic: &str, fields: &'static [Field]) -> anyhow::Result<&mut Table> {
        let tables = self.of_topics.entry(topic.to_owned()).or_default();
        let is_known = |table: &Table| table.layouts.iter().any(|known| std::ptr::eq(*known, fields));
        if let Some(index) = tables.iter().position(is_known) {
            return Ok(&mut tables[index]);
        }
        let mut names = String::from("log_ns");
        columns(fields, "", &mut names);
        let index = tables.iter().position(|table| table.names == names);
        let index = match index {
            Some(index) => index,
            None => {
                let number = if tables.is_empty() { String::new() } else { format!(".{}", tables.len() + 1) };
                let path = self.folder.join(format!("{topic}{number}.csv"));
                let new = NewFile::create(&path, Existing::forced(self.force), &[self.from])?;
                let mut file = BufWriter::new(new);
                writeln!(file, "{names}")?;
                tables.push(Table { names, layouts: Vec::new(), file });
                tables.len() - 1
            }
        };
        tables[index].layouts.push(fields);
        Ok(&mut tables[index])
    }
}

/// Exports the recording as a bag of ROS 2: a folder with the file and its `metadata.yaml`. Scans and odometry are also in it
/// as `/scan` and `/odom`, in the types of ROS 2. The files have no names yet.
fn rosbag2(from: &Path, folder: &Path, force: bool) -> anyhow::Result<(u64, Vec<NewFile>)> {
    make(folder)?;
    let path = folder.join("metadata.yaml");
    let mut description = NewFile::create(&path, Existing::forced(force), &[from])?;
    let (copied, mut new_files) = prepare(from, &folder.join("recording.mcap"), force, 0..=u64::MAX, true)?;
    let (mut topics, mut files) = (BTreeMap::<String, (String, u64)>::new(), String::new());
    let (mut names, mut span_ns) = (String::new(), [u64::MAX, 0]);
    for (path, Summary { times_ns, messages, topics: found }) in copied.files.iter().zip(copied.summaries) {
        for (topic, (kind, count)) in found {
            topics.entry(topic).or_insert((kind, 0)).1 += count;
        }
        span_ns = [span_ns[0].min(times_ns[0]), span_ns[1].max(times_ns[1])];
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let _ = writeln!(names, "    - {name}");
        let _ = write!(
            files,
            "    - path: {name}\n      starting_time:\n        nanoseconds_since_epoch: {}\n      \
             duration:\n        nanoseconds: {}\n      message_count: {messages}\n",
            times_ns[0],
            times_ns[1] - times_ns[0]
        );
    }
    let [start_ns, end_ns] = span_ns;
    let total = copied.messages;
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
         duration:\n    nanoseconds: {}\n  \
         starting_time:\n    nanoseconds_since_epoch: {start_ns}\n  \
         message_count: {total}\n  topics_with_message_count:\n",
        end_ns - start_ns
    );
    for (topic, (kind, count)) in topics {
        let (topic, kind) = (yaml(&topic), yaml(&kind));
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {topic}\n        type: {kind}\n        \
             serialization_format: cdr\n        offered_qos_profiles: \"\"\n      message_count: {count}\n"
        );
    }
    let _ = write!(
        text,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n{names}  files:\n{files}"
    );
    description.write_all(text.as_bytes())?;
    new_files.push(description);
    Ok((total, new_files))
}

fn make(folder: &Path) -> anyhow::Result<()> {
    make_folder(folder).map_err(|error| Failure::bad_input(format!("{}: {error}", folder.display())))
}

/// A text as a value of YAML: names of other programs may hold anything.
fn yaml(text: &str) -> Cow<'_, str> {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '/' | '_' | '.' | '-');
    if text.starts_with(|first: char| first == '/' || first.is_ascii_alphabetic())
        && text.chars().all(is_plain)
    {
        return Cow::Borrowed(text);
    }
    Cow::Owned(serde_json::Value::from(text).to_string())
}

/// Adds the names of all numbers, as `,header.chain.0.woken_ns`.
fn columns(fields: &[Field], around: &str, names: &mut String) {
    for field in fields {
        let name = format!("{around}{}", field.name);
        match &field.kind {
            Kind::Struct(_, inner) => columns(inner, &format!("{name}."), names),
            Kind::Array(Kind::Struct(_, inner), length) => {
                (0..*length).for_each(|index| columns(inner, &format!("{name}.{index}."), names));
            }
            Kind::Array(_, length) => (0..*length).for_each(|index| _ = write!(names, ",{name}.{index}")),
            Kind::Scalar(_) => _ = write!(names, ",{name}"),
        }
    }
}

fn values(fields: &[Field], bytes: &[u8], row: &mut String) {
    fields.iter().for_each(|field| value(&field.kind, &bytes[field.offset..], row));
}

fn value(kind: &Kind, bytes: &[u8], row: &mut String) {
    match kind {
        Kind::Struct(_, fields) => values(fields, bytes, row),
        Kind::Array(element, length) => {
            (0..*length).for_each(|index| value(element, &bytes[index * element.size()..], row));
        }
        Kind::Scalar(name) => _ = write!(row, ",{}", number(name, bytes)),
    }
}

/// A number as text that reads back to the same bits.
pub fn number(name: &str, bytes: &[u8]) -> String {
    match name {
        "u8" => bytes[0].to_string(),
        "u16" => bytemuck::pod_read_unaligned::<u16>(&bytes[..2]).to_string(),
        "u32" => bytemuck::pod_read_unaligned::<u32>(&bytes[..4]).to_string(),
        "i32" => bytemuck::pod_read_unaligned::<i32>(&bytes[..4]).to_string(),
        "u64" => bytemuck::pod_read_unaligned::<u64>(&bytes[..8]).to_string(),
        _ => bytemuck::pod_read_unaligned::<f64>(&bytes[..8]).to_string(),
    }
}

#[cfg(test)]
mod tests {
    use console::new_file::Scratch;
    use shared_types::Odometry;

    use super::*;

    #[test]
    fn other_columns_of_a_topic_are_a_table_of_their_own() {
        const OLD: [Field; 1] = [Field { name: "old", doc: "", offset: 0, kind: Kind::Scalar("u8") }];
        const NEW: [Field; 1] = [Field { name: "new", ..OLD[0] }];
        let folder = Scratch::new().unwrap();
        let path = folder.path();
        let mut tables =
            Tables { from: path, folder: path, force: false, of_topics: BTreeMap::new(), rows: 0 };
        let again: &[Field] = Box::leak(Box::new(OLD));
        for (log_ns, fields) in [(1, &OLD as &[Field]), (2, &NEW), (3, again), (4, &NEW)] {
            tables.add("own", fields, log_ns, &[7]).unwrap();
        }
        let files = tables.of_topics.into_values().flatten().map(|table| table.file.into_inner().unwrap());
        finish_all(files.collect()).unwrap();
        let read = |name: &str| std::fs::read_to_string(path.join(name)).unwrap();
        assert_eq!(read("own.csv"), "log_ns,old\n1,7\n3,7\n");
        assert_eq!(read("own.2.csv"), "log_ns,new\n2,7\n4,7\n");
    }

    #[test]
    fn a_row_has_a_value_for_each_column() {
        let (mut names, mut row) = (String::new(), String::new());
        columns(Topic::Odometry.fields(), "", &mut names);
        values(
            Topic::Odometry.fields(),
            bytemuck::bytes_of(&Odometry { x_m: 0.1, ..Odometry::default() }),
            &mut row,
        );
        let at = names.split(',').position(|name| name == "x_m").unwrap();
        assert_eq!(row.split(',').nth(at), Some("0.1"));
        assert_eq!(names.split(',').count(), row.split(',').count());
    }
}
