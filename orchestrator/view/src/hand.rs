//! A person who drives from the page: a process of `scanloop teleop --stdin` that is handed what buttons that are held ask
//! for.
//!
//! Without a new control the wheels are blocked, as for any person. A process that was handed none for a second is ended,
//! which pauses the drive: its window has lost the focus, the connection, or is gone.

use std::io::{Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use supervision::child::this_program;

use crate::http::{Response, Status};

/// The drive is paused after this time without a control.
const SILENT: Duration = Duration::from_secs(1);
/// Time between two looks at it.
const LOOK: Duration = Duration::from_millis(200);
/// Longest message that is shown [bytes].
const MAX_MESSAGE: u64 = 4096;

/// What buttons that are held ask for: velocity [m/s] and steering angle [rad]; `None` when they are released.
pub(crate) type Held = Option<[f64; 2]>;

/// The person of a page.
#[derive(Debug, Default)]
pub(crate) struct Hand(Arc<Mutex<Option<Person>>>);

#[derive(Debug)]
struct Person {
    child: Child,
    controls: Option<ChildStdin>,
    given: Instant,
}

impl Hand {
    /// Hands on what is held.
    pub(crate) fn hold(&self, system_id: &str, held: Held) -> Response {
        let mut place = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some([velocity, steering]) = held else {
            place.take().into_iter().for_each(Person::end);
            return Response::json(Status::Ok, "{}".to_owned());
        };
        if let Some(person) = &mut *place
            && matches!(person.child.try_wait(), Ok(Some(_)) | Err(_))
        {
            let message = place.take().map(Person::last_words).unwrap_or_default();
            return Response::text(Status::Conflict, &message);
        }
        if place.is_none() {
            match Person::start(system_id) {
                Ok(person) => *place = Some(person),
                Err(error) => return Response::text(Status::Unavailable, &format!("teleop: {error}")),
            }
            self.watch();
        }
        if let Some(person) = &mut *place {
            person.given = Instant::now();
            // It has ended, if it does not take it: the next one tells why.
            let line = format!("{velocity} {steering}\n");
            let _ = person.controls.as_mut().map(|controls| controls.write_all(line.as_bytes()));
        }
        Response::json(Status::Ok, "{}".to_owned())
    }

    /// Ends a person that is silent.
    fn watch(&self) {
        let place = Arc::clone(&self.0);
        let until_silent = move || {
            loop {
                std::thread::sleep(LOOK);
                let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
                match &*place {
                    Some(person) if person.given.elapsed() <= SILENT => {}
                    _ => return place.take().into_iter().for_each(Person::end),
                }
            }
        };
        let _ = std::thread::Builder::new().name("hand".to_owned()).spawn(until_silent);
    }
}

impl Person {
    fn start(system_id: &str) -> std::io::Result<Self> {
        let mut child = Command::new(this_program())
            .args(["--system-id", system_id, "teleop", "--stdin"])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        let controls = child.stdin.take();
        Ok(Self { child, controls, given: Instant::now() })
    }

    /// Its standard input ends: it pauses the drive, and ends.
    fn end(mut self) {
        drop(self.controls.take());
        let _ = self.child.wait();
    }

    fn last_words(mut self) -> String {
        let mut text = String::new();
        let messages = self.child.stderr.take().map(|stream| stream.take(MAX_MESSAGE));
        let _ = messages.map(|mut stream| stream.read_to_string(&mut text));
        self.end();
        text.trim().to_owned()
    }
}
