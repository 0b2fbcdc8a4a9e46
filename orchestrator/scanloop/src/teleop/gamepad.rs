//! What a gamepad asks for: events of Linux (evdev) decoded.
//!
//! The left shoulder button is the dead man: it has to be pressed, and held. Up is the velocity, left and right the steering
//! angle. After lost events (`SYN_DROPPED`) nothing is known, so it has to be pressed anew.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use console::exit::Failure;
use rustix::fs::{Mode, OFlags, open};

use super::keys::Line;

/// Bytes of an event: a time of two words, type, code and value.
const EVENT: usize = 2 * size_of::<usize>() + 8;
/// Types and codes of the kernel's `input-event-codes.h`.
const EV_SYN: u16 = 0;
const EV_KEY: u16 = 1;
const EV_ABS: u16 = 3;
const SYN_REPORT: u16 = 0;
const SYN_DROPPED: u16 = 3;
const ABS_X: u16 = 0;
const ABS_Y: u16 = 1;
const BTN_SOUTH: usize = 0x130;
const BTN_TL: u16 = 0x136;
const BTN_SELECT: u16 = 0x13a;
const BTN_START: u16 = 0x13b;
/// Range of a stick where events come from something else than a device, such as a pipe from another host.
const RANGE: [i32; 2] = [-32768, 32767];
/// Share of the stick around its middle that is none.
const DEAD_ZONE: f64 = 0.12;
/// Steering angle of a stick at its end, unless another one is asked for [rad].
const STEERING_RAD: f64 = 0.06;
/// Where the kernel tells what devices are.
const DEVICES: &str = "/sys/class/input";

/// A gamepad, as its events tell.
#[derive(Debug, Clone)]
pub(super) struct Gamepad {
    /// Velocity [m/s] and steering angle [rad] of a stick at its end.
    full: [f64; 2],
    range: [[i32; 2]; 2],
    /// The stick to the right and down, -1 to 1.
    stick: [f64; 2],
    is_held: bool,
    /// Between lost events and the end of their report.
    is_lost: bool,
    /// The beginning of an event.
    rest: Vec<u8>,
}

impl Gamepad {
    /// One at rest whose stick has this range.
    pub(super) fn new(velocity: f64, steering: Option<f64>, range: Option<[[i32; 2]; 2]>) -> Self {
        Self {
            full: [velocity, steering.unwrap_or(STEERING_RAD)],
            range: range.unwrap_or([RANGE; 2]),
            stick: [0.0; 2],
            is_held: false,
            is_lost: false,
            rest: Vec::new(),
        }
    }

    /// What it asks for while the dead man is held.
    pub(super) fn asked(&self) -> Option<[f64; 2]> {
        let [velocity, steering] = self.full;
        let [right, down] = self.stick;
        self.is_held.then_some([(-down).max(0.0) * velocity, -right * steering])
    }

    /// Follows the events in bytes; with what a button of them asks for.
    pub(super) fn take(&mut self, bytes: &[u8]) -> Option<Line> {
        self.rest.extend_from_slice(bytes);
        let whole = self.rest.len() - self.rest.len() % EVENT;
        let events: Vec<u8> = self.rest.drain(..whole).collect();
        let mut asked = None;
        for event in events.chunks_exact(EVENT) {
            let [.., t0, t1, c0, c1, v0, v1, v2, v3] = *event else { continue };
            let (kind, code) = (u16::from_ne_bytes([t0, t1]), u16::from_ne_bytes([c0, c1]));
            let value = i32::from_ne_bytes([v0, v1, v2, v3]);
            match (kind, code) {
                (EV_SYN, SYN_DROPPED) => {
                    *self = Self { is_lost: true, is_held: false, stick: [0.0; 2], ..self.clone() };
                }
                (EV_SYN, SYN_REPORT) => self.is_lost = false,
                _ if self.is_lost => {}
                (EV_ABS, ABS_X) => self.stick[0] = share(value, self.range[0]),
                (EV_ABS, ABS_Y) => self.stick[1] = share(value, self.range[1]),
                // A button that is held repeats nothing, or 2.
                (EV_KEY, BTN_TL) => self.is_held = value != 0 && (self.is_held || value == 1),
                (EV_KEY, BTN_SELECT) if value == 1 => asked = Some(Line::Pause),
                (EV_KEY, BTN_START) if value == 1 => asked = Some(Line::Resume),
                _ => {}
            }
        }
        asked
    }
}

