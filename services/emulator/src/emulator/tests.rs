use super::*;
use shared_types::{BlockReason, FRONT_BEAM};

const PERIOD: u64 = 100_000_000;

fn parse(text: &str) -> Scenario {
    Scenario::parse(text, "test").unwrap()
}

/// A robot that follows its commands exactly.
fn ideal(more: &str) -> Emulator {
    let robot = "[robot]\nvelocity_factor = 1.0\nsteering_map = \"identity\"\nodometry_longitudinal = 0.0";
    Emulator::new(&parse(&format!("{robot}\n[noise]\nrange_m = 0.0\n{more}")), PERIOD)
}

fn drive(velocity: f64, steering: f64) -> Actuation {
    Actuation {
        kind: ActuationKind::Drive.wire(),
        sent_velocity_mps: velocity,
        sent_steering_rad: steering,
        ..Actuation::default()
    }
}

fn block() -> Actuation {
    Actuation { reason: BlockReason::Commanded.wire(), ..Actuation::default() }
}

fn measure(emulator: &mut Emulator, scan_id: u64) -> (Scan, Odometry, Truth) {
    let (mut scan, mut odometry, mut truth) = Default::default();
    emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
    (scan, odometry, truth)
}

/// Runs scans in lock-step: the actuation for a scan acts when the scan is complete.
fn lockstep(emulator: &mut Emulator, scans: std::ops::RangeInclusive<u64>, actuation: &Actuation) -> Truth {
    let mut last = Truth::default();
    for scan_id in scans {
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        last = measure(emulator, scan_id).2;
        emulator.actuate(actuation);
    }
    last
}

#[test]
fn the_first_sweep_fits_after_the_start_and_is_ready_a_third_later() {
    let emulator = ideal("");
    assert_eq!(emulator.acquired_ns(1), 100_000_000);
    assert_eq!(emulator.scan_ready_ns(1), 133_333_333);
    assert_eq!(emulator.sweep_ns(), 66_666_666);
    let sweep = Sweep { scan_id: 1, front_ns: emulator.acquired_ns(1), duration_ns: emulator.sweep_ns() };
    assert_eq!(sweep.beam_ns(FRONT_BEAM, FRONT_BEAM, 682), 100_000_000);
    assert!(
        sweep.beam_ns(681, FRONT_BEAM, 682) <= emulator.scan_ready_ns(1)
            && sweep.beam_ns(0, FRONT_BEAM, 682) > 66_000_000
    );
}

#[test]
fn before_the_first_actuation_the_robot_stands_with_blocked_wheels() {
    let mut emulator = ideal("");
    emulator.advance_to(1_000_000_000);
    let (_, odometry, truth) = measure(&mut emulator, 9);
    assert_eq!((truth.x_m, truth.speed_mps, truth.blocked, truth.dead_man), (0.0, 0.0, 1, 0));
    assert_eq!((odometry.x_m, odometry.y_m, odometry.yaw_rad), (0.0, 0.0, 0.0));
    assert_eq!(truth.steps, 1000);
}

#[test]
fn an_actuation_acts_at_the_time_of_the_clock_within_a_step() {
    let mut emulator = ideal("");
    emulator.advance_to(133_333_333);
    assert_eq!(emulator.actuate(&drive(1.0, 0.0)), Received::Accepted);
    emulator.advance_to(emulator.scan_ready_ns(2));
    let (_, odometry, truth) = measure(&mut emulator, 2);
    // From 133.333333 ms to the front beam at 200 ms with 1 m/s.
    assert!((truth.x_m - 0.066_666_667).abs() < 1e-12, "{}", truth.x_m);
    assert_eq!((truth.time_s, truth.speed_mps, odometry.speed_mps), (0.2, 1.0, 1.0));
    assert!((odometry.x_m - truth.x_m).abs() < 1e-12);
    // To the end of the sweep, 100 ms.
    assert!((emulator.present().state.x - 0.1).abs() < 1e-12);
}

#[test]
fn the_robots_own_dead_man_blocks_after_two_periods_to_the_nanosecond() {
    let mut emulator = ideal("[track]\nx_m = [0.0, 100.0]");
    emulator.advance_to(133_333_333);
    emulator.actuate(&drive(1.0, 0.0));
    emulator.advance_to(1_000_000_000);
    let truth = measure(&mut emulator, 9).2;
    assert_eq!((truth.blocked, truth.dead_man, truth.speed_mps), (1, 1, 0.0));
    assert!((truth.longest_blind_s - 0.2).abs() < 1e-12, "{}", truth.longest_blind_s);
    // 0.2 m driven and 1 / (2 * 5) m slid.
    assert!((truth.path_length_m - 0.3).abs() < 1e-9 && (truth.x_m - 0.3).abs() < 1e-9);
}

