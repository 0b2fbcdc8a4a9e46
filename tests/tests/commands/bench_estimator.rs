//! `scanloop bench estimator`: its rows, its picture, and what it refuses.

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn each_robot_has_a_row_with_a_filter_and_one_without() {
    let system = TestSystem::new(EXECUTABLE);
    let short =
        ["--seeds", "2", "--way", "12", "--robot", "ideal", "--robot", "summit", "--scenario", "empty"];
    let output = system.run(&[&["bench", "estimator", "--json", "--svg", "pose.svg"], &short[..]].concat());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
    let (rows, odometers) = (results["rows"].as_array().unwrap(), results["odometer"].as_array().unwrap());
    for (rows, filters) in [(rows, true), (odometers, false)] {
        let robots: Vec<&str> = rows.iter().filter_map(|row| row["robot"].as_str()).collect();
        let twice = ["ideal", "ideal", "summit", "summit"];
        assert_eq!(robots, if filters { &twice[..] } else { &["ideal", "summit"] });
        for (place, row) in rows.iter().enumerate() {
            let laser = if filters && place % 2 == 1 { "match" } else { "off" };
            assert_eq!(
                (&row["runs"], &row["collision"], &row["laser"]),
                (&2.into(), &0.into(), &laser.into())
            );
            assert!(number(row, "rms_m") < number(row, "max_m") && number(row, "max_m") < 0.5, "{row}");
            assert_eq!(row["coverage_95"].is_number() && row["nis_mean"].is_number(), filters, "{row}");
            assert!(row["over_time"].as_array().unwrap().len() > 10, "{row}");
        }
    }
    // White noise of 20 mm on each of two axes, which the filter makes smaller.
    let [filtered, raw] = [rows, odometers].map(|rows| number(&rows[0], "rms_m"));
    assert!((raw - 0.0283).abs() < 0.003 && filtered < raw / 2.0, "{filtered} of {raw}");
    assert!(
        number(&rows[1], "rms_m") < filtered && number(&rows[3], "rms_m") < 0.01,
        "{} {}",
        rows[1],
        rows[3]
    );
    let picture = std::fs::read_to_string(system.folder().join("pose.svg")).unwrap();
    assert!(picture.contains("summit, no filter") && picture.contains("NEES"), "{picture}");
    let again = system.run(&["bench", "estimator", "--svg", "pose.svg"]);
    let text = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(again.status.code() == Some(2) && text.contains("--force"), "{text}");
}

#[test]
fn a_way_or_a_setting_that_is_not_allowed_is_named() {
    let system = TestSystem::new(EXECUTABLE);
    for (option, expected) in [
        ("--way=5", "--way = 5 is not allowed: 10 to 9900"),
        ("--duration=0", "--duration = 0 is not allowed: 1 to 100000"),
        ("--set=robot.gyro_scale=3", "robot.gyro_scale = 3 is not allowed: -0.1 to 0.1"),
    ] {
        let output = system.run(&["bench", "estimator", option]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && text.contains(expected), "{text}");
    }
}
