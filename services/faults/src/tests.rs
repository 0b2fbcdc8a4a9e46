use shared_types::{Command, MAX_BEAMS, Obstacles, Pose, Role, Sample, Scan, ScanGeometry};

use super::*;

fn change(text: &str) -> Change {
    let text = format!(
        "title = \"\"\nmagnitude = \"\"\n[inject.sample]\n{text}\n\
         [expect]\noutcomes = [\"stopped\"]\ndetected_by = []\nwithin_ms = 0"
    );
    match InjectedFault::parse("test", &text).unwrap().inject {
        Injection::Sample(fault) => Change::new(&fault).unwrap(),
        other => panic!("{other:?}"),
    }
}

fn refusal(text: &str) -> String {
    let expect = "[expect]\noutcomes = [\"stopped\"]\ndetected_by = []\nwithin_ms = 0";
    let text = format!("title = \"\"\nmagnitude = \"\"\n{text}\n{expect}");
    InjectedFault::parse("test", &text).unwrap_err().to_string()
}

fn apply<S: Sample>(change: &mut Change, sample: &mut S) -> Changed {
    change.apply(S::TYPE, bytemuck::bytes_of_mut(sample))
}

#[test]
fn every_shipped_fault_is_allowed_and_has_a_plain_name() {
    let faults = all().unwrap_or_else(|error| panic!("{error}"));
    assert!(faults.len() >= 100, "{}", faults.len());
    for fault in &faults {
        let is_plain = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '-';
        assert!(fault.name.chars().all(is_plain), "{}", fault.name);
        assert!(!fault.title.is_empty() && !fault.magnitude.is_empty(), "{}", fault.name);
        for (phase, differs) in &fault.in_phase {
            assert!(!differs.because.is_empty(), "{}: in.{phase}.because is missing", fault.name);
        }
    }
}

#[test]
fn numbers_are_set_added_and_scaled_wherever_they_stand() {
    let mut pose = Pose { x_m: 2.0, ..Pose::default() };
    let to = change("topic = \"pose\"\naction = \"add\"\nfields = [\"x_m\", \"predicted_x_m\"]\nvalue = 0.5");
    assert_eq!(apply(&mut to.clone(), &mut pose), Changed::Once(0));
    assert_eq!((pose.x_m, pose.predicted_x_m, pose.y_m), (2.5, 0.5, 0.0));

    let mut scan = Scan { ranges_mm: [1000; MAX_BEAMS], ..Scan::of(ScanGeometry::URG_04LX) };
    let mut half = change("topic = \"scan\"\naction = \"scale\"\nfields = [\"ranges_mm\"]\nvalue = 0.5");
    apply(&mut half, &mut scan);
    assert_eq!(scan.ranges_mm, [500; MAX_BEAMS]);

    let mut command = Command { verified: 1, ..Command::default() };
    let mut unverified =
        self::change("topic = \"command\"\naction = \"set\"\nfields = [\"verified\"]\nvalue = 0");
    apply(&mut unverified, &mut command);
    assert_eq!(command.verified, 0);

    let mut obstacles = Obstacles::default();
    let mut nan = change("topic = \"obstacles\"\naction = \"set\"\nfields = [\"items.1.y_m\"]\nvalue = nan");
    apply(&mut nan, &mut obstacles);
    assert!(obstacles.items[1].y_m.is_nan() && obstacles.items[0].y_m == 0.0);
}

#[test]
fn stamps_keep_their_last_digits_and_do_not_wrap() {
    let mut command = Command::default();
    command.header.acquired_ns = 9_007_199_254_740_993;
    let mut later =
        change("topic = \"command\"\naction = \"add\"\nfields = [\"header.acquired_ns\"]\nvalue = 1e9");
    apply(&mut later, &mut command);
    assert_eq!(command.header.acquired_ns, 9_007_200_254_740_993);
    let mut earlier =
        change("topic = \"command\"\naction = \"add\"\nfields = [\"header.acquired_ns\"]\nvalue = -1e18");
    apply(&mut earlier, &mut command);
    assert_eq!(command.header.acquired_ns, 1);
}

#[test]
fn frozen_and_stale_samples_repeat_the_last_good_one() {
    let of = |scan_id, x_m| {
        let mut pose = Pose { x_m, ..Pose::default() };
        (pose.header.scan_id, pose.header.sequence) = (scan_id, scan_id + 10);
        pose
    };
    for (action, scan_id) in [("freeze", 2), ("stale", 1)] {
        let mut change = change(&format!("topic = \"pose\"\naction = \"{action}\""));
        let mut pose = of(2, 2.0);
        assert_eq!(apply(&mut change, &mut pose), Changed::Nothing, "there is none yet");
        change.keep(bytemuck::bytes_of(&of(1, 1.0)));
        assert_eq!(apply(&mut change, &mut pose), Changed::Once(0));
        assert_eq!((pose.x_m, pose.header.scan_id, pose.header.sequence), (1.0, scan_id, 12));
    }
}

