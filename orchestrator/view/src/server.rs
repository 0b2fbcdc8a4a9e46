//! `scanloop view`: accepts connections, each with a thread of its own, and runs the collector.

use std::collections::HashSet;
use std::net::{IpAddr, Shutdown as Direction, SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use console::exit::Exit;
use console::note;
use console::output::data;
use runtime::{Priority, Shutdown, wait_for};

use crate::access::{Need, Refusal, Token, admit};
use crate::actions::{Actions, Verb};
use crate::arguments::{ViewArguments, listen};
use crate::child::{Parent, inherited};
use crate::http::{Failed, Method, Request, Response, Status, read_request};
use crate::hub::Hub;
use crate::live::Live;
use crate::peer::{Held, Peer, Places, peer_of};
use crate::questions::Questions;
use crate::recorded::RecordedDrive;
use crate::source::{Source, Still};
use crate::{pages, stream};

/// Most connections of one user or of one other machine: a browser opens at most six to one server.
const MAX_CONNECTIONS: usize = 48;
/// Most connections of all but the own user together.
const MAX_OTHERS: usize = 96;
/// Most streams of one user or of one other machine, and of all but the own user: half of the connections, so that
/// there is always one for a request.
const MAX_STREAMS: (usize, usize) = (MAX_CONNECTIONS / 2, MAX_OTHERS / 2);
/// The collector polls the source so often [ns].
const POLL_NS: u64 = 25_000_000;
/// Pause after the machine refused a connection [ns].
const REFUSED_PAUSE_NS: u64 = 50_000_000;
/// No wait is without a timeout [ns].
const ACCEPT_NS: u64 = 1_000_000_000;
/// Stack of the thread of a connection [bytes].
const STACK: usize = 256 << 10;
/// An answer must be taken within this time.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// At the end, the streams have this time to say so.
const FAREWELL: Duration = Duration::from_millis(300);

/// Serves the page until a signal ends it. `verbs` are what `--control` allows.
///
/// # Errors
/// An address that can't be listened on (exit code 2), and threads that can't be started.
pub fn serve(system_id: &str, arguments: &ViewArguments, verbs: &[Verb]) -> anyhow::Result<Exit> {
    let shutdown = Shutdown::on_signals()?;
    let recorded = arguments.file.as_deref().map(RecordedDrive::open).transpose()?;
    let listener = if arguments.for_run { inherited()? } else { listen(arguments.listen, arguments.port)? };
    let verbs = if arguments.control { verbs.to_vec() } else { Vec::new() };
    let mut source: Box<dyn Source> = match &recorded {
        Some(recorded) => Box::new(Still(Some(recorded.system().to_string()))),
        None => Box::new(Live::new(system_id, verbs.clone())?),
    };
    let questions = Questions::new(system_id, arguments.file.as_deref());
    let site = Arc::new(Site::new(Actions::new(system_id, verbs), questions, recorded)?);
    announce(&site.token, &listener, system_id, arguments)?;
    let parent = arguments.for_run.then(Parent::new);
    // The first page finds a state already.
    site.hub.publish(source.poll(0.0), 0.0);
    start_accepting(listener, Arc::clone(&site))?;
    collect(&mut *source, &site.hub, || {
        wait_for(&[shutdown.descriptor()], if arguments.file.is_some() { ACCEPT_NS } else { POLL_NS });
        !shutdown.requested() && parent.as_ref().is_none_or(|parent| parent.is_needed(system_id))
    });
    site.end();
    Ok(Exit::Done)
}

/// Prints the link.
fn announce(
    token: &Token,
    listener: &TcpListener,
    system_id: &str,
    arguments: &ViewArguments,
) -> anyhow::Result<()> {
    let address = listener.local_addr()?;
    let shown = match address.ip() {
        ip if !ip.is_unspecified() => ip,
        IpAddr::V4(_) => IpAddr::from([127, 0, 0, 1]),
        IpAddr::V6(_) => IpAddr::from([0, 0, 0, 0, 0, 0, 0, 1]),
    };
    let link = format!("http://{}/#token={}", SocketAddr::new(shown, address.port()), token.text());
    if !address.ip().is_loopback() {
        let warning = format!(
            "warning: {address} is reachable from other computers, without encryption; everybody with the link sees the drive"
        );
        runtime::print(Priority::Warning, &warning);
    }
    if arguments.for_run {
        note!("page: {link}");
        return Ok(());
    }
    let shown = match &arguments.file {
        Some(file) => file.display().to_string(),
        None => format!("system {system_id}{}", if arguments.control { " with control" } else { "" }),
    };
    note!("showing {shown}; Ctrl-C ends the page");
    data(&link).map(|_| ())
}

/// Polls the source and publishes what is new, as long as `continues` holds.
fn collect(source: &mut dyn Source, hub: &Hub, continues: impl Fn() -> bool) {
    let started = Instant::now();
    while continues() {
        let now_s = started.elapsed().as_secs_f64();
        hub.publish(source.poll(now_s), now_s);
    }
}

/// What all connections share.
struct Site {
    hub: Hub,
    token: Token,
    actions: Actions,
    questions: Questions,
    /// The recording that is shown instead of a running system.
    recorded: Option<Mutex<RecordedDrive>>,
    streams: Arc<Places>,
    /// Streams that are sent.
    sent: AtomicUsize,
    /// What was logged: each kind of refusal is logged once.
    logged: Mutex<HashSet<&'static str>>,
}

impl Site {
    fn new(actions: Actions, questions: Questions, recorded: Option<RecordedDrive>) -> anyhow::Result<Self> {
        let token = Token::random()?;
        Ok(Self {
            hub: Hub::default(),
            token,
            actions,
            questions,
            recorded: recorded.map(Mutex::new),
            streams: Places::new(MAX_STREAMS.0, MAX_STREAMS.1),
            sent: AtomicUsize::new(0),
            logged: Mutex::default(),
        })
    }

    fn end(&self) {
        self.hub.end();
        let until = Instant::now() + FAREWELL;
        while self.sent.load(Ordering::SeqCst) > 0 && Instant::now() < until {
            wait_for(&[], 10_000_000);
        }
    }

    fn log_once(&self, what: &'static str) {
        if self.logged.lock().unwrap_or_else(PoisonError::into_inner).insert(what) {
            note!("refused a request: {what}; further ones of this kind are not shown");
        }
    }

    /// Answers the request of one connection.
    fn serve(&self, stream: &mut TcpStream, peer: SocketAddr, local: SocketAddr, holder: Peer, place: &Held) {
        let _ = stream.set_write_timeout(Some(WRITE_TIMEOUT));
        let read = read_request(stream);
        place.asked();
        let response = match read {
            Ok((request, body)) => match self.route(&request, &body, peer, local) {
                Some(response) => response,
                None => return self.stream(stream, holder),
            },
            Err(Failed::Gone) => return,
            Err(Failed::Refused(status)) => {
                self.log_once("it is not well formed");
                Response::text(status, "the request is not well formed, too long or too slow")
            }
        };
        let _ = response.write(stream);
        let _ = stream.shutdown(Direction::Write);
    }

    /// The answer to a request; `None` for a stream.
    fn route(&self, request: &Request, body: &[u8], peer: SocketAddr, local: SocketAddr) -> Option<Response> {
        let (need, method) = match request.path.as_str() {
            "/stream" | "/history" | "/frame" | "/system" | "/why" => (Need::Data, Method::Get),
            "/control" => (Need::Control, Method::Post),
            _ => (Need::Page, Method::Get),
        };
        if let Err(refusal) = admit(&self.token, need, request, peer, local) {
            return Some(self.refuse(refusal));
        }
        if request.method != method {
            return Some(Response::text(Status::MethodNotAllowed, "this path is not asked in this way"));
        }
        let found = match request.path.as_str() {
            "/stream" => return None,
            "/control" => Some(self.actions.answer(body)),
            "/system" => Some(Response::json(Status::Ok, self.hub.system().as_bytes())),
            "/history" | "/frame" => self.past(request),
            "/why" => Some(self.questions.answer(request.number("scan"))),
            path => pages::file(path),
        };
        Some(found.unwrap_or_else(|| Response::text(Status::NotFound, "there is no such page")))
    }

    /// Rows or a frame of earlier; of a recording by time, of a running system by number.
    fn past(&self, request: &Request) -> Option<Response> {
        let ok = |text: &[u8]| Response::json(Status::Ok, text);
        let is_frame = request.path == "/frame";
        let Some(recorded) = &self.recorded else {
            if is_frame {
                let frame = request.number("number").and_then(|number| self.hub.frame(number));
                return frame.map(|frame| ok(frame.as_bytes()));
            }
            let after = |key| request.number(key).unwrap_or(0);
            return Some(ok(self.hub.history(after("row"), after("event")).as_bytes()));
        };
        let at_s = request.number("at_ms").map(|at_ms| at_ms as f64 * 1e-3);
        let mut recorded = recorded.lock().unwrap_or_else(PoisonError::into_inner);
        if !is_frame {
            return Some(ok(recorded.history(at_s).as_bytes()));
        }
        Some(match recorded.frame(at_s?) {
            Ok(frame) => ok(frame.to_string().as_bytes()),
            Err(error) => Response::text(Status::Unavailable, &format!("{error:#}")),
        })
    }

    fn refuse(&self, refusal: Refusal) -> Response {
        self.log_once(match refusal {
            Refusal::Host => "its host is not this address",
            Refusal::Origin => "it comes from another site",
            Refusal::Token => "its token is missing or wrong",
        });
        Response::text(Status::Forbidden, refusal.text())
    }

    fn stream(&self, stream: &mut TcpStream, holder: Peer) {
        let Some(_place) = self.streams.take(holder) else {
            self.log_once("one user or machine has too many pages open");
            let _ = Response::text(Status::Unavailable, "too many pages are open").write(stream);
            return;
        };
        self.sent.fetch_add(1, Ordering::SeqCst);
        stream::send(stream, &self.hub);
        self.sent.fetch_sub(1, Ordering::SeqCst);
    }
}

fn start_accepting(listener: TcpListener, site: Arc<Site>) -> anyhow::Result<()> {
    listener.set_nonblocking(true)?;
    std::thread::Builder::new().name("accept".to_owned()).spawn(move || {
        let places = Places::new(MAX_CONNECTIONS, MAX_OTHERS);
        loop {
            wait_for(&[listener.as_fd()], ACCEPT_NS);
            // All that wait are taken at once: those without a place are closed, and keep none in the queue.
            let refused = loop {
                match listener.accept() {
                    Ok((stream, peer)) => accept(&site, &places, stream, peer),
                    Err(error) => break error,
                }
            };
            if refused.kind() != std::io::ErrorKind::WouldBlock {
                wait_for(&[], REFUSED_PAUSE_NS);
            }
        }
    })?;
    Ok(())
}

/// Serves a connection in a thread of its own, if its peer has a place left.
fn accept(site: &Arc<Site>, places: &Arc<Places>, stream: TcpStream, peer: SocketAddr) {
    let Ok(local) = stream.local_addr() else { return };
    let holder = peer_of(peer, local);
    let Some(place) = places.take_for(holder, &stream) else {
        return site.log_once("one user or machine holds too many connections");
    };
    let site = Arc::clone(site);
    let serve = move || {
        let mut stream = stream;
        if stream.set_nonblocking(false).is_ok() {
            site.serve(&mut stream, peer, local, holder, &place);
        }
    };
    // Without a thread the connection is closed.
    let _ = std::thread::Builder::new().name("page".to_owned()).stack_size(STACK).spawn(serve);
}

#[cfg(test)]
mod tests;
