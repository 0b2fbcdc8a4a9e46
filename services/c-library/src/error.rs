//! Errors of the library, as a number and as a message.

use std::cell::RefCell;
use std::ffi::{CString, c_char, c_int};

use runtime::RuntimeError;
use shared_types::{CheckpointError, Fault, Topic, UnknownName};

/// Why a call was refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("{0} is a null pointer")]
    Null(&'static str),
    #[error("{0} is not UTF-8")]
    NotText(&'static str),
    #[error(transparent)]
    Name(#[from] UnknownName),
    #[error("state of the device: {0}")]
    Device(Fault),
    #[error("role {0} is unknown: 0 to 4")]
    RoleNumber(u32),
    #[error("this role does not {verb} topic {topic}")]
    NotYours { verb: &'static str, topic: Topic },
    #[error("this role has no pair of inputs to join")]
    NoPair,
    #[error("a sample of topic {topic} has {expected} bytes, not {found}")]
    Size { topic: Topic, expected: usize, found: usize },
    #[error("a sample of topic {topic} has {expected} bytes, not {found}")]
    OwnSize { topic: String, expected: usize, found: usize },
    #[error("a companion does not write topics of the loop")]
    OfTheLoop,
    #[error("topic {0}: {1}")]
    Sample(Topic, Fault),
    #[error("{0}")]
    State(CheckpointError),
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    #[error("this person has handed back")]
    HandedBack,
    #[error("the library has panicked; see the log")]
    Panic,
}

impl Refusal {
    /// The number of `enum scanloop_result`.
    pub(crate) fn code(&self) -> c_int {
        match self {
            Self::Runtime(RuntimeError::Layout(_)) => -3,
            Self::Runtime(RuntimeError::NotInASystem(_) | RuntimeError::Environment { .. }) => -2,
            Self::Runtime(RuntimeError::Refused(_)) => -6,
            Self::Runtime(_) | Self::Panic => -5,
            Self::Sample(..) => -4,
            _ => -1,
        }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Keeps the message for [`last`].
pub(crate) fn remember(refusal: &Refusal) {
    let text = refusal.to_string().replace('\0', " ");
    LAST.with(|last| *last.borrow_mut() = CString::new(text).unwrap_or_default());
}

/// The message of the last refusal in this thread.
pub(crate) fn last() -> *const c_char {
    LAST.with(|last| last.borrow().as_ptr())
}
