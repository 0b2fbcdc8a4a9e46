//! Numbers that can be checked by hand, of a robot that follows at once and of one that lags.

use super::*;
use crate::learned::Learned;
use shared_types::Header;
use vehicle::integrate;

const MS: u64 = 1_000_000;

fn model(speed_weight: f64) -> MotionModel {
    let parameters = Parameters::default();
    MotionModel {
        parameters,
        bounds: Bounds::default(),
        blocked_deceleration_mps2: 5.0,
        speed_weight,
        delay_ns: 0,
        velocity_lag: Lag::default(),
        steering_lag: Lag::default(),
        learned: Learned::default(),
    }
}

fn actuation(from_ns: u64, kind: ActuationKind, velocity: f64, steering: f64) -> Actuation {
    let mut header = Header::default();
    header.stage_mut(Role::Actuator).published_ns = from_ns;
    Actuation {
        header,
        kind: kind.wire(),
        desired_velocity_mps: velocity,
        desired_steering_rad: steering,
        ..Actuation::default()
    }
}

fn drive(from_ns: u64, velocity: f64, steering: f64) -> Actuation {
    actuation(from_ns, ActuationKind::Drive, velocity, steering)
}

#[test]
fn an_interval_is_split_where_the_newer_actuation_took_effect() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(10 * MS, 0.5, 0.0));
    motion.note(&model(0.0), &drive(133 * MS, 0.8, 0.0));
    motion.begin(&model(0.0), 100 * MS, 0.5);
    let end = motion.advance(&model(0.0), Planar::default(), 100 * MS, 200 * MS, None).pose;
    // 33 ms at 0.5 m/s and 67 ms at 0.8 m/s.
    assert!((end.x - (0.033 * 0.5 + 0.067 * 0.8)).abs() < 1e-12, "{end:?}");
    assert_eq!(motion.speed_mps, 0.8);
}

#[test]
fn a_turn_is_that_of_the_model() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 0.6, 0.05));
    motion.speed_mps = 0.6;
    let mut pose = Planar { yaw: 0.3, x: 1.0, y: -0.5 };
    for step in 0..20 {
        pose = motion.advance(&model(1.0), pose, step * 100 * MS, (step + 1) * 100 * MS, Some(0.6)).pose;
    }
    let start = State { yaw: 0.3, x: 1.0, y: -0.5, ..State::default() };
    let control = Control { velocity: 0.6, steering: 0.05 };
    let exact = integrate::integrate(&Parameters::default(), &start, &control, 2.0);
    // The same method with the same steps.
    assert!((pose.yaw - exact.yaw).abs() < 1e-9 && (pose.x - exact.x).abs() < 1e-9);
    assert!((pose.y - exact.y).abs() < 1e-9 && (motion.sideslip_rad - exact.sideslip).abs() < 1e-9);
}

#[test]
fn blocked_wheels_slide_to_a_stop_and_keep_their_angle() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 1.0, 0.06));
    motion.begin(&model(0.0), 0, 1.0);
    motion.note(&model(0.0), &actuation(50 * MS, ActuationKind::Block, 0.0, 0.0));
    let end = motion.advance(&model(0.0), Planar::default(), 0, 1_000 * MS, None).pose;
    // 50 ms at 1 m/s and 1 / (2 * 5) m of sliding, on a circle of 3.1 m radius; the yaw rate of 0.32 rad/s lags
    // behind the falling speed by about 15 ms.
    let yaw = 0.15 / 3.1 + 0.32 * 0.015;
    assert!((end.yaw - yaw).abs() < 1.5e-3 && (end.x - 0.15).abs() < 2e-4, "{end:?}");
    assert_eq!((motion.speed_mps, motion.sideslip_rad, motion.yaw_rate_radps), (0.0, 0.0, 0.0));
}

