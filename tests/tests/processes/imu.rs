//! The example with an inertial sensor: a companion measures, an estimator of your own uses it.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use emulator::Outcome;
use runtime::LayoutFile;
use scanloop_tests::TestSystem;

/// The struct of the example, from its own source.
#[path = "../../../examples/rust/imu/src/imu.rs"]
mod sensor;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const SENSOR: &str = env!("CARGO_BIN_EXE_imu-sensor-under-test");
const ESTIMATOR: &str = env!("CARGO_BIN_EXE_imu-estimator-under-test");
const JUDGE: &str = env!("CARGO_BIN_EXE_imu-judge-under-test");

/// The robot `summit` with a gyro that is ten times worse.
const WORSE: [&str; 6] = [
    "--set",
    "robot.preset=summit",
    "--set",
    "robot.gyro_noise_rad=0.002",
    "--set",
    "robot.gyro_bias_walk_radps=0.0002",
];

fn example() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/rust/imu"))
}

/// The root of the mean square of the yaw error of one drive [rad].
fn yaw_error_rad(seed: u32, estimator: &[&str]) -> f64 {
    let system = TestSystem::new(EXECUTABLE);
    let file = example().join("system.toml");
    let command = |key: &str, words: &[&str]| format!("process.{key}.command={words:?}");
    let overrides = [
        command("sensor", &[SENSOR, &seed.to_string()]),
        command("judge", &[JUDGE]),
        command("estimator", &[&[ESTIMATOR], estimator].concat()),
    ];
    let seed = seed.to_string();
    let mut arguments = vec!["free", "--system", file.to_str().unwrap(), "--seed", &seed];
    overrides.iter().for_each(|text| arguments.extend(["--set", text]));
    arguments.extend(WORSE);
    let report = system.lockstep(&arguments);
    assert!(
        [Outcome::Reached, Outcome::Missed].contains(&report.outcome),
        "{}: {}",
        report.outcome,
        report.reason
    );
    assert!(
        report.companions.iter().all(|companion| companion.left_lockstep_at_scan.is_none()),
        "{report:?}"
    );
    let log = std::fs::read_to_string(system.folder().join("out/logs/judge.log")).unwrap();
    let line = log.lines().find_map(|line| line.trim().strip_prefix("yaw_error_rad = "));
    line.unwrap_or_else(|| panic!("no error in {log}")).parse().unwrap()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    f64::midpoint(values[(values.len() - 1) / 2], values[values.len() / 2])
}

#[test]
fn with_the_sensor_the_median_yaw_error_is_at_most_half() {
    repeat_when_late(|| {
        let seeds = 1..=20;
        let with = median(seeds.clone().map(|seed| yaw_error_rad(seed, &[])).collect());
        let without = median(seeds.map(|seed| yaw_error_rad(seed, &["odometry"])).collect());
        assert!(with > 0.0 && with <= without / 2.0, "with {with} rad, without {without} rad");
    });
}

#[test]
fn the_struct_of_the_example_is_what_the_executable_prints() {
    repeat_when_late(|| {
        let layout = example().join("imu.toml");
        for (form, expected) in [
            ("--rust", "pub yaw_rate_radps: f64"),
            ("--c", "double yaw_rate_radps"),
            ("--python", "class Imu"),
        ] {
            let output =
                Command::new(EXECUTABLE).args(["types", form, "--layout"]).arg(&layout).output().unwrap();
            let printed = String::from_utf8(output.stdout).unwrap();
            assert!(printed.contains(expected), "{printed}");
            if form == "--rust" {
                assert_eq!(printed, std::fs::read_to_string(example().join("src/imu.rs")).unwrap());
            }
        }
    });
}

#[test]
fn the_layout_file_of_the_example_is_what_its_struct_gives() {
    repeat_when_late(|| {
        let layout =
            LayoutFile::of::<sensor::Imu>("What an inertial sensor measures between two scans.").unwrap();
        let file = std::fs::read_to_string(example().join("imu.toml")).unwrap();
        assert_eq!(file.parse::<LayoutFile>().unwrap(), layout);
        assert_eq!(layout.text().parse::<LayoutFile>().unwrap(), layout, "{}", layout.text());
    });
}

/// Contents of all files of the product: its sources, and the executable.
fn product() -> BTreeMap<PathBuf, Vec<u8>> {
    fn add(folder: &Path, found: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            match path.is_dir() {
                true => add(&path, found),
                false => _ = found.insert(path.clone(), std::fs::read(&path).unwrap()),
            }
        }
    }
    let mut found = BTreeMap::new();
    for folder in ["shared-types", "services", "orchestrator"] {
        add(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(folder), &mut found);
    }
    found.insert(EXECUTABLE.into(), std::fs::read(EXECUTABLE).unwrap());
    found
}

#[test]
fn the_examples_need_no_change_of_the_product() {
    repeat_when_late(|| {
        let before = product();
        assert!(yaw_error_rad(1, &[]) > 0.0);
        let after = product();
        let changed: Vec<_> = before.keys().filter(|path| before.get(*path) != after.get(*path)).collect();
        assert!(changed.is_empty() && before.len() == after.len(), "{changed:?}");
        // Nor does the product know the programs, topics and settings of the examples, but for what `scanloop new` copies.
        let is_code = |path: &Path| path.extension().is_some_and(|end| end == "rs");
        let copies = |path: &Path| path.ends_with("new/template.rs");
        for (path, content) in before.iter().filter(|(path, _)| is_code(path) && !copies(path)) {
            let text = String::from_utf8_lossy(content);
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            let code = code.take_while(|line| !line.contains("#[cfg(test)]"));
            for name in ["imu-sensor", "imu-estimator", "imu-judge", "advisor.py", "speed-limit"] {
                assert!(!code.clone().any(|line| line.contains(name)), "{} in {}", name, path.display());
            }
        }
    });
}
