//! The services of one system on iceoryx2: created in one place, opened everywhere else.
//!
//! Only the orchestrator creates, so a process that starts first can't create a topic with other sizes, and
//! the order of starts is irrelevant. A service lives as long as anyone has it open, so it outlives the
//! orchestrator that created it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{
    BackpressureStrategy, Config, LogLevel, Node, NodeBuilder, NodeName, ServiceName, SignalHandlingMode,
    ipc, set_log_level_from_env_or,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use shared_types::{
    Actuation, Checkpoint, Command, Directive, Heartbeat, Obstacles, Odometry, Pose, Sample, Scan, Topic,
    Truth,
};

use crate::bell::Bells;
use crate::quality::{EVENT_PORTS, NODES, Quality, quality};
use crate::reserve::{Reserve, allocate_files, remove_empty_files, require_room};
use crate::wire::Wire;
use crate::{Domain, RuntimeError, layouts, management};

type Samples<S> = publish_subscribe::PortFactory<ipc::Service, Wire<S>, ()>;
type Blobs = publish_subscribe::PortFactory<ipc::Service, [u8], ()>;
pub(crate) type Events = event::PortFactory<ipc::Service>;

pub(crate) type WirePublisher<S> = Publisher<ipc::Service, Wire<S>, ()>;
pub(crate) type BlobPublisher = Publisher<ipc::Service, [u8], ()>;
pub(crate) type BlobSubscriber = Subscriber<ipc::Service, [u8], ()>;
pub(crate) type WireSubscriber<S> = Subscriber<ipc::Service, Wire<S>, ()>;

/// How long to retry opening a service that another process is just cleaning up.
const OPEN_RETRY: Duration = Duration::from_secs(5);

/// One process's access to the services of its system.
#[derive(Debug)]
pub struct Bus {
    domain: Domain,
    node: Node<ipc::Service>,
    bells: Arc<Bells>,
    held: Vec<Box<dyn std::fmt::Debug>>,
}

impl Bus {
    /// Creates all services of the system and keeps them for as long as the value lives: the orchestrator.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when a system does not fit, [`RuntimeError::Bus`] when iceoryx2 refuses, and
    /// [`RuntimeError::File`] when the layouts of the samples can't be written.
    pub fn create(domain: &Domain) -> Result<Self, RuntimeError> {
        // Freed at once: what follows takes it piece by piece.
        Reserve::take(Reserve::of_a_system())?;
        Self::with_topics(domain, false)
    }

    /// Opens the services of a system that lost its orchestrator, and creates those that nobody keeps any more.
    ///
    /// # Errors
    /// [`RuntimeError::Layout`] when the system was built against other samples, and [`RuntimeError::Bus`] when iceoryx2
    /// refuses.
    pub fn take_over(domain: &Domain) -> Result<Self, RuntimeError> {
        Self::with_topics(domain, true)
    }

    fn with_topics(domain: &Domain, take_over: bool) -> Result<Self, RuntimeError> {
        let mut bus = if take_over {
            let bus = Self::join(domain, "orchestrator", Bells::create(domain)?)?;
            layouts::verify_all(domain)?;
            // The orchestrator that died still holds ports, of which there are few for directives.
            bus.clean_up_dead_processes();
            bus
        } else {
            Self::create_empty(domain)?
        };
        bus.topic::<Scan>(take_over)?;
        bus.topic::<Odometry>(take_over)?;
        bus.topic::<Pose>(take_over)?;
        bus.topic::<Obstacles>(take_over)?;
        bus.topic::<Command>(take_over)?;
        bus.topic::<Actuation>(take_over)?;
        bus.topic::<Heartbeat>(take_over)?;
        bus.topic::<Directive>(take_over)?;
        bus.topic::<Checkpoint>(take_over)?;
        bus.topic::<Truth>(take_over)?;
        allocate_files(domain)?;
        Ok(bus)
    }