#[test]
fn the_measured_speed_replaces_the_assumed_one_by_its_weight() {
    for (weight, expected) in [(0.0, 1.0), (0.5, 0.85), (1.0, 0.7)] {
        let mut motion = MotionState::default();
        motion.note(&model(0.0), &drive(0, 1.0, 0.0));
        motion.begin(&model(weight), 0, 0.0);
        // The control begins within the first interval, so the speed is constant after it took effect.
        motion.note(&model(0.0), &drive(1, 1.0, 0.01));
        motion.advance(&model(weight), Planar::default(), 0, 100 * MS, Some(0.7));
        assert!((motion.speed_mps - expected).abs() < 1e-12);
    }
}

#[test]
fn a_robot_that_stopped_by_itself_is_followed() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 1.0, 0.0));
    motion.begin(&model(1.0), 100 * MS, 1.0);
    let end = motion.advance(&model(1.0), Planar::default(), 100 * MS, 200 * MS, Some(0.0)).pose;
    assert!((end.x - 0.05).abs() < 1e-12 && motion.speed_mps == 0.0, "the mean of 1 and 0 m/s over 100 ms");
    let later = motion.advance(&model(1.0), end, 200 * MS, 300 * MS, Some(0.0)).pose;
    assert_eq!(later, end);
}

#[test]
fn a_speed_that_cannot_be_is_not_believed() {
    for wild in [f64::NAN, f64::INFINITY, 1e9, -3.0] {
        let mut motion = MotionState::default();
        motion.note(&model(0.0), &drive(0, 0.5, 0.0));
        motion.begin(&model(1.0), 0, 0.5);
        motion.advance(&model(1.0), Planar::default(), 0, 100 * MS, Some(wild));
        assert_eq!(motion.speed_mps, 0.5);
    }
}

#[test]
fn a_robot_that_was_told_to_reverse_does_and_another_does_not() {
    for model in [model(1.0), lagging()] {
        let mut motion = MotionState::default();
        motion.note(&model, &drive(0, -0.3, 0.05));
        let pose = motion.advance(&model, Planar::default(), 0, 1000 * MS, Some(-0.3)).pose;
        assert!((motion.speed_mps + 0.3).abs() < 1e-9 && pose.x < -0.2 && pose.y > 0.0, "{pose:?}");
        assert!(motion.yaw_rate_radps < 0.0);
        motion.note(&model, &actuation(1000 * MS, ActuationKind::Block, 0.0, 0.0));
        let rest = motion.advance(&model, pose, 1000 * MS, 1100 * MS, Some(0.0)).pose;
        // 0.3 m/s at 5 m/s^2: 9 mm.
        assert!(((rest.x - pose.x).hypot(rest.y - pose.y) - 0.009).abs() < 1e-4, "{rest:?}");
        assert_eq!((motion.speed_mps, motion.yaw_rate_radps), (0.0, 0.0));
        assert_eq!(motion.plausible_speed(&model, 1100 * MS, -0.3), None, "the wheels are blocked");
    }
}

#[test]
fn actuations_that_are_old_repeated_or_broken_change_nothing() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(50, 0.5, 0.01));
    let once = motion;
    motion.note(&model(0.0), &drive(50, 0.9, 0.0));
    motion.note(&model(0.0), &drive(40, 0.9, 0.0));
    motion.note(&model(0.0), &drive(60, 0.5, 0.01));
    motion.note(&model(0.0), &drive(70, f64::NAN, 0.0));
    motion.note(&model(0.0), &drive(70, 0.5, 1.0));
    motion.note(&model(0.0), &Actuation { kind: 7, ..drive(70, 0.5, 0.0) });
    assert_eq!(motion, once);
}

#[test]
fn the_oldest_of_many_actuations_is_forgotten() {
    let mut motion = MotionState::default();
    for index in 1..=20_u32 {
        let mut sent = drive(u64::from(index) * MS, 0.02 * f64::from(index), 0.0);
        sent.header.acquired_ns = u64::from(index) * MS;
        motion.note(&model(0.0), &sent);
    }
    assert_eq!(motion.controls().len(), HISTORY);
    assert_eq!((motion.controls()[0].from_ns, motion.controls()[HISTORY - 1].from_ns), (13 * MS, 20 * MS));
}

