//! An output that can mistreat a sample.

use std::rc::Rc;
use std::str::FromStr;

use runtime::{Output, Process, RuntimeError, monotonic_ns};
use scanloop_tests::{DelayPlace, planted};
use shared_types::{Header, Role, Sample};

use crate::Trouble;

/// How one sample is mistreated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// It gets a number and is not sent.
    Drop,
    /// It gets no number.
    Omit,
    /// It is sent twice under one number.
    Repeat,
    /// It is published twice under two numbers.
    Double,
    /// It is sent after the next one, numbers as they should be.
    Swap,
    /// It is published after the next one, numbers in the order of publication.
    Mix,
    /// Its header has this one of the [`FORGERIES`].
    Forge(usize),
    /// Every eighth sample has the next of the [`FORGERIES`], from this one on.
    ForgeAll(usize),
}

/// Fields of a header, and what they may be instead of what they are.
const FORGED: [fn(&mut Header) -> &mut u64; 4] = [
    |header| &mut header.sequence,
    |header| &mut header.scan_id,
    |header| &mut header.acquired_ns,
    |header| &mut header.stage_mut(Role::Robot).published_ns,
];
const INSTEAD: [fn(u64) -> u64; 8] = [
    |_| 0,
    |is| is.wrapping_sub(1),
    |is| is.wrapping_add(1),
    |is| is.wrapping_add(1_000),
    |_| 1 << 40,
    |_| 1 << 48,
    |_| 1 << 63,
    |_| u64::MAX,
];

/// How many forgeries there are: all values of the first field, then those of the next.
const FORGERIES: usize = FORGED.len() * INSTEAD.len();

fn forge(header: &mut Header, index: usize) {
    let field = FORGED[index / INSTEAD.len()](header);
    *field = INSTEAD[index % INSTEAD.len()](*field);
}

impl FromStr for Fault {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Ok(match text {
            "drop" => Self::Drop,
            "omit" => Self::Omit,
            "repeat" => Self::Repeat,
            "double" => Self::Double,
            "swap" => Self::Swap,
            "mix" => Self::Mix,
            "forge" => Self::ForgeAll(0),
            _ => {
                let index = text.strip_prefix("forge-").and_then(|index| index.parse().ok()).ok_or(())?;
                Self::Forge(if index < FORGERIES { index } else { return Err(()) })
            }
        })
    }
}

/// Publishes the samples of one topic, one of them wrongly.
pub(crate) struct Outlet<S: Sample> {
    output: Rc<Output<S>>,
    role: Role,
    trouble: Trouble,
    held: Option<S>,
}

impl<S: Sample> Outlet<S> {
    pub(crate) fn new(process: &mut Process, role: Role, trouble: Trouble) -> Result<Self, RuntimeError> {
        Ok(Self { output: process.output()?, role, trouble, held: None })
    }

    /// The inputs for a scan are there and about to be taken.
    pub(crate) fn before_take(&self, scan_id: u64) {
        self.wait_at(DelayPlace::Take, scan_id);
    }

    /// The inputs were taken.
    pub(crate) fn taken(&self, scan_id: u64) {
        self.wait_at(DelayPlace::Compute, scan_id);
    }

    /// Publishes a sample, or mistreats it.
    pub(crate) fn publish(&mut self, sample: &mut S) -> Result<(), RuntimeError> {
        let scan_id = sample.header().scan_id;
        match self.trouble {
            Trouble::Sample(fault, topic, at) if topic == S::TOPIC && scan_id >= at => {
                self.trouble = match fault {
                    Fault::ForgeAll(index) if index + 1 < FORGERIES => {
                        Trouble::Sample(Fault::ForgeAll(index + 1), topic, scan_id + 8)
                    }
                    _ => Trouble::Sample(fault, topic, u64::MAX),
                };
                self.publish_wrongly(fault, sample)?;
                eprintln!("wrong scan {scan_id} number {}", sample.header().sequence);
                Ok(())
            }
            Trouble::Sample(Fault::Mix, ..) => {
                self.output.publish(sample)?;
                self.held.take().map_or(Ok(()), |mut held| self.output.publish(&mut held))
            }
            Trouble::Sample(..) => {
                self.output.publish(sample)?;
                self.held.take().map_or(Ok(()), |mut held| self.output.send(&mut held))
            }
            Trouble::Delay => self.publish_late(scan_id, sample),
        }
    }

    fn publish_wrongly(&mut self, fault: Fault, sample: &mut S) -> Result<(), RuntimeError> {
        match fault {
            Fault::Drop => self.output.complete(sample),
            Fault::Omit => {}
            Fault::Repeat => {
                self.output.publish(sample)?;
                self.output.send(sample)?;
            }
            Fault::Double => {
                self.output.publish(sample)?;
                self.output.publish(sample)?;
            }
            Fault::Swap => {
                self.output.complete(sample);
                self.held = Some(*sample);
            }
            Fault::Mix => self.held = Some(*sample),
            Fault::Forge(index) | Fault::ForgeAll(index) => {
                self.output.complete(sample);
                forge(sample.header_mut(), index);
                self.output.send(sample)?;
                self.output.wake();
            }
        }
        Ok(())
    }

    fn publish_late(&mut self, scan_id: u64, sample: &mut S) -> Result<(), RuntimeError> {
        self.output.complete(sample);
        self.wait_at(DelayPlace::Publish, scan_id);
        self.output.send(sample)?;
        self.wait_at(DelayPlace::Deliver, scan_id);
        self.output.wake();
        Ok(())
    }

    /// Waits there if it is planned, and logs from when to when it really waited [ns].
    fn wait_at(&self, place: DelayPlace, scan_id: u64) {
        if !matches!(self.trouble, Trouble::Delay) {
            return;
        }
        let Some(delay_ns) = planted(scan_id, self.role, place) else { return };
        let from_ns = monotonic_ns();
        // Busy, because a sleep is not exact.
        while monotonic_ns() - from_ns < delay_ns {
            std::hint::spin_loop();
        }
        let to_ns = monotonic_ns();
        eprintln!("planted scan {scan_id} from {from_ns} to {to_ns}");
    }
}
