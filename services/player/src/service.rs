//! The process of the driver: actuation in; scan and odometry out.

use std::path::Path;

use driver::event::{ForeignRobot, RobotEvent, RobotSettings};
use driver::guard::Orders;
use driver::motion::{Convention, Turn};
use driver::service::TIMEOUT_PERIODS;
use runtime::Process;
use vehicle::Description;

use crate::client::{Client, ClientEvent};
use crate::config::{DriveCommand, PlayerConfig, ScanSource};
use crate::handshake::PlayerSession;

/// The guard is a service of this program, also when an update has replaced its file.
const THIS_PROGRAM: &str = "/proc/self/exe";
/// A state so much older than a sweep counts as of the same time [s].
const AHEAD_S: f64 = 0.005;
/// Mounting of the scanner that is reported and described may differ by this [m, rad].
const MOUNTING: f64 = 0.01;

/// Runs until asked to end.
///
/// # Errors
/// Settings that are not allowed, no server, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    driver::service::run("player", connect)
}

fn connect(process: &mut Process) -> anyhow::Result<(PlayerRobot, Orders, RobotSettings)> {
    let config = process.settings::<PlayerConfig>("player")?;
    config.validate().map_err(|invalid| anyhow::anyhow!("{}", invalid.within("player")))?;
    let vehicle: Description = process.settings("vehicle")?;
    let waker = process.waker();
    let timeout_ns = TIMEOUT_PERIODS * process.period_ns();
    let client =
        Client::start(&config, vehicle.scanner, timeout_ns, Path::new(THIS_PROGRAM), move || waker.wake())?;
    let limit_s = config.connect_timeout_s;
    let (orders, session) = client.connected(limit_s).map_err(|lost| {
        let reason = lost.map_or("no answer yet".to_owned(), |lost| lost.to_string());
        anyhow::anyhow!("no connection to {} within {limit_s} s: {reason}", config.server())
    })?;
    let settings = config.robot();
    let robot = PlayerRobot { client, config, vehicle };
    robot.log_devices(&session);
    Ok((robot, orders, settings))
}

impl PlayerConfig {
    /// What a driver has to know.
    fn robot(&self) -> RobotSettings {
        let turn = match self.command {
            DriveCommand::Car => Turn::Steering,
            DriveCommand::Velocity => Turn::YawRate,
        };
        RobotSettings {
            convention: Convention {
                turn,
                wheelbase_m: self.wheelbase_m,
                velocity_sign: self.velocity_sign,
                steering_sign: self.steering_sign,
                odometry_signs: self.odometry_signs,
            },
            delay_s: self.delay_s,
            ahead_s: AHEAD_S,
            stamp_offset_s: self.stamp_offset_s,
            sweep_s: self.sweep_s,
            has_scanner: self.scan == ScanSource::Urg,
        }
    }
}

/// The robot behind the server.
struct PlayerRobot {
    client: Client,
    config: PlayerConfig,
    vehicle: Description,
}

impl ForeignRobot for PlayerRobot {
    fn next(&mut self) -> Option<RobotEvent> {
        self.client.next().map(|event| match event {
            ClientEvent::Connected(orders, session) => {
                self.log_devices(&session);
                RobotEvent::Connected(orders)
            }
            ClientEvent::State { state, time_s, arrived_ns } => {
                RobotEvent::State { state, time_s, arrived_ns }
            }
            ClientEvent::Sweep { ranges_mm, time_s, arrived_ns } => {
                RobotEvent::Sweep { ranges_mm, time_s, sweep_ns: None, arrived_ns }
            }
            ClientEvent::Scanner(event) => event,
            ClientEvent::Lost(lost) => RobotEvent::Lost(lost.to_string()),
        })
    }
}

impl PlayerRobot {
    /// Logs what the server reports about its devices, and warns when the description has others.
    fn log_devices(&self, session: &PlayerSession) {
        let Self { config, vehicle, .. } = self;
        let server = config.server();
        let scanner = session.scanner.map_or("none".to_owned(), |scanner| scanner.to_string());
        tracing::info!(server, base = %config.base(), scanner, body_m = ?session.body_m, "connected");
        if let Some([length_m, width_m]) = session.body_m
            && (length_m > vehicle.length_m + MOUNTING || width_m > vehicle.width_m + MOUNTING)
        {
            tracing::warn!(
                length_m,
                width_m,
                "the body is larger: compare `vehicle.length_m` and `vehicle.width_m`"
            );
        }
        let described = [vehicle.scanner_x_m, vehicle.scanner_y_m, vehicle.scanner_yaw_rad];
        let Some(reported) = session.mounting else { return };
        if reported.iter().zip(described).any(|(reported, described)| (reported - described).abs() > MOUNTING)
        {
            tracing::warn!(
                ?reported,
                ?described,
                "the scanner is elsewhere: compare `vehicle.scanner_x_m` and its like"
            );
        }
    }
}
