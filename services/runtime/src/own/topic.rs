//! A topic of your own, opened by its name.

use std::marker::PhantomData;
use std::ops::Deref;
use std::rc::Rc;

use bytemuck::Pod;
use shared_types::Described;

use super::member::Member;
use super::reader::OwnReader;
use super::writer::OwnWriter;
use crate::enclosed::Enclosed;
use crate::port::Received;
use crate::{Bus, RuntimeError};

/// A sample in shared memory, read in place and returned to its writer when dropped.
pub struct OwnTaken<S>(Enclosed<Received>, PhantomData<S>);

impl<S: Pod> Deref for OwnTaken<S> {
    type Target = S;

    fn deref(&self) -> &S {
        bytemuck::from_bytes(&self.0)
    }
}

/// A topic of your own: whether this process reads or writes it stands in the system file.
pub struct NamedTopic<S> {
    port: Port,
    name: String,
    of: PhantomData<S>,
}

#[derive(Clone)]
pub(crate) enum Port {
    Reads(Enclosed2<OwnReader>),
    Writes(Enclosed2<OwnWriter>),
}

/// A shared port, whose destructor is compiled here.
pub(crate) type Enclosed2<T> = Rc<Enclosed<Rc<T>>>;

impl<S: Pod + Described> NamedTopic<S> {
    /// Opens the topic as its process reads or writes it.
    pub(crate) fn open(bus: &Bus, member: &Rc<Member>, name: &str) -> Result<(Self, Port), RuntimeError> {
        let (row, reads) = member.use_of(name)?;
        member.verify::<S>(&row)?;
        let port = Port::open(bus, member, &row, reads)?;
        Ok((Self { port: port.clone(), name: name.to_owned(), of: PhantomData }, port))
    }

    /// The oldest sample that was not taken yet.
    ///
    /// # Errors
    /// Errors of the bus, and [`RuntimeError::NoOwnTopic`] when this process writes the topic.
    pub fn take(&self) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.reader()?.take()?.map(OwnTaken::of))
    }

    /// The newest sample that was not taken; older ones are dropped.
    ///
    /// In real time it waits for nothing. In lock-step it waits until the writer is done with `scan_id`, and leaves
    /// samples of later scans: so the result does not depend on the order of arrival.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn newest(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.reader()?.newest(scan_id)?.map(OwnTaken::of))
    }

    /// The oldest sample that was not taken, of a scan up to `scan_id`: call it until there is none. It waits as
    /// [`NamedTopic::newest`] does, and takes samples of all scans in real time.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn up_to(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.reader()?.up_to(scan_id)?.map(OwnTaken::of))
    }

    /// The sample of one scan; samples before it are dropped. It waits as [`NamedTopic::newest`] does.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn by_scan(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.reader()?.by_scan(scan_id)?.map(OwnTaken::of))
    }

    /// Completes layout, incarnation, sequence and stamps of `sample`, publishes it, and wakes the readers.
    ///
    /// # Errors
    /// Errors of the bus, and [`RuntimeError::NoOwnTopic`] when this process reads the topic.
    pub fn publish(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.writer()?.publish(bytemuck::bytes_of_mut(sample))
    }

    /// [`NamedTopic::publish`] of a sample that `fill` writes in place: for large samples. Fields that `fill` leaves
    /// alone hold the bytes of an older sample.
    ///
    /// # Errors
    /// As [`NamedTopic::publish`].
    pub fn publish_in_place(&self, fill: impl FnOnce(&mut S)) -> Result<(), RuntimeError> {
        let mut fill = Some(fill);
        self.writer()?.publish_in_place(&mut |place| {
            if let Some(fill) = fill.take() {
                fill(bytemuck::from_bytes_mut(place));
            }
        })
    }

    fn reader(&self) -> Result<&OwnReader, RuntimeError> {
        match &self.port {
            Port::Reads(reader) => Ok(reader),
            Port::Writes(_) => Err(RuntimeError::WrongEnd { topic: self.name.clone(), verb: "written" }),
        }
    }

    fn writer(&self) -> Result<&OwnWriter, RuntimeError> {
        match &self.port {
            Port::Writes(writer) => Ok(writer),
            Port::Reads(_) => Err(RuntimeError::WrongEnd { topic: self.name.clone(), verb: "read" }),
        }
    }
}

impl<S> OwnTaken<S> {
    fn of(sample: Enclosed<Received>) -> Self {
        Self(sample, PhantomData)
    }
}

impl Port {
    fn open(
        bus: &Bus,
        member: &Rc<Member>,
        row: &super::table::TopicRow,
        reads: bool,
    ) -> Result<Self, RuntimeError> {
        Ok(match reads {
            true => Self::Reads(Rc::new(Enclosed::new(OwnReader::new(bus, member, row.clone())?))),
            false => Self::Writes(Rc::new(Enclosed::new(OwnWriter::new(bus, member, row)?))),
        })
    }

    /// Makes this end of all connections; one that fails is made with the next sample.
    pub(crate) fn connect(&self) {
        match self {
            Self::Reads(reader) => _ = reader.poll(),
            Self::Writes(writer) => writer.connect(),
        }
    }
}
