//! The bus as the processes of the loop use it: roles, topics, headers and wake-up of the crate `runtime`.
//!
//! Each process of the chain takes a role and does what its implementation does except for computing: wait, take,
//! answer the header, publish. Everything that the runtime does for a process is in the figure: the check of layout
//! and content, authority, sequence, stamps of the chain, counters, the heartbeat.
#![expect(unsafe_code, reason = "messages of a chosen size are plain bytes by a promise to bytemuck")]

use std::rc::Rc;

use bytemuck::{Pod, Zeroable};
use runtime::{
    Bus, ClockKind, DIRECTORY_VARIABLE, Domain, INCARNATION_VARIABLE, Input, Observer, Output, Process,
    Publisher, RUN_ID_VARIABLE, RunSettings, RuntimeError, SYSTEM_ID_VARIABLE, settings_file,
};
use shared_types::{
    Authority, Checkpoint, Command, Described, Directive, Fault, Field, Header, Heartbeat, Journal, Kind,
    Obstacles, Odometry, Phase, Pose, ProcessState, Role, Sample, Topic,
};

use crate::message::{Arrival, Stamp};
use crate::policy::POLL_US;
use crate::setup::{BLOCK_BYTES, HOPS, PROCESSES};
use crate::stage::ChainStage;
use crate::{HopError, Payload, Setup, WaitPolicy};

/// Samples above this are written in place, as no service of the loop has to [bytes].
const IN_PLACE: usize = 8192;
/// The chain ends with its driver; the runtime need not watch for that.
const ORPHAN_TIMEOUT_NS: u64 = 3_600_000_000_000;
/// Readers of a topic of the chain: the next process, and one for what comes unforeseen.
const READERS: usize = 2;
/// Readers of heartbeats and directives: the processes and the driver.
const PARTICIPANTS: usize = PROCESSES + 1;

/// A sample of a chosen size: `HOP` gives the topic, `REST` is the size without the header.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
struct Bytes<const HOP: usize, const REST: usize> {
    header: Header,
    rest: [u8; REST],
}

// SAFETY: both fields are plain bytes that may be zero.
unsafe impl<const HOP: usize, const REST: usize> Zeroable for Bytes<HOP, REST> {}
// SAFETY: a header is plain data of a size that is a multiple of its alignment, and bytes follow it; sizes that would
// need padding at the end are refused when the type is used.
unsafe impl<const HOP: usize, const REST: usize> Pod for Bytes<HOP, REST> {}

impl<const HOP: usize, const REST: usize> Described for Bytes<HOP, REST> {
    const KIND: Kind = Kind::Struct("Bytes", &[]);
}

impl<const HOP: usize, const REST: usize> Sample for Bytes<HOP, REST> {
    const TOPIC: Topic = [Topic::Odometry, Topic::Pose, Topic::Obstacles, Topic::Command][HOP];
    const TYPE_NAME: &'static str = "scanloop.Bytes.v1";
    const LAYOUT: u32 = {
        assert!(size_of::<Self>() == size_of::<Header>() + REST, "no padding");
        size_of::<Self>() as u32
    };
    const FIELDS: &'static [Field] = &[];

    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn check(&self) -> Result<(), Fault> {
        self.header.check::<Self>()?;
        match self.rest.last_chunk() {
            Some(end) if u64::from_ne_bytes(*end) == self.header.scan_id => Ok(()),
            _ => Err(Fault::OutOfRange { field: "rest", value: f64::NAN }),
        }
    }
}

/// The settings file of the chain.
#[derive(serde::Serialize)]
struct Settings {
    run: RunSettings,
    realtime: Realtime,
}

/// What the chain wants of the runtime's table `realtime`.
#[derive(serde::Serialize)]
struct Realtime {
    poll_us: u64,
}

/// The ports of one process; the end processes have one of the two.
struct BusStage<I: Sample, O: Sample> {
    process: Process,
    input: Option<Input<I>>,
    output: Option<(Rc<Output<O>>, Box<O>)>,
    /// Of the sample taken last.
    header: Header,
}

impl<I: Sample, O: Sample> BusStage<I, O> {
    fn open(setup: &Setup) -> Result<Box<dyn ChainStage>, RuntimeError> {
        let mut process = Process::attach(Role::ALL[setup.index])?;
        // As the orchestrator does for every process of a run; other schedulers stay as they are.
        runtime::Realtime::default().apply_to(std::process::id());
        let input = if setup.is_first() { None } else { Some(process.input::<I>()?) };
        let output = if setup.is_last() { None } else { Some((process.output::<O>()?, zeroed_box())) };
        process.start()?;
        Ok(Box::new(Self { process, input, output, header: Header::default() }))
    }
}

