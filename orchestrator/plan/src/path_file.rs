//! The points of a course in a file of their own: `course.path`.
//!
//! A recorded path has far more points than a course needs, each with an error. Points with a distance become waypoints, as
//! large a distance as leaves all points near the course.

use std::path::Path;

use calibration::record::{self, Record};
use console::exit::Failure;
use console::user_file;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use vehicle::Course;
use vehicle::course::{CourseKeys, Waypoint, Widths};

/// Distances between waypoints that are tried [m].
const APART_M: [f64; 4] = [2.0, 1.0, 0.5, 0.25];
/// A point of the file is at most this far from the course [m].
const BESIDE_M: f64 = 0.05;
/// Most points of a file.
const MAX_POINTS: usize = 100_000;

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PathPoint {
    x_m: f64,
    y_m: f64,
    #[serde(default)]
    speed_mps: Option<f64>,
    /// File and line, for messages.
    #[serde(skip)]
    place: String,
}

impl Record for PathPoint {
    fn locate(&mut self, place: String) {
        self.place = place;
    }
}

/// Puts the waypoints of `course.path` into a scenario, where it has one; the file is looked for beside that of the scenario.
///
/// # Errors
/// A file that can't be read, or whose points no course leads through; exit code 2.
pub(crate) fn read(scenario: &mut Table, scenario_file: &str) -> anyhow::Result<()> {
    let Some(course) = scenario.get_mut("course").and_then(Value::as_table_mut) else { return Ok(()) };
    let Some(path) = course.get("path").and_then(Value::as_str) else { return Ok(()) };
    if course.contains_key("waypoints") {
        let both = "either `waypoints` or `path`, not both";
        return Err(Failure::bad_input(format!(
            "{scenario_file}: course.path = {path} is not allowed: {both}"
        )));
    }
    let file = Path::new(scenario_file).with_file_name(path);
    let name = file.display().to_string();
    let text = user_file::read_table(&file)
        .map_err(|error| Failure::bad_input(format!("{name}: course.path: {error}")))?;
    let points: Vec<PathPoint> =
        record::read(&text, &name).map_err(|error| Failure::bad_input(error.to_string()))?;
    let waypoints = waypoints(&points, &name).map_err(Failure::bad_input)?;
    let written = waypoints.iter().map(Value::try_from).collect::<Result<Vec<_>, _>>()?;
    course.remove("path");
    course.insert("waypoints".to_owned(), Value::Array(written));
    Ok(())
}

/// As few of the points as make a course that leads past all of them.
fn waypoints(points: &[PathPoint], file: &str) -> Result<Vec<Waypoint>, String> {
    if !(2..=MAX_POINTS).contains(&points.len()) {
        return Err(format!("{file}: {} points are not allowed: 2 to {MAX_POINTS}", points.len()));
    }
    for PathPoint { x_m, y_m, speed_mps, place } in points {
        for (name, value) in [("x_m", x_m), ("y_m", y_m)] {
            if !(-1e4..=1e4).contains(value) {
                return Err(format!("{place}: {name} = {value} is not allowed: -10000 to 10000"));
            }
        }
        if let Some(speed_mps) = speed_mps.filter(|speed_mps| !(0.01..=10.0).contains(speed_mps)) {
            return Err(format!("{place}: speed_mps = {speed_mps} is not allowed: 0.01 to 10"));
        }
    }
    let mut farthest = None;
    for apart_m in APART_M {
        let waypoints = thinned(points, apart_m);
        let keys = CourseKeys {
            waypoints: waypoints.clone(),
            width_m: Widths::All(vehicle::Track::MIN_WIDTH_M),
            ..CourseKeys::default()
        };
        let Ok(course) = Course::try_from(keys) else { continue };
        let beside = |point: &PathPoint| distance_m(&course, point);
        let worst =
            points.iter().map(|point| (beside(point), point)).max_by(|one, other| one.0.total_cmp(&other.0));
        match worst {
            Some((beside_m, _)) if beside_m <= BESIDE_M => return Ok(waypoints),
            worst => farthest = worst,
        }
    }
    let Some((beside_m, point)) = farthest else {
        return Err(format!("{file}: no course leads through its points: they turn back or jump"));
    };
    let place = &point.place;
    Err(format!(
        "{place}: the point is {beside_m:.2} m beside the arcs through its neighbours, {BESIDE_M} m are allowed"
    ))
}

