//! Scans and odometry of a bag of ROS 2 in MCAP.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use console::user_file;
use recording::mcap::{Contents, McapReader};
use recording::read::refusal;
use recording::ros2::{BaseOdometry, LaserScan, Ros2Message};
use runtime::one_line;

use crate::ImportOptions;
use crate::message::{Each, Message, refuse};

/// First bytes of what is packed with Zstandard.
const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// An error names so many topics.
const MAX_NAMED: usize = 20;

/// A bag: one file, or several one after the other.
pub(crate) struct Bag {
    files: Vec<PathBuf>,
    scan: String,
    odometry: String,
}

impl Bag {
    /// Opens the files of a bag and finds its topics.
    ///
    /// # Errors
    /// Files that are no MCAP, and a topic that is missing or one of several; exit code 2.
    pub(crate) fn open(from: &Path, files: &[PathBuf], options: &ImportOptions) -> anyhow::Result<Self> {
        let mut topics = BTreeMap::new();
        let mut ordered = Vec::new();
        for file in files {
            let mut reader = open(file)?;
            let first_ns = match reader.next_message() {
                Ok(message) => message.map_or(u64::MAX, |message| message.log_ns),
                Err(error) => return Err(refusal(file, &error)),
            };
            ordered.push((first_ns, file.clone()));
            for contents in reader.files() {
                for channel in contents.channels.values() {
                    let schema = contents.schemas.get(&channel.schema);
                    let kind = schema.map_or("", |schema| schema.name.as_str());
                    topics.insert(channel.topic.clone(), kind.to_owned());
                }
            }
        }
        ordered.sort();
        Ok(Self {
            files: ordered.into_iter().map(|(_, file)| file).collect(),
            scan: topic::<LaserScan>(from, &topics, options.scan.as_deref(), "--scan")?,
            odometry: topic::<BaseOdometry>(from, &topics, options.odometry.as_deref(), "--odometry")?,
        })
    }

    /// Its topics with scans and odometry.
    pub(crate) fn topics(&self) -> [&str; 2] {
        [&self.scan, &self.odometry]
    }

    /// Its files.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(PathBuf::as_path)
    }

    /// Hands over its messages.
    ///
    /// # Errors
    /// A damaged file, or a message that is none of its type; exit code 2. Errors of `each`.
    pub(crate) fn read(&self, each: &mut Each<'_>) -> anyhow::Result<()> {
        for file in &self.files {
            let (mut reader, mut data) = (open(file)?, Vec::new());
            loop {
                let message = match reader.next_message() {
                    Ok(Some(message)) => message,
                    Ok(None) => break,
                    Err(error) => return Err(refusal(file, &error)),
                };
                let (channel, log_ns) = (message.channel, message.log_ns);
                data.clear();
                data.extend_from_slice(message.data);
                let Some(read) = self.message(reader.contents(), channel, &data) else { continue };
                each(
                    log_ns,
                    read.map_err(|reason| refuse(file, format_args!("message at {log_ns} ns: {reason}")))?,
                )?;
            }
        }
        Ok(())
    }

    /// A message of one of the topics.
    fn message(&self, contents: &Contents, channel: u16, data: &[u8]) -> Option<Result<Message, String>> {
        let channel = contents.channels.get(&channel)?;
        let kind = contents.schemas.get(&channel.schema)?.name.as_str();
        let decoded = if channel.topic == self.scan && LaserScan::is_named(kind) {
            LaserScan::decode(data).map(Message::Scan)
        } else if channel.topic == self.odometry && BaseOdometry::is_named(kind) {
            BaseOdometry::decode(data).map(Message::Odometry)
        } else {
            return None;
        };
        Some(decoded.filter(|_| channel.encoding == "cdr").ok_or_else(|| {
            if data.starts_with(ZSTD) {
                return "its messages are packed one by one; `ros2 bag convert` unpacks them".to_owned();
            }
            let (topic, encoding) = (one_line(&channel.topic), one_line(&channel.encoding));
            format!("topic {topic}: {} bytes in {encoding} are no {kind} in CDR, little endian", data.len())
        }))
    }

    /// Whether one of its files was cut off.
    ///
    /// # Errors
    /// A file that can't be read; exit code 2.
    pub(crate) fn is_cut_off(&self) -> anyhow::Result<bool> {
        for file in &self.files {
            if !open(file)?.files().iter().all(|contents| contents.is_complete) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

fn open(path: &Path) -> anyhow::Result<McapReader<BufReader<File>>> {
    let file = user_file::open(path).map_err(|error| refuse(path, error))?;
    McapReader::new(BufReader::new(file)).map_err(|error| refusal(path, &error))
}

/// The topic of a type: the one that is asked for, or the only one.
fn topic<M: Ros2Message>(
    from: &Path,
    topics: &BTreeMap<String, String>,
    wanted: Option<&str>,
    option: &str,
) -> anyhow::Result<String> {
    let found: Vec<&str> =
        topics.iter().filter(|(_, kind)| M::is_named(kind)).map(|(topic, _)| topic.as_str()).collect();
    let named = |names: &[&str]| {
        let more = if names.len() > MAX_NAMED { " and more" } else { "" };
        let shown: Vec<String> = names.iter().take(MAX_NAMED).map(|name| one_line(name)).collect();
        format!("{}{more}", shown.join(", "))
    };
    let kind = M::TYPE;
    match (wanted, &found[..]) {
        (Some(wanted), _) if found.contains(&wanted) => Ok(wanted.to_owned()),
        (None, [only]) => Ok((*only).to_owned()),
        (_, []) => {
            let all: Vec<&str> = topics.keys().map(String::as_str).collect();
            let all = if all.is_empty() { "it has none".to_owned() } else { named(&all) };
            Err(refuse(from, format_args!("no topic has {kind}; its topics are: {all}")))
        }
        (Some(wanted), some) => {
            let (wanted, some) = (one_line(wanted), named(some));
            Err(refuse(from, format_args!("{option} {wanted}: no such topic with {kind}; there are: {some}")))
        }
        (None, several) => {
            let several = named(several);
            Err(refuse(from, format_args!("several topics have {kind}, choose one with {option}: {several}")))
        }
    }
}
