//! The samples of a system as a recording: which channel a sample goes to, and what is kept of checkpoints.

use std::io::{self, Write};

use bytemuck::from_bytes;
use shared_types::{
    Checkpoint, Command, Directive, Header, Heartbeat, Journal, JournalKind, Obstacles, Pose, ROLES, Role,
    Scan, StageStamps, TOPICS, Topic,
};

use crate::foxglove::{self, Level};
use crate::mcap::{CDR, Channel, Schema, Writer};
use crate::own::OwnTopic;
use crate::schema::{ENCAPSULATION, ROS2MSG, schema, type_name};

/// Chunks end after this recorded time: what a cut-off recording may lose at most [ns].
const CHUNK_NS: u64 = 1_000_000_000;
/// Or with this many bytes.
const CHUNK_BYTES: usize = 4 << 20;
/// Of the checkpoints of a role, one is recorded in this time [ns].
const CHECKPOINT_NS: u64 = 1_000_000_000;
/// In simulated time, a stamp that lies further ahead needs one of another role that agrees with it [ns].
const AHEAD_NS: u64 = 10_000_000_000;
/// Samples lie at most so far before the newest one of the batch before: topics are read one after the other [ns].
const LATE_NS: u64 = 10_000_000_000;
/// No drive in simulated time lasts longer: a year [ns].
const MAX_SIMULATED_NS: u64 = 365 * 24 * 3600 * 1_000_000_000;
/// What the file names as its writer.
pub(crate) const LIBRARY: &str = concat!("scanloop ", env!("CARGO_PKG_VERSION"));
/// In front of the topics of the system.
pub(crate) const PREFIX: &str = "/scanloop/";

/// Where chunks of messages and files beside them are put.
pub trait TapeTarget {
    /// Adds a message of data in parts to the open chunk.
    fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[&[u8]]);
    /// Bytes of the open chunk, uncompressed.
    fn open_bytes(&self) -> usize;
    /// Ends the open chunk, if it has messages.
    ///
    /// # Errors
    /// Those of the output.
    fn end_chunk(&mut self) -> io::Result<()>;
    /// Adds a file.
    ///
    /// # Errors
    /// Those of the output.
    fn attach(&mut self, name: &str, media_type: &str, data: &[u8], log_ns: u64) -> io::Result<()>;
}

impl<W: Write> TapeTarget for Writer<W> {
    fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[&[u8]]) {
        self.message(channel, sequence, log_ns, data);
    }

    fn open_bytes(&self) -> usize {
        self.open_bytes()
    }

    fn end_chunk(&mut self) -> io::Result<()> {
        self.end_chunk()
    }

    fn attach(&mut self, name: &str, media_type: &str, data: &[u8], log_ns: u64) -> io::Result<()> {
        self.attach(name, media_type, data, log_ns)
    }
}

/// A file for a recording, with the schemas and channels of all topics of the loop.
///
/// # Errors
/// Those of `out`.
pub fn writer<W: Write>(out: W) -> io::Result<Writer<W>> {
    writer_with(out, &[])
}

/// A file for a recording, with the schemas and channels of all topics: those of the loop, and those of the system.
///
/// # Errors
/// Those of `out`.
pub(crate) fn writer_with<W: Write>(out: W, own: &[OwnTopic]) -> io::Result<Writer<W>> {
    let (mut schemas, mut channels) = definitions();
    for topic in own {
        schemas.push(topic.schema());
        channels.push(Channel {
            topic: format!("{PREFIX}{}", topic.name()),
            schema: schemas.len() as u16,
            encoding: CDR.to_owned(),
            metadata: vec![("type".to_owned(), topic.type_name())],
        });
    }
    Writer::new(out, LIBRARY, &schemas, &channels)
}

