//! iceoryx2 as its examples use it: publish and notify, `timed_wait` of the stock listener, receive.
//!
//! For information: the cost of the bus without this project's runtime and its wake-up. In iceoryx2 0.10 a listener
//! can miss a notification for good; because of the time-out this is only a delay here.
#![expect(unsafe_code, reason = "messages are written in place, on top of older ones")]

use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{
    BackpressureStrategy, Config, FileName, LogLevel, Node, NodeBuilder, Path, SemanticString, ServiceName,
    SignalHandlingMode, ipc, set_log_level_from_env_or,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use runtime::Domain;

use crate::message::{Arrival, Stamp};
use crate::policy::MAX_WAIT_NS;
use crate::setup::HOPS;
use crate::stage::ChainStage;
use crate::{HopError, Setup};

/// Messages that wait at a reader: as many as on the topics of the loop.
const BUFFER: usize = 16;

type Messages = publish_subscribe::PortFactory<ipc::Service, [u8], ()>;
type Reader = Subscriber<ipc::Service, [u8], ()>;
type Writer = Publisher<ipc::Service, [u8], ()>;
type Events = event::PortFactory<ipc::Service>;

/// The services of a chain, created by the driver and kept open for its life.
pub(crate) struct Services {
    _services: Vec<(Messages, Events)>,
    _node: Node<ipc::Service>,
}

/// The ports of one process.
pub(crate) struct StockListener {
    inlet: Option<(Reader, Listener<ipc::Service>)>,
    outlet: Option<(Writer, Notifier<ipc::Service>)>,
    outlet_bytes: usize,
    _node: Node<ipc::Service>,
}

impl Services {
    /// Creates the services of a chain.
    pub(crate) fn create(domain: &Domain) -> Result<Self, HopError> {
        let error = |reason: &dyn std::fmt::Debug| HopError::transport("create a service", reason);
        let node = node(domain)?;
        let mut services = Vec::new();
        for hop in 0..HOPS {
            let name = name(hop)?;
            let messages = node
                .service_builder(&name)
                .publish_subscribe::<[u8]>()
                .max_publishers(1)
                .max_subscribers(2)
                .subscriber_max_buffer_size(BUFFER)
                .enable_safe_overflow(true)
                .create()
                .map_err(|reason| error(&reason))?;
            let events = node.service_builder(&name).event().create().map_err(|reason| error(&reason))?;
            services.push((messages, events));
        }
        Ok(Self { _services: services, _node: node })
    }
}

impl StockListener {
    /// Opens the ports of this process; every address is the id of the domain.
    pub(crate) fn open(setup: &Setup) -> Result<Self, HopError> {
        let error = |reason: &dyn std::fmt::Debug| HopError::transport("open a service", reason);
        let id = setup.addresses.first().map_or("", String::as_str);
        let domain = Domain::existing(id).map_err(|reason| error(&reason))?;
        let node = node(&domain)?;
        let open = |hop: usize| -> Result<(Messages, Events), HopError> {
            let name = name(hop)?;
            let messages = node.service_builder(&name).publish_subscribe::<[u8]>().open();
            let events = node.service_builder(&name).event().open();
            Ok((messages.map_err(|reason| error(&reason))?, events.map_err(|reason| error(&reason))?))
        };
        let inlet = if setup.is_first() {
            None
        } else {
            let (messages, events) = open(setup.index - 1)?;
            let subscriber = messages.subscriber_builder().create().map_err(|reason| error(&reason))?;
            Some((subscriber, events.listener_builder().create().map_err(|reason| error(&reason))?))
        };
        let outlet = if setup.is_last() {
            None
        } else {
            let (messages, events) = open(setup.index)?;
            let publisher = messages
                .publisher_builder()
                .initial_max_slice_len(setup.outlet_bytes())
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(|reason| error(&reason))?;
            Some((publisher, events.notifier_builder().create().map_err(|reason| error(&reason))?))
        };
        Ok(Self { inlet, outlet, outlet_bytes: setup.outlet_bytes(), _node: node })
    }
}

impl ChainStage for StockListener {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        let Some((publisher, notifier)) = &self.outlet else { return Ok(()) };
        let error = |reason: &dyn std::fmt::Debug| HopError::transport("publish", reason);
        let loaned = publisher.loan_slice_uninit(self.outlet_bytes).map_err(|reason| error(&reason))?;
        // SAFETY: the bytes are shared memory, which the kernel hands out zeroed and messages were written to since.
        let mut loaned = unsafe { loaned.assume_init() };
        stamp.write(loaned.payload_mut());
        loaned.send().map_err(|reason| error(&reason))?;
        // A listener that can't be notified finds the message at its next time-out.
        let _ = notifier.notify();
        Ok(())
    }

    fn take(&mut self) -> Option<Arrival> {
        let (subscriber, _) = self.inlet.as_ref()?;
        let message = subscriber.receive().ok()??;
        Stamp::read(message.payload()).map(Arrival::now)
    }

    fn poll(&mut self) -> bool {
        self.inlet.as_ref().is_some_and(|(subscriber, _)| subscriber.has_samples().unwrap_or(false))
    }

    fn block(&mut self, timeout_ns: Option<u64>) {
        if let Some((_, listener)) = &self.inlet {
            let longest = Duration::from_nanos(timeout_ns.unwrap_or(MAX_WAIT_NS));
            // A signal ends the wait as a notification does.
            let _ = listener.timed_wait(|_| {}, longest);
        }
    }
}

fn node(domain: &Domain) -> Result<Node<ipc::Service>, HopError> {
    let error = |reason: &dyn std::fmt::Debug| HopError::transport("join the bus", reason);
    set_log_level_from_env_or(LogLevel::Fatal);
    let mut config = Config::default();
    let root = domain.bus_directory();
    config.global.prefix =
        FileName::new(domain.shared_memory_prefix().as_bytes()).map_err(|reason| error(&reason))?;
    config
        .global
        .set_root_path(&Path::new(root.as_os_str().as_encoded_bytes()).map_err(|reason| error(&reason))?);
    NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(|reason| error(&reason))
}

fn name(hop: usize) -> Result<ServiceName, HopError> {
    ServiceName::new(&format!("hop{hop}")).map_err(|reason| HopError::transport("name a service", reason))
}
