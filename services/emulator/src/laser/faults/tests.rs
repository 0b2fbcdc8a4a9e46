use shared_types::{BEAMS, FRONT_BEAM};

use super::*;
use crate::laser::Laser;
use crate::laser::tests::{SWEEP, circle, quiet, standing};
use crate::scene::Scene;

/// Walls that all beams but those near the track's direction see, 1 m to each side.
const WALLS: &str = "[track]\nwalls = true\ny_m = [-1.0, 1.0]\n";

/// Readings of scan 1, whose front beam is taken at 0.1 s.
fn scan(keys: &str, scene: &str) -> [u32; BEAMS] {
    scans(keys, scene, 1)[0]
}

/// Readings of scans 1 to `count`, ten a second, of a robot at rest.
fn scans(keys: &str, scene: &str, count: u64) -> Vec<[u32; BEAMS]> {
    let scenario = quiet(&format!("{scene}\n[scanner]\n{keys}"));
    let (mut laser, scene, history) = (Laser::new(&scenario), Scene::new(&scenario), standing());
    let mut measure = |scan_id| {
        let mut ranges = [0; BEAMS];
        let sweep = Sweep { scan_id, front_ns: scan_id * 100_000_000, ..SWEEP };
        laser.measure(&sweep, &history, &scene, &mut ranges);
        ranges
    };
    (1..=count).map(&mut measure).collect()
}

fn is_return(reading: u32) -> bool {
    reading >= MIN_RANGE_MM
}

/// How many beams report otherwise; both may have different codes.
fn differences(one: &[u32; BEAMS], other: &[u32; BEAMS]) -> usize {
    let differ = |(one, other): &(&u32, &u32)| one != other && (is_return(**one) || is_return(**other));
    one.iter().zip(other).filter(differ).count()
}

#[test]
fn codes_have_the_shares_of_the_recording_and_their_sum_is_one() {
    assert_eq!(CODES.iter().map(|(_, share)| share).sum::<u32>(), 10_000);
    assert!(CODES.iter().all(|(code, _)| !is_return(*code)));
    let at = [0.0, 0.949_99, 0.950_01, 0.986_99, 0.987_01, 0.996_99, 0.997_01, 0.999_99].map(code_of);
    assert_eq!(at, [0, 0, 7, 7, 6, 6, 10, 1]);
    // 68,200 beams without a return: 0.95 has a standard deviation of 0.0008, 0.037 of 0.0007.
    let all = scans("", "", 100);
    let share =
        |code: u32| all.iter().flatten().filter(|reading| **reading == code).count() as f64 / 68_200.0;
    assert!(
        (share(0) - 0.95).abs() < 0.004 && (share(7) - 0.037).abs() < 0.0035,
        "{} {}",
        share(0),
        share(7)
    );
    assert!((share(6) - 0.01).abs() < 0.002, "{}", share(6));
}

#[test]
fn a_dropout_and_an_empty_direction_have_the_same_codes() {
    let (healthy, lost) = (scans("", WALLS, 3), scans("dropout_steps = [[0, 1]]", WALLS, 3));
    let empty = scans("", "", 3);
    assert!(healthy.iter().flatten().any(|reading| is_return(*reading)));
    assert_eq!(lost, empty);
    assert_ne!(empty[0], empty[1]);
}

#[test]
fn beams_in_dead_sectors_return_nothing_and_the_others_are_as_before() {
    let (healthy, dead) = (scan("", WALLS), scan("dead_rad = [[-1.6, -1.5], [0.5, 1.0]]", WALLS));
    // A pitch is 0.0061359 rad: -1.6 and -1.5 are 260.8 and 244.5 pitches, 0.5 and 1 are 81.5 and 163.0 pitches.
    let is_dead = |beam: usize| {
        (FRONT_BEAM - 260..=FRONT_BEAM - 245).contains(&beam)
            || (FRONT_BEAM + 82..=FRONT_BEAM + 162).contains(&beam)
    };
    for beam in 0..BEAMS {
        let expected = if is_dead(beam) { false } else { is_return(healthy[beam]) };
        assert_eq!(is_return(dead[beam]), expected, "beam {beam}");
        assert!(is_dead(beam) || dead[beam] == healthy[beam]);
    }
    assert!(is_return(healthy[FRONT_BEAM - 250]) && is_return(healthy[FRONT_BEAM + 100]));
}