/// Schemas and channels that every recording of this program begins with.
pub(crate) fn definitions() -> (Vec<Schema>, Vec<Channel>) {
    let of_topic = |topic: &Topic| Schema {
        name: type_name(*topic),
        encoding: ROS2MSG.to_owned(),
        text: schema(*topic),
    };
    let schemas: Vec<Schema> = TOPICS.iter().map(of_topic).chain(foxglove::schemas()).collect();
    let topics = TOPICS.iter().map(|topic| {
        let layout = [("type".to_owned(), topic.type_name().to_owned())];
        (format!("{PREFIX}{topic}"), layout.to_vec())
    });
    let drawn = foxglove::CHANNELS.iter().map(|(topic, ..)| ((*topic).to_owned(), Vec::new()));
    let channel = |(schema, (topic, metadata))| Channel { topic, schema, encoding: CDR.to_owned(), metadata };
    let channels = (1..).zip(topics.chain(drawn)).map(channel).collect();
    (schemas, channels)
}

/// The type of an attached file.
pub(crate) fn media_type(name: &str) -> &'static str {
    if name.ends_with(".toml") { "application/toml" } else { "text/plain" }
}

/// A recording that is being made: what becomes of each sample, and when chunks end.
pub struct Tape<T: TapeTarget> {
    target: T,
    chunk_start_ns: Option<u64>,
    /// The newest time of the loop that was recorded [ns].
    now_ns: u64,
    /// The time of the machine, where that of the loop can't be later [ns].
    clock_ns: Option<u64>,
    /// No sample was published before this time [ns].
    earliest_ns: u64,
    /// The last stamp that lay too far ahead, and the role that wrote it [ns].
    ahead: Option<(Option<Role>, u64)>,
    /// The newest checkpoint of each role, and when the last one was recorded.
    checkpoints: [(Option<Box<Checkpoint>>, u64); ROLES],
    authority: [u32; ROLES],
    /// The newest process of each role, and until when all checkpoints of the role are recorded, because a process that
    /// joins takes one of them [ns].
    joins: [(u32, u64); ROLES],
    simulated: bool,
    /// Samples put until now, and those of them that are in ended chunks.
    samples: [u64; 2],
}

impl<T: TapeTarget> Tape<T> {
    /// Begins a recording at a time of the loop [ns]; in `simulated` time the stamps of all samples are those of the loop.
    pub fn new(target: T, simulated: bool, now_ns: u64) -> Self {
        let checkpoints = std::array::from_fn(|_| (None, 0));
        Self {
            target,
            chunk_start_ns: None,
            now_ns,
            clock_ns: None,
            earliest_ns: now_ns.saturating_sub(CHUNK_NS),
            ahead: None,
            checkpoints,
            authority: [0; ROLES],
            joins: [(0, 0); ROLES],
            simulated,
            samples: [0; 2],
        }
    }

    /// Begins a batch of samples, at a time of the machine [ns]: in real time, stamps that lie after it are of a wrong clock,
    /// as are those long before what the batches before held.
    pub(crate) fn begin_batch(&mut self, clock_ns: u64) {
        self.clock_ns = (!self.simulated).then_some(clock_ns);
        self.earliest_ns = self.earliest_ns.max(self.now_ns.saturating_sub(LATE_NS));
    }

    /// Adds a file as an attachment.
    ///
    /// # Errors
    /// Those of the output.
    pub fn attach(&mut self, name: &str, data: &[u8]) -> io::Result<()> {
        self.target.attach(name, media_type(name), data, self.now_ns)
    }

    /// Adds a sample of a topic, as its bytes, and what viewers draw of it.
    ///
    /// Of checkpoints, one per role and second is added, each that was newest when another process took over, and all
    /// in the second after a process has started.
    ///
    /// # Errors
    /// Those of the output.
    pub fn sample(&mut self, topic: Topic, bytes: &[u8]) -> io::Result<()> {
        match topic {
            Topic::Checkpoint => {
                let checkpoint: &Checkpoint = from_bytes(bytes);
                let Ok(role) = Role::try_from(checkpoint.role) else { return Ok(()) };
                let (newest, recorded_ns) = &mut self.checkpoints[role.index()];
                let is_due = self.now_ns >= recorded_ns.saturating_add(CHECKPOINT_NS) || *recorded_ns == 0;
                if !is_due && self.now_ns >= self.joins[role.index()].1 {
                    match newest {
                        Some(newest) => **newest = *checkpoint,
                        None => *newest = Some(Box::new(*checkpoint)),
                    }
                    return Ok(());
                }
                (*newest, *recorded_ns) = (None, self.now_ns.max(1));
            }
            Topic::Directive => self.keep_handed_over(from_bytes(bytes))?,
            Topic::Heartbeat => self.keep_joined(from_bytes(bytes))?,
            Topic::Journal => self.keep_resumed(from_bytes(bytes))?,
            _ => {}
        }
        self.samples[0] += 1;
        self.put(topic, bytes)?;
        match topic {
            Topic::Scan => self.draw(foxglove::SCAN, &foxglove::scan(from_bytes::<Scan>(bytes))),
            Topic::Pose => {
                let pose: &Pose = from_bytes(bytes);
                self.draw(foxglove::POSE, &foxglove::pose(pose))?;
                self.draw(foxglove::TRANSFORM, &foxglove::transform(pose))
            }
            Topic::Command => self.draw(foxglove::PATH, &foxglove::path(from_bytes::<Command>(bytes))),
            Topic::Obstacles => {
                self.draw(foxglove::OBSTACLES, &foxglove::obstacles(from_bytes::<Obstacles>(bytes)))
            }
            _ => Ok(()),
        }
    }

