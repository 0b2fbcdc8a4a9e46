//! What every source gives, and how it is refused.

use std::path::Path;

use console::exit::Failure;
use recording::ros2::{BaseOdometry, LaserScan};

/// A message that is imported.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Message {
    Scan(LaserScan),
    Odometry(BaseOdometry),
}

/// Takes messages with their log times [ns].
pub(crate) type Each<'e> = dyn FnMut(u64, Message) -> anyhow::Result<()> + 'e;

/// The error about a file; exit code 2.
pub(crate) fn refuse(path: &Path, reason: impl std::fmt::Display) -> anyhow::Error {
    Failure::bad_input(format!("{}: {reason}", path.display()))
}
