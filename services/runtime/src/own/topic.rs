//! A topic of your own, opened by its name.

use std::marker::PhantomData;
use std::ops::Deref;
use std::rc::Rc;

use bytemuck::Pod;
use shared_types::{Described, Header, LayoutRow};

use super::member::Member;
use super::reader::OwnReader;
use super::table::TopicRow;
use super::writer::OwnWriter;
use crate::enclosed::Enclosed;
use crate::port::Received;
use crate::{Bus, RuntimeError};

/// A sample in shared memory, read in place and returned to its writer when dropped.
pub struct OwnTaken<S>(TakenBytes, PhantomData<S>);

impl<S: Pod> Deref for OwnTaken<S> {
    type Target = S;

    fn deref(&self) -> &S {
        bytemuck::from_bytes(&self.0)
    }
}

/// The bytes of such a sample.
pub struct TakenBytes(Enclosed<Received>);

impl TakenBytes {
    /// The header of the sample.
    pub(crate) fn header(&self) -> &Header {
        bytemuck::from_bytes(&self[..size_of::<Header>()])
    }
}

impl Deref for TakenBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

/// A topic of your own: whether this process reads or writes it stands in the system file.
pub struct NamedTopic<S>(ByteTopic, PhantomData<S>);

/// [`NamedTopic`] of samples whose type another language has.
#[derive(Clone)]
pub struct ByteTopic {
    port: Port,
    name: Rc<str>,
    size: usize,
}

#[derive(Clone)]
enum Port {
    Reads(Rc<Enclosed<Rc<OwnReader>>>),
    Writes(Rc<Enclosed<Rc<OwnWriter>>>),
}

impl<S: Pod + Described> NamedTopic<S> {
    /// Opens the topic as its process reads or writes it.
    pub(crate) fn open(
        bus: &Bus,
        member: &Rc<Member>,
        name: &str,
    ) -> Result<(Self, ByteTopic), RuntimeError> {
        let topic = ByteTopic::open(bus, member, name, &|row| member.verify::<S>(row).map(|_| ()))?;
        Ok((Self(topic.clone(), PhantomData), topic))
    }

    /// The oldest sample that was not taken yet.
    ///
    /// # Errors
    /// Errors of the bus, and [`RuntimeError::WrongEnd`] when this process writes the topic.
    pub fn take(&self) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.0.take()?.map(OwnTaken::of))
    }

    /// The newest sample that was not taken; older ones are dropped.
    ///
    /// In real time it waits for nothing. In lock-step it waits until the writer is done with `scan_id`, and leaves
    /// samples of later scans: so the result does not depend on the order of arrival.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn newest(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.0.newest(scan_id)?.map(OwnTaken::of))
    }

    /// The oldest sample that was not taken, of a scan up to `scan_id`: call it until there is none. It waits as
    /// [`NamedTopic::newest`] does, and takes samples of all scans in real time.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn up_to(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.0.up_to(scan_id)?.map(OwnTaken::of))
    }

    /// The sample of one scan; samples before it are dropped. It waits as [`NamedTopic::newest`] does.
    ///
    /// # Errors
    /// As [`NamedTopic::take`].
    pub fn by_scan(&self, scan_id: u64) -> Result<Option<OwnTaken<S>>, RuntimeError> {
        Ok(self.0.by_scan(scan_id)?.map(OwnTaken::of))
    }

    /// Completes layout, incarnation, sequence and stamps of `sample`, publishes it, and wakes the readers.
    ///
    /// # Errors
    /// Errors of the bus, and [`RuntimeError::WrongEnd`] when this process reads the topic.
    pub fn publish(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.0.publish(bytemuck::bytes_of_mut(sample))
    }

    /// [`NamedTopic::publish`] of a sample that `fill` writes in place: for large samples. Fields that `fill` leaves
    /// alone hold the bytes of an older sample.
    ///
    /// # Errors
    /// As [`NamedTopic::publish`].
    pub fn publish_in_place(&self, fill: impl FnOnce(&mut S)) -> Result<(), RuntimeError> {
        let mut fill = Some(fill);
        self.0.writer()?.publish_in_place(&mut |place| {
            if let Some(fill) = fill.take() {
                fill(bytemuck::from_bytes_mut(place));
            }
        })
    }
}

