//! A person who drives from the page: a process of `scanloop teleop --stdin` that is handed what buttons that are held ask
//! for.
//!
//! Without a new control the wheels are blocked, as for any person. A process that was handed none for a second is ended,
//! which pauses the drive: its window has lost the focus, the connection, or is gone.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use runtime::{Person, RuntimeError};
use supervision::child::this_program;

use crate::http::{Response, Status};

/// The drive is paused after this time without a control.
const SILENT: Duration = Duration::from_secs(1);
/// Time between two looks at it.
const LOOK: Duration = Duration::from_millis(200);

/// What buttons that are held ask for: velocity [m/s] and steering angle [rad]; `None` when they are released.
pub(crate) type Held = Option<[f64; 2]>;

/// The person of a page, and when it was handed a control last.
#[derive(Debug, Default)]
pub(crate) struct Hand(Arc<Mutex<Option<(Person, Instant)>>>);

impl Hand {
    /// Hands on what is held.
    pub(crate) fn hold(&self, system_id: &str, held: Held) -> Response {
        let mut place = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some([velocity, steering]) = held else {
            *place = None;
            return Response::json(Status::Ok, "{}".to_owned());
        };
        match self.give(&mut place, system_id, [velocity, steering]) {
            Ok(()) => Response::json(Status::Ok, "{}".to_owned()),
            Err(RuntimeError::Refused(reason)) => Response::text(Status::Conflict, &reason),
            Err(error) => Response::text(Status::Unavailable, &error.to_string()),
        }
    }

    /// Hands on a control; the first one takes over.
    fn give(
        &self,
        place: &mut Option<(Person, Instant)>,
        system_id: &str,
        [velocity, steering]: [f64; 2],
    ) -> Result<(), RuntimeError> {
        if place.is_none() {
            let person = Person::take_over_by(this_program(), Some(system_id))?;
            *place = Some((person, Instant::now()));
            self.watch();
        }
        let Some((person, given)) = place else { return Ok(()) };
        *given = Instant::now();
        let taken = person.give(velocity, steering);
        if taken.is_err() {
            *place = None;
        }
        taken
    }

    /// Ends a person that is silent.
    fn watch(&self) {
        let place = Arc::clone(&self.0);
        let until_silent = move || {
            loop {
                std::thread::sleep(LOOK);
                let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
                match &*place {
                    Some((_, given)) if given.elapsed() <= SILENT => {}
                    _ => return *place = None,
                }
            }
        };
        let _ = std::thread::Builder::new().name("hand".to_owned()).spawn(until_silent);
    }
}
