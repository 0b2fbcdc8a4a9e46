//! A process whose topics are chosen by name at run time, over the typed ports of its role.
#![expect(unsafe_code, reason = "samples are read and written in memory of C")]

use std::ffi::c_void;
use std::rc::Rc;

use runtime::{Handover, Input, Output, Process, Taken, join, settings_table};
use shared_types::{
    Actuation, Checkpoint, Command, Header, Layouts, Obstacles, Odometry, Pose, Role, Sample, Scan, Topic,
};

use crate::error::Refusal;

/// An input, and the sample that C has a pointer to.
pub(crate) struct Port<S: Sample> {
    input: Input<S>,
    lent: Option<Taken<S>>,
}

/// The inputs of a role, those that belong to one scan together.
enum Inputs {
    Robot(Port<Actuation>),
    Estimator(Port<Odometry>, Port<Actuation>),
    Obstacles(Port<Scan>, Port<Pose>),
    Controller(Port<Pose>, Port<Obstacles>),
    Actuator(Port<Command>),
}

/// `enum scanloop_handover`: the state that a process resumes from.
#[derive(Clone, Copy)]
pub(crate) enum Resumed {
    /// Nothing ran before.
    FirstStart = 0,
    /// The state of the process before.
    State = 1,
    /// The process before was another program, whose state is of another kind.
    Foreign = 2,
    /// The state of the process before is too old, or was never saved.
    Lost = 3,
}

/// A process as C sees it.
pub struct CProcess {
    // Dropped before the process, whose bus lends the samples.
    inputs: Inputs,
    outputs: Vec<(Topic, Box<dyn Sink>)>,
    pub(crate) process: Process,
    role: Role,
    settings: toml::Table,
}

impl CProcess {
    /// Joins the system; `layouts` are those of the program that uses the library.
    pub(crate) fn open(role: Role, layouts: &Layouts) -> Result<Self, Refusal> {
        runtime::verify_layouts(role, layouts)?;
        let mut process = Process::attach(role)?;
        let settings = process.settings(settings_table(role))?;
        let inputs = match role {
            Role::Robot => Inputs::Robot(Port::open(&mut process)?),
            Role::Estimator => Inputs::Estimator(Port::open(&mut process)?, Port::open(&mut process)?),
            Role::Obstacles => Inputs::Obstacles(Port::open(&mut process)?, Port::open(&mut process)?),
            Role::Controller => Inputs::Controller(Port::open(&mut process)?, Port::open(&mut process)?),
            Role::Actuator => Inputs::Actuator(Port::open(&mut process)?),
        };
        let mut outputs = Vec::new();
        for topic in role.writes() {
            outputs.push((*topic, sink(&mut process, *topic)?));
        }
        Ok(Self { inputs, outputs, process, role, settings })
    }

    /// The oldest sample of a topic; it stays lent until the next one.
    pub(crate) fn read(&mut self, topic: Topic) -> Result<Option<*const c_void>, Refusal> {
        let port: &mut dyn Source = match (&mut self.inputs, topic) {
            (Inputs::Robot(port), Topic::Actuation) => port,
            (Inputs::Estimator(port, _), Topic::Odometry) => port,
            (Inputs::Estimator(_, port), Topic::Actuation) => port,
            (Inputs::Obstacles(port, _), Topic::Scan) => port,
            (Inputs::Obstacles(_, port) | Inputs::Controller(port, _), Topic::Pose) => port,
            (Inputs::Controller(_, port), Topic::Obstacles) => port,
            (Inputs::Actuator(port), Topic::Command) => port,
            _ => return Err(Refusal::NotYours { verb: "read", topic }),
        };
        Ok(port.lend())
    }

    /// A pair of one scan, as [`runtime::join`] chooses it.
    pub(crate) fn join(&mut self) -> Result<Option<[*const c_void; 2]>, Refusal> {
        match &mut self.inputs {
            Inputs::Obstacles(one, other) => Ok(pair(one, other)),
            Inputs::Controller(one, other) => Ok(pair(one, other)),
            _ => Err(Refusal::NoPair),
        }
    }

    /// Publishes a copy of `size` bytes at `sample`, and completes the header there.
    ///
    /// # Safety
    /// `sample` must point to `size` bytes that can be read and written.
    pub(crate) unsafe fn publish(
        &self,
        topic: Topic,
        sample: *mut c_void,
        size: usize,
    ) -> Result<(), Refusal> {
        let found = self.outputs.iter().find(|(written, _)| *written == topic);
        let (_, output) = found.ok_or(Refusal::NotYours { verb: "write", topic })?;
        if size != topic.size() {
            return Err(Refusal::Size { topic, expected: topic.size(), found: size });
        }
        // SAFETY: the caller guarantees it, for as many bytes as a sample of the topic has.
        unsafe { output.publish(sample) }
    }

