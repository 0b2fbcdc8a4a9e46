//! The life of the process of one role.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use shared_types::{ProcessState, Role};

use super::policy::{ProcessPolicy, nanoseconds};

/// A process that does not get a processor for so many hang limits is killed all the same.
const MAX_EXCUSES: u64 = 10;
/// Time between two events counts as silence of the process up to this share of the hang limit.
const MAX_GAP_SHARE: u64 = 3;

/// What a process is doing, as `scanloop status` shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VisibleState {
    /// It has no valid output yet.
    Starting,
    /// It has published a valid output.
    Ready,
    /// It is ready to take over again. Only a swap has such a process; the supervisor does not run it.
    Standby,
    /// It computes in the shadow of the process in charge. The supervisor does not run it.
    Shadow,
    /// It stopped making progress and was killed, but has not gone yet.
    Hung,
    /// It died and is about to be started again.
    Backoff,
    /// It could not be started or kept running: the run ends because of it.
    Failed,
    /// It is not running, and nothing is wrong with that.
    Stopped,
}

impl VisibleState {
    /// The name in `status --json`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Ready => "ready",
            Self::Standby => "standby",
            Self::Shadow => "shadow",
            Self::Hung => "hung",
            Self::Backoff => "backoff",
            Self::Failed => "failed",
            Self::Stopped => "stopped",
        }
    }
}

impl std::fmt::Display for VisibleState {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.pad(self.name())
    }
}

/// What is known of the process of one role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProcessView {
    /// The role.
    pub role: Role,
    /// What it is doing.
    pub state: VisibleState,
    /// The incarnation that lives or lived last; 0 before the first.
    pub incarnation: u32,
    /// Its process id, while it lives.
    pub pid: Option<u32>,
    /// How often it was started again.
    pub restarts: u32,
    /// How the last one ended, or why it could not be started.
    pub last_exit: Option<String>,
}

/// Stages in the life of the process of a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Life {
    /// Not started yet.
    Idle,
    /// Asked for, no answer yet.
    Spawning,
    /// There is a process.
    Alive(Alive),
    /// Dead; its remains are being removed from the bus. To be started from `due_ns` on.
    CleaningUp { due_ns: u64 },
    /// Dead and cleaned up; to be started at `due_ns`.
    Waiting { due_ns: u64 },
    /// Given up.
    Failed,
    /// Ended for good.
    Stopped,
}

/// A living process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Alive {
    /// Process id.
    pub(super) pid: u32,
    /// The furthest it got: attached, connected or ready.
    pub(super) reached: Option<ProcessState>,
    /// When it was first known to be ready.
    pub(super) ready_ns: Option<u64>,
    /// Until when it must have attached, connected, or had its first output.
    pub(super) start_deadline_ns: Option<u64>,
    /// When it last made progress.
    pub(super) progress_ns: u64,
    /// Until when it is not called hung, because it does not get a processor.
    pub(super) excused_ns: u64,
    /// Why it is being ended, if it is.
    pub(super) ending: Option<EndReason>,
    /// When it is killed, if it has not ended by then.
    pub(super) kill_ns: Option<u64>,
}

impl Alive {
    /// A process that has reported nothing yet and was not asked to end.
    pub(super) fn new(pid: u32, now_ns: u64) -> Self {
        Self { pid, progress_ns: now_ns, ..Self::default() }
    }
}

/// Why a process is being ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EndReason {
    /// The run ends.
    Stop,
    /// It is to be started again.
    Restart,
    /// It made no progress.
    Hung,
    /// It did not attach or connect in time.
    StartTimeout,
    /// It had all its inputs, and no output in time.
    NoOutput,
    /// Its outputs were dropped, and a reader had none that it could use in time.
    Refused,
}

/// A limit that a death has reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Limit {
    /// Too many in a row before the first output.
    Start,
    /// Too many within the window.
    Restart,
}

/// The process of one role with its history.
#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub(super) policy: ProcessPolicy,
    pub(super) life: Life,
    /// The last incarnation asked for; 0 before the first.
    pub(super) incarnation: u32,
    pub(super) restarts: u32,
    /// Deaths since the last healthy run.
    pub(super) streak: u32,
    /// Deaths before readiness since the last healthy run.
    pub(super) failed_starts: u32,
    /// Times of the deaths after readiness within the window [ns].
    pub(super) deaths: VecDeque<u64>,
    pub(super) last_exit: Option<String>,
    /// Its outputs are dropped by a reader that has had none that it could use.
    pub(super) refused: Option<Refused>,
    /// What the devices behind it do, by its newest report.
    pub(super) device: Option<String>,
    /// The run ends because of it.
    pub(super) is_at_fault: bool,
}

