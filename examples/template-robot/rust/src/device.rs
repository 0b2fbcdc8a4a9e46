//! The robot. **Replace the three functions `read_odometry`, `read_scan` and `write_wheels` by those of yours.**
//!
//! None of them may wait. As shipped they belong to a simulation with the faults of real devices: base and scanner have
//! one clock of their own, which restarts every 2 s, data arrive up to 3 ms late, and one sweep in 23 breaks off half-way.

use std::f64::consts::TAU;

use shared_types::{BEAMS, ScanGeometry};

use crate::odometry::Pose;

/// What the scanner has measured.
#[derive(Debug, Clone)]
pub(crate) struct Sweep {
    /// When the front beam was taken [ns].
    pub(crate) stamp_ns: u64,
    /// How many beams have come; less than [`BEAMS`] when the sweep broke off.
    pub(crate) beams: usize,
    /// Range per beam, counter-clockwise from the right; below 20 is no return [mm].
    pub(crate) ranges_mm: [u32; BEAMS],
}

impl Device {
    /// The newest state of the base that was not read before, with its stamp [ns].
    pub(crate) fn read_odometry(&mut self, now_ns: u64) -> Option<(u64, Pose)> {
        self.advance_to(now_ns);
        self.base
            .take_if(|(arrives_ns, ..)| *arrives_ns <= now_ns)
            .map(|(_, stamp_ns, pose)| (stamp_ns, pose))
    }

    /// The newest sweep that was not read before, complete or broken off.
    pub(crate) fn read_scan(&mut self, now_ns: u64) -> Option<Sweep> {
        self.advance_to(now_ns);
        self.scan.take_if(|(arrives_ns, _)| *arrives_ns <= now_ns).map(|(_, sweep)| sweep)
    }

    /// Drives with velocity [m/s] and steering angle [rad], or blocks the wheels. Called also when nothing changes.
    pub(crate) fn write_wheels(&mut self, now_ns: u64, drive: Option<(f64, f64)>) {
        self.advance_to(now_ns);
        self.drive = drive;
    }

    /// Whether base and scanner stamp with the same clock; `false` where the scanner has one of its own.
    pub(crate) fn has_one_clock(&self) -> bool {
        true
    }

    /// Shortest time from the stamp of a state of the base to its arrival [ns].
    pub(crate) fn base_delay_ns(&self) -> u64 {
        0
    }

    /// Shortest time from the front beam to the arrival of a sweep: half of the sweep, plus its way [ns].
    pub(crate) fn scan_delay_ns(&self) -> u64 {
        self.period_ns / 3
    }
}

/// Time of a step of the simulation [ns].
const STEP_NS: u64 = 1_000_000;
/// The base sends a state this often [ns].
const BASE_NS: u64 = 20_000_000;
/// Base and scanner restart this often [ns].
const RESTART_NS: u64 = 2_000_000_000;
/// Data arrive this much late at most [ns].
const LATE_NS: u64 = 3_000_000;
/// One sweep in this many breaks off.
const BROKEN: u64 = 23;
/// Distances of the walls from the start: behind, ahead, and to either side [m].
const WALLS_M: [f64; 3] = [3.0, 40.0, 3.5];
/// Ranges beyond this have no return [m].
const FAR_M: f64 = 5.6;
/// The robot drives this much slower than it is told.
const VELOCITY_FACTOR: f64 = 1.4;
/// Curvature of the path per steering angle [1/(m rad)].
const CURVATURE: f64 = 5.405;

/// A robot in a hall.
pub(crate) struct Device {
    period_ns: u64,
    now_ns: u64,
    started_ns: u64,
    sweeps: u64,
    drive: Option<(f64, f64)>,
    pose: Pose,
    /// Where the base was when it started.
    origin: Pose,
    /// With time of arrival and stamp.
    base: Option<(u64, u64, Pose)>,
    scan: Option<(u64, Sweep)>,
    random: u64,
}

