//! The services of one system on iceoryx2: created in one place, opened everywhere else.
//!
//! Only the orchestrator creates topics. So no process can create one with other sizes, and the order of starts does
//! not matter. A service lives as long as any process has it open, so it outlives the orchestrator that created it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::prelude::{Node, ServiceName, ipc};
use iceoryx2::service::port_factory::event;
use shared_types::{Sample, SampleType, TOPICS, Topic};

use crate::bell::Bells;
use crate::enclosed::Enclosed;
use crate::own::OwnTopics;
use crate::port::{self, BytePublisher, ByteSubscriber, Queue, Samples, Shape};
use crate::qos::{EVENT_PORTS, NODES, Qos, qos};
use crate::reserve::{Reserve, allocate_files, remove_empty_files, require_room};
use crate::{Domain, RuntimeError, layouts, node};

pub(crate) type Events = event::PortFactory<ipc::Service>;

/// How long to retry opening a service that another process is cleaning up.
const OPEN_RETRY: Duration = Duration::from_secs(5);

/// One process's access to the services of its system.
#[derive(Debug)]
pub struct Bus {
    domain: Domain,
    node: Enclosed<Node<ipc::Service>>,
    bells: Arc<Bells>,
    /// Services that exist as long as this value.
    held: Vec<Enclosed<(Samples, Option<Events>)>>,
}

impl Bus {
    /// Creates all services of the system and keeps them as long as the value lives: for the orchestrator. Queues of
    /// observers follow from the scan period.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when a system does not fit, [`RuntimeError::Bus`] when iceoryx2 refuses, and
    /// [`RuntimeError::File`] when the layouts of the samples can't be written.
    pub fn create(domain: &Domain, period_ns: u64) -> Result<Self, RuntimeError> {
        // Checked as a whole and freed at once; the services then take it piece by piece.
        let own = OwnTopics::of(domain)?.map_or(Ok(0), |table| table.bytes())?;
        Reserve::require_files()?;
        Reserve::take(Reserve::of_a_system(period_ns) + own)?;
        Self::create_empty(domain)?.with_topics(period_ns, false)
    }

    /// Opens the services of an orphaned system, and creates those that no process keeps open.
    ///
    /// # Errors
    /// [`RuntimeError::Layout`] when the system was built against other samples, and [`RuntimeError::Bus`] when
    /// iceoryx2 refuses.
    pub fn take_over(domain: &Domain, period_ns: u64) -> Result<Self, RuntimeError> {
        let bus = Self::join(domain, "orchestrator", Bells::create(domain)?)?;
        layouts::verify_all(domain)?;
        // The orchestrator that died still holds ports, of which there are few for directives.
        bus.clean_up_dead_processes();
        bus.with_topics(period_ns, true)
    }

    fn with_topics(mut self, period_ns: u64, take_over: bool) -> Result<Self, RuntimeError> {
        for topic in TOPICS {
            self.create_topic(&topic.sample_type().into(), qos(topic, period_ns), take_over)?;
        }
        if let Some(table) = OwnTopics::of(&self.domain)? {
            for row in &table.topic {
                self.create_topic(&row.shape()?.1, row.qos(), take_over)?;
            }
        }
        self.allocate()?;
        Ok(self)
    }

    /// A system without topics, for tools that create their own with [`Bus::create_topic_for`].
    ///
    /// # Errors
    /// As [`Bus::create`].
    pub fn create_empty(domain: &Domain) -> Result<Self, RuntimeError> {
        node::create_management(domain)?;
        let bus = Self::join(domain, "orchestrator", Bells::create(domain)?)?;
        layouts::write(domain)?;
        Ok(bus)
    }

    /// Joins the system as `name`; services are opened, never created.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room for its ports, and [`RuntimeError::Bus`] when iceoryx2
    /// refuses.
    pub fn open(domain: &Domain, name: &str) -> Result<Self, RuntimeError> {
        Self::join(domain, name, Bells::open(domain)?)
    }

    fn join(domain: &Domain, name: &str, bells: Arc<Bells>) -> Result<Self, RuntimeError> {
        // Running processes make their ends of its connections: without room SIGBUS would end them.
        require_room()?;
        let node = Enclosed::new(node::join(domain, name)?);
        Ok(Self { domain: domain.clone(), node, bells, held: Vec::new() })
    }

    /// Allocates the shared memory of all ports opened until now, so that none of them runs out of it later. Call it
    /// when the ports of a process are open.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room.
    pub fn allocate(&self) -> Result<(), RuntimeError> {
        allocate_files(&self.domain)
    }

    /// Frees what dead processes have left on the bus; returns how many were cleaned up.
    pub fn clean_up_dead_processes(&self) -> u64 {
        remove_empty_files(&self.domain);
        self.node.try_cleanup_dead_nodes().cleanups
    }