#[test]
fn in_lockstep_the_blind_time_is_one_period() {
    let mut emulator = ideal("");
    let truth = lockstep(&mut emulator, 1..=30, &drive(0.9, 0.0));
    assert!((truth.longest_blind_s - 0.1).abs() < 1e-12);
    assert!((truth.actuation_age_s - 0.1).abs() < 1e-12);
    assert_eq!(truth.dead_man, 0);
}

#[test]
fn impossible_actuations_are_refused_and_do_not_feed_the_dead_man() {
    let mut emulator = ideal("");
    lockstep(&mut emulator, 1..=5, &drive(0.9, 0.0));
    let refused = [
        drive(f64::NAN, 0.0),
        drive(0.5, f64::INFINITY),
        drive(2.01, 0.0),
        drive(-2.01, 0.0),
        drive(0.5, 0.121),
        Actuation { kind: 9, ..Actuation::default() },
    ];
    for (index, actuation) in refused.iter().enumerate() {
        emulator.advance_to(emulator.scan_ready_ns(6 + index as u64));
        assert_eq!(emulator.actuate(actuation), Received::Refused);
    }
    let truth = measure(&mut emulator, 11).2;
    assert_eq!((truth.refused, truth.blocked, truth.dead_man), (6, 1, 1));
    assert!((truth.longest_blind_s - 0.2).abs() < 1e-12);
}

#[test]
fn a_block_with_nan_in_it_still_blocks() {
    let mut emulator = ideal("");
    lockstep(&mut emulator, 1..=5, &drive(0.9, 0.0));
    let invalid = Actuation { sent_velocity_mps: f64::NAN, ..block() };
    assert_eq!(emulator.actuate(&invalid), Received::Accepted);
    emulator.advance_to(emulator.scan_ready_ns(10));
    assert_eq!(measure(&mut emulator, 10).2.speed_mps, 0.0);
}

#[test]
fn driving_into_a_box_is_a_collision_and_ends_the_motion() {
    let mut emulator =
        ideal("[[obstacle]]\nshape = \"box\"\nx_m = 1.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 0.4");
    let truth = lockstep(&mut emulator, 1..=20, &drive(1.0, 0.0));
    assert_eq!((truth.collided, truth.struck, truth.speed_mps), (1, 0, 0.0));
    // The front, 0.28 m ahead, meets the face at 1 m within one plant step.
    assert!((0.72..0.7211).contains(&truth.x_m), "{}", truth.x_m);
    assert!((-0.0011..=0.0).contains(&truth.min_clearance_m));
}

#[test]
fn a_robot_that_reverses_reports_it_and_collides_with_its_rear() {
    let mut emulator =
        ideal("[[obstacle]]\nshape = \"box\"\nx_m = -1.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 0.4");
    lockstep(&mut emulator, 1..=10, &drive(-0.5, 0.0));
    emulator.advance_to(emulator.scan_ready_ns(11));
    let (_, odometry, truth) = measure(&mut emulator, 11);
    assert_eq!((truth.speed_mps, odometry.speed_mps), (-0.5, -0.5));
    assert!(odometry.dx_m < -0.04 && truth.x_m < -0.4 && truth.path_length_m > 0.4, "{truth:?}");
    let truth = lockstep(&mut emulator, 12..=40, &drive(-0.5, 0.0));
    assert_eq!((truth.collided, truth.struck, truth.speed_mps), (1, 0, 0.0));
    assert!((-0.7206..=-0.72).contains(&truth.x_m), "{}", truth.x_m);
}

#[test]
fn touching_a_wall_is_a_collision() {
    let mut emulator = ideal("[start]\nyaw_rad = 0.5\n[track]\nwalls = true\ny_m = [-1.0, 1.0]");
    let truth = lockstep(&mut emulator, 1..=60, &drive(0.5, 0.0));
    assert_eq!(truth.collided, 1);
    // The front left corner reaches y = 1: centre + 0.28 sin 0.5 + 0.2 cos 0.5 = 1.
    assert!((truth.y_m - (1.0 - 0.28 * 0.5_f64.sin() - 0.2 * 0.5_f64.cos())).abs() < 1e-3);
}

