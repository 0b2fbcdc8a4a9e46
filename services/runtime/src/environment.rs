//! The environment variables by which an orchestrator tells a process where it belongs.

/// Names the system that the process belongs to.
pub const SYSTEM_ID_VARIABLE: &str = "SCANLOOP_SYSTEM_ID";
/// Gives the process its incarnation, one number per started process.
pub const INCARNATION_VARIABLE: &str = "SCANLOOP_INCARNATION";
/// Gives the random id of the run, by which its shared memory is named.
pub const RUN_ID_VARIABLE: &str = "SCANLOOP_RUN_ID";
/// Gives the directory of the system.
pub const DIRECTORY_VARIABLE: &str = "SCANLOOP_DIRECTORY";
/// Names the role that the process was started for.
pub const ROLE_VARIABLE: &str = "SCANLOOP_ROLE";
/// Names the companion that the process was started as, instead of a role.
pub const COMPANION_VARIABLE: &str = "SCANLOOP_COMPANION";
/// Gives a companion the number of its report in the page that it shares with the orchestrator.
pub const REPORT_VARIABLE: &str = "SCANLOOP_REPORT";
/// Gives the number of the inherited descriptor of the stop word.
pub const STOP_FD_VARIABLE: &str = "SCANLOOP_STOP_FD";
/// Chooses the directory in which the directories of systems are; for users.
pub const RUNTIME_DIR_VARIABLE: &str = "SCANLOOP_RUNTIME_DIR";

/// Is `1` for a process that replaces another: after a crash, or in a swap.
pub const RESTART_VARIABLE: &str = "SCANLOOP_RESTART";

/// Gives a candidate the incarnation of the running process of its role.
pub const CANDIDATE_VARIABLE: &str = "SCANLOOP_BESIDE";

/// The incarnation of the running process that this one is a candidate to replace.
pub(crate) fn incumbent() -> Option<u32> {
    std::env::var(CANDIDATE_VARIABLE).ok()?.parse().ok().filter(|incarnation| *incarnation > 0)
}

/// Whether this process replaces another.
pub(crate) fn is_restart() -> bool {
    std::env::var(RESTART_VARIABLE).is_ok_and(|value| value == "1")
}
