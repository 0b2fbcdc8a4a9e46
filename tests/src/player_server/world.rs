//! The robot behind the server, and what stands around it.

use emulator::steering_map::SteeringMap;
use emulator::{Emulator, Scenario};
use runtime::monotonic_ns;
use shared_types::{Actuation, ActuationKind, BEAMS, MIN_RANGE_MM, Odometry, Scan, Truth};

/// Time stamp of the first moment [s]: a server has run for a while when its first client comes.
const FIRST_S: f64 = 3.7;
/// The last command is repeated this often, so that the emulated robot's own dead man never acts [ns].
const REPEAT_NS: u64 = 40_000_000;
/// Range that stands for "nothing was hit" [m].
pub(super) const MAX_RANGE_M: f64 = 5.6;

/// What a server receives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReceivedCommand {
    /// A command to drive: velocity and steering angle [m/s, rad].
    Drive(f64, f64),
    /// A command to stop.
    Stop,
    /// The last client has closed the base, and the server has stopped it.
    Closed,
}

/// Data of one sweep.
#[derive(Debug)]
pub(super) struct Data {
    pub(super) time_s: f64,
    pub(super) pose: [f64; 3],
    pub(super) velocity: [f64; 3],
    pub(super) ranges_m: Vec<f64>,
}

#[derive(Debug)]
pub(super) struct World {
    emulator: Emulator,
    origin_ns: u64,
    next_scan: u64,
    command: Actuation,
    commanded_ns: u64,
    /// The robot blocks its wheels after this time without a command [ns].
    pub(super) watchdog_ns: Option<u64>,
    /// When the last command came [ns].
    commanded_last_ns: u64,
    pub(super) truth: Truth,
    pub(super) received: Vec<(u64, ReceivedCommand)>,
    /// Whether a client has the base open.
    pub(super) is_open: bool,
    was_open: bool,
}

impl World {
    pub(super) fn new(scenario: &Scenario, period_ns: u64) -> Self {
        let mut scenario = scenario.clone();
        // What the server's own calibration would undo.
        scenario.robot.velocity_factor = Some(1.0);
        scenario.robot.steering_map = Some(SteeringMap::Identity);
        scenario.robot.odometry_longitudinal = Some(0.0);
        Self {
            emulator: Emulator::new(&scenario, period_ns),
            origin_ns: monotonic_ns(),
            next_scan: 1,
            command: Actuation::default(),
            commanded_ns: 0,
            watchdog_ns: None,
            commanded_last_ns: 0,
            truth: Truth::default(),
            received: Vec::new(),
            is_open: false,
            was_open: false,
        }
    }

    pub(super) fn time_s(&self) -> f64 {
        FIRST_S + (monotonic_ns() - self.origin_ns) as f64 * 1e-9
    }

    /// Time of the first front beam [ns].
    pub(super) fn front_ns(&self) -> u64 {
        self.origin_ns + self.emulator.acquired_ns(1)
    }

    pub(super) fn speed_mps(&self) -> f64 {
        self.emulator.plant().speed()
    }

    /// Follows a command with a velocity and the steering angle of a car with half the axle distance.
    pub(super) fn command(&mut self, velocity_mps: f64, steering_rad: f64) {
        let stops = velocity_mps == 0.0;
        self.commanded_last_ns = monotonic_ns();
        self.received.push((
            monotonic_ns(),
            if stops { ReceivedCommand::Stop } else { ReceivedCommand::Drive(velocity_mps, steering_rad) },
        ));
        let kind = if stops { ActuationKind::Block } else { ActuationKind::Drive };
        self.command = Actuation {
            kind: kind.wire(),
            sent_velocity_mps: velocity_mps,
            sent_steering_rad: steering_rad,
            ..Actuation::default()
        };
        self.emulator.actuate(&self.command);
    }

    /// Lets time pass; the data of the sweep that has ended, if one has.
    pub(super) fn advance(&mut self, now_ns: u64) -> Option<Data> {
        if self.was_open && !self.is_open {
            self.command(0.0, 0.0);
            self.received.push((now_ns, ReceivedCommand::Closed));
        }
        self.was_open = self.is_open;
        let drives = self.command.kind == ActuationKind::Drive.wire();
        if drives && self.watchdog_ns.is_some_and(|after_ns| now_ns > self.commanded_last_ns + after_ns) {
            self.command(0.0, 0.0);
        }
        let elapsed_ns = now_ns - self.origin_ns;
        self.emulator.advance_to(elapsed_ns);
        if elapsed_ns >= self.commanded_ns + REPEAT_NS {
            self.commanded_ns = elapsed_ns;
            self.emulator.actuate(&self.command);
        }
        (elapsed_ns >= self.emulator.scan_ready_ns(self.next_scan)).then(|| self.measure())
    }

    fn measure(&mut self) -> Data {
        let (mut scan, mut odometry) = (Scan::default(), Odometry::default());
        self.emulator.measure(self.next_scan, &mut scan, &mut odometry, &mut self.truth);
        let stamp_ns = self.emulator.stamp_ns(self.next_scan);
        self.next_scan += 1;
        let range = |beam: usize| {
            let range_mm = scan.ranges_mm[beam];
            if range_mm < MIN_RANGE_MM { MAX_RANGE_M } else { f64::from(range_mm) * 1e-3 }
        };
        Data {
            time_s: FIRST_S + stamp_ns as f64 * 1e-9,
            pose: [odometry.x_m, odometry.y_m, odometry.yaw_rad],
            velocity: [odometry.speed_mps, 0.0, self.truth.yaw_rate_radps],
            ranges_m: (0..BEAMS).map(range).collect(),
        }
    }
}
