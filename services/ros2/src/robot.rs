//! The driver: role `robot`, implementation `ros2`.

use std::time::{Duration, Instant};

use driver::event::{ForeignRobot, RobotEvent, RobotSettings};
use driver::feed::Feed;
use driver::guard::Orders;
use driver::motion::{Convention, Turn};
use driver::ros2::{CommandType, Ros2Config};
use driver::scanner;
use driver::service::TIMEOUT_PERIODS;
use runtime::Process;
use vehicle::Description;

use crate::connection::{Wanted, serve};
use crate::transforms::Mounting;

/// A state so much older than a sweep is moved on to it, for bases that report 50 times a second: at 5 m/s^2 that is wrong
/// by a millimetre, while waiting for the next state costs 16 mm of way at 0.8 m/s [s].
const AHEAD_S: f64 = 0.02;

/// Runs until asked to end.
///
/// # Errors
/// Settings that are not allowed, no robot, and errors of the bus.
pub(crate) fn run() -> anyhow::Result<()> {
    driver::service::run("ros2", connect)
}

/// The robot behind its topics.
struct Ros2Robot(Feed<RobotEvent>);

impl ForeignRobot for Ros2Robot {
    fn next(&mut self) -> Option<RobotEvent> {
        self.0.next()
    }
}

fn connect(process: &mut Process) -> anyhow::Result<(Ros2Robot, Orders, RobotSettings)> {
    let config = process.settings::<Ros2Config>("ros2")?;
    config.validate().map_err(|invalid| anyhow::anyhow!("{}", invalid.within("ros2")))?;
    let vehicle: Description = process.settings("vehicle")?;
    let turn = match config.command {
        CommandType::Ackermann => Turn::Steering,
        CommandType::Twist | CommandType::TwistStamped => Turn::YawRate,
    };
    let settings = RobotSettings {
        convention: Convention::usual(turn, config.wheelbase_m),
        delay_s: config.delay_s,
        ahead_s: AHEAD_S,
        // Stamps are those of the front beam.
        stamp_offset_s: 0.0,
        sweep_s: config.sweep_s,
        has_scanner: config.has_scanner(),
    };
    let mounting = Mounting::of(&vehicle);
    let (limit_s, domain) = (config.connect_timeout_s, config.domain);
    let timeout_ns = TIMEOUT_PERIODS * process.period_ns();
    let waker = process.waker();
    let (mut feed, outlet) = Feed::new(move || waker.wake());
    if config.has_scanner() {
        let (settings, outlet) = (config.scanner_settings(), outlet.clone());
        feed.spawn("scanner", move || {
            scanner::read(&settings, &vehicle.scanner, timeout_ns, &outlet, |event| event);
        })?;
    }
    let wanted = Wanted { config, mounting, scanner: vehicle.scanner, timeout_ns };
    feed.spawn("ros2", move || {
        if let Err(error) = serve(&wanted, &outlet) {
            outlet.put(RobotEvent::Lost(format!("{error:#}")));
        }
    })?;
    let orders = connected(&feed, limit_s).map_err(|reason| {
        anyhow::anyhow!("no ROS 2 robot in domain {domain} within {limit_s} s: {reason}")
    })?;
    tracing::info!(domain, "connected");
    Ok((Ros2Robot(feed), orders, settings))
}

/// Waits for the first connection.
///
/// # Errors
/// The newest reason why there is none after the time of the settings.
fn connected(feed: &Feed<RobotEvent>, limit_s: f64) -> Result<Orders, String> {
    let (end, mut reason) = (Instant::now() + Duration::from_secs_f64(limit_s), "no answer yet".to_owned());
    loop {
        match feed.wait(end) {
            Some(RobotEvent::Connected(orders)) => return Ok(orders),
            Some(RobotEvent::Lost(lost)) => reason = lost,
            // A state of the scanner that came before the first connection still counts.
            Some(event @ RobotEvent::Scanner(_)) => feed.put_back(event),
            Some(_) => {}
            None => return Err(reason),
        }
    }
}
