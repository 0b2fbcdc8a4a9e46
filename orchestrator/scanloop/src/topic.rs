//! `scanloop topic list / hz / echo / pub`.

mod publish;
mod watch;

use std::time::Duration;

use console::exit::Exit;
use console::output::data;
use figures::{Align, Table};
use runtime::{OwnTopics, monotonic_ns};
use serde_json::{Map, Value, json};
use session::arguments::check_duration;
use shared_types::{ENUMERATIONS, Field, Kind, Role, TOPICS, Topic};

pub(crate) use self::publish::publish;
use self::watch::{Count, Watch};

/// Arrays of bytes up to this length are texts [bytes].
const MAX_TEXT: usize = 64;

/// The table of topics as text, with those that the running system adds, if there is one.
///
/// # Errors
/// A table of the system that can't be read.
pub(crate) fn list(system_id: &str) -> anyhow::Result<String> {
    let [left, right] = [Align::Left, Align::Right];
    let mut table =
        Table::new(&[("topic", left), ("bytes", right), ("writer", left), ("readers", left), ("type", left)]);
    for topic in TOPICS {
        let readers: Vec<&str> =
            Role::ALL.iter().filter(|role| role.reads().contains(&topic)).map(|role| role.name()).collect();
        let writer = match topic {
            Topic::Directive => "orchestrator",
            Topic::Heartbeat | Topic::Checkpoint | Topic::Journal => "all",
            Topic::Clock => "link",
            _ => topic.writer().map_or("-", Role::name),
        };
        let readers = match topic {
            Topic::Directive => "all".to_owned(),
            _ if readers.is_empty() => "orchestrator".to_owned(),
            _ => readers.join(", "),
        };
        let size = topic.size().to_string();
        table.row([topic.name(), &size, writer, &readers, topic.type_name()].map(str::to_owned));
    }
    let running = supervision::runs::find(system_id)?;
    let own = running.map_or(Ok(None), |domain| OwnTopics::of(&domain))?;
    for row in own.iter().flat_map(|own| &own.topic) {
        let own_type = row.layout.own_type()?;
        let (size, readers) = (own_type.size().to_string(), readers_of(own.as_ref(), &row.name));
        table.row(
            [&row.name, &size, &row.writer, &readers, &own_type.type_name()]
                .map(|cell: &String| cell.clone()),
        );
    }
    Ok(table.to_string())
}

/// The processes that read a topic of a system.
fn readers_of(own: Option<&OwnTopics>, topic: &str) -> String {
    let Some(own) = own else { return String::new() };
    let companions = own.companion.iter().filter(|row| row.reads.iter().any(|name| name == topic));
    let roles = own.also_reads.iter().filter(|also| also.topic == topic);
    let names = roles.map(|also| also.role.as_str()).chain(companions.map(|row| row.name.as_str()));
    names.collect::<Vec<_>>().join(", ")
}

/// Counts the samples of a topic and prints its rate once a second: of those that were published, also where they came too
/// fast to be seen here.
///
/// # Errors
/// An unknown topic, or a system that is not running.
pub(crate) fn hz(system_id: &str, topic: &str, duration_s: f64) -> anyhow::Result<()> {
    check_duration(Some(duration_s))?;
    let mut watch = Watch::open(system_id, topic)?;
    let started = monotonic_ns();
    let end = started + Duration::from_secs_f64(duration_s).as_nanos() as u64;
    let (mut before, mut before_ns) = (Count::default(), started);
    while monotonic_ns() < end && watch.sleep() {
        watch.poll(&mut |_| true)?;
        let now = monotonic_ns();
        if now >= before_ns + 1_000_000_000 {
            let rate_hz = watch.count.rate_hz(&before, now - before_ns);
            if !data(&format!("{topic}: {rate_hz:.2} Hz, {}", watch.count))? {
                return Ok(());
            }
            (before, before_ns) = (watch.count.clone(), now);
        }
    }
    let elapsed_ns = monotonic_ns() - started;
    let rate_hz = watch.count.rate_hz(&Count::default(), elapsed_ns);
    let seconds = elapsed_ns as f64 * 1e-9;
    data(&format!("{topic}: {rate_hz:.2} Hz on average over {seconds:.1} s, {}", watch.count)).map(|_| ())
}

/// Prints samples of a topic as JSON lines.
///
/// # Errors
/// An unknown topic, or a system that is not running.
pub(crate) fn echo(system_id: &str, topic: &str, count: Option<u64>, short: bool) -> anyhow::Result<Exit> {
    let mut watch = Watch::open(system_id, topic)?;
    let mut left = count.unwrap_or(u64::MAX);
    while left > 0 && watch.sleep() {
        let fields = watch.fields;
        let mut written = Ok(true);
        watch.poll(&mut |bytes| {
            if left > 0 {
                written = data(&format!("{}", decode_struct(fields, bytes, short)));
                left = if matches!(written, Ok(true)) { left - 1 } else { 0 };
            }
            left > 0
        })?;
        written?;
    }
    // What was asked for did not come.
    Ok(if count.is_some() && left > 0 && watch.has_ended { Exit::NotReached } else { Exit::Done })
}

