//! Processes beside the loop: they are kept running, and whatever they do, the robot reaches its goal.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::process::Output;

use emulator::Outcome;
use handover::swap::{Certificate, SwapOutcome};
use report::Report;
use rustix::process::Signal;
use scanloop_tests::{SHORT_FREE, TestSystem};
use session::control::CompanionStatus;
use supervision::supervisor::VisibleState;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const COMPANION: &str = env!("CARGO_BIN_EXE_faulty-companion");

const LAYOUT: &str =
    "name = \"Echo\"\n[[field]]\nname = \"value\"\ntype = \"f64\"\ndoc = \"Number of the scan\"\n";

/// The built-in system with the topic `echo`, a companion that writes it in this way, and one that reads it.
fn system_with(mode: &str, more: &str) -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let built_in = include_str!("../../../orchestrator/systems/default.toml");
    let text = format!(
        "{built_in}\n[[topic]]\nname = \"echo\"\nlayout = \"echo.toml\"\n[[topic]]\nname = \"limit\"\nlayout = \
         \"echo.toml\"\nwriter = \"operator\"\n[[process]]\nrole = \"companion\"\nname = \"writer\"\ncommand = \
         [{COMPANION:?}, {mode:?}]\nreads = [\"odometry\"]\nwrites = [\"echo\"]\n{more}\n[[process]]\nrole = \
         \"companion\"\nname = \"reader\"\ncommand = [{COMPANION:?}, \"read\"]\nreads = [\"echo\"]\n"
    );
    std::fs::write(system.folder().join("lab.toml"), text).unwrap();
    std::fs::write(system.folder().join("echo.toml"), LAYOUT).unwrap();
    system
}

const SYSTEM: [&str; 2] = ["--system", "lab.toml"];

fn started(mode: &str, more: &str) -> TestSystem {
    let mut system = system_with(mode, more);
    system.start(&[&SHORT_FREE[..], &SYSTEM].concat());
    system
}

/// The longest that a log of the run is now [bytes].
fn longest_log(system: &TestSystem) -> u64 {
    let logs = std::fs::read_dir(system.folder().join("out/logs")).into_iter().flatten();
    logs.filter_map(|log| Some(log.ok()?.metadata().ok()?.len())).max().unwrap_or(0)
}

#[test]
fn what_a_companion_prints_is_bounded_while_it_prints() {
    repeat_when_late(|| {
        let system = system_with("echo", "");
        let file = system.folder().join("lab.toml");
        let script = "head -c 400000000 /dev/zero | tr '\\\\0' x; echo the last line; exec sleep 600";
        let row = format!(
            "\n[[process]]\nrole = \"companion\"\nname = \"talker\"\ncommand = [\"sh\", \"-c\", \"{script}\"]\n"
        );
        std::fs::write(&file, std::fs::read_to_string(&file).unwrap() + &row).unwrap();
        let mut system = system;
        system.start(&[&["endless"][..], &SYSTEM].concat());
        let log = system.folder().join("out/logs/talker.log");
        let longest = std::cell::Cell::new(0);
        system.wait_until("it has printed all", |system| {
            longest.set(longest_log(system).max(longest.get()));
            let text = std::fs::read(&log).unwrap_or_default();
            text.len() < 2_000_000 && String::from_utf8_lossy(&text).contains("the last line")
        });
        // Between two looks of the orchestrator a busy machine writes some MiB.
        assert!(longest.get() < 200_000_000, "{} bytes", longest.get());
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        assert!(longest_log(&system) < 2_000_000);
    });
}

