//! The ledger of a run: it names each planted fault, raises no false alarm, and attributes time to the right stage.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::cell::RefCell;
use std::collections::BTreeMap;

use audit::ledger::DeliveryFaultKind;
use emulator::Outcome;
use report::Report;
use report::latency::attribute;
use runtime::{Bus, Observer};
use scanloop_tests::{DelayPlace, STAGES, TestSystem, plan, system_file};
use shared_types::{Actuation, Header, Role, Topic};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-role");

/// What can be wrong with a sample, and how it is named: in real time, and in lock-step, where a sample that is held
/// back stops the loop.
const FAULTS: [(&str, DeliveryFaultKind, DeliveryFaultKind); 6] = [
    ("drop", DeliveryFaultKind::Missing, DeliveryFaultKind::Missing),
    ("omit", DeliveryFaultKind::Missing, DeliveryFaultKind::Missing),
    ("repeat", DeliveryFaultKind::Duplicate, DeliveryFaultKind::Duplicate),
    ("double", DeliveryFaultKind::Duplicate, DeliveryFaultKind::Duplicate),
    ("swap", DeliveryFaultKind::Reordered, DeliveryFaultKind::Missing),
    ("mix", DeliveryFaultKind::Reordered, DeliveryFaultKind::Missing),
];

/// Topics with the role that writes them.
const TOPICS: [(Topic, Role); 7] = [
    (Topic::Odometry, Role::Robot),
    (Topic::Scan, Role::Robot),
    (Topic::Truth, Role::Robot),
    (Topic::Pose, Role::Estimator),
    (Topic::Obstacles, Role::Obstacles),
    (Topic::Command, Role::Controller),
    (Topic::Actuation, Role::Actuator),
];

/// A generator of numbers that are the same for the same seed.
struct Dice(u64);

impl Dice {
    /// A number below `sides`.
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }
}

#[test]
fn a_stage_that_does_not_take_a_topic_of_its_role_is_charged_with_no_loss() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let file = system.folder().join("system.toml");
        let program = env!("CARGO_BIN_EXE_dead-reckoning-under-test");
        std::fs::write(&file, system_file(100, &[Role::Estimator], program, &[])).unwrap();
        system.start(&["free", "--system", file.to_str().unwrap(), "--duration", "2"]);
        system.wait();
        let ledger = system.report().ledger;
        assert_eq!((ledger.residual, ledger.faults.len()), (0, 0), "{:?}", ledger.faults);
        let read =
            |topic: &str| ledger.topics.iter().any(|row| row.topic == topic && row.reader == "estimator");
        assert!(read("odometry") && !read("actuation") && !read("scan"), "{:?}", ledger.topics);
        system.assert_nothing_left();
    });
}

/// Plants one fault in a run; returns scan and number of the sample that it affected, if any, and the report.
fn hide(fault: &str, topic: Topic, role: Role, scan: u64, lockstep: bool) -> (Option<[u64; 2]>, Report) {
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("system.toml");
    let rate_hz = if lockstep { 10 } else { 100 };
    let arguments = [fault, topic.name(), &scan.to_string()];
    std::fs::write(&file, system_file(rate_hz, &[role], FAULTY, &arguments)).unwrap();
    let file = file.to_str().unwrap();
    let report = if lockstep {
        system.lockstep(&["--system", file, "--duration", "2"])
    } else {
        system.start(&["--system", file, "--duration", "1"]);
        system.wait();
        system.report()
    };
    system.assert_nothing_left();
    (log(&system, role, "wrong").first().map(|line| [line[0], line[1]]), report)
}

/// Numbers in the lines of a role's log with a prefix: `prefix scan 17 ns 25` has 17 and 25.
fn log(system: &TestSystem, role: Role, prefix: &str) -> Vec<Vec<u64>> {
    let text = std::fs::read_to_string(system.folder().join(format!("out/logs/{role}.log"))).unwrap();
    let lines = text.lines().filter(|line| line.starts_with(prefix));
    lines.map(|line| line.split(' ').filter_map(|number| number.parse().ok()).collect()).collect()
}

/// Plants one random fault and checks that the report names exactly it.
fn finds_one(dice: &mut Dice, lockstep: bool) {
    let (fault, live_kind, lockstep_kind) = FAULTS[dice.roll(6) as usize];
    let (topic, role) = TOPICS[dice.roll(7) as usize];
    let at = 1 + dice.roll(if lockstep { 20 } else { 100 });
    let (befallen, report) = hide(fault, topic, role, at, lockstep);
    let what = format!("{fault} {topic} at {at}, scan and number {befallen:?}, lock-step {lockstep}");
    let [scan, number] = befallen.unwrap_or_else(|| {
        panic!("{what}: it was not done: {:?}, {:?}: {}", report.scans, report.outcome, report.reason)
    });
    let kind = if lockstep && topic != Topic::Truth { lockstep_kind } else { live_kind };
    let Some(first) = report.ledger.faults.first() else {
        panic!("{what}: {:?} {:?}", report.ledger, report.scans);
    };
    eprintln!("{what}: {first}");
    assert_eq!(first.kind, kind, "{what}: {first}");
    // A sample that is held back and let go at the end is missing first and late then.
    for found in &report.ledger.faults {
        assert_eq!(found.topic, topic.name(), "{what}: {found}");
        let is_named = found.scan_id == scan || found.scan_id == 0 && found.sequence == number;
        assert!(is_named && (found.scan_id, found.sequence) != (0, 0), "{what}: {found}");
    }
}

