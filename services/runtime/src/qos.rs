//! Sizes of the services on the bus, in one place: the process that creates a service decides them for all.

use shared_types::Topic;

/// Sizes of one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Qos {
    /// Publishers: the process in charge, its standby, a shadow, and one that is ending.
    pub(crate) publishers: usize,
    /// Readers of the loop, their standbys, the orchestrator and observers.
    pub(crate) subscribers: usize,
    /// Samples that wait at one observer; the oldest is replaced when there are more. A process has a shorter queue of
    /// its own, [`Qos::of_a_process`].
    pub(crate) buffer: usize,
    /// Samples that one reader holds at a time.
    pub(crate) borrowed: usize,
    /// Earlier samples that a new reader gets.
    pub(crate) history: usize,
}

impl Qos {
    /// Samples of one publisher that wait at a process of the loop.
    pub(crate) fn of_a_process(self) -> usize {
        self.buffer.min(PROCESS_QUEUE)
    }

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

/// Readers of a topic of the loop at a time: its processes, their successors, the orchestrator and observers.
pub(crate) const MAX_READERS: usize = 24;
/// Samples of one publisher that wait at a process of the loop, and at least so many at an observer.
pub const PROCESS_QUEUE: usize = 16;
/// Memory for the samples that wait at all observers of one topic, for each publisher [bytes].
const OBSERVED_BYTES: usize = 4_000_000;
/// Nodes on one service: all readers, and writers with their successors.
pub(crate) const NODES: usize = 48;
/// Processes that may notify or listen on one topic.
pub(crate) const EVENT_PORTS: usize = 16;

/// Samples of one publisher that wait at an observer of a topic: those of one second or what fits into 4 MB for all
/// readers, whichever is smaller, and never less than at a process.
///
/// `size` is that of a sample [bytes], `period_ns` the time between two samples.
pub fn observer_queue(size: usize, period_ns: u64) -> usize {
    let second = 1_000_000_000 / period_ns.max(1);
    let fitting = OBSERVED_BYTES / (MAX_READERS * size.max(1));
    usize::try_from(second).map_or(fitting, |second| second.min(fitting)).max(PROCESS_QUEUE)
}

/// The sizes of a topic in a system with this scan period [ns].
pub(crate) fn qos(topic: Topic, period_ns: u64) -> Qos {
    let buffer = observer_queue(topic.size(), period_ns);
    let stream = Qos { publishers: 4, subscribers: MAX_READERS, buffer, borrowed: 20, history: 0 };
    match topic {
        // Of the largest samples twice as many fit: else a recorder would have to come within 19 ms at 1 kHz.
        Topic::Scan => Qos { buffer: observer_queue(topic.size() / 2, period_ns), ..stream },
        Topic::Odometry | Topic::Pose | Topic::Obstacles | Topic::Command => stream,
        // The ledger is made from these two, and in lock-step a second has more scans than in real time.
        Topic::Actuation | Topic::Truth => Qos { buffer: buffer.max(256), ..stream },
        // Ten a second of each process, at any rate of scans. Observers alone read them.
        Topic::Heartbeat => Qos { publishers: 16, buffer: PROCESS_QUEUE, borrowed: 4, ..stream },
        // In lock-step each scan is granted by one: a recorder takes them a few scans later.
        Topic::Directive => Qos { publishers: 2, buffer: PROCESS_QUEUE, borrowed: 2, history: 1, ..stream },
        // Recorders alone read them. A process publishes more than one for a scan where it has waited.
        Topic::Journal => {
            Qos { publishers: 16, subscribers: 8, buffer: buffer.max(32), borrowed: 4, history: 0 }
        }
        // Recorders alone read them.
        Topic::Clock => Qos { subscribers: 8, borrowed: 4, ..stream },
        Topic::Checkpoint => Qos { publishers: 16, subscribers: 12, buffer: 4, borrowed: 2, history: 1 },
    }
}

#[cfg(test)]
mod tests {
    use shared_types::Role;

    use super::*;

    #[test]
    fn an_observer_queues_one_second_or_four_megabytes_of_all_readers_and_at_least_sixteen() {
        let (ten_hz, hundred_hz, kilohertz) = (100_000_000, 10_000_000, 1_000_000);
        // A second has ten samples, which is less than a process queues.
        assert_eq!(observer_queue(8528, ten_hz), 16);
        assert_eq!(observer_queue(352, hundred_hz), 100);
        // 4,000,000 / (24 x 352) = 473.48 and 4,000,000 / (24 x 8528) = 19.54.
        assert_eq!(observer_queue(352, kilohertz), 473);
        assert_eq!(observer_queue(8528, kilohertz), 19);
        assert_eq!(observer_queue(4_000_000, kilohertz), 16);
        assert_eq!(observer_queue(0, 0), 4_000_000 / 24, "nothing is divided by zero");
    }

    #[test]
    fn every_topic_of_the_loop_has_room_for_24_readers_and_processes_queue_sixteen_at_any_rate() {
        for topic in Role::ALL.iter().flat_map(|role| role.writes()) {
            for period_ns in [1_000_000, 100_000_000] {
                let qos = qos(*topic, period_ns);
                assert_eq!((qos.subscribers, qos.of_a_process()), (24, 16), "{topic}");
            }
        }
    }
}