    /// Publishes the state of the process.
    pub(crate) fn save(&mut self, header: &Header, kind: u32, state: &[u8]) -> Result<(), Refusal> {
        let checkpoint = Checkpoint::of_bytes(self.role, kind, state).map_err(Refusal::State)?;
        Ok(self.process.save_checkpoint(header, checkpoint)?)
    }

    /// Copies the state that was handed over.
    pub(crate) fn resume(&self, kind: u32, state: &mut [u8]) -> Result<Resumed, Refusal> {
        let checkpoint = match self.process.resume_checkpoint()? {
            Handover::FirstStart => return Ok(Resumed::FirstStart),
            Handover::Lost => return Ok(Resumed::Lost),
            Handover::State(checkpoint) => checkpoint,
        };
        match checkpoint.state_bytes(kind) {
            Ok(bytes) if bytes.len() == state.len() => {
                state.copy_from_slice(bytes);
                Ok(Resumed::State)
            }
            _ => Ok(Resumed::Foreign),
        }
    }

    /// A number of the settings by its dotted key.
    pub(crate) fn setting(&self, key: &str) -> Option<f64> {
        let mut keys = key.split('.');
        let mut value = self.settings.get(keys.next()?)?;
        for key in keys {
            value = match value {
                toml::Value::Array(list) => list.get(key.parse::<usize>().ok()?)?,
                other => other.get(key)?,
            };
        }
        match value {
            toml::Value::Float(number) => Some(*number),
            toml::Value::Integer(number) => Some(*number as f64),
            toml::Value::Boolean(flag) => Some(f64::from(u8::from(*flag))),
            _ => None,
        }
    }
}

/// Reads one topic.
trait Source {
    fn lend(&mut self) -> Option<*const c_void>;
}

impl<S: Sample> Port<S> {
    fn open(process: &mut Process) -> Result<Self, Refusal> {
        Ok(Self { input: process.input()?, lent: None })
    }

    fn keep(&mut self, taken: Taken<S>) -> *const c_void {
        std::ptr::from_ref::<S>(self.lent.insert(taken)).cast()
    }
}

impl<S: Sample> Source for Port<S> {
    fn lend(&mut self) -> Option<*const c_void> {
        let taken = self.input.take()?;
        Some(self.keep(taken))
    }
}

fn pair<A: Sample, B: Sample>(one: &mut Port<A>, other: &mut Port<B>) -> Option<[*const c_void; 2]> {
    let (first, second) = join(&one.input, &other.input)?;
    Some([one.keep(first), other.keep(second)])
}

/// Writes one topic.
trait Sink {
    /// Publishes a copy of the sample and fills its header.
    ///
    /// # Safety
    /// `sample` must point to a sample of the topic that can be read and written.
    unsafe fn publish(&self, sample: *mut c_void) -> Result<(), Refusal>;
}

impl<S: Sample> Sink for Rc<Output<S>> {
    unsafe fn publish(&self, sample: *mut c_void) -> Result<(), Refusal> {
        let place = sample.cast::<S>();
        // SAFETY: the caller guarantees as many bytes as `S` has. They need not be aligned, and each
        // pattern of bits is a value, because `S` is `Pod`.
        let mut copy = unsafe { place.read_unaligned() };
        copy.header_mut().layout = S::LAYOUT;
        copy.check().map_err(|fault| Refusal::Sample(S::TOPIC, fault))?;
        Output::publish(self, &mut copy)?;
        // SAFETY: as above.
        unsafe { place.write_unaligned(copy) };
        Ok(())
    }
}

fn sink(process: &mut Process, topic: Topic) -> Result<Box<dyn Sink>, Refusal> {
    Ok(match topic {
        Topic::Scan => Box::new(process.output::<Scan>()?),
        Topic::Odometry => Box::new(process.output::<Odometry>()?),
        Topic::Pose => Box::new(process.output::<Pose>()?),
        Topic::Obstacles => Box::new(process.output::<Obstacles>()?),
        Topic::Command => Box::new(process.output::<Command>()?),
        Topic::Actuation => Box::new(process.output::<Actuation>()?),
        _ => return Err(Refusal::NotYours { verb: "write", topic }),
    })
}
