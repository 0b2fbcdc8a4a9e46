//! The live page: a small HTTP server that shows a running system, or a recording, in a browser.
//!
//! One thread, the *collector*, observes the system and makes at most ten frames a second, see `source`. The hub keeps
//! the newest one and five minutes of earlier ones. Each connection has a thread of its own, which waits for the hub and
//! writes the newest frame to its browser as a server-sent event. So a browser that does not read delays its own
//! connection only: frames that it misses are replaced by newer ones. The system is only observed, and an observer
//! never delays a scan.
//!
//! A recording has no newest frame: each page asks for the frame of the time that it shows, see `recorded`.
//!
//! `scanloop report` writes the same page to a file, with a recording in it, see `enclosed`.
//!
//! Who may read and who may control is decided in `access`, once per request.

mod access;
mod actions;
mod arguments;
mod child;
mod course;
mod enclosed;
mod events;
pub mod follower;
mod frame;
mod hand;
mod history;
mod http;
mod hub;
mod live;
mod pages;
mod peer;
mod questions;
mod recorded;
mod scene;
mod server;
mod source;
mod statuses;
mod stream;

pub use actions::Verb;
pub use arguments::ViewArguments;
pub use child::ViewOfRun;
pub use enclosed::{ReportArguments, report};
pub use server::serve;