    /// Adds a sample of a topic of the system, as its bytes; `index` is its place among them.
    ///
    /// # Errors
    /// Those of the output.
    pub(crate) fn own_sample(&mut self, index: usize, header: &Header, bytes: &[u8]) -> io::Result<()> {
        self.samples[0] += 1;
        // A stamp that lies far ahead is of another clock: that of a sample by hand in lock-step.
        let stamp_ns = published_ns_of(bytes);
        let latest_ns = self.now_ns.saturating_add(CHUNK_NS);
        let is_near = stamp_ns > 0 && (self.earliest_ns..=latest_ns).contains(&stamp_ns);
        let log_ns = if is_near { stamp_ns } else { self.now_ns };
        let channel = TOPICS.len() + foxglove::CHANNELS.len() + index;
        self.message(channel as u16, header.sequence as u32, log_ns, &[&ENCAPSULATION, bytes])
    }

    /// Adds a line of a log; `name` is the role.
    ///
    /// # Errors
    /// Those of the output.
    pub fn log(&mut self, name: &str, line: &str) -> io::Result<()> {
        let level = match line {
            _ if line.contains("ERROR") => Level::Error,
            _ if line.contains("WARN") => Level::Warning,
            _ => Level::Info,
        };
        let message = foxglove::log(self.now_ns, level, name, line);
        self.draw(foxglove::LOG, &message)
    }

    /// Where it puts everything.
    pub fn target(&mut self) -> &mut T {
        &mut self.target
    }

    /// Ends it; the open chunk is not yet ended.
    pub fn into_target(self) -> T {
        self.target
    }

    /// Samples of the loop in chunks that were ended; those of the open one may still be lost.
    pub fn samples(&self) -> u64 {
        self.samples[1]
    }

    /// The newest time of the loop in it [ns].
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// When another process gets authority, the newest checkpoint of its role is what it resumed from.
    fn keep_handed_over(&mut self, directive: &Directive) -> io::Result<()> {
        for role in Role::ALL {
            let index = role.index();
            let incarnation = directive.authority[index].incarnation;
            if std::mem::replace(&mut self.authority[index], incarnation) != incarnation
                && let Some(handed) = self.checkpoints[index].0.take()
            {
                self.put(Topic::Checkpoint, bytemuck::bytes_of(&*handed))?;
            }
        }
        Ok(())
    }

    /// When a process starts, the newest checkpoint of its role may be what it resumes from.
    fn keep_joined(&mut self, heartbeat: &Heartbeat) -> io::Result<()> {
        let Ok(role) = Role::try_from(heartbeat.role) else { return Ok(()) };
        let (newest, until_ns) = &mut self.joins[role.index()];
        if heartbeat.header.incarnation > *newest {
            (*newest, *until_ns) = (heartbeat.header.incarnation, self.now_ns.saturating_add(CHECKPOINT_NS));
            if let Some(handed) = self.checkpoints[role.index()].0.take() {
                self.put(Topic::Checkpoint, bytemuck::bytes_of(&*handed))?;
            }
        }
        Ok(())
    }

