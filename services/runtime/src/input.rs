//! The reading end of a topic: only valid samples of the producer in charge come out of it.

mod reader;

use std::marker::PhantomData;
use std::ops::Deref;
use std::rc::Rc;

use shared_types::{Fault, Sample};

use crate::enclosed::Enclosed;
use crate::port::Received;
use crate::shared::Shared;
use crate::view::view;
use crate::{Bus, RuntimeError};

pub use self::reader::KEPT;
pub(crate) use self::reader::Reader;

/// A sample in shared memory, read in place and returned to its producer when dropped.
pub struct Taken<S: Sample>(Enclosed<Received>, PhantomData<S>);

impl<S: Sample> Taken<S> {
    /// A sample that a reader of `S` has given.
    fn of(sample: Enclosed<Received>) -> Self {
        Self(sample, PhantomData)
    }
}

impl<S: Sample> Deref for Taken<S> {
    type Target = S;

    #[inline(always)]
    fn deref(&self) -> &S {
        view(&self.0)
    }
}

/// Reads samples of one type.
///
/// What never comes out: a sample of another layout or with bad content, of a producer without authority, a
/// duplicate, a reordered one, one that is too old (actuations are never too old for other roles than the robot). Each is counted by its kind in the account of the input,
/// which travels in the heartbeat.
///
/// While one process takes over from another, the newest samples of the one that does not count are kept aside.
/// When the directive gives their scans back to it they come out as if they had just arrived; and no scan that
/// was answered by one of the two is answered by the other again.
pub struct Input<S: Sample>(Enclosed<Rc<Reader>>, PhantomData<S>);

impl<S: Sample> Input<S> {
    /// The input of a reader of `S`.
    pub(crate) fn of(reader: Enclosed<Rc<Reader>>) -> Self {
        Self(reader, PhantomData)
    }

    /// The input of a process, or of a test of one.
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        Ok(Self::of(Enclosed::new(Rc::new(Reader::new(bus, shared, S::TYPE)?))))
    }

    /// The reader of this input.
    pub(crate) fn reader(&self) -> &Reader {
        &self.0
    }

    /// The oldest sample not yet taken.
    #[inline(always)]
    pub fn take(&self) -> Option<Taken<S>> {
        self.0.take().map(Taken::of)
    }

    /// The scan of the oldest sample not yet taken.
    pub fn next_scan(&self) -> Option<u64> {
        self.0.next_scan()
    }

    /// Drops what is kept of scans up to `scan_id`, counted as replaced: a state that was taken up contains them.
    pub fn skip_to(&self, scan_id: u64) {
        self.0.skip_to(scan_id);
    }

    /// Drops what is kept and `is_old`, counted as replaced.
    pub fn skip(&self, is_old: impl Fn(&S) -> bool) {
        self.0.skip(&|sample| is_old(view(sample)));
    }

    /// The newest sample; older ones are dropped and counted as replaced.
    pub fn take_newest(&self) -> Option<Taken<S>> {
        self.0.take_newest().map(Taken::of)
    }

    /// Notes that the process refuses a sample that it has taken: in its log, and in its next heartbeat.
    pub fn refuse(&self, sample: &S, fault: &Fault) {
        self.0.refuse(sample.header(), fault);
    }

    /// How many samples of the writer in charge were dropped for their content.
    pub fn dropped(&self) -> u64 {
        self.0.dropped()
    }
}

/// Takes a pair of samples that belong to one scan; older ones are dropped and counted as replaced.
///
/// A process that was held up has several pairs. As long as it answers faster than scans come, and all that wait in a
/// third of the age at which inputs are refused, it is given the oldest that is not too old by the time it is answered,
/// and no scan stays without an answer; otherwise the newest. Its last two answers tell: the quicker how fast it is, the
/// slower how long an answer may take. To be called until there is none: [`crate::Process::wait`] does not return for
/// what has come before.
pub fn join<A: Sample, B: Sample>(one: &Input<A>, other: &Input<B>) -> Option<(Taken<A>, Taken<B>)> {
    let (first, second) = reader::join(&one.0, &other.0)?;
    Some((Taken::of(first), Taken::of(second)))
}