#[test]
fn a_moving_obstacle_that_meets_the_standing_robot_strikes_it() {
    let mut emulator =
        ideal("[[obstacle]]\nshape = \"circle\"\nx_m = 1.28\ny_m = 0\nradius_m = 0.5\nvelocity_x_mps = -0.5");
    let truth = lockstep(&mut emulator, 1..=9, &block());
    assert_eq!((truth.struck, truth.collided), (0, 0));
    // Surface at 0.78, front at 0.28: contact after 1 s.
    let truth = lockstep(&mut emulator, 10..=12, &block());
    assert_eq!((truth.struck, truth.collided), (1, 0));
}

#[test]
fn clearances_are_those_of_the_plant_steps_and_of_the_front_beam() {
    let mut emulator = ideal("[[obstacle]]\nshape = \"circle\"\nx_m = 1.0\ny_m = 0.7\nradius_m = 0.3");
    let truth = lockstep(&mut emulator, 1..=40, &drive(1.0, 0.0));
    // Side of the body at 0.2, surface at 0.4; the body passes by and is far behind it at the end.
    assert!((truth.min_clearance_m - 0.2).abs() < 1e-6, "{}", truth.min_clearance_m);
    let tail = truth.x_m - 0.28 - 1.0;
    assert!((truth.clearance_m - (tail.hypot(0.5) - 0.3)).abs() < 1e-9);
}

#[test]
fn small_portions_of_time_and_more_measurements_change_no_bit() {
    let scenario = parse(Scenario::shipped("imperfect-robot").unwrap());
    let (mut whole, mut parts) = (Emulator::new(&scenario, PERIOD), Emulator::new(&scenario, PERIOD));
    for scan_id in 1..=40 {
        let ready = whole.scan_ready_ns(scan_id);
        whole.advance_to(ready);
        for part in (0..7).rev() {
            parts.advance_to(ready - part * 3_333_337);
            if part > 0 {
                let mut unused = Default::default();
                parts.clone().measure(scan_id, &mut Scan::default(), &mut Odometry::default(), &mut unused);
                let before = parts.history.clone();
                parts.laser.measure(
                    &Sweep { scan_id, front_ns: ready, duration_ns: 1000 },
                    &before,
                    &parts.scene,
                    &mut [0; shared_types::BEAMS],
                );
            }
        }
        let (one, other) = (measure(&mut whole, scan_id), measure(&mut parts, scan_id));
        assert_eq!(bytemuck_bytes(&one), bytemuck_bytes(&other));
        let steering = 0.05 * (scan_id as f64 * 0.3).sin();
        whole.actuate(&drive(1.2, steering));
        parts.actuate(&drive(1.2, steering));
    }
}

#[test]
fn two_equal_runs_give_identical_bytes_and_another_seed_does_not() {
    let run = |seed: u64| {
        let mut scenario = parse(Scenario::shipped("noisy").unwrap());
        scenario.seed = seed;
        let mut emulator = Emulator::new(&scenario, PERIOD);
        let mut samples = Vec::new();
        for scan_id in 1..=30 {
            emulator.advance_to(emulator.scan_ready_ns(scan_id));
            samples.push(bytemuck_bytes(&measure(&mut emulator, scan_id)));
            emulator.actuate(&drive(1.2, 0.01));
        }
        samples
    };
    assert!(run(1) == run(1));
    assert!(run(1) != run(2));
}

#[test]
fn laser_noise_does_not_change_the_odometry() {
    let run = |range_m: f64| {
        let mut scenario = parse(Scenario::shipped("noisy").unwrap());
        scenario.noise.range_m = range_m;
        let mut emulator = Emulator::new(&scenario, PERIOD);
        lockstep(&mut emulator, 1..=9, &drive(1.2, 0.0));
        emulator.advance_to(emulator.scan_ready_ns(10));
        measure(&mut emulator, 10).1
    };
    assert_eq!(run(0.0), run(0.03));
}

#[test]
fn the_body_turns_on_circles_without_a_jump_and_reports_wrapped_angles() {
    let mut emulator = ideal("[track]\nx_m = [-1000.0, 1000.0]\ny_m = [-1000.0, 1000.0]");
    for scan_id in 1..=300 {
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        let (_, odometry, truth) = measure(&mut emulator, scan_id);
        assert!(truth.yaw_rad.abs() <= std::f64::consts::PI && odometry.dyaw_rad.abs() < 0.04);
        emulator.actuate(&drive(1.0, 0.06));
    }
    assert!(emulator.plant().state().yaw > 9.0);
}

