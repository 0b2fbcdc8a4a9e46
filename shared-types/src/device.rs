//! The state of the devices behind a process, such as base and scanner of a robot.

use crate::describe::layout;
use crate::named::wire_enum;

/// Longest reason in a [`Device`] [bytes].
pub const DEVICE_REASON_BYTES: usize = 96;

wire_enum! {
    /// What the devices behind a process do.
    pub enum DeviceState {
        /// The process has none, or does not report them.
        None = 0 "none",
        /// One of them is being connected or started.
        Connecting = 1 "connecting",
        /// All of them deliver data.
        Running = 2 "running",
        /// One of them can't be used, or has stopped delivering data.
        Fault = 3 "fault",
    }
}

layout! {
    /// What the devices behind a process do, since when, and why.
    pub struct Device(112) {
        /// What they do, `DeviceState`
        pub state: u32,
        /// Unused, zero
        pub reserved: u32,
        /// Since when they do it; 0 while it is not known [ns of CLOCK_MONOTONIC]
        pub since_ns: u64,
        /// Why, in a few words of UTF-8, padded with zeros
        pub reason: [u8; DEVICE_REASON_BYTES],
    }
}

impl Device {
    /// Notes a state and its reason, of which only whole characters that fit are kept; returns whether either is new.
    pub fn note(&mut self, state: DeviceState, reason: &str, now_ns: u64) -> bool {
        let mut text = [0; DEVICE_REASON_BYTES];
        let length = reason.floor_char_boundary(DEVICE_REASON_BYTES);
        text[..length].copy_from_slice(&reason.as_bytes()[..length]);
        let is_same_state = self.state == state.wire();
        if is_same_state && self.reason == text {
            return false;
        }
        let since_ns = if is_same_state { self.since_ns } else { now_ns };
        *self = Self { state: state.wire(), reserved: 0, since_ns, reason: text };
        true
    }

    /// What they do; a number without a meaning is none.
    pub fn state(&self) -> DeviceState {
        DeviceState::try_from(self.state).unwrap_or(DeviceState::None)
    }

    /// Why; what can't be printed stands there as `?`.
    pub fn reason(&self) -> String {
        let length = self.reason.iter().position(|byte| *byte == 0).unwrap_or(DEVICE_REASON_BYTES);
        let text = String::from_utf8_lossy(&self.reason[..length]);
        text.chars().map(|letter| if letter.is_control() { '?' } else { letter }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_state_starts_with_the_state_and_not_with_another_reason() {
        let mut device = Device::default();
        assert_eq!((device.state(), device.reason()), (DeviceState::None, String::new()));
        assert!(device.note(DeviceState::Fault, "scanner: no scan comes", 5));
        assert!(!device.note(DeviceState::Fault, "scanner: no scan comes", 6));
        assert!(device.note(DeviceState::Fault, "scanner: connection refused", 7));
        assert_eq!((device.since_ns, device.reason().as_str()), (5, "scanner: connection refused"));
        assert!(device.note(DeviceState::Running, "", 8));
        assert_eq!((device.since_ns, device.state()), (8, DeviceState::Running));
    }

    #[test]
    fn a_reason_is_cut_between_characters_and_has_no_control_characters() {
        let mut device = Device::default();
        device.note(DeviceState::Fault, &format!("{}\u{e4}", "x".repeat(DEVICE_REASON_BYTES - 1)), 1);
        assert_eq!(device.reason(), "x".repeat(DEVICE_REASON_BYTES - 1));
        device.note(DeviceState::Fault, "a\u{1b}[2Jb", 1);
        assert_eq!(device.reason(), "a?[2Jb");
        device.reason = [0xff; DEVICE_REASON_BYTES];
        assert_eq!(device.reason().chars().count(), DEVICE_REASON_BYTES);
    }
}
