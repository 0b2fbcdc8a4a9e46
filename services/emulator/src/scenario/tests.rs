use super::*;
use proptest::prelude::*;

fn message(text: &str) -> String {
    Scenario::parse(text, "my.toml").unwrap_err().to_string()
}

const BOX: &str = "[[obstacle]]\nshape = \"box\"\nx_m = 5\ny_m = 0\nlength_m = 0.1\nwidth_m = 0.4\n";

#[test]
fn an_empty_file_is_the_default_without_obstacles() {
    let scenario = Scenario::parse("", "my.toml").unwrap();
    assert_eq!(scenario, Scenario::default());
    assert!(scenario.obstacles.is_empty());
}

#[test]
fn every_shipped_scenario_is_valid_named_as_its_file_and_reads_back_identically() {
    for name in Scenario::names() {
        let scenario = Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap();
        assert_eq!(scenario.name, name);
        let written = scenario.to_toml();
        assert_eq!(Scenario::parse(&written, "written").unwrap(), scenario, "{written}");
    }
    assert_eq!(Scenario::names().next(), Some("corridor"));
    assert_eq!(Scenario::shipped("nowhere"), None);
}

#[test]
fn the_shipped_corridor_is_the_default_with_one_box() {
    let scenario = Scenario::parse(Scenario::shipped("corridor").unwrap(), "corridor").unwrap();
    let shape = Shape::Box { length_m: 0.1, width_m: 0.4, yaw_rad: 0.0 };
    let robot = Robot { preset: Preset::Summit, ..Robot::default() };
    let expected =
        Scenario { obstacles: vec![ScenarioObstacle::fixed(shape, 5.0, 0.0)], robot, ..Scenario::default() };
    // The file repeats some values of the preset.
    let resolved = |scenario: Scenario| Scenario {
        robot: scenario.robot.resolved(&vehicle::Description::default(), scenario.seed),
        ..scenario
    };
    assert_eq!(resolved(scenario), resolved(expected));
}