#[test]
fn strange_requests_never_panic() {
    let mut emulator = Emulator::new(&parse(Scenario::shipped("corridor").unwrap()), 0);
    measure(&mut emulator, 0);
    measure(&mut emulator, u64::MAX);
    emulator.advance_to(0);
    emulator.actuate(&drive(f64::NEG_INFINITY, f64::NAN));
    measure(&mut emulator, 3);
}

/// Prints what a scan costs; no claim is made of the machine the tests run on.
#[test]
fn a_scan_period_costs_far_less_than_a_scan_period() {
    let mut emulator = Emulator::new(&parse(Scenario::shipped("slalom").unwrap()), PERIOD);
    let (mut scan, mut odometry, mut truth) = Default::default();
    let (mut moving, mut measuring) = (std::time::Duration::ZERO, std::time::Duration::ZERO);
    let scans = 200;
    for scan_id in 1..=scans {
        let start = std::time::Instant::now();
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        let moved = std::time::Instant::now();
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        measuring += moved.elapsed();
        moving += moved - start;
        emulator.actuate(&drive(1.2, 0.03 * (scan_id as f64 * 0.2).sin()));
    }
    println!("plant {:?} and measurement {:?} per scan", moving / scans as u32, measuring / scans as u32);
    assert!((moving + measuring) / (scans as u32) < std::time::Duration::from_millis(100));
}

/// The bytes of all samples, so that -0.0 and 0.0 differ.
fn bytemuck_bytes((scan, odometry, truth): &(Scan, Odometry, Truth)) -> (Vec<u32>, Vec<u64>) {
    let numbers = [
        odometry.x_m,
        odometry.y_m,
        odometry.yaw_rad,
        odometry.dx_m,
        odometry.dy_m,
        odometry.dyaw_rad,
        odometry.dt_s,
        odometry.speed_mps,
        truth.time_s,
        truth.x_m,
        truth.y_m,
        truth.yaw_rad,
        truth.sideslip_rad,
        truth.yaw_rate_radps,
        truth.speed_mps,
        truth.steering_rad,
        truth.clearance_m,
        truth.min_clearance_m,
        truth.path_length_m,
        truth.max_abs_lateral_m,
        truth.goal_distance_m,
        truth.longest_blind_s,
        truth.actuation_age_s,
    ];
    let mut bits: Vec<u64> = numbers.iter().map(|number| number.to_bits()).collect();
    bits.extend([truth.steps, truth.refused, u64::from(truth.blocked), u64::from(truth.collided)]);
    (scan.ranges().to_vec(), bits)
}

/// A scene with everything that is remembered: triggers, moving bodies, noise, drift and play.
fn eventful() -> Scenario {
    parse(
        "[track]\nwalls = true\n[robot]\nodometry_lateral_rate = 0.05\nsteering_backlash_rad = 0.005\n\
         [noise]\nodometry_m = 0.01\nodometry_rad = 0.005\ndropout = 0.02\nmixed_pixels = 0.5\n\
         [[obstacle]]\nshape = \"circle\"\nx_m = 2.5\ny_m = 0.9\nradius_m = 0.1\nappears_ahead_m = 1.0\nvelocity_y_mps = 0.1\n\
         [[obstacle]]\nshape = \"box\"\nx_m = 3.5\ny_m = -0.9\nlength_m = 0.2\nwidth_m = 0.2\nappears_s = 2.0",
    )
}

#[test]
fn one_that_continues_from_a_state_measures_the_same_to_the_last_bit() {
    continues_after(12, &eventful());
    // Far from its start on a course: the lateral position is that at its place.
    continues_after(50, &parse(Scenario::shipped("figure-eight").unwrap()));
}