#[test]
fn of_more_actuations_on_their_way_than_are_remembered_neighbours_are_one() {
    // 40 on their way: the delay is 40 ms at 1000 Hz. The steering angle grows by 0.1 mrad with each.
    let mut motion = MotionState::default();
    let delayed = MotionModel { delay_ns: 40 * MS, ..model(0.0) };
    for index in 1..=200_u64 {
        let mut sent = drive(index * MS, 0.5, 1e-4 * index as f64);
        sent.header.acquired_ns = index * MS;
        motion.note(&delayed, &sent);
        if index < 60 {
            continue;
        }
        assert_eq!(motion.controls().len(), HISTORY);
        assert!(motion.controls().array_windows().all(|[one, other]| one.from_ns < other.from_ns));
        // In force now is what was sent 40 ms ago, and in what is on its way no control is further off than a quarter of it.
        for ahead in 0..=40 {
            let then_rad = 1e-4 * (index - 40 + ahead) as f64;
            let found_rad = motion.in_force((index + ahead) * MS).unwrap().steering_rad;
            assert!((found_rad - then_rad).abs() < 1e-3, "{index} {ahead}: {found_rad} {then_rad}");
        }
    }
    // A block among them is remembered as what it is.
    let mut block = drive(201 * MS, 0.0, 0.0);
    (block.kind, block.header.acquired_ns) = (ActuationKind::Block.wire(), 201 * MS);
    motion.note(&delayed, &block);
    for index in 202..=230_u64 {
        let mut sent = drive(index * MS, 0.5, 1e-4 * index as f64);
        sent.header.acquired_ns = index * MS;
        motion.note(&delayed, &sent);
        let blocked: Vec<u64> = motion
            .controls()
            .iter()
            .filter(|control| control.drives == 0)
            .map(|control| control.from_ns)
            .collect();
        assert_eq!(blocked, [241 * MS], "{index}");
    }
}

#[test]
fn crawling_stays_finite_and_turns_slowly() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 0.001, 0.06));
    let end = motion.advance(&model(0.0), Planar::default(), 0, 2_000 * MS, None).pose;
    assert!(end.yaw.abs() < 0.05 && (end.x - 0.002).abs() < 1e-3, "{end:?}");
}

/// [`lagging`], reached by its commands after 20 ms.
fn delayed() -> MotionModel {
    MotionModel { delay_ns: 20 * MS, ..lagging() }
}

/// The SUMMIT with its lags, and no delay.
fn lagging() -> MotionModel {
    let rate = 0.5;
    MotionModel {
        velocity_lag: Lag { time_constant_s: 0.15, rise_per_s: 2.0, fall_per_s: 3.0 },
        steering_lag: Lag { time_constant_s: 0.1, rise_per_s: rate, fall_per_s: rate },
        ..model(1.0)
    }
}

/// Speed, steering angle and place of a plant with these lags, by Euler steps of 20 microseconds: an independent
/// integration of the same differential equations.
fn plant(controls: &[(u64, f64, f64)], until_ms: u64) -> (State, f64, f64) {
    let (mut state, mut speed, mut steering) = (State::default(), 0.0_f64, 0.0_f64);
    let step_s = 2e-5;
    for step in 0..until_ms * 50 {
        let now = controls.iter().rfind(|(from_ms, ..)| from_ms * 50 <= step);
        let Some((_, velocity, angle)) = now else { continue };
        let slope = vehicle::model::derivative_at(&Parameters::default(), &state, speed, steering);
        state = State::from_vector(&(state.to_vector() + slope * step_s));
        let (lowest, highest) = if speed + velocity < 0.0 { (-2.0, 3.0) } else { (-3.0, 2.0) };
        speed += ((velocity - speed) / 0.15).clamp(lowest, highest) * step_s;
        steering += ((angle - steering) / 0.1).clamp(-0.5, 0.5) * step_s;
    }
    (state, speed, steering)
}

#[test]
fn a_prediction_is_where_a_plant_with_the_same_lags_gets_to() {
    for side in [1.0, -1.0] {
        predicts_as_a_plant(side);
    }
}

