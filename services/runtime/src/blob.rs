//! Bytes of any number that travel beside the samples of a topic: the payload of a transport bench.
//!
//! A blob is published before the sample that it belongs to, without waking anyone, and starts with the scan's
//! number; the reader takes it when it has taken the sample. So the samples keep their types and all accounting, and
//! a hop carries as many bytes as asked for. Blobs are written into shared memory once and read in place.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use shared_types::Topic;

use crate::enclosed::Enclosed;
use crate::output::Connect;
use crate::port::{BytePublisher, ByteSubscriber, Received};
use crate::{Process, RuntimeError};

/// Smallest blob: the number of its scan [bytes].
pub const SMALLEST_BLOB: usize = 8;

/// Publishes blobs beside one topic.
pub struct BlobOutput {
    publisher: Enclosed<BytePublisher>,
    content: RefCell<Vec<u8>>,
    topic: Topic,
}

/// Takes blobs that came beside one topic.
pub struct BlobInput {
    subscriber: Enclosed<ByteSubscriber>,
    /// Of a later scan than the one asked for last.
    ahead: Enclosed<RefCell<Option<Received>>>,
    read: Cell<u64>,
}

impl Process {
    /// Opens the blobs beside `topic` for writing, `bytes` each; the orchestrator has to have created them.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn blob_output(&mut self, topic: Topic, bytes: usize) -> Result<Rc<BlobOutput>, RuntimeError> {
        let publisher = Enclosed::new(self.bus().blob_publisher(topic, bytes.max(SMALLEST_BLOB))?);
        let content = RefCell::new(vec![0; bytes.max(SMALLEST_BLOB)]);
        let output = Rc::new(BlobOutput { publisher, content, topic });
        self.connects(Rc::clone(&output) as Rc<dyn Connect>);
        Ok(output)
    }

    /// Opens the blobs beside `topic` for reading.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn blob_input(&mut self, topic: Topic) -> Result<Rc<BlobInput>, RuntimeError> {
        let subscriber = Enclosed::new(self.bus().blob_subscriber(topic)?);
        let ahead = Enclosed::new(RefCell::default());
        let input = Rc::new(BlobInput { subscriber, ahead, read: Cell::default() });
        self.connects(Rc::clone(&input) as Rc<dyn Connect>);
        Ok(input)
    }
}

impl BlobOutput {
    /// Copies one blob for a scan into shared memory and publishes it, without waking anyone.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn publish(&self, scan_id: u64) -> Result<(), RuntimeError> {
        let error = |reason: &dyn std::fmt::Debug| {
            RuntimeError::bus(format!("publish a payload beside topic {}", self.topic), reason)
        };
        let mut content = self.content.borrow_mut();
        content[..SMALLEST_BLOB].copy_from_slice(&scan_id.to_le_bytes());
        let mut place = self.publisher.loan(content.len()).map_err(|reason| error(&reason))?;
        place.bytes().copy_from_slice(&content);
        place.send().map_err(|reason| error(&reason))?;
        Ok(())
    }
}

impl BlobInput {
    /// Takes the blob of a scan and reads one byte of each cache line of it; false when it is not there.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn take(&self, scan_id: u64) -> Result<bool, RuntimeError> {
        loop {
            let ahead = self.ahead.take();
            let received = match ahead {
                Some(blob) => Some(blob),
                None => self.subscriber.receive()?,
            };
            let Some(blob) = received else { return Ok(false) };
            let number = blob.first_chunk().map_or(0, |number| u64::from_le_bytes(*number));
            if number > scan_id {
                // The bus keeps fewer blobs than samples: those of older scans are gone, this one's turn comes.
                self.ahead.replace(Some(blob));
                return Ok(false);
            }
            if number == scan_id {
                let sum = blob.iter().step_by(64).fold(0_u64, |sum, byte| sum + u64::from(*byte));
                self.read.set(std::hint::black_box(sum));
                return Ok(true);
            }
        }
    }
}

impl Connect for BlobOutput {
    fn connect(&self) {
        self.publisher.connect();
    }
}

impl Connect for BlobInput {
    fn connect(&self) {
        self.subscriber.connect();
    }
}
