//! One connection: from the first byte to its loss.

use std::io::Write;
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::os::fd::AsFd;
use std::path::Path;
use std::time::Duration;

use driver::beams::{Beams, SweepRanges};
use driver::guard::Held;
use driver::order::GuardOrder;
use runtime::{monotonic_ns, wait_for};
use rustix::io::Errno;
use rustix::net::RecvFlags;
use vehicle::ScannerDescription;

use super::{ClientEvent, Lost, Outlet};
use crate::PlayerConfig;
use crate::config::Delivery;
use crate::guard::Base;
use crate::handshake::{Handshake, PlayerSession};
use crate::header::MessageHeader;
use crate::message::{RangeSweep, ServerMessage};
use crate::stream::MessageStream;

/// An attempt to connect ends after this time.
const CONNECT: Duration = Duration::from_secs(2);
/// A message that cannot be sent within this time ends the connection.
const SEND: Duration = Duration::from_millis(50);
/// Longest sleep of the thread [ns].
const SLEEP_NS: u64 = 20_000_000;
/// A server that sends more in a second floods [bytes, messages]. A scanner with 40 Hz and 1,081 beams takes 0.4 MB/s.
const FLOOD: [usize; 2] = [16_000_000, 20_000];
/// Without data for fewer scan periods, of which `timeout_ns` has two, a server is not silent: slow scanners have long ones.
const MIN_SILENT_PERIODS: u64 = 2;
const SECOND_NS: u64 = 1_000_000_000;

/// Serves one connection until the driver ends.
///
/// # Errors
/// Why the connection was lost; the wheels are stopped then.
pub(super) fn serve(
    config: &PlayerConfig,
    described: &ScannerDescription,
    timeout_ns: u64,
    scanloop: &Path,
    outlet: &Outlet,
) -> Result<(), Lost> {
    let server = connect(config)?;
    let mut connection = Connection::new(config, described, timeout_ns, &server);
    let Some(session) = connection.open(outlet)? else { return Ok(()) };
    let base = Base { index: config.position2d, command: config.command };
    let mut guard = crate::guard::start(scanloop, &server, base, timeout_ns)?;
    if !outlet.put(ClientEvent::Connected(guard.orders()?, session.clone())) {
        return Ok(());
    }
    let ended = connection.follow(&session, &mut guard, outlet);
    if ended.is_err() {
        base.stop_now(&server);
    }
    // The guard stops the wheels once more before the connection is closed.
    drop(guard);
    let _ = server.shutdown(Shutdown::Both);
    ended
}

fn connect(config: &PlayerConfig) -> Result<TcpStream, Lost> {
    let unknown = |source| Lost::UnknownHost { host: config.host.clone(), source };
    let port = u16::try_from(config.port).unwrap_or(u16::MAX);
    let addresses = (config.host.as_str(), port).to_socket_addrs().map_err(unknown)?;
    let mut failed = std::io::Error::other("it has no address");
    for address in addresses {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(server) => {
                let prepared = server.set_nodelay(true).and_then(|()| server.set_write_timeout(Some(SEND)));
                return prepared.map(|()| server).map_err(Lost::Broken);
            }
            Err(error) => failed = error,
        }
    }
    Err(Lost::NotConnected { server: config.server(), source: failed })
}

/// The reading end of a connection.
struct Connection<'a> {
    config: &'a PlayerConfig,
    described: &'a ScannerDescription,
    server: &'a TcpStream,
    stream: MessageStream,
    beams: Option<Beams>,
    /// Bytes and messages since the start of the present second [ns].
    traffic: [usize; 2],
    second_ns: u64,
    /// Base and scanner send data at least this often [ns].
    silence_ns: u64,
    /// When base and scanner sent data last [ns].
    data_ns: [u64; 2],
    /// Time stamp of the newest sweep [s].
    sweep_s: f64,
    /// When the newest round of data was asked for [ns].
    asked_ns: u64,
}

impl<'a> Connection<'a> {
    fn new(
        config: &'a PlayerConfig,
        described: &'a ScannerDescription,
        timeout_ns: u64,
        server: &'a TcpStream,
    ) -> Self {
        let now_ns = monotonic_ns();
        Self {
            config,
            described,
            server,
            silence_ns: ((config.silence_s * 1e9) as u64).max(timeout_ns / 2 * MIN_SILENT_PERIODS),
            stream: MessageStream::default(),
            beams: None,
            traffic: [0; 2],
            second_ns: now_ns,
            data_ns: [now_ns; 2],
            sweep_s: f64::NAN,
            asked_ns: 0,
        }
    }

    /// The conversation at the start; `None` when the driver ends.
    fn open(&mut self, outlet: &Outlet) -> Result<Option<PlayerSession>, Lost> {
        let mut requests = Vec::new();
        let mut handshake = Handshake::new(self.config, monotonic_ns(), &mut requests);
        while !outlet.is_ended() {
            let mut server = self.server;
            server.write_all(&requests).map_err(Lost::Broken)?;
            requests.clear();
            wait_for(&[server.as_fd()], SLEEP_NS);
            let now_ns = monotonic_ns();
            self.receive(now_ns)?;
            let mut session = handshake.expire(now_ns, &mut requests)?;
            while let Some((header, payload)) = next(&mut self.stream, self.config)? {
                let message = read(&header, payload)?;
                session = session.or(handshake.take(&header, &message, now_ns, &mut requests)?);
            }
            if session.is_some() {
                self.data_ns = [now_ns; 2];
                return Ok(session);
            }
        }
        Ok(None)
    }

