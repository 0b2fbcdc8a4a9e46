//! A goal that a program sets, for C.
#![expect(unsafe_code, reason = "functions that C can call take pointers")]
#![expect(clippy::missing_safety_doc, reason = "the header states the rules for all functions")]

use std::ffi::{c_char, c_int};

use runtime::GoalOrder;

use crate::{YES, answer, text_or_none};

/// See `scanloop.h`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn scanloop_set_goal(
    system_id: *const c_char,
    x_m: f64,
    y_m: f64,
    yaw_rad: *const f64,
    from_scan: *mut u64,
) -> c_int {
    answer(|| {
        // SAFETY: C passes the places of numbers of its own, or null.
        let (yaw_rad, from_scan) = unsafe { (yaw_rad.as_ref(), from_scan.as_mut()) };
        let order = GoalOrder::give(text_or_none("system_id", system_id)?, [x_m, y_m], yaw_rad.copied())?;
        let first = order.wait()?;
        from_scan.into_iter().for_each(|scan| *scan = first);
        Ok(YES)
    })
}