#[test]
fn the_rate_of_a_topic_is_that_of_its_writer_however_few_samples_are_seen() {
    repeat_when_late(|| {
        // 2,001 samples for each of ten scans a second.
        let mut system = system_with("flood", "");
        system.start(&[&["endless"][..], &SYSTEM].concat());
        system.wait_until("the flood is on", |system| {
            companion(system, "writer").is_some_and(|writer| writer.rate_hz > 15_000.0)
        });
        let output = system.run(&["topic", "hz", "echo", "--duration", "3"]);
        let text = String::from_utf8(output.stdout).unwrap();
        let number = |before: &str| {
            let words: Vec<&str> = text.lines().last().unwrap().split(' ').collect();
            let index = words.iter().position(|word| word.trim_end_matches(',') == before).unwrap();
            words[index - 1].parse::<f64>().unwrap()
        };
        let rate_hz = companion(&system, "writer").unwrap().rate_hz;
        assert!((number("Hz") / rate_hz - 1.0).abs() < 0.3, "{rate_hz}: {text}");
        assert!(number("lost") > 1_000.0 && number("samples") > 0.0, "{text}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
    });
}

fn companion(system: &TestSystem, name: &str) -> Option<CompanionStatus> {
    system.status()?.companions.into_iter().find(|companion| companion.name == name)
}

/// Waits for the goal; the loop has lost nothing.
fn reached(mut system: TestSystem) -> (Report, String) {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached);
    assert_eq!(
        (report.scans.lost, report.scans.unaccounted, report.ledger.residual),
        (0, 0, 0),
        "{report:?}"
    );
    system.assert_nothing_left();
    (report, system.stderr())
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

#[test]
fn topics_of_a_system_are_listed_measured_echoed_and_published_by_hand() {
    repeat_when_late(|| {
        let system = started("echo", "");
        let list = text(&system.run(&["topic", "list"]));
        let row = list.lines().find(|line| line.starts_with("echo ")).unwrap();
        assert!(row.contains("writer") && row.contains("reader") && row.contains("own.Echo."), "{list}");
        let echoed = system.run(&["topic", "echo", "echo", "-n", "1"]);
        let sample: serde_json::Value = serde_json::from_slice(&echoed.stdout).unwrap();
        assert_eq!(sample["value"].as_f64(), sample["header"]["scan_id"].as_f64());
        assert!(sample["stage"]["published_ns"].as_u64() > sample["header"]["acquired_ns"].as_u64());
        let published = system.run(&["topic", "pub", "limit", "{\"value\": 0.5}"]);
        assert_eq!(published.status.code(), Some(0), "{}", text(&published));
        for (topic, json, message) in [
            ("command", "{}", "topic command belongs to the loop"),
            ("echo", "{}", "topic echo is written by companion writer"),
            ("limit", "{\"speed\": 1}", "speed = 1 is not allowed: one of value"),
            ("other", "{}", "unknown topic `other`"),
        ] {
            let refused = system.run(&["topic", "pub", topic, json]);
            assert_eq!(refused.status.code(), Some(2));
            assert!(text(&refused).contains(message), "{}", text(&refused));
        }
        let writer = companion(&system, "writer").unwrap();
        assert!(writer.published > 0 && writer.state == VisibleState::Ready, "{writer:?}");
        let (report, _) = reached(system);
        assert_eq!(report.companions.len(), 2);
        assert!(report.companions.iter().all(|companion| companion.answered > 20 && companion.invalid == 0));
    });
}

/// Nice value of a process.
fn nice(pid: u32) -> i32 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    // Behind the name, which may have spaces, the fields begin with the third.
    let (_, fields) = status.rsplit_once(") ").unwrap();
    fields.split(' ').nth(19 - 3).unwrap().parse().unwrap()
}

#[test]
fn companions_run_with_a_lower_priority_than_the_loop() {
    repeat_when_late(|| {
        let system = started("echo", "");
        let status = system.status().unwrap();
        let (loops, beside) = (&status.processes, &status.companions);
        assert!(loops.len() == 5 && beside.len() == 2, "{status:?}");
        let most = loops.iter().map(|process| nice(process.pid.cast_unsigned())).max().unwrap();
        assert!(beside.iter().all(|companion| nice(companion.pid) >= most.max(10)), "{most}");
        reached(system);
    });
}

#[test]
fn a_companion_that_is_killed_is_started_again() {
    repeat_when_late(|| {
        let system = started("echo", "");
        system.wait_until("it is ready", |system| {
            companion(system, "writer").is_some_and(|it| it.published > 3)
        });
        let before = companion(&system, "writer").unwrap();
        system.signal(before.pid.cast_signed(), Signal::KILL);
        system.wait_until("it is there again", |system| {
            companion(system, "writer")
                .is_some_and(|it| it.restarts == 1 && it.published > 3 && it.pid != before.pid)
        });
        let (_, stderr) = reached(system);
        assert!(stderr.contains("companion writer ended: killed by signal 9"), "{stderr}");
    });
}

