//! Draws how the evidence of the obstacle detector judges a scanner, over time, as an SVG file on standard output.
//!
//! ```text
//! cargo run -p scanloop --example scanner_health -- SCENARIO [KEY=VALUE]... >picture.svg
//! cargo run -p scanloop --example scanner_health -- recording FILE >picture.svg
//! ```
//!
//! The first form drives a scenario in one process; `KEY=VALUE` is that of `scanloop run --set`. The second form reads
//! a log of the CoreSLAM format and moves the robot by its wheel ticks.

use anyhow::Context;
use calibration::FitChart;
use console::note;
use obstacles::{ObstacleDetector, ObstaclesConfig};
use pipeline::{PipelineSettings, drive};
use plan::{Choice, Plan};
use report::picture::panels;
use shared_types::{BEAMS, Header, Pose, Scan, ScanGeometry, ScannerHealth, ScannerState};
use vehicle::Description;

/// Half of the distance between the wheels of the recorded rover, and radius of its wheels [m].
const ROVER: (f64, f64) = (0.165, 0.077);
/// Angle of a wheel per tick [rad].
const TICK_RAD: f64 = std::f64::consts::PI / 2000.0;
/// Place of the recorded scanner ahead of the axle [m].
const ROVER_SCANNER_M: f64 = 0.145;
/// Column of the first range of a log.
const FIRST_RANGE: usize = 24;

/// Time [s] and health of each scan.
type Health = Vec<(f64, ScannerHealth)>;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let health = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["recording", file] => recorded(&std::fs::read_to_string(file).context(file.to_owned())?)?,
        [scenario, ..] => driven(scenario, &arguments[1..])?,
        [] => anyhow::bail!("usage: scanner_health SCENARIO [KEY=VALUE]... | recording FILE"),
    };
    summarise(&health);
    console::output::data(&panels::draw(&charts(&health))?)?;
    Ok(())
}

/// The health over a drive of a scenario.
fn driven(scenario: &str, overrides: &[String]) -> anyhow::Result<Health> {
    let choice = Choice { overrides: overrides.to_vec(), ..Choice::default() };
    let Plan { scenario, system, .. } = Plan::read(Some(scenario), &choice)?;
    let settings = PipelineSettings { scenario, tuning: system.tuning(), period_ns: system.period_ns() };
    let mut health = Vec::new();
    let end = drive(&settings, |step| {
        health.extend(step.obstacles.map(|obstacles| (step.truth.time_s, obstacles.scanner)));
    })?;
    note!("{}: {}", end.outcome, end.reason);
    Ok(health)
}

/// The health over a log of the rover.
fn recorded(text: &str) -> anyhow::Result<Health> {
    let vehicle = Description { scanner_x_m: ROVER_SCANNER_M, ..Description::default() };
    let mut detector = ObstacleDetector::new(ObstaclesConfig { vehicle, ..ObstaclesConfig::default() })?;
    let mut pose = Pose::default();
    let (mut health, mut before, mut begin_ns) = (Health::new(), None, 0);
    for (line, scan_id) in text.lines().filter(|line| !line.trim().is_empty()).zip(1..) {
        let columns: Vec<f64> = line
            .split_ascii_whitespace()
            .map(str::parse)
            .collect::<Result<_, _>>()
            .with_context(|| format!("line {scan_id}"))?;
        anyhow::ensure!(columns.len() >= FIRST_RANGE + BEAMS, "line {scan_id} has {} columns", columns.len());
        let header = Header { scan_id, acquired_ns: (columns[0] * 1e3) as u64, ..Header::default() };
        let mut scan =
            Scan { header, sweep_ns: 66_666_667, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        for (range, column) in scan.ranges_mm.iter_mut().zip(&columns[FIRST_RANGE..]) {
            *range = *column as u32;
        }
        let wheels = [columns[2], columns[3]].map(|ticks| ticks * TICK_RAD * ROVER.1);
        if let Some((last, at_ns)) = before.replace((wheels, header.acquired_ns)) {
            advance(
                &mut pose,
                [wheels[0] - last[0], wheels[1] - last[1]],
                (header.acquired_ns - at_ns) as f64 * 1e-9,
            );
        } else {
            begin_ns = header.acquired_ns;
        }
        pose.header = header;
        health.push(((header.acquired_ns - begin_ns) as f64 * 1e-9, detector.step(&scan, &pose).scanner));
    }
    Ok(health)
}

/// Moves the rover by the ways of its left and right wheel.
fn advance(pose: &mut Pose, [left, right]: [f64; 2], elapsed_s: f64) {
    let (way, turn) = ((left + right) / 2.0, (right - left) / (2.0 * ROVER.0));
    let course = pose.yaw_rad + turn / 2.0;
    pose.x_m += way * course.cos();
    pose.y_m += way * course.sin();
    pose.yaw_rad += turn;
    (pose.speed_mps, pose.yaw_rate_radps) = (way / elapsed_s, turn / elapsed_s);
}

/// Prints the scans in each state.
fn summarise(health: &Health) {
    let count = |state: ScannerState| health.iter().filter(|(_, health)| health.state() == state).count();
    let counts: Vec<String> =
        ScannerState::ALL.iter().map(|state| format!("{} {state}", count(*state))).collect();
    note!("{} scans: {}", health.len(), counts.join(", "));
}

/// Shares, sight and state, one below the other.
fn charts(health: &Health) -> Vec<FitChart> {
    let over_time = |value: fn(&ScannerHealth) -> f64| -> Vec<[f64; 2]> {
        health.iter().map(|(time_s, health)| [*time_s, value(health)]).collect()
    };
    let chart = |title: &str, up, points, line| FitChart {
        title: title.to_owned(),
        across: "time [s]",
        up,
        points,
        line,
    };
    vec![
        chart(
            "valid beams of the window (points) and predicted returns that came (line)",
            "share",
            over_time(|health| health.valid_share),
            over_time(|health| health.returned_share),
        ),
        chart("distance that is seen ahead", "[m]", Vec::new(), over_time(|health| health.seen_ahead_m)),
        chart(
            "state: 0 healthy, 1 degraded, 2 blind, 3 stuck, 4 contradictory",
            "state",
            Vec::new(),
            over_time(|health| f64::from(health.state)),
        ),
    ]
}
