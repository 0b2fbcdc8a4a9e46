//! The plant against an independent integrator: SciPy's DOP853 at a relative tolerance of 1e-12.
//!
//! `plant_reference.py` generates the stored values.

use emulator::Scenario;
use emulator::plant::Plant;
use emulator::scenario::Robot;
use emulator::steering_map::SteeringMap;

/// Largest deviation of sideslip, yaw, yaw rate, x, y, speed and steering angle at the end of a part.
///
/// The plant makes steps of 1 ms across kinks, where a rate reaches its limit or the robot gets slower than 0.05 m/s.
const TOLERANCE: f64 = 1e-6;

fn robot(friction: f64, lag: bool) -> Robot {
    let of = |value| Some(if lag { value } else { 0.0 });
    Robot {
        tyre_friction: Some(friction),
        velocity_factor: Some(1.0),
        steering_map: Some(SteeringMap::Identity),
        velocity_lag_s: of(0.15),
        steering_lag_s: of(0.1),
        ..Robot::default()
    }
}

#[test]
fn every_manoeuvre_ends_where_an_independent_integrator_ends() {
    let (mut plants, mut worst) = (Vec::<(&str, Plant)>::new(), 0.0_f64);
    for line in include_str!("plant_reference.csv").lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |index: usize| cells[index].parse::<f64>();
        if plants.last().is_none_or(|(name, _)| *name != cells[0]) {
            let robot = robot(number(1).unwrap(), cells[2] == "1");
            plants.push((cells[0], Plant::new(&Scenario { robot, ..Scenario::default() })));
        }
        let (name, plant) = plants.last_mut().unwrap();
        match (number(4), number(5)) {
            (Ok(velocity), Ok(steering)) => plant.drive(velocity, steering),
            _ => plant.block(),
        }
        for _ in 0..(number(3).unwrap() * 1000.0).round() as u64 {
            plant.step(1e-3);
        }
        let state = plant.state();
        let reached =
            [state.sideslip, state.yaw, state.yaw_rate, state.x, state.y, plant.speed(), plant.steering()];
        let deviations: Vec<f64> =
            (0..7).map(|index| (reached[index] - number(6 + index).unwrap()).abs()).collect();
        let largest = deviations.iter().copied().fold(0.0, f64::max);
        eprintln!("{name}: {largest:.1e}");
        assert!(largest < TOLERANCE, "{line}: {deviations:?}");
        worst = worst.max(largest);
    }
    assert_eq!(plants.len(), 9);
    eprintln!("largest deviation {worst:.1e}");
}
