//! Every shipped scenario in lock-step, with the outcome it is shipped for.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use audit::digest::Digests;
use emulator::{Outcome, Scenario};
use pipeline::{DriveResult, PipelineSettings, Tuning, profile};
use report::Report;
use scanloop_tests::TestSystem;
use vehicle::Surroundings;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Drives a scenario twice and checks what holds for all of them.
fn drive(scenario: &str, expected: Outcome) -> Report {
    let system = TestSystem::new(EXECUTABLE);
    let report = system.lockstep(&[scenario]);
    assert_eq!(report.outcome, expected, "{scenario}: {}", report.reason);
    assert!(!report.drive.truth.unwrap().collided);
    assert_eq!(report.scans.unaccounted, 0);
    assert_eq!((report.scans.commanded, report.scans.lost), (report.scans.published, 0));
    assert!(
        report.drive.truth.unwrap().min_clearance_m >= 0.05,
        "{scenario}: clearance {} m",
        report.drive.truth.unwrap().min_clearance_m
    );
    let again = system.lockstep(&[scenario]);
    assert_eq!(again.trajectory, report.trajectory, "{scenario}: two runs differ");
    assert_eq!(again.digests, report.digests, "{scenario}: two runs differ");
    system.assert_nothing_left();
    report
}

/// A scenario that is to be reached.
fn reach(scenario: &str) {
    let report = drive(scenario, Outcome::Reached);
    let tolerance =
        Scenario::parse(Scenario::shipped(scenario).unwrap(), scenario).unwrap().goal.last().tolerance_m;
    assert!(report.drive.final_distance_m <= tolerance);
}

#[test]
fn corridor_is_reached() {
    reach("corridor");
}

/// Its robot has errors that only the system file of the scenario describes.
#[test]
fn the_chain_of_the_source_reaches_its_goal_with_every_seed() {
    reach("thesis");
    let system = TestSystem::new(EXECUTABLE);
    for seed in 2..=20 {
        let report = system.lockstep(&["thesis", "--seed", &seed.to_string()]);
        assert_eq!(report.outcome, Outcome::Reached, "seed {seed}: {}", report.reason);
        assert!(report.drive.truth.unwrap().min_clearance_m >= 0.05, "seed {seed}");
    }
    let other = system.lockstep(&["thesis", "--set", "estimator.profile=scaled"]);
    assert_eq!(other.outcome, Outcome::Stopped, "the filter of the project does not expect this odometer");
}

#[test]
fn several_goals_are_reached_in_their_order_and_directions() {
    reach("stations");
    let system = TestSystem::new(EXECUTABLE);
    let report = system.lockstep(&["stations", "--set", "goal.0.x_m=5.5", "--set", "goal.1.stay_s=4.0"]);
    let times: Vec<f64> = report.goals.iter().map(|goal| goal.reached_s.unwrap()).collect();
    assert!(times.is_sorted() && times[2] - times[1] > 4.0 + 6.0, "{times:?}");
    assert_eq!(report.goals.iter().filter(|goal| goal.yaw_error_rad.is_some()).count(), 2);
    // A goal that the robot misses ends the drive: the odometer is 3 % wrong, which nothing shows without a laser.
    let blind = ["--set", "estimator.laser=off", "--set", "robot.odometry_longitudinal=0.04"];
    let report = system.lockstep(&[&["stations"], &blind[..]].concat());
    assert_eq!(report.outcome, Outcome::Missed, "{}", report.reason);
    assert!(report.reason.contains(" of 3, 0.1 m are allowed"), "{}", report.reason);
    let ended = report.goals.iter().position(|goal| goal.reached_s.is_none()).unwrap();
    assert!(report.goals[ended].distance_m.unwrap() > 0.1);
    assert!(report.goals[ended + 1..].iter().all(|goal| goal.distance_m.is_none()));
}

