//! Fields of a topic of your own that a built-in stage reads.

use std::rc::Rc;

use shared_types::Kind;

use super::member::Member;
use super::table::TopicRow;
use super::topic::{ByteTopic, TakenBytes};
use crate::{Bus, RuntimeError};

/// Fields of one topic.
pub(crate) struct OwnFields {
    topic: ByteTopic,
    offsets: Vec<usize>,
    /// How long a sample counts [ns]; `None` in simulated time.
    max_age_ns: Option<u64>,
}

impl OwnFields {
    /// Opens the topic; with its end, to be connected.
    ///
    /// # Errors
    /// A topic that this process does not read, one without these fields, and errors of the bus.
    pub(crate) fn open(
        bus: &Bus,
        member: &Rc<Member>,
        name: &str,
        (fields, kind): (&[&str], &str),
    ) -> Result<(Self, ByteTopic), RuntimeError> {
        let offsets = member.use_of(name)?.0.offsets_of(fields, kind)?;
        let topic = ByteTopic::open(bus, member, name, &|_| Ok(()))?;
        let max_age_ns = member.max_age_ns(name);
        Ok((Self { topic: topic.clone(), offsets, max_age_ns }, topic))
    }

    /// How long a sample counts [ns]; `None` in simulated time.
    pub(super) fn max_age_ns(&self) -> Option<u64> {
        self.max_age_ns
    }

    /// The first byte of the first field of the oldest sample that was not taken.
    pub(super) fn take(&self) -> Result<Option<u8>, RuntimeError> {
        Ok(self.topic.take()?.map(|sample| sample[self.offsets[0]]))
    }

    /// The oldest sample that was not taken, as [`ByteTopic::up_to`].
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn up_to(&self, scan_id: u64) -> Result<Option<TakenBytes>, RuntimeError> {
        self.topic.up_to(scan_id)
    }

    /// The fields of a sample, as the bits of 8 bytes each.
    pub(crate) fn bits<'s>(&'s self, sample: &'s [u8]) -> impl Iterator<Item = u64> + 's {
        self.offsets.iter().map(|at| bytemuck::pod_read_unaligned(&sample[*at..at + size_of::<u64>()]))
    }
}

impl TopicRow {
    /// Where a sample has these fields of one kind [bytes].
    ///
    /// # Errors
    /// A layout without one of them.
    pub fn offsets_of(&self, fields: &[&str], kind: &str) -> Result<Vec<usize>, RuntimeError> {
        let (own, _) = self.shape()?;
        let offset = |name: &&str| {
            let is_it = |field: &&shared_types::Field| {
                field.name == *name && matches!(field.kind, Kind::Scalar(found) if found == kind)
            };
            own.fields().iter().find(is_it).map(|field| field.offset).ok_or_else(|| {
                let what = format!("its layout has no field `{name}` of type {kind}, which its reader needs");
                RuntimeError::settings(format!("topic {}", self.name).into(), what)
            })
        };
        fields.iter().map(offset).collect()
    }
}
