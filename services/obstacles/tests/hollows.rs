//! Bodies with hollows: they are reported as early as others, and cover no room.

mod scene;

use nalgebra::Vector2;
use scene::*;
use vehicle::geometry::Rectangle;

#[test]
fn a_body_with_a_hollow_of_any_depth_is_reported_when_it_is_seen_again() {
    for seed in 0..10 {
        for depth in [0.02, 0.05, 0.08, 0.1, 0.12, 0.15, 0.2, 0.3] {
            // Two boxes side by side; the left one stands further back. A box and a circle.
            let step = [block(4.0, -0.2, 0.3, 0.4, 0.0), block(4.0 + depth, 0.2, 0.3, 0.4, 0.0)];
            let bow = [block(4.0, -0.3, 0.775, 0.446, 0.0), Body::Circle([3.6 + depth, 0.0].into(), 0.33)];
            for bodies in [step, bow] {
                let seen = run(&mut tight(), &mut Scene::of(&bodies).noisy(seed), &mut Robot::default(), 6);
                assert!(seen[3].count > 0, "seed {seed}, {depth} m");
                assert!(seen[5].items[0].sightings >= 3, "seed {seed}, {depth} m: {:?}", seen[5].items[0]);
            }
        }
    }
}

#[test]
fn the_corner_of_a_room_covers_no_room() {
    for (seed, side) in (0..10).flat_map(|seed| [(seed, 1.0), (seed, -1.0)]) {
        let walls = [block(4.0, 1.2 * side, 10.0, 0.1, 0.0), block(8.0, 0.2 * side, 0.1, 2.1, 0.0)];
        let mut scene = Scene::of(&walls).noisy(seed);
        let mut robot = Robot { speed: 0.5, ..Robot::default() };
        let mut detector = tight();
        for scan in 0..80 {
            let obstacles = run(&mut detector, &mut scene, &mut robot, 1)[0];
            for item in obstacles.list() {
                let centre = Vector2::new(item.box_x_m, item.box_y_m);
                let (length, width) = (item.box_length_m, item.box_width_m);
                let body = Rectangle { centre, yaw: item.box_yaw_rad, length, width };
                let distance = robot.body().distance_to_rectangle(&body);
                assert!(distance > 0.4, "seed {seed}, scan {scan}: {distance} m, {item:?}");
            }
        }
    }
}
