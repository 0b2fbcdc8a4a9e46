//! The program `scanloop-link`: where it is, and the one that the orchestrator runs.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use anyhow::Context;
use console::answer;
use console::exit::{Exit, Failure};
use plan::System;
use plan::hosts::{Crossing, HostEntry, RolePlace, crossings_between, endpoint};
use runtime::{
    Domain, HUB, INCARNATION_VARIABLE, LinkLoss, LinkPeer, LinkStatus, LinkTable, LinkedHost,
    RUN_ID_VARIABLE, monotonic_ns,
};
use shared_types::Topic;
use supervision::child::{Child, Launch, other_program};
use supervision::child_log::ChildLog;

/// Name of the program.
const PROGRAM: &str = "scanloop-link";
/// Time between two looks at its status [ns].
const READ_NS: u64 = 50_000_000;
/// After this time all processes of a host that is connected again have sent heartbeats [ns].
const STEADY_NS: u64 = 1_000_000_000;
/// A status older than this says that the link does not run [ns].
const SILENT_NS: u64 = 1_000_000_000;

/// The link of the orchestrator's host.
pub struct HubLink {
    domain: Domain,
    table: LinkTable,
    log: Arc<ChildLog>,
    child: Option<Child>,
    status: LinkStatus,
    read_ns: u64,
    /// Since when samples come from a host without a break [ns].
    connected_ns: BTreeMap<String, u64>,
}

impl HubLink {
    /// Starts the link of a system whose bus exists, and whose roles are at `places`; `None` when its file names no host.
    ///
    /// # Errors
    /// A system without the program `scanloop-link` (exit code 2), and errors of the file system.
    pub fn start(
        domain: &Domain,
        system: &System,
        places: &[RolePlace<'_>],
        logs: &Path,
    ) -> anyhow::Result<Option<Self>> {
        if system.hosts.is_empty() {
            return Ok(None);
        }
        let credentials =
            system.credentials.as_deref().map(|folder| require_private(folder, HUB)).transpose()?;
        let mut table = LinkTable {
            here: HUB.to_owned(),
            run_id: domain.run_id().to_owned(),
            period_ns: system.period_ns(),
            orphan_timeout_ns: system.run_settings(false).orphan_timeout_ns,
            realtime: system.realtime.clone(),
            peers: system.hosts.iter().map(peer_of).collect(),
            credentials,
            ..LinkTable::default()
        };
        extend(&mut table, places);
        table.write(domain)?;
        let path = logs.join("link.log");
        let log = ChildLog::of_run(&path, true)?;
        log.begin(PROGRAM).with_context(|| path.display().to_string())?;
        let (domain, status) = (domain.clone(), LinkStatus::default());
        let mut link =
            Self { domain, table, log, child: None, status, read_ns: 0, connected_ns: BTreeMap::new() };
        link.launch()?;
        Ok(Some(link))
    }

    /// Has the topics cross that roles at `places` need. Those that crossed before still do.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn reach(&mut self, places: &[RolePlace<'_>]) -> anyhow::Result<()> {
        let before = self.table.clone();
        extend(&mut self.table, places);
        if self.table != before {
            self.table.write(&self.domain)?;
        }
        Ok(())
    }

    /// Whether a host has published the directive of that number, or a later one.
    pub fn has_directive(&self, host: &str, sequence: u64) -> bool {
        let is_there = |host: &LinkedHost| host.is_connected && host.directive >= sequence;
        self.status.host(host).is_some_and(is_there)
    }

