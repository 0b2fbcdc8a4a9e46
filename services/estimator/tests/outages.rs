//! Data and commands of the robot are away for a while: the estimate takes up where the robot really is, and nothing is
//! suspected.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use actuation::Actuator;
use emulator::{Emulator, Scenario};
use estimator::{Estimator, EstimatorConfig};
use shared_types::{
    Actuation, Alarm, Command, CommandKind, Header, Level, Odometry, Pose, Role, Scan, SolveStatus, Truth,
};

const T_NS: u64 = 100_000_000;
/// The last scan before the outage: the robot has its full speed.
const LAST: u64 = 40;

/// What the connection and the robot do in an outage.
#[derive(Debug, Clone, Copy)]
struct Outage {
    /// How long neither data nor commands pass [s].
    gap_s: f64,
    /// The robot blocks its wheels after this time without a command [s].
    watchdog_s: f64,
    /// Whether the driver forwards the data of the outage when it is over.
    forwards: bool,
    velocity_mps: f64,
    steering_rad: f64,
}

/// The loop without its middle: robot, estimator and actuator.
struct Loop {
    outage: Outage,
    robot: Emulator,
    estimator: Estimator,
    actuator: Actuator,
    sequence: u64,
    sent: Actuation,
    /// The largest error of the position since the outage [m].
    error_m: f64,
    pose: Pose,
}

impl Loop {
    fn new(outage: Outage) -> Self {
        let mut scenario = Scenario::default();
        scenario.obstacles.clear();
        scenario.timeout_s = 60.0;
        Self {
            outage,
            robot: Emulator::new(&scenario, T_NS),
            estimator: Estimator::new(&EstimatorConfig { odometry_scale: 0.0, ..EstimatorConfig::default() })
                .unwrap(),
            actuator: Actuator::new(actuation::ActuatorConfig::default(), T_NS).unwrap(),
            sequence: 0,
            sent: Actuation::default(),
            error_m: 0.0,
            pose: Pose::default(),
        }
    }

    fn is_away(&self, at_ns: u64) -> bool {
        let since_s = at_ns.saturating_sub(LAST * T_NS + T_NS / 2) as f64 * 1e-9;
        since_s > 0.0 && since_s <= self.outage.gap_s
    }

    /// What a scan shows, when its sweep is complete.
    fn measure(&mut self, scan_id: u64) -> (Odometry, Truth) {
        let (mut odometry, mut truth) = (Odometry::default(), Truth::default());
        self.robot.measure(scan_id, &mut Scan::default(), &mut odometry, &mut truth);
        let acquired_ns = self.robot.acquired_ns(scan_id);
        odometry.header = Header { scan_id, incarnation: 1, acquired_ns, ..Header::default() };
        (odometry, truth)
    }

    /// A sample reaches the estimator, and its command the robot.
    fn receive(&mut self, mut odometry: Odometry, truth: &Truth, now_ns: u64) {
        // A driver numbers what it publishes, so nothing seems to be missing.
        self.sequence += 1;
        (odometry.header.sequence, odometry.header.scan_id) = (self.sequence, self.sequence);
        let pose = self.estimator.step(&odometry, None, now_ns).unwrap();
        if odometry.header.acquired_ns > LAST * T_NS {
            self.error_m = self.error_m.max((pose.x_m - truth.x_m).hypot(pose.y_m - truth.y_m));
        }
        let command = Command {
            header: pose.header,
            kind: CommandKind::Drive.wire(),
            level: Level::Converged.wire(),
            status: SolveStatus::Converged.wire(),
            verified: 1,
            velocity_mps: self.outage.velocity_mps,
            steering_rad: self.outage.steering_rad,
            ..Command::default()
        };
        self.pose = pose;
        let answer = self.actuator.answer(&command, now_ns);
        self.publish(answer, now_ns);
    }

    /// An actuation reaches the estimator, and the robot unless it is out of reach.
    fn publish(&mut self, mut actuation: Actuation, now_ns: u64) {
        actuation.header.stage_mut(Role::Actuator).published_ns = now_ns;
        self.estimator.note(&actuation, now_ns);
        if !self.is_away(now_ns) {
            self.robot.actuate(&actuation);
            self.sent = actuation;
        }
    }

