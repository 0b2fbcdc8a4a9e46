//! What the ports of companions, and those of roles on topics of your own, have counted: a table in shared memory.
//!
//! A process takes a free cell for each of its ports and writes to it alone. The orchestrator reads all cells for the
//! ledger, and frees those of processes that have ended. When all cells are taken, a port is not counted; nothing else
//! changes.
#![expect(unsafe_code, reason = "shared memory is mapped from a file")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

use shared_types::{Fate, Header, InputAccount};

use super::page::{create_file, open_file};
use crate::shared_memory::Mapped;
use crate::{Domain, RuntimeError, monotonic_ns};

/// Ports that are counted at a time, at most.
pub(crate) const MAX_PORTS: usize = 512;
/// Name of the file in the directory of the bus, with the version of its layout.
const FILE: &str = "ports.v1";
/// Words of an account.
const WORDS: usize = size_of::<InputAccount>() / size_of::<u64>();
/// A reader gives up to read a cell that is being written all the time after so many attempts.
const MAX_READS: usize = 100;

/// One port; zero while it is free.
#[repr(C, align(64))]
struct Cell {
    incarnation: AtomicU32,
    /// Odd while it is being written.
    version: AtomicU32,
    topic: AtomicU32,
    /// 1 for a reader, 2 for a writer.
    end: AtomicU32,
    process: AtomicU32,
    pid: AtomicU32,
    opened_ns: AtomicU64,
    /// When a reader polled, or a writer published, last.
    active_ns: AtomicU64,
    delays: [AtomicU64; 3],
    account: [AtomicU64; WORDS],
}

#[repr(C)]
struct Table {
    cells: [Cell; MAX_PORTS],
}

const _: () = assert!(size_of::<Cell>() == 384 && WORDS == 36 && std::mem::offset_of!(Cell, account) == 64);

/// The ports of one system.
#[derive(Debug, Clone)]
pub struct PortTable(Arc<Mapped<Table>>);

/// Times of the samples of one port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delays {
    /// How many were measured.
    pub count: u64,
    /// Their sum [ns].
    pub sum_ns: u64,
    /// The longest [ns].
    pub max_ns: u64,
}

/// What one port has counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PortCount {
    /// Incarnation of its process.
    pub incarnation: u32,
    /// The process, by [`crate::OwnTopics::process_name`].
    pub process: u32,
    /// Its process id.
    pub pid: u32,
    /// The topic, by [`crate::OwnTopics::topic_name`].
    pub topic: u32,
    /// Whether it writes the topic; otherwise it reads it.
    pub writes: bool,
    /// When it was opened [ns].
    pub opened_ns: u64,
    /// When a reader polled, or a writer published, last [ns].
    pub active_ns: u64,
    /// At a reader from the publication of a sample until it was taken; at a writer from the publication of the scan
    /// until that of the sample. In real time only.
    pub delays: Delays,
    /// What became of the samples at a reader. At a writer `arrived` is the newest sequence number.
    pub account: InputAccount,
}

impl PortTable {
    /// Creates the table of a system, or opens the one that another orchestrator left.
    ///
    /// # Errors
    /// [`RuntimeError::File`] and [`RuntimeError::SharedMemory`].
    pub fn create(domain: &Domain) -> Result<Self, RuntimeError> {
        // SAFETY: atomics only, and the file is as large as the table.
        unsafe { create_file(domain, FILE) }.map(|table| Self(Arc::new(table)))
    }

    /// Opens the table of a running system.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn open(domain: &Domain) -> Result<Self, RuntimeError> {
        // SAFETY: as above.
        unsafe { open_file(domain, FILE) }.map(|table| Self(Arc::new(table)))
    }

    /// What all ports have counted.
    pub fn counts(&self) -> Vec<PortCount> {
        self.0.cells.iter().filter_map(Cell::read).collect()
    }

    /// Frees the cells of processes that have ended.
    pub fn free(&self, has_ended: impl Fn(&PortCount) -> bool) {
        for cell in &self.0.cells {
            if let Some(count) = cell.read().filter(&has_ended) {
                cell.end.store(0, Ordering::SeqCst);
                let _ = cell.incarnation.compare_exchange(
                    count.incarnation,
                    0,
                    Ordering::SeqCst,
                    Ordering::SeqCst,
                );
            }
        }
    }

    fn take(&self, incarnation: u32) -> Option<usize> {
        let free = |cell: &Cell| {
            cell.incarnation.compare_exchange(0, incarnation, Ordering::SeqCst, Ordering::SeqCst).is_ok()
        };
        self.0.cells.iter().position(free)
    }
}

impl Cell {
    /// A consistent copy, or the last attempt of one whose process died while it wrote; `None` while it is free.
    fn read(&self) -> Option<PortCount> {
        let read = |number: &AtomicU64| number.load(Ordering::Relaxed);
        for attempt in 1..=MAX_READS {
            let version = self.version.load(Ordering::Acquire);
            let (incarnation, end) =
                (self.incarnation.load(Ordering::Relaxed), self.end.load(Ordering::Acquire));
            if incarnation == 0 || end == 0 {
                return None;
            }
            let [count, sum_ns, max_ns] = [0, 1, 2].map(|index| read(&self.delays[index]));
            let mut words = [0; WORDS];
            words.iter_mut().zip(&self.account).for_each(|(word, number)| *word = read(number));
            let copy = PortCount {
                incarnation,
                process: self.process.load(Ordering::Relaxed),
                pid: self.pid.load(Ordering::Relaxed),
                topic: self.topic.load(Ordering::Relaxed),
                writes: end == 2,
                opened_ns: read(&self.opened_ns),
                active_ns: read(&self.active_ns),
                delays: Delays { count, sum_ns, max_ns },
                account: bytemuck::cast(words),
            };
            fence(Ordering::Acquire);
            let is_whole = version.is_multiple_of(2) && self.version.load(Ordering::Relaxed) == version;
            if is_whole || attempt == MAX_READS {
                return Some(copy);
            }
            std::hint::spin_loop();
        }
        None
    }
}

