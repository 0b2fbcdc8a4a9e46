//! Topics of your own and processes beside the loop, for C.
#![expect(unsafe_code, reason = "functions that C can call take pointers")]
#![expect(clippy::missing_safety_doc, reason = "the header states the rules for all functions")]

use std::ffi::{c_char, c_int, c_void};

use runtime::{ByteTopic, Companion, LoopTopic, TakenBytes};
use shared_types::{
    Actuation, Checkpoint, ClockOffset, Command, Directive, Heartbeat, Journal, LayoutRow, Obstacles,
    Odometry, Pose, Sample, Scan, Topic, Truth,
};

use crate::error::Refusal;
use crate::{CLayoutRow, CProcess, NO, YES, answer, layout_row, put, text, with};

/// A topic as C sees it, and the sample that C has a pointer to.
pub struct CTopic(Port);

enum Port {
    Own { topic: ByteTopic, lent: Option<TakenBytes>, place: Vec<u64> },
    Loop(Box<dyn Source>),
}

/// A companion as C sees it.
pub struct CCompanion(Companion);

/// Which sample is wanted.
#[derive(Clone, Copy)]
enum Wanted {
    Oldest,
    Newest(u64),
    OfScan(u64),
}

/// Reads one topic of the loop.
trait Source {
    fn lend(&mut self, wanted: Wanted) -> Result<Option<*const c_void>, Refusal>;
}

struct Copied<S: Sample>(LoopTopic<S>, Option<S>);

impl<S: Sample> Source for Copied<S> {
    fn lend(&mut self, wanted: Wanted) -> Result<Option<*const c_void>, Refusal> {
        let found = match wanted {
            Wanted::Oldest => self.0.take()?,
            Wanted::Newest(scan) => self.0.newest(scan)?,
            Wanted::OfScan(scan) => self.0.by_scan(scan)?,
        };
        Ok(found.map(|sample| std::ptr::from_ref::<S>(self.1.insert(sample)).cast()))
    }
}

impl CTopic {
    fn own(topic: ByteTopic) -> Self {
        let place = vec![0; topic.size().div_ceil(size_of::<u64>())];
        Self(Port::Own { topic, lent: None, place })
    }

    fn lend(&mut self, wanted: Wanted) -> Result<Option<*const c_void>, Refusal> {
        match &mut self.0 {
            Port::Loop(source) => source.lend(wanted),
            Port::Own { topic, lent, .. } => {
                let found = match wanted {
                    Wanted::Oldest => topic.take()?,
                    Wanted::Newest(scan) => topic.newest(scan)?,
                    Wanted::OfScan(scan) => topic.by_scan(scan)?,
                };
                Ok(found.map(|sample| lent.insert(sample).as_ptr().cast()))
            }
        }
    }
}

fn source(companion: &mut Companion, topic: Topic) -> Result<Box<dyn Source>, Refusal> {
    fn of<S: Sample>(companion: &mut Companion) -> Result<Box<dyn Source>, Refusal> {
        Ok(Box::new(Copied::<S>(companion.input()?, None)))
    }
    match topic {
        Topic::Scan => of::<Scan>(companion),
        Topic::Odometry => of::<Odometry>(companion),
        Topic::Pose => of::<Pose>(companion),
        Topic::Obstacles => of::<Obstacles>(companion),
        Topic::Command => of::<Command>(companion),
        Topic::Actuation => of::<Actuation>(companion),
        Topic::Heartbeat => of::<Heartbeat>(companion),
        Topic::Directive => of::<Directive>(companion),
        Topic::Checkpoint => of::<Checkpoint>(companion),
        Topic::Truth => of::<Truth>(companion),
        Topic::Journal => of::<Journal>(companion),
        Topic::Clock => of::<ClockOffset>(companion),
    }
}

fn rows(layout: *const CLayoutRow, count: usize) -> Result<Vec<LayoutRow>, Refusal> {
    if layout.is_null() {
        return Err(Refusal::Null("layout"));
    }
    // SAFETY: C passes a table that `scanloop types --c --layout` has printed, and its length.
    unsafe { std::slice::from_raw_parts(layout, count) }.iter().map(layout_row).collect()
}

/// Hands an object over to C.
pub(crate) fn hand_over<T>(
    place: *mut *mut T,
    name: &'static str,
    make: impl FnOnce() -> Result<T, Refusal>,
) -> c_int {
    answer(|| {
        // SAFETY: C passes the place of a pointer of its own, or null.
        let place = unsafe { place.as_mut() }.ok_or(Refusal::Null(name))?;
        *place = std::ptr::null_mut();
        *place = Box::into_raw(Box::new(make()?));
        Ok(YES)
    })
}

