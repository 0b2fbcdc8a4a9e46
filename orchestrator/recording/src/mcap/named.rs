//! The chunks that the summaries of a file name, and which of them were read.

use super::Damage;
use super::fields::Fields;

/// Chunks of one file and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Named {
    file: usize,
    times_ns: [u64; 2],
    /// Where the first of them begins, as the summary says.
    at: u64,
    /// How many were not read yet.
    left: u32,
}

/// Chunks that follow each other and were not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Unread {
    pub(super) at: u64,
    /// First and last log time [ns].
    pub(super) times_ns: [u64; 2],
}

/// Chunks by file and time.
#[derive(Debug, Default)]
pub(super) struct NamedChunks(Vec<Named>);

impl NamedChunks {
    /// Memory of one [bytes].
    pub(super) const BYTES: u64 = size_of::<Named>() as u64;

    /// Adds a chunk from the fields of its record in the summary of a file that begins at a byte.
    pub(super) fn add(&mut self, file: usize, begin: u64, body: &[u8]) -> Result<(), Damage> {
        let mut fields = Fields(body);
        let (times_ns, at) = ([fields.u64()?, fields.u64()?], fields.u64()?);
        self.0.push(Named { file, times_ns, at: begin.saturating_add(at), left: 1 });
        Ok(())
    }

    /// Forgets those of a file whose summary is damaged.
    pub(super) fn forget(&mut self, file: usize) {
        self.0.retain(|named| named.file != file);
    }

    /// All were added.
    pub(super) fn sort(&mut self) {
        self.0.sort_unstable();
        self.0.dedup_by(|next, first| {
            let is_same = (next.file, next.times_ns) == (first.file, first.times_ns);
            first.left += u32::from(is_same);
            is_same
        });
    }

    /// Takes note that a chunk was read; false if the summary names no further one of its time.
    pub(super) fn read(&mut self, file: usize, times_ns: [u64; 2]) -> bool {
        let found = self.0.binary_search_by_key(&(file, times_ns), |named| (named.file, named.times_ns));
        let Some(named) = found.ok().map(|place| &mut self.0[place]).filter(|named| named.left > 0) else {
            return false;
        };
        named.left -= 1;
        true
    }

    /// Those of a file.
    fn of(&self, file: usize) -> &[Named] {
        let begin = self.0.partition_point(|named| named.file < file);
        let end = self.0.partition_point(|named| named.file <= file);
        &self.0[begin..end]
    }

    /// Whether the summary of a file names chunks.
    pub(super) fn has(&self, file: usize) -> bool {
        !self.of(file).is_empty()
    }

    /// Those of a file that were not read, as one where none that was read lies between.
    pub(super) fn unread(&self, file: usize) -> Vec<Unread> {
        // Chunks of definitions alone have no time.
        let named = self.of(file).iter().filter(|named| named.times_ns != [0; 2]);
        let mut unread: Vec<Unread> = Vec::new();
        let mut is_next = false;
        for Named { times_ns, at, left, .. } in named.copied() {
            match unread.last_mut().filter(|_| is_next && left > 0) {
                Some(last) => last.times_ns[1] = last.times_ns[1].max(times_ns[1]),
                None if left > 0 => unread.push(Unread { at, times_ns }),
                None => {}
            }
            is_next = left > 0;
        }
        unread
    }
}
