//! From the threads of a connection to the process of its driver: a queue of fixed size, which wakes the process.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Events that wait for the process: more than a second of data.
const QUEUED: usize = 32;

/// The end of the process.
#[derive(Debug)]
pub struct Feed<E> {
    events: Receiver<E>,
    /// Events that were put back.
    back: RefCell<VecDeque<E>>,
    is_ended: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl<E: Send + 'static> Feed<E> {
    /// A queue and its other end; `wake` is called there when there is an event.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> (Self, Outlet<E>) {
        let (sender, events) = sync_channel(QUEUED);
        let is_ended = Arc::new(AtomicBool::new(false));
        let outlet = Outlet { events: sender, wake: Arc::new(wake), is_ended: Arc::clone(&is_ended) };
        (Self { events, back: RefCell::default(), is_ended, threads: Vec::new() }, outlet)
    }

    /// Starts a thread, which has to end when its outlet says so.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn spawn(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
        self.threads.push(std::thread::Builder::new().name(name.to_owned()).spawn(run)?);
        Ok(())
    }

    /// The next event, if there is one.
    pub fn next(&self) -> Option<E> {
        let back = self.back.borrow_mut().pop_front();
        back.or_else(|| self.events.try_recv().ok())
    }

    /// Puts an event back, to be the next one.
    pub fn put_back(&self, event: E) {
        self.back.borrow_mut().push_back(event);
    }

    /// Waits for an event, until `end` at the longest.
    pub fn wait(&self, end: Instant) -> Option<E> {
        self.events.recv_timeout(end.saturating_duration_since(Instant::now())).ok()
    }
}

impl<E> Drop for Feed<E> {
    /// Ends the threads.
    fn drop(&mut self) {
        self.is_ended.store(true, Ordering::SeqCst);
        // A thread may wait for a place in the queue.
        while self.threads.iter().any(|thread| !thread.is_finished()) {
            let _ = self.events.recv_timeout(Duration::from_millis(5));
        }
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}

/// Where a thread puts its events.
pub struct Outlet<E> {
    events: SyncSender<E>,
    wake: Arc<dyn Fn() + Send + Sync>,
    is_ended: Arc<AtomicBool>,
}

impl<E> Clone for Outlet<E> {
    fn clone(&self) -> Self {
        let (wake, is_ended) = (Arc::clone(&self.wake), Arc::clone(&self.is_ended));
        Self { events: self.events.clone(), wake, is_ended }
    }
}

impl<E> Outlet<E> {
    /// Hands data over; they are dropped when the process does not take them.
    pub fn offer(&self, event: E) {
        let _ = self.events.try_send(event);
        (self.wake)();
    }

    /// Hands over what must not be lost; false when the process has ended.
    pub fn put(&self, event: E) -> bool {
        let is_there = self.events.send(event).is_ok();
        (self.wake)();
        is_there
    }

    /// Whether the process ends.
    pub fn is_ended(&self) -> bool {
        self.is_ended.load(Ordering::SeqCst)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_are_dropped_when_none_takes_them_and_what_was_put_back_comes_first() {
        let (feed, outlet) = Feed::new(|| {});
        (0..QUEUED + 5).for_each(|event| outlet.offer(event));
        feed.put_back(1000);
        let taken: Vec<usize> = std::iter::from_fn(|| feed.next()).collect();
        assert_eq!((taken[0], taken[1], taken.len()), (1000, 0, QUEUED + 1));
    }

    #[test]
    fn the_end_of_the_process_ends_a_thread_that_waits_for_a_place() {
        let (mut feed, outlet) = Feed::new(|| {});
        let ended = outlet.clone();
        feed.spawn("filler", move || while !outlet.is_ended() && outlet.put(1) {}).unwrap();
        drop(feed);
        assert!(ended.is_ended());
    }
}
