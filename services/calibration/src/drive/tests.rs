use super::*;
use crate::{drift, steering, velocity};
use emulator::scenario::{Noise, Robot, Values};

/// A robot whose hidden parameters differ by up to 30 % from those of scenario `imperfect-robot`.
fn hidden(trial: u64) -> Scenario {
    let mut stream = NoiseStream::new(trial, Purpose::Course, 4242);
    let mut off = |value: f64| value * stream.between(0.7, 1.3);
    Scenario {
        robot: Robot {
            velocity_factor: Some(off(1.4)),
            steering_backlash_rad: Some(off(0.006)),
            odometry_longitudinal: Some(off(0.012)),
            odometry_lateral_rate: Some(off(0.0003)),
            ..Robot::default()
        },
        noise: Noise { odometry_m: 0.005, odometry_rad: 0.003, ..Noise::default() },
        ..Scenario::default()
    }
}

/// Runs the trials on two threads and hands back their results in order.
fn trials<T: Send>(count: u64, trial: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let half = |parity: u64| (parity..count).step_by(2).map(&trial).collect::<Vec<T>>();
    let (even, odd) = std::thread::scope(|scope| {
        let odd = scope.spawn(|| half(1));
        (half(0), odd.join().unwrap())
    });
    let (mut even, mut odd) = (even.into_iter(), odd.into_iter());
    (0..count).filter_map(|index| if index % 2 == 0 { even.next() } else { odd.next() }).collect()
}

#[test]
fn kv_of_unseen_robots_is_found_within_1_percent_and_covered() {
    let results = trials(50, |trial| {
        let robot = hidden(trial);
        let fit = velocity::fit(&straight_runs(&robot, trial)).unwrap();
        let truth = robot.robot_values().velocity_factor;
        (fit.factor.value / truth - 1.0, fit.factor.covers(truth))
    });
    let worst = results.iter().map(|result| result.0.abs()).fold(0.0, f64::max);
    let covered = results.iter().filter(|result| result.1).count();
    eprintln!("kv: worst {:.3} %, covered {covered} of 50", 100.0 * worst);
    assert!(worst < 0.01 && covered >= 45, "{worst} {covered}");
}

#[test]
fn df_dds_and_play_of_unseen_robots_are_found_within_10_percent_and_covered() {
    let results = trials(50, |trial| {
        let robot = hidden(trial);
        let fit = drift::fit(&sine_runs(&robot, trial)).unwrap();
        let play = fit.play.unwrap();
        let Values { odometry_longitudinal, odometry_lateral_rate, steering_backlash_rad, .. } =
            robot.robot_values();
        let pairs = [
            (fit.longitudinal, odometry_longitudinal),
            (fit.lateral_rate, odometry_lateral_rate),
            (play, steering_backlash_rad),
        ];
        pairs.map(|(estimate, truth)| (estimate.value / truth - 1.0, estimate.covers(truth)))
    });
    for (index, name) in ["df", "dds", "play"].into_iter().enumerate() {
        let worst = results.iter().map(|result| result[index].0.abs()).fold(0.0, f64::max);
        let covered = results.iter().filter(|result| result[index].1).count();
        eprintln!("{name}: worst {:.2} %, covered {covered} of 50", 100.0 * worst);
        assert!(worst < 0.1 && covered >= 45, "{name} {worst} {covered}");
    }
}

#[test]
fn the_steering_map_of_unseen_robots_is_found_within_2_mrad_and_covered() {
    let results = trials(50, |trial| {
        let robot = hidden(trial);
        let fit = steering::fit(&circle_runs(&robot, trial)).unwrap();
        let map = robot.robot.steering_map.unwrap_or_default();
        let worst = (-60..=60)
            .map(|step| 1e-3 * f64::from(step))
            .map(|desired| (map.realised(fit.inverse.eval(desired)) - desired).abs())
            .fold(0.0, f64::max);
        let covered =
            fit.points.iter().filter(|point| point.realised_rad.covers(map.realised(point.sent_rad))).count();
        let play = fit.play.unwrap();
        let truth = robot.robot_values().steering_backlash_rad;
        (
            worst,
            covered,
            fit.points.len(),
            (play.value / truth - 1.0).abs(),
            play.covers(truth),
            fit.held_out_rad,
        )
    });
    let worst = results.iter().map(|result| result.0).fold(0.0, f64::max);
    let covered: usize = results.iter().map(|result| result.1).sum();
    let asked: usize = results.iter().map(|result| result.2).sum();
    let play = results.iter().map(|result| result.3).fold(0.0, f64::max);
    let plays = results.iter().filter(|result| result.4).count();
    let held = results.iter().map(|result| result.5).fold(0.0, f64::max);
    eprintln!(
        "map: worst {worst:.5} rad, covered {covered} of {asked}; play: worst {:.2} %, covered {plays} of 50; held-out {held:.5} rad",
        100.0 * play
    );
    assert!(worst < 0.002 && 10 * covered >= 9 * asked, "{worst} {covered} of {asked}");
    assert!(play < 0.1 && plays >= 45, "{play} {plays}");
}

#[test]
fn the_same_seed_gives_the_same_tables_and_another_one_does_not() {
    let robot = hidden(1);
    assert_eq!(straight_runs(&robot, 5), straight_runs(&robot, 5));
    assert_ne!(straight_runs(&robot, 5), straight_runs(&robot, 6));
}
