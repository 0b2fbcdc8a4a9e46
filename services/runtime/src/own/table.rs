//! The table of topics and companions of a system, as a file in its directory.

use std::str::FromStr;

use key_table::{of_text, text_of};
use serde::{Deserialize, Serialize};
use shared_types::{Described, Field, Kind, LayoutFault, LayoutRow, OwnField, OwnType, Role, TOPICS};

use super::page::MAX_COMPANIONS;
use crate::port::Shape;
use crate::qos::Qos;
use crate::reserve::{NODE_BYTES, bytes_of_topic, total};
use crate::settings::RunSettings;
use crate::{Domain, RuntimeError};

/// Name of the file in the directory of the system; it is there only when the system has such topics or processes.
pub const TOPICS_FILE: &str = "own-topics.toml";
/// Writer of a topic whose samples are published by hand.
pub const OPERATOR: &str = "operator";

/// The layout of samples as a file describes it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayoutFile {
    /// Name of the type, as `Imu`.
    pub name: String,
    /// What a sample is.
    #[serde(default)]
    pub doc: String,
    /// The fields between header and stamps.
    #[serde(default)]
    pub field: Vec<LayoutField>,
}

/// One field in a [`LayoutFile`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayoutField {
    /// Its name.
    pub name: String,
    /// `u8`, `u16`, `u32`, `u64`, `i32` or `f64`, also with a number of elements: `f64[3]`.
    #[serde(rename = "type")]
    pub kind: String,
    /// What it means, with the unit in brackets.
    #[serde(default)]
    pub doc: String,
}

impl LayoutFile {
    /// The layout of a Rust struct that `plain_state!` declares; [`LayoutFile::text`] makes a layout file of it.
    ///
    /// # Errors
    /// A struct without header or stamps, or with a struct among its own fields.
    pub fn of<S: Described>(doc: &str) -> Result<Self, LayoutFault> {
        let own = OwnType::of::<S>()?;
        let field = |field: &Field| {
            let kind = match field.kind {
                Kind::Scalar(name) => name.to_owned(),
                Kind::Array(Kind::Scalar(name), count) => format!("{name}[{count}]"),
                _ => "struct".to_owned(),
            };
            LayoutField { name: field.name.to_owned(), kind, doc: field.doc.to_owned() }
        };
        let fields = own.fields().iter().filter(|field| !["header", "stage"].contains(&field.name));
        let layout =
            Self { name: own.name().to_owned(), doc: doc.to_owned(), field: fields.map(field).collect() };
        // The file must give the type that the struct has.
        layout.own_type()?;
        Ok(layout)
    }

    /// The text of a layout file.
    pub fn text(&self) -> String {
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let head = format!("name = {}\ndoc = {}\n", quoted(&self.name), quoted(&self.doc));
        let field = |LayoutField { name, kind, doc }: &LayoutField| {
            let [name, kind, doc] = [name, kind, doc].map(|text| quoted(text));
            format!("\n[[field]]\nname = {name}\ntype = {kind}\ndoc = {doc}\n")
        };
        self.field.iter().map(field).fold(head, |text, field| text + &field)
    }

    /// The type of the samples.
    ///
    /// # Errors
    /// Fields that make no type of samples.
    pub fn own_type(&self) -> Result<OwnType, LayoutFault> {
        let field = |field: &LayoutField| (field.name.clone(), field.kind.clone(), field.doc.clone());
        let fields: Vec<_> = self.field.iter().map(field).collect();
        let fields: Vec<_> = fields.iter().map(|(name, kind, doc)| OwnField { name, kind, doc }).collect();
        OwnType::new(&self.name, &fields)
    }
}

/// Reads the text of a layout file.
impl FromStr for LayoutFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let layout: Self = toml::from_str(text).map_err(|error| key_table::toml_fault(text, &error))?;
        layout.own_type().map_err(|fault| {
            let start = place(text, &fault).unwrap_or_default();
            format!("line {}: {fault}", 1 + text[..start].matches('\n').count())
        })?;
        Ok(layout)
    }
}