    /// A system without topics, for tools that create their own with [`Bus::create_topic_for`].
    ///
    /// # Errors
    /// As [`Bus::create`].
    pub fn create_empty(domain: &Domain) -> Result<Self, RuntimeError> {
        management::create(domain)?;
        let bus = Self::join(domain, "orchestrator", Bells::create(domain)?)?;
        layouts::write(domain)?;
        Ok(bus)
    }

    /// Joins the system as `name`; services are opened, never created.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room for its ports, and [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn open(domain: &Domain, name: &str) -> Result<Self, RuntimeError> {
        Self::join(domain, name, Bells::open(domain)?)
    }

    fn join(domain: &Domain, name: &str, bells: Arc<Bells>) -> Result<Self, RuntimeError> {
        // The processes that run make their ends of its connections: without room they would be ended by SIGBUS.
        require_room(None)?;
        Ok(Self { domain: domain.clone(), node: node(name, &domain.config()?)?, bells, held: Vec::new() })
    }

    /// Allocates what the ports that were opened until now have in shared memory, so that none of them runs out of it
    /// later. To be called once the ports of a process are open.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room.
    pub fn allocate(&self) -> Result<(), RuntimeError> {
        allocate_files(&self.domain)
    }

    /// Frees what processes that died have left on the bus; returns how many were cleaned up.
    pub fn clean_up_dead_processes(&self) -> u64 {
        remove_empty_files(&self.domain);
        self.node.try_cleanup_dead_nodes().cleanups
    }

    /// Creates the service for payloads beside a topic, see [`crate::BlobOutput`]: the orchestrator of a bench.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn create_blobs(&mut self, topic: Topic) -> Result<(), RuntimeError> {
        let created = self
            .node
            .service_builder(&blob_name(topic)?)
            .publish_subscribe::<[u8]>()
            .max_publishers(2)
            .max_subscribers(4)
            .subscriber_max_buffer_size(4)
            .subscriber_max_borrowed_samples(2)
            .history_size(0)
            .enable_safe_overflow(true)
            .max_nodes(NODES)
            .create()
            .map_err(|reason| RuntimeError::bus(format!("create payloads of topic {topic}"), reason))?;
        self.held.push(Box::new(created));
        Ok(())
    }

    pub(crate) fn blob_publisher(&self, topic: Topic, bytes: usize) -> Result<BlobPublisher, RuntimeError> {
        let created = self
            .blobs(topic)?
            .publisher_builder()
            .initial_max_slice_len(bytes)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create();
        created.map_err(|reason| RuntimeError::bus(format!("write payloads of topic {topic}"), reason))
    }

    pub(crate) fn blob_subscriber(&self, topic: Topic) -> Result<BlobSubscriber, RuntimeError> {
        let created = self.blobs(topic)?.subscriber_builder().create();
        created.map_err(|reason| RuntimeError::bus(format!("read payloads of topic {topic}"), reason))
    }

    pub(crate) fn publisher<S: Sample>(&self) -> Result<(WirePublisher<S>, Samples<S>), RuntimeError> {
        let service = self.samples::<S>()?;
        let publisher = service
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|reason| RuntimeError::bus(format!("write topic {}", S::TOPIC), reason))?;
        Ok((publisher, service))
    }

    pub(crate) fn subscriber<S: Sample>(&self) -> Result<WireSubscriber<S>, RuntimeError> {
        let service = self.samples::<S>()?;
        service
            .subscriber_builder()
            .history_request(quality(S::TOPIC).history)
            .create()
            .map_err(|reason| RuntimeError::bus(format!("read topic {}", S::TOPIC), reason))
    }

    /// The doorbells of the system.
    pub(crate) fn bells(&self) -> &Arc<Bells> {
        &self.bells
    }

    /// The event service of a topic.
    pub(crate) fn events(&self, topic: Topic) -> Result<Events, RuntimeError> {
        let name = service_name(topic)?;
        let open = || self.node.service_builder(&name).event().open();
        retry(open).map_err(|reason| RuntimeError::bus(format!("open events of topic {topic}"), reason))
    }

    /// Creates the topic of `S` with room for `readers` instead of the usual number, because large samples times many
    /// readers are much memory; keeps it for as long as the value lives.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn create_topic_for<S: Sample>(&mut self, readers: usize) -> Result<(), RuntimeError> {
        self.sized_topic::<S>(Quality { subscribers: readers, ..quality(S::TOPIC) }, false)
    }

    fn topic<S: Sample>(&mut self, take_over: bool) -> Result<(), RuntimeError> {
        self.sized_topic::<S>(quality(S::TOPIC), take_over)
    }

    fn sized_topic<S: Sample>(&mut self, quality: Quality, take_over: bool) -> Result<(), RuntimeError> {
        let name = service_name(S::TOPIC)?;
        let samples = || {
            self.node
                .service_builder(&name)
                .publish_subscribe::<Wire<S>>()
                .max_publishers(quality.publishers)
                .max_subscribers(quality.subscribers)
                .subscriber_max_buffer_size(quality.buffer)
                .subscriber_max_borrowed_samples(quality.borrowed)
                .history_size(quality.history)
                .enable_safe_overflow(true)
                .max_nodes(NODES)
        };
        let events = || {
            self.node
                .service_builder(&name)
                .event()
                .max_notifiers(EVENT_PORTS)
                .max_listeners(EVENT_PORTS)
                .max_nodes(NODES)
                .event_id_max_value(15)
        };
        let (samples, events) = if take_over {
            let error = |reason: &dyn std::fmt::Debug| {
                RuntimeError::bus(format!("take over topic {}", S::TOPIC), reason)
            };
            (
                retry(|| samples().open_or_create()).map_err(|reason| error(&reason))?,
                retry(|| events().open_or_create()).map_err(|reason| error(&reason))?,
            )
        } else {
            let error = |reason: &dyn std::fmt::Debug| {
                RuntimeError::bus(format!("create topic {}", S::TOPIC), reason)
            };
            (
                samples().create().map_err(|reason| error(&reason))?,
                events().create().map_err(|reason| error(&reason))?,
            )
        };
        self.held.push(Box::new(samples));
        self.held.push(Box::new(events));
        Ok(())
    }

    fn samples<S: Sample>(&self) -> Result<Samples<S>, RuntimeError> {
        let name = service_name(S::TOPIC)?;
        let open = || self.node.service_builder(&name).publish_subscribe::<Wire<S>>().open();
        retry(open).map_err(|reason| RuntimeError::bus(format!("open topic {}", S::TOPIC), reason))
    }

    fn blobs(&self, topic: Topic) -> Result<Blobs, RuntimeError> {
        let name = blob_name(topic)?;
        let open = || self.node.service_builder(&name).publish_subscribe::<[u8]>().open();
        retry(open).map_err(|reason| RuntimeError::bus(format!("open payloads of topic {topic}"), reason))
    }
}

/// A node of the bus.
pub(crate) fn node(name: &str, config: &Config) -> Result<Node<ipc::Service>, RuntimeError> {
    set_log_level_from_env_or(LogLevel::Fatal);
    let name = NodeName::new(name).map_err(|reason| RuntimeError::bus("name a node", reason))?;
    let node = NodeBuilder::new()
        .name(&name)
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>();
    node.map_err(|reason| RuntimeError::bus("join the bus", reason))
}

fn service_name(topic: Topic) -> Result<ServiceName, RuntimeError> {
    ServiceName::new(topic.name()).map_err(|reason| RuntimeError::bus("name a topic", reason))
}

fn blob_name(topic: Topic) -> Result<ServiceName, RuntimeError> {
    let name = format!("{}-payload", topic.name());
    ServiceName::new(&name).map_err(|reason| RuntimeError::bus("name a payload", reason))
}

/// Opening can collide with a clean-up by another process; that passes.
fn retry<T, E>(mut open: impl FnMut() -> Result<T, E>) -> Result<T, E> {
    let started = Instant::now();
    loop {
        match open() {
            Err(_) if started.elapsed() < OPEN_RETRY => std::thread::sleep(Duration::from_millis(5)),
            result => return result,
        }
    }
}
