//! The range of an axis of an input device of Linux (evdev).
#![expect(unsafe_code, reason = "rustix has no call for input devices")]

use std::os::fd::AsFd;

use rustix::ioctl::{Getter, ioctl, opcode};

/// `struct input_absinfo` of the kernel.
#[repr(C)]
struct AbsInfo {
    value: i32,
    minimum: i32,
    maximum: i32,
    fuzz: i32,
    flat: i32,
    resolution: i32,
}

/// `EVIOCGABS(0)` and `EVIOCGABS(1)`.
const ABS_X: u32 = opcode::read::<AbsInfo>(b'E', 0x40);
const ABS_Y: u32 = opcode::read::<AbsInfo>(b'E', 0x41);

/// Smallest and largest value of both axes of the first stick, x and y; `None` for what is no input device with them.
pub fn stick_range(device: impl AsFd) -> Option<[[i32; 2]; 2]> {
    // SAFETY: both requests fill an `input_absinfo`, whose layout is part of the kernel's interface.
    let (x, y) = unsafe {
        (
            ioctl(&device, Getter::<ABS_X, AbsInfo>::new()).ok()?,
            ioctl(&device, Getter::<ABS_Y, AbsInfo>::new()).ok()?,
        )
    };
    Some([[x.minimum, x.maximum], [y.minimum, y.maximum]])
}