/// Where the text has what a fault is about; `None` for what it does not have.
fn place(text: &str, fault: &LayoutFault) -> Option<usize> {
    #[derive(Deserialize)]
    struct Places {
        name: toml::Spanned<String>,
        #[serde(default)]
        field: Vec<FieldPlaces>,
    }
    #[derive(Deserialize)]
    struct FieldPlaces {
        name: toml::Spanned<String>,
        #[serde(rename = "type")]
        kind: toml::Spanned<String>,
    }
    let Places { name, field } = toml::from_str(text).ok()?;
    // Of a name that is there twice the second one is refused.
    let mut fields = field.iter().rev();
    Some(match fault.at.as_str() {
        "name" => name.span().start,
        "field.name" => fields.find(|field| *field.name.get_ref() == fault.value)?.name.span().start,
        // A hole before the stamps is one after the last field.
        "stage" => fields.next()?.kind.span().start,
        at => fields.find(|field| field.name.get_ref() == at)?.kind.span().start,
    })
}

/// One topic that the system file adds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    /// Its name.
    pub name: String,
    /// The companion that writes it, or [`OPERATOR`].
    pub writer: String,
    /// Samples that wait at one reader.
    pub queue: usize,
    /// Readers, observers included.
    pub readers: usize,
    /// How far two processes that write it may differ, by field.
    #[serde(default)]
    pub agree: Vec<(String, f64)>,
    /// Its samples.
    pub layout: LayoutFile,
}

/// One companion.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompanionRow {
    /// Its name.
    pub name: String,
    /// Topics that it reads; in lock-step it answers each sample of the first.
    pub reads: Vec<String>,
    /// Topics that it writes.
    pub writes: Vec<String>,
    /// Whether lock-step waits for it.
    pub lockstep: bool,
}

/// A topic that a process of the loop reads in addition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlsoReads {
    /// Its role.
    pub role: String,
    /// The topic.
    pub topic: String,
    /// Samples older than this are dropped [ms].
    pub max_age_ms: f64,
}

/// The topics and processes that a system file adds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OwnTopics {
    /// What all processes need to know.
    pub run: RunSettings,
    /// The topics.
    #[serde(default)]
    pub topic: Vec<TopicRow>,
    /// The companions; their order is that of the page.
    #[serde(default)]
    pub companion: Vec<CompanionRow>,
    /// What roles read in addition.
    #[serde(default)]
    pub also_reads: Vec<AlsoReads>,
}

impl OwnTopics {
    /// The table of a system; `None` when it has neither such topics nor companions.
    ///
    /// # Errors
    /// [`RuntimeError::File`], and [`RuntimeError::Settings`] for a file that can't be read.
    pub fn of(domain: &Domain) -> Result<Option<Self>, RuntimeError> {
        if !domain.folder().contains(TOPICS_FILE) {
            return Ok(None);
        }
        let text = domain.folder().read_text(TOPICS_FILE)?;
        let refuse =
            |error: toml::de::Error| RuntimeError::settings(domain.directory().join(TOPICS_FILE), error);
        of_text(&text).map(Some).map_err(refuse)
    }

    /// The table in a recording; `None` for a text that is none.
    pub fn recorded(text: &str) -> Option<Self> {
        of_text(text).ok()
    }

