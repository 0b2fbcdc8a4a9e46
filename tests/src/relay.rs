//! A network between two programs on this machine: a relay of datagrams that delays, loses and holds them.
//!
//! It needs no rights, so that what a bad network does is tested everywhere. Datagrams of one way keep their order, as in
//! the queue of a router. What is lost follows from the seed and from the number of the datagram.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest sleep, after which a change of the network is noticed.
const POLL: Duration = Duration::from_millis(2);
/// Largest datagram.
const MAX_BYTES: usize = 65_536;

/// A relay; it ends when dropped.
pub struct Relay {
    address: SocketAddr,
    network: Arc<Network>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Network {
    loss_ppm: AtomicU32,
    delay_us: AtomicU32,
    jitter_us: AtomicU32,
    is_cut: AtomicBool,
    is_holding: AtomicBool,
    is_ending: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// Datagrams of one way.
struct Way<T> {
    network: Arc<Network>,
    random: u64,
    waiting: VecDeque<(Instant, T)>,
}

impl Relay {
    /// A relay to the program at an address; others reach it through [`Relay::address`].
    ///
    /// # Panics
    /// When the machine has no free port.
    pub fn start(to: SocketAddr) -> Self {
        let front = UdpSocket::bind("127.0.0.1:0").expect("a free port");
        let address = front.local_addr().expect("the address of a socket");
        let network = Arc::<Network>::default();
        let shared = Arc::clone(&network);
        let thread = std::thread::spawn(move || forth(&shared, &front, to).expect("a relay"));
        Self { address, network, thread: Some(thread) }
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// This share of the datagrams of each way is lost from now on.
    pub fn lose(&self, share: f64) {
        self.network.loss_ppm.store((1e6 * share) as u32, Ordering::Relaxed);
    }

    /// Each way takes this long from now on, and an exponential time of this mean in addition.
    pub fn delay(&self, delay: Duration, jitter: Duration) {
        self.network.delay_us.store(delay.as_micros() as u32, Ordering::Relaxed);
        self.network.jitter_us.store(jitter.as_micros() as u32, Ordering::Relaxed);
    }

    /// Whether all datagrams are lost.
    pub fn cut(&self, is_cut: bool) {
        self.network.is_cut.store(is_cut, Ordering::Relaxed);
    }

    /// Whether datagrams wait; they come at once, as a burst, when they do not any more.
    pub fn hold(&self, is_holding: bool) {
        self.network.is_holding.store(is_holding, Ordering::Relaxed);
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.network.is_ending.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
        let threads =
            std::mem::take(&mut *self.network.threads.lock().unwrap_or_else(PoisonError::into_inner));
        threads.into_iter().for_each(|thread| _ = thread.join());
    }
}

/// From those in front to the program behind: each of them has a socket of its own there.
fn forth(network: &Arc<Network>, front: &UdpSocket, to: SocketAddr) -> io::Result<()> {
    let mut behind: BTreeMap<SocketAddr, Arc<UdpSocket>> = BTreeMap::new();
    let mut way = Way::new(network, 1);
    let mut bytes = vec![0; MAX_BYTES];
    while !network.is_ending.load(Ordering::Relaxed) {
        way.deliver(|(socket, datagram): (Arc<UdpSocket>, Vec<u8>)| _ = socket.send(&datagram));
        front.set_read_timeout(Some(way.timeout()))?;
        let Ok((length, from)) = front.recv_from(&mut bytes) else { continue };
        if !behind.contains_key(&from) {
            let socket = Arc::new(UdpSocket::bind("127.0.0.1:0")?);
            socket.connect(to)?;
            let (shared, back, front) = (Arc::clone(network), Arc::clone(&socket), front.try_clone()?);
            let seed = 2 + behind.len() as u64;
            let thread = std::thread::spawn(move || _ = back_to(&shared, &back, &front, from, seed));
            network.threads.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
            behind.insert(from, socket);
        }
        way.accept((Arc::clone(&behind[&from]), bytes[..length].to_vec()));
    }
    Ok(())
}

/// From the program behind to one in front.
fn back_to(
    network: &Arc<Network>,
    socket: &UdpSocket,
    front: &UdpSocket,
    to: SocketAddr,
    seed: u64,
) -> io::Result<()> {
    let mut way = Way::new(network, seed);
    let mut bytes = vec![0; MAX_BYTES];
    while !network.is_ending.load(Ordering::Relaxed) {
        way.deliver(|datagram: Vec<u8>| _ = front.send_to(&datagram, to));
        socket.set_read_timeout(Some(way.timeout()))?;
        if let Ok(length) = socket.recv(&mut bytes) {
            way.accept(bytes[..length].to_vec());
        }
    }
    Ok(())
}

impl<T> Way<T> {
    fn new(network: &Arc<Network>, seed: u64) -> Self {
        Self { network: Arc::clone(network), random: seed, waiting: VecDeque::new() }
    }

    /// Takes a datagram, unless it is lost.
    fn accept(&mut self, datagram: T) {
        let loss = f64::from(self.network.loss_ppm.load(Ordering::Relaxed)) * 1e-6;
        if self.uniform() < loss || self.network.is_cut.load(Ordering::Relaxed) {
            return;
        }
        let micros = |value: &AtomicU32| f64::from(value.load(Ordering::Relaxed));
        let jitter_us = -micros(&self.network.jitter_us) * (1.0 - self.uniform()).ln();
        let delay_us = micros(&self.network.delay_us) + jitter_us;
        let due = Instant::now() + Duration::from_secs_f64(1e-6 * delay_us);
        let due = self.waiting.back().map_or(due, |(before, _)| due.max(*before));
        self.waiting.push_back((due, datagram));
    }

    /// Passes on what is due.
    fn deliver(&mut self, mut each: impl FnMut(T)) {
        let (now, is_held) = (Instant::now(), self.network.is_holding.load(Ordering::Relaxed));
        while !is_held && self.waiting.front().is_some_and(|(due, _)| *due <= now) {
            self.waiting.pop_front().into_iter().for_each(|(_, datagram)| each(datagram));
        }
    }

    /// How long to wait for a datagram.
    fn timeout(&self) -> Duration {
        let next = self.waiting.front().map(|(due, _)| due.saturating_duration_since(Instant::now()));
        let is_held = self.network.is_holding.load(Ordering::Relaxed);
        let wait = if is_held { POLL } else { next.unwrap_or(POLL) };
        wait.clamp(Duration::from_micros(20), POLL)
    }

    /// A number from 0 to 1, by splitmix64.
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.random;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends `count` datagrams through the relay and returns the round trips of those that came back.
    fn round_trips(relay: &Relay, count: u64) -> Vec<Duration> {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.connect(relay.address()).expect("the relay");
        socket.set_read_timeout(Some(Duration::from_millis(100))).expect("a timeout");
        let trip = |number: u64| {
            let sent = Instant::now();
            socket.send(&number.to_le_bytes()).ok()?;
            let mut bytes = [0; 8];
            socket.recv(&mut bytes).ok()?;
            (bytes == number.to_le_bytes()).then(|| sent.elapsed())
        };
        (0..count).filter_map(trip).collect()
    }

    /// A program that sends back what it gets, for as long as it gets something.
    fn echo() -> SocketAddr {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let address = socket.local_addr().expect("an address");
        socket.set_read_timeout(Some(Duration::from_secs(2))).expect("a timeout");
        std::thread::spawn(move || {
            let mut bytes = [0; 64];
            while let Ok((length, from)) = socket.recv_from(&mut bytes) {
                let _ = socket.send_to(&bytes[..length], from);
            }
        });
        address
    }

    #[test]
    fn datagrams_are_delayed_lost_and_held() {
        let relay = Relay::start(echo());
        assert_eq!(round_trips(&relay, 20).len(), 20);
        relay.delay(Duration::from_millis(5), Duration::ZERO);
        assert!(round_trips(&relay, 5).iter().all(|trip| *trip >= Duration::from_millis(10)));
        relay.delay(Duration::ZERO, Duration::ZERO);
        relay.lose(0.5);
        let came = round_trips(&relay, 40).len();
        assert!((1..30).contains(&came), "{came} of 40, a quarter is expected");
        relay.lose(0.0);
        relay.cut(true);
        assert_eq!(round_trips(&relay, 2), []);
        relay.cut(false);
        relay.hold(true);
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.connect(relay.address()).expect("the relay");
        (0..3).for_each(|_| _ = socket.send(&[1]));
        socket.set_read_timeout(Some(Duration::from_millis(50))).expect("a timeout");
        assert!(socket.recv(&mut [0; 8]).is_err());
        relay.hold(false);
        socket.set_read_timeout(Some(Duration::from_secs(5))).expect("a timeout");
        (0..3).for_each(|_| assert!(socket.recv(&mut [0; 8]).is_ok(), "the burst"));
    }
}
