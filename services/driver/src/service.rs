//! The process of the driver: actuation in; scan and odometry out.
//!
//! It orders its guard to drive or to stop; the guard sends the commands. It blocks the wheels itself when no actuation
//! has come for two scan periods, when the run is stopped, and before it ends.

use std::rc::Rc;

use runtime::{CANDIDATE_VARIABLE, Input, Output, Process, Wheels, monotonic_ns};
use serde::Deserialize;
use shared_types::{Actuation, ActuationKind, DeviceState, Odometry, Phase, Role, Scan};
use vehicle::Description;

use crate::devices::Devices;
use crate::event::{ForeignRobot, RobotEvent, RobotSettings};
use crate::guard::Orders;
use crate::motion::{Motion, Ordered};
use crate::odometry::TrackedOdometry;
use crate::order::GuardOrder;
use crate::sensing::{MeasuredSweep, Sensing};

/// The dead man acts after this many periods without an actuation.
pub const TIMEOUT_PERIODS: u64 = 2;
/// Longest sleep of the process [ns]. A publisher in another language may not ring, so that the connection can't wake it.
const SLEEP_NS: u64 = 20_000_000;
/// A robot that was asked to end comes to rest within this time [ns].
const REST_NS: u64 = 700_000_000;
/// A slower robot rests [m/s]: real odometry has noise.
const RESTING_MPS: f64 = 0.01;
/// Limits of sent values are kept up to rounding.
const SLACK: f64 = 1e-9;
/// Scans whose mean period is compared with the rate of the system.
const RATE_SCANS: u64 = 20;
/// The mean period may differ from that of the system by this share.
const RATE_TOLERANCE: f64 = 0.05;

/// What the driver reads of the scenario: where the robot stands at the start.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default)]
struct Course {
    start: Start,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(default)]
struct Start {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

/// Runs a driver of a robot until it is asked to end. `connect` reads its settings and makes the first connection;
/// `name` is the implementation.
///
/// # Errors
/// Settings that are not allowed, no connection, and errors of the bus.
pub fn run<R: ForeignRobot>(
    name: &str,
    connect: impl FnOnce(&mut Process) -> anyhow::Result<(R, Orders, RobotSettings)>,
) -> anyhow::Result<()> {
    // It would stop the wheels that the other process drives.
    let is_alone = std::env::var_os(CANDIDATE_VARIABLE).is_none();
    anyhow::ensure!(
        is_alone,
        "the wheels have one driver: `{name}` can be neither swapped in nor run in shadow"
    );
    let mut process = Process::attach(Role::Robot)?;
    let mut driver = Driver::new(&mut process, connect)?;
    if !process.start()? {
        return Ok(());
    }
    anyhow::ensure!(
        !process.clock().is_simulated(),
        "the robot of `{name}` does not wait: there is no lock-step"
    );
    driver.pass_over();
    while process.wait(Some(driver.due_ns()))? {
        driver.turn(&mut process, false)?;
    }
    driver.come_to_rest(&mut process)
}

/// The driver with its ports.
struct Driver<R> {
    robot: R,
    settings: RobotSettings,
    vehicle: Description,
    period_ns: u64,
    actuations: Input<Actuation>,
    scans: Rc<Output<Scan>>,
    odometries: Rc<Output<Odometry>>,
    orders: Option<Orders>,
    sensing: Sensing,
    devices: Devices,
    tracked: TrackedOdometry,
    /// What was sent since the last scan.
    ordered: Ordered,
    /// Time of the first front beam [ns].
    first_ns: u64,
    scan: Scan,
    /// When the dead man acts; `None` while the wheels are blocked [ns].
    drives_until_ns: Option<u64>,
    /// Whether the block was logged.
    is_stopped: bool,
    /// So many dropped messages are logged next.
    next_logged: u64,
}

impl<R: ForeignRobot> Driver<R> {
    fn new(
        process: &mut Process,
        connect: impl FnOnce(&mut Process) -> anyhow::Result<(R, Orders, RobotSettings)>,
    ) -> anyhow::Result<Self> {
        let vehicle: Description = process.settings("vehicle")?;
        let Start { x_m, y_m, yaw_rad } = process.settings::<Course>("scenario")?.start;
        let period_ns = process.period_ns();
        let (actuations, scans, odometries) = (process.input()?, process.output()?, process.output()?);
        let (robot, orders, settings) = connect(process)?;
        process.report_wheels(Wheels::Blocked);
        let sweep_ns = (settings.sweep_s * 1e9) as u64;
        Ok(Self {
            vehicle,
            period_ns,
            actuations,
            scans,
            odometries,
            robot,
            settings,
            orders: Some(orders),
            sensing: Sensing::new(&settings, period_ns),
            devices: Devices::new(settings.has_scanner, monotonic_ns()),
            tracked: TrackedOdometry::new([x_m, y_m, yaw_rad]),
            ordered: Ordered::default(),
            first_ns: 0,
            scan: Scan {
                sweep_ns: sweep_ns.clamp(1, period_ns),
                period_ns,
                ..Scan::of(vehicle.scanner.geometry())
            },
            drives_until_ns: None,
            is_stopped: false,
            next_logged: 1,
        })
    }