    /// Starts the link again if it has ended, and reads its status; returns what a user should know.
    pub fn keep(&mut self) -> Vec<String> {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.read_ns) < READ_NS {
            return Vec::new();
        }
        self.read_ns = now_ns;
        let mut messages = Vec::new();
        if let Ok(Some(status)) = LinkStatus::read(&self.domain) {
            let before = std::mem::replace(&mut self.status, status);
            for host in &self.status.hosts {
                if host.is_connected && host.is_locked {
                    self.connected_ns.entry(host.name.clone()).or_insert(now_ns);
                } else {
                    self.connected_ns.remove(&host.name);
                }
            }
            let own = [before.stood_still_ms, self.status.stood_still_ms];
            messages.extend(standstill("this host", own));
            for host in &self.status.hosts {
                let own = before
                    .host(&host.name)
                    .map_or([0; 2], |before| [before.stood_still_ms, host.stood_still_ms]);
                messages.extend(standstill(&format!("host {}", host.name), own));
            }
            messages.extend(
                self.status.hosts.iter().filter_map(|host| self.change(before.host(&host.name), host)),
            );
        }
        let exit = self.child.as_mut().and_then(|child| child.try_wait().ok().flatten());
        if self.child.is_some() && exit.is_none() {
            return messages;
        }
        let lines = self.log.last_lines(2).unwrap_or_default().join(" | ");
        self.child = None;
        let again =
            self.launch().map_or_else(|error| format!("{error:#}"), |()| "it was started again".to_owned());
        let exit = exit.map_or_else(String::new, |exit| format!(": {exit}"));
        messages.push(format!("scanloop-link ended{exit} {lines}; {again}"));
        messages
    }

    /// What has changed at a host that matters to a user.
    fn change(&self, before: Option<&LinkedHost>, now: &LinkedHost) -> Option<String> {
        let name = &now.name;
        let is_wide = |host: &LinkedHost| host.is_locked && host.bound_ns > self.table.period_ns / 10;
        let (was_connected, was_wide) =
            before.map_or((false, false), |host| (host.is_connected, is_wide(host)));
        let was_refused = before.is_some_and(|host| host.refused == now.refused);
        match (was_connected, now.is_connected) {
            _ if !now.refused.is_empty() && !was_refused => {
                Some(format!("host {name}: refused: {}", now.refused))
            }
            (true, false) => Some(format!("host {name}: nothing comes from it")),
            (false, true) if before.is_some_and(|host| !host.version.is_empty()) => {
                Some(format!("host {name}: connected again"))
            }
            _ if is_wide(now) && !was_wide => Some(format!(
                "host {name}: its clock may be wrong by {:.1} ms, more than a tenth of a scan period",
                now.bound_ns as f64 * 1e-6
            )),
            _ => None,
        }
    }

    /// Whether a process on a host could not show that it works: nothing came from there a moment ago, or now.
    pub fn is_cut(&self, host: &str) -> bool {
        let now_ns = monotonic_ns();
        let is_silent = now_ns.saturating_sub(self.status.written_ns) > SILENT_NS;
        is_silent
            || self.connected_ns.get(host).is_none_or(|since_ns| now_ns.saturating_sub(*since_ns) < STEADY_NS)
    }

    /// Samples that were lost between hosts within the last seconds, as the links of all hosts report them.
    pub fn losses(&self) -> impl Iterator<Item = &LinkLoss> {
        self.status.losses.iter().chain(self.status.hosts.iter().flat_map(|host| &host.losses))
    }

    /// The other hosts.
    pub fn hosts(&self) -> &[LinkedHost] {
        &self.status.hosts
    }

    fn launch(&mut self) -> anyhow::Result<()> {
        let command = vec![program()?.into(), "hub".into(), self.domain.system_id().into()];
        // By these a stop finds it, as all processes of the run.
        let environment: Vec<(OsString, OsString)> = vec![
            (RUN_ID_VARIABLE.into(), self.domain.run_id().into()),
            (INCARNATION_VARIABLE.into(), "0".into()),
        ];
        let child = Child::spawn(&Launch { command, environment }, &self.log);
        self.child = Some(child.map_err(|error| Failure::process(format!("{PROGRAM}: {error}")))?);
        Ok(())
    }
}

/// What a user should know when the time for which a host stood still has grown [ms].
fn standstill(host: &str, [before, now]: [u64; 2]) -> Option<String> {
    let lost_s = now.saturating_sub(before) as f64 * 1e-3;
    (now > before).then(|| format!("{host} stood still for {lost_s:.1} s: suspended, stopped or overloaded"))
}

