//! The bridge of one host: the topics that cross, the probe of clocks, and messages to and from agents.

use std::collections::BTreeMap;
use std::os::unix::net::UnixDatagram;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use runtime::{
    Domain, HUB, LINK_SOCKET, LinkStatus, LinkTable, LinkedHost, Shutdown, boottime_ns, monotonic_ns,
    reply_socket,
};
use zenoh::Wait;
use zenoh::qos::Priority;

use crate::clock::Probe;
use crate::flows::{Flows, Tables, topics_of};
use crate::inbox::Registration;
use crate::link::Link;
use crate::network::{self, Network, Place, agent_key, clock_key, status_key, table_key};
use crate::refusals;
use crate::standstill::Standstill;

/// Time between two probes of clocks, and until the clock is locked.
const PROBE: Duration = Duration::from_millis(100);
const PROBE_AT_START: Duration = Duration::from_millis(20);
/// Time between two reports.
const REPORT: Duration = Duration::from_millis(100);
/// A host that has reported nothing for this long is not connected [ns].
const SILENT_NS: u64 = 1_000_000_000;
/// Largest message of a process to an agent [bytes].
const MESSAGE_BYTES: usize = 1 << 20;

/// A running bridge; it ends when dropped.
pub(crate) struct Bridge {
    pub(crate) link: Arc<Link>,
    flows: Arc<Mutex<Flows>>,
    threads: Vec<JoinHandle<()>>,
    subscribers: Vec<Registration>,
}

impl Bridge {
    /// Starts to forward the topics of the table between the bus of `domain` and the network.
    ///
    /// # Errors
    /// Unknown topics, what Zenoh refuses, and errors of the bus.
    pub(crate) fn start(session: &Network, domain: &Domain, table: &LinkTable) -> anyhow::Result<Self> {
        let link = Arc::new(Link::new(table));
        let flows = Arc::new(Mutex::new(Flows::new(&link, session, domain)));
        let mut bridge = Self { link, flows, threads: Vec::new(), subscribers: Vec::new() };
        bridge.extend(&table.receives, &table.sends)?;
        match table.here == HUB {
            true => bridge.answer_clocks(session)?,
            false => {
                bridge.follow_clock(session)?;
                bridge.follow_topics(session)?;
            }
        }
        Ok(bridge)
    }

    /// Has further topics cross; those that do already are left alone.
    ///
    /// # Errors
    /// As [`Bridge::start`].
    pub(crate) fn extend(&self, receives: &[String], sends: &[String]) -> anyhow::Result<()> {
        self.flows.lock().unwrap_or_else(PoisonError::into_inner).extend(receives, sends)
    }

    fn spawn(&mut self, work: impl FnOnce() -> anyhow::Result<()> + Send + 'static) {
        self.threads.push(self.link.spawn(work));
    }

    /// Answers the question of each host for the time.
    fn answer_clocks(&mut self, session: &Network) -> anyhow::Result<()> {
        let (asked, open) = (clock_key(&self.link.table.run_id, "ask", "*"), session.clone());
        let run_id = self.link.table.run_id.clone();
        let hosts: Vec<String> = self.link.table.peers.iter().map(|peer| peer.name.clone()).collect();
        let mut answers = BTreeMap::new();
        self.subscribers.push(session.subscribe(asked, move |key, question| {
            let received_ns = monotonic_ns();
            let host = key.rsplit('/').next().unwrap_or_default().to_owned();
            let Some(sent) = question.first_chunk::<8>().filter(|_| hosts.contains(&host)) else { return };
            if !answers.contains_key(&host) {
                match open.publisher(clock_key(&run_id, "answer", &host), Priority::RealTime) {
                    Ok(made) => drop(answers.insert(host.clone(), made)),
                    Err(_) => return,
                }
            }
            if let Some(answer) = answers.get(&host) {
                let stamps = [u64::from_le_bytes(*sent), received_ns, monotonic_ns()];
                let _ = answer.put(stamps.map(u64::to_le_bytes).concat()).wait();
            }
        }));
        Ok(())
    }

