//! What is remembered: bodies out of view, bodies that move, bodies that vanish, state across processes.

mod scene;

use scene::{Body, Robot, Scene, block, detector, mover, run};
use shared_types::Obstacles;

#[test]
fn an_obstacle_beside_and_behind_is_remembered_until_it_is_three_metres_behind() {
    let mut scene = Scene::of(&[block(3.0, 0.9, 0.3, 0.3, 0.0)]).noisy(3);
    let mut robot = Robot { speed: 1.0, ..Robot::default() };
    let seen = run(&mut detector(), &mut scene, &mut robot, 75);
    let id = seen[2].items[0].id;
    for (scan, obstacles) in seen.iter().enumerate().skip(2) {
        let behind = 0.1 * scan as f64 - 3.15;
        if behind < 2.8 {
            assert_eq!((obstacles.count, obstacles.items[0].id), (1, id), "scan {scan}");
            assert!((obstacles.items[0].box_y_m - 0.9).abs() < 0.08, "scan {scan}");
        } else if behind > 3.2 {
            assert_eq!(obstacles.count, 0, "scan {scan}");
        }
    }
    assert!(
        seen[55].items[0].unseen_s > 0.2,
        "behind the sweep it is not seen: {}",
        seen[55].items[0].unseen_s
    );
    assert_eq!(seen[20].items[0].unseen_s, 0.0);
}

#[test]
fn a_hidden_obstacle_is_remembered() {
    let poles = [block(4.5, 0.4, 0.2, 0.3, 0.0)];
    let mut detector = detector();
    let mut scene = Scene::of(&poles);
    let first = run(&mut detector, &mut scene, &mut Robot::default(), 3);
    assert_eq!(first[2].count, 1);
    scene.bodies.push(block(2.5, 0.2, 0.1, 1.0, 0.0));
    let later = run(&mut detector, &mut scene, &mut Robot::default(), 20);
    let hidden = later[19].list().iter().find(|item| item.id == first[2].items[0].id).unwrap();
    assert!((hidden.unseen_s - 2.0).abs() < 1e-9, "{}", hidden.unseen_s);
}

#[test]
fn an_obstacle_that_vanishes_is_forgotten_within_three_scans() {
    for seed in 0..10 {
        let mut detector = detector();
        let mut scene =
            Scene::of(&[block(4.0, 0.2, 0.1, 0.4, 0.0), Body::Circle([3.0, -0.8].into(), 0.15)]).noisy(seed);
        let seen = run(&mut detector, &mut scene, &mut Robot::default(), 10);
        assert_eq!(seen[9].count, 2);
        // Its place is free when what is behind it is seen.
        scene.bodies.remove(0);
        scene.bodies.push(block(5.3, 0.0, 0.1, 9.0, 0.0));
        let seen = run(&mut detector, &mut scene, &mut Robot::default(), 4);
        let body =
            |obstacles: &Obstacles| obstacles.list().iter().any(|item| (item.box_x_m - 4.0).abs() < 0.2);
        let states: Vec<bool> = seen.iter().map(body).collect();
        assert_eq!(states, [true, true, false, false], "seed {seed}: one scan is no proof, three are");
    }
}

#[test]
fn beams_that_see_nothing_cut_no_body_off() {
    for (seed, covered) in [(1, [0.04, 0.35]), (2, [-0.35, -0.04])] {
        let mut detector = detector();
        let mut scene = Scene::of(&[block(5.0, 0.0, 0.3, 0.8, 0.0)]).noisy(seed);
        let mut robot = Robot { speed: 1.0, ..Robot::default() };
        let whole = run(&mut detector, &mut scene, &mut robot, 12)[11].items[0];
        // From 3.8 to 1.8 m before the body, these beams cover more and more of one of its ends: at last, half of it.
        scene.dead_rad = Some(covered);
        let seen = run(&mut detector, &mut scene, &mut robot, 20);
        for obstacles in &seen {
            assert_eq!(obstacles.count, 1);
            let body = obstacles.items[0];
            assert!((body.box_width_m - whole.box_width_m).abs() < 0.05, "{body:?}");
            assert!((body.box_x_m - whole.box_x_m).hypot(body.box_y_m - whole.box_y_m) < 0.04, "{body:?}");
            assert_eq!((body.velocity_x_mps, body.velocity_y_mps), (0.0, 0.0), "{body:?}");
        }
    }
}

#[test]
fn missing_returns_erase_nothing_and_an_old_memory_grows_until_it_is_forgotten() {
    let mut detector = detector();
    let mut scene = Scene::of(&[block(4.0, 0.2, 0.1, 0.4, 0.0)]);
    let seen = run(&mut detector, &mut scene, &mut Robot::default(), 20);
    let width = seen[19].items[0].box_width_m;
    scene.bodies.clear();
    // Seen in 20 scans, it is remembered for ten seconds, and grows by 2 cm/s at each side.
    let seen = run(&mut detector, &mut scene, &mut Robot::default(), 102);
    assert_eq!((seen[98].count, seen[101].count), (1, 0));
    assert!((seen[49].items[0].box_width_m - width - 0.2).abs() < 1e-9, "{}", seen[49].items[0].box_width_m);
}

