//! The view of `run --top`: a process that draws on the terminal of the run while the run keeps silent.

use std::os::fd::{AsFd, OwnedFd};
use std::process::Command;
use std::sync::Arc;
use std::thread::JoinHandle;

use console::exit::Failure;
use console::screen::{self, ScreenGuard};
use runtime::hold_terminal;
use rustix::event::{EventfdFlags, eventfd};
use supervision::child::this_program;

/// A view; dropping it ends it and frees the terminal.
pub(crate) struct TopView {
    /// Made readable when the view is to end.
    end: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl TopView {
    /// Passes when there is a terminal.
    ///
    /// # Errors
    /// Exit code 2.
    pub(crate) fn require_terminal() -> anyhow::Result<()> {
        let refused = "--top needs a terminal as standard input and standard error";
        if screen::is_available() { Ok(()) } else { Err(Failure::bad_input(refused)) }
    }

    /// Starts the view of a system that is about to start.
    ///
    /// # Errors
    /// Without descriptors or threads.
    pub(crate) fn start(system_id: &str) -> anyhow::Result<Self> {
        let end = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let mut command = Command::new(this_program());
        command.args(["--system-id", system_id, "top", "--draw", "--of-run"]);
        let until = Arc::clone(&end);
        hold_terminal(true);
        // The kernel ends the view with the thread that started it, so the same thread waits for it.
        let view = move || {
            let ended = ScreenGuard::start(&mut command).and_then(|mut guard| guard.wait(&[until.as_fd()]));
            hold_terminal(false);
            match ended {
                Ok(status) if status.success() => {}
                Ok(status) => tracing::warn!("the view has ended: {status}"),
                Err(error) => tracing::warn!(%error, "no view"),
            }
        };
        let thread = std::thread::Builder::new().name("view".to_owned()).spawn(view);
        let thread = thread.inspect_err(|_| hold_terminal(false))?;
        Ok(Self { end, thread: Some(thread) })
    }
}

impl Drop for TopView {
    fn drop(&mut self) {
        let _ = rustix::io::write(&self.end, &1_u64.to_ne_bytes());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
