//! The companion `imu`: `sensor_msgs/Imu` as a topic of the system, one sample for each scan.
//!
//! A sample answers the odometry of a scan and has its number. It holds the mean yaw rate from the odometry before to this one,
//! on the clock of the scans. A time that the messages do not cover without a gap has no sample: its odometry stands alone.

use std::collections::VecDeque;

use driver::ros2::Ros2Config;
use runtime::{Companion, NamedTopic, monotonic_ns};
use shared_types::{Header, Odometry};

use crate::arguments;
use crate::listener::Listener;
use crate::message;
use crate::system::only_output;

/// Messages are taken this often [ns].
const TAKE_NS: u64 = 5_000_000;
/// Messages further apart leave a gap [ns].
const MAX_GAP_NS: u64 = 50_000_000;
/// So many rates are kept: two seconds of a sensor with 1 kHz.
const MAX_RATES: usize = 2000;

shared_types::plain_state! {
    /// What an inertial sensor measures, as the layout `examples/rust/imu/imu.toml` has it.
    pub struct Imu {
        /// Identity and stamps of the sample that this one answers
        pub header: shared_types::Header,
        /// Mean yaw rate since the sample before [rad/s]
        pub yaw_rate_radps: f64,
        /// Time since the sample before; zero in the first sample [s]
        pub dt_s: f64,
        /// When the process that published it worked on it
        pub stage: shared_types::StageStamps,
    }
}

/// Where the sensor is.
#[derive(Debug)]
pub(crate) struct ImuOptions {
    config: Ros2Config,
    topic: String,
    /// Where up is in the frame of the sensor, of length 1.
    up: [f64; 3],
}

impl ImuOptions {
    /// Those of arguments `KEY=VALUE`.
    ///
    /// # Errors
    /// An argument that is none of them, with what is allowed.
    pub(crate) fn read(arguments: &[&str]) -> Result<Self, String> {
        let (mut topic, mut up) = ("imu".to_owned(), [0.0, 0.0, 1.0]);
        let config = arguments::read(arguments, "", ", topic=NAME, up=X,Y,Z", |key, value| match key {
            "topic" => arguments::set(&mut topic, arguments::topic(value)),
            "up" => arguments::set(&mut up, arguments::three(value).and_then(unit)),
            _ => false,
        })?;
        Ok(Self { config, topic, up })
    }

    /// The rate about the vertical axis of the robot in a message [rad/s].
    ///
    /// # Errors
    /// A message without rates, and numbers that are none.
    fn rate(&self, message: &message::Imu) -> Result<f64, String> {
        if message.angular_velocity_covariance[0] < 0.0 {
            return Err("it has no angular velocity, says its covariance".to_owned());
        }
        let message::Vector3 { x, y, z } = message.angular_velocity;
        let rate = [x, y, z].iter().zip(self.up).map(|(rate, up)| rate * up).sum::<f64>();
        if rate.is_finite() { Ok(rate) } else { Err(format!("its angular velocity is {x}, {y}, {z}")) }
    }
}

/// A direction as a vector of length 1; `None` for one that has none.
fn unit(direction: [f64; 3]) -> Option<[f64; 3]> {
    let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
    (length > 1e-6).then(|| direction.map(|part| part / length))
}

/// Runs until asked to end.
///
/// # Errors
/// A node that can't be made, a topic of our own with another layout, and errors of the bus.
pub(crate) fn run(options: &ImuOptions) -> anyhow::Result<()> {
    let mut companion = Companion::attach()?;
    let odometries = companion.input::<Odometry>()?;
    let output = only_output(&companion)?;
    let imu: NamedTopic<Imu> = companion.open(&output)?;
    let mut listener =
        Listener::open(&options.config, "scanloop_imu", &options.topic, |message: &message::Imu| {
            Some(&message.header.stamp)
        })?;
    if !companion.start()? {
        return Ok(());
    }
    let (mut rates, mut before_ns, mut waits) = (Rates::default(), None, None);
    while companion.wait(Some(monotonic_ns() + TAKE_NS))? {
        while let Some(received) = listener.take() {
            match received.fault.map_or_else(|| options.rate(&received.message), Err) {
                Ok(rate) => rates.add(received.stamped_ns, rate),
                Err(fault) => listener.drop_message(&fault),
            }
        }
        while let Some(odometry) = odometries.take()? {
            let header: Header = odometry.header;
            // A scan whose time was not covered until the next one is passed over.
            waits = before_ns.replace(header.acquired_ns).map(|from_ns| (from_ns, header));
        }
        if let Some((from_ns, header)) = waits
            && let Some(yaw_rate_radps) = rates.mean(from_ns, header.acquired_ns)
        {
            waits = None;
            let dt_s = (header.acquired_ns - from_ns) as f64 * 1e-9;
            imu.publish(&mut Imu { header: header.answer(), yaw_rate_radps, dt_s, ..Imu::default() })?;
        }
    }
    Ok(())
}

