//! The processes of a system as the operating system sees them: started, watched, signalled, reaped.

pub mod background;
pub mod child;
pub mod child_log;
pub mod directives;
pub mod entry;
pub mod environment;
pub mod fleet;
pub mod halt;
pub mod keeper;
pub mod lock;
pub mod private_system;
pub mod realtime;
pub mod replaceable;
pub mod room;
pub mod runs;
pub mod supervisor;