impl ByteTopic {
    pub(super) fn open(
        bus: &Bus,
        member: &Rc<Member>,
        name: &str,
        verify: &dyn Fn(&TopicRow) -> Result<(), RuntimeError>,
    ) -> Result<Self, RuntimeError> {
        let (row, reads) = member.use_of(name)?;
        verify(&row)?;
        let (_, shape) = row.shape()?;
        let port = match reads {
            true => Port::Reads(Rc::new(Enclosed::new(OwnReader::new(bus, member, row)?))),
            false => Port::Writes(Rc::new(Enclosed::new(OwnWriter::new(bus, member, &row)?))),
        };
        Ok(Self { port, name: name.into(), size: shape.size })
    }

    /// Opens the topic with the fields `mine`, as another language lays them out.
    pub(crate) fn open_rows(
        bus: &Bus,
        member: &Rc<Member>,
        name: &str,
        mine: &[LayoutRow],
    ) -> Result<Self, RuntimeError> {
        let named = |row: &LayoutRow| LayoutRow { topic: name.to_owned(), ..row.clone() };
        Self::open(bus, member, name, &|row| member.verify_rows(row, mine.iter().map(named).collect()))
    }

    /// Name of the topic.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Size of a sample [bytes].
    pub fn size(&self) -> usize {
        self.size
    }

    /// As [`NamedTopic::take`].
    ///
    /// # Errors
    /// As there.
    pub fn take(&self) -> Result<Option<TakenBytes>, RuntimeError> {
        Ok(self.reader()?.take()?.map(TakenBytes))
    }

    /// As [`NamedTopic::newest`].
    ///
    /// # Errors
    /// As there.
    pub fn newest(&self, scan_id: u64) -> Result<Option<TakenBytes>, RuntimeError> {
        Ok(self.reader()?.newest(scan_id)?.map(TakenBytes))
    }

    /// As [`NamedTopic::up_to`].
    ///
    /// # Errors
    /// As there.
    pub fn up_to(&self, scan_id: u64) -> Result<Option<TakenBytes>, RuntimeError> {
        Ok(self.reader()?.up_to(scan_id)?.map(TakenBytes))
    }

    /// As [`NamedTopic::by_scan`].
    ///
    /// # Errors
    /// As there.
    pub fn by_scan(&self, scan_id: u64) -> Result<Option<TakenBytes>, RuntimeError> {
        Ok(self.reader()?.by_scan(scan_id)?.map(TakenBytes))
    }

    /// As [`NamedTopic::publish`], for [`ByteTopic::size`] bytes that are aligned as a header is.
    ///
    /// # Errors
    /// As there.
    pub fn publish(&self, sample: &mut [u8]) -> Result<(), RuntimeError> {
        self.writer()?.publish(sample)
    }

    /// Makes this end of all connections; one that fails is made with the next sample.
    pub(crate) fn connect(&self) {
        match &self.port {
            Port::Reads(reader) => _ = reader.poll(),
            Port::Writes(writer) => writer.connect(),
        }
    }

    /// The reading end; `None` when this process writes the topic.
    pub(super) fn reading(&self) -> Option<&OwnReader> {
        match &self.port {
            Port::Reads(reader) => Some(reader),
            Port::Writes(_) => None,
        }
    }

    fn reader(&self) -> Result<&OwnReader, RuntimeError> {
        self.reading().ok_or_else(|| RuntimeError::WrongEnd { topic: self.name.to_string(), verb: "written" })
    }

    fn writer(&self) -> Result<&OwnWriter, RuntimeError> {
        match &self.port {
            Port::Writes(writer) => Ok(writer),
            Port::Reads(_) => Err(RuntimeError::WrongEnd { topic: self.name.to_string(), verb: "read" }),
        }
    }
}

impl<S> OwnTaken<S> {
    fn of(sample: TakenBytes) -> Self {
        Self(sample, PhantomData)
    }
}