#[test]
fn a_companion_is_replaced_and_restarted_while_the_robot_drives() {
    repeat_when_late(|| {
        let system = started("echo", "");
        let pid = |system: &TestSystem| companion(system, "writer").map_or(0, |it| it.pid);
        let first = pid(&system);
        let swapped = system.run(&["swap", "writer", "--", COMPANION, "echo"]);
        assert_eq!(swapped.status.code(), Some(0), "{}", text(&swapped));
        system.wait_until("it is replaced", |system| ![0, first].contains(&pid(system)));
        let second = pid(&system);
        let restarted = system.run(&["restart", "reader"]);
        assert_eq!(restarted.status.code(), Some(0), "{}", text(&restarted));
        let unknown = system.run(&["restart", "pilot"]);
        assert_eq!(unknown.status.code(), Some(2));
        assert!(text(&unknown).contains("unknown role `pilot`"), "{}", text(&unknown));
        let (report, _) = reached(system);
        assert_ne!(second, first);
        assert!(report.companions.iter().all(|companion| companion.invalid == 0), "{report:?}");
        let [swap, restart] = report.swaps.as_slice() else { panic!("{:?}", report.swaps) };
        assert_eq!((swap.role.as_str(), restart.role.as_str()), ("writer", "reader"));
        for certificate in [swap, restart] {
            assert_eq!(certificate.outcome, SwapOutcome::Swapped, "{certificate}");
        }
        assert_eq!((swap.missed_scans, swap.duplicate_scans), (0, 0), "{swap}");
    });
}

/// A system whose topic `echo` has a bound of agreement.
fn bounded() -> TestSystem {
    let mut system = system_with("echo", "");
    let file = system.folder().join("lab.toml");
    let lab = std::fs::read_to_string(&file).unwrap();
    let topic = "layout = \"echo.toml\"\n";
    let bounded = lab.replacen(topic, &format!("{topic}agree = [{{ field = \"value\", bound = 0.1 }}]\n"), 1);
    std::fs::write(&file, bounded).unwrap();
    system.start(&[&["free"][..], &SYSTEM].concat());
    system
}

#[test]
fn with_a_bound_a_companion_takes_over_after_scans_that_agree_and_one_that_differs_is_refused() {
    repeat_when_late(|| {
        let system = bounded();
        let swap = |mode: &str| {
            let output =
                system.run(&["swap", "writer", "--shadow-scans", "5", "--json", "--", COMPANION, mode]);
            let certificate: Certificate = serde_json::from_slice(&output.stdout)
                .unwrap_or_else(|error| panic!("{error}: {}", text(&output)));
            (output.status.code(), certificate)
        };
        let (code, refused) = swap("shifted");
        assert_eq!((code, refused.outcome), (Some(1), SwapOutcome::Refused), "{refused}");
        assert!(
            refused.reason.contains("field value of topic echo differs by 0.5")
                && refused.reason.contains("0.1"),
            "{refused}"
        );
        let (code, swapped) = swap("echo");
        assert_eq!((code, swapped.outcome), (Some(0), SwapOutcome::Swapped), "{swapped}");
        assert!(swapped.shadow_scans >= 5 && swapped.first_scan_new > Some(10), "{swapped:?}");
        assert_eq!((swapped.missed_scans, swapped.duplicate_scans), (0, 0), "{swapped}");
        let (report, _) = reached(system);
        assert_eq!(report.swaps, [refused, swapped]);
        let row = report.ledger.companions.iter().find(|row| row.reader == "reader").unwrap();
        assert!(row.reasons["authority"] >= 5 && row.residual == 0, "samples of the one in shadow: {row:?}");
    });
}

