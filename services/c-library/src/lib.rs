//! The C library: a process of the loop in C, documented in `include/scanloop.h`.
//!
//! Each function checks its arguments, calls [`runtime::Process`], and turns an error into a number and a message. So
//! a process in C has the same start barrier, heartbeats, authority filter and stop as all others.
//!
//! C callers must use one thread, pass pointers that are null or valid, and end texts with a zero. A pointer to a
//! sample is valid until the next read of its topic, because the port holds the sample for that long.
#![expect(unsafe_code, reason = "functions that C can call take pointers")]
#![expect(clippy::missing_safety_doc, reason = "the header states the rules for all functions")]

mod error;
pub mod goal;
pub mod own;
pub mod person;
mod process;

use std::ffi::{CStr, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};

use runtime::Wheels;
use shared_types::{DeviceState, Directive, Header, Heartbeat, LayoutRow, Layouts, Role, Topic};

use error::Refusal;
pub use process::CProcess;

const NO: c_int = 0;
const YES: c_int = 1;

/// One row of the table in `scanloop_types.h`.
#[repr(C)]
pub struct CLayoutRow {
    topic: *const c_char,
    field: *const c_char,
    kind: *const c_char,
    count: u32,
    size: u32,
    offset: u32,
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_open(
    role: u32,
    layouts: *const CLayoutRow,
    count: usize,
    process: *mut *mut CProcess,
) -> c_int {
    answer(|| {
        runtime::start_logging();
        let role = Role::try_from(role).map_err(|_| Refusal::RoleNumber(role))?;
        if layouts.is_null() {
            return Err(Refusal::Null("layouts"));
        }
        // SAFETY: C passes the table of the header and its length.
        let rows = unsafe { std::slice::from_raw_parts(layouts, count) };
        let rows = rows.iter().map(layout_row).collect::<Result<_, _>>()?;
        // SAFETY: C passes the place of a pointer of its own.
        let place = unsafe { process.as_mut() }.ok_or(Refusal::Null("process"))?;
        *place = std::ptr::null_mut();
        let opened =
            CProcess::open(role, &Layouts { rows }).inspect_err(|refusal| tracing::error!("{refusal}"))?;
        *place = Box::into_raw(Box::new(opened));
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_start(process: *mut CProcess) -> c_int {
    with(process, |process| Ok(c_int::from(process.process.start()?)))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_wait(process: *mut CProcess, deadline_ns: u64) -> c_int {
    let deadline = (deadline_ns > 0).then_some(deadline_ns);
    with(process, |process| Ok(c_int::from(process.process.wait(deadline)?)))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_read(
    process: *mut CProcess,
    topic: *const c_char,
    sample: *mut *const c_void,
) -> c_int {
    with(process, |process| {
        let found = process.read(topic_of(topic)?)?;
        put(sample, "sample", found)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_join(
    process: *mut CProcess,
    first: *mut *const c_void,
    second: *mut *const c_void,
) -> c_int {
    with(process, |process| {
        if first.is_null() || second.is_null() {
            return Err(Refusal::Null("a place for a sample"));
        }
        let found = process.join()?;
        put(first, "first", found.map(|pair| pair[0]))?;
        put(second, "second", found.map(|pair| pair[1]))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_answer(to: *const Header, also: *const Header, answer: *mut Header) {
    // SAFETY: C passes its own headers, or null.
    let (to, also, answer) = unsafe { (to.as_ref(), also.as_ref(), answer.as_mut()) };
    if let (Some(to), Some(answer)) = (to, answer) {
        *answer = also.map_or_else(|| to.answer(), |also| to.answer_both(also));
    }
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_publish(
    process: *mut CProcess,
    topic: *const c_char,
    sample: *mut c_void,
    size: usize,
) -> c_int {
    with(process, |process| {
        if sample.is_null() {
            return Err(Refusal::Null("sample"));
        }
        // SAFETY: C passes a struct of its own and its size.
        unsafe { process.publish(topic_of(topic)?, sample, size)? };
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_begin(process: *mut CProcess) -> c_int {
    with(process, |process| {
        process.process.begin();
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_save(
    process: *mut CProcess,
    header: *const Header,
    kind: u32,
    state: *const c_void,
    size: usize,
) -> c_int {
    with(process, |process| {
        // SAFETY: C passes the header of a sample.
        let header = unsafe { header.as_ref() }.ok_or(Refusal::Null("header"))?;
        if state.is_null() {
            return Err(Refusal::Null("state"));
        }
        // SAFETY: C passes a state of its own and its size.
        let state = unsafe { std::slice::from_raw_parts(state.cast::<u8>(), size) };
        process.save(header, kind, state)?;
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_resume(
    process: *mut CProcess,
    kind: u32,
    state: *mut c_void,
    size: usize,
) -> c_int {
    with(process, |process| {
        if state.is_null() {
            return Err(Refusal::Null("state"));
        }
        // SAFETY: C passes a state of its own and its size.
        let state = unsafe { std::slice::from_raw_parts_mut(state.cast::<u8>(), size) };
        Ok(process.resume(kind, state)? as c_int)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_setting(
    process: *mut CProcess,
    key: *const c_char,
    value: *mut f64,
) -> c_int {
    with(process, |process| {
        let found = process.setting(text("key", key)?);
        // SAFETY: C passes the place of a number of its own.
        let place = unsafe { value.as_mut() }.ok_or(Refusal::Null("value"))?;
        Ok(found.map_or(NO, |number| {
            *place = number;
            YES
        }))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_now_ns(process: *mut CProcess) -> u64 {
    // SAFETY: C passes what `scanloop_open` gave it, or null.
    unsafe { process.as_ref() }.map_or(0, |process| process.process.clock().now_ns())
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_period_ns(process: *mut CProcess) -> u64 {
    // SAFETY: C passes what `scanloop_open` gave it, or null.
    unsafe { process.as_ref() }.map_or(0, |process| process.process.period_ns())
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_report_wheels(process: *mut CProcess, wheels: u32) -> c_int {
    with(process, |process| {
        process.process.report_wheels(Wheels::from(u64::from(wheels)));
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_report_device(
    process: *mut CProcess,
    state: u32,
    reason: *const c_char,
) -> c_int {
    with(process, |process| {
        let reason = if reason.is_null() { "" } else { text("reason", reason)? };
        process.process.report_device(DeviceState::try_from(state).map_err(Refusal::Device)?, reason);
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_status(
    process: *mut CProcess,
    counters: *mut Heartbeat,
    orders: *mut Directive,
) -> c_int {
    with(process, |process| {
        // SAFETY: C passes structs of its own, or null.
        let (counters, orders) = unsafe { (counters.as_mut(), orders.as_mut()) };
        if let Some(counters) = counters {
            *counters = process.process.heartbeat();
        }
        if let Some(orders) = orders {
            *orders = process.process.directive();
        }
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_log(level: c_int, message: *const c_char) {
    let Ok(message) = text("text", message) else { return };
    match level {
        0 => tracing::debug!("{message}"),
        1 => tracing::info!("{message}"),
        2 => tracing::warn!("{message}"),
        _ => tracing::error!("{message}"),
    }
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub extern "C" fn scanloop_last_error() -> *const c_char {
    error::last()
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_close(process: *mut CProcess) {
    if !process.is_null() {
        // SAFETY: C passes what `scanloop_open` made by `Box::into_raw`, and does not use it again.
        let process = unsafe { Box::from_raw(process) };
        let _ = catch_unwind(AssertUnwindSafe(|| drop(process)));
    }
}

/// The result of `act` as C reads it; a panic does not unwind into C.
fn answer(act: impl FnOnce() -> Result<c_int, Refusal>) -> c_int {
    let result = catch_unwind(AssertUnwindSafe(act)).unwrap_or(Err(Refusal::Panic));
    result.unwrap_or_else(|refusal| {
        error::remember(&refusal);
        refusal.code()
    })
}

fn with(process: *mut CProcess, act: impl FnOnce(&mut CProcess) -> Result<c_int, Refusal>) -> c_int {
    // SAFETY: C passes what `scanloop_open` gave it, or null, from one thread.
    let process = unsafe { process.as_mut() };
    answer(|| act(process.ok_or(Refusal::Null("process"))?))
}

/// Stores a pointer at a place that C gives; null and `NO` when there is none.
fn put(
    place: *mut *const c_void,
    name: &'static str,
    found: Option<*const c_void>,
) -> Result<c_int, Refusal> {
    // SAFETY: C passes the place of a pointer of its own, or null.
    let place = unsafe { place.as_mut() }.ok_or(Refusal::Null(name))?;
    *place = found.unwrap_or(std::ptr::null());
    Ok(if found.is_some() { YES } else { NO })
}

fn text<'a>(name: &'static str, start: *const c_char) -> Result<&'a str, Refusal> {
    if start.is_null() {
        return Err(Refusal::Null(name));
    }
    // SAFETY: C passes a text that ends with a zero and stays during the call.
    unsafe { CStr::from_ptr(start) }.to_str().map_err(|_| Refusal::NotText(name))
}

/// A text that may be left out.
fn text_or_none<'a>(name: &'static str, start: *const c_char) -> Result<Option<&'a str>, Refusal> {
    if start.is_null() { Ok(None) } else { text(name, start).map(Some) }
}

fn topic_of(name: *const c_char) -> Result<Topic, Refusal> {
    Ok(text("topic", name)?.parse()?)
}

fn layout_row(row: &CLayoutRow) -> Result<LayoutRow, Refusal> {
    Ok(LayoutRow {
        topic: text("topic of a layout", row.topic)?.to_owned(),
        field: text("field of a layout", row.field)?.to_owned(),
        kind: text("kind of a layout", row.kind)?.to_owned(),
        count: row.count as usize,
        size: row.size as usize,
        offset: row.offset as usize,
    })
}