impl<I: Sample, O: Sample> ChainStage for BusStage<I, O> {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        let Some((output, sample)) = &mut self.output else { return Ok(()) };
        let header = if self.input.is_some() {
            self.header.answer()
        } else {
            let mut header = Header { scan_id: stamp.sequence, ..Header::default() };
            // A stage that no process of this chain has, so that no process overwrites the stamp.
            header.stage_mut(Role::Actuator).woken_ns = stamp.sent_ns;
            header
        };
        let sent = if size_of::<O>() > IN_PLACE {
            output.publish_in_place(|place| fill(place, header))
        } else {
            fill(&mut **sample, header);
            output.publish(sample)
        };
        sent.map_err(|error| HopError::transport("publish", error))
    }

    fn take(&mut self) -> Option<Arrival> {
        let sample = self.input.as_ref()?.take()?;
        self.header = *sample.header();
        let sent_ns = self.header.stage(Role::Actuator).woken_ns;
        Some(Arrival::now(Stamp { sequence: self.header.scan_id, sent_ns }))
    }

    fn poll(&mut self) -> bool {
        self.wait(0);
        self.input.as_ref().is_some_and(|input| input.next_scan().is_some())
    }

    fn sleep_until(&mut self, time_ns: u64) {
        while runtime::monotonic_ns() < time_ns {
            // It ends by order of the driver, not by a signal.
            let _ = self.process.wait_for_time(time_ns);
        }
        self.process.begin();
    }

    fn block(&mut self, timeout_ns: Option<u64>) {
        self.wait(timeout_ns.unwrap_or(u64::MAX));
    }
}

impl<I: Sample, O: Sample> BusStage<I, O> {
    fn wait(&mut self, timeout_ns: u64) {
        let deadline = (timeout_ns < u64::MAX).then(|| runtime::monotonic_ns() + timeout_ns);
        // It ends by order of the driver, not by a signal.
        let _ = self.process.wait(deadline);
    }
}

/// A sample of zeros that is never on the stack: the largest has 4 MB.
fn zeroed_box<S: Sample>() -> Box<S> {
    // SAFETY: samples are plain data, for which zero is a value.
    unsafe { Box::new_zeroed().assume_init() }
}

/// Writes a message into a sample of the bus: the header, and the number at the end of chosen sizes.
fn fill<S: Sample>(sample: &mut S, header: Header) {
    if S::FIELDS.is_empty() {
        let end = size_of::<S>() - 8;
        bytemuck::bytes_of_mut(sample)[end..].copy_from_slice(&header.scan_id.to_ne_bytes());
    }
    *sample.header_mut() = header;
}

/// Calls a function with the constant that fits a message size.
macro_rules! with_size {
    ($bytes:expr, $name:ident, $body:expr) => {{
        const HEADER: usize = size_of::<Header>();
        macro_rules! run {
            ($index:literal) => {{
                const $name: usize = BLOCK_BYTES[$index] - HEADER;
                $body
            }};
        }
        match BLOCK_BYTES.iter().position(|bytes| *bytes == $bytes) {
            Some(0) => run!(0),
            Some(1) => run!(1),
            Some(2) => run!(2),
            Some(3) => run!(3),
            Some(4) => run!(4),
            Some(5) => run!(5),
            Some(6) => run!(6),
            _ => Err(RuntimeError::Bus {
                action: "choose a message size".to_owned(),
                reason: format!("{} bytes is none of {BLOCK_BYTES:?}", $bytes),
            }),
        }
    }};
}

/// Opens the ports of this process and passes the start barrier.
pub(crate) fn open(setup: &Setup) -> Result<Box<dyn ChainStage>, HopError> {
    let opened = if setup.payload_bytes == Payload::Pipeline.bytes() {
        match setup.index {
            0 => BusStage::<Odometry, Odometry>::open(setup),
            1 => BusStage::<Odometry, Pose>::open(setup),
            2 => BusStage::<Pose, Obstacles>::open(setup),
            3 => BusStage::<Obstacles, Command>::open(setup),
            _ => BusStage::<Command, Command>::open(setup),
        }
    } else {
        with_size!(
            setup.payload_bytes[0],
            REST,
            match setup.index {
                0 => BusStage::<Bytes<0, REST>, Bytes<0, REST>>::open(setup),
                1 => BusStage::<Bytes<0, REST>, Bytes<1, REST>>::open(setup),
                2 => BusStage::<Bytes<1, REST>, Bytes<2, REST>>::open(setup),
                3 => BusStage::<Bytes<2, REST>, Bytes<3, REST>>::open(setup),
                _ => BusStage::<Bytes<3, REST>, Bytes<3, REST>>::open(setup),
            }
        )
    };
    opened.map_err(|error| HopError::transport("open the ports", error))
}

