//! `scanloop topic list / hz / echo / pub`.

mod publish;

use std::time::Duration;

use console::exit::Failure;
use console::output::data;
use figures::{Align, Table};
use runtime::{Bus, Observer, OwnObserver, OwnTopics, RuntimeError, Shutdown, monotonic_ns, wait_for};
use serde_json::{Map, Value, json};
use session::arguments::check_duration;
use shared_types::{
    Actuation, Checkpoint, ClockOffset, Command, Directive, ENUMERATIONS, Field, Header, Heartbeat, Journal,
    Kind, MAX_NUMBER, Obstacles, Odometry, Pose, Role, Sample, Scan, TOPICS, Topic, Truth, did_you_mean,
    require_sequence,
};

pub(crate) use self::publish::publish;

/// Longest sleep between two polls of a topic; a buffer of 16 samples lasts longer than this at 500 Hz.
const POLL_NS: u64 = 20_000_000;

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
pub(crate) fn echo(system_id: &str, topic: &str, count: Option<u64>, short: bool) -> anyhow::Result<()> {
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
    Ok(())
}

/// Returns the bytes of the next sample of a topic.
type NextSample = Box<dyn FnMut() -> Result<Option<Vec<u8>>, RuntimeError>>;

/// A topic under observation, of any type.
struct Watch {
    fields: &'static [Field],
    /// Whether its samples are numbered by one process.
    is_numbered: bool,
    next: NextSample,
    shutdown: Shutdown,
    count: Count,
    _bus: Bus,
}

/// Writers of a topic that are told apart: those in charge, candidates and those that are ending.
const MAX_WRITERS: usize = 16;

/// How many samples of a topic were published while it was observed.
#[derive(Debug, Clone, Default)]
struct Count {
    /// That arrived here.
    seen: u64,
    /// That did not, by the numbers of those that did.
    lost: u64,
    /// That have a number that they can't have.
    impossible: u64,
    /// Incarnation and newest number of each writer, the latest last, and when it came [ns].
    writers: Vec<(u32, u64, u64)>,
}

impl Count {
    /// Counts a sample of a topic that each writer numbers without gaps.
    fn add(&mut self, header: &Header, now_ns: u64) {
        self.seen += 1;
        let Header { incarnation, sequence, .. } = *header;
        let known = self.writers.iter().position(|(of, ..)| *of == incarnation);
        let (newest, since_ns) = match known.map(|index| self.writers.remove(index)) {
            Some((_, newest, at_ns)) => (newest, at_ns),
            None => (sequence.saturating_sub(1), 0),
        };
        let is_possible = require_sequence(sequence, newest, now_ns.saturating_sub(since_ns)).is_ok()
            && sequence <= MAX_NUMBER;
        if is_possible {
            self.lost += sequence.saturating_sub(newest).saturating_sub(1);
        } else {
            self.impossible += 1;
        }
        if self.writers.len() == MAX_WRITERS {
            self.writers.remove(0);
        }
        if is_possible || known.is_some() {
            self.writers.push((incarnation, if is_possible { sequence } else { newest }, now_ns));
        }
    }

    /// Samples published per second since an earlier count, seen or not.
    fn rate_hz(&self, before: &Self, elapsed_ns: u64) -> f64 {
        let published = (self.seen + self.lost).saturating_sub(before.seen + before.lost);
        published as f64 / (elapsed_ns.max(1) as f64 * 1e-9)
    }
}

impl std::fmt::Display for Count {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} samples seen, {} lost", self.seen, self.lost)?;
        if self.impossible > 0 {
            write!(formatter, ", {} with an impossible number", self.impossible)?;
        }
        Ok(())
    }
}

