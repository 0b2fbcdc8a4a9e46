//! Bodies beside the track, and bodies that move close to others.

mod scene;

use scene::*;
use shared_types::{Obstacle, Obstacles};

fn moving(obstacles: &Obstacles) -> Option<Obstacle> {
    obstacles.list().iter().find(|item| item.velocity_x_mps.hypot(item.velocity_y_mps) > 0.0).copied()
}

/// The track ends at y = -1.5; bodies at rest are described from -2.1 on.
#[test]
fn a_body_that_comes_from_beside_the_track_is_known_to_move_before_it_is_on_it() {
    for seed in 0..20 {
        let mut scene = Scene::of(&[mover(3.0, -3.0, 0.4, 0.0, 0.4)]).noisy(seed);
        let seen = run(&mut tight(), &mut scene, &mut Robot::default(), 25);
        // After 2 s its front is at -2.0.
        let body = moving(&seen[20]).unwrap_or_else(|| panic!("seed {seed}: {:?}", seen[20].list()));
        assert!((body.velocity_y_mps - 0.4).abs() < 0.2, "seed {seed}: {}", body.velocity_y_mps);
    }
}

#[test]
fn what_stands_far_beside_the_track_is_described_only_where_it_is_near() {
    for seed in 0..20 {
        // A long wall 1 m beside the track, and a box in front of it that reaches into the track.
        let mut scene =
            Scene::of(&[block(4.0, -2.6, 6.0, 0.2, 0.02), block(3.0, -1.9, 0.4, 1.3, 0.0)]).noisy(seed);
        let mut robot = Robot { speed: 0.5, ..Robot::default() };
        for obstacles in run(&mut tight(), &mut scene, &mut robot, 40).iter().skip(5) {
            assert!(obstacles.count > 0, "seed {seed}");
            for item in obstacles.list() {
                assert_eq!((item.velocity_x_mps, item.velocity_y_mps), (0.0, 0.0), "seed {seed}");
                let (x, length) = (item.box_x_m, item.box_length_m);
                assert!((x - 3.0).abs() < 0.25 && length < 0.75, "seed {seed}: {x} {length}");
            }
        }
    }
}

#[test]
fn a_body_that_passes_close_behind_one_at_rest_keeps_its_velocity() {
    for seed in 0..20 {
        // The gap is 5 cm: the segmentation takes both for one.
        let mut scene =
            Scene::of(&[mover(3.45, -1.2, 0.4, 0.0, 0.3), block(3.0, 0.4, 0.4, 0.4, 0.0)]).noisy(seed);
        let seen = run(&mut tight(), &mut scene, &mut Robot::default(), 45);
        for (scan, obstacles) in seen.iter().enumerate().skip(25) {
            let body = moving(obstacles).unwrap_or_else(|| panic!("seed {seed} scan {scan}"));
            assert!(
                (body.velocity_y_mps - 0.3).abs() < 0.2,
                "seed {seed} scan {scan}: {}",
                body.velocity_y_mps
            );
            let standing = obstacles.list().iter().filter(|item| item.body != body.body);
            for item in standing {
                assert!(
                    item.box_length_m < 0.6 && item.box_width_m < 0.7,
                    "seed {seed} scan {scan}: {item:?}"
                );
            }
        }
    }
}
