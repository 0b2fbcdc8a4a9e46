//! The resources of a chain: shared memory, sockets, ports, a bus. They exist before its processes start and are
//! removed when dropped.

use std::fs::File;
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use runtime::Domain;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fs::{FlockOperation, MemfdFlags, OFlags, flock, ftruncate, memfd_create};
use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};

use crate::ring::Ring;
use crate::setup::{HOPS, PROCESSES, SETUP_VARIABLE, Setup};
use crate::{ChainPlan, Contender, HopError, bus, listener, peers};

/// First letter of the ids of the systems that chains make.
const ID: char = 'h';

/// A file of the directory of a chain, locked as long as its driver lives: no other system has it.
const MARKER: &str = "chain-of-a-bench";

/// Files of one chain: a domain of its own, with a directory for sockets and logs. Removed when dropped.
#[derive(Debug)]
pub(crate) struct Files(
    pub(crate) Domain,
    #[expect(dead_code, reason = "its lock lasts as long as it is open")] File,
);

/// Everything that must exist before the processes of a chain start.
pub(crate) struct Wiring {
    // Fields are dropped in this order: the bus before its files.
    system: Option<bus::System>,
    _services: Option<listener::Services>,
    descriptors: Vec<OwnedFd>,
    /// Address of each hop, see [`Setup::addresses`].
    pub(crate) addresses: Vec<String>,
}

impl Files {
    /// A new domain; first removes the remains of killed drivers.
    pub(crate) fn create() -> Result<Self, HopError> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let id = format!("{ID}{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        sweep();
        let domain = Domain::create(&id).map_err(|error| HopError::transport("make a directory", error))?;
        let marker = lock(&domain, OFlags::RDWR | OFlags::CREATE);
        Ok(Self(domain, marker.map_err(HopError::system("lock a directory"))?))
    }

    /// Directory of the chain.
    pub(crate) fn directory(&self) -> &Path {
        self.0.directory()
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        let _ = self.0.remove();
    }
}

impl Wiring {
    /// Makes what the contender of the plan needs.
    pub(crate) fn new(plan: &ChainPlan, files: &Files) -> Result<Self, HopError> {
        let mut wiring =
            Self { system: None, _services: None, descriptors: Vec::new(), addresses: Vec::new() };
        match plan.contender {
            Contender::Iceoryx2 => {
                let (period_ns, policy) = (plan.period_ns(), plan.policy);
                wiring.system = Some(bus::System::create(files.0.clone(), plan.payload, period_ns, policy)?);
            }
            Contender::Iceoryx2Listener => {
                wiring._services = Some(listener::Services::create(&files.0)?);
                wiring.addresses.push(files.0.system_id().to_owned());
            }
            Contender::Floor | Contender::FloorFutex => {
                for payload in plan.payload.bytes() {
                    wiring.add_ring(payload, plan.contender == Contender::Floor)?;
                }
            }
            Contender::UnixSocket => {
                for _ in 0..HOPS {
                    let pair =
                        socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None);
                    let (writer, reader) =
                        pair.map_err(|error| HopError::system("make sockets")(error.into()))?;
                    wiring.addresses.push(format!("{},{}", writer.as_raw_fd(), reader.as_raw_fd()));
                    wiring.descriptors.extend([writer, reader]);
                }
            }
            Contender::Zenoh | Contender::ZenohShm => wiring.addresses = free_ports()?,
            Contender::Zeromq => {
                let socket = |hop| format!("ipc://{}/hop{hop}", files.directory().display());
                wiring.addresses = (0..HOPS).map(socket).collect();
            }
            Contender::Dora => {}
        }
        Ok(wiring)
    }

    /// Descriptors that the processes inherit.
    pub(crate) fn descriptors(&self) -> Vec<RawFd> {
        self.descriptors.iter().map(AsRawFd::as_raw_fd).collect()
    }

    /// The commands that start all processes; `setup` makes the setup of one.
    pub(crate) fn commands(
        &self,
        plan: &ChainPlan,
        files: &Files,
        setup: impl Fn(usize) -> Setup,
    ) -> Result<Vec<Command>, HopError> {
        if plan.contender == Contender::Dora {
            return Ok(vec![dataflow(files, setup)?]);
        }
        (0..PROCESSES)
            .map(|index| {
                let mut command = match peers::program(plan.contender) {
                    Some(program) => Command::new(program),
                    None => Command::new(&plan.program),
                };
                if peers::program(plan.contender).is_none() {
                    command.args(&plan.arguments);
                }
                if let Some(system) = &self.system {
                    command.envs(system.environment(index));
                }
                command.env(SETUP_VARIABLE, setup(index).to_json()?);
                Ok(command)
            })
            .collect()
    }

    /// The part of the driver while the chain starts; call it repeatedly.
    pub(crate) fn assist(&mut self) -> Result<(), HopError> {
        self.system.as_mut().map_or(Ok(()), bus::System::assist)
    }

    fn add_ring(&mut self, payload: usize, with_event: bool) -> Result<(), HopError> {
        let error = |error: rustix::io::Errno| HopError::system("make shared memory")(error.into());
        let memory = memfd_create("scanloop-hop", MemfdFlags::CLOEXEC).map_err(error)?;
        ftruncate(&memory, Ring::bytes(payload) as u64).map_err(error)?;
        let mut address = memory.as_raw_fd().to_string();
        self.descriptors.push(memory);
        if with_event {
            let event = eventfd(0, EventfdFlags::CLOEXEC).map_err(error)?;
            address.push_str(&format!(",{}", event.as_raw_fd()));
            self.descriptors.push(event);
        }
        self.addresses.push(address);
        Ok(())
    }
}