/// The part of an orchestrator that a chain needs: topics, settings, directives.
pub(crate) struct System {
    // Fields are dropped in this order: ports before the bus, the bus before its files.
    directives: Publisher<Directive>,
    heartbeats: Observer<Heartbeat>,
    _bus: Bus,
    domain: Domain,
    states: [Option<ProcessState>; PROCESSES],
    phase: Phase,
}

impl System {
    /// Creates the bus of a chain in a domain of its own.
    pub(crate) fn create(
        domain: Domain,
        payload: Payload,
        period_ns: u64,
        policy: WaitPolicy,
    ) -> Result<Self, HopError> {
        let error = |error: RuntimeError| HopError::transport("create the bus of the chain", error);
        let run = RunSettings {
            period_ns,
            clock: ClockKind::Monotonic,
            orphan_stop_ns: ORPHAN_TIMEOUT_NS,
            orphan_timeout_ns: ORPHAN_TIMEOUT_NS,
        };
        let realtime = Realtime { poll_us: if policy == WaitPolicy::Poll { POLL_US } else { 0 } };
        let text = toml::to_string(&Settings { run, realtime })
            .map_err(|error| HopError::transport("write the settings", error))?;
        for role in Role::ALL {
            domain.folder().write(&settings_file(*role), text.as_bytes()).map_err(error)?;
        }
        let bus = create(&domain, payload).map_err(error)?;
        Ok(Self {
            directives: Publisher::new(&bus).map_err(error)?,
            heartbeats: Observer::new(&bus).map_err(error)?,
            _bus: bus,
            domain,
            states: [None; PROCESSES],
            phase: Phase::Starting,
        })
    }

    /// The environment variables of the process `index`.
    pub(crate) fn environment(&self, index: usize) -> [(&'static str, String); 4] {
        [
            (SYSTEM_ID_VARIABLE, self.domain.system_id().to_owned()),
            (RUN_ID_VARIABLE, self.domain.run_id().to_owned()),
            (DIRECTORY_VARIABLE, self.domain.directory().display().to_string()),
            (INCARNATION_VARIABLE, incarnation(index).to_string()),
        ]
    }

    /// Advances the start barrier; call it until all processes have sent their hello.
    pub(crate) fn assist(&mut self) -> Result<(), HopError> {
        let error = |error: RuntimeError| HopError::transport("start the chain", error);
        self.heartbeats
            .poll(|heartbeat| {
                let state = ProcessState::try_from(heartbeat.state).ok();
                if let Some(place) = self.states.get_mut(heartbeat.role as usize) {
                    *place = state.or(*place);
                }
            })
            .map_err(error)?;
        let all =
            |least: ProcessState| self.states.iter().all(|state| state.is_some_and(|state| state >= least));
        let phase = match self.phase {
            Phase::Starting if all(ProcessState::Attached) => Phase::Connecting,
            Phase::Connecting if all(ProcessState::Connected) => Phase::Driving,
            _ => return Ok(()),
        };
        self.phase = phase;
        let mut directive = Directive {
            phase: phase.wire(),
            issued_ns: runtime::monotonic_ns(),
            orchestrator_pid: u64::from(std::process::id()),
            ..Directive::default()
        };
        for (index, authority) in directive.authority.iter_mut().enumerate() {
            *authority = Authority { incarnation: incarnation(index), previous: 0, from_scan: 0 };
        }
        self.directives.publish(&mut directive, true).map_err(error)
    }
}

fn incarnation(index: usize) -> u32 {
    index as u32 + 1
}

fn create(domain: &Domain, payload: Payload) -> Result<Bus, RuntimeError> {
    let mut bus = Bus::create_empty(domain)?;
    bus.create_topic_for::<Heartbeat>(PARTICIPANTS)?;
    bus.create_topic_for::<Directive>(PARTICIPANTS)?;
    bus.create_topic_for::<Checkpoint>(PARTICIPANTS)?;
    bus.create_topic_for::<Journal>(PARTICIPANTS)?;
    let Payload::Block(bytes) = payload else {
        bus.create_topic_for::<Odometry>(READERS)?;
        bus.create_topic_for::<Pose>(READERS)?;
        bus.create_topic_for::<Obstacles>(READERS)?;
        bus.create_topic_for::<Command>(READERS)?;
        return Ok(bus);
    };
    with_size!(bytes, REST, {
        bus.create_topic_for::<Bytes<0, REST>>(READERS)?;
        bus.create_topic_for::<Bytes<1, REST>>(READERS)?;
        bus.create_topic_for::<Bytes<2, REST>>(READERS)?;
        bus.create_topic_for::<Bytes<3, REST>>(READERS)
    })?;
    Ok(bus)
}

const _: () = assert!(HOPS == 4, "four topics carry the chain");
