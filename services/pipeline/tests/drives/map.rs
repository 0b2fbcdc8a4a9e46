//! The estimator finds the robot in a map that was drawn from another drive, in a floor plan of rooms that only the test knows.

use std::fmt::Write as _;

use estimator::laser::grid::{Drawing, GridFrame, beams};
use estimator::laser::map::surfaces;
use nalgebra::Vector2;
use pipeline::{LoopWatch, PipelineSettings, SimulatedLoop};
use shared_types::{AnySample, AnyStage, Odometry, Pose, Scan, Truth};
use vehicle::{Description, Surroundings};

use crate::{parse, seeds};

/// Distance of the goal [m].
const GOAL_M: f64 = 50.0;

/// What was seen in a drive.
#[derive(Default)]
struct Seen {
    truth: Truth,
    scan: Option<Scan>,
    /// Scans with the estimates of their poses, and the true ones.
    views: Vec<(Scan, [Pose; 2])>,
    /// Differences of the estimate from the truth [m].
    errors_m: Vec<f64>,
}

impl LoopWatch for Seen {
    fn measured(&mut self, scan: &Scan, _: &Odometry, truth: &Truth) {
        (self.scan, self.truth) = (Some(*scan), *truth);
    }

    fn stepped(&mut self, _: &dyn AnyStage, output: Option<AnySample<'_>>) {
        let Some(pose) = output.and_then(|output| output.get::<Pose>().copied()) else { return };
        self.errors_m.push((pose.x_m - self.truth.x_m).hypot(pose.y_m - self.truth.y_m));
        let Truth { x_m, y_m, yaw_rad, .. } = self.truth;
        let true_pose = Pose { x_m, y_m, yaw_rad, ..pose };
        self.views.extend(self.scan.take().map(|scan| (scan, [pose, true_pose])));
    }
}

impl Seen {
    fn rms_m(&self) -> f64 {
        (self.errors_m.iter().map(|error_m| error_m * error_m).sum::<f64>() / self.errors_m.len() as f64)
            .sqrt()
    }

    fn most_m(&self, from: usize) -> f64 {
        self.errors_m[from..].iter().copied().fold(0.0, f64::max)
    }

    /// The surfaces of the map that its scans make, seen from the estimates or from where they were taken.
    fn map(&self, is_true: bool) -> Vec<[f64; 4]> {
        let frame =
            GridFrame::around(Vector2::new(-10.0, -10.0), Vector2::new(GOAL_M + 20.0, 10.0), 0.05).unwrap();
        let mut drawing = Drawing::new(frame);
        for (scan, poses) in &self.views {
            beams(scan, &poses[usize::from(is_true)], &Description::default())
                .for_each(|[from, to]| drawing.beam(from, to));
        }
        surfaces(&drawing.grid())
    }
}

/// Rooms of different length along a corridor, each with a door to it.
fn rooms() -> String {
    let mut boxes = String::new();
    let mut wall = |x_m: f64, y_m: f64, length_m: f64, width_m: f64| {
        let _ = write!(
            boxes,
            "[[obstacle]]\nshape = \"box\"\nx_m = {x_m:?}\ny_m = {y_m:?}\nlength_m = {length_m:?}\nwidth_m = {width_m:?}\n"
        );
    };
    for (side, lengths_m) in [(1.0, [3.1, 4.7, 2.6, 5.3]), (-1.0, [4.2, 2.9, 5.6, 3.4])] {
        let mut from_m = -4.0;
        for length_m in lengths_m.iter().cycle() {
            let door_m = 1.0;
            let before_m = length_m / 3.0;
            let behind_m = length_m - before_m - door_m;
            wall(from_m + before_m / 2.0, side * 1.95, before_m, 0.1);
            wall(from_m + length_m - behind_m / 2.0, side * 1.95, behind_m, 0.1);
            wall(from_m, side * 3.25, 0.1, 2.5);
            wall(from_m + length_m / 2.0, side * 4.5, *length_m, 0.1);
            from_m += length_m;
            if from_m > GOAL_M + 12.0 {
                break;
            }
        }
    }
    wall(-4.0, 0.0, 0.1, 3.8);
    wall(GOAL_M + 10.5, 0.0, 0.1, 3.8);
    boxes
}