#[test]
fn the_ledger_and_the_latency_know_topics_beside_the_loop() {
    repeat_when_late(|| {
        let system = started("echo", "");
        system.wait_until("it is ready", |system| {
            companion(system, "writer").is_some_and(|it| it.published > 3)
        });
        let live = system.run(&["latency", "--duration", "1", "--json"]);
        let live: serde_json::Value = serde_json::from_slice(&live.stdout).unwrap();
        let rows = live["latency_us"]["companions"].as_array().unwrap();
        assert!(rows.iter().any(|row| row["topic"] == "echo" && row["writes"] == true), "{rows:?}");
        let (report, _) = reached(system);
        let row = |topic: &str, reader: &str| {
            let found =
                report.ledger.companions.iter().find(|row| (&*row.topic, &*row.reader) == (topic, reader));
            found.unwrap_or_else(|| panic!("{:?}", report.ledger.companions)).clone()
        };
        for row in [row("odometry", "writer"), row("echo", "reader")] {
            let sum = row.used + row.replaced + row.lost + row.in_flight + row.residual;
            assert!(row.used > 20 && row.published == sum && row.residual == 0, "{row:?}");
        }
        let delay = |process: &str, writes: bool| {
            let rows = report.latency_us.companions.iter();
            rows.clone()
                .find(|row| row.topic == "echo" && row.process == process && row.writes == writes)
                .cloned()
        };
        let (published, taken) = (delay("writer", true).unwrap(), delay("reader", false).unwrap());
        assert!(published.count > 20 && taken.count > 20, "{published:?} {taken:?}");
        assert!(taken.mean_us > 0.0 && published.mean_us <= published.max_us, "{published:?} {taken:?}");
    });
}

#[test]
fn one_that_was_built_against_another_layout_is_refused_with_the_field() {
    repeat_when_late(|| {
        let (report, stderr) = reached(started("other-layout", "restart = \"never\""));
        let message = "topic echo: field value is of type u64 in this process, f64 in the system";
        assert!(stderr.contains(message), "{stderr}");
        assert_eq!((report.companions[0].state.as_str(), report.companions[0].published), ("failed", 0));
    });
}

#[test]
fn companions_of_an_adopted_run_are_started_again() {
    repeat_when_late(|| {
        let mut system = started("echo", "");
        system.wait_until("it is ready", |system| {
            companion(system, "writer").is_some_and(|it| it.published > 3)
        });
        let before = companion(&system, "writer").unwrap().pid;
        system.kill_orchestrator();
        system.adopt(&[]);
        system.wait_until("it is there again", |system| {
            companion(system, "writer").is_some_and(|it| it.pid != before && it.published > 3)
        });
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0));
        assert_eq!(report.companions.len(), 2);
        let row = report.ledger.companions.iter().find(|row| row.reader == "reader").unwrap();
        assert!(row.used > 3 && row.residual == 0, "{row:?}");
        system.assert_nothing_left();
    });
}

#[test]
fn one_that_hangs_is_killed_and_named() {
    repeat_when_late(|| {
        let (_, stderr) = reached(started("hang", ""));
        assert!(stderr.contains("companion writer makes no progress: killed"), "{stderr}");
    });
}

#[test]
fn one_that_dies_again_and_again_has_failed_and_the_robot_drives_on() {
    repeat_when_late(|| {
        let (report, stderr) = reached(started("die", "restart_limit = 1"));
        assert!(stderr.contains("companion writer ended: exit code 7"), "{stderr}");
        assert!(stderr.contains("companion writer has failed: the robot drives on without it"), "{stderr}");
        assert_eq!(report.companions[0].state, "failed");
    });
}

#[test]
fn one_that_is_needed_ends_the_run_when_it_has_failed() {
    repeat_when_late(|| {
        let mut system = started("die", "restart = \"never\"\nneeded = true");
        assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
        let report = system.report();
        assert_eq!(report.outcome, Outcome::Failed);
        assert!(
            report.reason.contains("companion writer, which the run needs, has failed"),
            "{}",
            report.reason
        );
        system.assert_nothing_left();
    });
}

#[test]
fn one_that_floods_its_topic_loses_its_own_samples_only() {
    repeat_when_late(|| {
        let (report, stderr) = reached(started("flood", ""));
        assert!(report.companions[0].published > 10_000, "{report:?}");
        let row = report.ledger.companions.iter().find(|row| row.reader == "reader").unwrap();
        assert!(row.reasons["queue_full"] > 1000 && row.residual == 0, "{row:?}");
        let message = "reader dropped samples of topic echo: more came at once than its queue holds";
        assert!(stderr.contains(message), "{stderr}");
    });
}

