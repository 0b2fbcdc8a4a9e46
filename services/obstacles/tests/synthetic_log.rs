//! A healthy scanner is never blind, stuck or contradictory: a log with the statistics of a real URG-04LX on a rover.
//!
//! The rover drives through two rooms with doors to a large hall, and turns on the spot. Half of the beams return
//! nothing, because a surface is dark or too far away. Periods, error codes and repeated scans are as recorded, too. The
//! first test asserts that the log has these statistics, the second that the detector passes it.

mod scene;

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector2;
use obstacles::{ObstacleDetector, ObstaclesConfig};
use scene::{Body, Robot, Scene, block};
use shared_types::{BEAMS, Header, Pose, Scan, ScanGeometry, WINDOW};

/// Speed [m/s], yaw rate [rad/s] and time [s] of each part of the way.
const COURSE: [[f64; 3]; 21] = [
    [0.0, 0.0, 3.0],
    [0.3, 0.0, 6.0],
    [0.65, 0.0, 9.0],
    // In the hall, with nothing ahead: a rest and a turn on the spot.
    [0.0, 0.0, 2.5],
    [0.0, 0.8, 1.9635],
    [0.5, 0.0, 8.0],
    [0.0, 0.8, 1.9635],
    // Through the second door.
    [0.5, 0.0, 6.5],
    [0.0, -1.0, FRAC_PI_2],
    [0.0, 0.0, 5.0],
    [0.0, -1.0, FRAC_PI_2],
    [0.0, 0.0, 2.0],
    [0.85, 0.0, 2.35],
    [0.0, 0.0, 1.2],
    [0.3, 0.0, 5.5],
    [0.0, -1.0, FRAC_PI_2],
    [0.5, 0.0, 8.0],
    [0.0, -0.4, 3.927],
    // Back through the first door.
    [0.45, 0.0, 7.0],
    [0.2, 0.3, 3.0],
    [0.0, 0.0, 2.0],
];
/// Where the way begins [m].
const START: (f64, f64) = (-2.0, -0.5);
/// What the odometry reports of ways and turns.
const ODOMETRY: (f64, f64) = (1.02, 0.94);
/// Times at which a scan comes late, with the next ones too early and repeated; the rover rests [s].
const HICCUPS_S: [f64; 2] = [19.0, 42.5];
/// Error codes and how many of 10,000 beams without a return carry them.
const CODES: [(u32, u32); 8] = [(0, 9_500), (7, 370), (6, 100), (10, 6), (8, 6), (15, 6), (2, 6), (1, 6)];

/// Surfaces that return something up to a distance [m].
struct Surfaces {
    scene: Scene,
    reach_m: f64,
}

/// One row of the log.
struct Row {
    scan: Scan,
    pose: Pose,
    rests: bool,
}

/// A wall from one point to another, 0.1 m thick.
fn wall(from: (f64, f64), to: (f64, f64)) -> Body {
    let (x, y) = ((from.0 + to.0) / 2.0, (from.1 + to.1) / 2.0);
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    block(x, y, dx.hypot(dy), 0.1, dy.atan2(dx))
}

/// Rooms to the left of x = 4 m, a hall to its right.
fn surfaces() -> [Surfaces; 3] {
    let bright = [
        // The wall between rooms and hall, with two doors.
        wall((4.0, -7.0), (4.0, -1.0)),
        wall((4.0, 0.0), (4.0, 3.0)),
        wall((4.0, 4.0), (4.0, 9.0)),
        // The rooms.
        wall((-3.0, -2.0), (1.6, -2.0)),
        wall((-3.0, 2.0), (4.0, 2.0)),
        wall((-3.0, 2.0), (-3.0, 6.0)),
        wall((-3.0, 6.0), (4.0, 6.0)),
        // The far side of the hall.
        wall((10.0, -1.4), (10.0, 5.5)),
        // Furniture.
        block(0.5, 1.2, 0.8, 0.5, 0.2),
        block(2.6, -1.5, 0.5, 0.5, 0.0),
        block(1.5, 5.2, 1.0, 0.4, -0.3),
        Body::Circle([6.9, 4.6].into(), 0.15),
        Body::Circle([7.2, -0.9].into(), 0.14),
    ];
    let grey = [wall((-3.0, -2.0), (-3.0, 2.0))];
    let dark =
        [wall((1.6, -2.0), (4.0, -2.0)), block(7.5, 1.0, 1.0, 0.6, 0.5), block(5.0, 7.5, 1.5, 0.4, 0.0)];
    let of = |bodies: &[Body], reach_m| Surfaces { scene: Scene::of(bodies), reach_m };
    [of(&bright, 5.6), of(&grey, 1.5), of(&dark, 0.0)]
}