/// Rates at their times, the newest last.
#[derive(Debug, Default)]
struct Rates(VecDeque<(u64, f64)>);

impl Rates {
    fn add(&mut self, time_ns: u64, rate: f64) {
        if self.0.back().is_some_and(|(newest_ns, _)| time_ns <= *newest_ns) {
            return;
        }
        if self.0.len() == MAX_RATES {
            self.0.pop_front();
        }
        self.0.push_back((time_ns, rate));
    }

    /// The mean from one time to another, with straight lines between the rates; `None` where they do not cover it.
    fn mean(&self, from_ns: u64, to_ns: u64) -> Option<f64> {
        let Self(rates) = self;
        let is_covered = rates.front()?.0 <= from_ns && from_ns < to_ns && to_ns <= rates.back()?.0;
        let mut turned = 0.0;
        for ((start_ns, start), (end_ns, end)) in rates.iter().zip(rates.range(1..)) {
            let [first_ns, last_ns] = [from_ns, to_ns].map(|time_ns| time_ns.clamp(*start_ns, *end_ns));
            if first_ns == last_ns {
                continue;
            }
            if end_ns - start_ns > MAX_GAP_NS {
                return None;
            }
            let at = |time_ns: u64| {
                start + (end - start) * (time_ns - start_ns) as f64 / (end_ns - start_ns) as f64
            };
            turned += f64::midpoint(at(first_ns), at(last_ns)) * (last_ns - first_ns) as f64;
        }
        is_covered.then(|| turned / (to_ns - from_ns) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn the_mean_between_two_scans_is_the_turned_angle_over_their_time() {
        let mut rates = Rates::default();
        // From 0 to 1 rad/s in 100 ms, then constant.
        (0..=10).for_each(|step| rates.add(step * 10 * MS, step as f64 / 10.0));
        (11..=15).for_each(|step| rates.add(step * 10 * MS, 1.0));
        let mean = |from: u64, to: u64| rates.mean(from * MS, to * MS);
        let close =
            |found: Option<f64>, wanted: f64| assert!((found.unwrap() - wanted).abs() < 1e-12, "{found:?}");
        close(mean(0, 100), 0.5);
        // Between messages, too: from 0.25 to 0.55.
        close(mean(25, 55), 0.4);
        // Half a way at 0.75, half at 1.
        close(mean(50, 150), 0.875);
        assert_eq!([mean(100, 151), mean(50, 50)], [None; 2], "beyond the newest, and no time");
        rates.add(210 * MS, 1.0);
        assert_eq!(rates.mean(120 * MS, 200 * MS), None, "60 ms are a gap");
        rates.add(220 * MS, 0.0);
        close(rates.mean(210 * MS, 220 * MS), 0.5);
        rates.add(215 * MS, 9.0);
        close(rates.mean(210 * MS, 220 * MS), 0.5);
    }

    #[test]
    fn the_rate_is_that_about_the_vertical_axis_however_the_sensor_is_mounted() {
        let mut message = message::Imu::default();
        message.angular_velocity = message::Vector3 { x: 0.1, y: -0.2, z: 0.3 };
        let rate =
            |argument: &str, message: &message::Imu| ImuOptions::read(&[argument]).unwrap().rate(message);
        assert_eq!(rate("up=0,0,1", &message), Ok(0.3));
        assert_eq!(rate("up=0,0,-2", &message), Ok(-0.3), "upside down");
        assert_eq!(rate("up=0,-1,0", &message), Ok(0.2), "on its side");
        message.angular_velocity.x = f64::NAN;
        assert_eq!(rate("up=0,0,1", &message).unwrap_err(), "its angular velocity is NaN, -0.2, 0.3");
        message.angular_velocity_covariance[0] = -1.0;
        assert!(rate("up=0,0,1", &message).unwrap_err().starts_with("it has no angular velocity"));
        assert!(ImuOptions::read(&["up=0,0,0"]).unwrap_err().starts_with("up=0,0,0 is not allowed"));
    }
}