    fn drive(&mut self) {
        let mut forwarded = Vec::new();
        for scan_id in 1..=LAST + 90 {
            // Between two scans: the actuator checks for silence, and the robot follows what it has until its watchdog acts.
            let before_ns = self.robot.scan_ready_ns(scan_id - 1);
            for now_ns in (0..10).map(|tenth| before_ns + tenth * T_NS / 10) {
                self.robot.advance_to(now_ns);
                if let Some(block) = self.actuator.tick(now_ns) {
                    self.publish(block, now_ns);
                }
                let sent_ns = self.sent.header.stage(Role::Actuator).published_ns;
                if self.is_away(now_ns) && (now_ns - sent_ns) as f64 * 1e-9 <= self.outage.watchdog_s - 0.2 {
                    self.robot.actuate(&self.sent);
                }
            }
            let now_ns = self.robot.scan_ready_ns(scan_id);
            self.robot.advance_to(now_ns);
            let (odometry, truth) = self.measure(scan_id);
            if self.is_away(now_ns) {
                forwarded.push((odometry, truth));
                continue;
            }
            let late = std::mem::take(&mut forwarded);
            if self.outage.forwards {
                late.into_iter().for_each(|(odometry, truth)| self.receive(odometry, &truth, now_ns));
            }
            self.receive(odometry, &truth, now_ns);
        }
    }
}

#[test]
fn after_an_outage_of_any_length_the_estimate_is_where_the_robot_is_and_nothing_is_suspected() {
    for tenths in (2..=40).chain([50, 60]) {
        for watchdog_s in [0.3, 10.0] {
            for (forwards, steering_rad) in [(false, 0.0), (true, 0.0), (false, 0.04), (true, 0.04)] {
                let gap_s = 0.1 * f64::from(tenths) - 0.03;
                let outage = Outage { gap_s, watchdog_s, forwards, velocity_mps: 1.0, steering_rad };
                let mut drive = Loop::new(outage);
                drive.drive();
                assert_eq!(drive.pose.alarm, Alarm::None.wire(), "{outage:?}: {:?}", drive.pose);
                // It drives on, and knows where: the odometry is exact but for 1 % of the way, which is corrected.
                assert!(drive.error_m < 0.02, "{outage:?}: {} m", drive.error_m);
                assert!(drive.pose.speed_mps > 0.6, "{outage:?}: {:?}", drive.pose);
            }
        }
    }
}

#[test]
fn an_outage_of_a_robot_that_reverses_is_no_other() {
    for tenths in [2, 5, 9, 14, 30] {
        for (watchdog_s, forwards) in [(0.3, false), (0.3, true), (10.0, false), (10.0, true)] {
            let gap_s = 0.1 * f64::from(tenths) - 0.03;
            let outage = Outage { gap_s, watchdog_s, forwards, velocity_mps: -0.3, steering_rad: 0.04 };
            let mut drive = Loop::new(outage);
            drive.drive();
            assert_eq!(drive.pose.alarm, Alarm::None.wire(), "{outage:?}: {:?}", drive.pose);
            assert!(drive.error_m < 0.02, "{outage:?}: {} m", drive.error_m);
            assert!(drive.pose.speed_mps < -0.25, "{outage:?}: {:?}", drive.pose);
        }
    }
}

#[test]
fn the_covariance_has_what_the_robot_may_have_slid() {
    let ahead_m = |gap_s| {
        let mut drive = Loop::new(Outage {
            gap_s,
            watchdog_s: 0.3,
            forwards: false,
            velocity_mps: 1.0,
            steering_rad: 0.0,
        });
        drive.drive();
        drive.pose.covariance[4]
    };
    // From 1 m/s at 5 m/s^2: 0.1 m at most, of which 0.289 are the standard deviation. The rest is the drift of encoders,
    // of a way that the outage makes shorter.
    let grown = ahead_m(1.0) - ahead_m(0.0);
    assert!((grown / 0.0289_f64.powi(2) - 1.0).abs() < 0.1, "{grown}");
}