/// What the orchestrator may need at most when samples lie about their numbers [KiB].
const MAX_MEMORY_KIB: u64 = 400_000;

/// The most memory that the orchestrator has needed so far [KiB].
fn memory_kib(system: &TestSystem) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{}/status", system.orchestrator())).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0)
}

/// In real time every eighth sample of a topic has another wrong number in its header: 0, one less, one more, 1,000 more,
/// and 2^40 to 2^64 - 1 as sequence, as scan, and as either stamp. The run continues, and names them.
#[test]
fn no_number_in_a_header_ends_a_run_or_takes_its_memory() {
    repeat_when_late(|| {
        for (topic, role) in TOPICS {
            let mut system = TestSystem::new(EXECUTABLE);
            let file = system.folder().join("system.toml");
            std::fs::write(&file, system_file(100, &[role], FAULTY, &["forge", topic.name(), "40"])).unwrap();
            system.start(&["--system", file.to_str().unwrap(), "--duration", "4"]);
            let largest = std::cell::Cell::new(0);
            system.wait_until("the run ends", |system| {
                largest.set(memory_kib(system).max(largest.get()));
                system.status().is_none_or(|status| status.state != "driving")
            });
            let code = system.wait().code();
            let report = system.report();
            assert!(matches!(code, Some(0 | 1)), "{topic}: {code:?}: {} {}", report.reason, system.stderr());
            assert!(largest.get() < MAX_MEMORY_KIB, "{topic}: {} KiB", largest.get());
            assert_eq!(log(&system, role, "wrong").len(), 32, "{topic}");
            let named = |fault: &audit::ledger::DeliveryFault| {
                fault.kind == DeliveryFaultKind::Impossible && fault.topic == topic.name()
            };
            assert!(report.ledger.faults.iter().any(named), "{topic}: {:?}", report.ledger.faults);
            assert!(report.ledger.impossible >= 8, "{topic}: {}", report.ledger.impossible);
            // Each blocks the wheels for some scans at most: most scans have a command of their own.
            let scans = &report.scans;
            assert!(scans.commanded > scans.published / 2, "{topic}: {scans:?}");
            assert!(scans.published < 2_000, "{topic}: {scans:?}");
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_number_that_can_not_be_ends_a_lock_step_with_its_name() {
    repeat_when_late(|| {
        // 2^63 and 2^64 - 1 as sequence, 1,000 too much and 2^63 as scan.
        for (topic, role) in TOPICS {
            for (fault, field) in
                [("forge-6", "sequence"), ("forge-7", "sequence"), ("forge-11", "scan"), ("forge-14", "scan")]
            {
                let (befallen, report) = hide(fault, topic, role, 8, true);
                let what =
                    format!("{fault} {topic} at {befallen:?}: {} {:?}", report.reason, report.ledger.faults);
                let named = |found: &audit::ledger::DeliveryFault| {
                    found.topic == topic.name() && found.kind == DeliveryFaultKind::Impossible
                };
                assert!(report.ledger.faults.iter().any(named), "{field}: {what}");
                if topic != Topic::Truth {
                    assert_eq!(report.outcome, Outcome::Failed, "{field}: {what}");
                    assert!(report.reason.contains(topic.name()), "{field}: {what}");
                }
            }
        }
    });
}

/// Trials of a kind: few in every run of the tests, all with `SCANLOOP_TRIALS=200`.
fn trials(few: u64) -> u64 {
    std::env::var("SCANLOOP_TRIALS").ok().and_then(|text| text.parse().ok()).unwrap_or(few)
}

#[test]
fn a_hidden_fault_in_lock_step_is_named_with_topic_and_scan() {
    repeat_when_late(|| {
        let mut dice = Dice(1);
        (0..trials(12)).for_each(|_| finds_one(&mut dice, true));
    });
}

#[test]
fn a_hidden_fault_in_real_time_is_named_with_topic_and_scan() {
    repeat_when_late(|| {
        let mut dice = Dice(2);
        (0..trials(5)).for_each(|_| finds_one(&mut dice, false));
    });
}

#[test]
fn a_clean_run_raises_no_alarm() {
    repeat_when_late(|| {
        let mut dice = Dice(3);
        for trial in 0..trials(6) {
            let mut system = TestSystem::new(EXECUTABLE);
            let seed = dice.roll(1_000_000).to_string();
            let report = if trial % 2 == 0 {
                system.lockstep(&["long", "--seed", &seed])
            } else {
                let rate = ["rate_hz=10", "rate_hz=100", "rate_hz=500"][dice.roll(3) as usize];
                system.start(&["--seed", &seed, "--duration", "1", "--set", rate]);
                system.wait();
                system.report()
            };
            assert_clean(&report);
            system.assert_nothing_left();
        }
    });
}

/// That every sample of every topic is accounted for.
fn assert_clean(report: &Report) {
    let ledger = &report.ledger;
    assert_eq!(ledger.faults, [], "{ledger:?}");
    assert_eq!((ledger.residual, ledger.duplicates, ledger.reordered), (0, 0, 0));
    assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
    assert_eq!(ledger.topics.len(), 9, "{ledger:?}");
    for row in &ledger.topics {
        assert_eq!(row.residual, 0, "{row:?}");
        assert_eq!(row.published, row.used + row.replaced + row.lost + row.in_flight, "{row:?}");
    }
}

/// The headers of all actuations that answered a scan, read from the bus while the system drives.
fn answers(system: &TestSystem) -> BTreeMap<u64, Header> {
    let bus = Bus::open(&system.domain(), "observer").unwrap();
    let observer = Observer::<Actuation>::new(&bus).unwrap();
    let headers = RefCell::new(BTreeMap::new());
    system.wait_until("the run ends", |system| {
        observer
            .poll(|actuation| {
                if actuation.answers == 1 {
                    headers.borrow_mut().insert(actuation.header.scan_id, actuation.header);
                }
            })
            .unwrap();
        system.status().is_none_or(|status| status.state != "driving")
    });
    headers.into_inner()
}

/// When one stage waited per scan, from its own log: from, to [ns].
fn planted(system: &TestSystem, role: Role) -> BTreeMap<u64, (u64, u64)> {
    log(system, role, "planted").into_iter().map(|line| (line[0], (line[1], line[2]))).collect()
}

fn median(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values[values.len() / 2]
}

/// Every stage waits 1, 5 and 20 ms before it takes, in its computation, before it publishes, and between publication
/// and wake-up, one of these per scan. The header of the actuation divides the way of a scan among stages and places
/// without gap or overlap; the logged wait of the stage must lie wholly within the part of that stage and place. No
/// limit of time is needed for that; what else was in those parts is printed.
#[test]
fn planted_delays_lie_in_the_stage_and_place_that_they_are_attributed_to() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let file = system.folder().join("system.toml");
        std::fs::write(&file, system_file(10, &STAGES, FAULTY, &["delay"])).unwrap();
        system.start(&["endless", "--system", file.to_str().unwrap(), "--duration", "11"]);
        let headers = answers(&system);
        system.wait();
        let planted = STAGES.map(|role| planted(&system, role));
        let mut others: BTreeMap<String, Vec<u64>> = BTreeMap::new();
        for (scan, header) in &headers {
            let attribution = attribute(header).unwrap();
            let path: u64 = attribution.stages.iter().map(|s| s.hop_ns + s.compute_ns + s.publish_ns).sum();
            assert_eq!(path, attribution.reaction_ns, "every nanosecond is attributed");
            let (role, place, delay_ns) = plan(*scan);
            let index = STAGES.iter().position(|stage| *stage == role).unwrap();
            let Some(&(from_ns, to_ns)) = planted[index].get(scan) else { continue };
            let stamps = header.stage(role);
            let before_ns = match index.checked_sub(1) {
                None => header.scan_published_ns(),
                Some(before) => header.stage(STAGES[before]).published_ns,
            };
            let next = STAGES.get(index + 1).map(|next| header.stage(*next));
            let (part, attributed_ns) = match place {
                DelayPlace::Take => ((before_ns, stamps.taken_ns), attribution.stages[index].hop_ns),
                DelayPlace::Compute => {
                    ((stamps.taken_ns, stamps.computed_ns), attribution.stages[index].compute_ns)
                }
                DelayPlace::Publish => {
                    ((stamps.computed_ns, stamps.published_ns), attribution.stages[index].publish_ns)
                }
                DelayPlace::Deliver => match next {
                    // A subscriber that polled before it was woken did not wait.
                    Some(next) if next.woken_ns >= to_ns => {
                        ((stamps.published_ns, next.taken_ns), attribution.stages[index + 1].hop_ns)
                    }
                    _ => continue,
                },
            };
            let what = format!("{place:?} of {role}, {} ms", delay_ns / 1_000_000);
            assert!(to_ns - from_ns >= delay_ns);
            assert!(
                part.0 <= from_ns && to_ns <= part.1,
                "{what}, scan {scan}: {from_ns} to {to_ns} in {part:?}"
            );
            assert_eq!(part.1 - part.0, attributed_ns, "{what}, scan {scan}");
            others.entry(what).or_default().push(attributed_ns - (to_ns - from_ns));
        }
        // All but deliveries: a subscriber that polls meanwhile does not wait for them.
        let places = others.keys().filter(|what| !what.starts_with("Deliver")).count();
        assert_eq!(places, 36, "{others:?}");
        assert!(others.len() > places, "{others:?}");
        for (what, others) in others {
            eprintln!("{what}: and {} us of its own", median(others) / 1000);
        }
    });
}
