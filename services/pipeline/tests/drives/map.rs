//! The estimator finds the robot in a map that was drawn from another drive, in a floor plan of rooms that only the test knows.

use std::fmt::Write as _;

use estimator::laser::grid::{Drawing, GridFrame, MapDeviation, beams};
use estimator::laser::map::{DEVIATION, surfaces};
use nalgebra::Vector2;
use pipeline::{LoopWatch, PipelineSettings, SimulatedLoop};
use shared_types::{AnySample, AnyStage, Odometry, Pose, Scan, Truth};
use vehicle::{Description, Surroundings};

use crate::{parse, seeds};

/// Distance of the goal [m].
const GOAL_M: f64 = 50.0;
/// Side of a cell [m].
const CELL_M: f64 = 0.05;

/// What was seen in a drive.
#[derive(Default)]
struct Seen {
    truth: Truth,
    scan: Option<Scan>,
    /// Scans with the estimates of their poses, and the true ones.
    views: Vec<(Scan, [Pose; 2])>,
    /// Differences of the estimate from the truth [m].
    errors_m: Vec<f64>,
    /// How many of them are in the ellipse of 95 %.
    inside: f64,
    /// How well the poses are known.
    deviation: MapDeviation,
}

/// A map of a drive: its surfaces, and how far they may be off [m].
#[derive(Default)]
struct Map {
    surfaces: Vec<[f64; 4]>,
    deviation_m: f64,
}

impl LoopWatch for Seen {
    fn measured(&mut self, scan: &Scan, _: &Odometry, truth: &Truth) {
        (self.scan, self.truth) = (Some(*scan), *truth);
    }