#[test]
fn messages_name_file_key_value_and_what_is_allowed() {
    let cases = [
        ("[noise]\nrange_m = 2", "my.toml: noise.range_m = 2 is not allowed: 0 to 1"),
        ("[noise]\nrange_m = nan", "my.toml: noise.range_m = NaN is not allowed: 0 to 1"),
        ("[noise]\ndropout = \"no\"", "my.toml: noise.dropout = \"no\" is not allowed: a number"),
        ("seed = -1", "my.toml: seed = -1 is not allowed: a whole number from 0"),
        ("timeout_s = inf", "my.toml: timeout_s = inf is not allowed: 0.1 to 1000000"),
        ("track = 5", "my.toml: track = 5 is not allowed: a table [track]"),
        ("[track]\nwalls = 1", "my.toml: track.walls = 1 is not allowed: a boolean"),
        ("[track]\nx_m = [0.0]", "my.toml: track.x_m = [0.0] is not allowed: an array of two numbers"),
        (
            "[track]\ny_m = [1.5, -1.5]",
            "my.toml: track.y_m = [1.5, -1.5] is not allowed: two numbers from -1000 to 1000, the second at least 0.5 above the first",
        ),
        ("[start]\ny_m = 1.6", "my.toml: start.y_m = 1.6 is not allowed: -1.5 to 1.5, the bounds track.y_m"),
        ("[goal]\nx_m = 22.5", "my.toml: goal.x_m = 22.5 is not allowed: 0 to 22, the bounds track.x_m"),
        (
            "[robot]\nsteering_map = \"bent\"",
            "my.toml: robot.steering_map = \"bent\" is not allowed: `nonlinear` or `identity`",
        ),
        (
            "[robot]\ngyro_bias_radps = 0.2",
            "my.toml: robot.gyro_bias_radps = 0.2 is not allowed: -0.1 to 0.1",
        ),
        ("[robot]\ngyro_scale = -1", "my.toml: robot.gyro_scale = -1 is not allowed: -0.1 to 0.1"),
        ("[robot]\nwheel_smaller = 0.5", "my.toml: robot.wheel_smaller = 0.5 is not allowed: -0.1 to 0.1"),
        ("[robot]\nslip_share = 1", "my.toml: robot.slip_share = 1 is not allowed: 0 to 0.9"),
        ("[robot]\nslip_length_m = -1", "my.toml: robot.slip_length_m = -1 is not allowed: 0 to 10000"),
        (
            "[robot]\npushed_yaw_rad = 4",
            "my.toml: robot.pushed_yaw_rad = 4 is not allowed: -3.141592653589793 to 3.141592653589793",
        ),
        ("obstacle = 3", "my.toml: obstacle = 3 is not allowed: tables [[obstacle]]"),
        (
            "name = \"../up\"",
            "my.toml: name = ../up is not allowed: 1 to 64 letters, digits, blanks, `-`, `_` and `.`",
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(message(text), expected);
    }
}

#[test]
fn messages_about_an_obstacle_carry_its_index() {
    let second = |keys: &str| message(&format!("{BOX}[[obstacle]]\n{keys}"));
    let start = "my.toml: obstacle[1].";
    let cases = [
        ("x_m = 1", "shape = (missing) is not allowed: `box` or `circle` must be given"),
        ("shape = \"ball\"", "shape = \"ball\" is not allowed: `circle` or `box`"),
        (
            "shape = \"circle\"\nx_m = 3\ny_m = 0",
            "radius_m = (missing) is not allowed: a number [m] must be given",
        ),
        ("shape = \"circle\"\nx_m = 3\ny_m = 0\nradius_m = -1", "radius_m = -1 is not allowed: 0.005 to 50"),
        (
            "shape = \"circle\"\nx_m = 3\ny_m = 0\nradius_m = 1\nwidth_m = 0.5",
            "width_m = 0.5 is not allowed: only with shape = \"box\"",
        ),
        (
            "shape = \"circle\"\nx_m = 0.3\ny_m = 0\nradius_m = 0.1",
            "x_m = 0.3 (y_m = 0) is not allowed: an obstacle must not touch the robot's body at the start",
        ),
        (
            "shape = \"circle\"\nx_m = 3\ny_m = 0\nradius_m = 0.1\nappears_s = 1\nappears_ahead_m = 1",
            "appears_s = 1 is not allowed: either appears_s or appears_ahead_m, not both",
        ),
        (
            "shape = \"circle\"\nx_m = 3\ny_m = 0\nradius_m = 0.1\nappears_s = 3\ndisappears_s = 1",
            "disappears_s = 1 is not allowed: 3 to 1000000",
        ),
    ];
    for (keys, expected) in cases {
        assert_eq!(second(keys), format!("{start}{expected}"));
    }
}

#[test]
fn an_unknown_key_is_named_with_the_known_ones() {
    let text = message("[noise]\nrnage_m = 0.1");
    assert!(
        text.starts_with("my.toml: noise.rnage_m = 0.1 is not allowed: the key is unknown. Did you mean `range_m`? Expected one of")
    );
    assert!(text.contains("`range_m`"));
    assert!(message("speed = 1").contains("speed = 1"));
    assert!(message(&format!("{BOX}heigth_m = 1")).starts_with("my.toml: obstacle[0].heigth_m = 1 "));
}

#[test]
fn a_syntax_error_names_its_line() {
    assert!(message("seed = 1\n\nname = ").starts_with("my.toml: line 3: "));
}

#[test]
fn an_obstacle_that_comes_later_may_stand_on_the_start() {
    let text = "[[obstacle]]\nshape = \"circle\"\nx_m = 0\ny_m = 0\nradius_m = 0.1\nappears_s = 9";
    assert!(Scenario::parse(text, "my.toml").is_ok());
}

#[test]
fn a_body_that_reaches_into_a_wall_at_the_start_is_refused() {
    let text = "[track]\nwalls = true\n[start]\ny_m = 1.31";
    assert!(
        message(text)
            .starts_with("my.toml: start.y_m = 1.31 is not allowed: the robot's body must stand between")
    );
}

#[test]
fn walls_shrink_the_bound_of_the_centre_by_half_the_body_and_the_safety_distance() {
    let scenario = Scenario::parse(Scenario::shipped("walls").unwrap(), "walls").unwrap();
    let [low, high] = scenario.centre_y_m();
    assert!((low + 1.5).abs() < 1e-12 && (high - 1.5).abs() < 1e-12);
}

#[test]
fn endless_obstacles_depend_on_the_seed_only_and_stay_in_their_ranges() {
    let scenario = Scenario::parse(Scenario::shipped("endless").unwrap(), "endless").unwrap();
    let placed = scenario.placed_obstacles();
    assert_eq!(placed, scenario.placed_obstacles());
    assert_eq!(placed.len(), 1815, "from 6 m to 9984 m each 5.5 m");
    for obstacle in &placed {
        let Shape::Box { width_m, .. } = obstacle.shape else { panic!("boxes only") };
        assert!((0.2..0.5).contains(&width_m) && obstacle.y_m.abs() <= 0.6);
    }
    assert_ne!(Scenario { seed: 2, ..scenario }.placed_obstacles(), placed);
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in ".{0,200}") {
        let _ = Scenario::parse(&text, "my.toml");
    }

    #[test]
    fn no_value_of_any_key_makes_the_reader_panic(
        table in prop::sample::select(vec![
            "", "track", "start", "goal", "robot", "noise", "scanner", "endless", "obstacle",
        ]),
        key in prop::sample::select(vec![
            "name", "seed", "timeout_s", "x_m", "y_m", "yaw_rad", "walls", "tolerance_m", "shape", "radius_m",
            "length_m", "width_m", "velocity_factor", "spacing_m", "appears_s", "odometry_drift", "dropout",
            "dead_rad", "dropout_steps", "missing_every", "to_s", "late_s", "black",
        ]),
        value in prop::sample::select(vec![
            "nan", "-inf", "1e308", "-1", "true", "\"box\"", "[]", "[nan, 1]", "{}", "9223372036854775807",
            "[[]]", "1979-05-27", "{ shape = \"box\" }", "\"\"",
        ]),
    ) {
        let header = match table {
            "" => String::new(),
            "obstacle" => "[[obstacle]]\n".to_owned(),
            name => format!("[{name}]\n"),
        };
        if let Err(error) = Scenario::parse(&format!("{header}{key} = {value}"), "my.toml") {
            let text = error.to_string();
            prop_assert!(text.starts_with("my.toml: ") && text.contains(table), "{}", text);
            prop_assert!(!text.contains('\n'), "one line: {}", text);
        }
    }

    #[test]
    fn a_valid_scenario_reads_back_identically(
        x in 2.0..20.0f64, y in -1.0..1.0f64, radius in 0.01..0.5f64, yaw in -1.0..1.0f64,
        seed in 0..=i64::MAX as u64, speed in -1.0..1.0f64, ahead in proptest::option::of(0.1..3.0f64),
    ) {
        let mut obstacle = ScenarioObstacle::fixed(Shape::Circle { radius_m: radius }, x, y);
        obstacle.velocity_y_mps = speed;
        obstacle.appears_ahead_m = ahead;
        let scenario = Scenario {
            seed,
            start: Start { yaw_rad: yaw, ..Start::default() },
            obstacles: vec![obstacle],
            endless: Some(Endless::default()),
            ..Scenario::default()
        };
        prop_assert_eq!(scenario.validate(), Ok(()));
        prop_assert_eq!(Scenario::parse(&scenario.to_toml(), "written").unwrap(), scenario);
    }
}

