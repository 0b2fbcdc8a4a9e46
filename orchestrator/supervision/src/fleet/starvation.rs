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

#[cfg(test)]
mod tests {
    use std::process::{Child, Command, Stdio};
    use std::time::{Duration, Instant};

    use super::*;

    /// A child that is killed when the test ends.
    struct Killed(Child);

    impl Drop for Killed {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    fn child(script: &str) -> Killed {
        let mut command = Command::new("sh");
        Killed(command.args(["-c", script]).stdin(Stdio::piped()).spawn().expect("a shell"))
    }

    /// Waits until a process is as it should be.
    fn wait_for(pid: u32, condition: impl Fn(bool, f64) -> bool) {
        let begun = Instant::now();
        while !is_runnable(pid).is_some_and(|(runnable, cpu_s)| condition(runnable, cpu_s)) {
            assert!(begun.elapsed() < Duration::from_secs(30), "{:?}", is_runnable(pid));
            std::thread::yield_now();
        }
    }

    #[test]
    fn one_that_works_without_progress_hangs_and_one_that_gets_no_processor_does_not() {
        let busy = child("while :; do :; done");
        let pid = busy.0.id();
        wait_for(pid, |_, cpu_s| cpu_s > 0.02);
        let mut starvation = Starvation::default();
        assert!(starvation.is_starved(7, pid), "it is runnable, and its time counts from now on");
        let (_, before_s) = is_runnable(pid).expect("a process");
        wait_for(pid, |_, cpu_s| cpu_s - before_s > STARVED_CPU_S);
        assert!(!starvation.is_starved(7, pid), "it had a processor for long enough");
        assert!(starvation.is_starved(8, pid), "the time of another incarnation counts anew");
        starvation.clear();
        assert!(starvation.is_starved(8, pid), "so does that after progress");
    }

    #[test]
    fn one_that_sleeps_or_is_gone_is_not_starved() {
        let asleep = child("read line");
        wait_for(asleep.0.id(), |runnable, _| !runnable);
        let mut starvation = Starvation::default();
        assert!(!starvation.is_starved(7, asleep.0.id()) && !starvation.is_starved(7, asleep.0.id()));
        assert!(!starvation.is_starved(7, u32::MAX));
    }
}