    /// When the process has to wake at the latest [ns].
    fn due_ns(&self) -> u64 {
        let due = [self.drives_until_ns, self.sensing.due_ns()].into_iter().flatten();
        due.fold(monotonic_ns() + SLEEP_NS, u64::min)
    }

    /// Leaves out what was measured before the drive: it has waited.
    fn pass_over(&mut self) {
        while let Some(event) = self.robot.next() {
            let is_data = matches!(
                event,
                RobotEvent::State { .. } | RobotEvent::Sweep { .. } | RobotEvent::Scan { .. }
            );
            if !is_data {
                self.take(event);
            }
        }
    }

    /// Does all that is due, and blocks the wheels when they must not turn.
    fn turn(&mut self, process: &mut Process, ends: bool) -> anyhow::Result<()> {
        while let Some(event) = self.robot.next() {
            self.take(event);
            // Data that have waited are used in their order.
            self.publish(process)?;
        }
        self.publish(process)?;
        self.obey(process, ends || process.must_stop());
        process.report_wheels(self.wheels());
        self.log_dropped();
        let (state, reason) = self.devices.shown();
        process.report_device(state, reason);
        Ok(())
    }

    fn take(&mut self, event: RobotEvent) {
        match event {
            RobotEvent::Connected(orders) => {
                self.orders = Some(orders);
                self.sensing.restart();
                self.devices.set_base(DeviceState::Running, "", monotonic_ns());
            }
            RobotEvent::State { state, time_s, arrived_ns } => {
                if !self.sensing.state(&state, time_s, arrived_ns) {
                    tracing::warn!(?state, "a state of the base is not finite");
                }
            }
            RobotEvent::Scan { ranges_mm, is_missing, front_ns, sweep_ns, arrived_ns } => {
                self.scan.sweep_ns = sweep_ns.clamp(1, self.period_ns);
                self.sensing.sweep_at((ranges_mm, is_missing), front_ns, arrived_ns);
            }
            RobotEvent::Sweep { ranges_mm, time_s, sweep_ns, arrived_ns } => {
                if let Some(sweep_ns) = sweep_ns {
                    self.scan.sweep_ns = sweep_ns.clamp(1, self.period_ns);
                }
                self.sensing.sweep(ranges_mm, time_s, arrived_ns);
            }
            RobotEvent::Scanner(device) => self.devices.set_scanner(device),
            RobotEvent::Lost(lost) => self.lose(&lost),
        }
    }

    /// Logs how many messages were dropped, each time when they are twice as many.
    fn log_dropped(&mut self) {
        let dropped = self.sensing.dropped();
        if dropped >= self.next_logged {
            self.next_logged = 2 * dropped;
            tracing::warn!(dropped, "sweeps or states came late, or after newer ones, and were dropped");
        }
    }

    fn lose(&mut self, lost: &str) {
        self.devices.set_base(DeviceState::Fault, lost, monotonic_ns());
        // The first loss is news, further attempts are not.
        if self.orders.take().is_some() {
            tracing::error!(lost, "the connection is lost: the wheels are stopped");
        } else {
            tracing::debug!(lost, "no connection yet");
        }
        self.drives_until_ns = None;
        // Scans of another scanner have no pose now.
        self.sensing.restart();
    }

    /// Follows actuations and the dead man.
    fn obey(&mut self, process: &Process, must_stop: bool) {
        while let Some(actuation) = self.actuations.take() {
            let drives = !must_stop && process.is_in_charge();
            match ActuationKind::try_from(actuation.kind) {
                Ok(ActuationKind::Block) => self.block(),
                Ok(ActuationKind::Drive) if drives && self.is_possible(&actuation) => self.drive(&actuation),
                _ => {}
            }
        }
        if must_stop != self.is_stopped {
            self.is_stopped = must_stop;
            if must_stop {
                tracing::info!("the robot blocks its wheels");
                self.block();
            }
        }
        if self.drives_until_ns.is_some_and(|until_ns| monotonic_ns() >= until_ns) {
            tracing::warn!("no actuation for two periods: the robot blocks its wheels");
            self.block();
        }
    }