    /// Whether a process has opened the topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn has_publisher(&self, topic: Topic) -> Result<bool, RuntimeError> {
        Ok(port::publishers(&self.open_samples(&topic.sample_type().into())?) > 0)
    }

    pub(crate) fn publisher(&self, of: &SampleType) -> Result<BytePublisher, RuntimeError> {
        self.publisher_of(&of.into())
    }

    /// The reading end of a topic of the loop, with the queue of a process or the longest that the topic allows.
    pub(crate) fn subscriber(&self, of: &SampleType, queue: Queue) -> Result<ByteSubscriber, RuntimeError> {
        let history = qos(of.topic, u64::MAX).history;
        self.subscriber_of(&of.into(), queue, history)
    }

    /// The writing end of any topic.
    pub(crate) fn publisher_of(&self, of: &Shape) -> Result<BytePublisher, RuntimeError> {
        let created = BytePublisher::new(self.open_samples(of)?);
        created.map_err(|reason| RuntimeError::bus(format!("write topic {}", of.topic), reason))
    }

    /// The reading end of any topic, which gets so many earlier samples.
    pub(crate) fn subscriber_of(
        &self,
        of: &Shape,
        queue: Queue,
        history: usize,
    ) -> Result<ByteSubscriber, RuntimeError> {
        let created = ByteSubscriber::new(&self.open_samples(of)?, of, queue, history);
        created.map_err(|reason| RuntimeError::bus(format!("read topic {}", of.topic), reason))
    }

    /// The doorbells of the system.
    pub(crate) fn bells(&self) -> &Arc<Bells> {
        &self.bells
    }

    /// The event service of a topic.
    pub(crate) fn events(&self, topic: &str) -> Result<Events, RuntimeError> {
        let name = service_name(topic)?;
        let open = || self.node.service_builder(&name).event().open();
        retry(open).map_err(|reason| RuntimeError::bus(format!("open events of topic {topic}"), reason))
    }

    /// Creates the topic of `S` with room for `readers` instead of the usual number, which saves memory where samples
    /// are large; keeps it as long as the value lives.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn create_topic_for<S: Sample>(&mut self, readers: usize) -> Result<(), RuntimeError> {
        // No observer reads them: the shortest queues that a topic may have.
        let qos = Qos { subscribers: readers, ..qos(S::TOPIC, u64::MAX) };
        self.create_topic(&S::TYPE.into(), qos, false)
    }

    fn create_topic(&mut self, of: &Shape, qos: Qos, take_over: bool) -> Result<(), RuntimeError> {
        let (name, detail) = (service_name(&of.topic)?, port::of_samples(of)?);
        let samples = || {
            port::samples(&self.node, &name, &detail)
                .max_publishers(qos.publishers)
                .max_subscribers(qos.subscribers)
                .subscriber_max_buffer_size(qos.buffer)
                .subscriber_max_borrowed_samples(qos.borrowed)
                .history_size(qos.history)
                .enable_safe_overflow(true)
                .max_nodes(NODES)
        };
        let events = || {
            self.node
                .service_builder(&name)
                .event()
                .max_notifiers(EVENT_PORTS.max(qos.publishers))
                .max_listeners(EVENT_PORTS.max(qos.subscribers))
                .max_nodes(NODES)
                .event_id_max_value(15)
        };
        let verb = if take_over { "take over" } else { "create" };
        let error =
            |reason: &dyn std::fmt::Debug| RuntimeError::bus(format!("{verb} topic {}", of.topic), reason);
        let made = if take_over {
            (
                retry(|| samples().open_or_create()).map_err(|reason| error(&reason))?,
                retry(|| events().open_or_create()).map_err(|reason| error(&reason))?,
            )
        } else {
            (
                samples().create().map_err(|reason| error(&reason))?,
                events().create().map_err(|reason| error(&reason))?,
            )
        };
        self.held.push(Enclosed::new((made.0, Some(made.1))));
        Ok(())
    }

    fn open_samples(&self, of: &Shape) -> Result<Samples, RuntimeError> {
        let (name, detail) = (service_name(&of.topic)?, port::of_samples(of)?);
        let open = || port::samples(&self.node, &name, &detail).open();
        retry(open).map_err(|reason| RuntimeError::bus(format!("open topic {}", of.topic), reason))
    }

    /// The node of this process, for services of other types.
    pub(crate) fn node(&self) -> &Node<ipc::Service> {
        &self.node
    }
}

fn service_name(topic: &str) -> Result<ServiceName, RuntimeError> {
    ServiceName::new(topic).map_err(|reason| RuntimeError::bus("name a topic", reason))
}

/// Retries, because opening can collide with a clean-up by another process.
fn retry<T, E>(mut open: impl FnMut() -> Result<T, E>) -> Result<T, E> {
    let started = Instant::now();
    loop {
        match open() {
            Err(_) if started.elapsed() < OPEN_RETRY => std::thread::sleep(Duration::from_millis(5)),
            result => return result,
        }
    }
}
