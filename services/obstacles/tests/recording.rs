//! A real URG-04LX on a real rover is never taken for blind, stuck or contradictory.
//!
//! The recording is not part of the project: the test uses it where it lies beside the checkout, and tells when not.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::PI;
use std::io::Write;

use obstacles::{ObstacleDetector, ObstaclesConfig};
use shared_types::{BEAMS, Header, Pose, Scan, ScanGeometry};
use vehicle::Description;

/// Where the recording is expected, from the folder of this crate.
const FILE: &str = "../../../shared/recordings/urg-rover.dat";

/// Way of a wheel for its ticks [m].
fn wheel_m(ticks: f64) -> f64 {
    ticks * 180.0 / 2000.0 * PI / 180.0 * 0.077
}

struct Row {
    time_ns: u64,
    ticks: [f64; 2],
    ranges_mm: [u32; BEAMS],
}

fn rows(text: &str) -> Vec<Row> {
    let row = |line: &str| {
        let columns: Vec<f64> = line.split_ascii_whitespace().map(|column| column.parse().unwrap()).collect();
        let mut ranges_mm = [0; BEAMS];
        for (range, column) in ranges_mm.iter_mut().zip(&columns[24..24 + BEAMS]) {
            *range = *column as u32;
        }
        Row { time_ns: (columns[0] * 1e3) as u64, ticks: [columns[2], columns[3]], ranges_mm }
    };
    text.lines().filter(|line| !line.trim().is_empty()).map(row).collect()
}

/// Says that a test was skipped, on the standard error of the program: that of a test that passes is not shown.
fn skipped(test: &str) {
    let mut stderr = std::io::stderr();
    writeln!(stderr, "skipped: {test}: {FILE} is not there").unwrap();
}

#[test]
fn the_recorded_scanner_is_never_blind_stuck_or_contradictory() {
    let Ok(text) = std::fs::read_to_string(FILE) else {
        skipped("the_recorded_scanner_is_never_blind_stuck_or_contradictory");
        return;
    };
    let rows = rows(&text);
    assert_eq!(rows.len(), 756);
    // The published kinematics, and those that fit the ranges: the wheels turn 1.9 times as far.
    for factor in [1.0, 1.9] {
        drive(&rows, factor);
    }
}

/// Drives along the recording with the way of the wheels multiplied by `factor`.
fn drive(rows: &[Row], factor: f64) {
    let vehicle = Description { scanner_x_m: 0.145, ..Description::default() };
    let mut detector =
        ObstacleDetector::new(ObstaclesConfig { vehicle, ..ObstaclesConfig::default() }).unwrap();
    let mut pose = Pose::default();
    let mut states = [0_usize; 5];
    let mut stops = 0;
    for (index, row) in rows.iter().enumerate() {
        if index > 0 {
            let before = &rows[index - 1];
            let elapsed = (row.time_ns - before.time_ns) as f64 * 1e-9;
            let [left, right] = [0, 1].map(|side| factor * wheel_m(row.ticks[side] - before.ticks[side]));
            let (way, turn) = ((left + right) / 2.0, (right - left) / 0.33);
            let course = pose.yaw_rad + turn / 2.0;
            pose.x_m += way * course.cos();
            pose.y_m += way * course.sin();
            pose.yaw_rad += turn;
            (pose.speed_mps, pose.yaw_rate_radps) = (way / elapsed, turn / elapsed);
        }
        let header = Header { scan_id: index as u64 + 1, acquired_ns: row.time_ns, ..Header::default() };
        let mut scan =
            Scan { header, sweep_ns: 66_666_667, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        scan.ranges_mut().copy_from_slice(&row.ranges_mm);
        pose.header = header;
        let health = detector.step(&scan, &pose).scanner;
        let state = health.state();
        states[state.wire() as usize] += 1;
        stops += usize::from(health.seen_ahead_m < 0.5);
        assert!(!state.is_stop(), "factor {factor}, scan {index}: {state}, {health:?}");
    }
    eprintln!("factor {factor}: {states:?}, {stops} scans with less than half a metre of sight");
}
