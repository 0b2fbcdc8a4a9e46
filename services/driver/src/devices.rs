//! The state of base and scanner together, as `scanloop status` shows it.

use shared_types::{Device, DeviceState};

/// Names of the parts in a reason.
const NAMES: [&str; 2] = ["base", "scanner"];

/// What base and scanner do.
#[derive(Debug)]
pub struct Devices {
    /// Base and scanner; [`DeviceState::None`] for a scanner that comes with the base.
    parts: [Device; 2],
    state: DeviceState,
    reason: String,
}

impl Devices {
    /// A base that is connected; the scanner is one of its server, or one that is being connected by itself.
    pub fn new(has_scanner: bool, now_ns: u64) -> Self {
        let mut devices =
            Self { parts: [Device::default(); 2], state: DeviceState::Running, reason: String::new() };
        devices.parts[0].note(DeviceState::Running, "", now_ns);
        if has_scanner {
            devices.parts[1].note(DeviceState::Connecting, "", now_ns);
        }
        devices.join();
        devices
    }

    /// Notes what the base does.
    pub fn set_base(&mut self, state: DeviceState, reason: &str, now_ns: u64) {
        if self.parts[0].note(state, reason, now_ns) {
            self.join();
        }
    }

    /// Notes what a scanner at this computer does.
    pub fn set_scanner(&mut self, scanner: Device) {
        self.parts[1] = scanner;
        self.join();
    }

    /// The state of the part that works least, and for each part with a reason its name and the reason.
    pub fn shown(&self) -> (DeviceState, &str) {
        (self.state, &self.reason)
    }

    fn join(&mut self) {
        let states = self.parts.each_ref().map(Device::state);
        let worst = states.into_iter().max_by_key(|state| match state {
            DeviceState::None => 0,
            DeviceState::Running => 1,
            DeviceState::Connecting => 2,
            DeviceState::Fault => 3,
        });
        self.state = worst.unwrap_or(DeviceState::None);
        self.reason.clear();
        for (name, part) in NAMES.into_iter().zip(&self.parts) {
            let reason = part.reason();
            let is_connecting = part.state() == DeviceState::Connecting;
            if reason.is_empty() && !is_connecting {
                continue;
            }
            let separator = if self.reason.is_empty() { "" } else { "; " };
            for text in [separator, name, if reason.is_empty() { "" } else { ": " }, &reason] {
                self.reason.push_str(text);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_part_that_works_least_decides_and_each_reason_names_its_part() {
        let mut devices = Devices::new(true, 1);
        assert_eq!(devices.shown(), (DeviceState::Connecting, "scanner"));
        let mut scanner = Device::default();
        scanner.note(DeviceState::Running, "", 2);
        devices.set_scanner(scanner);
        assert_eq!(devices.shown(), (DeviceState::Running, ""));
        devices.set_base(DeviceState::Fault, "the server closed the connection", 3);
        assert_eq!(devices.shown(), (DeviceState::Fault, "base: the server closed the connection"));
        scanner.note(DeviceState::Fault, "no scan comes", 4);
        devices.set_scanner(scanner);
        devices.set_base(DeviceState::Running, "", 5);
        assert_eq!(devices.shown(), (DeviceState::Fault, "scanner: no scan comes"));
    }

    #[test]
    fn a_scanner_of_the_server_has_no_state_of_its_own() {
        assert_eq!(Devices::new(false, 1).shown(), (DeviceState::Running, ""));
    }
}
