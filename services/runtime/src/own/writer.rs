//! The writing end of a topic of your own, for samples of any type.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::ipc;
use shared_types::{Header, OwnType, StageStamps};

use super::member::Member;
use super::ports::Port;
use super::table::{OwnTopics, TopicRow};
use crate::enclosed::Enclosed;
use crate::port::{BytePublisher, Loan, Shape};
use crate::{Bus, RuntimeError, monotonic_ns};

/// Publishes samples of one type, which it is given as bytes.
pub(crate) struct OwnWriter {
    sender: Sender,
    layout: u32,
    member: Rc<Member>,
    sequence: Cell<u64>,
    port: RefCell<Port>,
}

impl OwnWriter {
    pub(super) fn new(bus: &Bus, member: &Rc<Member>, row: &TopicRow) -> Result<Rc<Self>, RuntimeError> {
        let (own, shape) = row.shape()?;
        let sender = Sender::open(bus, &shape)?;
        Ok(Rc::new(Self {
            sender,
            layout: own.layout(),
            member: Rc::clone(member),
            sequence: Cell::new(0),
            port: member.port(&row.name, true),
        }))
    }

    pub(super) fn connect(&self) {
        self.sender.publisher.connect();
    }

    pub(super) fn publish(&self, sample: &mut [u8]) -> Result<(), RuntimeError> {
        let mut place = self.sender.loan()?;
        self.complete(sample);
        place.bytes().copy_from_slice(sample);
        self.send(place)
    }

    pub(super) fn publish_in_place(&self, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), RuntimeError> {
        let mut place = self.sender.loan()?;
        fill(place.bytes());
        self.complete(place.bytes());
        self.send(place)
    }

    /// Fills layout, incarnation, sequence and the stamps of this process.
    fn complete(&self, sample: &mut [u8]) {
        let member = &*self.member;
        self.sequence.set(self.sequence.get() + 1);
        let header = header_of(sample);
        (header.layout, header.incarnation, header.sequence) =
            (self.layout, member.incarnation, self.sequence.get());
        let scan_ns = if member.clock.is_simulated() { 0 } else { header.scan_published_ns() };
        let now = member.clock.now_ns();
        let stamps = StageStamps { computed_ns: now, published_ns: now, ..member.stamps.get() };
        let at = sample.len() - size_of::<StageStamps>();
        self.port.borrow_mut().delayed(scan_ns, now);
        sample[at..].copy_from_slice(bytemuck::bytes_of(&stamps));
    }

    fn send(&self, place: Loan) -> Result<(), RuntimeError> {
        self.sender.send(place)?;
        let port = &mut *self.port.borrow_mut();
        port.account.arrived = self.sequence.get();
        port.show(std::iter::empty());
        let report = &mut *self.member.report.borrow_mut();
        report.published += 1;
        report.published_ns = monotonic_ns();
        self.member.write(report);
        Ok(())
    }
}

/// Sends bytes and notifies the readers.
struct Sender {
    topic: String,
    publisher: BytePublisher,
    notifier: Notifier<ipc::Service>,
}

impl Sender {
    fn open(bus: &Bus, shape: &Shape) -> Result<Self, RuntimeError> {
        let topic = shape.topic.clone();
        let notifier = bus.events(&topic)?.notifier_builder().create();
        let notifier =
            notifier.map_err(|reason| RuntimeError::bus(format!("notify topic {topic}"), reason))?;
        Ok(Self { publisher: bus.publisher_of(shape)?, notifier, topic })
    }

    fn loan(&self) -> Result<Loan, RuntimeError> {
        self.publisher.loan().map_err(|reason| self.error("loan", reason))
    }

    fn send(&self, place: Loan) -> Result<(), RuntimeError> {
        place.send().map_err(|reason| self.error("send", reason))?;
        // A reader that can't be notified finds the sample at its next time-out.
        let _ = self.notifier.notify();
        Ok(())
    }

    fn error(&self, action: &str, reason: impl std::fmt::Debug) -> RuntimeError {
        RuntimeError::bus(format!("{action} a sample of topic {}", self.topic), reason)
    }
}

fn header_of(sample: &mut [u8]) -> &mut Header {
    bytemuck::from_bytes_mut(&mut sample[..size_of::<Header>()])
}

/// Publishes by hand on a topic whose writer is [`super::OPERATOR`].
pub struct OwnPublisher {
    own: OwnType,
    sender: Enclosed<Sender>,
}

impl OwnPublisher {
    /// Opens the topic for writing. Readers get samples from [`OwnPublisher::publish`] once they have made their end of
    /// the connection: wait a scan period.
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`], also for a topic that a companion writes, and [`RuntimeError::Bus`].
    pub fn new(bus: &Bus, table: &OwnTopics, topic: &str) -> Result<Self, RuntimeError> {
        let unknown =
            || RuntimeError::NoOwnTopic { process: super::OPERATOR.to_owned(), topic: topic.to_owned() };
        let row = table.find(topic).filter(|row| row.writer == super::OPERATOR).ok_or_else(unknown)?;
        let (own, shape) = row.shape()?;
        let sender = Enclosed::new(Sender::open(bus, &shape)?);
        bus.allocate()?;
        sender.publisher.connect();
        Ok(Self { own, sender })
    }

    /// The type of the samples.
    pub fn own_type(&self) -> &OwnType {
        &self.own
    }

    /// Publishes a sample; layout, incarnation, sequence and stamps are filled here.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn publish(&self, sample: &mut [u8], incarnation: u32, sequence: u64) -> Result<(), RuntimeError> {
        let header = header_of(sample);
        (header.layout, header.incarnation, header.sequence) = (self.own.layout(), incarnation, sequence);
        let now = monotonic_ns();
        let stamps = StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
        let at = sample.len() - size_of::<StageStamps>();
        sample[at..].copy_from_slice(bytemuck::bytes_of(&stamps));
        let mut place = self.sender.loan()?;
        place.bytes().copy_from_slice(sample);
        self.sender.send(place)
    }
}
