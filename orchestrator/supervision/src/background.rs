//! A thread for work that may block, such as disk access, so that the loop never waits for it.
//!
//! Jobs run one after the other. When one does not return, the queue fills up and later jobs are dropped.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

/// Most jobs that wait.
const MAX_JOBS: usize = 64;

type Job = Box<dyn FnOnce() + Send>;

/// A thread that runs jobs. It ends by itself once this is dropped and all jobs are done.
#[derive(Debug)]
pub struct Background {
    /// `None` when no thread could be started: then jobs are dropped.
    jobs: Option<SyncSender<Job>>,
}

impl Background {
    /// Starts the thread.
    pub fn new(name: &str) -> Self {
        let (jobs, queue) = sync_channel::<Job>(MAX_JOBS);
        let started = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || queue.into_iter().for_each(|job| job()));
        Self { jobs: started.is_ok().then_some(jobs) }
    }

    /// Queues a job; false when it is dropped, because too many wait.
    pub fn post(&self, job: impl FnOnce() + Send + 'static) -> bool {
        self.jobs.as_ref().is_some_and(|jobs| jobs.try_send(Box::new(job)).is_ok())
    }

    /// Queues a job and waits for its result, but not longer than `limit`; the job may still run later.
    pub fn call<T: Send + 'static>(
        &self,
        limit: Duration,
        job: impl FnOnce() -> T + Send + 'static,
    ) -> Option<T> {
        let (answer, answers) = sync_channel(1);
        let posted = self.post(move || _ = answer.try_send(job()));
        answers.recv_timeout(limit).ok().filter(|_| posted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn a_job_that_does_not_return_delays_no_caller() {
        let background = Background::new("test");
        let (release, waits) = channel::<()>();
        assert!(background.post(move || _ = waits.recv()));
        assert_eq!(background.call(Duration::from_millis(5), || 1), None);
        let taken = (0..2 * MAX_JOBS).filter(|_| background.post(|| {})).count();
        assert!(taken <= MAX_JOBS, "{taken}");
        drop(release);
        // A minute is far more than a busy machine takes for 64 empty jobs.
        let started = std::time::Instant::now();
        while !background.post(|| {}) && started.elapsed() < Duration::from_secs(60) {
            std::thread::yield_now();
        }
        assert_eq!(background.call(Duration::from_secs(60), || 2), Some(2));
    }
}