/// The counts of one port, in its process.
pub(super) struct Port {
    table: PortTable,
    /// `None` when the table is full.
    cell: Option<usize>,
    pub(super) account: InputAccount,
    pub(super) delays: Delays,
}

impl Port {
    pub(super) fn open(table: &PortTable, incarnation: u32, process: u32, topic: u32, writes: bool) -> Self {
        let cell = table.take(incarnation);
        if let Some(cell) = cell.map(|cell| &table.0.cells[cell]) {
            cell.version.store(0, Ordering::SeqCst);
            cell.topic.store(topic, Ordering::SeqCst);
            cell.process.store(process, Ordering::SeqCst);
            cell.pid.store(std::process::id(), Ordering::SeqCst);
            cell.opened_ns.store(monotonic_ns(), Ordering::SeqCst);
            cell.active_ns.store(0, Ordering::SeqCst);
            cell.delays.iter().chain(&cell.account).for_each(|number| number.store(0, Ordering::SeqCst));
            // A cell without an end is not read.
            cell.end.store(if writes { 2 } else { 1 }, Ordering::SeqCst);
        }
        Self { table: table.clone(), cell, account: InputAccount::default(), delays: Delays::default() }
    }

    /// Counts a sample that has a fate.
    pub(super) fn settle(&mut self, fate: Fate, header: &Header) {
        self.account.settle(fate, header);
    }

    /// A sample was taken, or published, so long after what the delay is counted from; a stamp that lies ahead, or is
    /// missing, is not counted.
    pub(super) fn delayed(&mut self, since_ns: u64, now_ns: u64) {
        if let Some(delay_ns) = now_ns.checked_sub(since_ns).filter(|_| since_ns > 0) {
            let Delays { count, sum_ns, max_ns } = self.delays;
            self.delays = Delays {
                count: count + 1,
                sum_ns: sum_ns.wrapping_add(delay_ns),
                max_ns: max_ns.max(delay_ns),
            };
        }
    }

    /// Shows the counts in the table; `waiting` are the samples that wait in the process.
    pub(super) fn show<'a>(&mut self, waiting: impl Iterator<Item = &'a Header>) {
        let Some(cell) = self.cell.map(|cell| &self.table.0.cells[cell]) else { return };
        (self.account.waiting, self.account.waiting_sum) =
            waiting.fold((0, 0), |(count, sum), header| (count + 1, u64::wrapping_add(sum, header.sequence)));
        let version = cell.version.load(Ordering::Relaxed);
        cell.version.store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        cell.active_ns.store(monotonic_ns(), Ordering::Relaxed);
        let Delays { count, sum_ns, max_ns } = self.delays;
        let words: [u64; WORDS] = bytemuck::cast(self.account);
        let places = cell.delays.iter().chain(&cell.account);
        for (place, word) in places.zip([count, sum_ns, max_ns].into_iter().chain(words)) {
            place.store(word, Ordering::Relaxed);
        }
        cell.version.store(version.wrapping_add(2), Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_of_a_port_are_read_until_its_process_has_ended_and_a_full_table_counts_no_more() {
        let domain = Domain::create(&format!("pt{}", std::process::id())).unwrap();
        let bus = crate::Bus::create(&domain, 100_000_000).unwrap();
        let (table, other) = (PortTable::create(&domain).unwrap(), PortTable::open(&domain).unwrap());
        assert_eq!(other.counts(), []);
        let mut port = Port::open(&table, 7, 3, 2, false);
        let header = |sequence| Header { incarnation: 9, sequence, ..Header::default() };
        for sequence in [1, 2, 4] {
            assert_eq!(port.account.arrive(&header(sequence)), None);
        }
        port.settle(Fate::Used, &header(1));
        port.delayed(100, 350);
        port.delayed(100, 150);
        port.delayed(200, 150);
        port.show([header(2), header(4)].iter());
        let [count] = other.counts().try_into().unwrap();
        assert_eq!((count.incarnation, count.process, count.topic, count.writes), (7, 3, 2, false));
        assert_eq!(count.delays, Delays { count: 2, sum_ns: 300, max_ns: 250 });
        let account = &count.account;
        assert_eq!((account.arrived, account.used, account.missing, account.waiting), (3, 1, 1, 2));
        assert_eq!((account.open_sum, account.waiting_sum), (6, 6));
        let ports: Vec<Port> =
            (0..MAX_PORTS as u32).map(|index| Port::open(&table, 8, index, 0, true)).collect();
        assert_eq!(ports.iter().filter(|port| port.cell.is_none()).count(), 1);
        other.free(|count| count.incarnation == 8);
        assert_eq!(other.counts().len(), 1);
        assert!(Port::open(&table, 8, 0, 0, true).cell.is_some(), "freed cells are taken again");
        drop(bus);
        domain.remove().unwrap();
    }
}
