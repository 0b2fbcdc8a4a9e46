//! The interface of commands to a user at a terminal: exit codes, output, progress, files of the user.

pub mod control_group;
pub mod exit;
pub mod limits;
pub mod new_file;
pub mod out_folder;
pub mod output;
pub mod progress;
pub mod screen;
pub mod user_file;