fn continues_after(scans: u64, scenario: &Scenario) {
    let mut old = Emulator::new(scenario, PERIOD);
    let actuation = |scan_id: u64| {
        let steering = 0.06 * (scan_id as f64 * 0.7).sin();
        if scan_id.is_multiple_of(11) { block() } else { drive(0.9, steering) }
    };
    let step = |robots: &mut [&mut Emulator], scan_id: u64| {
        let samples: Vec<_> = robots
            .iter_mut()
            .map(|robot| {
                robot.advance_to(robot.scan_ready_ns(scan_id));
                let samples = measure(robot, scan_id);
                // A command that acts within a step of the plant.
                robot.advance_to(robot.scan_ready_ns(scan_id) + 700_123);
                robot.actuate(&actuation(scan_id));
                samples
            })
            .collect();
        assert!(samples.windows(2).all(|pair| pair[0] == pair[1]), "scan {scan_id}");
        samples[0].2.path_length_m
    };
    for scan_id in 1..=scans {
        step(&mut [&mut old], scan_id);
    }
    let mut new = Emulator::new(scenario, PERIOD);
    new.resume(&old.state(scans).unwrap()).unwrap();
    let mut way_m = 0.0;
    for scan_id in scans + 1..=scans + 18 {
        way_m = step(&mut [&mut old, &mut new], scan_id);
    }
    assert!(way_m > 1.2, "it drove: {way_m}");
    assert_eq!(old.state(scans + 18), new.state(scans + 18));
}

#[test]
fn a_state_is_given_away_only_until_the_next_sweep_begins() {
    let mut emulator = ideal("");
    emulator.advance_to(emulator.scan_ready_ns(1));
    assert!(emulator.state(1).is_some());
    emulator.advance_to(emulator.scan_ready_ns(2) - emulator.sweep_ns());
    assert!(emulator.state(1).is_some());
    emulator.advance_to(emulator.now_ns() + 1);
    assert!(emulator.state(1).is_none());
}

#[test]
fn a_time_in_the_far_future_takes_ten_minutes_of_steps_at_most() {
    let mut emulator = ideal("");
    emulator.advance_to(u64::MAX);
    assert_eq!(emulator.now_ns(), MAX_AHEAD_NS);
}

#[test]
fn a_state_of_another_scene_or_with_impossible_numbers_is_refused() {
    let mut emulator = Emulator::new(&eventful(), PERIOD);
    emulator.advance_to(emulator.scan_ready_ns(1));
    let good = emulator.state(1).unwrap();
    assert!(ideal("").resume(&good).is_err(), "an obstacle that is not in the scene");
    let bad = EmulatorState { speed_mps: f64::NAN, ..good };
    assert_eq!(emulator.resume(&bad), Err(shared_types::Fault::NotFinite { field: "speed_mps" }));
    for bad in [
        EmulatorState { plant_ns: good.clock_ns + 1, ..good },
        // The plant would have to take steps for ever.
        EmulatorState { clock_ns: u64::MAX, ..good },
        EmulatorState { last_actuation_ns: good.clock_ns + 1, ..good },
    ] {
        assert!(emulator.resume(&bad).is_err());
    }
    assert_eq!(emulator.state(1), Some(good), "unchanged");
}

/// A robot whose commands take exactly 25 ms.
fn delayed(more: &str) -> Emulator {
    let way =
        "command_delay_s = 0.025\ncommand_jitter_s = 0.0\nvelocity_factor = 1.0\nsteering_map = \"identity\"";
    Emulator::new(&parse(&format!("[robot]\n{way}\n{more}")), PERIOD)
}

#[test]
fn a_command_acts_when_it_arrives_to_the_nanosecond_and_feeds_the_dead_man_then() {
    let mut emulator = delayed("");
    emulator.advance_to(133_333_333);
    assert_eq!(emulator.actuate(&drive(1.0, 0.0)), Received::Accepted);
    emulator.advance_to(158_333_332);
    assert!(emulator.plant().is_blocked());
    emulator.advance_to(200_000_000);
    // 200 - 158.333333 ms at 1 m/s.
    assert!((emulator.plant().state().x - 0.041_666_667).abs() < 1e-12, "{}", emulator.plant().state().x);
    emulator.advance_to(1_000_000_000);
    let truth = measure(&mut emulator, 9).2;
    assert_eq!((truth.dead_man, truth.blocked), (1, 1));
    assert!((truth.longest_blind_s - 0.2).abs() < 1e-12, "{}", truth.longest_blind_s);
    assert!((truth.actuation_age_s - (1.0 - 0.158_333_333)).abs() < 1e-12);
    assert!((truth.path_length_m - 0.3).abs() < 1e-9, "{}", truth.path_length_m);
}