    /// Whether an actuation to drive is within the limits of sent values; NaN is not.
    fn is_possible(&self, actuation: &Actuation) -> bool {
        self.vehicle.bounds.allow_sent(actuation.sent_velocity_mps, actuation.sent_steering_rad, SLACK)
    }

    fn drive(&mut self, actuation: &Actuation) {
        let (velocity_mps, steering_rad) = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
        let numbers = self.settings.convention.sent(&self.vehicle.parameters(), velocity_mps, steering_rad);
        if self.give(GuardOrder::Drive(numbers)) {
            let curvature = self.vehicle.parameters().curvature_of(steering_rad);
            self.ordered.add(velocity_mps, velocity_mps * curvature);
            self.drives_until_ns = Some(monotonic_ns() + TIMEOUT_PERIODS * self.period_ns);
        }
    }

    fn block(&mut self) {
        self.give(GuardOrder::Stop);
        self.drives_until_ns = None;
    }

    fn give(&mut self, order: GuardOrder) -> bool {
        let Some(orders) = &self.orders else { return false };
        orders
            .give(order)
            .inspect_err(|error| tracing::warn!(%error, "the guard does not take orders"))
            .is_ok()
    }

    /// What the wheels do.
    fn wheels(&self) -> Wheels {
        let rests = self.sensing.newest().is_some_and(|motion| motion.speed_mps.abs() < RESTING_MPS);
        match (self.drives_until_ns.is_some(), rests) {
            (true, _) => Wheels::Turning,
            (false, false) => Wheels::Blocked,
            (false, true) => Wheels::Resting,
        }
    }

    /// Before this process ends: blocks the wheels and waits until the robot rests.
    fn come_to_rest(&mut self, process: &mut Process) -> anyhow::Result<()> {
        let until_ns = monotonic_ns() + REST_NS;
        loop {
            self.turn(process, true)?;
            if self.wheels() == Wheels::Resting || self.orders.is_none() {
                return Ok(());
            }
            if monotonic_ns() >= until_ns {
                tracing::error!("the robot does not come to rest");
                return Ok(());
            }
            process.wait(Some(self.due_ns()))?;
        }
    }

    /// Publishes the sweep that is ready, with its odometry.
    fn publish(&mut self, process: &mut Process) -> anyhow::Result<()> {
        let Some(measured) = self.sensing.next(monotonic_ns()) else { return Ok(()) };
        if process.directive().phase != Phase::Driving.wire() {
            return Ok(());
        }
        process.begin();
        let mut odometry = self.odometry(&measured.motion);
        self.scan.header = odometry.header;
        let ranges_mm = self.scan.ranges_mut();
        ranges_mm.copy_from_slice(&measured.ranges_mm[..ranges_mm.len()]);
        self.scan.missing = measured.is_missing.into();
        self.scans.publish(&mut self.scan)?;
        self.odometries.publish(&mut odometry)?;
        self.compare_rate(odometry.header.scan_id, &measured);
        Ok(())
    }

    /// The odometry of the next scan, on the track.
    fn odometry(&mut self, motion: &Motion) -> Odometry {
        let (odometry, jump) = self.tracked.next(motion, std::mem::take(&mut self.ordered));
        if let Some([from, to]) = jump {
            tracing::warn!(?from, ?to, "the odometry has jumped: the robot is taken to be where it was");
        }
        odometry
    }

    /// Warns once when the scanner has another rate than the system.
    fn compare_rate(&mut self, scan_id: u64, measured: &MeasuredSweep) {
        if scan_id == 1 {
            self.first_ns = measured.motion.time_ns;
        }
        if scan_id == RATE_SCANS {
            let mean_ns = (measured.motion.time_ns - self.first_ns) as f64 / (RATE_SCANS - 1) as f64;
            let period_ns = self.period_ns as f64;
            if (mean_ns - period_ns).abs() > RATE_TOLERANCE * period_ns {
                let (scanner_hz, rate_hz) = (1e9 / mean_ns, 1e9 / period_ns);
                tracing::warn!(
                    scanner_hz,
                    rate_hz,
                    "the scanner has another rate than the system: set `rate_hz`"
                );
            }
        }
    }
}
