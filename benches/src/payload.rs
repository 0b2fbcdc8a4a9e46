//! Bytes of any number that travel with the samples of a topic: the payload of the transport chain.
//!
//! A payload is published before its sample, without a wake-up, and starts with the scan id; the reader takes it after
//! the sample. So the samples keep their types and counters, and a hop carries as many bytes as requested. Payloads
//! are written into shared memory once and read in place.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{BackpressureStrategy, ServiceName, ipc};
use iceoryx2::sample::Sample as BusSample;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use runtime::Process;
use shared_types::Topic;

/// Length of the scan id at the start of a payload [bytes].
const SCAN_ID_BYTES: usize = 8;
/// How long to retry opening a service that another process creates at the same time.
const OPEN_RETRY: Duration = Duration::from_secs(5);

/// The payload that a stage sends with one topic, if there is one.
pub(crate) struct Sent(Option<Sender>);

/// The payload that a stage takes with one topic, if there is one.
pub(crate) struct Received(Option<Receiver>);

struct Sender {
    publisher: Rc<Publisher<ipc::Service, [u8], ()>>,
    content: RefCell<Vec<u8>>,
}

struct Receiver {
    subscriber: Rc<Subscriber<ipc::Service, [u8], ()>>,
    /// Of a later scan than the one asked for last.
    ahead: Cell<Option<BusSample<ipc::Service, [u8], ()>>>,
    read: Cell<u64>,
}

impl Sent {
    /// Opens the payloads of `topic` for writing, so many bytes each.
    pub(crate) fn open(process: &mut Process, topic: Topic, bytes: Option<usize>) -> anyhow::Result<Self> {
        let Some(bytes) = bytes else { return Ok(Self(None)) };
        let content = vec![0; bytes.max(SCAN_ID_BYTES)];
        let publisher = Rc::new(
            service(process, topic)?
                .publisher_builder()
                .initial_max_slice_len(content.len())
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()?,
        );
        let port = Rc::clone(&publisher);
        process.on_connect(move || _ = port.update_connections());
        Ok(Self(Some(Sender { publisher, content: RefCell::new(content) })))
    }

    /// Copies the payload of a scan into shared memory and publishes it, without a wake-up.
    pub(crate) fn publish(&self, scan_id: u64) -> anyhow::Result<()> {
        let Some(Sender { publisher, content }) = &self.0 else { return Ok(()) };
        let mut content = content.borrow_mut();
        content[..SCAN_ID_BYTES].copy_from_slice(&scan_id.to_le_bytes());
        publisher.loan_slice_uninit(content.len())?.write_from_slice(&content).send()?;
        Ok(())
    }
}

impl Received {
    /// Opens the payloads of `topic` for reading.
    pub(crate) fn open(process: &mut Process, topic: Topic, bytes: Option<usize>) -> anyhow::Result<Self> {
        if bytes.is_none() {
            return Ok(Self(None));
        }
        let subscriber = Rc::new(service(process, topic)?.subscriber_builder().create()?);
        let port = Rc::clone(&subscriber);
        process.on_connect(move || _ = port.update_connections());
        Ok(Self(Some(Receiver { subscriber, ahead: Cell::default(), read: Cell::default() })))
    }

    /// Whether the stage may answer: a scan whose payload is missing stays without an answer, and counts as lost.
    pub(crate) fn take(&self, scan_id: u64) -> anyhow::Result<bool> {
        self.0.as_ref().map_or(Ok(true), |receiver| receiver.take(scan_id))
    }
}

impl Receiver {
    /// Takes the payload of a scan and reads one byte of each cache line of it; false when it is not there.
    fn take(&self, scan_id: u64) -> anyhow::Result<bool> {
        loop {
            let next = match self.ahead.take() {
                Some(sample) => Some(sample),
                None => self.subscriber.receive()?,
            };
            let Some(sample) = next else { return Ok(false) };
            let payload = sample.payload();
            let number = payload.first_chunk().map_or(0, |number| u64::from_le_bytes(*number));
            if number > scan_id {
                // The bus keeps fewer payloads than samples: those of older scans are gone, this one is used later.
                self.ahead.set(Some(sample));
                return Ok(false);
            }
            if number == scan_id {
                let sum = payload.iter().step_by(64).fold(0_u64, |sum, byte| sum + u64::from(*byte));
                self.read.set(std::hint::black_box(sum));
                return Ok(true);
            }
        }
    }
}

/// The service for the payloads of a topic; the first process that asks for it creates it.
fn service(process: &Process, topic: Topic) -> anyhow::Result<PortFactory<ipc::Service, [u8], ()>> {
    let name = ServiceName::new(&format!("{topic}-payload"))?;
    let open = || {
        process
            .node()
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .max_publishers(2)
            .max_subscribers(4)
            .subscriber_max_buffer_size(4)
            .subscriber_max_borrowed_samples(2)
            .history_size(0)
            .enable_safe_overflow(true)
            .max_nodes(8)
            .open_or_create()
    };
    let started = Instant::now();
    loop {
        match open() {
            Err(_) if started.elapsed() < OPEN_RETRY => std::thread::sleep(Duration::from_millis(5)),
            opened => return opened.map_err(|reason| anyhow!("payloads of topic {topic}: {reason}")),
        }
    }
}