#[test]
fn some_fields_can_be_frozen_alone() {
    let mut change = change("topic = \"pose\"\naction = \"freeze\"\nfields = [\"x_m\"]");
    change.keep(bytemuck::bytes_of(&Pose { x_m: 1.0, y_m: 1.0, ..Pose::default() }));
    let mut pose = Pose { x_m: 2.0, y_m: 2.0, ..Pose::default() };
    apply(&mut change, &mut pose);
    assert_eq!((pose.x_m, pose.y_m), (1.0, 2.0));
}

#[test]
fn each_second_sample_is_held_back_when_they_are_reordered() {
    let mut change = change("topic = \"pose\"\naction = \"reorder\"");
    let changed: Vec<Changed> = (0..4).map(|_| apply(&mut change, &mut Pose::default())).collect();
    let [held, now] = [Changed::AfterNext, Changed::Once(0)];
    assert_eq!(changed, [held, now, held, now]);
}

#[test]
fn a_wrong_file_is_refused_with_file_key_and_what_is_allowed() {
    let sample = "[inject.sample]\ntopic = \"pose\"\naction = \"set\"";
    let cases = [
        (format!("{sample}\nfields = [\"z_m\"]"), "inject.sample.fields: pose has no number `z_m`"),
        (format!("{sample}\nfields = [\"gain.9\"]"), "pose has no number `gain.9`"),
        (sample.to_owned(), "inject.sample.fields goes with the actions set, add, scale and freeze"),
        ("[inject.sample]\ntopic = \"pose\"\naction = \"delay\"".to_owned(), "delay_ms goes with"),
        ("[inject.sample]\ntopic = \"poses\"\naction = \"drop\"".to_owned(), "unknown topic `poses`"),
        (
            "[inject.sample]\ntopic = \"pose\"\naction = \"drop\"\nat_robot = true".to_owned(),
            "at_robot: the robot reads the topic actuation only",
        ),
        (
            "[inject.process]\nprocess = \"robot\"\naction = \"hang\"\nseconds = 5".to_owned(),
            "inject.process.seconds = 5 is not allowed: above 0, up to 4",
        ),
        ("[inject.process]\nprocess = \"pilot\"\naction = \"kill\"".to_owned(), "unknown role `pilot`"),
        ("[inject.scenario]\nset = {}\n[in.beside]\noutcomes = [\"won\"]".to_owned(), "`won` is not one of"),
        ("[inject.scenario]\nset = {}\n[in.dusk]\noutcomes = []".to_owned(), "unknown variant `dusk`"),
    ];
    for (text, expected) in cases {
        let message = refusal(&text);
        assert!(message.starts_with("test.toml: ") && message.contains(expected), "{expected}: {message}");
    }
}

#[test]
fn faults_for_running_systems_are_those_that_a_process_can_carry_out() {
    let live = live_names().unwrap();
    for name in
        ["scanner-dead", "pose-late-5ms", "command-not-finite", "drive-weak", "process-actuator-hangs"]
    {
        assert!(live.iter().any(|live| live == name), "{name}");
    }
    for name in
        ["pose-flood", "pose-duplicated", "command-late-400ms", "scanner-late-250ms", "shared-memory-full"]
    {
        assert!(find(name).unwrap().unwrap().refused_live().is_some(), "{name}");
    }
    assert_eq!(find("no-such-fault"), Ok(None));
    let lasts_s = |name: &str| find(name).unwrap().unwrap().lasts_s(0.1);
    assert_eq!([lasts_s("scanner-dead"), lasts_s("machine-stalls-500ms")], [2.0, 0.5]);
    assert!((lasts_s("scan-lost-3") - 0.3).abs() < 1e-9);
}

#[test]
fn a_fault_of_a_running_process_acts_in_the_writer_of_its_topic() {
    let acts_in = |name: &str| find(name).unwrap().unwrap().acts_in();
    assert_eq!(acts_in("pose-frozen"), Some(Role::Estimator));
    assert_eq!(acts_in("scan-lost-3"), Some(Role::Robot));
    assert_eq!(acts_in("drive-weak"), Some(Role::Robot));
    assert_eq!(acts_in("process-actuator-dies"), None);
}
