//! Wake-up between this library and processes that use the events of the bus instead of doorbells, in any language.
//!
//! Publishers of this library ring, and also notify the event of the topic while a process listens to it. Its readers
//! listen only while a process that can't ring writes one of their topics, and register this at the doorbells. They
//! recognise such a process by the name of its notifier, which is not `doorbell`.
//!
//! The lists of listeners and notifiers lie in memory that nothing else needs. So they are read only with every
//! heartbeat, with every directive and after every time-out. A new process is announced by a directive, so it is
//! known before its samples count, and no sample is lost in any case.

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
    has_listeners: Cell<bool>,
}

impl Ringer {
    pub(crate) fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        let events = bus.events(topic.name())?;
        let created = events.notifier_builder().name(&rings()?).create();
        let notifier =
            created.map_err(|reason| RuntimeError::bus(format!("notify topic {topic}"), reason))?;
        Ok(Self { topic, bells: Arc::clone(bus.bells()), events, notifier, has_listeners: Cell::new(true) })
    }

    /// Wakes all readers of the topic.
    pub(crate) fn ring(&self) {
        self.bells.ring(self.topic);
        if self.has_listeners.get() || self.bells.has_listeners(self.topic) {
            // A reader that can't be notified finds the sample at its next time-out.
            let _ = self.notifier.notify();
        }
    }

    /// Checks whether a process listens to the events of the topic.
    pub(crate) fn poll_listeners(&self) {
        self.has_listeners.set(self.events.dynamic_config().number_of_listeners() > 0);
    }
}

/// The event of a topic, listened to only while a publisher needs it.
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
            events: bus.events(topic.name())?,
            listener: RefCell::new(None),
            rings: rings()?,
            notifiers: Cell::new(0),
            needed: Cell::new(false),
        })
    }

    /// Whether a process that does not ring writes the topic. The list of publishers is read again when their number
    /// has changed, and with `again`, because one may have replaced another; reading it allocates.
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

    /// Starts or stops listening.
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
                    tracing::warn!(topic = %self.topic, ?reason, "can't listen to the events of a topic");
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

    /// Takes all notifications, so that the next one wakes again. Call it before the topic is emptied.
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
