//! Ports of iceoryx2 for samples of any type.
//!
//! A service describes the type of its samples by name, size, alignment and variant; iceoryx2 compares nothing else.
//! The bindings of iceoryx2 for C and Python pass that description as a value and move bytes, and so do these ports.
//! So its generic code is compiled here, for one type, and other processes see the same services as typed ports would
//! make.
#![expect(unsafe_code, reason = "samples in shared memory are typed by hand")]

use std::mem::MaybeUninit;
use std::ops::Deref;
use std::ptr::NonNull;

use iceoryx2::port::publisher::{self, PublisherCreateError};
use iceoryx2::port::subscriber::{self, SubscriberCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{LoanError, ReceiveError, SendError};
use iceoryx2::prelude::{BackpressureStrategy, Node, PortFactory, ServiceName, ipc};
use iceoryx2::sample::Sample as BusSample;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::builder::publish_subscribe::Builder;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::publish_subscribe;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use shared_types::SampleType;

use crate::RuntimeError;
use crate::qos::PROCESS_QUEUE;

/// A service for samples.
pub(crate) type Samples =
    publish_subscribe::PortFactory<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>;
/// The builder that creates or opens one.
pub(crate) type SamplesBuilder = Builder<[CustomPayloadMarker], CustomHeaderMarker, ipc::Service>;

/// What a service is made from: the name of its topic, and the type of its samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Name of the topic.
    pub(crate) topic: String,
    /// Name of the type on the bus.
    pub(crate) type_name: String,
    /// Size of a sample [bytes].
    pub(crate) size: usize,
    /// Its alignment [bytes].
    pub(crate) alignment: usize,
}

impl From<&SampleType> for Shape {
    fn from(of: &SampleType) -> Self {
        let (topic, type_name) = (of.topic.name().to_owned(), of.name.to_owned());
        Self { topic, type_name, size: of.size, alignment: of.alignment }
    }
}

/// The description of a sample type for a service, as a port of that type gives it.
pub(crate) fn of_samples(of: &Shape) -> Result<TypeDetail, RuntimeError> {
    TypeDetail::__internal_new_from_parts(TypeVariant::FixedSize, &of.type_name, of.size, of.alignment)
        .map_err(|reason| RuntimeError::bus(format!("describe samples of topic {}", of.topic), reason))
}

/// The builder of the service `name`, for samples without a user header.
pub(crate) fn samples(node: &Node<ipc::Service>, name: &ServiceName, detail: &TypeDetail) -> SamplesBuilder {
    let builder = node
        .service_builder(name)
        .publish_subscribe::<[CustomPayloadMarker]>()
        .user_header::<CustomHeaderMarker>();
    // SAFETY: the ports below treat payloads as bytes of this size and alignment, and touch no user header, which is
    // empty as `()` is.
    unsafe {
        builder
            .__internal_set_payload_type_details(detail)
            .__internal_set_user_header_type_details(&TypeDetail::new::<()>(TypeVariant::FixedSize))
    }
}

/// How many publishers a service has.
pub(crate) fn publishers(service: &Samples) -> usize {
    service.dynamic_config().number_of_publishers()
}

/// Lends places in shared memory and sends what was written there.
#[derive(Debug)]
pub(crate) struct BytePublisher {
    port: publisher::Publisher<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>,
    service: Samples,
}

impl BytePublisher {
    /// A port that lends one place at a time.
    pub(crate) fn new(service: Samples) -> Result<Self, PublisherCreateError> {
        let port = service
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()?;
        Ok(Self { port, service })
    }

    /// The place of the next sample.
    pub(crate) fn loan(&self) -> Result<Loan, LoanError> {
        // SAFETY: samples have one element each.
        unsafe { self.port.loan_custom_payload(1) }.map(Loan)
    }

    /// Makes this end of all connections; a failed one is retried at the next send.
    pub(crate) fn connect(&self) {
        let _ = self.port.update_connections();
    }

    /// How many publishers the service has.
    #[cfg(test)]
    pub(crate) fn publishers(&self) -> usize {
        publishers(&self.service)
    }

    /// How many subscribers the service has.
    pub(crate) fn subscribers(&self) -> usize {
        self.service.dynamic_config().number_of_subscribers()
    }
}

