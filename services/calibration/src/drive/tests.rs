use super::*;
use crate::{drift, steering, velocity};
use emulator::scenario::{Noise, Preset, Robot, Values};
use vehicle::VehicleModel;

fn usual() -> Description {
    Description::default()
}

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
        let fit = velocity::fit(&straight_runs(&robot, &usual(), trial)).unwrap();
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
        let fit = drift::fit(&sine_runs(&robot, &usual(), trial), &usual()).unwrap();
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
        let fit = steering::fit(&circle_runs(&robot, &usual(), trial), &usual()).unwrap();
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
fn a_front_steered_and_a_differential_robot_are_calibrated_as_they_are_described() {
    let bounds = |velocity_max_mps, steering_max_rad| Bounds {
        velocity_max_mps,
        steering_max_rad,
        sent_velocity_max_mps: 1.3 * velocity_max_mps,
        sent_steering_max_rad: 1.3 * steering_max_rad,
        ..Bounds::default()
    };
    let car = Description {
        model: VehicleModel::Bicycle,
        bounds: bounds(5.0, 0.35),
        mass_kg: 3.74,
        front_m: 0.159,
        rear_m: 0.171,
        stiffness_n_per_rad: 95.0,
        inertia_kgm2: 0.0471,
        ..Description::default()
    };
    let wheels = Description {
        model: VehicleModel::Differential,
        bounds: bounds(0.65, 0.45),
        front_m: 0.1,
        rear_m: 0.1,
        ..Description::default()
    };
    for vehicle in [car, wheels] {
        let turned = |steering_offset_rad| {
            let robot = Robot {
                preset: Preset::Summit,
                velocity_factor: Some(1.08),
                steering_offset_rad: Some(steering_offset_rad),
                odometry_longitudinal: Some(0.02),
                ..Robot::default()
            };
            Scenario { robot: robot.resolved(&vehicle, 1), ..Scenario::default() }
        };
        let robot = turned(0.0);
        let velocity = velocity::fit(&straight_runs(&robot, &vehicle, 1)).unwrap();
        assert!((velocity.factor.value - 1.08).abs() < 0.02, "{:?}", velocity.factor);
        let steering = steering::fit(&circle_runs(&turned(0.01), &vehicle, 1), &vehicle).unwrap();
        // Its angle is 0.01 rad more to the left than sent.
        for desired in [-0.3, 0.0, 0.3] {
            let sent = steering.inverse.eval(desired);
            assert!((sent - (desired - 0.01)).abs() < 0.01, "{desired}: {sent} of {:?}", vehicle.model);
        }
        let drift = drift::fit(&sine_runs(&robot, &vehicle, 1), &vehicle).unwrap();
        assert!((drift.longitudinal.value - 0.02).abs() < 2e-3, "{:?}", drift.longitudinal);
        // A robot that steers late has no play.
        let (play, late) = (drift.play.unwrap().value, drift.steering_late.unwrap().value);
        assert!(play < 1e-3 && (late - 0.12).abs() < 0.02, "{play} {late}");
    }
}

#[test]
fn the_same_seed_gives_the_same_tables_and_another_one_does_not() {
    let robot = hidden(1);
    assert_eq!(straight_runs(&robot, &usual(), 5), straight_runs(&robot, &usual(), 5));
    assert_ne!(straight_runs(&robot, &usual(), 5), straight_runs(&robot, &usual(), 6));
}
