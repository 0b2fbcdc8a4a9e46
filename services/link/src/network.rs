//! Zenoh as the link uses it: its configuration, and the names under which things travel.

use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::Arc;

use anyhow::anyhow;
use shared_types::Topic;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;
use zenoh::{Config, Session, Wait};

use crate::inbox::{Inbox, Registration};

/// Files of a host.
pub(crate) const AUTHORITY: &str = "authority.pem";
pub(crate) const CERTIFICATE: &str = "certificate.pem";
pub(crate) const KEY: &str = "key.pem";

/// Name and value of the variable from which Zenoh takes its threads, at the start of a process only. By default a sample
/// that arrives passes through three of them; with one for all of reading it wakes a stage without another switch. Writing has
/// its own: a reader that writes would wait for itself.
const THREADS: (&str, &str) = ("ZENOH_RUNTIME", "(rx: (handover: acc), app: (handover: acc))");

/// Largest message that is put together [bytes]: several times the largest sample.
const MAX_MESSAGE_BYTES: usize = 16 << 20;

/// A peer that has sent nothing for this long is gone [ms]. Until then the other end of a connection that has failed refuses
/// a new one, so that an outage costs this time at least.
const LEASE_MS: u32 = 1_000;

/// An attempt to connect takes this long at most [ms]. Its datagrams may be lost in an outage; the next one comes after it.
const OPEN_MS: u32 = 1_000;

/// Places in each queue of the network, as many as it allows.
const MAX_QUEUE: u32 = 16;
/// A sample waits this long for a place at most [us].
const WAIT_BEFORE_DROP_US: u32 = 5_000;

/// Where this end of the network is.
pub(crate) enum Place<'a> {
    /// It connects to these endpoints.
    Hub(Vec<&'a str>),
    /// It listens at this one.
    Agent(&'a str),
}

/// What the names of all messages begin with.
const NAMES: &str = "scanloop/**";

/// A network that was joined.
#[derive(Clone)]
pub(crate) struct Network {
    session: Session,
    inbox: Inbox,
    // Held until the end.
    _subscriber: Arc<Subscriber<()>>,
}

/// Starts this program again in place, with the variable of Zenoh's threads set, unless someone has set it.
///
/// # Errors
/// Those of the kernel.
pub(crate) fn set_threads() -> anyhow::Result<()> {
    if std::env::var_os(THREADS.0).is_some() {
        return Ok(());
    }
    let mut arguments = std::env::args_os();
    let mut again = Command::new(std::env::current_exe()?);
    again.arg0(arguments.next().as_deref().unwrap_or(OsStr::new(env!("CARGO_PKG_NAME"))));
    Err(again.args(arguments).env(THREADS.0, THREADS.1).exec().into())
}

/// Joins the network. A hub retries for ever; an agent fails if its address is not one of this machine.
///
/// # Errors
/// What Zenoh refuses, as a sentence.
pub(crate) fn join(place: &Place<'_>, credentials: Option<&str>) -> anyhow::Result<Network> {
    let (listen, connect) = match place {
        Place::Hub(endpoints) => (Vec::new(), endpoints.clone()),
        Place::Agent(endpoint) => (vec![*endpoint], Vec::new()),
    };
    let mut settings = vec![
        // Peers would expect a connection between each two; routers forward for each other, through the hub.
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("{listen:?}")),
        ("connect/endpoints", format!("{connect:?}")),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        (
            "connect/retry",
            "{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 }".to_owned(),
        ),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("transport/link/rx/max_message_size", MAX_MESSAGE_BYTES.to_string()),
        ("transport/unicast/open_timeout", OPEN_MS.to_string()),
        ("transport/unicast/accept_timeout", OPEN_MS.to_string()),
        ("transport/link/tx/queue/batching/enabled", "false".to_owned()),
        // Each sample takes a place, a large one several: the samples of a few scans fit.
        ("transport/link/tx/queue/size/real_time", MAX_QUEUE.to_string()),
        ("transport/link/tx/queue/size/interactive_high", MAX_QUEUE.to_string()),
        ("transport/link/tx/queue/size/data_high", MAX_QUEUE.to_string()),
        ("transport/link/tx/queue/size/data", MAX_QUEUE.to_string()),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", WAIT_BEFORE_DROP_US.to_string()),
    ];
    if let Some(folder) = credentials {
        let file = |name: &str| format!("{:?}", format!("{folder}/{name}"));
        settings.extend([
            ("transport/link/tls/root_ca_certificate", file(AUTHORITY)),
            ("transport/link/tls/listen_certificate", file(CERTIFICATE)),
            ("transport/link/tls/listen_private_key", file(KEY)),
            ("transport/link/tls/connect_certificate", file(CERTIFICATE)),
            ("transport/link/tls/connect_private_key", file(KEY)),
            ("transport/link/tls/enable_mtls", "true".to_owned()),
            ("transport/link/tls/verify_name_on_connect", "true".to_owned()),
        ]);
    }
    let mut config = Config::default();
    for (key, value) in settings {
        config.insert_json5(key, &value).map_err(|error| anyhow!("{key} = {value}: {error}"))?;
    }
    let session = zenoh::open(config).wait().map_err(|error| match place {
        Place::Agent(endpoint) => anyhow!("it can't listen at {endpoint}: {error}"),
        Place::Hub(_) => anyhow!("{error}"),
    })?;
    let inbox = Inbox::default();
    let shared = inbox.clone();
    let subscriber = session
        .declare_subscriber(NAMES)
        .allowed_origin(Locality::Remote)
        .callback(move |sample| shared.take(sample.key_expr().as_str(), &sample.payload().to_bytes()));
    let subscriber = Arc::new(subscriber.wait().map_err(|error| anyhow!("{error}"))?);
    Ok(Network { session, inbox, _subscriber: subscriber })
}

