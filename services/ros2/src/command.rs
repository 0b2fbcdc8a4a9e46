//! Commands for the wheels, in the form that the robot takes.

use driver::ros2::{CommandReliability, CommandType, Ros2Config};
use ros2_client::Publisher;
use runtime::monotonic_ns;

use crate::message::{
    AckermannDrive, AckermannDriveStamped, Header, Named, Time, Twist, TwistStamped, Vector3,
};
use crate::node::{RosNode, best_effort, reliable};

/// The writer in its form.
enum Form {
    Twist(Publisher<Twist>),
    Stamped(Publisher<TwistStamped>),
    Ackermann(Publisher<AckermannDriveStamped>),
}

/// Sends commands.
pub(crate) struct CommandWriter {
    form: Form,
    frame: String,
    /// The clock of the robot minus CLOCK_MONOTONIC [s]; without one, stamps are zero.
    pub(crate) offset_s: Option<f64>,
}

impl CommandWriter {
    /// A writer on the topic of the settings.
    ///
    /// # Errors
    /// Those of DDS.
    pub(crate) fn open(node: &mut RosNode, config: &Ros2Config) -> anyhow::Result<Self> {
        let topic = config.topic("cmd_vel");
        let qos = match config.reliability {
            CommandReliability::Reliable => reliable(),
            CommandReliability::BestEffort => best_effort(),
        };
        let form = match config.command {
            CommandType::Twist => Form::Twist(node.advertise(&topic, qos)?),
            CommandType::TwistStamped => Form::Stamped(node.advertise(&topic, qos)?),
            CommandType::Ackermann => Form::Ackermann(node.advertise(&topic, qos)?),
        };
        Ok(Self { form, frame: config.base_frame.clone(), offset_s: None })
    }

    /// Sends a velocity [m/s], with a yaw rate [rad/s] or a steering angle [rad].
    ///
    /// # Errors
    /// A queue that is full, and errors of DDS.
    pub(crate) fn send(&self, numbers: [f64; 2]) -> std::io::Result<()> {
        let sent = match &self.form {
            Form::Twist(writer) => writer.publish(twist(numbers)).map_err(|error| error.to_string()),
            Form::Stamped(writer) => writer
                .publish(TwistStamped { header: self.header(), twist: twist(numbers) })
                .map_err(|error| error.to_string()),
            Form::Ackermann(writer) => writer
                .publish(AckermannDriveStamped { header: self.header(), drive: ackermann(numbers) })
                .map_err(|error| error.to_string()),
        };
        sent.map_err(std::io::Error::other)
    }

    fn header(&self) -> Header {
        let now_s = monotonic_ns() as f64 * 1e-9;
        let stamp = self.offset_s.map_or_else(Time::default, |offset_s| Time::of_seconds(now_s + offset_s));
        Header { stamp, frame_id: self.frame.clone() }
    }
}

/// Package and type of the message that a robot takes.
pub(crate) fn type_of(command: CommandType) -> [&'static str; 2] {
    match command {
        CommandType::Twist => Twist::TYPE,
        CommandType::TwistStamped => TwistStamped::TYPE,
        CommandType::Ackermann => AckermannDriveStamped::TYPE,
    }
}

fn twist([velocity_mps, yaw_rate_radps]: [f64; 2]) -> Twist {
    Twist {
        linear: Vector3 { x: velocity_mps, ..Vector3::default() },
        angular: Vector3 { z: yaw_rate_radps, ..Vector3::default() },
    }
}

fn ackermann([velocity_mps, steering_rad]: [f64; 2]) -> AckermannDrive {
    AckermannDrive {
        speed: velocity_mps as f32,
        steering_angle: steering_rad as f32,
        ..AckermannDrive::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_has_velocity_and_turn_at_their_places() {
        let sent = twist([0.5, -0.2]);
        assert_eq!((sent.linear.x, sent.angular.z), (0.5, -0.2));
        assert_eq!([sent.linear.y, sent.linear.z, sent.angular.x, sent.angular.y], [0.0; 4]);
        let sent = ackermann([0.5, -0.25]);
        assert_eq!((sent.speed, sent.steering_angle, sent.acceleration), (0.5, -0.25, 0.0));
    }
}