/// An S of two bends, 3 m wide.
const S_CURVE: &str = "[[course.waypoints]]\nx_m = 0\ny_m = 0\nyaw_rad = 0\n\
                       [[course.waypoints]]\nx_m = 8\ny_m = 3\nyaw_rad = 0.5\n\
                       [[course.waypoints]]\nx_m = 16\ny_m = 6\nyaw_rad = 0\n";

#[test]
fn a_scenario_with_a_course_begins_at_its_first_waypoint_and_ends_at_its_last() {
    let scenario = Scenario::parse(
        &S_CURVE.replace("x_m = 0\ny_m = 0\nyaw_rad = 0", "x_m = 0\ny_m = -1\nyaw_rad = 0.25"),
        "my.toml",
    );
    let Scenario { start, goal, course, .. } = scenario.unwrap();
    assert_eq!([start.x_m, start.y_m, start.yaw_rad], [0.0, -1.0, 0.25]);
    assert_eq!([goal.last().x_m, goal.last().y_m], [16.0, 6.0]);
    let course = course.unwrap();
    assert!((course.at(course.length_m()).point - Vector2::new(16.0, 6.0)).norm() < 1e-9);
}

#[test]
fn keys_of_start_and_goal_win_over_the_course_and_a_missing_yaw_is_its_direction_there() {
    let text = format!("{S_CURVE}[start]\nx_m = 8\ny_m = 3\n[goal]\nx_m = 15\ny_m = 5.5\n");
    let scenario = Scenario::parse(&text, "my.toml").unwrap();
    assert_eq!([scenario.goal.last().x_m, scenario.goal.last().y_m], [15.0, 5.5]);
    assert!((scenario.start.yaw_rad - 0.5).abs() < 1e-9, "{:?}", scenario.start);
    let Start { x_m: along_m, y_m: across_m, yaw_rad } = scenario.start_on_course();
    assert!(along_m > 8.5 && across_m.abs() < 1e-9 && yaw_rad.abs() < 1e-9, "{along_m} {across_m} {yaw_rad}");
    let own = Scenario::parse(&text.replace("y_m = 3\n[goal]", "y_m = 3\nyaw_rad = 0.1\n[goal]"), "my.toml")
        .unwrap();
    assert_eq!(own.start.yaw_rad, 0.1);
    assert!((own.start_on_course().yaw_rad + 0.4).abs() < 1e-9);
}