    fn stepped(&mut self, _: &dyn AnyStage, output: Option<AnySample<'_>>) {
        let Some(pose) = output.and_then(|output| output.get::<Pose>().copied()) else { return };
        let (x, y) = (pose.x_m - self.truth.x_m, pose.y_m - self.truth.y_m);
        self.errors_m.push(x.hypot(y));
        let [.., xx, xy, _, _, yy] = pose.covariance;
        let squares = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
        self.inside += f64::from(u8::from(squares <= 5.99));
        self.deviation.see(&pose);
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

    fn inside(&self) -> f64 {
        self.inside / self.errors_m.len() as f64
    }

    /// The map that its scans make, seen from the estimates or from where they were taken.
    fn map(&self, is_true: bool) -> Map {
        let frame =
            GridFrame::around(Vector2::new(-10.0, -10.0), Vector2::new(GOAL_M + 20.0, 10.0), CELL_M).unwrap();
        let mut drawing = Drawing::new(frame);
        for (scan, poses) in &self.views {
            beams(scan, &poses[usize::from(is_true)], &Description::default())
                .for_each(|[from, to]| drawing.beam(from, to));
        }
        let own_m = if is_true { 0.0 } else { self.deviation.root_m() };
        Map { surfaces: surfaces(&drawing.grid()), deviation_m: own_m.hypot(CELL_M * DEVIATION) }
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
fn drive(robot: &str, seed: u64, map: Option<&Map>, scans: u64) -> Seen {
    let text = format!(
        "name = \"rooms\"\nseed = {seed}\ntimeout_s = 400.0\n[track]\nx_m = [0.0, {:?}]\nsurroundings = \"open\"\n\
         [goal]\nx_m = {GOAL_M:?}\n[robot]\n{robot}\n{}",
        GOAL_M + 10.0,
        rooms()
    );
    let mut settings = PipelineSettings::of(parse(&text));
    settings.tuning =
        pipeline::Tuning::of(Description { surroundings: Surroundings::Hall, ..Description::default() });
    driven(settings, map, GOAL_M - 1.0, scans)
}

/// A drive of so far, for at most so many scans.
fn driven(mut settings: PipelineSettings, map: Option<&Map>, way_m: f64, scans: u64) -> Seen {
    if let Some(Map { surfaces, deviation_m }) = map {
        settings.tuning.estimator.surfaces.clone_from(surfaces);
        settings.tuning.estimator.map_deviation_m = *deviation_m;
        settings.tuning.estimator.surface_deviation_m = CELL_M * DEVIATION;
    }
    let mut simulation = SimulatedLoop::new(&settings, true).unwrap();
    let mut seen = Seen::default();
    while simulation.way_m() < way_m && simulation.next_scan() < scans {
        simulation.move_on();
        simulation.measure(&mut seen);
        simulation.settle(&mut seen);
    }
    seen
}

/// The map of a drive of a seed, and this drive.
fn mapped(seed: u64, is_true: bool) -> (Map, Seen) {
    let seen = drive("preset = \"summit\"", seed, None, 1200);
    (seen.map(is_true), seen)
}

#[test]
fn in_a_map_of_another_drive_the_pose_is_as_good_as_the_map_and_known_to_be_no_better() {
    for (seed, (map, first)) in seeds::each(1..=4, |seed| mapped(seed, false)) {
        assert!(map.surfaces.len() > 40, "{}", map.surfaces.len());
        for preset in ["summit", "worn"] {
            let robot = format!("preset = {preset:?}");
            for (other, seen) in seeds::each(11..=12, |seed| drive(&robot, seed, Some(&map), 1200)) {
                let (rms_m, most_m, inside) = (seen.rms_m(), seen.most_m(0), seen.inside());
                let text = format!("{seed} {preset} {other}: {rms_m:.4} {most_m:.4} {inside:.3}");
                // What the map is off, and half a cell, at most a whole one.
                assert!(rms_m < first.rms_m() + CELL_M / 2.0 && most_m < first.most_m(0) + CELL_M, "{text}");
                assert!(inside > 0.9, "{text}");
            }
        }
    }
}

#[test]
fn in_a_map_without_errors_the_pose_is_known_to_a_third_of_a_cell() {
    let (map, _) = mapped(1, true);
    for preset in ["summit", "worn"] {
        let robot = format!("preset = {preset:?}");
        for (seed, seen) in seeds::each(11..=14, |seed| drive(&robot, seed, Some(&map), 1200)) {
            let (rms_m, most_m, inside) = (seen.rms_m(), seen.most_m(0), seen.inside());
            let text = format!("{preset} {seed}: {rms_m:.4} {most_m:.4} {inside:.3}");
            assert!(rms_m < 0.015 && most_m < 0.05 && inside > 0.9, "{text}");
        }
    }
}

#[test]
fn a_robot_that_is_lifted_in_a_mapped_room_is_located_again_within_two_seconds() {
    let (map, first) = mapped(1, false);
    let lifted = "preset = \"summit\"\npushed_s = 8.0\npushed_left_m = 0.5";
    for (seed, seen) in seeds::each(11..=14, |seed| drive(lifted, seed, Some(&map), 130)) {
        assert!(seen.most_m(0) > 0.4, "it was lifted");
        let (count, most_m) = (seen.errors_m.len(), seen.most_m(101));
        assert!(count > 110 && most_m < first.most_m(0) + 0.03, "{seed}: {:?}", &seen.errors_m[75..]);
    }
}

#[test]
fn a_hall_that_is_drawn_where_it_was_stated_is_driven_in_to_half_a_cell() {
    let hall = |seed: u64, map: Option<&Map>| {
        let text = format!(
            "name = \"hall\"\nseed = {seed}\ntimeout_s = 60.0\n[track]\nx_m = [0.0, 22.0]\n[goal]\nx_m = 10.0\n\
             [[obstacle]]\nshape = \"box\"\nx_m = 5.0\ny_m = 0.0\nlength_m = 0.1\nwidth_m = 0.4\n\
             [robot]\npreset = \"summit\"\n"
        );
        driven(PipelineSettings::of(parse(&text)), map, 9.8, 200)
    };
    for (seed, map) in seeds::each(1..=4, |seed| hall(seed, None).map(false)) {
        let seen = hall(seed + 10, Some(&map));
        let (rms_m, most_m, inside) = (seen.rms_m(), seen.most_m(0), seen.inside());
        let text = format!("{seed}: {rms_m:.4} {most_m:.4} {inside:.3}");
        assert!(rms_m < 0.025 && most_m < 0.05 && inside > 0.9, "{text}");
    }
}
