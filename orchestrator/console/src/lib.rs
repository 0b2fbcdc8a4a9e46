//! What a command and a person at a terminal say to each other: exit codes, lines, progress, files of the user.

pub mod exit;
pub mod limits;
pub mod output;
pub mod progress;
pub mod user_file;
