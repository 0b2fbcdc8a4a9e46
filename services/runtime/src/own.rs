//! Topics and processes that a system file adds to those of the loop.
//!
//! The orchestrator writes one table of them ([`OwnTopics`]) and makes their services. A [`Companion`] is a process
//! that fills no role. It reads topics of the loop and of its own, and writes topics of its own. Processes of the loop
//! open such a topic by name with [`crate::Process::open`].
//!
//! Companions have no part in directives and heartbeats of the loop: a page of shared memory ([`CompanionPage`]) has
//! what the orchestrator tells them and what they report. They wake by the events of the bus, which work in all
//! languages. On a topic of the loop they sleep where observers do. So a companion adds nothing to the work of a
//! process of the loop, except a system call per sample while it sleeps there.

mod builtin;
mod companion;
mod emergency;
mod field;
mod member;
mod page;
mod ports;
mod reader;
mod table;
mod topic;
mod writer;

pub use builtin::LoopTopic;
pub use companion::Companion;
pub use emergency::EMERGENCY_STOP_FIELDS;
pub use page::{CompanionPage, CompanionSelfReport, MAX_COMPANIONS};
pub use ports::{Delays, PortCount, PortTable};
pub use table::{
    AlsoReads, CompanionRow, LayoutField, LayoutFile, OPERATOR, OwnTopics, TOPICS_FILE, TopicRow,
    memory_limit,
};
pub use topic::{ByteTopic, NamedTopic, OwnTaken, TakenBytes};

pub(crate) use emergency::EmergencyStop;
pub(crate) use field::OwnFields;
pub(crate) use member::{Member, Place};

pub use reader::OwnObserver;
pub use writer::OwnPublisher;
