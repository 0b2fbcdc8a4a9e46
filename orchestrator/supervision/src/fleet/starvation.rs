//! Tells a process that is only short of a processor from one that hangs.

use crate::child::is_runnable;

/// A process that has used this much time on a processor without progress is not starved [s]: a quarter of the
/// shortest hang limit, and three times what a scan takes at most.
const STARVED_CPU_S: f64 = 0.075;

/// What is known of a process that makes no progress: its incarnation, and its processor time when that was noticed [s].
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Starvation(Option<(u32, f64)>);

impl Starvation {
    /// Whether a process that makes no progress is only short of a processor. Ask as soon as it is suspected: its
    /// processor time counts from then on.
    ///
    /// One that sleeps or was stopped is not starved, nor is one that has used a good part of a hang limit since.
    pub(super) fn is_starved(&mut self, incarnation: u32, pid: u32) -> bool {
        let Some((runnable, cpu_s)) = is_runnable(pid) else { return false };
        match self.0 {
            Some((suspect, before_s)) if suspect == incarnation => {
                runnable && cpu_s - before_s < STARVED_CPU_S
            }
            _ => {
                self.0 = Some((incarnation, cpu_s));
                runnable
            }
        }
    }

    /// The process makes progress.
    pub(super) fn clear(&mut self) {
        self.0 = None;
    }
}
