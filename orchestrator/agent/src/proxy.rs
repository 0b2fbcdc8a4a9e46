//! The process that stands for one on another host: it ends as that one ends, and a signal to it reaches that one.

use std::os::unix::net::UnixDatagram;
use std::time::Duration;

use anyhow::Context;
use console::exit::{Exit, Failure};
use runtime::{
    CANDIDATE_VARIABLE, Domain, INCARNATION_VARIABLE, LINK_SOCKET, LinkStatus, LinkTable, Priority,
    RESTART_VARIABLE, ROLE_VARIABLE, Shutdown, Silence, StopWord, Wheels, link_version, monotonic_ns,
    own_settings_file, print, reply_socket, settings_file,
};
use rustix::process::{Signal, getpid, kill_process};
use shared_types::Role;

use crate::message::{Down, RemoteOrder, RemoteStart, RemoteState, Up, handover_of};

/// Time between two messages, and before the first answer [ns].
const REPEAT_NS: u64 = 100_000_000;
/// The same once the run was stopped: the command that stopped it waits for the wheels [ns].
const STOPPED_REPEAT_NS: u64 = 20_000_000;
const FIRST_REPEAT_NS: u64 = 50_000_000;
/// An agent that has not answered once within this time can't be reached [ns].
const REACH_NS: u64 = 8_000_000_000;
/// The same while a process is to be swapped, before the swap is refused for its silence [ns].
const REACH_IN_SWAP_NS: u64 = 2_500_000_000;
/// After `orphan_timeout_s` without an orchestrator the processes of a host end within this time, the robot last [ns].
const ORPHAN_END_NS: u64 = 2_000_000_000;
/// Longest sleep.
const POLL: Duration = Duration::from_millis(20);
/// Largest answer [bytes].
const ANSWER_BYTES: usize = 1 << 16;

