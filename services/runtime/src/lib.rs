//! What all processes of the loop have in common: bus, clock, wake-up, start barrier, heartbeat.
//!
//! This is the only product crate that uses iceoryx2. A complete process of your own:
//!
//! ```no_run
//! use runtime::Process;
//! use shared_types::{Odometry, Pose, Role};
//!
//! fn main() -> Result<(), runtime::RuntimeError> {
//!     let mut process = Process::attach(Role::Estimator)?;
//!     let odometry = process.input::<Odometry>()?;
//!     let output = process.output::<Pose>()?;
//!     process.start()?;
//!     while process.wait(None)? {
//!         while let Some(measured) = odometry.take() {
//!             let (yaw_rad, x_m, y_m) = (measured.yaw_rad, measured.x_m, measured.y_m);
//!             output.publish(&mut Pose { header: measured.header.answer(), yaw_rad, x_m, y_m, ..Pose::default() })?;
//!         }
//!     }
//!     Ok(())
//! }
//! ```
//!
//! [`Process`] does the rest: it waits with a time-out, checks layouts, drops and counts samples of processes that are
//! not in charge, copies stamps, and handles signals.

mod alarm;
mod axis;
mod bell;
mod bus;
mod clock;
mod counters;
mod crash;
mod datagrams;
mod domain;
mod enclosed;
mod environment;
mod error;
mod folder;
mod goal;
mod guard;
mod handover;
mod identity;
mod input;
mod journal;
mod layouts;
mod link;
mod logging;
mod node;
mod observer;
mod orphan;
mod output;
mod own;
mod peer;
mod person;
mod place;
mod port;
mod process;
mod qos;
mod realtime;
mod refusals;
mod reserve;
mod settings;
mod shared;
mod shared_memory;
mod shutdown;
mod silence;
pub mod stage;
mod stop;
mod tamper;
mod terminal;
#[cfg(test)]
mod tests;
mod view;
mod waiter;
mod wake;
mod waker;

pub use axis::stick_range;
pub use bus::Bus;
pub use clock::{Clock, boottime_ns, monotonic_ns};
pub use crash::latch_on_crash;
pub use datagrams::drop_empty_datagrams;
pub use domain::{Domain, LOCK_FILE, remove_bus_files_of};
pub use environment::{
    CANDIDATE_VARIABLE, COMPANION_VARIABLE, DIRECTORY_VARIABLE, INCARNATION_VARIABLE, REPORT_VARIABLE,
    RESTART_VARIABLE, ROLE_VARIABLE, RUN_ID_VARIABLE, RUNTIME_DIR_VARIABLE, STOP_FD_VARIABLE,
    SYSTEM_ID_VARIABLE,
};
pub use error::RuntimeError;
pub use folder::Folder;
pub use goal::GoalOrder;
pub use handover::{Handover, HandoverData, read as read_handover, write as write_handover};
pub use identity::{
    Identified, Identity, NotOurs, PROCESSES_FILE, Seen, identify, pid_namespace, processes, processes_of,
    start_ticks, started_processes, started_processes_of_others, uid_of,
};
pub use input::{Input, Taken, join};
pub use layouts::{LAYOUTS_FILE, verify_layouts};
pub use link::{
    HUB, LINK_SOCKET, LinkCounts, LinkLoss, LinkPeer, LinkStatus, LinkTable, LinkedHost, LossReason,
    link_version, reply_socket,
};
pub use logging::{Priority, check_log_filter, print, print_answer, start_logging, writes_to_journal};
pub use observer::{Checked, Observer, Publisher, TopicObserver, TopicPublishers};
pub use orphan::LEAVING;
pub use output::Output;
pub use own::{
    AlsoReads, ByteTopic, Companion, CompanionPage, CompanionRow, CompanionSelfReport, Delays,
    EMERGENCY_STOP_FIELDS, LayoutField, LayoutFile, LoopTopic, MAX_COMPANIONS, NamedTopic, OPERATOR,
    OwnObserver, OwnPublisher, OwnTaken, OwnTopics, PortCount, PortTable, TOPICS_FILE, TakenBytes, TopicRow,
    memory_limit,
};
pub use peer::peer_uid;
pub use person::{EXECUTABLE_VARIABLE, Person};
pub use process::Process;
pub use qos::{PROCESS_QUEUE, observer_queue};
pub use realtime::{Realtime, Scheduler};
pub use reserve::Reserve;
pub use settings::{
    ClockKind, RunSettings, own_settings_file, settings_file, settings_table, started_settings_file,
};
pub use shared_memory::Shortage;
pub use shutdown::Shutdown;
pub use silence::{STOOD_STILL_NS, Silence};
pub use stop::{StopWord, Wheels};
pub use tamper::{Tamper, tamper_with};
pub use terminal::{
    flush_terminal, hold_terminal, is_terminal, one_line, printable, show_live_line, start_terminal,
};
pub use wake::wait_for;
pub use waker::Waker;