    /// What a process has continued from is recorded, if it is still known.
    fn keep_resumed(&mut self, journal: &Journal) -> io::Result<()> {
        let Ok(role) = Role::try_from(journal.role) else { return Ok(()) };
        for entry in journal.used().iter().filter(|entry| entry.kind == JournalKind::Resumed.wire() as u16) {
            let is_it = |checkpoint: &mut Box<Checkpoint>| {
                (checkpoint.header.incarnation, checkpoint.header.sequence)
                    == (entry.incarnation, entry.value)
            };
            if let Some(resumed) = self.checkpoints[role.index()].0.take_if(is_it) {
                self.put(Topic::Checkpoint, bytemuck::bytes_of(&*resumed))?;
            }
        }
        Ok(())
    }

    fn put(&mut self, topic: Topic, bytes: &[u8]) -> io::Result<()> {
        let header = (topic.sample_type().header)(bytes);
        let stamp_ns = match topic {
            // These carry the time of the machine.
            Topic::Heartbeat if !self.simulated => from_bytes::<Heartbeat>(bytes).issued_ns,
            Topic::Directive if !self.simulated => from_bytes::<Directive>(bytes).issued_ns,
            Topic::Checkpoint if !self.simulated => from_bytes::<Checkpoint>(bytes).issued_ns,
            _ => topic.writer().map_or(0, |role| published_ns(header, role)),
        };
        let is_plausible = self.is_plausible(topic.writer(), stamp_ns);
        if is_plausible {
            self.now_ns = self.now_ns.max(stamp_ns);
        }
        let log_ns = if stamp_ns == 0 || !is_plausible { self.now_ns } else { stamp_ns };
        self.message(topic as u16, header.sequence as u32, log_ns, &[&ENCAPSULATION, bytes])
    }

    /// Whether the loop can have reached the time of a stamp. One wrong clock never moves the time of the recording; a pause
    /// of the recorder itself does, as then the stamps of all roles lie ahead.
    fn is_plausible(&mut self, writer: Option<Role>, stamp_ns: u64) -> bool {
        if stamp_ns < self.earliest_ns {
            return false;
        }
        if let Some(clock_ns) = self.clock_ns {
            return stamp_ns <= clock_ns.saturating_add(CHUNK_NS);
        }
        // A recording may begin in the middle of a drive.
        let is_near = self.now_ns == 0 || stamp_ns <= self.now_ns.saturating_add(AHEAD_NS);
        if is_near || stamp_ns > MAX_SIMULATED_NS {
            return stamp_ns <= MAX_SIMULATED_NS;
        }
        let before = self.ahead.replace((writer, stamp_ns));
        before.is_some_and(|(other, ns)| other != writer && ns.abs_diff(stamp_ns) <= AHEAD_NS)
    }

    fn draw(&mut self, channel: usize, message: &[u8]) -> io::Result<()> {
        self.message((TOPICS.len() + channel) as u16, 0, self.now_ns, &[message])
    }

    fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[&[u8]]) -> io::Result<()> {
        let start_ns = *self.chunk_start_ns.get_or_insert(self.now_ns);
        self.target.message(channel, sequence, log_ns, data);
        if self.now_ns >= start_ns.saturating_add(CHUNK_NS) || self.target.open_bytes() >= CHUNK_BYTES {
            self.chunk_start_ns = None;
            self.target.end_chunk()?;
            self.samples[1] = self.samples[0];
        }
        Ok(())
    }
}

/// When the sample of a role was published [ns].
pub(crate) fn published_ns(header: &Header, role: Role) -> u64 {
    header.stage(role).published_ns
}