#[test]
fn a_path_in_a_file_is_followed_and_its_velocities_are_kept() {
    let system = TestSystem::new(EXECUTABLE);
    let folder = system.folder();
    let write = |name: &str, text: &str| {
        std::fs::write(folder.join(name), text).unwrap();
        folder.join(name).display().to_string()
    };
    // A bend of 5 m radius after 4 m, recorded every 5 cm, slow in its second half.
    let point = |index: u32| {
        let along = f64::from(index) * 0.05;
        let turn = ((along - 4.0) / 5.0).max(0.0);
        let [x, y] = if turn > 0.0 { [4.0 + 5.0 * turn.sin(), 5.0 - 5.0 * turn.cos()] } else { [along, 0.0] };
        let speed = if turn > 0.6 { "0.4" } else { "" };
        format!("{x:.4},{y:.4},{speed}\n")
    };
    let rows: String = (0..=200).map(point).collect();
    write("way.csv", &format!("x_m,y_m,speed_mps\n{rows}"));
    let file = write("drive.toml", "name = \"drive\"\n[course]\npath = \"way.csv\"\n");
    let report = system.lockstep(&[&file]);
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    let speeds = |from_s: f64, to_s: f64| {
        let rows = report.trajectory.iter().filter(move |[time_s, ..]| (from_s..to_s).contains(time_s));
        let rows: Vec<_> = rows.collect();
        rows.windows(2)
            .map(|pair| (pair[1][1] - pair[0][1]).hypot(pair[1][2] - pair[0][2]) / (pair[1][0] - pair[0][0]))
            .collect::<Vec<_>>()
    };
    let fast = speeds(2.0, 4.0);
    assert!(fast.iter().all(|speed| *speed > 0.9), "{fast:?}");
    let slow = speeds(9.0, 12.0);
    assert!(slow.len() > 20 && slow.iter().all(|speed| *speed < 0.44), "{slow:?}");
    for (text, message) in [
        ("x_m,y_m\n0,0\n1,0\n2,zero\n", "way.csv: line 4: y_m = zero is not allowed"),
        ("x_m,y_m\n0,0\n", "way.csv: 1 points are not allowed: 2 to 100000"),
        ("x_m;y_m\n0;0\n1;0\n", "way.csv: "),
    ] {
        write("way.csv", text);
        let output = system.run(&["check", &file]);
        let printed = scanloop_tests::printed(&output);
        assert!(output.status.code() == Some(2) && printed.contains(message), "{printed}");
    }
    let both = write("both.toml", "[course]\npath = \"way.csv\"\nwaypoints = [{ x_m = 0 }, { x_m = 5 }]\n");
    let printed = scanloop_tests::printed(&system.run(&["check", &both]));
    assert!(printed.contains("either `waypoints` or `path`, not both"), "{printed}");
    let slow = write("slow.toml", "[course]\nwaypoints = [{ x_m = 0, speed_mps = 0.05 }, { x_m = 5 }]\n");
    let printed = scanloop_tests::printed(&system.run(&["check", &slow]));
    assert!(
        printed.contains("course.waypoints[0].speed_mps = 0.05 is not allowed: at least vehicle.bounds"),
        "{printed}"
    );
}

#[test]
fn one_goal_may_stand_in_a_list_and_an_option_names_it_by_its_number() {
    let system = TestSystem::new(EXECUTABLE);
    let lines = |arguments: &[&str]| scanloop_tests::printed(&system.run(arguments));
    let checked = lines(&["check", "free", "--set", "goal.0.x_m=7"]);
    assert!(checked.contains("goal at (7, 0)"), "{checked}");
    let behind = lines(&["check", "stations", "--set", "goal.2.y_m=3"]);
    assert!(behind.contains("goal[2]") || behind.contains("goal.2"), "{behind}");
    let missing = lines(&["check", "free", "--set", "goal.1.x_m=7"]);
    assert!(missing.contains("goal has no element `1`, it has 1"), "{missing}");
}

