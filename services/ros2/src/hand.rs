//! What a person asks for by messages of ROS 2, and whether the person may take over with them.

use driver::motion::steering_of;
use vehicle::Description;

use crate::message::{Joy, Twist};

/// After it has lost the drive, a stream of velocities has to be silent for this long before it takes over anew [ns].
const SILENCE_NS: u64 = 1_000_000_000;

/// What a person asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Asked {
    /// A velocity [m/s] and a steering angle [rad].
    Drive([f64; 2]),
    /// Blocked wheels, until more is asked for.
    Pause,
    /// That the controller drives on.
    Resume,
}

/// How a gamepad is read. The defaults are those of `joy_node` with a gamepad for an Xbox: left stick, and the buttons LB,
/// BACK and START.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gamepad {
    /// Velocity of a stick that is all ahead [m/s]. To the side it asks for the largest steering angle of the vehicle.
    pub(crate) velocity_mps: f64,
    /// Numbers of the axes for velocity and steering.
    pub(crate) axes: [usize; 2],
    /// Numbers of the buttons: the one that is held to drive, that for a pause, and that to hand back.
    pub(crate) buttons: [usize; 3],
}

impl Default for Gamepad {
    fn default() -> Self {
        Self { velocity_mps: 0.5, axes: [1, 0], buttons: [4, 6, 7] }
    }
}

impl Gamepad {
    /// The control that its sticks ask for, and which buttons are held.
    ///
    /// # Errors
    /// An axis or a button that it does not have, and an axis that is no number.
    pub(crate) fn read(&self, vehicle: &Description, joy: &Joy) -> Result<([f64; 2], [bool; 3]), String> {
        let (mut shares, mut held) = ([0.0; 2], [false; 3]);
        for (share, number) in shares.iter_mut().zip(self.axes) {
            let axis = joy
                .axes
                .get(number)
                .ok_or_else(|| format!("it has {} axes, but number {number} is asked for", joy.axes.len()))?;
            if !axis.is_finite() {
                return Err(format!("axis {number} is {axis}"));
            }
            *share = f64::from(axis.clamp(-1.0, 1.0));
        }
        for (held, number) in held.iter_mut().zip(self.buttons) {
            let button = joy.buttons.get(number).ok_or_else(|| {
                format!("it has {} buttons, but number {number} is asked for", joy.buttons.len())
            })?;
            *held = *button != 0;
        }
        let [ahead, left] = shares;
        Ok(([self.velocity_mps * ahead, vehicle.bounds.steering_max_rad * left], held))
    }
}

/// The control that a velocity and a yaw rate ask for.
///
/// # Errors
/// Numbers that are none.
pub(crate) fn of_twist(vehicle: &Description, twist: &Twist) -> Result<[f64; 2], String> {
    let (velocity_mps, yaw_rate_radps) = (twist.linear.x, twist.angular.z);
    if !(velocity_mps.is_finite() && yaw_rate_radps.is_finite()) {
        return Err(format!("linear.x is {velocity_mps}, angular.z {yaw_rate_radps}"));
    }
    Ok([velocity_mps, steering_of(&vehicle.parameters(), velocity_mps, yaw_rate_radps)])
}

/// Follows what a person does. Who has lost the drive, because another one paused or resumed it, has to let go before it is
/// taken over again: a stream that nobody stops, or a button that is stuck, does not fight with that other one.
#[derive(Debug)]
pub(crate) struct Hand {
    /// Whether what is asked for may take over.
    is_free: bool,
    /// The buttons of the message before. One that is held from the start on is not pressed.
    held: [bool; 3],
    /// When the velocity before came [ns].
    seen_ns: u64,
}

impl Hand {
    /// Before anything was asked for; `is_free` if a first velocity may take over.
    pub(crate) fn new(is_free: bool) -> Self {
        Self { is_free, held: [false, true, true], seen_ns: 0 }
    }

    /// What a control asks for that came at `now_ns` in a stream of velocities.
    pub(crate) fn stream(&mut self, control: [f64; 2], now_ns: u64) -> Option<Asked> {
        self.is_free |= self.seen_ns > 0 && now_ns.saturating_sub(self.seen_ns) >= SILENCE_NS;
        self.seen_ns = now_ns;
        self.is_free.then_some(Asked::Drive(control))
    }

    /// What sticks and buttons ask for. While the first button is not held that is nothing, and once to stand.
    pub(crate) fn buttons(&mut self, control: [f64; 2], held: [bool; 3]) -> Option<Asked> {
        let before = std::mem::replace(&mut self.held, held);
        let is_pressed = |button: usize| held[button] && !before[button];
        let was_free = self.is_free;
        self.is_free |= !held[0];
        if is_pressed(1) || is_pressed(2) {
            self.is_free = false;
            return Some(if is_pressed(1) { Asked::Pause } else { Asked::Resume });
        }
        match (was_free, held[0], before[0]) {
            (true, true, _) => Some(Asked::Drive(control)),
            (true, false, true) => Some(Asked::Drive([0.0, control[1]])),
            _ => None,
        }
    }