#[test]
fn a_stuck_scanner_repeats_one_scan_until_the_fault_ends() {
    let scene = circle(3.0, 0.0, 0.2, "velocity_x_mps = -1.0");
    let (free, stuck) = (scans("", &scene, 8), scans("stuck_s = 0.3\nto_s = 0.6", &scene, 8));
    for (index, (free, stuck)) in free.iter().zip(&stuck).enumerate() {
        // Scans 3, 4 and 5; the post is 1 m/s faster: 2.5 m ahead at 0.3 s.
        let expected = if (2..5).contains(&index) { 2500 } else { free[FRONT_BEAM] };
        assert_eq!(stuck[FRONT_BEAM], expected, "scan {}", index + 1);
        assert_eq!(free == stuck, !(3..5).contains(&index), "scan {}", index + 1);
    }
    assert_eq!(free[7][FRONT_BEAM], 2000);
}

#[test]
fn dropouts_come_in_steps_and_a_larger_share_loses_the_same_beams_and_others() {
    let valid = |scan: &[u32; BEAMS]| scan.iter().filter(|reading| is_return(**reading)).count() as f64;
    let healthy = scans("", WALLS, 30);
    let lossy = scans("dropout_steps = [[1.05, 0.25], [2.05, 0.75]]", WALLS, 30);
    let all: f64 = valid(&healthy[0]);
    let share = |scans: &[[u32; BEAMS]]| scans.iter().map(valid).sum::<f64>() / (all * scans.len() as f64);
    // Ten scans of 600 beams and more: a standard deviation of 0.006.
    assert!(all > 600.0);
    assert_eq!(share(&lossy[..10]), 1.0);
    assert!((share(&lossy[10..20]) - 0.75).abs() < 0.03 && (share(&lossy[20..]) - 0.25).abs() < 0.03);
    let (some, more) = (scan("dropout_steps = [[0, 0.3]]", WALLS), scan("dropout_steps = [[0, 0.6]]", WALLS));
    assert!(some.iter().zip(&more).all(|(some, more)| is_return(*some) || !is_return(*more)));
    assert!(some.iter().zip(&more).all(|(some, more)| !is_return(*more) || some == more));
}

#[test]
fn factor_and_offset_change_ranges_before_the_limits_of_the_device() {
    let post = circle(2.0, 0.0, 0.1, "");
    let front = |keys: &str, scene: &str| scan(keys, scene)[FRONT_BEAM];
    assert_eq!(front("range_factor = 1.5", &post), 2850);
    assert_eq!(front("range_offset_m = -0.3", &post), 1600);
    assert_eq!(front("range_factor = 1.5\nrange_offset_m = 0.25", &post), 3100);
    assert!(!is_return(front("range_factor = 3.0", &post)), "5.7 m");
    assert!(!is_return(front("range_offset_m = -1.881", &post)), "19 mm");
    assert_eq!(front("range_offset_m = -1.88", &post), 20);
    // Too little light comes back from 6.9 m, whatever the scale makes of the range.
    assert!(!is_return(front("range_factor = 0.5", &circle(7.0, 0.0, 0.1, ""))));
}

#[test]
fn a_turned_scanner_sees_a_post_in_other_beams() {
    let post = circle(2.0, 0.0, 0.1, "");
    let turned = scan("yaw_rad = 0.6135923151542565", &post);
    // 100 pitches to the left: the post comes 100 beams earlier.
    assert_eq!(turned[FRONT_BEAM - 100], 1900);
    assert!(!is_return(turned[FRONT_BEAM]));
    assert_eq!(scan("yaw_rad = 0.6135923151542565\nfrom_s = 0.2", &post)[FRONT_BEAM], 1900);
}