    /// Writes the table; one without topics and companions is not written.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn write(&self, domain: &Domain) -> Result<(), RuntimeError> {
        if self.topic.is_empty() && self.companion.is_empty() {
            return Ok(());
        }
        let path = domain.directory().join(TOPICS_FILE);
        let text = text_of(self).map_err(|error| RuntimeError::settings(path, error))?;
        domain.folder().write(TOPICS_FILE, text.as_bytes())
    }

    /// A topic by its name.
    pub fn find(&self, topic: &str) -> Option<&TopicRow> {
        self.topic.iter().find(|row| row.name == topic)
    }

    /// Number of a companion in the page.
    pub fn index_of(&self, companion: &str) -> Option<usize> {
        self.companion.iter().position(|row| row.name == companion)
    }

    /// Number of a topic in the table of ports: first those of the file, then those of the loop.
    pub(crate) fn number_of(&self, topic: &str) -> u32 {
        let own = self.topic.iter().map(|row| row.name.as_str());
        let all = own.chain(TOPICS.iter().map(|topic| topic.name()));
        all.take_while(|name| *name != topic).count() as u32
    }

    /// The topic with that number.
    pub fn topic_name(&self, number: u32) -> Option<&str> {
        let number = number as usize;
        let of_loop = || TOPICS.get(number - self.topic.len()).map(|topic| topic.name());
        self.topic.get(number).map(|row| row.name.as_str()).or_else(of_loop)
    }

    /// The process with that number in the table of ports: first the companions, then the roles.
    pub fn process_name(&self, number: u32) -> Option<&str> {
        let role = || Role::ALL.get((number as usize).checked_sub(MAX_COMPANIONS)?).map(|role| role.name());
        self.companion.get(number as usize).map(|row| row.name.as_str()).or_else(role)
    }

    /// The entry of a topic that a role reads in addition.
    pub(crate) fn of_role(&self, role: Role, topic: &str) -> Option<&AlsoReads> {
        self.also_reads.iter().find(|also| also.role == role.name() && also.topic == topic)
    }

    /// Shared memory that the topics need in addition to those of the loop, their processes included [bytes].
    ///
    /// # Errors
    /// [`RuntimeError::Settings`] for a layout that is not allowed.
    pub fn bytes(&self) -> Result<u64, RuntimeError> {
        let topics = self.topic.iter().map(|row| Ok(row.bytes(row.shape()?.0.size())));
        let topics: u64 = topics.sum::<Result<u64, RuntimeError>>()?;
        Ok(topics + NODE_BYTES * self.companion.len() as u64)
    }

    /// Rows of the table of layouts.
    pub(crate) fn rows(&self) -> Vec<LayoutRow> {
        let types = self.topic.iter().filter_map(|row| Some((row, row.layout.own_type().ok()?)));
        types.flat_map(|(row, own)| own.rows(&row.name)).collect()
    }
}

impl TopicRow {
    /// Sizes of the service.
    pub(crate) fn qos(&self) -> Qos {
        Qos {
            // The one in charge, its successor, and two that are ending.
            publishers: 4,
            // The orchestrator reads it too: in lock-step, and during a swap of its writer. So do two recorders: that of
            // the run, and one that joins it.
            subscribers: self.readers + 4,
            buffer: self.queue,
            borrowed: self.queue + 2,
            history: 0,
        }
    }

    /// The numbers of a field in the bytes of a sample; empty for a field that the samples do not have.
    pub fn numbers(fields: &[Field], field: &str, sample: &[u8]) -> Vec<f64> {
        let Some(field) = fields.iter().find(|known| known.name == field) else { return Vec::new() };
        let (element, count) = match field.kind {
            Kind::Array(element, count) => (*element, count),
            single => (single, 1),
        };
        let Kind::Scalar(name) = element else { return Vec::new() };
        let bytes = sample[field.offset..].chunks_exact(element.size()).take(count);
        bytes.map(|bytes| number(name, bytes)).collect()
    }

    /// Name, type and size on the bus.
    pub(crate) fn shape(&self) -> Result<(OwnType, Shape), RuntimeError> {
        let own = self.layout.own_type().map_err(|fault| {
            RuntimeError::settings(TOPICS_FILE.into(), format_args!("topic {}: {fault}", self.name))
        })?;
        let (size, alignment) = (own.size(), align_of::<shared_types::Header>());
        Ok((own, Shape { topic: self.name.clone(), type_name: own.type_name(), size, alignment }))
    }

    /// Shared memory for samples of `size`: the service, two writers, and all readers that there may be [bytes].
    pub fn bytes(&self, size: usize) -> u64 {
        bytes_of_topic(self.qos(), size)
    }
}

/// A scalar of a sample as a number.
fn number(kind: &str, bytes: &[u8]) -> f64 {
    match kind {
        "u8" => f64::from(bytes[0]),
        "u16" => f64::from(bytemuck::pod_read_unaligned::<u16>(bytes)),
        "u32" => f64::from(bytemuck::pod_read_unaligned::<u32>(bytes)),
        "i32" => f64::from(bytemuck::pod_read_unaligned::<i32>(bytes)),
        "u64" => bytemuck::pod_read_unaligned::<u64>(bytes) as f64,
        _ => bytemuck::pod_read_unaligned::<f64>(bytes),
    }
}

/// What topics of your own may take of shared memory, together: half of it [bytes]; `None` when it has no limit.
///
/// # Errors
/// [`RuntimeError::File`] when the file system can't be asked.
pub fn memory_limit() -> Result<Option<u64>, RuntimeError> {
    Ok(total()?.map(|bytes| bytes / 2))
}
