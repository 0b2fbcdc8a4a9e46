//! Recordings for other programs: tables of comma-separated values, and bags of ROS 2.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::Path;

use console::exit::Failure;
use console::new_file::{Existing, NewFile};
use shared_types::{Field, Kind, TOPICS, Topic};

use crate::copy::copy;
use crate::info::Info;
use crate::read::Recording;

/// Exports each topic as a table, one column per number; returns the number of rows. Checkpoints have no columns.
///
/// # Errors
/// A recording that can't be read, and a folder that can't be written to.
pub fn csv(from: &Path, folder: &Path, force: bool) -> anyhow::Result<u64> {
    let mut recording = Recording::open(from)?;
    make(folder)?;
    let mut tables: Vec<Option<BufWriter<NewFile>>> = TOPICS.iter().map(|_| None).collect();
    let mut rows = 0;
    recording.samples(|_, sample| {
        if sample.topic == Topic::Checkpoint {
            return Ok(());
        }
        let table = &mut tables[sample.topic as usize];
        let fields = sample.topic.fields();
        if table.is_none() {
            let path = folder.join(format!("{}.csv", sample.topic));
            let mut names = String::from("log_ns");
            columns(fields, "", &mut names);
            let mut file = BufWriter::new(NewFile::create(&path, Existing::forced(force), &[from])?);
            writeln!(file, "{names}")?;
            *table = Some(file);
        }
        if let Some(file) = table {
            let mut row = sample.log_ns.to_string();
            values(fields, sample.bytes, &mut row);
            writeln!(file, "{row}")?;
            rows += 1;
        }
        Ok(())
    })?;
    for table in tables.into_iter().flatten() {
        table.into_inner().map_err(IntoInnerError::into_error)?.finish()?;
    }
    Ok(rows)
}

/// Exports the recording as a bag of ROS 2: a folder with the file and its `metadata.yaml`.
///
/// # Errors
/// As [`csv`].
pub fn rosbag2(from: &Path, folder: &Path, force: bool) -> anyhow::Result<u64> {
    let info = Info::read(from)?;
    make(folder)?;
    let path = folder.join("metadata.yaml");
    let mut description = NewFile::create(&path, Existing::forced(force), &[from])?;
    let name = "recording.mcap";
    copy(from, &folder.join(name), force, 0..=u64::MAX)?;
    let mut recording = Recording::open(from)?;
    let mut start_ns = u64::MAX;
    while let Ok(Some(message)) = recording.reader().next_message() {
        start_ns = start_ns.min(message.log_ns);
    }
    let contents = recording.contents();
    let total: u64 = info.channels.values().sum();
    let duration_ns = (info.duration_s * 1e9) as u64;
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  \
         duration:\n    nanoseconds: {duration_ns}\n  \
         starting_time:\n    nanoseconds_since_epoch: {start_ns}\n  \
         message_count: {total}\n  topics_with_message_count:\n"
    );
    for channel in contents.channels.values() {
        let (topic, schema) = (&channel.topic, contents.schemas.get(&channel.schema));
        let (kind, count) = (schema.map_or("", |schema| &schema.name), info.channels[topic]);
        let (topic, kind) = (yaml(topic), yaml(kind));
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {topic}\n        type: {kind}\n        \
             serialization_format: cdr\n        offered_qos_profiles: \"\"\n      message_count: {count}\n"
        );
    }
    let _ = write!(
        text,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {name}\n  \
         files:\n    - path: {name}\n      starting_time:\n        nanoseconds_since_epoch: {start_ns}\n      \
         duration:\n        nanoseconds: {duration_ns}\n      message_count: {total}\n"
    );
    description.write_all(text.as_bytes())?;
    description.finish()?;
    Ok(total)
}

fn make(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|error| Failure::bad_input(format!("{}: {error}", folder.display())))
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
    use shared_types::Odometry;

    use super::*;

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
