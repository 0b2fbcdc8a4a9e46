//! The samples of a robot, received and reduced to what the checks need.

use std::collections::VecDeque;

use runtime::{Bus, Observer, RuntimeError};
use shared_types::{Obstacles, Odometry, Scan, ScannerHealth};
use vehicle::Description;

/// Observers of scan, odometry and obstacles.
pub(super) struct Feed {
    scans: Observer<Scan>,
    odometries: Observer<Odometry>,
    obstacles: Observer<Obstacles>,
    /// All that came.
    pub(super) observed: Observed,
    /// The newest odometry.
    pub(super) newest: Option<Odometry>,
    /// The newest scans with ranges, the newest last.
    pub(super) scans_seen: VecDeque<Scan>,
    /// How the scanner is turned on the body [rad].
    scanner_yaw_rad: f64,
}

/// Scans that are kept: a leg of the drive at 40 Hz.
const MAX_SCANS: usize = 256;

/// Free width that is wanted to each side of the body [m].
const SIDE_M: f64 = 0.2;

/// What came so far.
#[derive(Debug, Default)]
pub(super) struct Observed {
    /// One entry per scan.
    pub(super) sweeps: Vec<Sweep>,
    /// Number of odometry samples.
    pub(super) odometries: usize,
    /// Samples with impossible content.
    pub(super) invalid: u64,
    /// The newest state of the scanner.
    pub(super) health: Option<ScannerHealth>,
    /// Distance and turn by the odometry.
    pub(super) way: Vec<Point>,
}

/// What is kept of a scan.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sweep {
    /// Time of the front beam [ns].
    pub(super) acquired_ns: u64,
    /// When it was published [ns].
    pub(super) published_ns: u64,
    /// Share of the beams ahead of the body with a return; `None` for a scan without ranges.
    pub(super) returns: Option<f64>,
}

/// Where the robot is by its odometry.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Point {
    /// Time of the front beam [ns].
    pub(super) at_ns: u64,
    /// Distance driven ahead, backwards negative [m].
    pub(super) ahead_m: f64,
    /// Angle turned, to the left positive [rad].
    pub(super) left_rad: f64,
}

impl Feed {
    /// Observes from now on.
    pub(super) fn open(bus: &Bus, vehicle: &Description) -> Result<Self, RuntimeError> {
        Ok(Self {
            scans: Observer::new(bus)?,
            odometries: Observer::new(bus)?,
            obstacles: Observer::new(bus)?,
            observed: Observed::default(),
            newest: None,
            scans_seen: VecDeque::with_capacity(MAX_SCANS),
            scanner_yaw_rad: vehicle.scanner_yaw_rad,
        })
    }

    /// Makes this end of all connections.
    pub(super) fn connect(&self) {
        self.scans.connect();
        self.odometries.connect();
        self.obstacles.connect();
    }

    /// The newest scan with ranges.
    pub(super) fn newest_scan(&self) -> Option<&Scan> {
        self.scans_seen.back()
    }

    /// Takes all that came; returns whether odometry did.
    pub(super) fn poll(&mut self) -> Result<bool, RuntimeError> {
        let Observed { sweeps, odometries, invalid, health, way } = &mut self.observed;
        let before = *odometries;
        *invalid += self.scans.poll(|scan| {
            sweeps.push(Sweep::of(scan, self.scanner_yaw_rad));
            if !scan.missing.is_set() {
                if self.scans_seen.len() == MAX_SCANS {
                    self.scans_seen.pop_front();
                }
                self.scans_seen.push_back(*scan);
            }
        })?;
        *invalid += self.odometries.poll(|odometry| {
            *odometries += 1;
            way.push(way.last().copied().unwrap_or_default().next(odometry));
            self.newest = Some(*odometry);
        })?;
        *invalid += self.obstacles.poll(|obstacles| *health = Some(obstacles.scanner))?;
        Ok(*odometries > before)
    }
}

impl Sweep {
    fn of(scan: &Scan, scanner_yaw_rad: f64) -> Self {
        let (acquired_ns, published_ns) = (scan.header.acquired_ns, scan.header.scan_published_ns());
        let ahead = || beams_ahead(scan, scanner_yaw_rad);
        let returned = ahead().filter(|(beam, _)| scan.range_m(*beam).is_some()).count();
        let share = returned as f64 / ahead().count().max(1) as f64;
        Self { acquired_ns, published_ns, returns: (!scan.missing.is_set()).then_some(share) }
    }
}