/// Ports of the loopback that are free now, as Zenoh writes them.
fn free_ports() -> Result<Vec<String>, HopError> {
    let bound: Result<Vec<TcpListener>, _> =
        (0..HOPS).map(|_| TcpListener::bind((Ipv4Addr::LOCALHOST, 0))).collect();
    let bound = bound.map_err(HopError::system("find free ports"))?;
    let address = |listener: &TcpListener| listener.local_addr().map(|address| format!("tcp/{address}"));
    bound.iter().map(address).collect::<Result<_, _>>().map_err(HopError::system("find free ports"))
}

/// dora's program with a dataflow of five nodes: it starts the processes itself.
fn dataflow(files: &Files, setup: impl Fn(usize) -> Setup) -> Result<Command, HopError> {
    let missing = || HopError::transport("start dora", "not installed");
    let (dora, node) =
        (peers::dora().ok_or_else(missing)?, peers::program(Contender::Dora).ok_or_else(missing)?);
    let mut text = String::from("nodes:\n");
    for index in 0..PROCESSES {
        text.push_str(&format!("  - id: hop{index}\n    path: {}\n", node.display()));
        text.push_str(&format!("    env:\n      {SETUP_VARIABLE}: '{}'\n", setup(index).to_json()?));
        if index > 0 {
            let input = format!("    inputs:\n      message:\n        source: hop{}/message\n", index - 1);
            text.push_str(&format!("{input}        queue_size: 16\n"));
        }
        if index < HOPS {
            text.push_str("    outputs:\n      - message\n");
        }
    }
    std::fs::write(files.directory().join("dataflow.yml"), text)
        .map_err(HopError::system("write a dataflow"))?;
    let mut command = Command::new(dora);
    command.args(["run", "dataflow.yml"]).current_dir(files.directory());
    Ok(command)
}

/// Opens and locks the marker of a chain.
fn lock(domain: &Domain, flags: OFlags) -> io::Result<File> {
    let marker = domain.folder().open_file(MARKER, flags)?;
    flock(&marker, FlockOperation::NonBlockingLockExclusive)?;
    Ok(marker)
}

/// Removes the remains of chains whose driver has ended.
fn sweep() {
    for domain in Domain::all().unwrap_or_default() {
        if let Ok(marker) = lock(&domain, OFlags::RDWR) {
            drop(Files(domain, marker));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_driver_has_left_is_removed_by_the_next() {
        // No process has this number: the kernel's largest is 2^22.
        let [dead, other] = ["h4999999-0", "h4999999-1"].map(|id| Domain::create(id).unwrap());
        drop(lock(&dead, OFlags::RDWR | OFlags::CREATE).unwrap());
        let files = Files::create().unwrap();
        assert!(!dead.exists() && !dead.bus_directory().exists());
        assert!(other.exists(), "a system of the user may have such a name");
        other.remove().unwrap();
        sweep();
        assert!(files.0.exists(), "its driver lives");
        let directory = files.directory().to_owned();
        assert!(directory.exists());
        drop(files);
        assert!(!directory.exists());
    }
}
