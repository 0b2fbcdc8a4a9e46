//! What the benches share: recorded laps, the time per scan of a stage, a bus of one's own.

mod echo;
mod lap;

pub use echo::{Echo, Peer, echo_until_told};
pub use lap::Lap;
