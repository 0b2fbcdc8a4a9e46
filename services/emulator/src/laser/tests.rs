use shared_types::{BEAMS, FRONT_BEAM, MIN_RANGE_MM};

use super::*;
use crate::history::Node;
use crate::scenario::{MAX_RANGE_M, Surroundings};

pub(super) const SWEEP: Sweep = Sweep { scan_id: 1, front_ns: 100_000_000, duration_ns: 66_666_666 };

fn node(time_ns: u64, state: State) -> Node {
    Node {
        time_ns,
        state,
        speed: 0.0,
        steering: 0.0,
        reported: Vector2::zeros(),
        reported_yaw: 0.0,
        encoder_m: 0.0,
    }
}

pub(super) fn standing() -> History {
    History::new(node(0, State::default()), 1_000_000_000)
}

/// A scenario without noise in open surroundings, so that a beam that misses everything has no return.
pub(super) fn quiet(text: &str) -> Scenario {
    let mut scenario = in_hall(text);
    scenario.track.surroundings = Surroundings::Open;
    scenario
}

fn in_hall(text: &str) -> Scenario {
    Scenario::parse(&format!("{text}\n[noise]\nrange_m = 0.0"), "test").unwrap()
}

/// Readings of one sweep, with the same code for all beams without a return.
fn readings(scenario: &Scenario, history: &History) -> [u32; BEAMS] {
    let mut ranges = [7; BEAMS];
    Laser::new(scenario).measure(&SWEEP, history, &Scene::new(scenario), &mut ranges);
    ranges.map(|reading| if reading < MIN_RANGE_MM { NO_RETURN } else { reading })
}

pub(super) fn circle(x: f64, y: f64, radius: f64, more: &str) -> String {
    format!("[[obstacle]]\nshape = \"circle\"\nx_m = {x}\ny_m = {y}\nradius_m = {radius}\n{more}")
}

#[test]
fn a_post_straight_ahead_is_seen_at_its_near_side_by_as_many_beams_as_it_is_wide() {
    let ranges = readings(&quiet(&circle(2.0, 0.0, 0.1, "")), &standing());
    assert_eq!(ranges[FRONT_BEAM], 1900);
    // asin(0.1 / 2) = 2.866 deg to each side, 8.15 pitches of 0.3516 deg: 17 beams.
    let hits: Vec<usize> = (0..BEAMS).filter(|beam| ranges[*beam] >= MIN_RANGE_MM).collect();
    assert_eq!((hits[0], hits.len()), (FRONT_BEAM - 8, 17));
    assert_eq!(ranges[0], NO_RETURN);
}

#[test]
fn a_box_is_seen_with_its_flat_face_and_the_right_beams_come_first() {
    let text = "[[obstacle]]\nshape = \"box\"\nx_m = 3.05\ny_m = -0.5\nlength_m = 0.1\nwidth_m = 1.0";
    let ranges = readings(&quiet(text), &standing());
    // Face at x = 3 from y = -1 to 0: beam 300 points 40 pitches = 14.0625 deg to the right, 3 / cos = 3.0927.
    assert_eq!(ranges[300], 3093);
    assert_eq!(ranges[FRONT_BEAM - 1], 3000);
    assert_eq!(ranges[FRONT_BEAM + 2], NO_RETURN, "nothing on the left");
}

#[test]
fn walls_are_seen_at_their_distance_over_the_cosine() {
    let scenario = quiet("[track]\nwalls = true\ny_m = [-1.9, 1.9]");
    let ranges = readings(&scenario, &standing());
    // 256 pitches are 90 deg.
    assert_eq!((ranges[FRONT_BEAM - 256], ranges[FRONT_BEAM + 256]), (1900, 1900));
    // 171 pitches: 1.9 / sin(60.117 deg) = 2.1914.
    assert_eq!(ranges[FRONT_BEAM + 171], 2191);
    assert_eq!(ranges[FRONT_BEAM], NO_RETURN);
}

#[test]
fn a_hall_is_seen_behind_obstacles_and_with_noise_as_they_are() {
    let ranges = readings(&in_hall(&circle(2.0, 0.0, 0.1, "")), &standing());
    assert_eq!(ranges[FRONT_BEAM], 1900);
    // The pillar at x = 0 to both sides, and nothing ahead within the reach: the end wall is 24 m away.
    assert_eq!((ranges[FRONT_BEAM - 256], ranges[FRONT_BEAM + 256]), (3200, 3200));
    // 192 pitches are 67.5 deg: the wall is met at x = 3.5 / tan = 1.45, 3.5 / sin = 3.788.
    assert_eq!((ranges[FRONT_BEAM - 192], ranges[FRONT_BEAM + 192]), (3788, 3788));
    assert_eq!(ranges[FRONT_BEAM + 20], NO_RETURN);
    // 80 pitches are 28.1 deg, which meets the wall at 7.4 m; 120 pitches are 42.2 deg, at 5.21 m.
    assert_eq!((ranges[FRONT_BEAM + 80], ranges[FRONT_BEAM + 120]), (NO_RETURN, 5212));
    let noisy = Scenario::parse("[noise]\nrange_m = 0.02", "test").unwrap();
    let noisy = readings(&noisy, &standing());
    let far = (FRONT_BEAM + 180..FRONT_BEAM + 240).map(|beam| (noisy[beam].abs_diff(ranges[beam]), beam));
    assert!(far.clone().any(|(off, _)| off > 20) && far.clone().all(|(off, _)| off < 100), "{far:?}");
}