/// Outputs of a process that were dropped.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Refused {
    /// Role of the process that dropped them.
    pub(super) reader: Role,
    /// The newest of them, and what is wrong with it.
    pub(super) reason: String,
}

impl Slot {
    pub(super) fn new(policy: ProcessPolicy) -> Self {
        Self {
            policy,
            life: Life::Idle,
            incarnation: 0,
            restarts: 0,
            streak: 0,
            failed_starts: 0,
            deaths: VecDeque::new(),
            last_exit: None,
            refused: None,
            device: None,
            is_at_fault: false,
        }
    }

    /// Whether there is a process, or is about to be one.
    pub(super) fn is_live(&self) -> bool {
        matches!(self.life, Life::Spawning | Life::Alive(_))
    }

    /// The living process, when it is of this incarnation.
    pub(super) fn alive(&mut self, incarnation: u32) -> Option<&mut Alive> {
        match &mut self.life {
            Life::Alive(alive) if self.incarnation == incarnation => Some(alive),
            _ => None,
        }
    }

    /// Whether it lives and got as far as `state`.
    pub(super) fn has_reached(&self, state: ProcessState) -> bool {
        matches!(self.life, Life::Alive(Alive { reached, ending: None, .. }) if reached >= Some(state))
    }

    /// Whether it lives, is ready, and was not asked to end.
    pub(super) fn is_ready(&self) -> bool {
        self.has_reached(ProcessState::Ready)
    }

    /// Counts a death; the limit that it reaches, if it does.
    pub(super) fn count_death(&mut self, now_ns: u64, ready_ns: Option<u64>) -> Option<Limit> {
        let healthy_ns = nanoseconds(self.policy.healthy_after_ms);
        if ready_ns.is_some_and(|ready_ns| now_ns.saturating_sub(ready_ns) >= healthy_ns) {
            self.streak = 0;
            self.failed_starts = 0;
        }
        self.streak = self.streak.saturating_add(1);
        if ready_ns.is_none() {
            self.failed_starts = self.failed_starts.saturating_add(1);
        }
        let window_ns = nanoseconds(self.policy.restart_window_ms);
        self.deaths.retain(|then_ns| now_ns.saturating_sub(*then_ns) < window_ns);
        self.deaths.extend(ready_ns.map(|_| now_ns));
        if self.failed_starts >= self.policy.start_limit {
            return Some(Limit::Start);
        }
        (self.deaths.len() > self.policy.restart_limit as usize).then_some(Limit::Restart)
    }

    /// Forgets all deaths: another program fills the role.
    pub(super) fn forget_deaths(&mut self) {
        (self.streak, self.failed_starts, self.last_exit) = (0, 0, None);
        self.deaths.clear();
    }

    /// When the process will be called hung, if it is watched for that.
    pub(super) fn hang_deadline_ns(&self) -> Option<u64> {
        match self.life {
            Life::Alive(alive) if self.has_reached(ProcessState::Connected) => {
                let limit_ns = nanoseconds(self.policy.hang_after_ms);
                let at_last_ns = alive.progress_ns.saturating_add(limit_ns.saturating_mul(MAX_EXCUSES));
                Some(alive.progress_ns.saturating_add(limit_ns).max(alive.excused_ns).min(at_last_ns))
            }
            _ => None,
        }
    }

    /// After a longer gap between two events the caller does not know which processes made progress [ns].
    pub(super) fn longest_gap_ns(&self) -> u64 {
        nanoseconds(self.policy.hang_after_ms) / MAX_GAP_SHARE
    }

    pub(super) fn view(&self) -> ProcessView {
        let (state, pid) = match self.life {
            Life::Stopped if self.is_at_fault => (VisibleState::Failed, None),
            Life::Idle | Life::Stopped => (VisibleState::Stopped, None),
            Life::Spawning => (VisibleState::Starting, None),
            Life::CleaningUp { .. } | Life::Waiting { .. } => (VisibleState::Backoff, None),
            Life::Failed => (VisibleState::Failed, None),
            Life::Alive(alive) => {
                let state = match (alive.ending, alive.ready_ns) {
                    (Some(EndReason::Hung), _) => VisibleState::Hung,
                    (_, Some(_)) => VisibleState::Ready,
                    (_, None) => VisibleState::Starting,
                };
                (state, Some(alive.pid))
            }
        };
        let Self { incarnation, restarts, .. } = *self;
        ProcessView {
            role: self.policy.role,
            state,
            incarnation,
            pid,
            restarts,
            last_exit: self.last_exit.clone(),
        }
    }
}