/// When a sample of a topic of the system was published: its stamps stand at its end [ns].
fn published_ns_of(bytes: &[u8]) -> u64 {
    let start = bytes.len().saturating_sub(size_of::<StageStamps>());
    bytemuck::try_pod_read_unaligned::<StageStamps>(&bytes[start..]).map_or(0, |stamps| stamps.published_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Log times of all messages.
    #[derive(Default)]
    struct Times(Vec<u64>);

    impl TapeTarget for Times {
        fn message(&mut self, _channel: u16, _sequence: u32, log_ns: u64, _data: &[&[u8]]) {
            self.0.push(log_ns);
        }

        fn open_bytes(&self) -> usize {
            0
        }

        fn end_chunk(&mut self) -> io::Result<()> {
            Ok(())
        }

        fn attach(&mut self, _: &str, _: &str, _: &[u8], _: u64) -> io::Result<()> {
            Ok(())
        }
    }

    fn put(tape: &mut Tape<Times>, topic: Topic, stamp_ns: u64) -> (u64, u64) {
        let mut bytes = vec![0_u64; topic.sample_type().size.div_ceil(8)];
        let bytes = &mut bytemuck::cast_slice_mut::<u64, u8>(&mut bytes)[..topic.sample_type().size];
        let mut header = Header::default();
        header.stage_mut(topic.writer().unwrap()).published_ns = stamp_ns;
        bytes[..size_of::<Header>()].copy_from_slice(bytemuck::bytes_of(&header));
        tape.put(topic, bytes).unwrap();
        (*tape.target().0.last().unwrap(), tape.now_ns())
    }

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_stamp_of_a_wrong_clock_does_not_move_the_time_of_a_recording() {
        let now_ns = 500 * SECOND_NS;
        let mut tape = Tape::new(Times::default(), false, now_ns);
        tape.begin_batch(now_ns);
        for stamp_ns in [u64::MAX, u64::MAX, now_ns + 2 * SECOND_NS] {
            assert_eq!(put(&mut tape, Topic::Odometry, stamp_ns), (now_ns, now_ns));
            assert_eq!(put(&mut tape, Topic::Command, stamp_ns), (now_ns, now_ns));
        }
        // The recorder stood still for a minute.
        let later_ns = now_ns + 60 * SECOND_NS;
        tape.begin_batch(later_ns);
        assert_eq!(put(&mut tape, Topic::Odometry, later_ns), (later_ns, later_ns));
        assert_eq!(put(&mut tape, Topic::Command, now_ns), (now_ns, later_ns));
    }

    #[test]
    fn a_stamp_of_long_ago_is_recorded_at_the_newest_time() {
        for simulated in [false, true] {
            let start_ns = 500 * SECOND_NS;
            let mut tape = Tape::new(Times::default(), simulated, start_ns);
            for now_ns in (0..40).map(|second| start_ns + second * SECOND_NS) {
                tape.begin_batch(now_ns);
                assert_eq!(put(&mut tape, Topic::Odometry, now_ns), (now_ns, now_ns));
                let long_ago = [1, 65_535, start_ns - 2 * SECOND_NS, now_ns.saturating_sub(12 * SECOND_NS)];
                for stamp_ns in long_ago {
                    assert_eq!(put(&mut tape, Topic::Actuation, stamp_ns), (now_ns, now_ns), "{stamp_ns}");
                }
                assert_eq!(put(&mut tape, Topic::Command, now_ns - 1), (now_ns - 1, now_ns));
            }
            let mut sample = [0_u64; 48];
            sample[47] = 1;
            tape.own_sample(0, &Header::default(), bytemuck::bytes_of(&sample)).unwrap();
            assert_eq!(tape.target().0.last(), Some(&(start_ns + 39 * SECOND_NS)));
        }
    }

    #[test]
    fn in_simulated_time_a_stamp_far_ahead_needs_one_of_another_role() {
        let mut tape = Tape::new(Times::default(), true, 0);
        assert_eq!(put(&mut tape, Topic::Odometry, u64::MAX), (0, 0));
        // It began in the middle of a drive.
        let [start_ns, ahead_ns] = [5000, 6000].map(|seconds| seconds * SECOND_NS);
        assert_eq!(put(&mut tape, Topic::Odometry, start_ns), (start_ns, start_ns));
        for _ in 0..3 {
            assert_eq!(put(&mut tape, Topic::Command, u64::MAX), (start_ns, start_ns));
            assert_eq!(put(&mut tape, Topic::Pose, u64::MAX), (start_ns, start_ns));
            assert_eq!(put(&mut tape, Topic::Command, ahead_ns), (start_ns, start_ns));
        }
        assert_eq!(put(&mut tape, Topic::Odometry, ahead_ns), (ahead_ns, ahead_ns));
    }
}