/// Where a stick stands in its range, -1 to 1; 0 near its middle.
fn share(value: i32, [minimum, maximum]: [i32; 2]) -> f64 {
    let (value, minimum, maximum) = (f64::from(value), f64::from(minimum), f64::from(maximum));
    let share = (2.0 * (value - minimum) / (maximum - minimum).max(1.0) - 1.0).clamp(-1.0, 1.0);
    share.signum() * ((share.abs() - DEAD_ZONE) / (1.0 - DEAD_ZONE)).max(0.0)
}

/// Opens a gamepad: this one, else the first that this machine has.
///
/// # Errors
/// What was looked at, and why it can't be used; exit code 2.
pub(super) fn open_gamepad(device: Option<&Path>) -> anyhow::Result<File> {
    let path = match device {
        Some(device) => device.to_owned(),
        None => find(Path::new(DEVICES))?,
    };
    let file = open(&path, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty());
    file.map(File::from).map_err(|error| {
        let hint = match io::Error::from(error).kind() {
            io::ErrorKind::PermissionDenied => ": add this user to the group `input`, then log in anew",
            _ => "",
        };
        Failure::bad_input(format!("gamepad {}: {}{hint}", path.display(), io::Error::from(error)))
    })
}

/// The first device in a folder of the kernel that has a stick and the button of a gamepad.
fn find(folder: &Path) -> anyhow::Result<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let number = |name: &str| name.strip_prefix("event").and_then(|number| number.parse::<u32>().ok());
    let mut devices: Vec<u32> =
        entries.filter_map(|entry| number(&entry.file_name().to_string_lossy())).collect();
    devices.sort_unstable();
    let mut seen = Vec::new();
    for device in devices {
        let about = folder.join(format!("event{device}/device"));
        let read = |name: &str| std::fs::read_to_string(about.join(name)).unwrap_or_default();
        let has = |name: &str, bits: &[usize]| {
            let text = read(name);
            bits.iter().all(|bit| has_bit(&text, *bit))
        };
        let path = format!("/dev/input/event{device}");
        if has("capabilities/key", &[BTN_SOUTH])
            && has("capabilities/abs", &[usize::from(ABS_X), usize::from(ABS_Y)])
        {
            return Ok(path.into());
        }
        seen.push(format!("{path} ({})", read("name").trim()));
    }
    let seen = if seen.is_empty() { "no input devices".to_owned() } else { seen.join(", ") };
    Err(Failure::bad_input(format!(
        "there is no gamepad, a device with a stick and the button `south`: {} has {seen}",
        folder.display()
    )))
}