#[test]
fn salt_and_dust_replace_their_share_by_ranges_within_their_reach() {
    for (keys, reach_mm) in [("salt = 0.1", 5600), ("dust = 0.1", 1000)] {
        let all = scans(keys, "", 100);
        let mut ranges: Vec<u32> = all.into_iter().flatten().filter(|reading| is_return(*reading)).collect();
        ranges.sort_unstable();
        // 0.1 of 68,200 has a standard deviation of 0.0011; the median is in the middle within 1.2 % of the reach.
        assert!((ranges.len() as f64 / 68_200.0 - 0.1).abs() < 0.006, "{keys}: {}", ranges.len());
        let middle = f64::from(ranges[ranges.len() / 2]) / f64::from(20 + reach_mm);
        assert!((middle - 0.5).abs() < 0.03, "{keys}: {middle}");
        let [first, last] = [ranges[0], ranges[ranges.len() - 1]];
        assert!((20..30).contains(&first) && (reach_mm - 10..=reach_mm).contains(&last), "{first} {last}");
    }
    // What they do not hit stays.
    let (healthy, salted) = (scan("", WALLS), scan("salt = 0.01", WALLS));
    assert!((1..20).contains(&differences(&healthy, &salted)));
}

#[test]
fn a_black_obstacle_gives_no_return_from_afar_and_hides_what_is_behind() {
    let (post, panel) = (circle(2.0, 0.0, 0.1, "black = true"), circle(4.5, 0.0, 0.5, ""));
    let front = |keys: &str| scan(keys, &format!("{post}\n{panel}"))[FRONT_BEAM];
    assert!(!is_return(front("")), "1.9 m");
    assert!(!is_return(front("black_range_m = 1.89")));
    assert_eq!(front("black_range_m = 1.91"), 1900);
    assert_eq!(front("from_s = 0.2"), 1900);
    assert_eq!(scan("", &circle(1.59, 0.0, 0.1, "black = true"))[FRONT_BEAM], 1490, "near enough");
    assert_eq!(scan("", &panel)[FRONT_BEAM], 4000, "not black");
}

#[test]
fn no_fault_acts_before_its_time_or_after_it() {
    let keys = "dead_rad = [[-3, 3]]\nrange_factor = 2\nyaw_rad = 1\nsalt = 1\nstuck_s = 0\n\
                dropout_steps = [[0, 1]]\nfrom_s = 0.2\nto_s = 0.4";
    let (healthy, faulty) = (scans("", WALLS, 5), scans(keys, WALLS, 5));
    let equal: Vec<bool> = healthy.iter().zip(&faulty).map(|(one, other)| one == other).collect();
    assert_eq!(equal, [true, false, false, true, true]);
}

#[test]
fn a_fault_never_changes_the_noise_of_the_beams_that_it_leaves_alone() {
    let noisy = |keys: &str| {
        let text = format!("{WALLS}[scanner]\n{keys}\n[noise]\nrange_m = 0.02\ndropout = 0.2");
        let scenario = Scenario::parse(&text, "test").unwrap();
        let (mut laser, mut ranges) = (Laser::new(&scenario), [0; BEAMS]);
        laser.measure(&SWEEP, &standing(), &Scene::new(&scenario), &mut ranges);
        ranges
    };
    let healthy = noisy("");
    let salted = noisy("salt = 0.05");
    for keys in ["dropout_steps = [[0, 0.1]]", "dead_rad = [[-0.3, 0.3]]", "dust = 0.05"] {
        // A tenth of 682 beams, 98 beams, a twentieth; codes stay as well.
        let (faulty, both) = (noisy(keys), noisy(&format!("{keys}\nsalt = 0.05")));
        let changed = faulty.iter().zip(&healthy).filter(|(one, other)| one != other).count();
        assert!((10..110).contains(&changed), "{keys}: {changed}");
        // Where the fault changes nothing, salt is as without it.
        let untouched =
            (0..BEAMS).filter(|beam| faulty[*beam] == healthy[*beam] && is_return(healthy[*beam]));
        assert!(untouched.into_iter().all(|beam| both[beam] == salted[beam]), "{keys}");
    }
}
