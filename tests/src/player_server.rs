//! A Player 3 server with an emulated robot, written from the description of the protocol.
//!
//! As Stage, it has no watchdog unless one is set: the robot follows the last command until another one comes, or until
//! no client has the base open. Its scanner and its odometry are those of the emulator, without the imperfections that a calibration
//! undoes. A Hokuyo scanner stands on the robot too, at a port of its own. Faults of both can be switched on.

mod client;
mod hokuyo;
mod world;

use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use emulator::Scenario;
use runtime::{monotonic_ns, wait_for};
use shared_types::Truth;
use urg::DeviceFault;

use client::Client;
use hokuyo::Hokuyo;
use world::World;

pub use world::ReceivedCommand;

/// Time between two turns of the server [ns].
const TURN_NS: u64 = 2_000_000;
/// Bytes that are no message.
const GARBAGE: [u8; 400] = [0xa5; 400];
/// Messages in a turn of a server that floods.
const FLOOD: usize = 400;

/// What is wrong with the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ServerFault {
    /// Nothing.
    None = 0,
    /// It sends nothing more.
    Stalls = 1,
    /// It sends bytes that are no messages.
    Garbage = 2,
    /// It sends far too much.
    Floods = 3,
    /// It stops in the middle of a sweep.
    HalfSweep = 4,
    /// The network is away: neither data nor commands pass. Both come late when this ends.
    Held = 5,
    /// The same, but the data are lost.
    Cut = 6,
}

/// A running server; it ends when it is dropped.
#[derive(Debug)]
pub struct PlayerServer {
    port: u16,
    scanner: String,
    world: Arc<Mutex<World>>,
    hokuyo: Arc<Mutex<Hokuyo>>,
    fault: Arc<AtomicU8>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl PlayerServer {
    /// Starts a server on the loopback interface; `port` 0 takes a free one.
    ///
    /// # Errors
    /// A port that is in use.
    pub fn start(scenario: &Scenario, period_ns: u64, port: u16) -> std::io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let world = World::new(scenario, period_ns);
        let hokuyo = Hokuyo::new(world.front_ns())?;
        let scanner = hokuyo.place();
        let (world, hokuyo) = (Arc::new(Mutex::new(world)), Arc::new(Mutex::new(hokuyo)));
        let (fault, ends) = (Arc::new(AtomicU8::new(0)), Arc::new(AtomicBool::new(false)));
        let server = Server {
            port,
            listener,
            world: Arc::clone(&world),
            hokuyo: Arc::clone(&hokuyo),
            fault: Arc::clone(&fault),
            clients: Vec::new(),
            held: Vec::new(),
        };
        let its_end = Arc::clone(&ends);
        let thread = std::thread::Builder::new().spawn(move || server.run(&its_end))?;
        Ok(Self { port, scanner, world, hokuyo, fault, ends, thread: Some(thread) })
    }

    /// The port that it listens on.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Address of the Hokuyo scanner.
    pub fn scanner(&self) -> &str {
        &self.scanner
    }

    /// What the Hokuyo scanner has measured so far, by beam [mm].
    pub fn measured(&self) -> Vec<Vec<u32>> {
        locked(&self.hokuyo).shown.clone()
    }

    /// Damages this many of the next scans of the Hokuyo scanner.
    pub fn damage_scans(&self, fault: DeviceFault, count: usize) {
        locked(&self.hokuyo).damage = (fault, count);
    }

    /// The true state at the newest scan.
    pub fn truth(&self) -> Truth {
        locked(&self.world).truth
    }

    /// The true speed now [m/s].
    pub fn speed_mps(&self) -> f64 {
        locked(&self.world).speed_mps()
    }

    /// What was received since the start, with the time on CLOCK_MONOTONIC [ns].
    pub fn received(&self) -> Vec<(u64, ReceivedCommand)> {
        locked(&self.world).received.clone()
    }

    /// Blocks the wheels after this time without a command [ns].
    pub fn set_watchdog(&self, after_ns: u64) {
        locked(&self.world).watchdog_ns = Some(after_ns);
    }

    /// Switches a fault on, or all off.
    pub fn set_fault(&self, fault: ServerFault) {
        self.fault.store(fault as u8, Ordering::SeqCst);
    }
}

impl Drop for PlayerServer {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread of a server.
struct Server {
    port: u16,
    listener: TcpListener,
    world: Arc<Mutex<World>>,
    hokuyo: Arc<Mutex<Hokuyo>>,
    fault: Arc<AtomicU8>,
    clients: Vec<Client>,
    /// Data that the network holds.
    held: Vec<world::Data>,
}

impl Server {
    fn run(mut self, ends: &AtomicBool) {
        while !ends.load(Ordering::SeqCst) {
            wait_for(&[], TURN_NS);
            self.turn();
        }
    }

    fn turn(&mut self) {
        let mut world = locked(&self.world);
        if let Ok((stream, _)) = self.listener.accept() {
            self.clients.extend(Client::new(stream, self.port, world.time_s()));
        }
        let fault = self.fault.load(Ordering::SeqCst);
        let is_away = fault == ServerFault::Held as u8 || fault == ServerFault::Cut as u8;
        if !is_away {
            self.clients.retain_mut(|client| client.serve(&mut world).is_ok());
            world.is_open = self.clients.iter().any(Client::has_base);
        }
        let data = world.advance(monotonic_ns());
        drop(world);
        let mut hokuyo = locked(&self.hokuyo);
        if let Some(data) = &data {
            hokuyo.show(&data.ranges_m);
        }
        hokuyo.serve();
        drop(hokuyo);
        if is_away {
            self.held.extend(data.filter(|_| fault == ServerFault::Held as u8));
            return;
        }
        let held = std::mem::take(&mut self.held);
        for client in &mut self.clients {
            held.iter().for_each(|data| client.deliver(data));
            match (&data, fault) {
                (Some(data), 0) => client.deliver(data),
                (Some(data), 4) => {
                    client.deliver_half(data);
                    self.fault.store(ServerFault::Stalls as u8, Ordering::SeqCst);
                }
                (_, 2) => client.send(&GARBAGE),
                (_, 3) => (0..FLOOD).for_each(|_| client.send(&GARBAGE_FREE)),
                _ => {}
            }
        }
    }
}

/// A header of a message without payload, of an interface that no client knows.
const GARBAGE_FREE: [u8; 40] = {
    let mut bytes = [0; 40];
    (bytes[11], bytes[19], bytes[23]) = (99, 1, 1);
    bytes
};
