//! `scanloop bench latency` and `bench compare` on short runs: counts, keys and files, never times.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::process::Output;

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, system_file};
use serde_json::Value;
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-role");

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs the bench for a second at 50 Hz and returns its JSON and its text.
fn bench(system: &TestSystem, arguments: &[&str]) -> (Value, String) {
    let short = ["bench", "latency", "--rate", "50", "--duration", "1.2", "--quiet", "--json"];
    let output = system.run(&[&short, arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (serde_json::from_slice(&output.stdout).unwrap(), stderr(&output))
}

fn assert_nothing_unexplained(results: &Value) {
    let count = |key: &str| results[key].as_u64().unwrap_or_else(|| panic!("{key}: {results}"));
    assert!(count("published") >= 60 && count("commanded") > 0, "{results}");
    assert_eq!(count("published"), count("commanded") + count("lost") + count("unaccounted"));
    assert_eq!(count("complete_chains"), count("commanded"), "every actuation carries its whole chain");
    assert_eq!(results["scan_to_actuation_us"]["count"], results["commanded"]);
    // Each scan counts here, whether it was answered or not; those in flight at the end do not.
    let corrected = results["scan_to_actuation_corrected_us"]["count"].as_u64().unwrap();
    assert!((count("commanded")..=count("published")).contains(&corrected), "{results}");
}

#[test]
fn the_pipeline_is_measured_and_the_files_are_those_that_tools_read() {
    repeat_when_late(measure_the_pipeline);
}

fn measure_the_pipeline() {
    let system = TestSystem::new(EXECUTABLE);
    let (results, text) = bench(&system, &["--out", "measured"]);
    system.assert_nothing_left();
    assert_nothing_unexplained(&results);
    for stage in ["estimator", "obstacles", "controller", "actuator"] {
        assert_eq!(results["stages_us"][stage]["count"], results["commanded"], "{stage}");
    }
    for key in ["data_age_us", "transport_us", "robot_lateness_us", "wake_up_noise_us"] {
        for figure in ["count", "p50", "p90", "p99", "p999", "max"] {
            assert!(results[key][figure].is_number(), "{key}.{figure}");
        }
    }
    for key in ["kernel", "cores", "governor", "timer_slack_ns", "idle_states", "load_average"] {
        assert!(results["machine"].get(key).is_some(), "{key}: {}", results["machine"]);
    }
    assert_eq!((&results["rate_hz"], &results["outcome"]), (&Value::from(50.0), &Value::from("timeout")));
    assert!(results["stamps_us_per_stage"].as_f64().unwrap() > 0.0);
    assert_eq!(results["profile"], scanloop_tests::PROFILE);
    assert!(text.contains(&format!("built with the profile `{}`", scanloop_tests::PROFILE)), "{text}");
    for expected in ["scan to actuation", "corrected", "wake-up noise", "smallest visible", "profile"] {
        assert!(text.contains(expected), "{expected}: {text}");
    }

    let read = |name: &str| std::fs::read_to_string(system.folder().join("measured").join(name)).unwrap();
    let report: Value = serde_json::from_str(&read("report.json")).unwrap();
    assert_eq!(report["published"], results["published"]);
    assert!(read("latency.hlog").starts_with("#[Histogram log format version 1.3]"));
    assert!(read("latency.hlog").contains("\nTag=scan_to_actuation,0.000,"));
    for name in ["scan_to_actuation.hgrm", "scan_to_actuation_corrected.hgrm"] {
        assert!(read(name).contains("#[Mean") && read(name).contains(" 1.000000000000 "), "{name}");
    }
    for name in ["histogram.svg", "ccdf.svg"] {
        assert!(read(name).starts_with("<svg") && read(name).contains("controller"), "{name}");
    }
    let trace: Value = serde_json::from_str(&read("trace.json")).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let count = |phase: &str| events.iter().filter(|event| event["ph"] == phase).count() as u64;
    let commanded = results["commanded"].as_u64().unwrap();
    assert_eq!((count("s"), count("t"), count("f")), (commanded, 3 * commanded, commanded));
    assert!(read("logs/controller.log").contains("controller"));

    // A run does not differ from itself, and each of its figures can be asked for.
    let compare = |arguments: &[&str]| {
        let file = "measured/report.json";
        let output = system.run(&[&["bench", "compare", file, file, "--json"], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    for arguments in [&[][..], &["--metric", "stages_us.controller.p50"], &["--metric", "transport_us.p50"]] {
        let verdict = compare(arguments);
        assert_eq!(verdict["verdict"], "no difference", "{verdict}");
        assert_eq!(verdict["difference"], 0.0);
        assert!(verdict["smallest_visible"].as_f64().unwrap() > 0.0);
        assert!(verdict["interval"].as_array().is_some_and(|interval| interval.len() == 2));
    }
}

#[test]
fn the_chain_without_compute_carries_any_payload_under_load() {
    repeat_when_late(carry_any_payload);
}

fn carry_any_payload() {
    let system = TestSystem::new(EXECUTABLE);
    let (results, text) = bench(&system, &["--compute", "none", "--payload", "100000", "--load"]);
    system.assert_nothing_left();
    assert_nothing_unexplained(&results);
    assert_eq!(
        (&results["compute"], &results["payload_bytes"]),
        (&Value::from("none"), &Value::from(100_000))
    );
    assert_eq!(results["machine"]["busy_loops"], results["machine"]["cores"]);
    assert!(text.contains("100000 bytes on each hop"), "{text}");
}

#[test]
fn real_time_processes_on_one_processor_run_or_are_refused_with_the_way_out() {
    repeat_when_late(run_on_one_processor);
}

fn run_on_one_processor() {
    let system = TestSystem::new(EXECUTABLE);
    let arguments = ["bench", "latency", "--compute", "none", "--rate", "50", "--duration", "0.4", "--quiet"];
    let output = system.run(&[&arguments[..], &["--sched", "fifo", "--cpu", "0", "--json"]].concat());
    system.assert_nothing_left();
    match output.status.code() {
        Some(0) => {
            let results: Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(results["machine"]["scheduling"], "fifo");
            assert_eq!(results["machine"]["pinned_to"], serde_json::json!([0]));
            assert!(results["commanded"].as_u64().unwrap() > 0);
        }
        code => {
            assert_eq!(code, Some(4), "{}", stderr(&output));
            assert!(stderr(&output).contains("rtprio 40"), "{}", stderr(&output));
        }
    }
}

#[test]
fn a_sample_that_nothing_explains_makes_no_measurement() {
    repeat_when_late(lose_a_sample);
}

fn lose_a_sample() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("system.toml");
    std::fs::write(&file, system_file(100, &[Role::Estimator], FAULTY, &["drop", "pose", "20"])).unwrap();
    let arguments = ["bench", "latency", "--rate", "100", "--duration", "1", "--quiet", "--json", "--system"];
    let output = system.run(&[&arguments[..], &[file.to_str().unwrap()]].concat());
    system.assert_nothing_left();
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(results["residual"].as_u64().unwrap() > 0, "{results}");
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("unaccounted for"), "{}", stderr(&output));
}

#[test]
fn what_is_not_allowed_is_named() {
    let system = TestSystem::new(EXECUTABLE);
    for (arguments, expected) in [
        (&["latency", "--rate", "2000"][..], "--rate 2000 is not allowed: 0.5 to 1000"),
        (&["latency", "--payload", "100"], "--payload 100 is not allowed with --compute real"),
        (&["latency", "--cpu", "1-0"], "--cpu 1-0 is not allowed"),
        (&["latency", "--cpu", "900"], "processor 900 is not among"),
        (&["compare", "a.json", "b.json"], "a.json"),
        (&["compare", "--ab", "true", "true", "--rounds", "7"], "--rounds 7 is not allowed: 8 to 1000"),
        (
            &["compare", "--ab", "true", "true"],
            "does not print JSON with a number at scan_to_actuation_us.p50",
        ),
        (&["compare"], "required"),
    ] {
        let output = system.run(&[&["bench"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
    }
    let output = system.run(&["bench", "compare", "--ab", "true", "exit 3", "--metric", "wall"]);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
}

#[test]
fn commands_in_turns_are_told_apart_by_what_they_print() {
    let system = TestSystem::new(EXECUTABLE);
    // Each command counts its runs, so that its figures are not all the same.
    let command = |name: &str, offset: u32| {
        format!("echo x >> {name}; n=$(wc -l < {name}); echo \"{{\\\"t_us\\\": $((n % 3 + {offset}))}}\"")
    };
    let compare = |a: &str, b: &str| {
        let arguments = ["bench", "compare", "--metric", "t_us", "--json", "--ab", a, b];
        let output = system.run(&arguments);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let same = compare(&command("a", 100), &command("b", 100));
    assert_eq!((&same["verdict"], &same["metric"]), (&Value::from("no difference"), &Value::from("t_us")));
    assert!(same["rounds_to_settle"].is_null() && same["text"].as_str().unwrap().contains("equal"), "{same}");
    // 100 to 102 against 101 to 107, four rounds in seven in favour of B.
    let wide = "echo x >> e; n=$(wc -l < e); echo \"{\\\"t_us\\\": $((n * 5 % 7 + 98))}\"";
    let unsettled = compare(&command("f", 100), wide);
    assert_eq!(unsettled["verdict"], "no difference", "{unsettled}");
    if unsettled["difference"] != 0.0 {
        let rounds = unsettled["rounds_to_settle"].as_u64().unwrap();
        assert!(unsettled["text"].as_str().unwrap().contains(&format!("--rounds {rounds}")), "{unsettled}");
    }
    let slower = compare(&command("c", 100), &command("d", 150));
    assert_eq!((&slower["verdict"], &slower["difference"]), (&Value::from("slower"), &Value::from(50.0)));
    assert_eq!(slower["rounds"].as_array().unwrap().len(), 12);
    assert!(slower["text"].as_str().unwrap().starts_with("B is 50.0 us slower (99 % interval"));
}
