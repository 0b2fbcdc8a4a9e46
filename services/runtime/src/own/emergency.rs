//! Emergency stops from outside: topics of your own by which a companion says whether a button is pressed.
//!
//! The actuator reads them itself, so that a stop needs no other process. A button that says nothing for longer than
//! `max_age_ms` counts as pressed.

use std::rc::Rc;

use shared_types::Kind;

use super::member::Member;
use super::table::TopicRow;
use super::topic::ByteTopic;
use crate::{Bus, RuntimeError};

/// The field that says it: not zero for pressed.
const FIELD: &str = "pressed";

/// What the actuator knows of one button.
pub(crate) struct EmergencyStop {
    topic: ByteTopic,
    offset: usize,
    /// How long a sample counts [ns]; `None` in simulated time.
    max_age_ns: Option<u64>,
    /// When a sample came last [ns]; 0 before the first.
    seen_ns: u64,
    is_pressed: bool,
}

impl EmergencyStop {
    /// Opens the topic of a button; with its end, to be connected.
    ///
    /// # Errors
    /// A topic that this process does not read, one that tells of no button, and errors of the bus.
    pub(crate) fn open(
        bus: &Bus,
        member: &Rc<Member>,
        name: &str,
    ) -> Result<(Self, ByteTopic), RuntimeError> {
        let offset = member.use_of(name)?.0.pressed_at()?;
        let topic = ByteTopic::open(bus, member, name, &|_| Ok(()))?;
        let max_age_ns = member.max_age_ns(name);
        Ok((Self { topic: topic.clone(), offset, max_age_ns, seen_ns: 0, is_pressed: false }, topic))
    }

    /// Whether the wheels have to be blocked for it at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn blocks(&mut self, now_ns: u64) -> Result<bool, RuntimeError> {
        while let Some(sample) = self.topic.take()? {
            self.is_pressed = sample[self.offset] != 0;
            self.seen_ns = now_ns;
        }
        let is_silent = self.max_age_ns.is_some_and(|limit| now_ns.saturating_sub(self.seen_ns) > limit);
        Ok(self.is_pressed || is_silent || self.seen_ns == 0)
    }
}

impl TopicRow {
    /// Where a sample says whether a button is pressed [bytes].
    ///
    /// # Errors
    /// A layout without a field `pressed` of type u8.
    pub fn pressed_at(&self) -> Result<usize, RuntimeError> {
        let (own, _) = self.shape()?;
        let field = own.fields().iter().find(|field| field.name == FIELD && field.kind == Kind::Scalar("u8"));
        field.map(|field| field.offset).ok_or_else(|| {
            let what =
                format!("its layout has no field `{FIELD}` of type u8, by which an emergency stop is told");
            RuntimeError::settings(format!("topic {}", self.name).into(), what)
        })
    }
}