fn distance_m(course: &Course, point: &PathPoint) -> f64 {
    let at = Vector2::new(point.x_m, point.y_m);
    let [along_m, _] = course.locate(at);
    (course.at(along_m).point - at).norm()
}

/// The first and the last point, and points with at least this distance between them; a velocity is the smallest one of those
/// left out behind its point.
fn thinned(points: &[PathPoint], apart_m: f64) -> Vec<Waypoint> {
    let mut waypoints: Vec<Waypoint> = Vec::new();
    let last = points.len() - 1;
    for (index, PathPoint { x_m, y_m, speed_mps, .. }) in points.iter().enumerate() {
        let apart = |waypoint: &Waypoint| (x_m - waypoint.x_m).hypot(y_m - waypoint.y_m);
        let far = waypoints.last().is_none_or(|before| apart(before) >= apart_m);
        if index == last && !far && waypoints.len() > 1 {
            waypoints.pop();
        }
        if far || index == last {
            waypoints.push(Waypoint { speed_mps: *speed_mps, ..Waypoint::new(*x_m, *y_m, None) });
        } else if let (Some(before), Some(speed_mps)) = (waypoints.last_mut(), speed_mps) {
            before.speed_mps = Some(before.speed_mps.map_or(*speed_mps, |before| before.min(*speed_mps)));
        }
    }
    waypoints
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: u32, at: impl Fn(f64) -> [f64; 2]) -> Vec<PathPoint> {
        let point = |index: u32| {
            let [x_m, y_m] = at(f64::from(index));
            PathPoint { x_m, y_m, speed_mps: None, place: format!("a.csv: line {}", index + 2) }
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn few_waypoints_lead_past_all_points_of_a_noisy_recording() {
        // A sine of 8 m half a period, every 5 cm, with an error of a centimetre.
        let noise = |index: f64| 0.01 * (index * 12.9898).sin();
        let points = points(400, |index| {
            let x = index * 0.05;
            [x + noise(index), (x * std::f64::consts::PI / 8.0).sin() + noise(index + 0.5)]
        });
        let waypoints = waypoints(&points, "a.csv").unwrap();
        assert!((8..=22).contains(&waypoints.len()), "{}", waypoints.len());
        let course =
            Course::try_from(CourseKeys { waypoints, width_m: Widths::All(0.5), ..CourseKeys::default() })
                .unwrap();
        assert!(points.iter().all(|point| distance_m(&course, point) <= BESIDE_M));
        // The sine bends by at most (pi / 8)^2 = 0.154 1/m.
        assert!(course.sharpest().radius_m > 4.0, "{:?}", course.sharpest());
    }

    #[test]
    fn a_corner_is_refused_with_its_line_and_a_velocity_holds_from_its_point_on() {
        let corner =
            points(200, |index| if index < 100.0 { [index * 0.1, 0.0] } else { [9.9, (index - 99.0) * 0.1] });
        let sharp = waypoints(&corner, "a.csv").unwrap_err();
        assert!(sharp.starts_with("a.csv: line 101: the point is 0."), "{sharp}");
        let jump = points(40, |index| [index * 0.1, if index == 20.0 { 0.3 } else { 0.0 }]);
        let refused = waypoints(&jump, "a.csv").unwrap_err();
        assert!(refused.starts_with("a.csv: line 2"), "{refused}");
        let slow = [None, Some(0.0)].map(|speed_mps| PathPoint { speed_mps, ..corner[3].clone() });
        let refused = waypoints(&slow, "a.csv").unwrap_err();
        assert_eq!(refused, "a.csv: line 5: speed_mps = 0 is not allowed: 0.01 to 10");
        let refused =
            waypoints(&[PathPoint { x_m: f64::NAN, ..corner[3].clone() }, corner[4].clone()], "a.csv");
        assert_eq!(refused.unwrap_err(), "a.csv: line 5: x_m = NaN is not allowed: -10000 to 10000");
        let mut line = points(101, |index| [index * 0.1, 0.0]);
        (line[30].speed_mps, line[37].speed_mps) = (Some(0.5), Some(0.3));
        let limited = waypoints(&line, "a.csv").unwrap();
        assert_eq!(
            limited.iter().map(|waypoint| waypoint.speed_mps).collect::<Vec<_>>(),
            [None, Some(0.3), None, None, None, None]
        );
    }
}
