//! The reading end of a topic: it delivers only valid samples of the process in charge.

mod reader;

use std::marker::PhantomData;
use std::ops::Deref;
use std::rc::Rc;

use shared_types::Sample;

use crate::enclosed::Enclosed;
use crate::port::Received;
use crate::shared::Shared;
use crate::view::view;
use crate::{Bus, RuntimeError};

pub(crate) use self::reader::{Reader, join as join_readers};

/// A sample in shared memory, read in place and returned to its producer when dropped.
pub struct Taken<S: Sample>(Enclosed<Received>, PhantomData<S>);

impl<S: Sample> Taken<S> {
    /// A sample from a reader of `S`.
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
/// Dropped are samples of another layout, with bad content, from a process without authority, repeated, reordered or
/// too old (actuations are too old for the robot only). Each kind is counted, and the counters travel in the
/// heartbeat.
///
/// During a swap, the newest samples of the process that does not count are kept aside. When the directive gives it
/// their scans again, they are delivered as if they had just arrived. A scan answered by one of the two processes is
/// not answered by the other.
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

    /// The newest sample; older ones are dropped and counted as replaced.
    pub fn take_newest(&self) -> Option<Taken<S>> {
        self.0.take_newest().map(Taken::of)
    }
}

/// Takes a pair of samples that belong to one scan; older ones are dropped and counted as replaced.
///
/// After a delay several pairs may wait. It gives the oldest pair that can be answered in time if the process can
/// catch up: it answers faster than scans come, and all that wait within a third of the age at which inputs are
/// refused. Then no scan stays without an answer. Otherwise it gives the newest pair. The last two answers decide:
/// the quicker gives the speed of the process, the slower the time that an answer may take.
///
/// Call it until it returns `None`: [`crate::Process::wait`] does not return for samples that came before.
pub fn join<A: Sample, B: Sample>(one: &Input<A>, other: &Input<B>) -> Option<(Taken<A>, Taken<B>)> {
    let (first, second) = reader::join(&one.0, &other.0)?;
    Some((Taken::of(first), Taken::of(second)))
}