fn decode_struct(fields: &[Field], bytes: &[u8], short: bool) -> Value {
    let mut object = Map::new();
    for field in fields {
        let long = matches!(field.kind, Kind::Array(_, length) if length > 16 && !is_text(&field.kind));
        if field.name != "reserved" && !(short && long) {
            let (bytes, kind) = (&bytes[field.offset..], &field.kind);
            let value = name_of(field, bytes).unwrap_or_else(|| decode(kind, bytes, short));
            object.insert(field.name.to_owned(), value);
        }
    }
    Value::Object(object)
}

/// The name of a number of an enumeration, which the documentation of its field names; `None` for an unknown number.
fn name_of(field: &Field, bytes: &[u8]) -> Option<Value> {
    let number = match field.kind {
        Kind::Scalar("u32") => bytemuck::pod_read_unaligned::<u32>(&bytes[..4]),
        Kind::Scalar("u16") => u32::from(bytemuck::pod_read_unaligned::<u16>(&bytes[..2])),
        _ => return None,
    };
    let mut quoted = field.doc.split('`').skip(1).step_by(2);
    let enumeration = quoted.find_map(|name| ENUMERATIONS.iter().find(|known| known.name == name))?;
    enumeration.values.iter().find(|value| value.number == number).map(|value| json!(value.name))
}

fn is_text(kind: &Kind) -> bool {
    matches!(kind, Kind::Array(Kind::Scalar("u8"), ..=MAX_TEXT))
}

fn decode(kind: &Kind, bytes: &[u8], short: bool) -> Value {
    match kind {
        Kind::Array(_, length) if is_text(kind) => {
            json!(String::from_utf8_lossy(&bytes[..*length]).trim_end_matches('\0'))
        }
        Kind::Scalar(name) => scalar(name, bytes),
        Kind::Array(element, length) => {
            let size = element.size();
            (0..*length).map(|index| decode(element, &bytes[index * size..], short)).collect()
        }
        Kind::Struct(_, fields) => decode_struct(fields, bytes, short),
    }
}

fn scalar(name: &str, bytes: &[u8]) -> Value {
    match name {
        "u8" => json!(bytes[0]),
        "u16" => json!(bytemuck::pod_read_unaligned::<u16>(&bytes[..2])),
        "u32" => json!(bytemuck::pod_read_unaligned::<u32>(&bytes[..4])),
        "i32" => json!(bytemuck::pod_read_unaligned::<i32>(&bytes[..4])),
        "u64" => json!(bytemuck::pod_read_unaligned::<u64>(&bytes[..8])),
        _ => json!(bytemuck::pod_read_unaligned::<f64>(&bytes[..8])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Command, Heartbeat, Odometry, Sample};

    #[test]
    fn sizes_of_all_descriptions_are_the_sizes_of_the_samples() {
        for topic in TOPICS {
            let last = topic.fields().last().unwrap();
            assert_eq!(last.offset + last.kind.size(), topic.size(), "{topic}");
        }
    }

    #[test]
    fn numbers_of_enumerations_have_names_and_unknown_ones_stay_numbers() {
        let mut command = Command { kind: 1, reason: 8, level: 77, verified: 1, ..Command::default() };
        let value = decode_struct(Command::FIELDS, bytemuck::bytes_of(&command), true);
        assert_eq!((&value["kind"], &value["reason"]), (&json!("drive"), &json!("state_lost")));
        assert_eq!((&value["level"], &value["verified"]), (&json!(77), &json!(1)));
        command.kind = 2;
        let value = decode_struct(Command::FIELDS, bytemuck::bytes_of(&command), true);
        assert_eq!(value["kind"], json!("land"));
        let mut heartbeat = Heartbeat { role: 4, state: 2, ..Heartbeat::default() };
        heartbeat.refused[0].note(&command.header, &shared_types::Fault::NotVerified { value: 0 });
        let value = decode_struct(Heartbeat::FIELDS, bytemuck::bytes_of(&heartbeat), true);
        assert_eq!((&value["role"], &value["state"]), (&json!("actuator"), &json!("ready")));
        let refused = &value["refused"][0];
        assert_eq!((&refused["rule"], &refused["field"]), (&json!("not_verified"), &json!("verified")));
    }

    #[test]
    fn every_enumeration_is_named_by_the_fields_that_hold_it() {
        fn named(fields: &'static [Field], found: &mut Vec<&str>) {
            for field in fields {
                match &field.kind {
                    Kind::Struct(_, inner) | Kind::Array(Kind::Struct(_, inner), _) => named(inner, found),
                    _ if name_of(field, &[0; 4]).is_some() => found.extend(field.doc.split('`').nth(1)),
                    _ => {}
                }
            }
        }
        let mut found = Vec::new();
        TOPICS.iter().for_each(|topic| named(topic.fields(), &mut found));
        for enumeration in ENUMERATIONS {
            assert!(found.contains(&enumeration.name), "{}", enumeration.name);
        }
    }

    #[test]
    fn a_sample_is_decoded_field_by_field() {
        let mut odometry = Odometry { x_m: 1.5, ..Odometry::default() };
        odometry.header.scan_id = 9;
        let value = decode_struct(Odometry::FIELDS, bytemuck::bytes_of(&odometry), false);
        assert_eq!(value["x_m"], json!(1.5));
        assert_eq!(value["header"]["scan_id"], json!(9));
        assert_eq!(value["header"]["chain"].as_array().unwrap().len(), 8);
    }
}