impl Device {
    /// A robot at rest; `period_ns` is the time between two sweeps.
    pub(crate) fn open(now_ns: u64, period_ns: u64) -> Self {
        let (pose, origin) = (Pose::default(), Pose::default());
        let (drive, base, scan) = (None, None, None);
        Self { period_ns, now_ns, started_ns: now_ns, sweeps: 0, drive, pose, origin, base, scan, random: 1 }
    }

    fn advance_to(&mut self, now_ns: u64) {
        while self.now_ns + STEP_NS <= now_ns {
            self.now_ns += STEP_NS;
            self.step();
        }
    }

    fn step(&mut self) {
        self.roll(STEP_NS as f64 * 1e-9);
        let (run_ns, late_ns) = (self.now_ns - self.started_ns, self.random(LATE_NS));
        // A clock of its own, 100 ppm fast, that begins again at zero.
        let stamp_ns = (run_ns % RESTART_NS) + (run_ns % RESTART_NS) / 10_000;
        if run_ns.is_multiple_of(RESTART_NS) {
            self.origin = self.pose;
        }
        if run_ns.is_multiple_of(BASE_NS) {
            self.base = Some((self.now_ns + late_ns, stamp_ns, self.pose.seen_from(self.origin)));
        }
        if run_ns / self.period_ns > self.sweeps {
            self.sweeps = run_ns / self.period_ns;
            let beams = if self.sweeps.is_multiple_of(BROKEN) { BEAMS / 2 } else { BEAMS };
            let sweep = Sweep { stamp_ns, beams, ranges_mm: self.measure() };
            self.scan = Some((self.now_ns + self.period_ns / 3 + late_ns, sweep));
        }
    }

    /// Moves the robot. Blocked wheels decelerate at 5 m/s^2, the drive changes speed by 2 m/s^2.
    fn roll(&mut self, dt_s: f64) {
        let (velocity, steering) = self.drive.unwrap_or_default();
        let wanted_mps = velocity / VELOCITY_FACTOR;
        let most = dt_s * if self.drive.is_some() { 2.0 } else { 5.0 };
        let Pose { x_m, y_m, yaw_rad, speed_mps } = &mut self.pose;
        *speed_mps += (wanted_mps - *speed_mps).clamp(-most, most);
        *yaw_rad += CURVATURE * steering * *speed_mps * dt_s;
        *x_m += *speed_mps * yaw_rad.cos() * dt_s;
        *y_m += *speed_mps * yaw_rad.sin() * dt_s;
    }

    /// Distances to the walls, with an error of up to a centimetre.
    fn measure(&mut self) -> [u32; BEAMS] {
        let Pose { x_m, y_m, yaw_rad, .. } = self.pose;
        std::array::from_fn(|beam| {
            let (sin, cos) = (yaw_rad + ScanGeometry::URG_04LX.yaw_rad(beam)).sin_cos();
            let along = if cos > 0.0 { (WALLS_M[1] - x_m) / cos } else { (WALLS_M[0] + x_m) / -cos };
            let across = if sin > 0.0 { (WALLS_M[2] - y_m) / sin } else { (WALLS_M[2] + y_m) / -sin };
            let range_m = along.min(across);
            let noise_mm = self.random(20) as f64 - 10.0;
            if range_m < FAR_M { (range_m * 1e3 + noise_mm) as u32 } else { 0 }
        })
    }

    /// A number below `limit`.
    fn random(&mut self, limit: u64) -> u64 {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 33) % limit
    }
}

impl Pose {
    /// `self` as a base reports it that started at `origin`.
    fn seen_from(self, origin: Pose) -> Self {
        let (sin, cos) = origin.yaw_rad.sin_cos();
        let (x, y) = (self.x_m - origin.x_m, self.y_m - origin.y_m);
        let yaw_rad = (self.yaw_rad - origin.yaw_rad).rem_euclid(TAU);
        Self { x_m: cos * x + sin * y, y_m: cos * y - sin * x, yaw_rad, speed_mps: self.speed_mps }
    }
}
