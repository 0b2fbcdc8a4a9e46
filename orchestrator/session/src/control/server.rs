//! The listener of the control socket: a thread that accepts, and one per connection that lives for seconds.
//!
//! Where the machine gives no more threads or descriptors, the listener serves one connection after the other itself, with a
//! descriptor that it keeps for that. So a system can be asked and stopped whatever has run out.

use std::fs::Permissions;
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use runtime::{peer_uid, wait_for};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::Errno;
use rustix::process::geteuid;

use super::line::{read_line, write_line};
use super::{Reply, Request};

/// Most connections at once; one more receives [`BUSY`] and is closed.
const MAX_CONNECTIONS: usize = 16;
/// Longest request [bytes]: a swap with a long command line.
const MAX_REQUEST: usize = 64 << 10;
/// A request must be there within this time.
const READ_TIMEOUT: Duration = Duration::from_secs(1);
/// An answer must be taken within this time.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// A request waits this long for the loop.
const LOOP_TIMEOUT: Duration = Duration::from_secs(10);
/// Pause after the machine refused a connection, for example without free descriptors [ns].
const REFUSED_PAUSE_NS: u64 = 50_000_000;
/// No wait is without a timeout [ns].
const ACCEPT_NS: u64 = 1_000_000_000;
/// Stack of a connection's thread [bytes]: requests and answers are on the heap.
const STACK: usize = 256 << 10;

/// Answer to a connection too many.
pub(super) const BUSY: &str = "too many connections to the orchestrator at once";

/// A request that waits for the loop.
#[derive(Debug)]
pub(super) struct Asked {
    pub(super) request: Request,
    pub(super) answer: SyncSender<Reply>,
    /// The client is told after this time that the request was not carried out.
    until: Instant,
    client: Arc<UnixStream>,
}

impl Asked {
    /// Whether it is still carried out: a client that has hung up was told that it was not. A stop always is.
    ///
    /// A client that only sends nothing more waits for its answer.
    pub(super) fn is_awaited(&self) -> bool {
        if self.request == Request::Stop {
            return true;
        }
        let mut set = [PollFd::new(&*self.client, PollFlags::empty())];
        let has_hung_up = matches!(poll(&mut set, Some(&Timespec::default())), Ok(ready) if ready > 0);
        Instant::now() < self.until && !has_hung_up
    }
}

/// The threads of the socket; they end when this is dropped.
#[derive(Debug)]
pub(super) struct Server {
    /// Readable when a request waits.
    pub(super) wake: Arc<OwnedFd>,
    requests: Receiver<Asked>,
    /// Made readable when the listener is to end.
    end: Arc<OwnedFd>,
    listener: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens at `path`; a file that is there is replaced.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let _ = std::fs::remove_file(path);
        let listener = UnixListener::bind(path)?;
        // Independent of the umask. Before, the private directory keeps others from connecting.
        std::fs::set_permissions(path, Permissions::from_mode(0o600))?;
        listener.set_nonblocking(true)?;
        let (wake, end) = (Arc::new(event()?), Arc::new(event()?));
        let (sender, requests) = sync_channel(MAX_CONNECTIONS);
        let inbox = Inbox { sender, wake: Arc::clone(&wake) };
        let until = Arc::clone(&end);
        let accept = move || accept_until(&listener, &until, &inbox);
        let thread = std::thread::Builder::new().name("control".to_owned()).spawn(accept)?;
        Ok(Self { wake, requests, end, listener: Some(thread) })
    }

    /// The requests that wait.
    pub(super) fn take(&self) -> impl Iterator<Item = Asked> {
        // First the signal, then the requests: one that comes in between is taken now or wakes again.
        let _ = rustix::io::read(&*self.wake, &mut [0; 8]);
        self.requests.try_iter()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        signal(&self.end);
        if let Some(listener) = self.listener.take() {
            let _ = listener.join();
        }
    }
}

/// Hands requests of a connection to the loop.
#[derive(Debug, Clone)]
struct Inbox {
    sender: SyncSender<Asked>,
    wake: Arc<OwnedFd>,
}

fn event() -> io::Result<OwnedFd> {
    Ok(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?)
}

fn signal(event: &OwnedFd) {
    // It fails when the event is readable already.
    let _ = rustix::io::write(event, &1u64.to_ne_bytes());
}

fn accept_until(listener: &UnixListener, end: &OwnedFd, inbox: &Inbox) {
    // Each connection holds one more reference; their number is the number of connections.
    let places = Arc::new(());
    let mut spare = Spare::new(end);
    loop {
        wait_for(&[listener.as_fd(), end.as_fd()], ACCEPT_NS);
        if wait_for(&[end.as_fd()], 0) {
            return;
        }
        match listener.accept() {
            Ok((stream, _)) => admit(stream, &places, inbox),
            Err(error) if spare.free_for(&error) => {
                if let Ok((stream, _)) = listener.accept() {
                    serve_here(&Arc::new(stream), inbox);
                }
                spare.renew(end);
            }
            Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => {}
            Err(_) => {
                spare.renew(end);
                _ = wait_for(&[end.as_fd()], REFUSED_PAUSE_NS);
            }
        }
    }
}

/// Gives a connection a thread, if it is allowed.
fn admit(stream: UnixStream, places: &Arc<()>, inbox: &Inbox) {
    if !peer_uid(&stream).is_ok_and(|peer| may_ask(peer, geteuid().as_raw())) {
        return;
    }
    if Arc::strong_count(places) > MAX_CONNECTIONS {
        // The buffer of a new connection is large enough for this, so it does not wait.
        let _ = stream.set_nonblocking(true);
        let _ = answer(&stream, &Reply::Refused(BUSY.to_owned()));
        return;
    }
    let stream = Arc::new(stream);
    let serve = {
        let (place, stream, inbox) = (Arc::clone(places), Arc::clone(&stream), inbox.clone());
        move || {
            serve_one(&stream, &inbox);
            drop(place);
        }
    };
    let started = std::thread::Builder::new().name("client".to_owned()).stack_size(STACK).spawn(serve);
    if started.is_err() {
        serve_one(&stream, inbox);
    }
}

