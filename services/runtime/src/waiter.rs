//! Hearing processes that do not ring doorbells: those that use the bus's own events, in any language.
//!
//! Writers of ours ring, and notify the topic's event as well while somebody listens there. Readers of ours listen only
//! while a process that can't ring writes one of their topics, and say so beside the doorbells. They tell by the names of
//! the notifiers: ours are called `doorbell`. Who else listens or notifies is looked up with every heartbeat, with every
//! directive and after every time-out, because those lists lie in memory that nothing else needs; one that comes is
//! announced by a directive, so it is known before its samples count, and no sample is lost in any case.

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
    events: Events,
    notifier: Notifier<ipc::Service>,
    received: Cell<bool>,
}

impl Ringer {
    pub(crate) fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        let events = bus.events(topic)?;
        let created = events.notifier_builder().name(&rings()?).create();
        let notifier =
            created.map_err(|reason| RuntimeError::bus(format!("notify topic {topic}"), reason))?;
        Ok(Self { topic, bells: Arc::clone(bus.bells()), events, notifier, received: Cell::new(true) })
    }

    /// Wakes everyone who reads the topic.
    pub(crate) fn ring(&self) {
        self.bells.ring(self.topic);
        if self.received.get() || self.bells.has_listeners(self.topic) {
            // One that can't be notified finds the sample at its next time-out.
            let _ = self.notifier.notify();
        }
    }

    /// Notes whether anybody listens to the events of the topic.
    pub(crate) fn poll_listeners(&self) {
        self.received.set(self.events.dynamic_config().number_of_listeners() > 0);
    }
}

/// The event of a topic, listened to only while somebody needs it.
pub(crate) struct Waiter {
    topic: Topic,
    bells: Arc<Bells>,
    events: Events,
    listener: RefCell<Option<Listener<ipc::Service>>>,
    rings: PortName,
    notifiers: Cell<usize>,
    needed: Cell<bool>,
}

impl Waiter {
    pub(crate) fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        Ok(Self {
            topic,
            bells: Arc::clone(bus.bells()),
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
                Ok(created) => {
                    *listener = Some(created);
                    self.bells.listens(self.topic, true);
                }
                // The time-outs remain.
                Err(reason) => {
                    tracing::warn!(topic = %self.topic, ?reason, "the events of a topic can't be heard");
                }
            },
            (false, true) => {
                self.bells.listens(self.topic, false);
                *listener = None;
            }
            _ => {}
        }
    }

    /// Readable when the event was notified; borrowed until [`Waiter::listen`] is called the next time.
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

impl Drop for Waiter {
    fn drop(&mut self) {
        self.listen(false);
    }
}

fn rings() -> Result<PortName, RuntimeError> {
    PortName::new(RINGS).map_err(|reason| RuntimeError::bus("name a port", reason))
}
