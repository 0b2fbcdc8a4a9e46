//! A scanner that fails: the robot stops in time, and drives on where what is left is enough.

use emulator::{Outcome, Scenario};
use pipeline::PipelineSettings;

use crate::{End, end, parse};

/// Faults with which each scenario is driven to its end all the same.
const BEARABLE: [&str; 11] = [
    "dropout_steps = [[0, 0.5]]",
    "dead_rad = [[0.52, 0.70]]",
    "dead_rad = [[-0.35, -0.175]]",
    "dead_rad = [[-0.262, -0.0873]]",
    "dead_rad = [[0.175, 0.35]]",
    "dead_rad = [[-1.05, -0.87]]",
    "salt = 0.01",
    "dust = 0.01",
    "stamp_jitter_s = 0.02",
    "missing_every = 5",
    "period_s = [0.005, 0.255]",
];

/// Faults that nothing can be reached with, or not always, from the start or in the middle of a drive.
const SEVERE: [&str; 34] = [
    "dropout_steps = [[0, 0.7]]",
    "dropout_steps = [[0, 0.9]]",
    "dropout_steps = [[0, 0.98]]",
    "dropout_steps = [[0, 1]]",
    "dropout_steps = [[4, 0.95]]",
    "dropout_steps = [[5, 1]]",
    "dead_rad = [[-3.1, 3.1]]",
    "dead_rad = [[-0.8, 0.8]]",
    "dead_rad = [[0, 1.2]]",
    "dead_rad = [[-2.2, -0.1]]",
    "dead_rad = [[-0.3, 0.3]]\nfrom_s = 4",
    "dead_rad = [[-0.502, 1.923]]\nfrom_s = 2.9",
    "stuck_s = 0",
    "stuck_s = 3",
    "stuck_s = 4.2",
    "range_factor = 0.5",
    "range_factor = 1.2",
    "range_factor = 1.5",
    "range_factor = 2",
    "range_factor = 1.4\nfrom_s = 2.5",
    "range_factor = 1.5\nfrom_s = 3\nto_s = 5",
    "range_offset_m = -0.4",
    "range_offset_m = 0.2",
    "range_offset_m = 0.5",
    "range_offset_m = 2.1\nfrom_s = 1.1",
    "yaw_rad = 0.1",
    "yaw_rad = 0.3",
    "yaw_rad = -0.5\nfrom_s = 4",
    "salt = 0.3",
    "salt = 1",
    "dust = 0.3",
    "dust = 1\nfrom_s = 4",
    "missing_every = 2",
    "missing_every = 1\nfrom_s = 3",
];

fn with_scanner(name: &str, preset: &str, seed: u64, keys: &str) -> End {
    let mut table: toml::Table = Scenario::shipped(name).unwrap().parse().unwrap();
    table.insert("seed".into(), toml::Value::Integer(seed as i64));
    let robot = table.entry("robot").or_insert_with(|| toml::Table::new().into());
    robot.as_table_mut().unwrap().insert("preset".into(), preset.into());
    table.insert("scanner".into(), keys.parse::<toml::Table>().unwrap().into());
    end(&PipelineSettings::of(parse(&toml::to_string(&table).unwrap())))
}

#[test]
fn a_degraded_scanner_is_good_enough_for_every_outcome() {
    let outcomes = [
        ("corridor", Outcome::Reached),
        ("slalom", Outcome::Reached),
        ("crossing", Outcome::Reached),
        ("walls", Outcome::Reached),
        ("blocked", Outcome::Stopped),
    ];
    for (index, keys) in BEARABLE.iter().enumerate() {
        for (name, outcome) in outcomes {
            let preset = if index % 2 == 0 { "summit" } else { "ideal" };
            let end = with_scanner(name, preset, 3, keys);
            assert!(end.is_untouched(), "{name}, {preset}, {keys}: {end:?}");
            assert_eq!(end.outcome, outcome, "{name}, {preset}, {keys}: {end:?}");
        }
    }
}

#[test]
fn no_fault_of_the_scanner_ends_in_a_contact() {
    for (index, keys) in SEVERE.iter().enumerate() {
        for (offset, name) in ["corridor", "slalom", "two-obstacles"].into_iter().enumerate() {
            let preset = ["ideal", "summit", "worn"][(index + offset) % 3];
            let end = with_scanner(name, preset, 1, keys);
            assert!(end.is_untouched(), "{name}, {preset}, {keys}: {end:?}");
        }
    }
}

#[test]
fn a_front_that_is_covered_while_a_body_stands_there_stays_unseen() {
    let covered = with_scanner("sudden", "ideal", 508_713, "dead_rad = [[-0.780, 0.749]]\nfrom_s = 4.3");
    assert!(covered.is_untouched(), "{covered:?}");
}

#[test]
fn stamps_that_jitter_are_no_wrong_calibration() {
    for seed in [14, 21, 23] {
        let end = with_scanner("crossing", "summit", seed, "stamp_jitter_s = 0.02");
        assert_eq!(end.outcome, Outcome::Reached, "seed {seed}: {end:?}");
    }
}

#[test]
fn a_blind_scanner_is_the_reason_of_the_stop_and_does_not_last() {
    let blind = with_scanner("corridor", "ideal", 1, "dropout_steps = [[3, 1]]");
    assert_eq!(blind.outcome, Outcome::Stopped);
    assert!(blind.reason.contains("scanner"), "{}", blind.reason);
    let healed = with_scanner("corridor", "ideal", 1, "dropout_steps = [[3, 1], [5, 0]]");
    assert_eq!(healed.outcome, Outcome::Reached, "{}", healed.reason);
}

#[test]
fn an_outage_that_leaves_some_returns_is_over_when_they_come_again() {
    for (from_s, to_s, share) in [(2.6, 3.1, 0.8), (3.0, 5.0, 0.9), (4.1, 4.5, 0.95), (5.3, 8.0, 0.85)] {
        let keys = format!("dropout_steps = [[{from_s}, {share}], [{to_s}, 0]]");
        let end = with_scanner("corridor", "summit", 1, &keys);
        assert_eq!(end.outcome, Outcome::Reached, "{keys}: {}", end.reason);
    }
}

#[test]
fn a_front_that_is_covered_during_an_outage_stays_unseen() {
    for seed in [508_713, 2, 3, 4, 5, 6] {
        let keys = "dead_rad = [[-0.780, 0.749]]\nfrom_s = 3.3\ndropout_steps = [[3.3, 0.9], [6, 0]]";
        let covered = with_scanner("sudden", "ideal", seed, keys);
        assert!(covered.is_untouched(), "seed {seed}: {covered:?}");
    }
}

#[test]
fn in_open_surroundings_the_robot_is_careful() {
    let text = "name = \"open\"\ntimeout_s = 90\n[track]\nsurroundings = \"open\"\n[goal]\nx_m = 4\n";
    let (mut fastest, mut scans) = (0.0_f64, 0);
    let drive = pipeline::drive(&PipelineSettings::of(parse(text)), |step| {
        fastest = fastest.max(step.truth.speed_mps);
        scans += 1;
    })
    .unwrap();
    assert_eq!(drive.outcome, Outcome::Reached, "{}", drive.reason);
    assert!(fastest < 0.31 && scans > 100, "{fastest} m/s, {scans} scans");
}
