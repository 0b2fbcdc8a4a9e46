//! A companion of the bench: it takes all that it reads, and answers each sample of the first topic on all that it writes.

use bytemuck::{bytes_of, cast_slice_mut, pod_read_unaligned};
use runtime::{ByteTopic, Companion, LoopTopic, RuntimeError};
use shared_types::{Actuation, Command, Header, Obstacles, Odometry, Pose, Sample, Scan};

/// The name of the service.
pub(crate) const SERVICE: &str = "scale-companion";

/// The first topic that it reads.
enum First {
    Scan(LoopTopic<Scan>),
    Odometry(LoopTopic<Odometry>),
    Pose(LoopTopic<Pose>),
    Obstacles(LoopTopic<Obstacles>),
    Command(LoopTopic<Command>),
    Actuation(LoopTopic<Actuation>),
    Own(ByteTopic),
}

/// Runs until the system ends.
///
/// # Errors
/// Errors of the bus, and of a process that was started by hand.
pub(crate) fn run() -> anyhow::Result<()> {
    let mut companion = Companion::attach()?;
    let uses = companion.uses().clone();
    let first = match uses.reads.first().map(String::as_str) {
        Some("scan") => Some(First::Scan(companion.input()?)),
        Some("odometry") => Some(First::Odometry(companion.input()?)),
        Some("pose") => Some(First::Pose(companion.input()?)),
        Some("obstacles") => Some(First::Obstacles(companion.input()?)),
        Some("command") => Some(First::Command(companion.input()?)),
        Some("actuation") => Some(First::Actuation(companion.input()?)),
        Some(own) => Some(First::Own(companion.open_bytes(own)?)),
        None => None,
    };
    let outputs: Vec<ByteTopic> =
        uses.writes.iter().map(|name| companion.open_bytes(name)).collect::<Result<_, _>>()?;
    let size = outputs.iter().map(ByteTopic::size).max().unwrap_or(size_of::<Header>());
    // Of words, so that the header in front is aligned.
    let mut sample = vec![0_u64; size.div_ceil(size_of::<u64>())];
    if !companion.start()? {
        return Ok(());
    }
    while companion.wait(None)? {
        while let Some(header) = first.as_ref().map_or(Ok(None), First::take)? {
            for output in &outputs {
                let place = &mut cast_slice_mut(&mut sample)[..output.size()];
                place[..size_of::<Header>()].copy_from_slice(bytes_of(&header.answer()));
                output.publish(place)?;
            }
        }
    }
    Ok(())
}

impl First {
    /// The header of the oldest sample that was not taken.
    fn take(&self) -> Result<Option<Header>, RuntimeError> {
        fn of<S: Sample>(topic: &LoopTopic<S>) -> Result<Option<Header>, RuntimeError> {
            Ok(topic.take()?.map(|sample| *sample.header()))
        }
        match self {
            Self::Scan(topic) => of(topic),
            Self::Odometry(topic) => of(topic),
            Self::Pose(topic) => of(topic),
            Self::Obstacles(topic) => of(topic),
            Self::Command(topic) => of(topic),
            Self::Actuation(topic) => of(topic),
            Self::Own(topic) => {
                Ok(topic.take()?.map(|sample| pod_read_unaligned(&sample[..size_of::<Header>()])))
            }
        }
    }
}