#[test]
fn a_scenario_names_a_system_file_beside_it_and_the_option_comes_first() {
    let system = TestSystem::new(EXECUTABLE);
    let folder = system.folder();
    std::fs::write(
        folder.join("drive.toml"),
        "name = \"drive\"\nsystem = \"slow.toml\"\n[goal]\nx_m = 3.0\n",
    )
    .unwrap();
    let file = folder.join("drive.toml").display().to_string();
    let missing = system.run(&["check", &file]);
    let slow = folder.join("slow.toml").display().to_string();
    assert_eq!(missing.status.code(), Some(2));
    let message = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(message.contains(&slow), "{message}");
    std::fs::write(&slow, "[controller]\ncruise_mps = 0.5\n").unwrap();
    std::fs::write(folder.join("fast.toml"), "[controller]\ncruise_mps = 0.9\n").unwrap();
    let fast = folder.join("fast.toml").display().to_string();
    let (named, chosen) = (system.lockstep(&[&file]), system.lockstep(&[&file, "--system", &fast]));
    assert!(named.duration_s > 1.3 * chosen.duration_s, "{} {}", named.duration_s, chosen.duration_s);
    let refused = system.run(&["check", &file, "--set", "system=fast.toml"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--system FILE"));
}

#[test]
fn a_drive_continues_after_missing_scans() {
    let system = TestSystem::new(EXECUTABLE);
    // With seed 2 scans are missing after the end of the run, too.
    let drive = || system.lockstep(&["corridor", "--seed", "2", "--set", "robot.scan_missing_every=10"]);
    let (report, again) = (drive(), drive());
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    assert!(report.scans.missing >= 3, "about one in ten: {:?}", report.scans);
    assert_eq!((report.scans.published, report.scans.lost), (report.scans.commanded, 0));
    assert_eq!((report.scans.unaccounted, again.scans.missing), (0, report.scans.missing));
    assert_eq!(again.digests, report.digests);
}

/// Late and irregular scans, and scans without ranges: every one is answered, and processes and pipeline agree.
#[test]
fn every_scan_of_a_scanner_that_is_late_irregular_or_blind_is_answered() {
    let system = TestSystem::new(EXECUTABLE);
    let faults: [(&str, &[&str]); 5] = [
        ("constantly late", &["scanner.late_s=0.05"]),
        ("late for a second", &["scanner.late_s=0.25", "scanner.from_s=3.0", "scanner.to_s=4.0"]),
        ("one in five missing", &["scanner.missing_every=5", "scanner.stamp_jitter_s=0.02"]),
        ("blind for two seconds", &["scanner.missing_every=1", "scanner.from_s=3.0", "scanner.to_s=5.0"]),
        ("irregular", &["scanner.period_s=[0.005, 0.255]", "scanner.stamp_jitter_s=0.02"]),
    ];
    for (name, keys) in faults {
        let mut arguments = vec!["corridor"];
        keys.iter().for_each(|key| arguments.extend(["--set", key]));
        let report = system.lockstep(&arguments);
        assert_eq!(
            (report.scans.unaccounted, report.drive.truth.unwrap().collided),
            (0, false),
            "{name}: {:?}",
            report.scans
        );
        let scans = &report.scans;
        assert_eq!((scans.commanded, scans.lost, scans.late), (scans.published, 0, 0), "{name}");
        assert_eq!(scans.missing > 0, name.contains("missing") || name.contains("blind"), "{name}");
        assert_eq!(report.stop_reasons.contains_key("gap"), name == "irregular", "{name}");
        let table: String =
            keys.iter().map(|key| key.trim_start_matches("scanner.").to_owned() + "\n").collect();
        let text = format!("{}\n[scanner]\n{table}", Scenario::shipped("corridor").unwrap());
        let (drive, digests) = in_one_process(Scenario::parse(&text, name).unwrap());
        assert_eq!((drive.outcome, digests), (report.outcome, report.digests), "{name}");
    }
    system.assert_nothing_left();
}

#[test]
fn free_is_reached() {
    reach("free");
}

#[test]
fn two_obstacles_are_passed() {
    reach("two-obstacles");
}

#[test]
fn slalom_is_reached() {
    reach("slalom");
}

#[test]
fn walls_are_kept_away_from() {
    reach("walls");
}

#[test]
fn noisy_is_reached() {
    reach("noisy");
}

#[test]
fn imperfect_robot_is_brought_to_the_goal() {
    reach("imperfect-robot");
}

#[test]
fn crossing_is_reached() {
    reach("crossing");
}

#[test]
fn s_curve_is_reached() {
    reach("s-curve");
}

#[test]
fn bend_is_reached() {
    reach("bend");
}

#[test]
fn slalom_arc_is_reached() {
    reach("slalom-arc");
}

#[test]
fn a_turn_in_three_is_reached_backwards_in_its_middle() {
    reach("u-turn");
}

#[test]
fn a_place_along_the_way_is_reached_backwards() {
    reach("park-parallel");
}

#[test]
fn a_place_across_the_way_is_reached_backwards() {
    reach("park-perpendicular");
}

#[test]
fn a_dead_end_is_left_backwards_and_passed() {
    reach("dead-end");
}

#[test]
fn a_robot_that_drives_forwards_only_stays_in_a_dead_end_and_is_refused_a_course_backwards() {
    let system = TestSystem::new(EXECUTABLE);
    let forwards = "vehicle.bounds.reverse_max_mps=0";
    for keys in [forwards, "controller.back_out_m=0"] {
        let report = system.lockstep(&["dead-end", "--set", keys]);
        assert_eq!(report.outcome, Outcome::Stopped, "{keys}: {}", report.reason);
    }
    let output = system.run(&["check", "u-turn", "--set", forwards]);
    assert_eq!(output.status.code(), Some(2));
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(printed.contains("course.waypoints[3].reverse"), "{printed}");
}

#[test]
fn a_robot_turns_round_to_a_goal_behind_it() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("behind.toml");
    for (goal, legs) in [("x_m = -6.0", 3), ("x_m = -4.0\ny_m = -3.0\nyaw_rad = 0.0", 1)] {
        let text =
            format!("name = \"behind\"\n[course]\nturn_radius_m = 4.0\nwidth_m = 2.0\n[goal]\n{goal}\n");
        let scenario = Scenario::parse(&text, "behind").unwrap();
        assert_eq!(scenario.course.as_ref().unwrap().legs().len(), legs, "{goal}");
        std::fs::write(&file, text).unwrap();
        let report = system.lockstep(&[file.to_str().unwrap()]);
        assert_eq!(report.outcome, Outcome::Reached, "{goal}: {}", report.reason);
    }
}

#[test]
fn backwards_the_robot_passes_a_body_that_it_has_passed_before() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("back.toml");
    let text = "name = \"back\"\ntimeout_s = 90.0\n[course]\nwidth_m = 3.0\nwaypoints = [\n\
        { x_m = 0.0, y_m = 0.0, yaw_rad = 0.0 },\n{ x_m = 10.0, y_m = 0.0, yaw_rad = 0.0 },\n\
        { x_m = 1.0, y_m = 0.0, yaw_rad = 0.0, reverse = true },\n]\n\
        [[obstacle]]\nshape = \"box\"\nx_m = 4.5\ny_m = 0.1\nlength_m = 0.3\nwidth_m = 0.3\n";
    std::fs::write(&file, text).unwrap();
    let report = system.lockstep(&[file.to_str().unwrap()]);
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    assert!(report.drive.truth.unwrap().min_clearance_m > 0.05);
}