impl Point {
    /// The next point: the increment counts in the direction of the body halfway.
    fn next(self, odometry: &Odometry) -> Self {
        let Odometry { dx_m, dy_m, dyaw_rad, yaw_rad, .. } = *odometry;
        let (sin, cos) = (yaw_rad - dyaw_rad / 2.0).sin_cos();
        Self {
            at_ns: odometry.header.acquired_ns,
            ahead_m: self.ahead_m + dx_m * cos + dy_m * sin,
            left_rad: self.left_rad + wrapped(dyaw_rad),
        }
    }
}

/// An angle in (-pi, pi]: increments of the reported yaw may jump by a turn.
fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

/// Whether a beam looks up to 60 degrees to either side of the body's front, wherever the scanner is turned.
pub(super) fn is_ahead(scan: &Scan, beam: usize, scanner_yaw_rad: f64) -> bool {
    (scan.beam_yaw_rad(beam) + scanner_yaw_rad).cos() >= 0.5
}

/// Those beams, with their yaw on the body [rad].
fn beams_ahead(scan: &Scan, scanner_yaw_rad: f64) -> impl Iterator<Item = (usize, f64)> {
    let beams = (0..scan.ranges().len()).filter(move |beam| is_ahead(scan, *beam, scanner_yaw_rad));
    beams.map(move |beam| (beam, scan.beam_yaw_rad(beam) + scanner_yaw_rad))
}

/// Distance from the front of the body to the nearest return in its way [m]; infinite when there is none.
pub(super) fn free_ahead_m(scan: &Scan, vehicle: &Description) -> f64 {
    let half_m = vehicle.width_m / 2.0 + SIDE_M;
    let returns = beams_ahead(scan, vehicle.scanner_yaw_rad).filter_map(|(beam, yaw_rad)| {
        let range_m = scan.range_m(beam)?;
        let (x_m, y_m) = (range_m * yaw_rad.cos(), range_m * yaw_rad.sin());
        let (x_m, y_m) = (vehicle.scanner_x_m + x_m, vehicle.scanner_y_m + y_m);
        (y_m.abs() <= half_m).then_some(x_m - vehicle.nose_m())
    });
    returns.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{FRONT_BEAM, ScanGeometry, WINDOW};

    #[test]
    fn distance_ahead_is_counted_along_the_body() {
        let east = Odometry { dx_m: 0.5, ..Odometry::default() };
        let north = Odometry { dy_m: -0.2, yaw_rad: std::f64::consts::FRAC_PI_2, ..Odometry::default() };
        let end = Point::default().next(&east).next(&north);
        assert!((end.ahead_m - 0.3).abs() < 1e-12, "{end:?}");
        let jump = Odometry { dyaw_rad: 0.1 - std::f64::consts::TAU, ..Odometry::default() };
        assert!((Point::default().next(&jump).left_rad - 0.1).abs() < 1e-12);
    }

    #[test]
    fn only_returns_in_the_way_of_the_body_count() {
        let vehicle = Description::default();
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        assert_eq!(free_ahead_m(&scan, &vehicle), f64::INFINITY);
        // 59.8 degrees to the right at 2 m: beside the way.
        scan.ranges_mm[*WINDOW.start()] = 2000;
        assert_eq!(free_ahead_m(&scan, &vehicle), f64::INFINITY);
        scan.ranges_mm[FRONT_BEAM] = 1280;
        assert!((free_ahead_m(&scan, &vehicle) - 1.0).abs() < 1e-12);
        // A quarter of a turn to the left: its first beams look ahead, its front beam to the side.
        let turned = Description { scanner_yaw_rad: std::f64::consts::FRAC_PI_2, ..vehicle };
        assert_eq!(free_ahead_m(&scan, &turned), f64::INFINITY);
        scan.ranges_mm[FRONT_BEAM - 256] = 1280;
        assert!((free_ahead_m(&scan, &turned) - 1.0).abs() < 1e-12);
        scan.ranges_mm.fill(0);
        scan.ranges_mm[..FRONT_BEAM - 256].fill(1000);
        let returns = |vehicle: &Description| Sweep::of(&scan, vehicle.scanner_yaw_rad).returns.unwrap();
        assert!(
            returns(&vehicle) < 0.01 && returns(&turned) > 0.3,
            "{} {}",
            returns(&vehicle),
            returns(&turned)
        );
    }
}