/// A host, of which nothing is needed yet.
fn peer_of(host: &HostEntry) -> LinkPeer {
    let endpoint = endpoint(host.transport, &host.address);
    LinkPeer { name: host.name.clone(), endpoint, ..LinkPeer::default() }
}

/// Adds the topics to the table of the orchestrator's link that roles at `places` need.
fn extend(table: &mut LinkTable, places: &[RolePlace<'_>]) {
    let add = |list: &mut Vec<String>, topic: Topic| {
        if !list.iter().any(|name| name == topic.name()) {
            list.push(topic.name().to_owned());
            list.sort();
        }
    };
    for Crossing { from, to, topic } in crossings_between(places) {
        match from {
            None => add(&mut table.sends, topic),
            Some(_) if to.is_none() => add(&mut table.receives, topic),
            Some(_) => {}
        }
        for peer in &mut table.peers {
            if from == Some(&peer.name) {
                add(&mut peer.sends, topic);
            } else if to == Some(&peer.name) {
                add(&mut peer.receives, topic);
            }
        }
    }
}

/// The folder of certificates as an absolute path, if it is private and its certificates are valid now and those of `host`.
///
/// # Errors
/// The file with what is wrong with it; exit code 2.
pub(crate) fn require_private(folder: &str, host: &str) -> anyhow::Result<String> {
    let folder = std::path::absolute(folder)?;
    let key = folder.join("key.pem");
    let mode = std::fs::metadata(&key).map(|meta| meta.mode() & 0o777);
    let mode =
        mode.map_err(|error| Failure::bad_input(format!("credentials: {}: {error}", key.display())))?;
    if mode & 0o077 != 0 {
        let message = format!("credentials: {}: mode {mode:o} is not allowed: 600", key.display());
        return Err(Failure::bad_input(message));
    }
    let checked =
        Command::new(program()?).arg("check").arg(&folder).arg(host).stdin(Stdio::null()).output()?;
    if !checked.status.success() {
        let reason = String::from_utf8_lossy(&checked.stderr);
        return Err(Failure::bad_input(format!(
            "credentials: {}",
            reason.trim().trim_start_matches("error: ")
        )));
    }
    Ok(folder.display().to_string())
}

/// Makes certificates for the orchestrator and for a host, and prints where they are.
///
/// # Errors
/// A name or address that is not allowed, a folder that is not private or can't be written, and a host that has its
/// certificate already, unless `force`; exit code 2.
pub fn pair(host: &str, address: IpAddr, days: u32, folder: &Path, force: bool) -> anyhow::Result<Exit> {
    if !plan::hosts::is_name(host) {
        return Err(Failure::bad_input(format!("HOST {host} is not allowed: {}", plan::hosts::NAME_RULE)));
    }
    let (address, days) = (address.to_string(), days.to_string());
    let mut command = Command::new(program()?);
    command.arg("pair").arg(folder).args([host, &address, &days]).args(force.then_some("--force"));
    let made = command.stdin(Stdio::null()).output()?;
    if !made.status.success() {
        let reason = String::from_utf8_lossy(&made.stderr);
        let reason = reason.trim().trim_start_matches("error: ");
        return Err(Failure::bad_input(format!("no certificates were made: {reason}")));
    }
    let folder = std::path::absolute(folder)?;
    answer!(
        false,
        "valid for {days} days:\n  {0}/{HUB}   for the orchestrator: `credentials` of the system file\n  {0}/{host}   copy it to \
         host {host}: `credentials` of its agent.toml\n  {0}/authority-key.pem   signs further hosts; keep it here, and secret",
        folder.display()
    )?;
    Ok(Exit::Done)
}

/// The program, beside this one or in `PATH`.
///
/// # Errors
/// Where it was looked for, and the command that builds it; exit code 2.
pub fn program() -> anyhow::Result<PathBuf> {
    other_program(PROGRAM, "services/link")
}
