//! A person who drives by hand, for C.
#![expect(unsafe_code, reason = "functions that C can call take pointers")]
#![expect(clippy::missing_safety_doc, reason = "the header states the rules for all functions")]

use std::ffi::{c_char, c_int};

use runtime::Person;

use crate::error::Refusal;
use crate::own::hand_over;
use crate::{YES, answer, text_or_none};

/// A person as C sees it; `None` once it has handed back.
pub struct CPerson(Option<Person>);

fn of_person(person: *mut CPerson, act: impl FnOnce(&mut CPerson) -> Result<(), Refusal>) -> c_int {
    // SAFETY: C passes what this library gave it, or null, from one thread.
    let person = unsafe { person.as_mut() };
    answer(|| act(person.ok_or(Refusal::Null("person"))?).map(|()| YES))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_person_take_over(
    system_id: *const c_char,
    person: *mut *mut CPerson,
) -> c_int {
    hand_over(person, "person", || {
        Ok(CPerson(Some(Person::take_over(text_or_none("system_id", system_id)?)?)))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_person_give(
    person: *mut CPerson,
    velocity_mps: f64,
    steering_rad: f64,
) -> c_int {
    of_person(person, |person| {
        Ok(person.0.as_mut().ok_or(Refusal::HandedBack)?.give(velocity_mps, steering_rad)?)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_person_pause(person: *mut CPerson) -> c_int {
    of_person(person, |person| Ok(person.0.as_mut().ok_or(Refusal::HandedBack)?.pause()?))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_person_resume(person: *mut CPerson) -> c_int {
    of_person(person, |person| Ok(person.0.take().ok_or(Refusal::HandedBack)?.resume()?))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_person_close(person: *mut CPerson) {
    if !person.is_null() {
        // SAFETY: C passes what `hand_over` made by `Box::into_raw`, and does not use it again.
        drop(unsafe { Box::from_raw(person) });
    }
}
