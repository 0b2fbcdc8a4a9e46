//! The bare round trip between two hosts: plain UDP and TCP, and Zenoh as the link uses it. It tells what the network
//! costs from what the link adds.
//!
//! `round-trip echo ADDRESS [CREDENTIALS]` answers on the other host until it is ended, `round-trip ping ADDRESS COUNT
//! [CREDENTIALS]` measures. The transports take turns, so that what disturbs the machine disturbs all of them. Ports:
//! that of the address for UDP and TCP, the next one for Zenoh over UDP, the one after it for Zenoh over QUIC.

#![allow(unreachable_pub, dead_code, reason = "modules of the link, of which this needs a part")]

#[path = "../src/inbox.rs"]
mod inbox;
#[path = "../src/network.rs"]
mod network;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use runtime::monotonic_ns;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;

use inbox::Registration;
use network::{Network, Place, join};

/// Bytes of a message: the mean of scan and command.
const BYTES: usize = 1_704;
/// Time between two messages of one transport, as between two scans.
const PERIOD: Duration = Duration::from_millis(100);
/// An answer that takes longer is lost.
const LOST: Duration = Duration::from_millis(20);
/// How long to wait for the other end.
const CONNECT: Duration = Duration::from_secs(10);
/// Messages before those that are measured.
const WARM_UP: usize = 10;

const ASK: &str = "scanloop/ping/ask";
const ANSWER: &str = "scanloop/ping/answer";

fn main() -> anyhow::Result<()> {
    network::set_threads()?;
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["echo", address] => echo(address.parse()?, None),
        ["echo", address, credentials] => echo(address.parse()?, Some(credentials)),
        ["ping", address, count] => ping(address.parse()?, None, count.parse()?),
        ["ping", address, count, credentials] => ping(address.parse()?, Some(credentials), count.parse()?),
        _ => bail!("usage: round-trip echo ADDRESS [CREDENTIALS] | ping ADDRESS COUNT [CREDENTIALS]"),
    }
}

/// Answers on all transports until the process is ended.
///
/// # Errors
/// An address that is not of this machine, and what Zenoh refuses.
fn echo(address: SocketAddr, credentials: Option<&str>) -> anyhow::Result<()> {
    let udp = UdpSocket::bind(address).context("UDP")?;
    let tcp = TcpListener::bind(address).context("TCP")?;
    let mut sessions = Vec::new();
    for (_, endpoint, trusted) in zenoh_places(address, credentials) {
        let session = join(&Place::Agent(&endpoint), trusted)?;
        let answer = session.publisher(ANSWER.to_owned(), Priority::RealTime)?;
        let subscriber = session.subscribe(ASK.to_owned(), move |_, bytes| _ = answer.put(bytes).wait());
        sessions.push((session, subscriber));
    }
    std::thread::spawn(move || -> std::io::Result<()> {
        for stream in tcp.incoming() {
            let (mut stream, mut bytes) = (stream?, [0; BYTES]);
            stream.set_nodelay(true)?;
            while stream.read_exact(&mut bytes).and_then(|()| stream.write_all(&bytes)).is_ok() {}
        }
        Ok(())
    });
    let mut bytes = [0; BYTES];
    loop {
        let (length, from) = udp.recv_from(&mut bytes)?;
        udp.send_to(&bytes[..length], from)?;
    }
}