/// Shared memory for one sample; it holds the bytes of an older one.
pub(crate) struct Loan(SampleMutUninit<ipc::Service, [MaybeUninit<CustomPayloadMarker>], CustomHeaderMarker>);

impl Loan {
    /// The place.
    pub(crate) fn bytes(&mut self) -> &mut [u8] {
        let place = self.0.payload_mut();
        // SAFETY: a marker is one byte. These are shared memory, which the kernel hands out zeroed and samples without
        // padding were written to since: all of them have values.
        unsafe { std::slice::from_raw_parts_mut(place.as_mut_ptr().cast(), place.len()) }
    }

    /// Sends the sample; returns how many subscribers got it.
    pub(crate) fn send(self) -> Result<usize, SendError> {
        // SAFETY: as in `bytes`; any bytes are a valid payload.
        unsafe { self.0.assume_init() }.send()
    }
}

/// How many samples of one publisher wait at a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Queue {
    /// As at the processes of the loop.
    Process,
    /// As many as the topic allows.
    Observer,
}

/// Receives samples.
#[derive(Debug)]
pub(crate) struct ByteSubscriber {
    port: subscriber::Subscriber<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>,
    topic: String,
    /// Size of each sample [bytes].
    size: usize,
}

impl ByteSubscriber {
    /// A port that also receives as many earlier samples as the topic keeps.
    pub(crate) fn new(
        service: &Samples,
        of: &Shape,
        queue: Queue,
        history: usize,
    ) -> Result<Self, SubscriberCreateError> {
        let builder = service.subscriber_builder().history_request(history);
        let most = service.static_config().subscriber_max_buffer_size();
        let builder = match queue {
            Queue::Process => builder.buffer_size(most.min(PROCESS_QUEUE)),
            Queue::Observer => builder,
        };
        let port = builder.create()?;
        Ok(Self { port, topic: of.topic.clone(), size: of.size })
    }

    /// How many samples of one publisher can wait here. A reader that finds fewer has missed none.
    pub(crate) fn capacity(&self) -> usize {
        self.port.buffer_size()
    }

    /// The next sample. Samples of another size are skipped: their publisher is damaged.
    pub(crate) fn receive(&self) -> Result<Option<Received>, RuntimeError> {
        self.next().map_err(|reason| self.error(reason))
    }

    /// Hands over the waiting samples; false when it ended because no more may be borrowed.
    pub(crate) fn receive_all(&self, mut each: impl FnMut(Received)) -> Result<bool, RuntimeError> {
        loop {
            match self.next() {
                Ok(Some(sample)) => each(sample),
                Ok(None) => return Ok(true),
                Err(ReceiveError::ExceedsMaxBorrows) => return Ok(false),
                Err(reason) => return Err(self.error(reason)),
            }
        }
    }

    /// Makes this end of all connections; a failed one is retried when receiving.
    pub(crate) fn connect(&self) {
        let _ = self.port.update_connections();
    }

    fn next(&self) -> Result<Option<Received>, ReceiveError> {
        while let Some(sample) = self.port.receive()? {
            let sample = Received::new(sample);
            if sample.len() == self.size {
                return Ok(Some(sample));
            }
        }
        Ok(None)
    }

    fn error(&self, reason: ReceiveError) -> RuntimeError {
        RuntimeError::bus(format!("receive from topic {}", self.topic), reason)
    }
}

/// The bytes of a sample, read in place and returned to their publisher when dropped.
pub(crate) struct Received {
    bytes: NonNull<[u8]>,
    /// Keeps the bytes borrowed.
    _sample: BusSample<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>,
}

impl Received {
    fn new(sample: BusSample<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>) -> Self {
        let payload = sample.payload();
        // A marker is one byte.
        let bytes = NonNull::slice_from_raw_parts(NonNull::from(payload).cast(), payload.len());
        Self { bytes, _sample: sample }
    }
}

impl Deref for Received {
    type Target = [u8];

    #[inline(always)]
    fn deref(&self) -> &[u8] {
        // SAFETY: they lie in shared memory that stays mapped, and are not written to, while the sample is borrowed.
        unsafe { self.bytes.as_ref() }
    }
}