    /// Reads data until the driver ends.
    fn follow(&mut self, session: &PlayerSession, guard: &mut Held, outlet: &Outlet) -> Result<(), Lost> {
        while !outlet.is_ended() {
            let now_ns = monotonic_ns();
            if self.config.delivery == Delivery::Pull && now_ns > self.asked_ns + SECOND_NS / 2 {
                guard.give(GuardOrder::Round);
                self.asked_ns = now_ns;
            }
            wait_for(&[self.server.as_fd(), guard.descriptor()], SLEEP_NS);
            let now_ns = monotonic_ns();
            self.receive(now_ns)?;
            while let Some((header, payload)) = next(&mut self.stream, self.config)? {
                self.traffic[1] += 1;
                match read(&header, payload)? {
                    ServerMessage::State(state) if header.device == self.config.base() => {
                        self.data_ns[0] = now_ns;
                        outlet.offer(ClientEvent::State { state, time_s: header.time_s, arrived_ns: now_ns });
                    }
                    ServerMessage::Sweep(sweep) if Some(header.device) == session.scanner => {
                        self.data_ns[1] = now_ns;
                        // The server's converter from ranger to laser sends each sweep twice.
                        if header.time_s != self.sweep_s {
                            self.sweep_s = header.time_s;
                            let ranges_mm =
                                fill(&mut self.beams, (self.config, self.described), session, &sweep)?;
                            outlet.offer(ClientEvent::Sweep {
                                ranges_mm,
                                time_s: header.time_s,
                                arrived_ns: now_ns,
                            });
                        }
                    }
                    ServerMessage::RoundEnd(lost) => {
                        if lost > 0 {
                            tracing::warn!(lost, "the queue of the server was full");
                        }
                        guard.give(GuardOrder::Round);
                        self.asked_ns = now_ns;
                    }
                    _ => {}
                }
            }
            guard.check(now_ns)?;
            self.require_data(session, now_ns)?;
        }
        Ok(())
    }

    /// Takes the bytes that are there.
    fn receive(&mut self, now_ns: u64) -> Result<(), Lost> {
        if now_ns >= self.second_ns + SECOND_NS {
            (self.second_ns, self.traffic) = (now_ns, [0; 2]);
        }
        match rustix::net::recv(self.server, self.stream.space(), RecvFlags::DONTWAIT) {
            Ok((_, 0)) => return Err(Lost::Closed),
            Ok((_, count)) => {
                self.stream.add(count);
                self.traffic[0] += count;
            }
            Err(Errno::AGAIN | Errno::INTR) => {}
            Err(error) => return Err(Lost::Broken(error.into())),
        }
        let [bytes, messages] = self.traffic;
        let floods = bytes > FLOOD[0] || messages > FLOOD[1];
        if floods { Err(Lost::Flood { bytes, messages }) } else { Ok(()) }
    }

    fn require_data(&self, session: &PlayerSession, now_ns: u64) -> Result<(), Lost> {
        let names = ["base", "scanner"];
        let devices = if session.scanner.is_some() { 2 } else { 1 };
        for (what, data_ns) in names.into_iter().zip(self.data_ns).take(devices) {
            let silent_ns = now_ns.saturating_sub(data_ns);
            if silent_ns > self.silence_ns {
                return Err(Lost::Silent { what, silent_ms: silent_ns / 1_000_000 });
            }
        }
        Ok(())
    }
}

fn next<'s>(
    stream: &'s mut MessageStream,
    config: &PlayerConfig,
) -> Result<Option<(MessageHeader, &'s [u8])>, Lost> {
    stream.next().map_err(|source| Lost::NotPlayer { server: config.server(), source })
}

fn read<'p>(header: &MessageHeader, payload: &'p [u8]) -> Result<ServerMessage<'p>, Lost> {
    let MessageHeader { device, subtype, .. } = *header;
    ServerMessage::read(header, payload).map_err(|source| Lost::Malformed { device, subtype, source })
}

/// The ranges of a sweep by beam of a scan.
fn fill(
    beams: &mut Option<Beams>,
    (config, described): (&PlayerConfig, &ScannerDescription),
    session: &PlayerSession,
    sweep: &RangeSweep<'_>,
) -> Result<SweepRanges, Lost> {
    let fan = sweep.fan.or(session.fan).ok_or(Lost::NoFan)?;
    let count = sweep.ranges_m.len();
    let beams = match beams.take().filter(|beams| beams.fits(&fan, count)) {
        Some(known) => beams.insert(known),
        None => beams.insert(Beams::new(fan, count, config.scan_sign, described)?),
    };
    let mut ranges_mm: SweepRanges = [0; _];
    beams.fill(|beam| sweep.ranges_m.get(beam), &mut ranges_mm);
    Ok(ranges_mm)
}
