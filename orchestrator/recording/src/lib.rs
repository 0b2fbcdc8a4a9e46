//! Recordings of drives: every sample of every topic in one file that other programs read too.

mod cdr;
pub mod copy;
mod earlier;
pub mod export;
mod foxglove;
pub mod imported;
pub mod info;
pub mod mcap;
mod own;
pub mod read;
pub mod recorder;
pub mod ros2;
pub mod running;
mod schema;
mod tape;

pub use foxglove::LogLine;
pub use read::{RecordedSample, Recording};
pub use schema::{schema, type_name};
pub use tape::{Tape, TapeTarget, writer};