/// The true motion at a time, and the one that the odometry reports: it integrates its own ways and turns.
fn motion_at(time_s: f64) -> [Robot; 2] {
    let mut robots = [Robot::at(START.0, START.1, 0.0); 2];
    let mut left_s = time_s;
    for [speed, yaw_rate, lasts_s] in COURSE {
        let step_s = lasts_s.min(left_s);
        let factors = [(1.0, 1.0), ODOMETRY];
        for (robot, (way, turn)) in robots.iter_mut().zip(factors) {
            (robot.speed, robot.yaw_rate) = (speed * way, yaw_rate * turn);
            let parts = (step_s / 0.02).ceil().max(1.0);
            for _ in 0..parts as usize {
                *robot = robot.after(step_s / parts);
            }
        }
        left_s -= step_s;
        if left_s <= 0.0 {
            break;
        }
    }
    robots
}

/// Time from each scan to the next [s].
fn periods(random: &mut Scene) -> Vec<f64> {
    let total_s: f64 = COURSE.iter().map(|[_, _, lasts_s]| lasts_s).sum();
    let (mut periods, mut now_s, mut hiccups) = (Vec::new(), 0.0, HICCUPS_S.iter().peekable());
    while now_s < total_s - 0.3 {
        let next = match hiccups.next_if(|at_s| now_s >= **at_s) {
            Some(_) => vec![0.255, 0.005, 0.023],
            None => vec![(0.098 + 0.02 * random.gauss()).clamp(0.056, 0.16)],
        };
        now_s += next.iter().sum::<f64>();
        periods.extend(next);
    }
    periods
}

fn code_of(uniform: f64) -> u32 {
    let mut left = (uniform * 10_000.0) as u32;
    for (code, share) in CODES {
        if left < share {
            return code;
        }
        left -= share;
    }
    0
}

/// What a sweep that begins at a place measures.
fn sweep(surfaces: &[Surfaces], random: &mut Scene, robot: &Robot, scan: &mut Scan) {
    for beam in 0..BEAMS {
        let seen = robot.after(scan.beam_time_s(beam));
        let angle = seen.yaw + ScanGeometry::URG_04LX.yaw_rad(beam);
        let (from, direction) = (Vector2::new(seen.x, seen.y), Vector2::new(angle.cos(), angle.sin()));
        let hits = surfaces.iter().filter_map(|surface| {
            surface.scene.cast(from, direction, 0.0).map(|range| (range, surface.reach_m))
        });
        let nearest = hits.min_by(|(one, _), (other, _)| one.total_cmp(other));
        // Weak returns are lost more often.
        let loss = nearest.map_or(0.0, |(range, _)| 0.01 + 0.1 * (range - 2.0).max(0.0));
        let (is_lost, noise) = (random.uniform() < loss, 0.01 * random.gauss());
        let code = code_of(random.uniform());
        scan.ranges_mm[beam] = match nearest {
            Some((range, reach_m)) if range < reach_m && !is_lost => {
                ((range + noise).max(0.02) * 1e3).round() as u32
            }
            _ => code,
        };
    }
}

