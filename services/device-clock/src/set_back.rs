//! A clock that was set back by so little that its samples look as if they had been overtaken.

/// Samples of a clock that was set back are late by more than this [ns].
const LATE_NS: i64 = 100_000_000;
/// All samples of this time are late by the same before that is assumed [ns].
const SUSPECTED_NS: u64 = 500_000_000;

/// Samples in a row that are late, since one whose stamp went back. A network delays each by another time.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SetBack {
    run: Option<Run>,
}

#[derive(Debug, Clone, Copy)]
struct Run {
    since_ns: u64,
    /// Smallest and largest arrival minus stamp [ns].
    least_ns: i64,
    most_ns: i64,
}

impl SetBack {
    /// Takes the next sample: arrival minus stamp, and by how much that is more than usual. Whether all since one that went
    /// back are late by the same time, to `spread_ns`.
    pub(crate) fn decides(
        &mut self,
        [offset_ns, excess_ns]: [i64; 2],
        arrived_ns: u64,
        went_back: bool,
        spread_ns: i64,
    ) -> bool {
        let new = went_back.then_some(Run { since_ns: arrived_ns, least_ns: offset_ns, most_ns: offset_ns });
        let longer = self.run.map(|run| Run {
            least_ns: run.least_ns.min(offset_ns),
            most_ns: run.most_ns.max(offset_ns),
            ..run
        });
        let is_one = |run: &Run| run.most_ns.saturating_sub(run.least_ns) <= spread_ns;
        self.run = longer.filter(is_one).or(new).filter(|_| excess_ns > LATE_NS);
        let is_over = self.run.is_some_and(|run| arrived_ns.saturating_sub(run.since_ns) >= SUSPECTED_NS);
        if is_over {
            self.run = None;
        }
        is_over
    }
}
