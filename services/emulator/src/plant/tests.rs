//! Motion that can be checked by hand, and the whole range of robots.

use super::*;
use crate::scenario::Robot;
use crate::steering_map::{SteeringMap, nonlinear};
use proptest::prelude::*;
use vehicle::Control;
use vehicle::integrate::integrate;

fn plant(robot: Robot) -> Plant {
    Plant::new(&Scenario { robot, ..Scenario::default() })
}

fn ideal() -> Robot {
    Robot { velocity_factor: Some(1.0), steering_map: Some(SteeringMap::Identity), ..Robot::default() }
}

fn run(plant: &mut Plant, milliseconds: usize) -> f64 {
    (0..milliseconds).map(|_| plant.step(1e-3)).sum()
}

#[test]
fn the_velocity_factor_divides_what_is_sent() {
    let mut plant = plant(Robot::default());
    plant.drive(1.4, 0.0);
    let distance = run(&mut plant, 1000);
    assert!((distance - 1.0).abs() < 1e-12 && (plant.state().x - 1.0).abs() < 1e-12);
}

#[test]
fn an_ideal_robot_moves_as_the_model() {
    let mut plant = plant(ideal());
    plant.drive(0.7, 0.05);
    run(&mut plant, 2000);
    let control = Control { velocity: 0.7, steering: 0.05 };
    let model = integrate(&Parameters::default(), &State::default(), &control, 2.0);
    // Both are RK4, with 1 and 2 ms; the yaw rate's transient at 0.7 m/s costs the latter about 1e-7.
    assert!((plant.state().to_vector() - model.to_vector()).amax() < 1e-6);
}

#[test]
fn blocked_wheels_slide_v_squared_over_two_a() {
    let mut plant = plant(ideal());
    plant.drive(0.9, 0.0);
    plant.block();
    let distance = run(&mut plant, 179);
    assert!(plant.speed() > 0.0);
    let rest = run(&mut plant, 10);
    // 0.81 / 10 m in 0.18 s.
    assert!((distance + rest - 0.081).abs() < 1e-12, "{}", distance + rest);
    assert_eq!((plant.speed(), plant.state().yaw_rate, plant.state().sideslip), (0.0, 0.0, 0.0));
}

#[test]
fn a_robot_drives_backwards_as_one_that_is_turned_round_drives_forwards() {
    for robot in [ideal(), Robot { tyre_friction: Some(0.8), ..lagging() }] {
        let mut backwards = plant(robot);
        backwards.drive(-0.3, 0.05);
        let mut mirror = plant(robot);
        mirror.parameters = mirror.parameters.mirrored();
        mirror.state = mirror.state.mirrored();
        mirror.drive(0.3, -0.05);
        for milliseconds in [1500, 300] {
            let [way, mirror_way] = [&mut backwards, &mut mirror].map(|plant| run(plant, milliseconds));
            assert!((way + mirror_way).abs() < 1e-9 && (backwards.speed + mirror.speed).abs() < 1e-12);
            let difference = backwards.state.to_vector() - mirror.state.mirrored().to_vector();
            assert!(difference.amax() < 1e-9, "{difference}");
            backwards.block();
            mirror.block();
        }
        assert_eq!((backwards.speed, backwards.state.yaw_rate), (0.0, 0.0));
        assert!(backwards.state.x < -0.4 && backwards.state.y.abs() > 0.01, "{backwards:?}");
    }
}

#[test]
fn the_drive_brakes_before_it_drives_the_other_way() {
    let limits = Robot { acceleration_max_mps2: Some(2.0), deceleration_max_mps2: Some(3.0), ..lagging() };
    let mut plant = plant(limits);
    plant.drive(1.0, 0.0);
    run(&mut plant, 3000);
    plant.drive(-1.0, 0.0);
    // 3 m/s^2 down to zero, and 2 m/s^2 from there.
    run(&mut plant, 433);
    assert!((plant.speed() + 0.2).abs() < 2e-3, "{}", plant.speed());
}

#[test]
fn blocked_wheels_keep_their_angle() {
    let mut plant = plant(ideal());
    plant.drive(1.0, 0.06);
    run(&mut plant, 500);
    plant.block();
    let yaw = plant.state().yaw;
    run(&mut plant, 300);
    assert_eq!(plant.steering(), 0.06);
    // 0.1 m in a turn of 3.1 m radius, and 5e-3 because the yaw rate lags up to 30 ms behind 1.6 rad/s^2.
    let turned = plant.state().yaw - yaw;
    assert!((turned - 0.1 / 3.1 - 5e-3).abs() < 2e-3, "{turned}");
}