#[test]
fn a_place_that_was_not_seen_is_not_backed_into() {
    // The body beside it hides where the robot is to stand.
    let hidden = ["park-perpendicular", "--set", "obstacle.0.x_m=4.5", "--set", "obstacle.0.length_m=1.0"];
    let report = TestSystem::new(EXECUTABLE).lockstep(&hidden);
    assert_eq!(report.outcome, Outcome::Stopped, "{}", report.reason);
    assert!(report.drive.truth.unwrap().min_clearance_m > 0.05);
}

#[test]
fn long_is_reached() {
    reach("long");
}

#[test]
fn blocked_stops_before_the_wall() {
    drive("blocked", Outcome::Stopped);
}

#[test]
fn sudden_obstacle_is_stopped_for() {
    drive("sudden", Outcome::Stopped);
}

/// The robot and the correction have the same drift (7.38). It must begin at the same scan in both: one period of
/// difference is 0.0053 of the distance, 0.2 m in this drive.
#[test]
fn the_printed_drift_is_corrected_to_ten_centimetres_in_forty_seconds() {
    let system = TestSystem::new(EXECUTABLE);
    let set = [
        "robot.odometry_lateral_rate=0.053",
        "robot.odometry_drift=time",
        "noise.odometry_m=0.02",
        "noise.odometry_rad=0.01",
        "estimator.profile=source",
    ];
    for seed in 1..=10 {
        let seed = seed.to_string();
        let mut arguments = vec!["endless", "--duration", "40", "--seed", &seed];
        set.iter().for_each(|pair| arguments.extend(["--set", *pair]));
        let report = system.lockstep(&arguments);
        assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
        let error_m = report.drive.truth.unwrap().estimate_error_max_m;
        assert!((0.02..0.10).contains(&error_m), "seed {seed}: {error_m} m");
    }
    system.assert_nothing_left();
}