    /// Has topics cross as the orchestrator's link says: a role that moves needs others.
    fn follow_topics(&mut self, session: &Network) -> anyhow::Result<()> {
        let LinkTable { run_id, here, .. } = &self.link.table;
        let (into, tables) = sync_channel(1);
        self.subscribers.push(session.subscribe(table_key(run_id, here), move |_, text| {
            // It is repeated.
            let _ = into.try_send(text.to_vec());
        }));
        let (shared, flows) = (Arc::clone(&self.link), Arc::clone(&self.flows));
        self.spawn(move || {
            let mut is_told = false;
            while shared.is_running() {
                let Ok(text) = tables.recv_timeout(REPORT) else { continue };
                if let Some((receives, sends)) = std::str::from_utf8(&text).ok().and_then(topics_of) {
                    flows.lock().unwrap_or_else(PoisonError::into_inner).extend(&receives, &sends)?;
                } else if !std::mem::replace(&mut is_told, true) {
                    let message = "refused a list of topics of the orchestrator: one of them is unknown here";
                    runtime::print(runtime::Priority::Warning, message);
                }
            }
            Ok(())
        });
        Ok(())
    }

    /// Asks for the time, and reports what was found.
    fn follow_clock(&mut self, session: &Network) -> anyhow::Result<()> {
        let LinkTable { run_id, here, .. } = self.link.table.clone();
        let shared = Arc::clone(&self.link);
        self.subscribers.push(session.subscribe(clock_key(&run_id, "answer", &here), move |_, stamps| {
            let returned_ns = monotonic_ns();
            let stamp =
                |index: usize| stamps.get(8 * index..)?.first_chunk().map(|bytes| u64::from_le_bytes(*bytes));
            if let (Some(sent_ns), Some(received_ns), Some(answered_ns)) = (stamp(0), stamp(1), stamp(2))
                && let Some(mut followed) = shared.clock.following()
            {
                shared.note_answer(returned_ns);
                followed.clock.probe(Probe { sent_ns, received_ns, answered_ns, returned_ns });
            }
        }));
        let question = session.publisher(clock_key(&run_id, "ask", &here), Priority::RealTime)?;
        let report = session.publisher(status_key(&run_id, &here), Priority::InteractiveHigh)?;
        let shared = Arc::clone(&self.link);
        self.spawn(move || {
            let (mut reported_ns, mut standstill) = (0, Standstill::default());
            while shared.is_running() {
                let _ = question.put(monotonic_ns().to_le_bytes().as_slice()).wait();
                let status = shared.status();
                let pause = if status.is_locked { PROBE } else { PROBE_AT_START };
                std::thread::sleep(pause);
                if standstill.wake(boottime_ns(), pause.as_nanos() as u64).is_some() {
                    shared.note_standstill(standstill.lost_ms());
                }
                if monotonic_ns().saturating_sub(reported_ns) >= REPORT.as_nanos() as u64 {
                    reported_ns = monotonic_ns();
                    let _ = report.put(status.to_text()).wait();
                }
            }
            Ok(())
        });
        Ok(())
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.link.end();
        self.threads.drain(..).for_each(|thread| _ = thread.join());
        self.subscribers.clear();
        self.flows.lock().unwrap_or_else(PoisonError::into_inner).join();
    }
}