/// A drive through the rooms, for at most so many scans.
fn drive(robot: &str, seed: u64, map: &[[f64; 4]], scans: u64) -> Seen {
    let text = format!(
        "name = \"rooms\"\nseed = {seed}\ntimeout_s = 400.0\n[track]\nx_m = [0.0, {:?}]\nsurroundings = \"open\"\n\
         [goal]\nx_m = {GOAL_M:?}\n[robot]\n{robot}\n{}",
        GOAL_M + 10.0,
        rooms()
    );
    let mut settings = PipelineSettings::of(parse(&text));
    settings.tuning =
        pipeline::Tuning::of(Description { surroundings: Surroundings::Hall, ..Description::default() });
    settings.tuning.estimator.surfaces = map.to_vec();
    let mut simulation = SimulatedLoop::new(&settings, true).unwrap();
    let mut seen = Seen::default();
    while simulation.way_m() < GOAL_M - 1.0 && simulation.next_scan() < scans {
        simulation.move_on();
        simulation.measure(&mut seen);
        simulation.settle(&mut seen);
    }
    seen
}

/// Root of the mean square and largest error of four drives, and a text of both.
fn errors(preset: &str, map: &[[f64; 4]]) -> (Vec<[f64; 2]>, String) {
    let robot = format!("preset = {preset:?}");
    let drives = seeds::each(1..=4, |seed| drive(&robot, seed, map, 1200));
    let found: Vec<[f64; 2]> = drives.iter().map(|(_, seen)| [seen.rms_m(), seen.most_m(0)]).collect();
    let text = format!("{preset} {found:.3?}");
    (found, text)
}

#[test]
fn in_a_map_of_another_drive_the_pose_is_as_good_as_the_map_however_far_the_odometer_drifts() {
    let first = drive("preset = \"summit\"", 2, &[], 1200);
    let map = first.map(false);
    assert!(map.len() > 40 && first.most_m(0) < 0.06, "{} {}", map.len(), first.most_m(0));
    for preset in ["summit", "worn"] {
        let ((with, text), (without, text_without)) = (errors(preset, &map), errors(preset, &[]));
        let sum = |errors: &[[f64; 2]]| errors.iter().map(|[rms_m, _]| rms_m).sum::<f64>();
        assert!(sum(&with) < 0.8 * sum(&without), "{text}; without {text_without}");
        for [rms_m, most_m] in with {
            // What the map is off, and half a cell.
            assert!(rms_m < first.rms_m() + 0.02 && most_m < first.most_m(0) + 0.03, "{text}");
        }
    }
}

#[test]
fn in_a_map_without_errors_the_pose_is_known_to_a_fifth_of_a_cell() {
    let map = drive("preset = \"summit\"", 2, &[], 1200).map(true);
    for preset in ["summit", "worn"] {
        let (found, text) = errors(preset, &map);
        assert!(found.iter().all(|[rms_m, most_m]| *rms_m < 0.015 && *most_m < 0.05), "{text}");
    }
}

#[test]
fn a_robot_that_is_lifted_in_a_mapped_room_is_located_again_within_two_seconds() {
    let map = drive("preset = \"summit\"", 2, &[], 1200).map(false);
    let lifted = "preset = \"summit\"\npushed_s = 8.0\npushed_left_m = 0.5";
    for (seed, seen) in seeds::each(1..=4, |seed| drive(lifted, seed, &map, 130)) {
        assert!(seen.most_m(0) > 0.4, "it was lifted");
        assert!(seen.errors_m.len() > 110 && seen.most_m(101) < 0.06, "{seed}: {:?}", &seen.errors_m[75..]);
    }
}
