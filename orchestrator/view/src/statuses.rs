//! Finds the system and asks for its status twice a second, in a thread of its own: an orchestrator that hangs delays
//! the answer for seconds, and no frame.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use runtime::{Domain, monotonic_ns};
use session::control::SystemStatus;
use session::orphaned::current_status;

/// Pause between two questions.
const PAUSE: Duration = Duration::from_millis(500);
/// Pause between two looks for a system that has its directory in a usual place.
const SEARCH_PAUSE: Duration = Duration::from_millis(250);
/// A search through all processes of the user is made once in so many of those looks.
const RARELY: u32 = 8;

/// What is known from outside of the bus.
#[derive(Debug, Clone, Default)]
pub(crate) struct Known {
    /// The system, while it runs.
    pub(crate) domain: Option<Domain>,
    /// Its last answer.
    pub(crate) status: Option<SystemStatus>,
    /// When that came [ns].
    pub(crate) answered_ns: u64,
    /// Why there was no answer the last time.
    pub(crate) trouble: Option<String>,
    /// How many answers there were.
    pub(crate) answers: u64,
}

/// The thread; it lives as long as the program.
#[derive(Debug)]
pub(crate) struct Statuses(Arc<Mutex<Known>>);

impl Statuses {
    /// Starts to look for a system of that id.
    ///
    /// # Errors
    /// A thread that can't be started.
    pub(crate) fn start(system_id: &str) -> anyhow::Result<Self> {
        let known = Arc::new(Mutex::new(Known::default()));
        let (shared, system_id) = (Arc::clone(&known), system_id.to_owned());
        std::thread::Builder::new().name("status".to_owned()).spawn(move || follow(&system_id, &shared))?;
        Ok(Self(known))
    }

    /// What is known now.
    pub(crate) fn known(&self) -> Known {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn follow(system_id: &str, shared: &Mutex<Known>) {
    let change =
        |apply: &dyn Fn(&mut Known)| apply(&mut shared.lock().unwrap_or_else(PoisonError::into_inner));
    let mut round: u32 = 0;
    loop {
        let found = search(system_id, round);
        round = round.wrapping_add(1);
        let Some(domain) = found else {
            change(&|known| *known = Known { answers: known.answers, ..Known::default() });
            std::thread::sleep(SEARCH_PAUSE);
            continue;
        };
        round = 1;
        change(&|known| {
            if known.domain.as_ref() != Some(&domain) {
                *known = Known { domain: Some(domain.clone()), answers: known.answers, ..Known::default() };
            }
        });
        let answer = current_status(&domain);
        change(&|known| match &answer {
            Ok(status) => {
                (known.status, known.trouble) = (Some(status.clone()), None);
                (known.answered_ns, known.answers) = (monotonic_ns(), known.answers + 1);
            }
            Err(error) => known.trouble = Some(format!("{error:#}")),
        });
        std::thread::sleep(PAUSE);
    }
}

fn search(system_id: &str, round: u32) -> Option<Domain> {
    let usual = Domain::find(system_id).ok().flatten();
    let other = || supervision::runs::find(system_id).ok().flatten();
    usual.or_else(|| if round.is_multiple_of(RARELY) { other() } else { None })
}
