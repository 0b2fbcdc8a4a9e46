//! `scanloop bench transport` with what needs no install: what it counts and prints, never how long it takes.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs the benchmark and returns its JSON and its text.
fn bench(system: &TestSystem, arguments: &[&str]) -> (Value, String) {
    let output = system.run(&[&["bench", "transport", "--json"], arguments].concat());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{message}");
    (serde_json::from_slice(&output.stdout).unwrap(), message)
}

fn names(rows: &Value) -> Vec<&str> {
    rows.as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect()
}

/// Every message of a row was either received and timed, or is counted as lost.
fn assert_explained(rows: &Value, sent: u64) {
    for row in rows.as_array().unwrap() {
        let (received, lost) = (row["latency_us"]["count"].as_u64().unwrap(), row["lost"].as_u64().unwrap());
        assert_eq!(row["sent"], sent, "{row}");
        assert_eq!(received + lost, sent, "{row}");
        assert!(received > 0, "nothing came through: {row}");
        for key in ["p50", "p90", "p99", "p999", "max"] {
            assert!(row["latency_us"][key].as_f64().unwrap() > 0.0, "{key}: {row}");
        }
        for key in ["ratio_p50", "ratio_p99"] {
            let low_high = row[format!("{key}_interval")].as_array().unwrap();
            let (low, high) = (low_high[0].as_f64().unwrap(), low_high[1].as_f64().unwrap());
            let ratio = row[key].as_f64().unwrap();
            assert!(low <= ratio && ratio <= high, "{key}: {row}");
        }
    }
}

#[test]
fn every_contender_of_ours_carries_the_pipelines_samples_under_both_policies() {
    let system = TestSystem::new(EXECUTABLE);
    let peers = "floor,floor-futex,unix-socket,iceoryx2-listener";
    let (results, text) = bench(
        &system,
        &["--peers", peers, "--rate", "100", "--samples", "30", "--rounds", "3", "--out", "out"],
    );
    assert_eq!(
        names(&results["transports"]),
        ["iceoryx2", "iceoryx2-listener", "floor", "floor-futex", "unix-socket"]
    );
    assert_eq!(names(&results["polling"]), ["iceoryx2", "floor", "floor-futex", "unix-socket"]);
    assert_explained(&results["transports"], 30);
    assert_explained(&results["polling"], 30);
    assert_eq!((&results["rate_hz"], &results["profile"]), (&100.0.into(), &scanloop_tests::PROFILE.into()));
    assert_eq!(results["hops"], 4);
    assert_eq!(results["scheduling"], "other");
    let sizes = ["odometry", "pose", "obstacles", "command"]
        .map(|topic| topic.parse::<shared_types::Topic>().unwrap().size());
    assert_eq!(results["payload_bytes"], serde_json::to_value(sizes).unwrap());
    assert_eq!(results["transports"][0]["verdict_p50"], "reference");
    assert!(text.contains("times the floor"), "{text}");
    let csv = std::fs::read_to_string(system.folder().join("out/transport.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 3 * 9, "a row per contender and round: {csv}");
    let written = std::fs::read(system.folder().join("out/transport.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&written).unwrap(), results);
}

#[test]
fn large_messages_arrive_whole_over_every_contender_of_ours() {
    let system = TestSystem::new(EXECUTABLE);
    for payload in ["1k", "1M"] {
        let options = "--peers floor,unix-socket,iceoryx2-listener --rate 50 --samples 15 --rounds 3 --policy block --payload";
        let arguments: Vec<&str> = options.split(' ').chain([payload]).collect();
        let (results, _) = bench(&system, &arguments);
        let expected = if payload == "1k" { 1024 } else { 1_048_576 };
        assert_eq!(results["payload_bytes"], expected);
        assert!(results.get("polling").is_none(), "one policy was asked for: {results}");
        assert_explained(&results["transports"], 15);
    }
}

#[test]
fn several_rates_give_a_list_and_all_processes_stay_where_they_are_pinned() {
    let system = TestSystem::new(EXECUTABLE);
    let first = first_processor().to_string();
    let options = "--peers floor --rate 50,100 --samples 6 --rounds 3 --policy poll --cpu";
    let arguments: Vec<&str> = options.split(' ').chain([first.as_str()]).collect();
    let (results, _) = bench(&system, &arguments);
    let list = results.as_array().unwrap();
    assert_eq!(list.iter().map(|one| one["rate_hz"].as_f64().unwrap()).collect::<Vec<_>>(), [50.0, 100.0]);
    for one in list {
        assert_eq!((&one["policy"], &one["load"]), (&Value::from("poll"), &Value::from(false)));
        assert_eq!(one["cpus"], Value::from(vec![first_processor()]));
        assert_explained(&one["transports"], 6);
    }
}

#[test]
fn a_loaded_machine_is_reported() {
    let system = TestSystem::new(EXECUTABLE);
    let options = "--peers floor --rate 100 --samples 3 --rounds 3 --policy block --load";
    let (results, text) = bench(&system, &options.split(' ').collect::<Vec<_>>());
    assert_eq!(results["load"], true);
    assert_explained(&results["transports"], 3);
    assert!(text.contains("every processor busy"), "{text}");
}

#[test]
fn peers_that_are_not_built_are_skipped_with_the_command_that_builds_them() {
    // Polling is not for peers, so nothing of theirs is started even where they are built.
    let system = TestSystem::new(EXECUTABLE);
    let options = "--peers zenoh,zenoh-shm,zeromq,dora --rate 100 --samples 3 --rounds 3 --policy poll";
    let (results, text) = bench(&system, &options.split(' ').collect::<Vec<_>>());
    assert_eq!(names(&results["transports"]), ["iceoryx2"]);
    let skipped = results["skipped"].as_array().unwrap();
    assert_eq!(names(&results["skipped"]), ["zenoh", "zenoh-shm", "zeromq", "dora"]);
    for row in skipped {
        let reason = row["reason"].as_str().unwrap();
        assert!(reason.contains("benches/peers/setup.sh") || reason.contains("--policy poll"), "{row}");
        assert!(text.contains(reason), "{text}");
    }
}

#[test]
fn wrong_options_are_refused_with_what_is_allowed() {
    let system = TestSystem::new(EXECUTABLE);
    for (arguments, parts) in [
        (["--peers", "dds"], ["unknown peer `dds`", "zenoh-shm"]),
        (["--rate", "0"], ["--rate", "0.5 to 5000"]),
        (["--payload", "1000"], ["--payload", "4194304"]),
        (["--cpu", "4095"], ["--cpu 4095 is not allowed", "not among"]),
        (["--rounds", "1"], ["--rounds", "3..=100"]),
    ] {
        let output = system.run(&[&["bench", "transport"], &arguments[..]].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{parts:?}: {message}");
    }
    let output = system.run(&["bench", "transport", "--help"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&output.stdout).contains("Usage: scanloop-lab transport"));
    let laboratory = env!("CARGO_BIN_EXE_scanloop-under-test-lab");
    let output = std::process::Command::new(laboratory).args(["service", "hop"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("bench transport"));
}

/// A processor that this test may use.
fn first_processor() -> usize {
    let set = rustix::thread::sched_getaffinity(None).unwrap();
    (0..rustix::thread::CpuSet::MAX_CPU).find(|cpu| set.is_set(*cpu)).unwrap()
}
