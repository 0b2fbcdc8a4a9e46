//! Sizes of the services on the bus, in one place: who creates a service decides them for all.

use shared_types::Topic;

/// Sizes of one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Quality {
    /// Publishers: the process in charge, its standby, a shadow, and one that is about to leave.
    pub(crate) publishers: usize,
    /// Readers of the loop, their standbys, the orchestrator and observers.
    pub(crate) subscribers: usize,
    /// Samples that wait at one reader; the oldest is replaced when there are more.
    pub(crate) buffer: usize,
    /// Samples that one reader holds at a time.
    pub(crate) borrowed: usize,
    /// Samples that a reader who comes late may ask for.
    pub(crate) history: usize,
}

impl Quality {
    /// Samples that one reader holds at a time, of all producers together.
    pub(crate) fn most_borrowed(self) -> usize {
        self.publishers * self.borrowed
    }
}

/// Nodes on one service: all processes, twice over during swaps, and observers.
pub(crate) const NODES: usize = 32;
/// Processes that may notify or listen on one topic.
pub(crate) const EVENT_PORTS: usize = 16;

/// How many samples of one writer can wait at one reader of a topic: who finds fewer has missed none.
pub fn buffer(topic: Topic) -> usize {
    quality(topic).buffer
}

/// The sizes of a topic.
pub(crate) fn quality(topic: Topic) -> Quality {
    let stream = Quality { publishers: 4, subscribers: 12, buffer: 16, borrowed: 20, history: 0 };
    match topic {
        Topic::Scan | Topic::Odometry | Topic::Pose | Topic::Obstacles | Topic::Command => stream,
        // The account of all scans is made from these two: 256 samples last a quarter of a second at 1 kHz.
        Topic::Actuation | Topic::Truth => Quality { buffer: 256, ..stream },
        Topic::Heartbeat => Quality { publishers: 16, subscribers: 6, ..stream },
        Topic::Directive => Quality { publishers: 2, subscribers: 24, buffer: 2, borrowed: 2, history: 1 },
        Topic::Checkpoint => Quality { publishers: 16, subscribers: 12, buffer: 4, borrowed: 2, history: 1 },
    }
}
