//! Sizes of the services on the bus, in one place: the process that creates a service decides them for all.

use shared_types::Topic;

/// Sizes of one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Qos {
    /// Publishers: the process in charge, its standby, a shadow, and one that is ending.
    pub(crate) publishers: usize,
    /// Readers of the loop, their standbys, the orchestrator and observers.
    pub(crate) subscribers: usize,
    /// Samples that wait at one reader; the oldest is replaced when there are more.
    pub(crate) buffer: usize,
    /// Samples that one reader holds at a time.
    pub(crate) borrowed: usize,
    /// Earlier samples that a new reader gets.
    pub(crate) history: usize,
}

impl Qos {
    /// Samples that one reader holds at a time, of all producers together.
    pub(crate) fn max_borrowed(self) -> usize {
        self.publishers * self.borrowed
    }

    /// Samples in the memory of one publisher: each reader queues and holds its share, and one is being written.
    fn samples(self) -> usize {
        self.subscribers * (self.buffer + self.borrowed) + self.history + 1
    }

    /// Memory for the samples of one publisher, of `size` each, at most [bytes].
    pub(crate) fn samples_bytes(self, size: usize) -> u64 {
        whole_pages(self.samples() * (size + SAMPLE_EXTRA))
    }

    /// Memory of the connection of one publisher to one reader, at most [bytes]: two queues of indices, and a mark for
    /// each sample.
    pub(crate) fn connection_bytes(self) -> u64 {
        whole_pages(size_of::<u64>() * (2 * self.buffer + self.borrowed + 2) + self.samples())
    }
}

/// What the bus adds to each sample: its header, alignment and a place in the list of free ones [bytes].
const SAMPLE_EXTRA: usize = 96;
/// What the bus has in front of what a file holds, at most [bytes].
const FILE_EXTRA: usize = 1024;
/// Files are allocated in pages of this size [bytes].
const PAGE: usize = 4096;

fn whole_pages(bytes: usize) -> u64 {
    (bytes + FILE_EXTRA).next_multiple_of(PAGE) as u64
}

/// Nodes on one service: all processes, twice over during swaps, and observers.
pub(crate) const NODES: usize = 32;
/// Processes that may notify or listen on one topic.
pub(crate) const EVENT_PORTS: usize = 16;

/// How many samples of one publisher can wait at one reader of a topic. A reader that finds fewer has missed none.
pub fn buffer(topic: Topic) -> usize {
    qos(topic).buffer
}

/// The sizes of a topic.
pub(crate) fn qos(topic: Topic) -> Qos {
    let stream = Qos { publishers: 4, subscribers: 12, buffer: 16, borrowed: 20, history: 0 };
    match topic {
        Topic::Scan | Topic::Odometry | Topic::Pose | Topic::Obstacles | Topic::Command => stream,
        // The ledger is made from these two: 256 samples last a quarter of a second at 1 kHz.
        Topic::Actuation | Topic::Truth => Qos { buffer: 256, ..stream },
        Topic::Heartbeat => Qos { publishers: 16, subscribers: 6, ..stream },
        // In lock-step each scan is granted by one: a recorder takes them a few scans later.
        Topic::Directive => Qos { publishers: 2, subscribers: 24, buffer: 16, borrowed: 2, history: 1 },
        Topic::Checkpoint => Qos { publishers: 16, subscribers: 12, buffer: 4, borrowed: 2, history: 1 },
    }
}
