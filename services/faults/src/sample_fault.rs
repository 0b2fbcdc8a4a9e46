//! A fault of the samples of one topic.

use serde::Deserialize;
use shared_types::Topic;

/// A fault of the samples of one topic.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleFault {
    /// The topic.
    #[serde(deserialize_with = "topic")]
    pub topic: Topic,
    /// `true`: only what the robot receives is wrong, all other readers see the right sample.
    #[serde(default)]
    pub at_robot: bool,
    /// What happens to a sample.
    pub action: SampleAction,
    /// Number of scans that it lasts; without it, to the end of the drive.
    pub scans: Option<u64>,
    /// The fields that `set`, `add` and `scale` change, like `x_m` or `items.0.x_m`; all elements of an array. `freeze`
    /// without fields keeps all.
    #[serde(default)]
    pub fields: Vec<String>,
    /// The number that is set or added, or the factor; for times in nanoseconds also [ns].
    #[serde(default)]
    pub value: f64,
    /// How much later a sample arrives, for `delay` [ms].
    #[serde(default)]
    pub delay_ms: u64,
}

/// What happens to a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SampleAction {
    /// It is lost.
    Drop,
    /// Its fields get a value.
    Set,
    /// A value is added to its fields.
    Add,
    /// Its fields are multiplied.
    Scale,
    /// Its content is that of the last good sample, with a new header.
    Freeze,
    /// It is the last good sample again, with its scan and stamps, under a new number.
    Stale,
    /// It arrives later.
    Delay,
    /// It arrives twice.
    Duplicate,
    /// Each second one arrives before the one that precedes it.
    Reorder,
    /// It arrives a hundred times, each time under a new number.
    Flood,
}

fn topic<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Topic, D::Error> {
    String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
}