fn predicts_as_a_plant(side: f64) {
    let controls = [(20, 1.0 * side, 0.06), (130, 0.4 * side, -0.06), (250, 0.9 * side, 0.02)];
    let mut motion = MotionState::default();
    for (from_ms, velocity, steering) in controls {
        motion.note(&delayed(), &drive(from_ms * MS - 20 * MS, velocity, steering));
    }
    let end = motion.advance(&lagging(), Planar::default(), 0, 400 * MS, None).pose;
    let (state, speed, steering) = plant(&controls, 400);
    // Steps of 5 ms against Euler steps, whose own error is 2e-5 s times the rates: 1e-4 rad in the yaw, 4e-5 m/s.
    assert!((motion.speed_mps - speed).abs() < 1e-4 && (motion.steering_rad - steering).abs() < 1e-5);
    assert!((end.x - state.x).abs() < 1e-4 && (end.y - state.y).abs() < 1e-4, "{end:?} {state:?}");
    assert!((end.yaw - state.yaw).abs() < 1e-4 && (motion.yaw_rate_radps - state.yaw_rate).abs() < 1e-3);
    assert!((motion.expected_mps - motion.speed_mps).abs() < 1e-12, "nothing was measured");
}

#[test]
fn a_command_acts_after_its_delay() {
    let mut motion = MotionState::default();
    motion.note(&delayed(), &drive(10 * MS, 1.0, 0.06));
    let before = motion.advance(&lagging(), Planar::default(), 0, 30 * MS, None).pose;
    assert_eq!((before, motion.speed_mps, motion.steering_rad), (Planar::default(), 0.0, 0.0));
    motion.advance(&lagging(), Planar::default(), 30 * MS, 80 * MS, None);
    // 50 ms at 2 m/s^2; 0.01 rad at 0.5 rad/s, the rest of 0.05 rad exponentially for 30 ms.
    let steering = 0.06 - 0.05 * (-0.3_f64).exp();
    assert!((motion.speed_mps - 0.1).abs() < 1e-12 && (motion.steering_rad - steering).abs() < 1e-12);
}

#[test]
fn blocked_wheels_keep_the_angle_that_they_have_reached() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 1.0, 0.06));
    motion.advance(&lagging(), Planar::default(), 0, 50 * MS, Some(0.5));
    let reached = 0.06 - 0.05 * (-0.3_f64).exp();
    motion.note(&delayed(), &actuation(30 * MS, ActuationKind::Block, 0.0, 0.0));
    let end = motion.advance(&lagging(), Planar::default(), 50 * MS, 250 * MS, None).pose;
    // 0.25 m^2/s^2 over 10 m/s^2.
    assert!((end.x - 0.025).abs() < 1e-4 && (motion.steering_rad - reached).abs() < 1e-12, "{end:?}");
    assert_eq!((motion.speed_mps, motion.yaw_rate_radps), (0.0, 0.0));
}

#[test]
fn a_drive_that_is_quicker_than_described_is_followed_and_the_difference_is_doubt() {
    let mut motion = MotionState::default();
    motion.note(&model(0.0), &drive(0, 0.5, 0.0));
    motion.begin(&lagging(), 0, 0.5);
    motion.note(&model(0.0), &drive(1, 0.7, 0.0));
    let moved = motion.advance(&lagging(), Planar::default(), 0, 100 * MS, Some(0.7));
    assert!((motion.speed_mps - 0.7).abs() < 1e-12);
    // The lag explains 0.2 (1 - exp(-2/3)) m/s; the rest grew evenly, or at once: 0.289 times its distance in 0.1 s.
    let explained = 0.7 - 0.2 * (-0.1_f64 / 0.15).exp();
    assert!((motion.expected_mps - explained).abs() < 1e-8);
    assert!((moved.ahead_m - 0.289 * (0.7 - explained) * 0.1).abs() < 1e-8 && moved.yaw_rad == 0.0);
    let distance = 0.07 - 0.2 * 0.15 * (1.0 - (-0.1_f64 / 0.15).exp()) + (0.7 - explained) * 0.05;
    assert!((moved.pose.x - distance).abs() < 1e-5, "{moved:?}");
}