/// Whether a bit is set in a bitmap of the kernel: words of hexadecimal digits, the highest first.
fn has_bit(text: &str, bit: usize) -> bool {
    let bits = usize::BITS as usize;
    let word = text.split_whitespace().rev().nth(bit / bits);
    word.and_then(|word| usize::from_str_radix(word, 16).ok())
        .is_some_and(|word| word >> (bit % bits) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(kind: u16, code: u16, value: i32) -> Vec<u8> {
        let mut bytes = vec![7; EVENT - 8];
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(code.to_ne_bytes());
        bytes.extend(value.to_ne_bytes());
        bytes
    }

    fn report() -> Vec<u8> {
        event(EV_SYN, SYN_REPORT, 0)
    }

    /// The events of a stick of 0 to 255, and a report.
    fn stick(x: i32, y: i32) -> Vec<u8> {
        [event(EV_ABS, ABS_X, x), event(EV_ABS, ABS_Y, y), report()].concat()
    }

    fn gamepad() -> Gamepad {
        Gamepad::new(0.5, None, Some([[0, 255]; 2]))
    }

    #[test]
    fn it_drives_only_while_the_dead_man_is_held() {
        let mut pad = gamepad();
        assert_eq!(pad.take(&stick(0, 0)), None);
        assert_eq!(pad.asked(), None);
        pad.take(&event(EV_KEY, BTN_TL, 2));
        assert_eq!(pad.asked(), None, "held before: it has to be pressed anew");
        pad.take(&event(EV_KEY, BTN_TL, 1));
        assert_eq!(pad.asked(), Some([0.5, 0.06]), "up and to the left");
        pad.take(&stick(255, 127));
        assert_eq!(pad.asked(), Some([0.0, -0.06]), "in the middle is a dead zone");
        pad.take(&stick(127, 255));
        assert_eq!(pad.asked(), Some([0.0, 0.0]), "down is not backwards");
        pad.take(&event(EV_KEY, BTN_TL, 0));
        assert_eq!(pad.asked(), None);
    }

    #[test]
    fn events_come_in_pieces_and_others_mean_nothing() {
        let mut pad = gamepad();
        let other = [event(EV_ABS, 5, 255), event(EV_KEY, 0x130, 1), event(4, 4, 9)].concat();
        let bytes = [other, event(EV_KEY, BTN_TL, 1), stick(128, 0)].concat();
        bytes.chunks(7).for_each(|piece| assert_eq!(pad.take(piece), None));
        let [velocity, steering] = pad.asked().unwrap();
        assert!(velocity == 0.5 && steering.abs() < 1e-12);
    }

    #[test]
    fn lost_events_release_it() {
        let mut pad = gamepad();
        pad.take(&[event(EV_KEY, BTN_TL, 1), stick(127, 0)].concat());
        pad.take(&event(EV_SYN, SYN_DROPPED, 0));
        assert_eq!(pad.asked(), None);
        pad.take(&[event(EV_KEY, BTN_TL, 1), event(EV_ABS, ABS_Y, 0)].concat());
        assert_eq!(pad.asked(), None, "up to its end the report is incomplete");
        pad.take(&[report(), event(EV_KEY, BTN_TL, 2)].concat());
        assert_eq!(pad.asked(), None);
        pad.take(&event(EV_KEY, BTN_TL, 1));
        assert_eq!(pad.asked(), Some([0.0, 0.0]), "where the stick stands is not known either");
    }

    #[test]
    fn select_pauses_and_start_hands_back_once_each() {
        let mut pad = gamepad();
        assert_eq!(pad.take(&event(EV_KEY, BTN_SELECT, 1)), Some(Line::Pause));
        assert_eq!(pad.take(&event(EV_KEY, BTN_SELECT, 0)), None);
        assert_eq!(pad.take(&event(EV_KEY, BTN_START, 1)), Some(Line::Resume));
        assert_eq!(pad.take(&event(EV_KEY, BTN_START, 2)), None);
    }

    #[test]
    fn the_first_device_with_a_stick_and_its_button_is_found() {
        let folder = std::env::temp_dir().join(format!("scanloop-gamepad-{}", std::process::id()));
        let device = |number: u32, name: &str, key: &str, abs: &str| {
            let about = folder.join(format!("event{number}/device"));
            std::fs::create_dir_all(about.join("capabilities")).unwrap();
            std::fs::write(about.join("name"), format!("{name}\n")).unwrap();
            std::fs::write(about.join("capabilities/key"), key).unwrap();
            std::fs::write(about.join("capabilities/abs"), abs).unwrap();
        };
        device(2, "Keyboard", "1000000000007 ff9f207ac14057ff febeffdfffefffff fffffffffffffffe", "0");
        let refused = find(&folder).unwrap_err().to_string();
        assert!(refused.contains("/dev/input/event2 (Keyboard)"), "{refused}");
        device(10, "Wireless Controller", "7fdb000000000000 0 0 0 0", "3003f");
        device(11, "Another", "7fdb000000000000 0 0 0 0", "3003f");
        assert_eq!(find(&folder).unwrap(), Path::new("/dev/input/event10"));
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(find(&folder).unwrap_err().to_string().contains("no input devices"));
    }
}