#[test]
fn positions_on_the_course_are_along_and_across_it_and_without_one_those_in_the_plane() {
    let plain = Scenario::default();
    assert_eq!((plain.on_course(3.0, -0.5), plain.start_on_course()), ([3.0, -0.5], plain.start));
    assert_eq!((plain.goals_on_course(), plain.track_on_course()), (vec![plain.goal.last()], plain.track));
    // A quarter of a circle with 10 m radius, which turns left from the x axis.
    let text = "[course]\nwidth_m = 4\nsurroundings = \"open\"\n\
                waypoints = [{ x_m = 0, y_m = 0, yaw_rad = 0 }, { x_m = 10, y_m = 10, yaw_rad = 1.5707963267948966 }]";
    let scenario = Scenario::parse(text, "my.toml").unwrap();
    let quarter_m = 5.0 * std::f64::consts::PI;
    let [along_m, across_m] = scenario.on_course(10.0, 9.0);
    assert!((along_m - quarter_m + 1.0).abs() < 0.1 && across_m.abs() < 0.1, "{along_m} {across_m}");
    let [along_m, across_m] = scenario.on_course(0.0, 1.0);
    assert!(along_m.abs() < 1e-9 && (across_m - 1.0).abs() < 1e-9);
    let track = scenario.track_on_course();
    assert!((track.x_m[1] - quarter_m - 2.0).abs() < 1e-9 && track.x_m[0] == -2.0);
    assert_eq!((track.y_m, track.walls, track.surroundings), ([-2.0, 2.0], false, Surroundings::Open));
    assert_eq!((scenario.surroundings(), scenario.centre_y_m()), (Surroundings::Open, [-2.0, 2.0]));
}

