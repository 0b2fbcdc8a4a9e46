//! Hearing processes that do not ring doorbells: those that use the bus's own events, in any language.
//!
//! Writers of ours do both: they ring, and they notify the topic's event, which costs nothing while nobody listens
//! there. Readers of ours listen only while a process that can't ring writes one of their topics. They tell by the
//! names of the notifiers: ours are called `doorbell`. One that comes is noticed at the reader's next look, which is a
//! scan later at most while anything moves, and a tenth of a second otherwise; no sample is lost by that.

use std::cell::{Cell, RefCell};
use std::os::fd::BorrowedFd;
use std::sync::Arc;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::port_name::PortName;
use iceoryx2::prelude::{CallbackProgression, PortFactory, ipc};
use shared_types::Topic;

use crate::RuntimeError;
use crate::bell::Bells;
use crate::bus::{Bus, Events};
use crate::wake::{borrow, clear, descriptor};

/// Name of the notifiers of processes that ring doorbells.
const RINGS: &str = "doorbell";

/// Wakes the readers of a topic.
pub(crate) struct Ringer {
    topic: Topic,
    bells: Arc<Bells>,
    notifier: Notifier<ipc::Service>,
}

impl Ringer {
    pub(crate) fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        let created = bus.events(topic)?.notifier_builder().name(&rings()?).create();
        let notifier =
            created.map_err(|reason| RuntimeError::bus(format!("notify topic {topic}"), reason))?;
        Ok(Self { topic, bells: Arc::clone(bus.bells()), notifier })
    }

    /// Wakes everyone who reads the topic.
    pub(crate) fn ring(&self) {
        self.bells.ring(self.topic);
        // Without a listener this is a look at the list of them. One that can't be notified finds the sample at its
        // next time-out.
        let _ = self.notifier.notify();
    }
}

/// The event of a topic, listened to only while somebody needs it.
pub(crate) struct Ear {
    topic: Topic,
    events: Events,
    listener: RefCell<Option<Listener<ipc::Service>>>,
    rings: PortName,
    notifiers: Cell<usize>,
    needed: Cell<bool>,
}

impl Ear {
    pub(crate) fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        Ok(Self {
            topic,
            events: bus.events(topic)?,
            listener: RefCell::new(None),
            rings: rings()?,
            notifiers: Cell::new(0),
            needed: Cell::new(false),
        })
    }

    /// Whether a process that does not ring writes the topic. The list of writers is read again when their number has
    /// changed, and with `again`, because one may have taken the place of another; reading it allocates.
    pub(crate) fn is_needed(&self, again: bool) -> bool {
        let notifiers = self.events.dynamic_config().number_of_notifiers();
        if again || notifiers != self.notifiers.get() {
            self.notifiers.set(notifiers);
            self.needed.set(false);
            self.events.dynamic_config().list_notifiers(|details| {
                if details.notifier_name == self.rings {
                    return CallbackProgression::Continue;
                }
                self.needed.set(true);
                CallbackProgression::Stop
            });
        }
        self.needed.get()
    }

    /// Listens from now on, or not any more.
    pub(crate) fn listen(&self, on: bool) {
        let mut listener = self.listener.borrow_mut();
        match (on, listener.is_some()) {
            (true, false) => match self.events.listener_builder().create() {
                Ok(created) => *listener = Some(created),
                // The time-outs remain.
                Err(reason) => {
                    tracing::warn!(topic = %self.topic, ?reason, "the events of a topic can't be heard");
                }
            },
            (false, true) => *listener = None,
            _ => {}
        }
    }

    /// Readable when the event was notified; borrowed until [`Ear::listen`] is called the next time.
    pub(crate) fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.listener.borrow().as_ref().map(|listener| borrow(descriptor(listener)))
    }

    /// Takes all notifications, so that the next one wakes again; to be called before the topic is emptied.
    pub(crate) fn clear(&self) {
        if let Some(listener) = &*self.listener.borrow() {
            clear(listener);
        }
    }
}

fn rings() -> Result<PortName, RuntimeError> {
    PortName::new(RINGS).map_err(|reason| RuntimeError::bus("name a port", reason))
}
