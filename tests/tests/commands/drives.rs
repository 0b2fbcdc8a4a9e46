//! Recorded drives as pages that are sent, and compared along their way.

use std::fs;

use scanloop_tests::{SHORT_CORRIDOR, TestSystem};
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A system with the recordings of these seeds, `1.mcap` and so on, and their scans.
fn driven(seeds: &[&str]) -> (TestSystem, Vec<u64>) {
    let system = TestSystem::new(EXECUTABLE);
    let drive = |seed: &&str| {
        let record = format!("--record={seed}.mcap");
        let noise = ["--set", "noise.odometry_m=0.02", "--set", "noise.odometry_rad=0.01"];
        system.lockstep(&[&SHORT_CORRIDOR[..], &noise, &["--seed", seed, &record]].concat()).scans.published
    };
    let scans = seeds.iter().map(drive).collect();
    (system, scans)
}

/// What a command prints to its outputs, and its exit code.
fn said(system: &TestSystem, arguments: &[&str]) -> (String, String, Option<i32>) {
    let output = system.run(arguments);
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    (out, err, output.status.code())
}

#[test]
fn a_drive_becomes_a_page_and_what_is_none_is_refused() {
    let (system, scans) = driven(&["1"]);
    let (text, _, code) = said(&system, &["report", "1.mcap", "-o", "drive.html"]);
    assert_eq!(code, Some(0), "{text}");
    let page = fs::read_to_string(system.folder().join("drive.html")).unwrap();
    // Lock-step grants eight scans beyond the one that ended the run.
    let shown: u64 = text.split(" MB, ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((scans[0]..=scans[0] + 9).contains(&shown), "{text}: {scans:?}");
    assert!(page.len() < 3_000_000 && page.contains("id=\"drive\">") && !page.contains("src="));
    fs::write(system.folder().join("empty"), "").unwrap();
    fs::write(system.folder().join("text"), "no recording").unwrap();
    for (arguments, reason) in [
        (["report", "1.mcap", "-o", "drive.html"], "drive.html: the file exists"),
        (["report", "1.mcap", "-o", "1.mcap"], "the same file as the input"),
        (["report", "empty", "-o", "new.html"], "empty: the file is empty"),
        (["report", "text", "-o", "new.html"], "text: no MCAP file"),
        (["report", "missing", "-o", "new.html"], "missing: No such file"),
    ] {
        let (_, text, code) = said(&system, &arguments);
        assert!(code == Some(2) && text.contains(reason), "{arguments:?}: {text}");
    }
    for (arguments, reason) in [
        (["report", "--compare", "1.mcap", "text", "-o", "new.html"], "text: no MCAP file"),
        (["report", "--compare", "1.mcap", "1.mcap", "-o", "1.mcap"], "the same file as the input"),
    ] {
        let (_, text, code) = said(&system, &arguments);
        assert!(code == Some(2) && text.contains(reason), "{arguments:?}: {text}");
    }
    assert_eq!(said(&system, &["report", "1.mcap", "--compare", "1.mcap", "1.mcap"]).2, Some(2));
    assert!(!system.folder().join("new.html").exists());
    assert_eq!(said(&system, &["report", "--compare", "1.mcap", "1.mcap"]).2, Some(0));
    let page = fs::read_to_string(system.folder().join("compare.html")).unwrap();
    assert!(page.len() < 100_000 && page.contains("id=\"drive\">") && !page.contains("src="));
    assert_eq!(said(&system, &["report", "1.mcap", "-o", "drive.html", "--force"]).2, Some(0));
}

#[test]
fn drives_are_equal_to_themselves_and_part_from_those_of_another_seed() {
    let (system, _) = driven(&["1", "2", "3"]);
    let (text, _, code) = said(&system, &["compare", "1.mcap", "1.mcap"]);
    assert!(code == Some(0) && text.starts_with("equal"), "{text}");
    let json = |arguments: &[&str]| -> Value {
        let (out, err, _) = said(&system, arguments);
        serde_json::from_str(&out).unwrap_or_else(|_| panic!("{err}"))
    };
    let two = json(&["compare", "1.mcap", "2.mcap", "--json"]);
    let part = &two["parts"][0];
    assert!(part["along_m"].as_f64().is_some_and(|along_m| (0.0..10.0).contains(&along_m)), "{two}");
    assert!(part["scans"][0].as_u64().is_some_and(|scan| scan > 0), "{two}");
    let back = json(&["compare", "2.mcap", "1.mcap", "--json"]);
    assert_eq!(back["parts"][0]["along_m"], part["along_m"], "either way round");
    let (_, text, _) = said(&system, &["compare", "1.mcap", "2.mcap"]);
    assert!(!text.contains("equal"), "{text}");

    for (folder, seeds) in [("a", ["1", "2"]), ("b", ["1", "2"]), ("c", ["2", "3"])] {
        fs::create_dir(system.folder().join(folder)).unwrap();
        for seed in seeds {
            let [from, to] =
                ["", folder].map(|place| system.folder().join(place).join(format!("{seed}.mcap")));
            fs::hard_link(from, to).unwrap();
        }
    }
    let same = json(&["compare", "a", "b", "--json"]);
    assert_eq!((&same["by_seed"], &same["parts"]), (&true.into(), &Value::Array(Vec::new())), "{same}");
    let other = json(&["compare", "a", "c", "--json"]);
    assert_eq!(other["by_seed"], false);
    // Some figures, such as the time, may be the same with all seeds.
    let intervals = other["figures"].as_array().unwrap().iter().filter_map(|figure| {
        let [low, high] = [0, 1].map(|end| figure["interval"][end].as_f64());
        Some((low?, figure["difference"].as_f64()?, high?))
    });
    let intervals: Vec<(f64, f64, f64)> = intervals.collect();
    assert!(
        intervals.iter().all(|(low, difference, high)| low <= difference && difference <= high),
        "{other}"
    );
    assert!(intervals.iter().any(|(low, _, high)| low < high), "{other}");

    fs::create_dir(system.folder().join("none")).unwrap();
    for (arguments, reason) in [
        (&["compare", "1.mcap", "none"][..], "none: it holds no recording"),
        (&["compare", "1.mcap", "missing.mcap"], "missing.mcap: No such file"),
        (&["compare", "1.mcap", "2.mcap", "--metric", "wall"], "--metric wall is not allowed"),
    ] {
        let (_, text, code) = said(&system, arguments);
        assert!(code == Some(2) && text.contains(reason), "{arguments:?}: {text}");
    }
}
