//! One process of `scanloop bench transport` over Zenoh, with and without its shared memory.
//!
//! Set for low latency as Zenoh's documentation and its own latency examples do:
//!
//! * peers that connect to each other directly over TCP on the loopback; no scouting, no gossip, no router;
//! * `lowlatency` transport without priorities, where messages fit into it (it can't split messages), else the usual
//!   one without batching;
//! * a message is passed on inside of the subscriber's callback, on Zenoh's own thread, without waking another one;
//! * express messages, which are not held back for others;
//! * with shared memory: messages are allocated there and only their description is sent; the memory is set up at the
//!   start, not with the first message.

use std::error::Error;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use hops::{Arrival, ChainStage, DriverConnection, HopError, Setup, Stamp, run};
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::shm::{GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};
use zenoh::{Config, Session, Wait};

/// Messages that fit into the shared memory of a process: as many as wait at a reader elsewhere.
const SLOTS: usize = 16;
/// Largest message of the low-latency transport: a batch of 65535 bytes less what surrounds the message.
const LOW_LATENCY_BYTES: usize = 60_000;

type Failure = Box<dyn Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    if std::env::args().nth(1).as_deref() == Some(hops::TIDY) {
        zenoh::shm::cleanup_orphaned_shm_segments();
        return Ok(());
    }
    let setup = Setup::from_environment()?;
    let session = zenoh::open(config(&setup)?).wait()?;
    if setup.is_first() {
        return Ok(run(&mut First { outlet: Outlet::new(&session, &setup)? }, &setup)?);
    }
    let key = format!("hop{}", setup.index - 1);
    if setup.is_last() {
        let (sender, arrivals) = channel();
        let subscriber = session.declare_subscriber(key).callback(move |sample| {
            // The time is taken here, before the other thread is woken.
            if let Some(stamp) = Stamp::read(&sample.payload().to_bytes()) {
                let _ = Sender::send(&sender, Arrival::now(stamp));
            }
        });
        let _subscriber = subscriber.wait()?;
        return Ok(run(&mut Last { arrivals, noticed: None }, &setup)?);
    }
    let mut outlet = Outlet::new(&session, &setup)?;
    let subscriber = session.declare_subscriber(key).callback_mut(move |sample| {
        if let Some(stamp) = Stamp::read(&sample.payload().to_bytes()) {
            let _ = outlet.send(stamp);
        }
    });
    let _subscriber = subscriber.wait()?;
    let mut control = DriverConnection::connect(&setup)?;
    control.hello(&setup)?;
    control.wait_for_close();
    Ok(())
}

fn config(setup: &Setup) -> Result<Config, Failure> {
    let shared_memory = setup.contender == "zenoh-shm";
    let largest = setup.payload_bytes.iter().copied().max().unwrap_or(0);
    let low_latency = shared_memory || largest <= LOW_LATENCY_BYTES;
    let list = |address: Option<&str>| format!("{:?}", address.iter().collect::<Vec<_>>());
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("listen/endpoints", list(setup.outlet())),
        ("connect/endpoints", list(setup.inlet())),
        // The process before this one may open its port later.
        ("connect/timeout_ms", "30000".to_owned()),
        (
            "connect/retry",
            "{ period_init_ms: 10, period_max_ms: 50, period_increase_factor: 1.5 }".to_owned(),
        ),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/unicast/lowlatency", low_latency.to_string()),
        ("transport/unicast/qos/enabled", (!low_latency).to_string()),
        ("transport/link/tx/queue/batching/enabled", "false".to_owned()),
        ("transport/shared_memory/enabled", shared_memory.to_string()),
        ("transport/shared_memory/mode", "\"init\"".to_owned()),
    ] {
        config.insert_json5(key, &value).map_err(|error| format!("{key} = {value}: {error}"))?;
    }
    Ok(config)
}

/// The writing end of a process.
struct Outlet {
    publisher: Publisher<'static>,
    bytes: usize,
    memory: Option<ShmProvider<PosixShmProviderBackend>>,
    message: Vec<u8>,
}

impl Outlet {
    fn new(session: &Session, setup: &Setup) -> Result<Self, Failure> {
        let bytes = setup.outlet_bytes();
        let publisher = session
            .declare_publisher(format!("hop{}", setup.index))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .wait()?;
        let memory = if setup.contender == "zenoh-shm" {
            // One more page: the allocator keeps its own notes between messages.
            let pool = PosixShmProviderBackend::builder(SLOTS * (bytes + 4096)).wait()?;
            Some(ShmProviderBuilder::backend(pool).wait())
        } else {
            None
        };
        Ok(Self { publisher, bytes, memory, message: vec![0; bytes] })
    }

    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        let error = |error: &dyn std::fmt::Debug| HopError::transport("publish", error);
        let payload: ZBytes = match &self.memory {
            Some(memory) => {
                let bytes = NonZeroUsize::new(self.bytes).ok_or_else(|| error(&"no bytes"))?;
                // Without room the message is lost, as with the others.
                let allocated = memory.alloc(bytes).with_policy::<GarbageCollect>().wait();
                let Ok(mut message) = allocated else { return Ok(()) };
                stamp.write(&mut message);
                message.into()
            }
            None => {
                stamp.write(&mut self.message);
                self.message.as_slice().into()
            }
        };
        self.publisher.put(payload).wait().map_err(|reason| error(&reason))
    }
}

/// The process that sends.
struct First {
    outlet: Outlet,
}

impl ChainStage for First {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        self.outlet.send(stamp)
    }

    fn take(&mut self) -> Option<Arrival> {
        None
    }

    fn poll(&mut self) -> bool {
        false
    }

    fn block(&mut self, _longest_ns: Option<u64>) {}
}

/// The process that takes the latencies: messages are stamped in the callback and collected here.
struct Last {
    arrivals: Receiver<Arrival>,
    noticed: Option<Arrival>,
}

impl ChainStage for Last {
    fn send(&mut self, _stamp: Stamp) -> Result<(), HopError> {
        Ok(())
    }

    fn take(&mut self) -> Option<Arrival> {
        self.noticed.take().or_else(|| self.arrivals.try_recv().ok())
    }

    fn poll(&mut self) -> bool {
        self.noticed = self.arrivals.try_recv().ok();
        self.noticed.is_some()
    }

    fn block(&mut self, timeout_ns: Option<u64>) {
        let longest = Duration::from_nanos(timeout_ns.unwrap_or(230_000_000));
        self.noticed = self.arrivals.recv_timeout(longest).ok();
    }
}