#[test]
fn a_block_travels_as_well_but_a_stop_of_the_process_acts_at_once_and_for_all() {
    let mut emulator = delayed("");
    lockstep(&mut emulator, 1..=5, &drive(0.9, 0.0));
    emulator.actuate(&block());
    emulator.advance_to(emulator.now_ns() + 24_999_999);
    assert!(!emulator.plant().is_blocked());
    emulator.advance_to(emulator.now_ns() + 1);
    assert!(emulator.plant().is_blocked());
    emulator.actuate(&drive(0.9, 0.0));
    emulator.advance_to(emulator.now_ns() + 25_000_000);
    assert!(!emulator.plant().is_blocked());
    emulator.actuate(&drive(0.9, 0.0));
    emulator.block_at_once();
    assert!(emulator.plant().is_blocked());
    emulator.advance_to(emulator.now_ns() + 50_000_000);
    assert!(emulator.plant().is_blocked(), "the command that was on its way never arrives");
}

#[test]
fn after_lost_commands_the_last_one_stays_in_force_until_the_dead_man_acts() {
    let mut emulator = ideal("");
    lockstep(&mut emulator, 1..=5, &drive(0.9, 0.0));
    let lossy = "[robot]\ncommand_loss = 1.0\nvelocity_factor = 1.0";
    let mut deaf = Emulator::new(&parse(lossy), PERIOD);
    deaf.resume(&emulator.state(5).unwrap()).unwrap();
    deaf.advance_to(deaf.scan_ready_ns(6));
    assert_eq!(deaf.actuate(&drive(0.2, 0.0)), Received::Accepted);
    deaf.advance_to(deaf.scan_ready_ns(6) + 50_000_000);
    assert_eq!((deaf.plant().speed(), deaf.plant().is_blocked()), (0.9, false));
    deaf.actuate(&block());
    deaf.advance_to(deaf.scan_ready_ns(7) + 1_000_000);
    assert!(deaf.plant().is_blocked(), "two periods after the last that arrived");
    assert_eq!(measure(&mut deaf, 7).2.dead_man, 1);
}

#[test]
fn the_scan_that_was_answered_is_known_when_the_answer_arrives() {
    let mut emulator = delayed("");
    emulator.advance_to(emulator.scan_ready_ns(1));
    let mut answer = Actuation { answers: 1, ..drive(0.5, 0.0) };
    answer.header.scan_id = 1;
    emulator.actuate(&answer);
    assert_eq!(measure(&mut emulator, 1).2.actuation_scan, 0);
    emulator.advance_to(emulator.scan_ready_ns(2));
    assert_eq!(measure(&mut emulator, 2).2.actuation_scan, 1);
}

#[test]
fn measured_speed_and_time_are_those_of_encoders_and_stamps() {
    let scenario = parse("[robot]\npreset = \"summit\"");
    let mut emulator = Emulator::new(&scenario, PERIOD);
    let mut last = emulator.stamp_ns(1);
    let mut differs = false;
    for scan_id in 1..=40 {
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        let (_, odometry, truth) = measure(&mut emulator, scan_id);
        let stamp_ns = emulator.stamp_ns(scan_id);
        assert!((odometry.dt_s - (stamp_ns - last) as f64 * 1e-9).abs() < 1e-12);
        assert!((truth.time_s - 0.1 * scan_id as f64).abs() < 1e-12);
        differs |= (odometry.speed_mps - truth.speed_mps).abs() > 1e-3;
        last = stamp_ns;
        emulator.actuate(&drive(1.2, 0.0));
    }
    assert!(differs);
    assert!(emulator.plant().speed() > 0.8);
}

/// A robot with everything that differs from the model, and the scene with everything that is remembered.
fn eventful_summit() -> Scenario {
    let mut scenario = eventful();
    scenario.robot.preset = crate::scenario::Preset::Summit;
    scenario.robot.command_delay_s = Some(0.13);
    scenario.robot.command_jitter_s = Some(0.02);
    scenario.robot.command_loss = Some(0.05);
    scenario
}