/// Runs the link of the orchestrator's host until the system ends.
///
/// # Errors
/// What Zenoh refuses, and errors of the bus.
pub(crate) fn run_hub(domain: &Domain, table: &LinkTable) -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let endpoints = table.peers.iter().map(|peer| peer.endpoint.as_str()).collect();
    let session = network::join(&Place::Hub(endpoints), table.credentials.as_deref())?;
    let bridge = Bridge::start(&session, domain, table)?;
    let heard: Arc<Mutex<BTreeMap<String, (u64, LinkedHost)>>> = Arc::default();
    let reports = Arc::clone(&heard);
    let known: Vec<String> = table.peers.iter().map(|peer| peer.name.clone()).collect();
    let _reports = session.subscribe(status_key(&table.run_id, "*"), move |_, text| {
        let host = std::str::from_utf8(text).ok().and_then(LinkedHost::of_text);
        // A peer can name any host.
        if let Some(host) = host.filter(|host| known.contains(&host.name)) {
            let mut reports = reports.lock().unwrap_or_else(PoisonError::into_inner);
            reports.insert(host.name.clone(), (monotonic_ns(), host));
        }
    });
    // What agents answer goes to the process that stands for the one there.
    let (answers, folder) = (UnixDatagram::unbound()?, domain.directory().to_owned());
    let _answers = session.subscribe(agent_key("*", "up"), move |_, message| {
        let number =
            message.split(|byte| *byte == b'\n').next().and_then(|line| std::str::from_utf8(line).ok());
        if let Some(incarnation) = number.and_then(|line| line.parse::<u32>().ok()) {
            let text = message.splitn(2, |byte| *byte == b'\n').nth(1).unwrap_or_default();
            // A process that has ended has no socket.
            let _ = answers.send_to(text, folder.join(reply_socket(incarnation)));
        }
    });
    let path = domain.directory().join(LINK_SOCKET);
    let _ = std::fs::remove_file(&path);
    let orders = UnixDatagram::bind(&path)?;
    orders.set_read_timeout(Some(Duration::from_millis(20)))?;
    let mut agents = BTreeMap::new();
    for peer in &table.peers {
        agents.insert(
            peer.name.clone(),
            session.publisher(agent_key(&peer.name, "down"), Priority::InteractiveHigh)?,
        );
    }
    let tables = Tables::new(&session, table)?;
    let (mut message, mut written_ns, mut standstill) = (vec![0; MESSAGE_BYTES], 0, Standstill::default());
    while !shutdown.requested() && bridge.link.is_running() && domain.is_current() {
        if let Ok(length) = orders.recv(&mut message) {
            let mut parts = message[..length].splitn(2, |byte| *byte == b'\n');
            let host = parts.next().and_then(|name| std::str::from_utf8(name).ok());
            if let (Some(agent), Some(text)) = (host.and_then(|name| agents.get(name)), parts.next()) {
                let _ = agent.put(text).wait();
            }
        }
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(written_ns) >= REPORT.as_nanos() as u64 {
            written_ns = now_ns;
            if standstill.wake(boottime_ns(), REPORT.as_nanos() as u64).is_some() {
                bridge.link.note_standstill(standstill.lost_ms());
            }
            if let Some(table) = LinkTable::read(domain)? {
                bridge.extend(&table.receives, &table.sends)?;
                tables.publish(&table);
            }
            status_of(&bridge.link, &heard.lock().unwrap_or_else(PoisonError::into_inner), now_ns)
                .write(domain)?;
        }
    }
    Ok(())
}

fn status_of(link: &Link, heard: &BTreeMap<String, (u64, LinkedHost)>, now_ns: u64) -> LinkStatus {
    let hosts = link.table.peers.iter().map(|peer| {
        let host = match heard.get(&peer.name) {
            Some((at_ns, host)) => {
                let is_connected = now_ns.saturating_sub(*at_ns) < SILENT_NS;
                LinkedHost { is_connected, ..host.clone() }
            }
            None => LinkedHost { name: peer.name.clone(), ..LinkedHost::default() },
        };
        let refused = refusals::reason_at(&peer.endpoint).filter(|_| !host.is_connected);
        LinkedHost { refused: refused.unwrap_or_default(), ..host }
    });
    LinkStatus {
        written_ns: now_ns,
        stood_still_ms: link.stood_still_ms(),
        counts: link.counters.get(),
        losses: link.losses.recent(now_ns),
        hosts: hosts.collect(),
    }
}
