//! Other work on every processor, as long as the value lives.
//!
//! One thread is pinned to each processor that this process may use. It loops without system calls and without memory
//! accesses, so it takes only processor time. The threads end with the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use console::output::data;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// The name of the service that is load until its standard input ends.
pub(crate) const SERVICE: &str = "load";

/// Busy loops; dropping it ends them.
pub(crate) struct Load {
    end: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Starts one loop on each processor.
    ///
    /// # Errors
    /// When the processors can't be read or a thread can't be started.
    pub(crate) fn start() -> anyhow::Result<Self> {
        let allowed = sched_getaffinity(None)?;
        let mut load = Self { end: Arc::new(AtomicBool::new(false)), threads: Vec::new() };
        for cpu in (0..CpuSet::MAX_CPU).filter(|&cpu| allowed.is_set(cpu)) {
            let end = Arc::clone(&load.end);
            let thread = std::thread::Builder::new().name(format!("load-{cpu}")).spawn(move || {
                let mut one = CpuSet::new();
                one.set(cpu);
                // Without pinning it is still load.
                let _ = sched_setaffinity(None, &one);
                while !end.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            })?;
            load.threads.push(thread);
        }
        Ok(load)
    }

    /// How many loops there are.
    pub(crate) fn count(&self) -> usize {
        self.threads.len()
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// The service: prints the number of loops, and runs them until its standard input ends.
///
/// # Errors
/// As [`Load::start`].
pub(crate) fn run() -> anyhow::Result<()> {
    let load = Load::start()?;
    data(&load.count().to_string())?;
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_one_loop_for_each_processor_and_it_ends() {
        let load = Load::start().unwrap();
        assert_eq!(load.count(), sched_getaffinity(None).unwrap().count() as usize);
        drop(load);
    }
}