#[test]
fn a_goal_where_a_closed_course_begins_is_its_end() {
    let text = "[course]\nwaypoints = [{ x_m = 0, y_m = 0, yaw_rad = 0 }, { x_m = 10, y_m = 10 }, { x_m = 0, y_m = 20 }, \
                { x_m = -10, y_m = 10 }, { x_m = 0, y_m = 0, yaw_rad = 0 }]";
    let scenario = Scenario::parse(text, "my.toml").unwrap();
    assert!(scenario.start_on_course().x_m.abs() < 1e-9);
    assert!((scenario.goals_on_course()[0].x_m - 20.0 * std::f64::consts::PI).abs() < 0.1);
}

#[test]
fn a_course_without_waypoints_leads_through_the_goals_in_their_directions() {
    let text = "[course]\n[[goal]]\nx_m = 6\ny_m = 1\n[[goal]]\nx_m = 12\ny_m = 6\nyaw_rad = 1.5\n";
    let scenario = Scenario::parse(text, "my.toml").unwrap();
    let course = scenario.course.clone().unwrap();
    let goals = scenario.goals_on_course();
    assert!(
        goals[0].x_m > 6.0 && goals[0].y_m.abs() < 1e-9 && goals[1].x_m == course.length_m(),
        "{goals:?}"
    );
    assert!(course.at(0.0).yaw.abs() < 1e-9 && (course.at(course.length_m()).yaw - 1.5).abs() < 1e-9);
    assert_eq!(Scenario::parse(&scenario.to_toml(), "written").unwrap(), scenario);
    let back = message(&text.replace("x_m = 12\ny_m = 6", "x_m = 6\ny_m = 1"));
    assert!(
        back.starts_with("my.toml: goal[1].x_m = (6, 1) is not allowed: at least 0.05 m from the one before"),
        "{back}"
    );
}

#[test]
fn goals_on_a_course_come_in_their_order_also_where_it_passes_again() {
    let circle = "[course]\nlaps = 2\nwaypoints = [{ x_m = 0, y_m = 0, yaw_rad = 0 }, { x_m = 10, y_m = 10 }, \
        { x_m = 0, y_m = 20 }, { x_m = -10, y_m = 10 }, { x_m = 0, y_m = 0, yaw_rad = 0 }]\n";
    let goals = "[[goal]]\nx_m = 10\ny_m = 10\n[[goal]]\nx_m = 10\ny_m = 10\n[[goal]]\n";
    let along: Vec<f64> = Scenario::parse(&format!("{circle}{goals}"), "my.toml")
        .unwrap()
        .goals_on_course()
        .iter()
        .map(|goal| goal.x_m / (5.0 * std::f64::consts::PI))
        .collect();
    // A quarter of the first lap, a quarter of the second, and the end.
    assert!(
        along.iter().zip([1.0, 5.0, 8.0]).all(|(quarters, expected)| (quarters - expected).abs() < 0.01),
        "{along:?}"
    );
    let half = message(&format!("{circle}[[goal]]\n[[goal]]\nx_m = 3"));
    assert!(half.starts_with("my.toml: goal[1].y_m = (missing) is not allowed"), "{half}");
    let before = message(&format!(
        "{}[[goal]]\nx_m = 0\ny_m = 20\n[[goal]]\nx_m = 10\ny_m = 10",
        circle.replace("laps = 2", "laps = 1")
    ));
    assert!(before.starts_with("my.toml: goal[1].x_m = "), "{before}");
}

#[test]
fn the_direction_of_a_goal_must_be_that_of_the_way() {
    assert!(Scenario::parse("[goal]\nyaw_rad = 0.05", "my.toml").is_ok());
    let across = message("[goal]\nyaw_rad = 1.0");
    assert!(
        across.starts_with(
            "my.toml: goal.yaw_rad = 1 is not allowed: the direction of the way there, 0.000, by"
        ),
        "{across}"
    );
    assert!(Scenario::parse("[goal]\nyaw_rad = 1.0\nyaw_tolerance_rad = 1.1", "my.toml").is_ok());
}