#[test]
fn with_commands_on_their_way_a_successor_measures_the_same_to_the_last_bit_however_time_is_cut() {
    let scenario = eventful_summit();
    let (mut old, mut parts) = (Emulator::new(&scenario, PERIOD), Emulator::new(&scenario, PERIOD));
    let mut new = None::<Emulator>;
    for scan_id in 1..=40 {
        let ready = old.scan_ready_ns(scan_id);
        old.advance_to(ready);
        (0..9).rev().for_each(|part| {
            parts.advance_to(ready - part * 3_333_337);
            parts.present();
        });
        let (one, other) = (measure(&mut old, scan_id), measure(&mut parts, scan_id));
        assert_eq!(bytemuck_bytes(&one), bytemuck_bytes(&other), "scan {scan_id}");
        if let Some(new) = &mut new {
            new.advance_to(ready);
            assert_eq!(bytemuck_bytes(&one), bytemuck_bytes(&measure(new, scan_id)), "scan {scan_id}");
        }
        let steering = 0.06 * (scan_id as f64 * 0.7).sin();
        let mut actuation = if scan_id % 11 == 0 { block() } else { drive(1.2, steering) };
        (actuation.header.scan_id, actuation.answers) = (scan_id, 1);
        for robot in [&mut old, &mut parts].into_iter().chain(&mut new) {
            robot.advance_to(ready + 700_123);
            robot.actuate(&actuation);
        }
        if scan_id == 12 {
            let state = old.state(12).unwrap();
            assert!(!state.travelling.list().is_empty());
            let mut robot = Emulator::new(&scenario, PERIOD);
            robot.resume(&state).unwrap();
            new = Some(robot);
        }
    }
    let way_m = measure(&mut old, 40).2.path_length_m;
    assert!(way_m > 1.0, "it drove: {way_m}");
    assert_eq!(Some(old.state(40).unwrap()), new.and_then(|new| new.state(40)));
}

#[test]
fn a_state_with_commands_out_of_order_is_refused() {
    let mut emulator = delayed("");
    emulator.advance_to(emulator.scan_ready_ns(1));
    emulator.actuate(&drive(0.5, 0.0));
    emulator.actuate(&drive(0.6, 0.0));
    let mut bad = emulator.state(1).unwrap();
    bad.travelling.items[1].arrives_ns = 1;
    assert!(emulator.resume(&bad).is_err());
    let mut bad = emulator.state(1).unwrap();
    bad.travelling.items[0].velocity_mps = f64::NAN;
    assert!(emulator.resume(&bad).is_err());
}

#[test]
fn a_late_scan_shows_what_was_there_when_it_was_taken_and_the_robot_has_moved_on() {
    let wall = "[[obstacle]]\nshape = \"box\"\nx_m = 4.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 4";
    let (mut prompt, mut late) = (ideal(wall), ideal(&format!("{wall}\n[scanner]\nlate_s = 0.5")));
    for scan_id in 1..=8 {
        let ready = prompt.scan_ready_ns(scan_id);
        assert_eq!(late.scan_ready_ns(scan_id), ready + 500_000_000);
        prompt.advance_to(ready);
        let (scan, odometry, truth) = measure(&mut prompt, scan_id);
        late.advance_to(ready);
        let mut behind = late.clone();
        for robot in [&mut prompt, &mut late, &mut behind] {
            robot.actuate(&drive(1.0, 0.0));
        }
        // The same commands until the scan is published.
        for step in 1..=5 {
            behind.advance_to(ready + step * 100_000_000);
            behind.actuate(&drive(1.0, 0.0));
        }
        let (scan_late, odometry_late, truth_late) = measure(&mut behind, scan_id);
        assert_eq!(scan_late.ranges_mm, scan.ranges_mm, "scan {scan_id}");
        assert_eq!((odometry_late.x_m, truth_late.x_m), (odometry.x_m, truth.x_m));
        assert!(behind.present().state.x - truth_late.x_m > 0.4);
    }
}

#[test]
fn a_successor_of_a_stuck_scanner_repeats_the_same_ranges() {
    let wall = "[[obstacle]]\nshape = \"box\"\nx_m = 4.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 4";
    let mut old = ideal(&format!("{wall}\n[scanner]\nstuck_s = 0.3"));
    lockstep(&mut old, 1..=5, &drive(1.0, 0.0));
    let state = old.state(5).unwrap();
    assert!(state.repeats.is_set() && state.repeated_mm[FRONT_BEAM] < 4000);
    let mut new = Emulator::new(&old.scenario, PERIOD);
    new.resume(&state).unwrap();
    for robot in [&mut old, &mut new] {
        robot.advance_to(robot.scan_ready_ns(6));
        assert_eq!(measure(robot, 6).0.ranges(), &state.repeated_mm.map(u32::from)[..682]);
    }
    assert_eq!(new.state(6), old.state(6));
}