#[test]
fn play_delays_the_wheels_by_half_its_width_in_either_direction() {
    let mut plant = plant(Robot { steering_backlash_rad: Some(0.006), ..ideal() });
    let mut wheels = |sent: f64| {
        plant.drive(0.5, sent);
        plant.steering()
    };
    assert_eq!(wheels(0.005), 0.0, "the play is not used up");
    assert!((wheels(0.020) - 0.014).abs() < 1e-15, "pushed from below");
    assert!((wheels(0.010) - 0.014).abs() < 1e-15, "nothing pushes on the way back");
    assert!((wheels(0.000) - 0.006).abs() < 1e-15, "pushed from above");
    assert!((wheels(-0.02) + 0.014).abs() < 1e-15);
}

#[test]
fn the_map_of_the_linkage_comes_before_the_play() {
    let mut plant = plant(Robot { steering_backlash_rad: Some(0.006), ..Robot::default() });
    plant.drive(0.5, 0.06);
    assert!((plant.steering() - (nonlinear(0.06) - 0.006)).abs() < 1e-15);
}

#[test]
fn the_slowest_drive_stays_stable_and_a_wreck_stays_where_it_is() {
    let mut plant = plant(ideal());
    plant.drive(0.01, 0.12);
    run(&mut plant, 5000);
    assert!(plant.state().is_finite() && plant.state().yaw_rate.abs() < 0.05);
    plant.wreck();
    let state = *plant.state();
    plant.drive(1.0, 0.0);
    assert_eq!(run(&mut plant, 100), 0.0);
    assert_eq!(*plant.state(), state);
}

/// A robot with lags and nothing else.
fn lagging() -> Robot {
    Robot {
        velocity_lag_s: Some(0.15),
        steering_lag_s: Some(0.1),
        acceleration_max_mps2: Some(100.0),
        deceleration_max_mps2: Some(100.0),
        steering_rate_max_radps: Some(100.0),
        ..ideal()
    }
}

