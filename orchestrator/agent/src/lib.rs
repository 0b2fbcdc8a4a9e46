//! Processes on other hosts: the agent that starts them there, and the proxy that stands for one at the orchestrator.
//!
//! The orchestrator supervises a process on another host as any other: it starts a proxy here, which has the agent there
//! start the process, and ends as that ends. Hangs are detected by heartbeats, which cross the link. So there is one
//! supervisor, and an agent decides nothing but what it refuses.
//!
//! Messages may be lost, doubled or late: each one says what is to be, not what is to be done, and is repeated ten times
//! a second.

pub mod agent;
pub mod file;
pub mod link;
pub mod message;
pub mod proxy;
mod served;
