//! An emergency stop from outside that the bench plays: a topic which the actuator reads in addition.

use anyhow::Context;
use runtime::{
    AlsoReads, Bus, CompanionPage, Domain, EMERGENCY_STOP_FIELDS, LayoutField, LayoutFile, OPERATOR,
    OwnPublisher, OwnTopics, PortTable, RunSettings, TopicRow, monotonic_ns,
};
use shared_types::Role;

/// Name of the topic.
const TOPIC: &str = "button";
/// A button that is silent for longer counts as pressed [ms].
const MAX_AGE_MS: f64 = 500.0;
/// Time between two samples [ns].
const INTERVAL_NS: u64 = 50_000_000;

/// The button.
pub(crate) struct Button {
    publisher: OwnPublisher,
    /// One sample, in words so that its header is aligned.
    words: Vec<u64>,
    /// Where the sample says whether it is pressed [bytes].
    offset: usize,
    sequence: u64,
    due_ns: u64,
    /// Whether it is pressed; `None` while it is silent.
    pub(crate) is_pressed: Option<bool>,
}

impl Button {
    /// Writes the table with its topic, before the bus is made.
    pub(crate) fn write(domain: &Domain, run: RunSettings) -> anyhow::Result<()> {
        let field = |(name, kind): (&str, &str)| LayoutField {
            name: name.to_owned(),
            kind: kind.to_owned(),
            doc: String::new(),
        };
        let fields = [("pressed", "u8"), ("reserved", "u8[7]")].map(field).to_vec();
        let layout = LayoutFile { name: "Button".to_owned(), doc: String::new(), field: fields };
        let row = TopicRow {
            name: TOPIC.to_owned(),
            writer: OPERATOR.to_owned(),
            queue: 8,
            readers: 1,
            agree: Vec::new(),
            layout,
        };
        let role = Role::Actuator.name().to_owned();
        let also = AlsoReads { role, topic: TOPIC.to_owned(), max_age_ms: MAX_AGE_MS };
        OwnTopics { run, topic: vec![row], companion: Vec::new(), also_reads: vec![also] }.write(domain)?;
        CompanionPage::create(domain)?;
        PortTable::create(domain)?;
        Ok(())
    }

    /// A button that is not pressed.
    pub(super) fn open(bus: &Bus, domain: &Domain) -> anyhow::Result<Self> {
        let table = OwnTopics::of(domain)?.context("the table of topics is gone")?;
        let offset = *table
            .find(TOPIC)
            .context("no button")?
            .offsets_of(EMERGENCY_STOP_FIELDS, "u8")?
            .first()
            .context("no field")?;
        let publisher = OwnPublisher::new(bus, &table, TOPIC)?;
        let words = vec![0; publisher.own_type().size() / size_of::<u64>()];
        Ok(Self { publisher, words, offset, sequence: 0, due_ns: 0, is_pressed: Some(false) })
    }

    /// Says whether it is pressed, when that is due.
    pub(super) fn turn(&mut self) -> anyhow::Result<()> {
        let (now_ns, Some(is_pressed)) = (monotonic_ns(), self.is_pressed) else { return Ok(()) };
        if now_ns < self.due_ns {
            return Ok(());
        }
        (self.due_ns, self.sequence) = (now_ns + INTERVAL_NS, self.sequence + 1);
        let sample: &mut [u8] = bytemuck::cast_slice_mut(&mut self.words);
        sample[self.offset] = u8::from(is_pressed);
        self.publisher.publish(sample, std::process::id(), self.sequence)?;
        Ok(())
    }

    /// Presses or releases it, at once; `None` lets it be silent.
    pub(crate) fn set(&mut self, is_pressed: Option<bool>) {
        (self.is_pressed, self.due_ns) = (is_pressed, 0);
    }
}
