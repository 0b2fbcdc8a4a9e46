//! Unix sockets written by hand: SOCK_SEQPACKET, one pair a hop, one system call to send and one to receive.
//!
//! A message larger than a packet goes as several, because the kernel's buffers do not take megabytes; the reader puts
//! them together. A message for which there is no room is lost, whole.

use std::os::fd::OwnedFd;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{RecvFlags, SendFlags, recv, send};

use crate::floor::inherited;
use crate::message::{Arrival, Stamp};
use crate::policy::MAX_WAIT_NS;
use crate::stage::ChainStage;
use crate::{HopError, Setup};

/// Largest packet: fits the buffers of a socket as the kernel gives them [bytes].
const PACKET: usize = 64 * 1024;

/// The ports of one process.
pub(crate) struct UnixSocket {
    inlet: Option<OwnedFd>,
    outlet: Option<OwnedFd>,
    incoming: Vec<u8>,
    outgoing: Vec<u8>,
    arrived: Option<Arrival>,
}

impl UnixSocket {
    /// Opens the ends that the setup names: `WRITER,READER` as numbers of descriptors.
    pub(crate) fn open(setup: &Setup) -> Result<Self, HopError> {
        let end = |address: Option<&str>, place: usize| {
            address.and_then(|text| text.split(',').nth(place)).map(inherited).transpose()
        };
        let (inlet, outlet) = (end(setup.inlet(), 1)?, end(setup.outlet(), 0)?);
        let longest = Some(Duration::from_nanos(MAX_WAIT_NS));
        for (socket, timeout) in [(&inlet, Timeout::Recv), (&outlet, Timeout::Send)] {
            if let Some(socket) = socket {
                set_socket_timeout(socket, timeout, longest)
                    .map_err(|error| HopError::system("set a time-out")(error.into()))?;
            }
        }
        Ok(Self {
            inlet,
            outlet,
            incoming: vec![0; setup.inlet_bytes()],
            outgoing: vec![0; setup.outlet_bytes()],
            arrived: None,
        })
    }

    /// Receives one message: its first packet with `flags`, the others when they come.
    fn receive(&mut self, flags: RecvFlags) -> Option<Arrival> {
        let inlet = self.inlet.as_ref()?;
        let mut packets = self.incoming.chunks_mut(PACKET);
        recv(inlet, packets.next()?, flags).ok()?;
        for packet in packets {
            while recv(inlet, &mut *packet, RecvFlags::empty()) == Err(Errno::INTR) {}
        }
        Stamp::read(&self.incoming).map(Arrival::now)
    }
}

impl ChainStage for UnixSocket {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        let Some(outlet) = &self.outlet else { return Ok(()) };
        stamp.write(&mut self.outgoing);
        let mut flags = SendFlags::DONTWAIT;
        for packet in self.outgoing.chunks(PACKET) {
            match send(outlet, packet, flags) {
                Ok(_) => flags = SendFlags::empty(),
                Err(Errno::AGAIN) if flags == SendFlags::DONTWAIT => return Ok(()),
                Err(error) => return Err(HopError::system("send a packet")(error.into())),
            }
        }
        Ok(())
    }

    fn take(&mut self) -> Option<Arrival> {
        self.arrived.take()
    }

    fn poll(&mut self) -> bool {
        self.arrived = self.receive(RecvFlags::DONTWAIT);
        self.arrived.is_some()
    }

    fn block(&mut self, timeout_ns: Option<u64>) {
        let Some(timeout_ns) = timeout_ns else {
            self.arrived = self.receive(RecvFlags::empty());
            return;
        };
        let longest = Timespec {
            tv_sec: (timeout_ns / 1_000_000_000) as i64,
            tv_nsec: (timeout_ns % 1_000_000_000) as i64,
        };
        let Some(inlet) = &self.inlet else { return };
        if matches!(poll(&mut [PollFd::new(inlet, PollFlags::IN)], Some(&longest)), Ok(1)) {
            self.poll();
        }
    }
}