/// Serves a connection on this thread, if it is allowed.
fn serve_here(stream: &Arc<UnixStream>, inbox: &Inbox) {
    if peer_uid(stream).is_ok_and(|peer| may_ask(peer, geteuid().as_raw())) {
        serve_one(stream, inbox);
    }
}

fn serve_one(stream: &Arc<UnixStream>, inbox: &Inbox) {
    if let Err(error) = answer_one(stream, inbox) {
        tracing::debug!(%error, "a client of the control socket was dropped");
    }
}

/// A descriptor for one connection when the process, or the machine, has no other.
struct Spare(Option<OwnedFd>);

impl Spare {
    fn new(of: &OwnedFd) -> Self {
        Self(of.try_clone().ok())
    }

    /// Whether `error` says that descriptors have run out, and one was freed.
    fn free_for(&mut self, error: &io::Error) -> bool {
        let is_shortage = matches!(Errno::from_io_error(error), Some(Errno::MFILE | Errno::NFILE));
        is_shortage && self.0.take().is_some()
    }

    fn renew(&mut self, of: &OwnedFd) {
        *self = Self::new(of);
    }
}

/// The user of this process may, and root, which could do anything to it anyway.
fn may_ask(peer: u32, own: u32) -> bool {
    peer == own || peer == 0
}

/// Reads a request, has it answered by the loop, and writes the answer.
fn answer_one(stream: &Arc<UnixStream>, inbox: &Inbox) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    let request = match read_line(stream, MAX_REQUEST, Instant::now() + READ_TIMEOUT) {
        Ok(Some(line)) => serde_json::from_str::<Request>(&line).map_err(|error| error.to_string()),
        Ok(None) => return Ok(()),
        Err(error) if error.kind() == ErrorKind::FileTooLarge => {
            Err(format!("longer than {MAX_REQUEST} bytes"))
        }
        Err(error) => return Err(error),
    };
    let reply = match request {
        Ok(request) => ask_loop(request, stream, inbox),
        Err(reason) => Some(Reply::Refused(format!("not a request: {reason}"))),
    };
    // Without a reply the run is over, and the connection is closed.
    reply.map_or(Ok(()), |reply| answer(stream, &reply))
}

/// What the loop answers; `None` when the run is over.
fn ask_loop(request: Request, stream: &Arc<UnixStream>, inbox: &Inbox) -> Option<Reply> {
    let (answer, answers) = sync_channel(1);
    let until = Instant::now() + LOOP_TIMEOUT;
    let late = |within: &str| Some(Reply::Refused(format!("the orchestrator does not answer{within}")));
    let asked = Asked { request, answer, until, client: Arc::clone(stream) };
    match inbox.sender.try_send(asked) {
        Ok(()) => signal(&inbox.wake),
        Err(TrySendError::Full(_)) => return late(""),
        Err(TrySendError::Disconnected(_)) => return None,
    }
    match answers.recv_timeout(LOOP_TIMEOUT) {
        Ok(reply) => Some(reply),
        Err(RecvTimeoutError::Timeout) => late(" within 10 s"),
        Err(RecvTimeoutError::Disconnected) => None,
    }
}

fn answer(stream: &UnixStream, reply: &Reply) -> io::Result<()> {
    write_line(stream, &serde_json::to_string(reply)?, Instant::now() + WRITE_TIMEOUT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_user_and_root_may_ask() {
        let [root, own, other] = [0, 1000, 1001];
        assert!(may_ask(own, own) && may_ask(root, own) && may_ask(root, root));
        assert!(!may_ask(other, own) && !may_ask(own, root));
    }

    /// The requests that a server carries out of those whose clients have sent them and done `after`, in their order.
    fn carried_out(requests: &[Request], after: fn(UnixStream) -> Option<UnixStream>) -> Vec<Request> {
        let folder = console::new_file::Scratch::new().unwrap();
        let path = folder.path().join("control.sock");
        let server = Server::open(&path).unwrap();
        let mut found = Vec::new();
        for request in requests {
            let client = UnixStream::connect(&path).unwrap();
            let line = serde_json::to_string(request).unwrap();
            write_line(&client, &line, Instant::now() + READ_TIMEOUT).unwrap();
            let client = after(client);
            assert!(wait_for(&[server.wake.as_fd()], 10_000_000_000), "no request came");
            found.extend(server.take().filter(Asked::is_awaited).map(|asked| asked.request));
            drop(client);
        }
        found
    }

    #[test]
    fn of_a_client_that_has_hung_up_only_a_stop_is_carried_out() {
        let role = shared_types::Role::Controller;
        let swap = r#"{"swap":{"role":"controller","implementation":null,"command":null,"set":["controller.cruise_mps=0.9"],
            "shadow_scans":10,"standby_scans":10,"tolerance":1.0}}"#;
        let swap = serde_json::from_str(swap).unwrap();
        let requests = [Request::Restart { role }, swap, Request::Stop, Request::Status];
        assert_eq!(carried_out(&requests, |_gone| None), [Request::Stop]);
        assert_eq!(carried_out(&requests, Some), requests);
        let sends_no_more = |client: UnixStream| {
            client.shutdown(std::net::Shutdown::Write).unwrap();
            Some(client)
        };
        assert_eq!(carried_out(&requests, sends_no_more), requests);
    }
}