#[test]
fn velocity_and_steering_follow_with_their_time_constants() {
    let mut plant = plant(lagging());
    plant.drive(0.8, 0.05);
    assert_eq!((plant.speed(), plant.steering()), (0.0, 0.0));
    let distance = run(&mut plant, 150);
    // One time constant of the velocity, 1.5 of the steering.
    assert!((plant.speed() - 0.8 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    assert!((plant.steering() - 0.05 * (1.0 - (-1.5_f64).exp())).abs() < 1e-9);
    // v t - v tau (1 - exp(-t / tau)).
    assert!((distance - 0.8 * 0.15 * (-1.0_f64).exp()).abs() < 1e-9, "{distance}");
}

#[test]
fn acceleration_deceleration_and_steering_rate_are_limited() {
    let limits = Robot {
        acceleration_max_mps2: Some(2.0),
        deceleration_max_mps2: Some(3.0),
        steering_rate_max_radps: Some(0.2),
        ..lagging()
    };
    let mut plant = plant(limits);
    plant.drive(1.0, 0.06);
    run(&mut plant, 100);
    assert!((plant.speed() - 0.2).abs() < 1e-12, "2 m/s^2 for 0.1 s: {}", plant.speed());
    assert!((plant.steering() - 0.02).abs() < 1e-12, "0.2 rad/s for 0.1 s: {}", plant.steering());
    run(&mut plant, 3000);
    plant.drive(0.1, 0.06);
    run(&mut plant, 100);
    assert!((plant.speed() - 0.7).abs() < 1e-6, "3 m/s^2 for 0.1 s: {}", plant.speed());
}

#[test]
fn a_robot_at_standstill_turns_its_wheels_before_it_rolls() {
    let mut plant = plant(Robot { velocity_lag_s: Some(0.0), ..lagging() });
    plant.drive(0.0, 0.06);
    assert_eq!(run(&mut plant, 1000), 0.0);
    assert!((plant.steering() - 0.06).abs() < 1e-5);
    assert_eq!(*plant.state(), State::default());
}

#[test]
fn blocked_wheels_keep_the_angle_that_they_had_reached() {
    let mut plant = plant(lagging());
    plant.drive(1.0, 0.06);
    run(&mut plant, 50);
    let reached = plant.steering();
    plant.block();
    run(&mut plant, 300);
    assert!(reached < 0.03);
    assert_eq!((plant.steering(), plant.speed()), (reached, 0.0));
}

#[test]
fn blocked_wheels_slow_down_by_mu_g_at_most() {
    let way = |friction| {
        let mut plant = plant(Robot { tyre_friction: Some(friction), ..ideal() });
        plant.drive(0.9, 0.0);
        plant.block();
        run(&mut plant, 2000)
    };
    assert!((way(0.1) - 0.81 / (2.0 * 0.981)).abs() < 1e-12);
    assert!((way(0.8) - 0.081).abs() < 1e-12, "5 m/s^2 is less than 0.8 g");
}

#[test]
fn tyres_with_little_friction_turn_less() {
    // How far the direction of motion turns in 5 s at 1 m/s.
    let turn = |friction| {
        let mut plant = plant(Robot { tyre_friction: Some(friction), ..ideal() });
        plant.drive(1.0, 0.06);
        run(&mut plant, 5000);
        plant.state().yaw + plant.state().sideslip
    };
    // 0.32 rad/s without a limit, less the transient; the forces of 0.02 g give 0.196 m/s^2 at most, over the
    // cosine of a sideslip up to 0.18 rad.
    assert!((turn(0.0) - 1.6).abs() < 0.03, "{}", turn(0.0));
    assert!((0.93..=0.998).contains(&turn(0.02)), "{}", turn(0.02));
    assert!((turn(0.8) / turn(0.0) - 1.0).abs() < 0.005);
}

#[test]
fn the_offset_is_added_after_map_and_play() {
    let mut plant = plant(Robot {
        steering_offset_rad: Some(0.01),
        steering_backlash_rad: Some(0.006),
        ..Robot::default()
    });
    assert_eq!(plant.steering(), 0.01);
    plant.drive(0.5, 0.06);
    assert!((plant.steering() - (nonlinear(0.06) - 0.006 + 0.01)).abs() < 1e-15);
    plant.drive(0.5, 0.06);
    assert!((plant.steering() - (nonlinear(0.06) - 0.006 + 0.01)).abs() < 1e-15, "it does not add up");
}

/// The robot with slippery ground from 1 to 2 m, on which half of the turning is slip.
fn on_slippery_ground(robot: Robot) -> Plant {
    plant(Robot { slip_at_m: 1.0, slip_length_m: 1.0, slip_share: 0.5, ..robot })
}

#[test]
fn on_slippery_ground_the_robot_is_slower_by_the_share_and_its_wheels_turn_as_before() {
    let mut plant = on_slippery_ground(ideal());
    plant.drive(1.0, 0.0);
    let mut turned_m = 0.0;
    let mut after = |milliseconds: usize| {
        for _ in 0..milliseconds {
            let turns_per_way = plant.turns_per_way();
            turned_m += turns_per_way * plant.step(1e-3);
        }
        (plant.state().x, plant.speed(), turned_m)
    };
    // One second to the ground, two over it, and the step in which it ends is the slower one.
    for (milliseconds, x_m, speed_mps) in [(900, 0.9, 1.0), (1100, 1.5, 0.5), (1500, 2.5, 1.0)] {
        let (x, speed, turned) = after(milliseconds);
        assert!((x - x_m).abs() < 1.1e-3 && speed == speed_mps, "{x} m, {speed} m/s");
        assert!(
            (turned - x_m - if x_m > 1.0 { x_m.min(2.0) - 1.0 } else { 0.0 }).abs() < 2.2e-3,
            "{turned} m"
        );
    }
}

#[test]
fn a_robot_with_a_lag_settles_to_the_slower_speed_and_blocked_wheels_do_not_slip() {
    let mut plant = on_slippery_ground(lagging());
    plant.drive(0.4, 0.0);
    // 0.4 m/s t - 0.06 m of the lag.
    run(&mut plant, 4500);
    assert!((plant.speed() - 0.2).abs() < 1e-4, "{}", plant.speed());
    assert_eq!(plant.turns_per_way(), 2.0);
    plant.block();
    assert_eq!(plant.turns_per_way(), 1.0);
    let slid = run(&mut plant, 100);
    assert!((slid - 0.04 / 10.0).abs() < 1e-5, "v^2 / 2 a of the speed over ground: {slid}");
}

#[test]
fn a_smaller_wheel_pulls_to_its_side_and_makes_the_robot_slower_by_half_its_fraction() {
    let turned = |fraction: f64, robot: Robot| {
        let mut plant = plant(Robot { wheel_smaller: Some(fraction), width_m: 0.4, ..robot });
        plant.drive(1.005, 0.0);
        let way_m = run(&mut plant, 8000);
        // 8.04 m of the wheels, with 1.005 turns per way.
        assert!((way_m - 8.0).abs() < 1e-9 && plant.turns_per_way() == 1.005, "{way_m}");
        plant.state().yaw
    };
    // Half of 0.01 / 0.4 m is 0.0125 1/m, over 8 m 0.1 rad; the start of the turn takes a hundredth.
    let [left, right] = [0.01, -0.01].map(|fraction| turned(fraction, ideal()));
    assert!((left - 0.1).abs() < 1.5e-3 && (left + right).abs() < 1e-12, "{left} {right}");
    // Nothing holds a differential drive; its yaw rate lags.
    let differential = Robot { model: Some(VehicleModel::Differential), ..ideal() };
    assert!((turned(0.01, differential) - 0.2).abs() < 5e-3, "{}", turned(0.01, differential));
}

/// Drives in turns of its own over the whole range of what moves a robot.
fn extreme(numbers: [f64; 5], lags: [f64; 2], friction: f64) -> Plant {
    let [mass, rear, front, stiffness, inertia] =
        numbers.map(|exponent| Some(10f64.powf(exponent).clamp(1e-3, 1e6)));
    plant(Robot {
        mass_kg: mass,
        rear_m: rear,
        front_m: front,
        stiffness_n_per_rad: stiffness,
        inertia_kgm2: inertia,
        velocity_lag_s: Some(lags[0]),
        steering_lag_s: Some(lags[1]),
        acceleration_max_mps2: Some(100.0),
        deceleration_max_mps2: Some(100.0),
        steering_rate_max_radps: Some(100.0),
        tyre_friction: Some(friction),
        ..ideal()
    })
}

/// A lag that is allowed: none, or any time constant.
fn any_lag() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), (-9.0..0.3f64).prop_map(|exponent| 10f64.powf(exponent))]
}