/// Drives and passes when the exit code goes with the outcome; nothing is touched.
fn untouched(system: &TestSystem, arguments: &[&str]) -> Report {
    let report = system.lockstep(arguments);
    assert!(
        !report.drive.truth.unwrap().collided && report.drive.truth.unwrap().min_clearance_m > 0.0,
        "{arguments:?}: {:?}",
        report.drive
    );
    report
}

/// `arguments` and one `--set` for each of `keys`.
fn set<'a>(scenario: &'a str, keys: &[&'a str]) -> Vec<&'a str> {
    [scenario].into_iter().chain(keys.iter().flat_map(|key| ["--set", *key])).collect()
}

#[test]
fn every_stage_knows_a_body_that_one_key_sets() {
    let system = TestSystem::new(EXECUTABLE);
    for body in ["robot.width_m=1.4", "robot.width_m=1.2", "robot.length_m=1.2"] {
        let report = untouched(&system, &set("corridor", &[body]));
        let ended = [Outcome::Reached, Outcome::Stopped].contains(&report.outcome);
        assert!(ended, "{body}: {:?}, {}", report.outcome, report.reason);
        assert!(
            report.drive.truth.unwrap().min_clearance_m >= 0.05,
            "{body}: {} m",
            report.drive.truth.unwrap().min_clearance_m
        );
        let output = system.run(&[&["run", "--lockstep", "--quiet"][..], &set("corridor", &[body])].concat());
        let code = i32::from(report.outcome != Outcome::Reached);
        assert_eq!(output.status.code(), Some(code), "{body}");
    }
}

#[test]
fn the_speed_limit_contains_braking_way_and_age_of_the_data() {
    let system = TestSystem::new(EXECUTABLE);
    let slow = ["rate_hz=0.5", "controller.horizon_s=10", "controller.intervals=5", "goal.tolerance_m=0.2"];
    for keys in [&["robot.blocked_deceleration_mps2=0.3"][..], &slow] {
        for preset in ["robot.preset=ideal", "robot.preset=summit"] {
            let report = untouched(&system, &set("sudden", &[keys, &[preset]].concat()));
            assert_eq!(report.outcome, Outcome::Stopped, "{keys:?} {preset}: {}", report.reason);
        }
    }
}

#[test]
fn a_rate_without_a_safe_speed_is_refused_and_the_keys_are_named() {
    let system = TestSystem::new(EXECUTABLE);
    for command in [&["run", "--lockstep"][..], &["check"]] {
        let arguments = set("sudden", &["vehicle.sudden_m=0.2", "rate_hz=0.5"]);
        let output = system.run(&[command, &arguments].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{command:?}: {message}");
        assert!(message.contains("rate_hz") && message.contains("vehicle.sudden_m"), "{message}");
    }
}

#[test]
fn gaps_of_120_centimetres_are_driven_through() {
    let system = TestSystem::new(EXECUTABLE);
    let course = ["goal.x_m=16", "obstacle.0.x_m=8"];
    let centred = untouched(&system, &set("corridor", &[&course[..], &["obstacle.0.width_m=1.6"]].concat()));
    assert_eq!(centred.outcome, Outcome::Reached, "{}", centred.reason);
    let two = [
        "obstacle.0.x_m=8",
        "obstacle.0.y_m=1.2",
        "obstacle.0.width_m=1.2",
        "obstacle.1.x_m=8",
        "obstacle.1.y_m=-1.2",
        "obstacle.1.width_m=1.2",
        "goal.x_m=16",
    ];
    let gap = untouched(&system, &set("two-obstacles", &two));
    assert_eq!(gap.outcome, Outcome::Reached, "{}", gap.reason);
    system.assert_nothing_left();
}

#[test]
fn processes_and_pipeline_give_the_same_bits() {
    let system = TestSystem::new(EXECUTABLE);
    for (name, surroundings) in
        [("corridor", Surroundings::Hall), ("noisy", Surroundings::Hall), ("free", Surroundings::Open)]
    {
        let report = system.lockstep(&[name, "--set", &format!("track.surroundings={surroundings}")]);
        let mut scenario = Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap();
        scenario.track.surroundings = surroundings;
        let (drive, digests) = in_one_process(scenario);
        assert_eq!(drive.outcome, report.outcome);
        assert_eq!(drive.scans, report.scans.published);
        assert_eq!(digests, report.digests, "{name}");
    }
}

#[test]
fn the_controller_of_the_source_gives_the_same_bits_in_processes_and_in_the_pipeline() {
    let system = TestSystem::new(EXECUTABLE);
    for (name, outcome) in [("two-obstacles", Outcome::Reached), ("sudden", Outcome::Stopped)] {
        let report = system.lockstep(&[name, "--set", "controller.profile=source"]);
        assert_eq!(report.outcome, outcome, "{name}: {}", report.reason);
        let mut table = "[controller]\nprofile = \"source\"".parse().unwrap();
        profile::add(&mut table);
        let tuning: Tuning = table.try_into().unwrap();
        let scenario = Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap();
        let (drive, digests) = with_settings(&PipelineSettings { tuning, ..PipelineSettings::of(scenario) });
        assert_eq!((drive.outcome, digests), (outcome, report.digests), "{name}");
    }
}

/// The drive of a scenario in the pipeline, with its digests.
fn in_one_process(scenario: Scenario) -> (DriveResult, BTreeMap<String, String>) {
    with_settings(&PipelineSettings::of(scenario))
}

/// The same with other settings of the stages.
fn with_settings(settings: &PipelineSettings) -> (DriveResult, BTreeMap<String, String>) {
    let mut digests = Digests::default();
    let drive = pipeline::drive(settings, |step| {
        digests.add(&step.truth);
        step.pose.iter().for_each(|sample| digests.add(sample));
        step.obstacles.iter().for_each(|sample| digests.add(sample));
        step.command.iter().for_each(|sample| digests.add(sample));
        step.actuation.iter().for_each(|sample| digests.add(sample));
    });
    (drive.unwrap(), digests.texts())
}
