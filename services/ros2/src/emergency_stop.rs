//! The companion `emergency-stop`: a button of ROS 2, `std_msgs/Bool`, as a topic that the actuator reads.
//!
//! Anything but a fresh `false` of the only publisher is a pressed button. No message is none here either: that the button is
//! silent is noticed by the actuator, after the `max_age_ms` of the system file.

use driver::ros2::Ros2Config;
use runtime::{Companion, NamedTopic};

use crate::arguments;
use crate::listener::{Listener, Received};
use crate::message::Bool;
use crate::system::only_output;

shared_types::plain_state! {
    /// An emergency stop, as the layout `examples/python/emergency-stop/button.toml` has it.
    pub struct Button {
        /// Identity and stamps of the sample that this one answers
        pub header: shared_types::Header,
        /// Not zero while it is pressed, or its contact can't be read
        pub pressed: u8,
        /// Unused, zero
        pub reserved: [u8; 7],
        /// When the process that published it worked on it
        pub stage: shared_types::StageStamps,
    }
}

/// Where the button is.
pub(crate) struct ButtonOptions {
    config: Ros2Config,
    topic: String,
}

impl ButtonOptions {
    /// Those of arguments `KEY=VALUE`.
    ///
    /// # Errors
    /// An argument that is none of them, with what is allowed.
    pub(crate) fn read(arguments: &[&str]) -> Result<Self, String> {
        let mut topic = "/emergency_stop".to_owned();
        let config = arguments::read(arguments, "", ", topic=NAME", |key, value| match key {
            "topic" => arguments::set(&mut topic, arguments::topic(value)),
            _ => false,
        })?;
        Ok(Self { config, topic })
    }
}

/// Runs until asked to end.
///
/// # Errors
/// A node that can't be made, a topic of our own with another layout, and errors of the bus.
pub(crate) fn run(options: &ButtonOptions) -> anyhow::Result<()> {
    let mut companion = Companion::attach()?;
    let output = only_output(&companion)?;
    let button: NamedTopic<Button> = companion.open(&output)?;
    let mut listener =
        Listener::open(&options.config, "scanloop_emergency_stop", &options.topic, |_: &Bool| None)?;
    if !companion.start()? {
        return Ok(());
    }
    // What was said before the drive has begun is not about it.
    while listener.take().is_some() {}
    while companion.wait(Some(0))? {
        listener.sleep()?;
        while let Some(received) = listener.take() {
            let pressed = u8::from(is_pressed(&received));
            if let Some(fault) = received.fault {
                listener.drop_message(&fault);
            }
            button.publish(&mut Button { pressed, ..Button::default() })?;
        }
    }
    Ok(())
}

fn is_pressed(received: &Received<Bool>) -> bool {
    received.message.data != 0 || received.fault.is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_false_that_can_be_trusted_is_a_released_button() {
        let said = |data: u8, fault: Option<&str>| {
            is_pressed(&Received { message: Bool { data }, stamped_ns: 0, fault: fault.map(str::to_owned) })
        };
        assert_eq!(
            [said(0, None), said(1, None), said(255, None), said(0, Some("late"))],
            [false, true, true, true]
        );
    }

    #[test]
    fn the_topic_is_an_argument() {
        let read = |arguments: &[&str]| {
            ButtonOptions::read(arguments).map(|options| options.config.topic(&options.topic))
        };
        assert_eq!(read(&["namespace=/robot1"]).unwrap(), "/emergency_stop");
        assert_eq!(read(&["namespace=/robot1", "topic=e_stop"]).unwrap(), "/robot1/e_stop");
        for wrong in ["topic=", "topic=a b", "pressed=1"] {
            assert!(read(&[wrong]).unwrap_err().starts_with(&format!("{wrong} is not allowed: some of ")));
        }
    }
}