#[test]
fn a_course_that_cannot_be_followed_is_refused_with_what_is_allowed() {
    let with = |keys: &str| message(&format!("{S_CURVE}{keys}"));
    let cases = [
        (
            with("[track]\nwalls = false"),
            "track = (a table) is not allowed: either [track] or [course], not both",
        ),
        (
            with("[endless]"),
            "endless = (a table) is not allowed: not with [course]: it places obstacles along the line through the start",
        ),
        (
            message("[course]\nwaypoints = [{ x_m = 1 }]"),
            "course.waypoints = 1 waypoints is not allowed: 2 to 5000 of them",
        ),
        (with("[goal]\nx_m = 9"), "goal.y_m = (missing) is not allowed: a number [m], as goal.x_m is given"),
        (
            with("[start]\ny_m = 0"),
            "start.x_m = (missing) is not allowed: a number [m], as start.y_m is given",
        ),
        (
            with("[start]\nx_m = 0\ny_m = 1.6"),
            "start.x_m = 0 (y_m = 1.6) is not allowed: at most 1.5 m beside the course, half of course.width_m, and 2 m \
             beyond its 17.30 m; it is 1.60 m to the left of it at 0.00 m",
        ),
        (
            with("[goal]\nx_m = 18.5\ny_m = 6"),
            "goal.x_m = 18.5 (y_m = 6) is not allowed: at most 1.5 m beside the course, half of course.width_m, and 2 m \
             beyond its 17.30 m; it is 0.00 m to the left of it at 19.80 m",
        ),
        (
            with("[start]\nx_m = 8\ny_m = 3\n[goal]\nx_m = 0\ny_m = 0"),
            "goal.x_m = 0 (y_m = 0) is not allowed: a place ahead of the start, which is at 8.65 m along the course; this is \
             at 0.00 m",
        ),
        (
            message("[course]\nwaypoints = [{ x_m = -9999 }, { x_m = 9999 }]"),
            "course.waypoints = a course of 19998.0 m is not allowed: at most 9990 m",
        ),
    ];
    for (refused, expected) in cases {
        assert_eq!(refused, format!("my.toml: {expected}"));
    }
}

#[test]
fn a_scenario_with_a_course_reads_back_identically_and_has_no_track_in_its_file() {
    let scenario = Scenario::parse(&format!("{S_CURVE}{BOX}"), "my.toml").unwrap();
    let written = scenario.to_toml();
    assert!(!written.contains("track") && written.contains("[[course.waypoints]]"), "{written}");
    assert_eq!(Scenario::parse(&written, "written").unwrap(), scenario, "{written}");
    let changed = scenario.with(&toml::from_str("[goal]\ntolerance_m = 0.2").unwrap()).unwrap();
    assert_eq!((changed.goal.last().tolerance_m, changed.goal.last().x_m), (0.2, scenario.goal.last().x_m));
}

#[test]
fn a_goal_in_laps_is_the_next_place_ahead_of_the_robot() {
    let mut scenario = Scenario::parse(Scenario::shipped("figure-eight").unwrap(), "eight").unwrap();
    let lap_m = scenario.course.as_ref().unwrap().length_m() / 3.0;
    // The first quarter of the eight.
    (scenario.goal.all_mut()[0].x_m, scenario.goal.all_mut()[0].y_m) = (4.5, 4.5);
    let quarter_m = scenario.goals_on_course()[0].x_m;
    assert!((quarter_m - lap_m / 8.0).abs() < 0.1, "{quarter_m} of {lap_m}");
    for (robot_m, laps) in [(1.0, 0.0), (lap_m / 2.0, 1.0), (1.05 * lap_m, 1.0), (1.5 * lap_m, 2.0)] {
        let [goal] = scenario.goals_ahead(0, robot_m)[..] else { panic!("one goal") };
        assert!((goal.x_m - quarter_m - laps * lap_m).abs() < 1e-6, "{goal:?} from {robot_m}");
    }
}