    /// Notes that the drive was lost.
    pub(crate) fn lose(&mut self) {
        self.is_free = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Vector3;

    const S: u64 = 1_000_000_000;

    fn twist(velocity: f64, yaw_rate: f64) -> Twist {
        let ahead = Vector3 { x: velocity, ..Vector3::default() };
        Twist { linear: ahead, angular: Vector3 { z: yaw_rate, ..Vector3::default() } }
    }

    #[test]
    fn a_yaw_rate_is_asked_for_as_the_steering_angle_of_both_axles() {
        let vehicle = Description { front_m: 0.5, rear_m: 0.5, ..Description::default() };
        // A circle of 4 m radius: atan(0.5 / 4).
        assert_eq!(of_twist(&vehicle, &twist(0.8, 0.2)), Ok([0.8, 0.125_f64.atan()]));
        assert_eq!(of_twist(&vehicle, &twist(0.0, 0.2)), Ok([0.0, 0.0]));
        assert_eq!(of_twist(&vehicle, &twist(f64::NAN, 0.0)).unwrap_err(), "linear.x is NaN, angular.z 0");
        assert!(of_twist(&vehicle, &twist(0.5, f64::INFINITY)).is_err());
    }

    #[test]
    fn a_gamepad_is_read_by_the_numbers_of_its_axes_and_buttons() {
        let mut vehicle = Description::default();
        vehicle.bounds.steering_max_rad = 0.1;
        let gamepad = Gamepad { velocity_mps: 0.4, axes: [1, 2], buttons: [1, 0, 2] };
        let mut joy = Joy { axes: vec![9.0, 0.5, -1.5], buttons: vec![0, 1, 0], ..Joy::default() };
        assert_eq!(gamepad.read(&vehicle, &joy), Ok(([0.2, -0.1], [true, false, false])));
        joy.axes[1] = f32::NAN;
        assert_eq!(gamepad.read(&vehicle, &joy).unwrap_err(), "axis 1 is NaN");
        joy.axes.truncate(1);
        assert_eq!(gamepad.read(&vehicle, &joy).unwrap_err(), "it has 1 axes, but number 1 is asked for");
        joy = Joy { axes: vec![0.0; 3], buttons: vec![0; 2], ..Joy::default() };
        assert_eq!(gamepad.read(&vehicle, &joy).unwrap_err(), "it has 2 buttons, but number 2 is asked for");
    }

    #[test]
    fn sticks_count_while_the_button_is_held_and_letting_go_asks_once_to_stand() {
        let mut hand = Hand::new(false);
        let mut given = |held: bool| hand.buttons([0.5, 0.1], [held, false, false]);
        assert_eq!(given(true), None, "a button that was stuck from the start on");
        assert_eq!(given(false), None);
        let driving = Some(Asked::Drive([0.5, 0.1]));
        assert_eq!([given(true), given(true)], [driving, driving]);
        assert_eq!([given(false), given(false)], [Some(Asked::Drive([0.0, 0.1])), None]);
    }

    #[test]
    fn a_button_is_pressed_once_and_after_it_the_person_has_to_let_go() {
        let mut hand = Hand::new(false);
        assert_eq!(hand.buttons([0.5, 0.0], [false, true, true]), None, "they were held from the start on");
        assert_eq!(hand.buttons([0.5, 0.0], [false, false, false]), None);
        assert_eq!(hand.buttons([0.5, 0.0], [true, false, false]), Some(Asked::Drive([0.5, 0.0])));
        for (button, asked) in [(1, Asked::Pause), (2, Asked::Resume)] {
            let mut held = [true, false, false];
            held[button] = true;
            assert_eq!(hand.buttons([0.5, 0.0], held), Some(asked));
            assert_eq!(hand.buttons([0.5, 0.0], held), None, "it is still held");
            assert_eq!(hand.buttons([0.5, 0.0], [true, false, false]), None, "nor does the stick count");
            assert_eq!(hand.buttons([0.5, 0.0], [false, false, false]), None);
            assert_eq!(hand.buttons([0.5, 0.0], [true, false, false]), Some(Asked::Drive([0.5, 0.0])));
        }
    }

    #[test]
    fn a_stream_that_has_lost_the_drive_is_taken_again_after_it_was_silent() {
        let mut hand = Hand::new(true);
        let driving = Some(Asked::Drive([0.5, 0.0]));
        assert_eq!(hand.stream([0.5, 0.0], S), driving);
        hand.lose();
        assert_eq!(hand.stream([0.5, 0.0], S + S / 2), None);
        assert_eq!(hand.stream([0.5, 0.0], 2 * S), None, "only half a second later");
        assert_eq!(hand.stream([0.5, 0.0], 3 * S), driving);
        assert_eq!(Hand::new(false).stream([0.5, 0.0], S), None, "the start of a program is no silence");
    }
}