#[test]
fn beside_a_course_its_hall_is_seen() {
    let course = "waypoints = [{ x_m = 0, y_m = 0 }, { x_m = 20, y_m = 0 }]\nwidth_m = 2.0\nsurroundings";
    let ranges = |surroundings: &str| {
        let text = format!("[course]\n{course} = {surroundings:?}\n[noise]\nrange_m = 0.0");
        readings(&Scenario::parse(&text, "test").unwrap(), &standing())
    };
    let hall = ranges("hall");
    // The pillar at the begin to both sides; 192 pitches are 67.5 deg: 3 / sin = 3.247.
    assert_eq!((hall[FRONT_BEAM - 256], hall[FRONT_BEAM + 256]), (2700, 2700));
    assert_eq!((hall[FRONT_BEAM - 192], hall[FRONT_BEAM + 192]), (3247, 3247));
    assert!(ranges("open").iter().all(|reading| *reading < MIN_RANGE_MM));
}

#[test]
fn a_moving_robot_sees_a_skewed_scan() {
    // 1 m/s along x: the beam at +60 deg (171 of 682 sweep positions later) starts 16.7 mm further ahead.
    let mut history = History::new(node(0, State::default()), 1_000_000_000);
    history.push(node(200_000_000, State { x: 0.2, ..State::default() }));
    let scenario = quiet("[[obstacle]]\nshape = \"box\"\nx_m = 2.15\ny_m = 0\nlength_m = 0.1\nwidth_m = 9");
    let ranges = readings(&scenario, &history);
    // Front beam at t = 0.1 s: robot at 0.1, face at 2.1.
    assert_eq!(ranges[FRONT_BEAM], 2000);
    for beam in [FRONT_BEAM - 128, FRONT_BEAM + 128] {
        // 45 deg; the right beam was taken 12.5 ms earlier and is longer by 25 mm * sqrt(2) than the left one.
        let shift = (beam as f64 - FRONT_BEAM as f64) / BEAMS as f64 * 0.066_666_666;
        let expected = (2.0 - shift) * std::f64::consts::SQRT_2 * 1000.0;
        assert!((f64::from(ranges[beam]) - expected).abs() <= 0.51, "{} {expected}", ranges[beam]);
    }
    assert_eq!(ranges[FRONT_BEAM - 128] - ranges[FRONT_BEAM + 128], 35);
}

#[test]
fn a_moving_obstacle_is_hit_where_it_is_at_the_time_of_the_beam() {
    let scenario = quiet(&circle(3.0, 0.0, 0.2, "velocity_x_mps = -1.0"));
    let ranges = readings(&scenario, &standing());
    assert_eq!(ranges[FRONT_BEAM], 2700);
    let gone = quiet(&circle(3.0, 0.0, 0.2, "disappears_s = 0.0995"));
    let ranges = readings(&gone, &standing());
    assert!(ranges[FRONT_BEAM - 10] > 2000, "still there a millisecond before the front beam");
    assert_eq!(ranges[FRONT_BEAM], NO_RETURN);
}

#[test]
fn culling_changes_nothing() {
    let mut stream = NoiseStream::new(5, Purpose::Course, 0);
    for _ in 0..200 {
        let (x, y) = (stream.between(-5.0, 5.0), stream.between(-5.0, 5.0));
        if x.hypot(y) < 1.5 {
            continue;
        }
        let scenario = quiet(&circle(x, y, stream.between(0.05, 1.0), "velocity_y_mps = 0.7"));
        let yaw = stream.between(-3.0, 3.0);
        let mut history = History::new(node(0, State { yaw, ..State::default() }), 1_000_000_000);
        history.push(node(200_000_000, State { yaw: yaw + 0.3, x: 0.2, ..State::default() }));
        let (mut laser, scene) = (Laser::new(&scenario), Scene::new(&scenario));
        laser.cast(&SWEEP, &history, &scene);
        let culled = laser.ranges.clone();
        let near = scene.near(Vector2::zeros(), 100.0).next().unwrap();
        laser.ranges.fill(f64::INFINITY);
        laser.cast_at(near, 0..=BEAMS - 1);
        for (with, without) in culled.iter().zip(&laser.ranges) {
            assert!(with == without || *without > MAX_RANGE_M);
        }
    }
}

