//! Pictures of given models, compared letter by letter with the files in `golden`.

use ratatui_core::backend::TestBackend;
use ratatui_core::terminal::Terminal;
use report::BlockingReport;
use session::control::EventRow;
use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, GivenGoal, Obstacle, Obstacles, PlanNode, Pose, Scan,
    ScanGeometry, StopReason, Truth,
};
use supervision::supervisor::VisibleState;
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::{Description, Goal, Track};

use super::super::model::Course;
use super::*;

/// The picture of a model as lines without blanks at their ends.
fn picture(model: &Model, [columns, rows]: [u16; 2]) -> String {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
    terminal.draw(|frame| draw(frame.area(), frame.buffer_mut(), model)).unwrap();
    let buffer = terminal.backend().buffer().clone();
    let line = |row| {
        let line: String = (0..columns).map(|column| buffer[(column, row)].symbol()).collect();
        line.trim_end().to_owned() + "\n"
    };
    (0..rows).map(line).collect()
}

fn assert_golden(name: &str, picture: &str) {
    let path = format!("{}/src/top/golden/{name}.txt", env!("CARGO_MANIFEST_DIR"));
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(picture == kept, "{path} differs from this picture:\n{picture}");
}

fn process(role: Role, implementation: &str, state: VisibleState) -> ProcessStatus {
    let json = serde_json::json!({
        "role": role.name(), "implementation": implementation, "pid": 4000 + role.index(), "state": state,
        "restarts": 0, "rate_hz": 10.0, "last_sample_age_ms": 42.4, "cpu_percent": 1.25, "memory_kib": 5120,
        "last_words": [],
    });
    serde_json::from_value(json).unwrap()
}

fn event(number: u64, time_s: f64, warning: bool, text: &str) -> EventRow {
    EventRow { number, time_s, warning, text: text.to_owned() }
}

/// A robot 4 m before a box, with a plan that passes it on the left.
fn driving() -> Model {
    let processes = [
        (Role::Robot, "emulator"),
        (Role::Estimator, "ekf"),
        (Role::Obstacles, "ellipses"),
        (Role::Controller, "nmpc"),
        (Role::Actuator, "actuation"),
    ];
    let processes = processes.map(|(role, name)| process(role, name, VisibleState::Ready)).to_vec();
    let status = SystemStatus {
        system_id: "lab".to_owned(),
        state: "driving".to_owned(),
        scenario: "corridor".to_owned(),
        scan: 37,
        processes,
        events: vec![event(1, 0.0, false, "controller: started")],
        ..SystemStatus::default()
    };
    let pose = Pose { x_m: 2.0, y_m: 0.1, yaw_rad: 0.2, speed_mps: 0.98, ..Pose::default() };
    let item = Obstacle {
        x_m: 5.0,
        a_m: 0.9,
        b_m: 0.6,
        box_x_m: 5.0,
        box_length_m: 0.3,
        box_width_m: 0.4,
        ..Obstacle::default()
    };
    let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
    obstacles.items[0] = item;
    let mut command = Command { kind: CommandKind::Drive.wire(), plan_length: 13, ..Command::default() };
    for (index, node) in command.plan.iter_mut().enumerate() {
        let x_m = 2.0 + 0.45 * index as f64;
        *node = PlanNode { x_m, y_m: 0.1 + 0.8 * ((x_m - 2.0) / 3.0).sin().max(0.0), ..PlanNode::default() };
    }
    let actuation =
        Actuation { kind: ActuationKind::Drive.wire(), desired_steering_rad: 0.021, ..Actuation::default() };
    let mut model = Model {
        system_id: "lab".to_owned(),
        status: Some(status),
        course: Course::new(
            Track::default(),
            vec![Goal::default()],
            vehicle::Course::default(),
            Description::default(),
        ),
        pose: Some(pose),
        truth: Some(Truth { speed_mps: 0.97, clearance_m: 2.41, ..Truth::default() }),
        actuation: Some(actuation),
        command: Some(Box::new(command)),
        obstacles: Some(Box::new(obstacles)),
        stages_ms: [0.05, 0.21, 0.84, 0.02, 0.33],
        ..Model::default()
    };
    (0..40).for_each(|scan| model.react(1.0 + f64::from(scan % 7) * 0.25));
    let mut scan = Scan::of(ScanGeometry::URG_04LX);
    scan.ranges_mm.iter_mut().step_by(6).for_each(|range_mm| *range_mm = 3000);
    model.place(&scan);
    model
}

