//! One process of `scanloop bench transport` over ZeroMQ (libzmq).
//!
//! Set for low latency: PUSH and PULL over `ipc://`, which is what libzmq has between processes of one machine (Unix
//! stream sockets), one thread for input and output, and a message is received and sent by the thread that works with
//! it. Messages are copied once into libzmq and once out of the socket; there is no shared memory.

use std::error::Error;

use hops::{Arrival, ChainStage, HopError, Setup, Stamp, run};
use zmq::{Context, DONTWAIT, Message, Socket, SocketType};

/// Messages that wait at most at each end of a hop.
const WAITING: i32 = 16;
/// Longest sleep [ms].
const MAX_WAIT_MS: i32 = 230;

fn main() -> Result<(), Box<dyn Error>> {
    let setup = Setup::from_environment()?;
    let context = Context::new();
    context.set_io_threads(1)?;
    let open = |kind: SocketType| -> Result<Socket, zmq::Error> {
        let socket = context.socket(kind)?;
        socket.set_rcvhwm(WAITING)?;
        socket.set_sndhwm(WAITING)?;
        socket.set_rcvtimeo(MAX_WAIT_MS)?;
        socket.set_linger(0)?;
        socket.set_reconnect_ivl(10)?;
        Ok(socket)
    };
    let mut hop = Hop {
        inlet: None,
        outlet: None,
        buffer: vec![0; setup.outlet_bytes()],
        message: Message::new(),
        noticed: None,
    };
    if let Some(address) = setup.outlet() {
        let socket = open(zmq::PUSH)?;
        socket.bind(address)?;
        hop.outlet = Some(socket);
    }
    if let Some(address) = setup.inlet() {
        let socket = open(zmq::PULL)?;
        socket.connect(address)?;
        hop.inlet = Some(socket);
    }
    Ok(run(&mut hop, &setup)?)
}

/// The ports of one process.
struct Hop {
    inlet: Option<Socket>,
    outlet: Option<Socket>,
    buffer: Vec<u8>,
    message: Message,
    noticed: Option<Arrival>,
}

impl Hop {
    fn receive(&mut self, flags: i32) {
        self.noticed = None;
        let Some(inlet) = &self.inlet else { return };
        if inlet.recv(&mut self.message, flags).is_ok() {
            self.noticed = Stamp::read(&self.message).map(Arrival::now);
        }
    }
}

impl ChainStage for Hop {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        let Some(outlet) = &self.outlet else { return Ok(()) };
        stamp.write(&mut self.buffer);
        match outlet.send(self.buffer.as_slice(), DONTWAIT) {
            // Without room the message is lost, as with the others.
            Ok(()) | Err(zmq::Error::EAGAIN) => Ok(()),
            Err(error) => Err(HopError::transport("send", error)),
        }
    }

    fn take(&mut self) -> Option<Arrival> {
        self.noticed.take()
    }

    fn poll(&mut self) -> bool {
        self.receive(DONTWAIT);
        self.noticed.is_some()
    }

    fn block(&mut self, _longest_ns: Option<u64>) {
        self.receive(0);
    }
}