fn log(seed: u64) -> Vec<Row> {
    let (surfaces, mut random) = (surfaces(), Scene::of(&[]).noisy(seed));
    let mut rows: Vec<Row> = Vec::new();
    let mut now_s = 0.0;
    for (index, period_s) in periods(&mut random).into_iter().enumerate() {
        now_s += period_s;
        let acquired_ns = (now_s * 1e9) as u64;
        let header = Header { scan_id: index as u64 + 1, acquired_ns, ..Header::default() };
        let mut scan =
            Scan { header, sweep_ns: 66_666_667, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        let [robot, reported] = motion_at(now_s);
        match rows.last() {
            // The scanner has not finished another sweep.
            Some(before) if period_s < 0.05 => scan.ranges_mm = before.scan.ranges_mm,
            _ => sweep(&surfaces, &mut random, &robot, &mut scan),
        }
        let pose = Pose {
            header,
            x_m: reported.x,
            y_m: reported.y,
            yaw_rad: reported.yaw,
            speed_mps: reported.speed,
            yaw_rate_radps: reported.yaw_rate,
            ..Pose::default()
        };
        rows.push(Row { scan, pose, rests: robot.speed == 0.0 && robot.yaw_rate == 0.0 });
    }
    rows
}

/// Value that a share of the sorted values is below.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The recording: 47 % of the window's beams carry a code, 9 % (p5), 51 % (median), 82 % (p95) and 97 % (largest) of one
/// scan, twelve scans in a row more than 90 %; periods of 5 to 255 ms, 98 ms in the median; four pairs of equal scans.
#[test]
fn the_log_has_the_statistics_of_the_recording() {
    let rows = log(1);
    let code_share = |row: &Row| {
        let codes = WINDOW.filter(|beam| row.scan.ranges_mm[*beam] < 20).count();
        codes as f64 / WINDOW.count() as f64
    };
    let shares: Vec<f64> = rows.iter().map(code_share).collect();
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    let longest = shares.split(|share| *share <= 0.9).map(<[f64]>::len).max().unwrap();
    let by_share = sorted(shares.iter().copied());
    let [low, median, high, largest] = [0.05, 0.5, 0.95, 1.0].map(|share| quantile(&by_share, share));
    assert!((0.44..0.50).contains(&mean), "{mean}");
    assert!(low < 0.12 && (0.45..0.57).contains(&median), "{low} {median}");
    assert!((0.78..0.9).contains(&high) && (0.96..0.98).contains(&largest), "{high} {largest}");
    assert!((12..16).contains(&longest), "{longest}");

    let stamps = rows
        .windows(2)
        .map(|pair| (pair[1].scan.header.acquired_ns - pair[0].scan.header.acquired_ns) as f64 * 1e-9);
    let periods = sorted(stamps);
    let [shortest, median, longest] = [0.0, 0.5, 1.0].map(|share| quantile(&periods, share));
    assert!((shortest - 0.005).abs() < 1e-6 && (longest - 0.255).abs() < 1e-6, "{shortest} {longest}");
    assert!((median - 0.098).abs() < 0.003, "{median}");

    let is_equal = |pair: &&[Row]| pair[0].scan.ranges_mm == pair[1].scan.ranges_mm;
    let equal: Vec<bool> = rows.windows(2).filter(is_equal).map(|pair| pair[1].rests).collect();
    assert_eq!(equal, [true; 4]);

    let codes: Vec<u32> =
        rows.iter().flat_map(|row| row.scan.ranges()).copied().filter(|range| *range < 20).collect();
    let share = |code: u32| codes.iter().filter(|found| **found == code).count() as f64 / codes.len() as f64;
    for (code, expected) in [(0, 0.95), (7, 0.037), (6, 0.01)] {
        assert!((share(code) - expected).abs() < 0.002, "{code}: {}", share(code));
    }
    let turns = rows.iter().filter(|row| row.pose.speed_mps == 0.0 && row.pose.yaw_rate_radps != 0.0).count();
    assert!(turns > 50, "{turns} scans on the spot");
}

#[test]
fn a_healthy_scanner_with_the_statistics_of_the_recording_is_never_blind_stuck_or_contradictory() {
    for seed in 1..=4 {
        let mut detector = ObstacleDetector::new(ObstaclesConfig::default()).unwrap();
        let (mut states, mut lowest) = ([0_usize; 5], 1.0_f64);
        for (index, row) in log(seed).iter().enumerate() {
            let health = detector.step(&row.scan, &row.pose).scanner;
            states[health.state().wire() as usize] += 1;
            lowest = lowest.min(health.returned_share);
            assert!(!health.state().is_stop(), "seed {seed}, scan {index}: {health}");
        }
        eprintln!("seed {seed}: {states:?}, at least {lowest:.2} of the predicted returns");
    }
}
