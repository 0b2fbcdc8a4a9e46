//! Scans with what the odometer said at their times, as text: what the laser odometry of others gets too.
//!
//! The first line names the beams: their number, angle of the first one and from one to the next [rad], duration of the
//! sweep and period [ns]. Each line after it is a scan: times at which the front beam was taken and at which the odometry
//! came [ns]; x, y, yaw and speed by the odometer; time [ns], velocity and steering angle of what was sent to the wheels
//! after the scan, zero where that is not known; the true x, y and yaw, `nan` where they are not known; the ranges [mm].

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use console::exit::Failure;
use console::user_file::{self, DATA_BYTES};
use estimator::{Estimator, EstimatorConfig};
use pipeline::Step;
use shared_types::{Actuation, ActuationKind, Flag, Header, Odometry, Role, Scan, ScanGeometry};

/// Numbers of a line before its ranges.
const FIELDS: usize = 12;

/// The line of the beams.
pub(super) fn heading(scan: &Scan) -> String {
    let ScanGeometry { count, first_rad, increment_rad } = scan.geometry();
    format!("{count} {first_rad:?} {increment_rad:?} {} {}\n", scan.sweep_ns, scan.period_ns)
}

/// The line of a scan.
pub(super) fn line(step: &Step) -> String {
    let Step { scan, odometry, truth, actuation, .. } = step;
    let came_ns = odometry.header.chain.iter().map(|stamps| stamps.published_ns).max().unwrap_or_default();
    let sent = actuation.as_ref().filter(|actuation| actuation.drives());
    let sent_ns = sent.map_or(0, |sent| sent.header.stage(Role::Actuator).published_ns);
    let [velocity, steering] =
        sent.map_or([0.0; 2], |sent| [sent.desired_velocity_mps, sent.desired_steering_rad]);
    let mut line = format!("{} {came_ns}", odometry.header.acquired_ns);
    for number in [odometry.x_m, odometry.y_m, odometry.yaw_rad, odometry.speed_mps] {
        let _ = write!(line, " {number:?}");
    }
    let _ = write!(line, " {sent_ns} {velocity:?} {steering:?}");
    for number in [truth.x_m, truth.y_m, truth.yaw_rad] {
        let _ = write!(line, " {number:?}");
    }
    for range in scan.ranges() {
        let _ = write!(line, " {range}");
    }
    line + "\n"
}

/// Estimates the poses of such a file; a line for each scan: x, y, yaw, and how long that took [ns]; and of the filter
/// innovation, state and covariance in terms of yaw, x and y.
///
/// # Errors
/// A file that can't be read or has other lines, with its number: exit code 2.
pub(super) fn follow(path: &Path, config: &EstimatorConfig) -> anyhow::Result<String> {
    let text = user_file::read(path, DATA_BYTES)
        .map_err(|reason| Failure::bad_input(format!("{}: {reason}", path.display())))?;
    let bad = |number: usize, what: &str| {
        Failure::bad_input(format!("{}, line {}: {what}", path.display(), number + 1))
    };
    let mut lines = text.lines().enumerate();
    let first: Vec<f64> = lines.next().and_then(|(_, line)| numbers(line)).unwrap_or_default();
    let &[count, first_rad, increment_rad, sweep_ns, period_ns] = &first[..] else {
        return Err(bad(0, "expected beams, first angle, increment, sweep and period"));
    };
    let geometry = ScanGeometry { count: count as usize, first_rad, increment_rad };
    let mut estimator = Estimator::new(config)?;
    let mut scan = Scan {
        sweep_ns: sweep_ns as u64,
        period_ns: period_ns as u64,
        missing: Flag::from(false),
        ..Scan::of(geometry)
    };
    let (mut odometry, mut poses) = (Odometry::default(), String::new());
    for (number, line) in lines {
        let fields = numbers(line)
            .filter(|fields| fields.len() == FIELDS + scan.ranges().len())
            .ok_or_else(|| bad(number, &format!("expected {FIELDS} numbers and {count} ranges")))?;
        if fields[0] as u64 <= odometry.header.acquired_ns {
            return Err(bad(number, "the time goes back"));
        }
        odometry = next(&odometry, &fields);
        scan.header = odometry.header;
        for (range, &field) in scan.ranges_mut().iter_mut().zip(&fields[FIELDS..]) {
            *range = field as u32;
        }
        let begun = Instant::now();
        let pose = estimator.step(&odometry, None, fields[1] as u64).unwrap_or_default();
        let stepped = begun.elapsed();
        if fields[6] > 0.0 {
            estimator.note(&actuation(&odometry.header, &fields), fields[6] as u64);
        }
        let begun = Instant::now();
        estimator.see(&scan);
        let took_ns = (stepped + begun.elapsed()).as_nanos();
        let state = estimator.state();
        let [yaw, x, y] = state.reckoning.pose;
        let _ = write!(poses, "{x:?} {y:?} {yaw:?} {took_ns}");
        for number in pose.innovation.iter().chain(&state.estimate).chain(&state.covariance) {
            let _ = write!(poses, " {number:?}");
        }
        poses.push('\n');
    }
    Ok(poses)
}

fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split_ascii_whitespace().map(|word| word.parse().ok()).collect()
}

/// The odometry of a line.
fn next(before: &Odometry, fields: &[f64]) -> Odometry {
    let [x_m, y_m, yaw_rad, speed_mps] = [fields[2], fields[3], fields[4], fields[5]];
    let acquired_ns = fields[0] as u64;
    let is_first = before.header.sequence == 0;
    let since = |now: f64, before: f64| if is_first { 0.0 } else { now - before };
    let header = Header { acquired_ns, incarnation: 1, ..before.header.next(0) };
    Odometry {
        header,
        x_m,
        y_m,
        yaw_rad,
        dx_m: since(x_m, before.x_m),
        dy_m: since(y_m, before.y_m),
        dyaw_rad: since(yaw_rad, before.yaw_rad),
        dt_s: since(acquired_ns as f64, before.header.acquired_ns as f64) * 1e-9,
        speed_mps,
    }
}

/// What was sent after the scan of a line.
fn actuation(header: &Header, fields: &[f64]) -> Actuation {
    let mut header = *header;
    header.stage_mut(Role::Actuator).published_ns = fields[6] as u64;
    Actuation {
        header,
        kind: ActuationKind::Drive.wire(),
        answers: 1,
        desired_velocity_mps: fields[7],
        desired_steering_rad: fields[8],
        ..Actuation::default()
    }
}

#[cfg(test)]
mod tests {
    use console::new_file::Scratch;

    use super::*;

    /// What following a file of these lines says.
    fn followed(lines: &[&str]) -> anyhow::Result<String> {
        let folder = Scratch::new().unwrap();
        let path = folder.path().join("drive.txt");
        std::fs::write(&path, lines.join("\n")).unwrap();
        follow(&path, &EstimatorConfig::default())
    }

    #[test]
    fn poses_follow_the_odometer_and_bad_lines_are_named() {
        const HEADING: &str = "3 -0.5 0.5 0 100000000";
        const FIRST: &str = "100000000 100000000 0 0 0 1 0 0 0 nan nan nan 1000 1000 1000";
        const SECOND: &str = "200000000 200000000 0.1 0 0 1 0 0 0 nan nan nan 1000 1000 1000";
        let poses = followed(&[HEADING, FIRST, SECOND]).unwrap();
        let x_m: Vec<f64> = poses.lines().map(|line| numbers(line).unwrap()[0]).collect();
        assert!(x_m.len() == 2 && x_m[0] == 0.0 && (x_m[1] - 0.1).abs() < 0.03, "{x_m:?}");
        for (lines, expected) in [
            (&["3 -0.5 0.5"][..], "line 1: expected beams"),
            (&[HEADING, "1 2 3"], "line 2: expected 12 numbers and 3 ranges"),
            (&[HEADING, SECOND, FIRST], "line 3: the time goes back"),
        ] {
            let error = followed(lines).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