#[test]
fn numbers_that_are_not_finite_do_not_reach_a_reader() {
    repeat_when_late(|| {
        let (report, stderr) = reached(started("garbage", ""));
        assert!(report.companions[1].invalid > 10, "{report:?}");
        let message = "reader dropped samples of topic echo: a number is not finite";
        assert!(stderr.contains(message), "{stderr}");
        assert!(!stderr.contains("companion reader ended"), "{stderr}");
    });
}

#[test]
fn commands_of_a_companion_are_dropped() {
    repeat_when_late(|| {
        let (report, stderr) = reached(started("command", ""));
        assert!(report.companions[0].published > 20, "{report:?}");
        let [stranger] = report.ledger.strangers.as_slice() else { panic!("{:?}", report.ledger.strangers) };
        assert_eq!((stranger.topic.as_str(), stranger.incarnation), ("command", 4_000_000));
        assert!(stranger.samples > 10, "{stranger:?}");
        assert!(
            stderr.contains("incarnation 4000000 publishes on topic command and fills no role"),
            "{stderr}"
        );
    });
}

#[test]
fn memory_that_a_companion_does_not_free_is_shown() {
    repeat_when_late(|| {
        let system = started("leak", "");
        system.wait_until("it has grown", |system| {
            companion(system, "writer").is_some_and(|it| it.memory_kib > 100_000)
        });
        reached(system);
    });
}

#[test]
fn lock_step_waits_for_companions_and_their_samples_are_part_of_the_digests() {
    repeat_when_late(|| {
        let drive = |more: &str| {
            let system = system_with("echo", more);
            let report = system.lockstep(&[&SHORT_FREE[..], &SYSTEM].concat());
            assert_eq!(report.outcome, Outcome::Reached);
            report
        };
        let (one, other, left_out) = (drive(""), drive(""), drive("lockstep = false"));
        assert_eq!(one.digests, other.digests);
        assert!(one.digests.contains_key("echo"));
        assert!(!left_out.digests.contains_key("echo"));
        assert_eq!(one.digests["actuation"], left_out.digests["actuation"], "the loop does not depend on it");
        assert!(one.companions[0].answered >= one.scans.published - 1, "{:?}", one.companions);
    });
}

#[test]
fn one_that_hangs_in_lock_step_leaves_it_and_is_named_in_the_report() {
    repeat_when_late(|| {
        let report = system_with("hang", "").lockstep(&[&SHORT_FREE[..], &SYSTEM].concat());
        assert_eq!(report.outcome, Outcome::Reached);
        assert_eq!(report.companions[0].left_lockstep_at_scan, Some(11));
    });
}

#[test]
fn bad_systems_are_refused_with_file_key_and_value() {
    repeat_when_late(|| {
        let system = system_with("echo", "");
        let checked = system.run(&["check", "lab.toml"]);
        assert_eq!(checked.status.code(), Some(0), "{}", text(&checked));
        assert!(text(&checked).contains("(writer = "), "{}", text(&checked));
        assert!(text(&checked).contains("shared memory: "), "{}", text(&checked));
        let lab = std::fs::read_to_string(system.folder().join("lab.toml")).unwrap();
        for (from, to, message) in [
            ("reads = [\"odometry\"]", "reads = [\"truth\"]", "process[5].reads = truth is not allowed"),
            ("writes = [\"echo\"]", "writes = []", "topic[0].name = echo is not allowed: a writer"),
            (
                "name = \"reader\"",
                "name = \"writer\"",
                "process[6].name = writer is not allowed: each name once",
            ),
            ("reads = [\"odometry\"]", "reads = [\"echo\"]", "process.reads = writer -> writer"),
        ] {
            std::fs::write(system.folder().join("lab.toml"), lab.replace(from, to)).unwrap();
            for command in [&["check", "lab.toml"][..], &["run", "--system", "lab.toml"]] {
                let refused = system.run(command);
                assert_eq!(refused.status.code(), Some(2), "{to}: {}", text(&refused));
                let text = text(&refused);
                assert!(text.contains("error: lab.toml: ") && text.contains(message), "{text}");
            }
        }
    });
}