#[test]
fn a_wide_body_that_goes_while_the_robot_rests_is_forgotten_and_no_other() {
    let remembered = |width: f64, speed: f64| {
        let mut detector = detector();
        let mut scene = Scene::of(&[block(1.8, 0.0, 0.2, width, 0.0)]);
        let mut robot = Robot { speed, ..Robot::default() };
        assert_eq!(run(&mut detector, &mut scene, &mut robot, 20)[19].count, 1);
        scene.bodies.clear();
        run(&mut detector, &mut scene, &mut robot, 15)[14].count
    };
    // 0.6 m at 1.7 m are 57 beams, 0.2 m are 19: one sector has 11. A surface that turns black while the robot drives stays.
    assert_eq!([remembered(0.6, 0.0), remembered(0.2, 0.0), remembered(0.6, 0.05)], [0, 1, 1]);
}

#[test]
fn the_velocity_of_a_moving_obstacle_is_found_with_an_honest_covariance() {
    let (mut inside, mut total) = (0, 0);
    for seed in 0..20 {
        let mut scene = Scene::of(&[mover(4.5, -1.2, 0.4, -0.1, 0.4)]).noisy(seed);
        let seen = run(&mut detector(), &mut scene, &mut Robot::default(), 50);
        let id = seen[2].items[0].body;
        for (scan, obstacles) in seen.iter().enumerate().skip(20) {
            let item = obstacles.items[0];
            assert_eq!(item.body, id, "seed {seed} scan {scan}");
            let error = (item.velocity_x_mps + 0.1, item.velocity_y_mps - 0.4);
            // Noise of 5 cm across at 4.5 m and a gain for 0.4 m/s^2: about 0.07 m/s.
            assert!(error.0.hypot(error.1) < 0.3, "seed {seed} scan {scan}: {error:?}");
            let [xx, xy, yy] = item.velocity_covariance;
            let squared = (yy * error.0 * error.0 - 2.0 * xy * error.0 * error.1 + xx * error.1 * error.1)
                / (xx * yy - xy * xy);
            total += 1;
            inside += u32::from(squared < 5.99);
        }
    }
    // 95 % of independent errors are inside; 30 scans of one drive are not independent.
    assert!(f64::from(inside) > 0.9 * f64::from(total), "{inside} of {total}");
}

#[test]
fn a_moving_obstacle_out_of_sight_is_carried_on_for_a_second() {
    let mut detector = detector();
    let mut scene = Scene::of(&[mover(3.5, -1.0, 0.4, 0.0, 0.5)]);
    let seen = run(&mut detector, &mut scene, &mut Robot::default(), 25);
    let last = seen[24].items[0];
    assert!((last.velocity_y_mps - 0.5).abs() < 0.1, "{}", last.velocity_y_mps);
    // Something near hides everything ahead.
    scene.bodies = vec![block(1.0, 0.0, 0.1, 4.0, 0.0)];
    let later = run(&mut detector, &mut scene, &mut Robot::default(), 12);
    let find = |obstacles: &Obstacles| obstacles.list().iter().find(|item| item.body == last.body).copied();
    let carried = find(&later[4]).unwrap();
    assert!((carried.box_y_m - last.box_y_m - 0.25).abs() < 0.06, "{} {}", carried.box_y_m, last.box_y_m);
    assert!(find(&later[11]).is_none());
}

#[test]
fn a_body_that_comes_into_view_part_by_part_does_not_move() {
    // A long box beside the path: at first only its front is seen, then more and more of its side.
    for seed in 0..20 {
        for yaw in [0.0, 0.3, -0.5] {
            let mut scene = Scene::of(&[block(5.0, 1.1, 2.0, 0.4, yaw)]).noisy(seed);
            let mut robot = Robot { speed: 1.0, ..Robot::default() };
            for (scan, obstacles) in run(&mut detector(), &mut scene, &mut robot, 70).iter().enumerate() {
                for item in obstacles.list() {
                    assert_eq!((item.velocity_x_mps, item.velocity_y_mps), (0.0, 0.0), "{seed} {yaw} {scan}");
                }
            }
        }
    }
}

#[test]
fn a_detector_that_resumes_continues_bit_by_bit() {
    let bodies = [
        block(4.0, 0.8, 0.3, 0.4, 0.4),
        mover(3.5, -1.0, 0.3, 0.1, 0.2),
        Body::Circle([5.0, 0.0].into(), 0.2),
    ];
    let mut scene = Scene::of(&bodies).noisy(5);
    let mut robot = Robot { speed: 0.8, ..Robot::default() };
    let (mut first, mut twin) = (detector(), detector());
    for scan in 0..60 {
        let (sample, pose) = scene.scan(&robot);
        robot = robot.after(0.1);
        if scan % 7 == 3 {
            let state = twin.state();
            twin = detector();
            twin.resume(&state).unwrap();
        }
        let (one, two) = (first.step(&sample, &pose), twin.step(&sample, &pose));
        assert_eq!(bytemuck::bytes_of(&one), bytemuck::bytes_of(&two), "scan {scan}");
        assert_eq!(bytemuck::bytes_of(&first.state()), bytemuck::bytes_of(&twin.state()), "scan {scan}");
    }
}
