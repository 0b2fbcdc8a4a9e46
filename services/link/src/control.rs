//! The link of an agent: messages between its standard streams and the network, and a bridge once there is a system.
//!
//! The agent writes `join SYSTEM_ID` when it has made the bus and the table of the link, and `up TEXT`; it reads
//! `down TEXT`, and `clock OFFSET_NS BOUND_NS SILENT_MS` or `clock unknown` ten times a
//! second. At the end of its input the link
//! ends: an agent that was killed takes its link with it.

use std::io::{BufRead, Write};
use std::time::Duration;

use anyhow::Context;
use runtime::{Domain, LinkTable};
use zenoh::Wait;
use zenoh::qos::Priority;

use crate::arguments::run_by;
use crate::bridge::Bridge;
use crate::network::{Place, agent_key, join, publisher, subscribe};

/// Runs until the standard input ends.
///
/// # Errors
/// What Zenoh refuses, a system that does not exist, and errors of the bus.
pub(crate) fn run_agent(name: &str, endpoint: &str, credentials: Option<&str>) -> anyhow::Result<()> {
    let session = join(&Place::Agent(endpoint), credentials)?;
    say("listening");
    let _orders = subscribe(&session, agent_key(name, "down"), |_, text| {
        if let Ok(text) = std::str::from_utf8(text) {
            say(&format!("down {}", text.replace('\n', " ")));
        }
    })?;
    let answers = publisher(&session, agent_key(name, "up"), Priority::InteractiveHigh)?;
    let mut bridge: Option<Bridge> = None;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        match line.split_once(' ') {
            Some(("join", system_id)) => {
                let domain = Domain::existing(system_id)?;
                let table = LinkTable::read(&domain)?.context("the system has no table of its link")?;
                run_by(&table.realtime);
                let made = Bridge::start(&session, &domain, &table)?;
                let link = std::sync::Arc::clone(&made.link);
                std::thread::spawn(move || {
                    while link.is_running() {
                        if link.is_lost() {
                            runtime::print(
                                runtime::Priority::Error,
                                "error: nothing comes from the orchestrator, starting anew",
                            );
                            std::process::exit(1);
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

/// One line for the agent; when that is gone, the input ends too.
fn say(line: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}
