//! The writing end of a topic.

mod filter;
mod writer;

use std::marker::PhantomData;
use std::rc::Rc;

use bytemuck::bytes_of_mut;
use shared_types::Sample;

use crate::enclosed::Enclosed;
use crate::shared::Shared;
use crate::view::view_mut;
use crate::{Bus, RuntimeError};

pub(crate) use self::writer::{Connect, Writer, may_write};

/// Publishes samples of one type.
pub struct Output<S: Sample>(Enclosed<Rc<Writer>>, PhantomData<S>);

impl<S: Sample> Output<S> {
    /// The output of a writer of `S`.
    pub(crate) fn of(writer: Enclosed<Rc<Writer>>) -> Self {
        Self(writer, PhantomData)
    }

    /// The output of a process, or of a test of one.
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        Ok(Self::of(Enclosed::new(Rc::new(Writer::new(bus, shared, S::TYPE)?))))
    }

    /// The writer of this output.
    pub(crate) fn writer(&self) -> &Writer {
        &self.0
    }

    /// Completes the header of `sample` and publishes it to all readers, then wakes them.
    ///
    /// It fills layout, incarnation, sequence, and the stamps of this stage, in `sample` too.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses; a reader that was not reached is counted, not an error.
    #[inline(always)]
    pub fn publish(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.0.publish(bytes_of_mut(sample))
    }

    /// [`Output::publish`] without waking a reader: for samples whose readers poll.
    ///
    /// # Errors
    /// As [`Output::publish`].
    #[inline(always)]
    pub fn publish_silently(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.0.publish_silently(bytes_of_mut(sample))
    }

    /// [`Output::publish`] of a sample that `fill` writes in place: for samples too large to be copied.
    ///
    /// Fields that `fill` leaves alone hold the bytes of an older sample.
    ///
    /// # Errors
    /// As [`Output::publish`].
    #[inline(always)]
    pub fn publish_in_place(&self, fill: impl FnOnce(&mut S)) -> Result<(), RuntimeError> {
        let mut fill = Some(fill);
        self.0.publish_in_place(&mut |place| {
            if let Some(fill) = fill.take() {
                fill(view_mut(place));
            }
        })
    }

    /// The first step of [`Output::publish`]: fills the header, except for its last stamp. The sequence number of the
    /// sample is then used.
    #[inline(always)]
    pub fn complete(&self, sample: &mut S) {
        self.0.complete(bytes_of_mut(sample));
    }

    /// The second step of [`Output::publish`]: sends a completed sample to all readers.
    ///
    /// # Errors
    /// As [`Output::publish`].
    #[inline(always)]
    pub fn send(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.0.send(bytes_of_mut(sample))
    }

    /// The last step of [`Output::publish`]: wakes the readers, then takes the place of the next sample while no
    /// process waits for this one.
    #[inline(always)]
    pub fn wake(&self) {
        self.0.wake();
    }
}