#[test]
fn the_truth_has_the_distance_to_the_last_goal_as_it_was_given() {
    let bend = "[course]\nwaypoints = [{ yaw_rad = 0 }, { x_m = 5, yaw_rad = 0 }, { x_m = 10, y_m = 5, yaw_rad = 1.5708 }]";
    let given = |index, x_m| GivenGoal { from_scan: 3, index, x_m, y_m: 0.5, ..GivenGoal::default() };
    // Of the bend the goal is 0.5 m to the left of its end.
    for (text, index, along_m, expected) in [
        ("", 0, 8.0, [8.0, 0.5]),
        (bend, 0, 5.0 + 2.5 * std::f64::consts::PI, [9.5, 5.0]),
        ("[[goal]]\nx_m = 4.0\n[[goal]]\n", 0, 5.0, [10.0, 0.0]),
        ("[[goal]]\nx_m = 4.0\n[[goal]]\n", 1, 8.0, [8.0, 0.5]),
    ] {
        let mut emulator = ideal(text);
        let mut distance_m = |scan_id| {
            emulator.give(&given(index, along_m), scan_id);
            lockstep(&mut emulator, scan_id..=scan_id, &block()).goal_distance_m
        };
        assert_eq!(distance_m(1), distance_m(2), "{text}: it counts from scan 3 on");
        let distance_m = distance_m(3);
        assert!((distance_m - f64::hypot(expected[0], expected[1])).abs() < 1e-4, "{text}: {distance_m}");
    }
}

#[test]
fn a_robot_that_is_lifted_while_it_drives_goes_on_aside_and_its_odometry_knows_the_turn_alone() {
    let encoders = "odometry_model = \"encoders\"\nencoder_slip_m = 0.0\ngyro_noise_rad = 0.0\n\
        gyro_bias_walk_radps = 0.0";
    let robot = "[robot]\nvelocity_factor = 1.0\nsteering_map = \"identity\"\nodometry_longitudinal = 0.0";
    let pushed = "pushed_s = 1.0335\npushed_left_m = 0.5\npushed_yaw_rad = 0.2";
    let mut emulator = Emulator::new(&parse(&format!("{robot}\n{encoders}\n{pushed}")), PERIOD);
    let mut ends = Vec::new();
    for scan_id in 1..=20 {
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        let (_, odometry, truth) = measure(&mut emulator, scan_id);
        ends.push((truth, odometry));
        emulator.actuate(&drive(1.0, 0.0));
    }
    // It drives from 133.3 ms on.
    let (before, after) = (&ends[9], &ends[19]);
    assert!(before.0.y_m == 0.0 && (before.0.x_m - 0.8667).abs() < 1e-3, "{:?}", before.0);
    let driven_m = 2.0 - 1.0335;
    let expected = [0.9 + driven_m * 0.2_f64.cos(), 0.5 + driven_m * 0.2_f64.sin(), 0.2];
    let (truth, odometry) = (after.0, after.1);
    for (value, expected) in [truth.x_m, truth.y_m, truth.yaw_rad].into_iter().zip(expected) {
        // The step in which it is lifted lasts 1 ms.
        assert!((value - expected).abs() < 2e-3, "{truth:?}");
    }
    assert!((truth.path_length_m - odometry.x_m.hypot(odometry.y_m)).abs() < 0.05, "{odometry:?}");
    assert!((odometry.y_m - driven_m * 0.2_f64.sin()).abs() < 2e-3 && (odometry.yaw_rad - 0.2).abs() < 1e-9);
    assert!((odometry.speed_mps - 1.0).abs() < 0.011, "the wheels turn as before: {odometry:?}");
}

#[test]
fn encoders_count_the_slip_of_the_ground_and_of_a_smaller_wheel() {
    let robot = "preset = \"ideal\"\nodometry_model = \"encoders\"\nencoder_slip_m = 0.0\n\
        odometry_longitudinal = 0.0\nslip_at_m = 0.5\nslip_length_m = 0.5\nslip_share = 0.2\nwheel_smaller = -0.01";
    let mut emulator = Emulator::new(&parse(&format!("[robot]\n{robot}")), PERIOD);
    let (mut truth, mut odometry) = (Truth::default(), Odometry::default());
    for scan_id in 1..=30 {
        emulator.advance_to(emulator.scan_ready_ns(scan_id));
        (_, odometry, truth) = measure(&mut emulator, scan_id);
        emulator.actuate(&drive(1.0, 0.0));
    }
    // Each way counts 1.005, half a metre of it 1.25 times.
    let slipped_m = 0.5 / 0.8 - 0.5;
    let counted_m = 1.005 * (truth.path_length_m - 0.0333 / 1.407 + slipped_m);
    let way_m = odometry.x_m.hypot(odometry.y_m);
    assert!(truth.x_m > 1.2 && (way_m - counted_m).abs() < 3e-3, "{way_m} {counted_m} {truth:?}");
}