impl Network {
    /// The writing end of a name. Nothing waits: what does not fit into the queue is dropped.
    ///
    /// # Errors
    /// What Zenoh refuses.
    pub(crate) fn publisher(&self, key: String, priority: Priority) -> anyhow::Result<Publisher<'static>> {
        let publisher = self.session.declare_publisher(key).congestion_control(CongestionControl::Drop);
        publisher.priority(priority).express(true).wait().map_err(|error| anyhow!("{error}"))
    }

    /// Calls `each` with the name and the bytes of all that comes under names that fit a pattern ([`Inbox::add`]).
    pub(crate) fn subscribe(
        &self,
        key: String,
        each: impl FnMut(&str, &[u8]) + Send + 'static,
    ) -> Registration {
        self.inbox.add(key, each)
    }

    /// Whether another host is connected.
    pub(crate) fn is_connected(&self) -> bool {
        self.session.info().routers_zid().wait().next().is_some()
    }

    /// When something came from another host last [ns]; 0 before.
    pub(crate) fn heard_ns(&self) -> u64 {
        self.inbox.heard_ns()
    }
}

/// The name of a topic of a run. It contains the layout, so samples of another one never arrive.
pub(crate) fn topic_key(run_id: &str, topic: Topic, from: &str) -> String {
    format!("scanloop/{run_id}/topic/{topic}/{:08x}/{from}", topic.layout())
}

/// The name under which a host asks for the time, and gets answers.
pub(crate) fn clock_key(run_id: &str, what: &str, host: &str) -> String {
    format!("scanloop/{run_id}/clock/{what}/{host}")
}

/// The name under which a host is told which topics cross there.
pub(crate) fn table_key(run_id: &str, host: &str) -> String {
    format!("scanloop/{run_id}/table/{host}")
}

/// The name under which a host reports.
pub(crate) fn status_key(run_id: &str, host: &str) -> String {
    format!("scanloop/{run_id}/status/{host}")
}

/// The name under which an agent is told what to do (`down`), and answers (`up`).
pub(crate) fn agent_key(host: &str, way: &str) -> String {
    format!("scanloop/agent/{host}/{way}")
}
