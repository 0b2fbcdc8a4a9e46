//! The transports that a chain can use.

use crate::stage::ChainStage;
use crate::{HopError, Setup, WaitPolicy, bus, floor, listener, unix_socket};

/// A transport under comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Contender {
    /// The bus as the processes of the loop use it: the reference of the comparison.
    Iceoryx2,
    /// iceoryx2 with its own listener, for information.
    Iceoryx2Listener,
    /// A ring in shared memory and an eventfd: the lowest cost of a hop when processes sleep.
    Floor,
    /// The same ring and a futex.
    FloorFutex,
    /// Unix sockets written by hand.
    UnixSocket,
    /// Zenoh over TCP on the loopback.
    Zenoh,
    /// Zenoh with shared memory.
    ZenohShm,
    /// ZeroMQ over its own Unix sockets.
    Zeromq,
    /// A dataflow of dora.
    Dora,
}

impl Contender {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::Iceoryx2,
        Self::Iceoryx2Listener,
        Self::Floor,
        Self::FloorFutex,
        Self::UnixSocket,
        Self::Zenoh,
        Self::ZenohShm,
        Self::Zeromq,
        Self::Dora,
    ];

    /// Name on the command line and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Iceoryx2 => "iceoryx2",
            Self::Iceoryx2Listener => "iceoryx2-listener",
            Self::Floor => "floor",
            Self::FloorFutex => "floor-futex",
            Self::UnixSocket => "unix-socket",
            Self::Zenoh => "zenoh",
            Self::ZenohShm => "zenoh-shm",
            Self::Zeromq => "zeromq",
            Self::Dora => "dora",
        }
    }

    /// Whether its processes can wait in this way. Libraries that wait in threads of their own have no choice.
    pub const fn can(self, policy: WaitPolicy) -> bool {
        matches!(policy, WaitPolicy::Block)
            || matches!(self, Self::Iceoryx2 | Self::Floor | Self::FloorFutex | Self::UnixSocket)
    }
}

impl std::str::FromStr for Contender {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|contender| contender.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("unknown peer `{text}`: expected some of {names}")
        })
    }
}

/// Opens the ports of one process of an in-tree contender, and sets how the process waits.
pub(crate) fn stage(setup: &mut Setup) -> Result<Box<dyn ChainStage>, HopError> {
    Ok(match setup.contender.as_str() {
        "iceoryx2" => {
            let stage = bus::open(setup)?;
            // The runtime does the polling itself, as its settings say.
            setup.policy = WaitPolicy::Block;
            stage
        }
        "iceoryx2-listener" => Box::new(listener::StockListener::open(setup)?),
        "floor" | "floor-futex" => Box::new(floor::Floor::open(setup)?),
        "unix-socket" => Box::new(unix_socket::UnixSocket::open(setup)?),
        other => return Err(HopError::Setup(format!("`{other}` is not run by this program"))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_others_are_refused_with_the_list() {
        for contender in Contender::ALL {
            assert_eq!(contender.name().parse(), Ok(contender));
        }
        let message = "dds".parse::<Contender>().unwrap_err();
        assert!(message.contains("`dds`") && message.contains("zenoh-shm"), "{message}");
    }
}
