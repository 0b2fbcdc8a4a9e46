//! Damaged places of a file, and the times of which messages may be missing there.

use super::Damage;
use super::named::Unread;

/// The time that a chunk covers is believed up to this [ns].
const MAX_CHUNK_NS: u64 = 3_600_000_000_000;

/// A place of a damaged file, and the time of which messages may be missing there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// Which of the joined files it is in.
    pub file: usize,
    /// Where it begins in the file.
    pub at: u64,
    /// What is wrong there.
    pub what: Damage,
    /// Whether messages may be missing; behind the end of the data is nothing but the summary.
    pub is_data: bool,
    /// Log time of the last message before it [ns]; `None` at the start of a file.
    pub from_ns: Option<u64>,
    /// Log time of the first message behind it, or what the file tells about its end [ns].
    pub to_ns: Option<u64>,
}

/// What was counted of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counted {
    /// Messages that are missing by what the summary counts.
    pub(super) missing: u64,
    /// Whether there are more or fewer than it counts.
    pub(super) differs: bool,
    /// First and last log time by the summary [ns].
    pub(super) times_ns: [u64; 2],
}

/// The gaps of a file that is being read.
#[derive(Debug, Default)]
pub(super) struct Gaps {
    found: Vec<Gap>,
    /// The first one of the file that is read.
    first: usize,
    /// The gap whose end is not known yet.
    open: Option<Gap>,
    /// Whether the last place of that gap may reach to the end of the file.
    is_endless: bool,
    /// The oldest and the newest message of the file that is read [ns].
    times_ns: Option<[u64; 2]>,
}

impl Gaps {
    /// Those that were passed until now.
    pub(super) fn found(&self) -> &[Gap] {
        &self.found
    }

    /// Notes a damaged place behind the newest message; `until_ns` is up to when messages were there, if that is known.
    pub(super) fn note(&mut self, file: usize, at: u64, what: Damage, is_data: bool, until_ns: Option<u64>) {
        let from_ns = self.times_ns.map(|[_, newest_ns]| newest_ns);
        self.is_endless = is_data && until_ns.is_none();
        match &mut self.open {
            Some(gap) => {
                gap.to_ns = gap.to_ns.max(until_ns);
                gap.is_data |= is_data;
            }
            None => self.open = Some(Gap { file, at, what, is_data, from_ns, to_ns: until_ns }),
        }
    }

    /// Messages of these times follow [ns]; `start_ns` is that of the first message of the file, if it is known.
    pub(super) fn end_at(&mut self, [first_ns, last_ns]: [u64; 2], start_ns: Option<u64>) {
        if let Some(gap) = self.open.take() {
            let from_ns = gap.from_ns.or(start_ns);
            // A chunk also holds some messages that are older than it, such as states and log lines.
            let claimed_ns = gap.to_ns.filter(|to_ns| *to_ns <= last_ns);
            let to_ns = claimed_ns.max(Some(first_ns)).max(from_ns);
            self.found.push(Gap { from_ns, to_ns, ..gap });
        }
        let [oldest_ns, newest_ns] = self.times_ns.unwrap_or([first_ns, last_ns]);
        self.times_ns = Some([oldest_ns.min(first_ns), newest_ns.max(last_ns)]);
    }

    /// No further message of a file is read. `counted` is what its summary counts, `unread` the chunks that it names but were
    /// not there, and `at` the place of its last part.
    pub(super) fn end_file(&mut self, file: usize, at: u64, counted: Option<Counted>, unread: &[Unread]) {
        if let Some(gap) = self.open.take() {
            // A time that lies far ahead is damaged itself.
            let latest_ns = gap.from_ns.map(|from_ns| from_ns.saturating_add(MAX_CHUNK_NS));
            let claimed_ns = gap.to_ns.filter(|to_ns| !self.is_endless && Some(*to_ns) <= latest_ns);
            let end_ns = counted.map(|counted| counted.times_ns[1]);
            let to_ns = claimed_ns.max(end_ns).filter(|to_ns| Some(*to_ns) >= gap.from_ns);
            self.found.push(Gap { to_ns, ..gap });
        }
        if let Some(counted) = counted {
            self.add_counted(file, at, &counted, unread);
            // All messages are there, whatever the damaged places have held.
            let is_data = counted.missing > 0;
            self.found[self.first..].iter_mut().for_each(|gap| gap.is_data &= is_data);
        }
        self.first = self.found.len();
        self.times_ns = None;
    }

    /// Adds what only the summary tells: chunks, or messages, that are not where anything is damaged.
    fn add_counted(&mut self, file: usize, at: u64, counted: &Counted, unread: &[Unread]) {
        let is_data = counted.missing > 0;
        for Unread { at, times_ns: [from_ns, to_ns] } in unread.iter().filter(|_| is_data).copied() {
            let is_known = self.found[self.first..].iter().any(|gap| {
                gap.is_data
                    && gap.from_ns.is_none_or(|from_ns| from_ns <= to_ns)
                    && gap.to_ns.is_none_or(|gap_ns| gap_ns >= from_ns)
            });
            if !is_known {
                let (what, from_ns, to_ns) = (Damage::Missing, Some(from_ns), Some(to_ns));
                self.found.push(Gap { file, at, what, is_data, from_ns, to_ns });
            }
        }
        if counted.differs && self.found.len() == self.first {
            let [start_ns, end_ns] = counted.times_ns;
            let [from_ns, to_ns] = match self.times_ns {
                Some([_, newest_ns]) if newest_ns < end_ns => [Some(newest_ns), Some(end_ns)],
                Some([oldest_ns, _]) if oldest_ns > start_ns => [Some(start_ns), Some(oldest_ns)],
                _ => [None; 2],
            };
            self.found.push(Gap { file, at, what: Damage::Count, is_data, from_ns, to_ns });
        }
    }
}
