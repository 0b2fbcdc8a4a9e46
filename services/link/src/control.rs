//! The link of an agent: messages between its standard streams and the network, and a bridge once there is a system.
//!
//! The agent writes `join SYSTEM_ID` when it has made the bus and the table of the link, and `up TEXT`; it reads
//! `down TEXT`, and `clock OFFSET_NS BOUND_NS SILENT_MS` or `clock unknown` ten times a
//! second. At the end of its input the link
//! ends: an agent that was killed takes its link with it.

use std::io::{BufRead, Write};
use std::time::Duration;

use anyhow::Context;
use runtime::{Domain, LinkTable, monotonic_ns};
use zenoh::Wait;
use zenoh::qos::Priority;

use crate::bridge::Bridge;
use crate::listener::Listener;
use crate::network::{Network, Place, agent_key, join};
use crate::threads::run_by;

/// An orchestrator that is connected and from which nothing has come for this long does not know that this end listens [ns]:
/// its link sends something ten times a second.
const DEAF_NS: u64 = 1_500_000_000;

/// Runs until the standard input ends.
///
/// # Errors
/// What Zenoh refuses, a system that does not exist, and errors of the bus.
pub(crate) fn run_agent(name: &str, endpoint: &str, credentials: Option<&str>) -> anyhow::Result<()> {
    let session = join(&Place::Agent(endpoint), credentials)?;
    let listener = Listener::of(endpoint);
    say("listening");
    let _orders = session.subscribe(agent_key(name, "down"), |_, text| {
        if let Ok(text) = std::str::from_utf8(text) {
            say(&format!("down {}", text.replace('\n', " ")));
        }
    });
    let answers = session.publisher(agent_key(name, "up"), Priority::InteractiveHigh)?;
    let network = session.clone();
    std::thread::spawn(move || watch(&network, listener));
    let mut bridge: Option<Bridge> = None;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        match line.split_once(' ') {
            Some(("join", system_id)) => {
                let domain = Domain::existing(system_id)?;
                let table = LinkTable::read(&domain)?.context("the system has no table of its link")?;
                run_by(&table.realtime);
                let made = Bridge::start(&session, &domain, &table)?;
                let (link, network) = (std::sync::Arc::clone(&made.link), session.clone());
                std::thread::spawn(move || {
                    while link.is_running() {
                        if link.is_unanswered() && network.is_connected() {
                            start_anew("the orchestrator does not answer");
                        }
                        let status = link.status();
                        match status.is_locked {
                            true => say(&format!(
                                "clock {} {} {}",
                                status.offset_ns,
                                status.bound_ns,
                                link.silent_ms()
                            )),
                            false => say("clock unknown"),
                        }
                        std::thread::sleep(Duration::from_millis(100));
                    }
                });
                bridge = Some(made);
            }
            Some(("up", text)) => {
                let (incarnation, text) = text.split_once(' ').unwrap_or((text, ""));
                let _ = answers.put(format!("{incarnation}\n{text}")).wait();
            }
            _ => {}
        }
        if bridge.as_ref().is_some_and(|bridge| !bridge.link.is_running()) {
            anyhow::bail!("the bridge has ended");
        }
    }
    Ok(())
}

/// Ends this link where no other end can connect any more, or where the orchestrator is connected and nothing comes from it:
/// what it was told of this end was lost.
fn watch(network: &Network, mut listener: Option<Listener>) {
    let mut connected_ns: Option<u64> = None;
    loop {
        std::thread::sleep(Duration::from_millis(100));
        let now_ns = monotonic_ns();
        connected_ns = network.is_connected().then(|| connected_ns.unwrap_or(now_ns));
        let silent_ns = connected_ns.map(|since_ns| now_ns.saturating_sub(since_ns.max(network.heard_ns())));
        if silent_ns.is_some_and(|silent_ns| silent_ns > DEAF_NS) {
            start_anew("nothing comes from the orchestrator");
        }
        if listener.as_mut().is_some_and(Listener::is_stuck) {
            start_anew("the network is not read");
        }
    }
}

/// Ends this program; the agent starts it again.
fn start_anew(reason: &str) -> ! {
    runtime::print(runtime::Priority::Error, &format!("error: {reason}, starting anew"));
    std::process::exit(1);
}

/// One line for the agent; when that is gone, the input ends too.
fn say(line: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}