proptest! {
    #[test]
    fn every_allowed_robot_stays_finite_and_drives_no_further_than_its_speed(
        numbers in prop::array::uniform5(-3.0..=6.0f64), lags in [any_lag(), any_lag()],
        friction in prop_oneof![Just(0.0), 0.05..5.0f64], velocity in 0.01..2.0f64, steering in -0.12..0.12f64,
    ) {
        let mut plant = extreme(numbers, lags, friction);
        let mut distance = 0.0;
        for turn in 0..4 {
            plant.drive(velocity, if turn % 2 == 0 { steering } else { -steering });
            distance += run(&mut plant, 200);
            prop_assert!(plant.state().is_finite(), "{plant:?}");
            prop_assert!((0.0..=velocity * (1.0 + 1e-9)).contains(&plant.speed()), "{plant:?}");
            prop_assert!(plant.steering().abs() <= steering.abs() + 1e-12, "{plant:?}");
        }
        let state = plant.state();
        prop_assert!(state.x.hypot(state.y) <= distance + 1e-9 && distance <= velocity * 0.8 + 1e-9);
        plant.block();
        run(&mut plant, 400);
        prop_assert!(plant.state().is_finite() && plant.speed() < velocity);
    }
}

#[test]
fn a_lag_far_shorter_than_a_step_is_none_and_does_not_chatter() {
    let mut short = plant(Robot { velocity_lag_s: Some(1e-6), steering_lag_s: Some(1e-6), ..lagging() });
    short.drive(0.8, 0.05);
    run(&mut short, 20);
    assert!((short.speed() - 0.8).abs() < 1e-9 && (short.steering() - 0.05).abs() < 1e-12, "{short:?}");
    let speeds = [0; 5].map(|_| (run(&mut short, 1), short.speed()).1);
    assert_eq!(speeds, [speeds[0]; 5]);
}

#[test]
fn stiff_tyres_that_slip_keep_the_steady_turn_of_soft_ones() {
    let turn = |stiffness: f64| {
        let mut plant =
            plant(Robot { stiffness_n_per_rad: Some(stiffness), tyre_friction: Some(0.8), ..ideal() });
        plant.drive(0.8, 0.05);
        run(&mut plant, 1000);
        (plant.state().yaw_rate, plant.state().sideslip)
    };
    let (soft, stiff) = (turn(2e4), turn(1e6));
    // The slip angles are below 1e-4 rad: the geometry of the axles alone decides.
    assert!(
        (soft.0 - stiff.0).abs() < 1e-3 * soft.0 && (soft.1 - stiff.1).abs() < 2e-4,
        "{soft:?} {stiff:?}"
    );
}
