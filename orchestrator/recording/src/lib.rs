//! Recordings of drives: every sample of every topic in one file that other programs read too.

pub mod copy;
mod earlier;
pub mod export;
mod foxglove;
pub mod info;
pub mod mcap;
mod own;
pub mod read;
pub mod recorder;
pub mod running;
mod schema;
mod tape;

pub use foxglove::LogLine;
pub use read::{RecordedSample, Recording};
pub use schema::{schema, type_name};
pub use tape::{Tape, TapeTarget, writer};