fn of_topic(topic: *mut CTopic, act: impl FnOnce(&mut CTopic) -> Result<c_int, Refusal>) -> c_int {
    // SAFETY: C passes what this library gave it, or null, from one thread.
    let topic = unsafe { topic.as_mut() };
    answer(|| act(topic.ok_or(Refusal::Null("topic"))?))
}

fn of_companion(
    companion: *mut CCompanion,
    act: impl FnOnce(&mut Companion) -> Result<c_int, Refusal>,
) -> c_int {
    // SAFETY: as in `of_topic`.
    let companion = unsafe { companion.as_mut() };
    answer(|| act(&mut companion.ok_or(Refusal::Null("companion"))?.0))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_open_topic(
    process: *mut CProcess,
    name: *const c_char,
    layout: *const CLayoutRow,
    count: usize,
    topic: *mut *mut CTopic,
) -> c_int {
    with(process, |process| {
        let opened =
            || Ok(CTopic::own(process.process.open_rows(text("name", name)?, &rows(layout, count)?)?));
        Ok(hand_over(topic, "topic", opened))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_open(companion: *mut *mut CCompanion) -> c_int {
    hand_over(companion, "companion", || {
        runtime::start_logging();
        Ok(CCompanion(Companion::attach()?))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_input(
    companion: *mut CCompanion,
    name: *const c_char,
    topic: *mut *mut CTopic,
) -> c_int {
    of_companion(companion, |companion| {
        let opened = || Ok(CTopic(Port::Loop(source(companion, text("name", name)?.parse()?)?)));
        Ok(hand_over(topic, "topic", opened))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_topic(
    companion: *mut CCompanion,
    name: *const c_char,
    layout: *const CLayoutRow,
    count: usize,
    topic: *mut *mut CTopic,
) -> c_int {
    of_companion(companion, |companion| {
        let opened = || Ok(CTopic::own(companion.open_rows(text("name", name)?, &rows(layout, count)?)?));
        Ok(hand_over(topic, "topic", opened))
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_start(companion: *mut CCompanion) -> c_int {
    of_companion(companion, |companion| Ok(c_int::from(companion.start()?)))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_wait(companion: *mut CCompanion, deadline_ns: u64) -> c_int {
    let deadline = (deadline_ns > 0).then_some(deadline_ns);
    of_companion(companion, |companion| Ok(c_int::from(companion.wait(deadline)?)))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_topic_take(topic: *mut CTopic, sample: *mut *const c_void) -> c_int {
    of_topic(topic, |topic| put(sample, "sample", topic.lend(Wanted::Oldest)?))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_topic_newest(
    topic: *mut CTopic,
    scan_id: u64,
    sample: *mut *const c_void,
) -> c_int {
    of_topic(topic, |topic| put(sample, "sample", topic.lend(Wanted::Newest(scan_id))?))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_topic_by_scan(
    topic: *mut CTopic,
    scan_id: u64,
    sample: *mut *const c_void,
) -> c_int {
    of_topic(topic, |topic| put(sample, "sample", topic.lend(Wanted::OfScan(scan_id))?))
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_topic_publish(
    topic: *mut CTopic,
    sample: *mut c_void,
    size: usize,
) -> c_int {
    of_topic(topic, |topic| {
        let Port::Own { topic, place, .. } = &mut topic.0 else { return Err(Refusal::OfTheLoop) };
        if sample.is_null() {
            return Err(Refusal::Null("sample"));
        }
        if size != topic.size() {
            return Err(Refusal::OwnSize {
                topic: topic.name().to_owned(),
                expected: topic.size(),
                found: size,
            });
        }
        // SAFETY: C passes a struct of its own and its size, which is that of the topic.
        let bytes = unsafe { std::slice::from_raw_parts_mut(sample.cast::<u8>(), size) };
        let copy: &mut [u8] = bytemuck::cast_slice_mut(place);
        copy[..size].copy_from_slice(bytes);
        topic.publish(&mut copy[..size])?;
        bytes.copy_from_slice(&copy[..size]);
        Ok(YES)
    })
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_topic_close(topic: *mut CTopic) {
    close(topic);
}

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_companion_close(companion: *mut CCompanion) {
    close(companion);
}

fn close<T>(object: *mut T) {
    let _ = answer(|| {
        if !object.is_null() {
            // SAFETY: C passes what `hand_over` made by `Box::into_raw`, and does not use it again.
            drop(unsafe { Box::from_raw(object) });
        }
        Ok(NO)
    });
}