#[test]
fn readings_are_error_codes_below_20_mm_and_beyond_5600_mm() {
    let silent = Noise { range_m: 0.0, ..Noise::default() };
    let mut stream = NoiseStream::new(1, Purpose::Laser, 1);
    let mut reading =
        |range| reading_of(range, &ScannerDescription::default(), (&silent, Scale::TRUE), &mut stream);
    assert_eq!(reading(0.0194), NO_RETURN);
    assert_eq!(reading(0.0196), 20);
    assert_eq!(reading(5.6), 5600);
    assert_eq!(reading(5.6001), NO_RETURN);
    assert_eq!(reading(f64::INFINITY), NO_RETURN);
    assert!(reading(f64::NAN) < MIN_RANGE_MM, "never a range");
}

#[test]
fn noise_and_dropouts_are_as_frequent_as_asked_for() {
    let scenario = Scenario::parse(
        &format!("{}[noise]\nrange_m = 0.02\ndropout = 0.05", "[track]\nwalls = true\ny_m = [-1.0, 1.0]\n"),
        "test",
    )
    .unwrap();
    let (mut laser, scene, history) = (Laser::new(&scenario), Scene::new(&scenario), standing());
    let (mut lost, mut count, mut squares) = (0, 0, 0.0);
    for scan_id in 1..=100 {
        let mut ranges = [0; BEAMS];
        laser.measure(&Sweep { scan_id, ..SWEEP }, &history, &scene, &mut ranges);
        for beam in (0..BEAMS).filter(|beam| laser.ranges[*beam] < 5.0) {
            count += 1;
            if ranges[beam] < MIN_RANGE_MM {
                lost += 1;
            } else {
                squares += (f64::from(ranges[beam]) * 1e-3 - laser.ranges[beam]).powi(2);
            }
        }
    }
    // About 60000 beams: five standard errors are 0.0045 of the share and 1.5 % of the deviation.
    assert!((f64::from(lost) / f64::from(count) - 0.05).abs() < 0.0045);
    let deviation = (squares / f64::from(count - lost)).sqrt();
    assert!((deviation / 0.02 - 1.0).abs() < 0.015, "{deviation}");
}

#[test]
fn a_mixed_pixel_lies_between_the_two_sides_of_an_edge() {
    let text = format!(
        "{}[[obstacle]]\nshape = \"box\"\nx_m = 3.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 6\n\
         [noise]\nrange_m = 0.0\nmixed_pixels = 1\n[track]\nsurroundings = \"open\"",
        circle(1.5, 0.0, 0.1, "")
    );
    let ranges = readings(&Scenario::parse(&text, "test").unwrap(), &standing());
    let between = ranges.iter().filter(|range| (1600..2900).contains(*range)).count();
    assert!(
        (1..=2).contains(&between),
        "one at each edge of the post unless it lands near a side: {between}"
    );
}

#[test]
fn beams_start_at_the_scanner_and_turn_with_it() {
    let post = circle(2.0, 0.0, 0.1, "");
    let mounted = |keys: &str| readings(&quiet(&format!("{post}\n[robot]\n{keys}")), &standing());
    assert_eq!(mounted("scanner_x_m = 0.25")[FRONT_BEAM], 1650);
    // 0.05 m to the left of the line, the post is hit 2 - sqrt(0.01 - 0.0025) ahead.
    assert_eq!(mounted("scanner_y_m = 0.05")[FRONT_BEAM], 1913);
    // An eighth of a turn to the left is 128 pitches: the post comes 128 beams earlier.
    let turned = mounted("scanner_yaw_rad = 0.7853981633974483");
    assert_eq!((turned[FRONT_BEAM], turned[FRONT_BEAM - 128]), (NO_RETURN, 1900));
    // Ahead of a robot that looks to the left is to the left of the track.
    let mut history = History::new(node(0, State::default()), 1_000_000_000);
    history.push(node(1, State { yaw: std::f64::consts::FRAC_PI_2, ..State::default() }));
    let scenario = quiet("[track]\nwalls = true\ny_m = [-2.0, 2.0]\n[robot]\nscanner_x_m = 0.25");
    assert_eq!(readings(&scenario, &history)[FRONT_BEAM], 1750);
}

#[test]
fn another_scanner_sees_with_its_own_beams_as_far_as_it_reaches() {
    let keys = "[robot.scanner]\nbeams = 1081\nincrement_rad = 0.004363323129985824\nrange_m = 10.0\nmin_range_m = 1.0\n";
    let scenario = quiet(&format!("{keys}{}{}", circle(9.0, 0.0, 0.5, ""), circle(0.0, -0.9, 0.05, "")));
    let mut laser = Laser::new(&scenario);
    assert_eq!((laser.geometry().count, laser.geometry().front().round()), (1081, 540.0));
    let mut ranges = [7; 1081];
    laser.measure(&SWEEP, &standing(), &Scene::new(&scenario), &mut ranges);
    // asin(0.5 / 9) = 3.185 deg to each side are 12.7 of its beams.
    let hits: Vec<usize> = (0..1081).filter(|beam| ranges[*beam] >= MIN_RANGE_MM).collect();
    assert_eq!((hits[0], hits.len(), ranges[540]), (528, 25, 8500));
    assert!(ranges[540 - 360] < MIN_RANGE_MM, "the post at its right is nearer than it measures");
}