/// Has the agent of `host` run an implementation for the role in the environment, until that ends.
///
/// # Errors
/// A process that was started by hand, an agent that can't be reached or refuses (exit code 4), and errors of sockets.
pub fn run(host: &str, implementation: &str) -> anyhow::Result<Exit> {
    let domain = Domain::of_this_process()?;
    let shutdown = Shutdown::on_signals()?;
    let incarnation: u32 =
        variable(INCARNATION_VARIABLE).and_then(|text| text.parse().ok()).context("no incarnation")?;
    let role: Role = variable(ROLE_VARIABLE).and_then(|text| text.parse().ok()).context("no role")?;
    let table = LinkTable::read(&domain)?.context("the system is on one host")?;
    let socket = UnixDatagram::bind(domain.directory().join(reply_socket(incarnation)))?;
    socket.set_read_timeout(Some(POLL))?;
    let mut down = Down {
        version: link_version(),
        system_id: domain.system_id().to_owned(),
        run_id: domain.run_id().to_owned(),
        incarnation,
        role,
        order: RemoteOrder::Start,
        stopped: false,
        start: Some(start_of(&domain, &table, host, role, incarnation, implementation)?),
    };
    let stop_word = StopWord::inherited()?;
    let ended_ns = table.orphan_timeout_ns.saturating_add(ORPHAN_END_NS);
    let begun_ns = monotonic_ns();
    let (mut heard_ns, mut sent_ns, mut is_known) = (begun_ns, 0, false);
    let mut silence = Silence::default();
    let reach_ns = if variable(CANDIDATE_VARIABLE).is_some() { REACH_IN_SWAP_NS } else { REACH_NS };
    let mut answer = vec![0; ANSWER_BYTES];
    loop {
        let now_ns = monotonic_ns();
        if !down.stopped && stop_word.as_ref().is_some_and(|word| !word.is_armed()) {
            (down.stopped, sent_ns) = (true, 0);
        }
        if shutdown.requested() && down.order != RemoteOrder::Terminate {
            (down.order, down.start, sent_ns) = (RemoteOrder::Terminate, None, 0);
            if !is_known {
                // Nothing was started, as far as is known here; an agent that did ends what it no longer is told about.
                return Ok(Exit::Done);
            }
        }
        let repeat_ns = match (down.stopped, is_known) {
            (true, _) => STOPPED_REPEAT_NS,
            (false, true) => REPEAT_NS,
            (false, false) => FIRST_REPEAT_NS,
        };
        if now_ns.saturating_sub(sent_ns) >= repeat_ns {
            if !domain.is_current() {
                // The system is gone, and its link with it; the agent ends what nothing speaks of any more.
                return Ok(Exit::Done);
            }
            let message = format!("{host}\n{}", serde_json::to_string(&down)?);
            // A link that is being started again has no socket for a moment.
            let _ = socket.send_to(message.as_bytes(), domain.directory().join(LINK_SOCKET));
            sent_ns = now_ns;
        }
        if !is_known && now_ns.saturating_sub(begun_ns) > reach_ns {
            let endpoint =
                table.peers.iter().find(|peer| peer.name == host).map_or("", |peer| &peer.endpoint);
            let status = LinkStatus::read(&domain).ok().flatten();
            let refused = status.as_ref().and_then(|status| status.host(host)).map(|host| &host.refused);
            if let Some(reason) = refused.filter(|reason| !reason.is_empty()) {
                return Err(Failure::process(format!("host {host}: refused: {endpoint}: {reason}")));
            }
            return Err(Failure::process(format!(
                "host {host}: no agent answers at {endpoint}; start `scanloop agent` there with the name, address and \
                 transport of the system file, and the same version of scanloop"
            )));
        }
        let silent_ns = silence.since(heard_ns, now_ns);
        if is_known && silent_ns > ended_ns {
            return Err(Failure::process(format!(
                "host {host}: nothing came from its agent for {:.1} s; by then its processes have ended",
                ended_ns as f64 * 1e-9
            )));
        }
        let Ok(length) = socket.recv(&mut answer) else { continue };
        let Ok(up) = serde_json::from_slice::<Up>(&answer[..length]) else { continue };
        if up.run_id != down.run_id || up.incarnation != incarnation {
            continue;
        }
        (is_known, heard_ns) = (true, monotonic_ns());
        // What it reported before it knew of a stop does not confirm that stop, also not one that has come just now.
        if let (Some(word), Some(wheels)) = (&stop_word, up.wheels)
            && up.stopped != word.is_armed()
        {
            word.report(role, Wheels::from(wheels));
        }
        match up.state {
            RemoteState::Running { .. } if down.order == RemoteOrder::Start => {
                (down.order, down.start) = (RemoteOrder::Run, None)
            }
            RemoteState::Running { .. } => {}
            RemoteState::Unknown => {
                return Err(Failure::process(format!(
                    "host {host}: its agent was started anew, and does not know it"
                )));
            }
            RemoteState::Refused { reason } => {
                return Err(Failure::process(format!("host {host}: {reason}")));
            }
            ended => {
                up.last_lines.iter().for_each(|line| print(Priority::Error, line));
                end_as(&ended);
            }
        }
    }
}

fn start_of(
    domain: &Domain,
    table: &LinkTable,
    host: &str,
    role: Role,
    incarnation: u32,
    implementation: &str,
) -> anyhow::Result<RemoteStart> {
    let folder = domain.folder();
    let own = own_settings_file(incarnation);
    let settings = folder.read_text(&if folder.contains(&own) { own } else { settings_file(role) })?;
    let peer =
        table.peers.iter().find(|peer| peer.name == host).context("the host has no row in the table")?;
    Ok(RemoteStart {
        implementation: implementation.to_owned(),
        restart: variable(RESTART_VARIABLE).as_deref() == Some("1"),
        candidate: variable(CANDIDATE_VARIABLE).and_then(|text| text.parse().ok()),
        period_ns: table.period_ns,
        realtime: table.realtime.clone(),
        settings,
        receives: peer.receives.clone(),
        sends: peer.sends.clone(),
        handover: handover_of(domain, role)?,
    })
}

/// Ends this process as the other one has ended.
fn end_as(state: &RemoteState) -> ! {
    if let RemoteState::Killed { signal } = state
        && let Some(signal) = Signal::from_named_raw(*signal)
    {
        // Those that this process handles would only set a flag.
        let signal = if [Signal::TERM, Signal::INT].contains(&signal) { Signal::KILL } else { signal };
        let _ = kill_process(getpid(), signal);
    }
    std::process::exit(if let RemoteState::Exited { code } = state { *code } else { Exit::Internal as i32 })
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok()
}