#[test]
fn a_drive_fits_on_80_by_24() {
    let picture = picture(&driving(), [80, 24]);
    assert!(picture.lines().all(|line| line.chars().count() <= 80));
    assert_golden("driving", &picture);
}

#[test]
fn a_course_is_drawn_with_its_bounds_and_the_distance_to_the_goal_is_along_it() {
    let mut model = driving();
    // 2 m straight on and a quarter of a circle with 6 m radius.
    let waypoints = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (8.0, 6.0, std::f64::consts::FRAC_PI_2)];
    let waypoints = waypoints.map(|(x_m, y_m, yaw_rad)| Waypoint::new(x_m, y_m, Some(yaw_rad))).to_vec();
    let way = vehicle::Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap();
    let track = Track { x_m: [-2.0, way.length_m() + 2.0], ..Track::default() };
    let goal = Goal { x_m: way.length_m(), ..Goal::default() };
    model.course = Course::new(track, vec![goal], way, Description::default());
    let goal = model.course.goals_in_plane().next().unwrap();
    assert!((goal.x_m - 8.0).abs() < 1e-9 && (goal.y_m - 6.0).abs() < 1e-9);
    model.pose = Some(Pose::default());
    // Over the corner it would be 10.0 m.
    let with_course = picture(&model, [80, 24]);
    assert!(with_course.contains("goal 11.4 m"), "{with_course}");
    model.course.outline = None;
    assert_ne!(with_course, picture(&model, [80, 24]), "the bounds of the way are drawn");
}

#[test]
fn a_goal_that_was_given_is_drawn_from_its_scan_on() {
    let mut model = driving();
    model.course.goals = vec![Goal::default()];
    model.pose = Some(Pose::default());
    model.course.give(&GivenGoal { from_scan: 7, x_m: 8.0, tolerance_m: 0.2, ..GivenGoal::default() });
    let shows = |model: &mut Model, scan_id| {
        model.course.heed_goal(scan_id);
        picture(model, [80, 24]).contains("goal 8.0 m")
    };
    assert!(!shows(&mut model, 6) && shows(&mut model, 7));
    // One that is not newer is no other.
    model.course.give(&GivenGoal { from_scan: 7, x_m: 9.0, ..GivenGoal::default() });
    assert!(shows(&mut model, 8));
}

#[test]
fn a_stop_and_a_swap_are_shown_with_their_events() {
    let mut model = driving();
    let status = model.status.as_mut().unwrap();
    status.blocking = Some(BlockingReport { id: 17, x_m: 6.0, y_m: 0.1, gap_m: 0.12, needed_m: 0.62 });
    status.processes.insert(4, process(Role::Controller, "./mine.py --fast", VisibleState::Shadow));
    status.processes[1].state = VisibleState::Backoff;
    for (number, text) in
        [(2, "controller: ./mine.py starts beside nmpc"), (3, "estimator (ekf) ended: signal 9")]
    {
        status.events.push(event(number, 3.1, number == 3, text));
    }
    model.actuation = Some(Actuation {
        kind: ActuationKind::Block.wire(),
        stop_reason: StopReason::Blocked.wire(),
        ..Actuation::default()
    });
    model.selected = 3;
    model.note("restart controller ...".to_owned());
    assert_golden("stopped", &picture(&model, [80, 24]));
}

#[test]
fn help_waiting_and_other_sizes() {
    let mut model = driving();
    model.help = true;
    assert_golden("help", &picture(&model, [80, 24]));
    let waiting = Model { system_id: "lab".to_owned(), of_run: true, ..Model::default() };
    assert_golden("waiting", &picture(&waiting, [80, 24]));
    let small = picture(&driving(), [40, 10]);
    assert!(small.starts_with("the terminal is too small: 72 x 20 neede"), "{small}");
    // Every size is drawn, from nothing to a wall.
    for size in [[1, 1], [72, 20], [73, 60], [200, 21], [300, 100]] {
        let lines = picture(&driving(), size);
        assert_eq!(lines.lines().count(), usize::from(size[1]));
    }
    assert!(picture(&driving(), [200, 60]).contains("p99 2.50  max 2.50"));
}

#[test]
fn text_from_outside_moves_no_cursor() {
    let mut model = driving();
    model.status.as_mut().unwrap().scenario = "a\u{1b}[2Jb\nc".to_owned();
    let first = picture(&model, [80, 24]);
    assert!(first.starts_with(" lab: driving, a\\u001b[2Jb c"), "{first}");
    assert!(!first.contains('\u{1b}'), "{first}");
}