/// Measures `count` round trips of each transport and prints a table.
///
/// # Errors
/// Another end that does not answer.
fn ping(address: SocketAddr, credentials: Option<&str>, count: usize) -> anyhow::Result<()> {
    let mut ways: Vec<(&str, Box<dyn Way>)> =
        vec![("udp", Box::new(Udp::new(address)?)), ("tcp", Box::new(Tcp::new(address)?))];
    for (name, endpoint, trusted) in zenoh_places(address, credentials) {
        ways.push((name, Box::new(Zenoh::new(&endpoint, trusted)?)));
    }
    let mut measured = vec![Vec::with_capacity(count); ways.len()];
    let pause = PERIOD / ways.len() as u32;
    for round in 0..WARM_UP + count {
        for ((_, way), measured) in ways.iter_mut().zip(&mut measured) {
            let next = Instant::now() + pause;
            let trip_ns = way.trip()?;
            if round >= WARM_UP {
                measured.push(trip_ns);
            }
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
    }
    println!("{:<12} {:>8} {:>8} {:>8} {:>8}", "transport", "p50 us", "p90 us", "p99 us", "lost");
    for ((name, _), measured) in ways.iter().zip(measured) {
        let mut trips: Vec<u64> = measured.iter().copied().flatten().collect();
        trips.sort_unstable();
        let at = |share: usize| {
            let index = (trips.len() * share).div_ceil(100).saturating_sub(1);
            trips.get(index).map_or(f64::NAN, |trip_ns| *trip_ns as f64 * 1e-3)
        };
        let lost = measured.len() - trips.len();
        println!("{name:<12} {:>8.0} {:>8.0} {:>8.0} {lost:>8}", at(50), at(90), at(99));
    }
    Ok(())
}

/// Zenoh's transports: name, endpoint and certificates.
fn zenoh_places(address: SocketAddr, credentials: Option<&str>) -> Vec<(&'static str, String, Option<&str>)> {
    let at = |name: &str, next: u16| {
        let place = SocketAddr::new(address.ip(), address.port().saturating_add(next));
        format!("{name}/{place}?rel=0")
    };
    let mut places = vec![("zenoh udp", at("udp", 1), None)];
    places.extend(credentials.map(|folder| ("zenoh quic", at("quic", 2), Some(folder))));
    places
}

/// One transport.
trait Way {
    /// Time of one message there and back [ns]; `None` when it was lost.
    fn trip(&mut self) -> anyhow::Result<Option<u64>>;
}

/// A message that differs from all others.
fn message(number: u64) -> [u8; BYTES] {
    let mut bytes = [1; BYTES];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes
}

struct Udp {
    socket: UdpSocket,
    number: u64,
}

impl Udp {
    fn new(address: SocketAddr) -> anyhow::Result<Self> {
        let any = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        socket.set_read_timeout(Some(LOST))?;
        Ok(Self { socket, number: 0 })
    }
}

impl Way for Udp {
    fn trip(&mut self) -> anyhow::Result<Option<u64>> {
        self.number += 1;
        let (sent, mut received) = (message(self.number), [0; BYTES]);
        let sent_ns = monotonic_ns();
        self.socket.send(&sent)?;
        while self.socket.recv(&mut received).is_ok() {
            if received == sent {
                return Ok(Some(monotonic_ns() - sent_ns));
            }
        }
        Ok(None)
    }
}

struct Tcp(TcpStream);

impl Tcp {
    fn new(address: SocketAddr) -> anyhow::Result<Self> {
        let stream = TcpStream::connect_timeout(&address, CONNECT)
            .with_context(|| format!("no `round-trip echo` answers at {address}"))?;
        stream.set_nodelay(true)?;
        Ok(Self(stream))
    }
}

impl Way for Tcp {
    fn trip(&mut self) -> anyhow::Result<Option<u64>> {
        let mut bytes = message(0);
        let sent_ns = monotonic_ns();
        self.0.write_all(&bytes)?;
        self.0.read_exact(&mut bytes)?;
        Ok(Some(monotonic_ns() - sent_ns))
    }
}

struct Zenoh {
    number: u64,
    publisher: Publisher<'static>,
    answers: Receiver<(u64, u64)>,
    _subscriber: Registration,
    _session: Network,
}

impl Zenoh {
    fn new(endpoint: &str, credentials: Option<&str>) -> anyhow::Result<Self> {
        let session = join(&Place::Hub(vec![endpoint]), credentials)?;
        let (into, answers) = channel();
        let subscriber = session.subscribe(ANSWER.to_owned(), move |_, bytes| {
            // The time is taken here, before the other thread is woken.
            let answered_ns = monotonic_ns();
            if let Some(number) = bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes)) {
                let _ = into.send((number, answered_ns));
            }
        });
        let publisher = session.publisher(ASK.to_owned(), Priority::RealTime)?;
        let mut way = Self { number: 0, publisher, answers, _subscriber: subscriber, _session: session };
        let started = Instant::now();
        while way.trip()?.is_none() {
            if started.elapsed() > CONNECT {
                bail!("no `round-trip echo` answers at {endpoint}");
            }
        }
        Ok(way)
    }
}

impl Way for Zenoh {
    fn trip(&mut self) -> anyhow::Result<Option<u64>> {
        self.number += 1;
        let sent = message(self.number);
        let sent_ns = monotonic_ns();
        self.publisher.put(sent.as_slice()).wait().map_err(|error| anyhow::anyhow!("{error}"))?;
        while let Ok((number, answered_ns)) = self.answers.recv_timeout(LOST) {
            if number == self.number {
                return Ok(Some(answered_ns - sent_ns));
            }
        }
        Ok(None)
    }
}