impl Watch {
    fn open(system_id: &str, topic: &str) -> anyhow::Result<Self> {
        let of_loop = topic.parse::<Topic>();
        let found = supervision::runs::existing(system_id);
        let domain = match &of_loop {
            Ok(_) => found?,
            // Only a running system has other topics.
            Err(unknown) => found.map_err(|_| Failure::bad_input(unknown))?,
        };
        let own = OwnTopics::of(&domain)?.filter(|own| own.find(topic).is_some());
        let bus = Bus::open(&domain, "observer")?;
        if let Some(own) = own {
            return Self::own(bus, &own, topic);
        }
        let topic = of_loop.map_err(|unknown| {
            let own = OwnTopics::of(&domain).ok().flatten().map_or_else(Vec::new, |own| own.topic);
            let names: Vec<&str> = own.iter().map(|row| row.name.as_str()).collect();
            let meant = did_you_mean(topic, names.iter().copied());
            let of_file = format!("; the system file adds {}.{meant}", names.join(", "));
            Failure::bad_input(format!("{unknown}{}", if names.is_empty() { "" } else { &of_file }))
        })?;
        fn of<S: Sample>(bus: &Bus) -> Result<NextSample, RuntimeError> {
            let observer = Observer::<S>::new(bus)?;
            Ok(Box::new(move || Ok(observer.next()?.map(|(sample, _)| bytemuck::bytes_of(&sample).to_vec()))))
        }
        let next = match topic {
            Topic::Scan => of::<Scan>(&bus),
            Topic::Odometry => of::<Odometry>(&bus),
            Topic::Pose => of::<Pose>(&bus),
            Topic::Obstacles => of::<Obstacles>(&bus),
            Topic::Command => of::<Command>(&bus),
            Topic::Actuation => of::<Actuation>(&bus),
            Topic::Heartbeat => of::<Heartbeat>(&bus),
            Topic::Directive => of::<Directive>(&bus),
            Topic::Checkpoint => of::<Checkpoint>(&bus),
            Topic::Truth => of::<Truth>(&bus),
            Topic::Journal => of::<Journal>(&bus),
            Topic::Clock => of::<ClockOffset>(&bus),
        }?;
        Self::of(bus, topic.fields(), topic.writer().is_some(), next)
    }

    /// A topic that the system file added.
    fn own(bus: Bus, own: &OwnTopics, topic: &str) -> anyhow::Result<Self> {
        let observer = OwnObserver::new(&bus, own, topic)?;
        let fields = observer.own_type().fields();
        Self::of(bus, fields, true, Box::new(move || observer.next()))
    }

    fn of(bus: Bus, fields: &'static [Field], is_numbered: bool, next: NextSample) -> anyhow::Result<Self> {
        let shutdown = Shutdown::on_signals()?;
        Ok(Self { fields, is_numbered, next, shutdown, count: Count::default(), _bus: bus })
    }

    /// Sleeps until the next poll; false when the user wants to end.
    fn sleep(&self) -> bool {
        wait_for(&[self.shutdown.descriptor()], POLL_NS);
        !self.shutdown.requested()
    }

    /// Passes the bytes of the samples that have arrived to `each` until it returns false.
    fn poll(&mut self, each: &mut impl FnMut(&[u8]) -> bool) -> anyhow::Result<()> {
        let now_ns = monotonic_ns();
        while let Some(bytes) = (self.next)()? {
            let header: Header = bytemuck::pod_read_unaligned(&bytes[..size_of::<Header>()]);
            match self.is_numbered {
                true => self.count.add(&header, now_ns),
                false => self.count.seen += 1,
            }
            if !each(&bytes) {
                break;
            }
        }
        Ok(())
    }
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

    #[test]
    fn sizes_of_all_descriptions_are_the_sizes_of_the_samples() {
        for topic in TOPICS {
            let last = topic.fields().last().unwrap();
            assert_eq!(last.offset + last.kind.size(), topic.size(), "{topic}");
        }
    }

    #[test]
    fn a_rate_counts_what_was_published_not_what_was_seen() {
        let header = |incarnation, sequence| Header { incarnation, sequence, ..Header::default() };
        let mut count = Count::default();
        // Of 1,000 samples in a second, every fifth is seen; two writers, one of which starts at 7.
        (1..=100).for_each(|index| count.add(&header(1, 5 * index), 10_000_000 * index));
        (0..100).for_each(|index| count.add(&header(2, 7 + 5 * index), 10_000_000 * index));
        assert_eq!((count.seen, count.lost, count.impossible), (200, 4 * 99 + 4 * 99, 0));
        assert_eq!(count.rate_hz(&Count::default(), 1_000_000_000), 992.0);
        let before = count.clone();
        for wrong in [1 << 63, u64::MAX, 1 << 47] {
            count.add(&header(1, wrong), 1_000_000_000);
        }
        count.add(&header(9, u64::MAX), 1_000_000_000);
        count.add(&header(1, 501), 1_010_000_000);
        assert_eq!((count.lost - before.lost, count.impossible), (0, 4));
        assert_eq!(count.to_string(), "205 samples seen, 792 lost, 4 with an impossible number");
        for incarnation in 0..1_000 {
            count.add(&header(incarnation, 1), 2_000_000_000);
        }
        assert!(count.writers.len() <= MAX_WRITERS);
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
