//! Two hosts with a bad network between them: samples that are lost, late or come as a burst, and links and agents that are
//! killed. What must hold is read from the outputs of the actuator.
//!
//! Variables make the same tests as long as a measurement needs: `SCANLOOP_HOST_SCANS`, `SCANLOOP_HOST_KILLS`,
//! `SCANLOOP_HOST_OUTAGES` and `SCANLOOP_HOST_STARTS`.

use scanloop_tests::machine::repeat_when_late;
use std::cell::RefCell;
use std::net::SocketAddr;
use std::time::Duration;

use runtime::{Bus, Observer, monotonic_ns};
use scanloop_tests::relay::Relay;
use shared_types::{Actuation, ActuationKind, Role};

use super::*;

const PERIOD_NS: u64 = 100_000_000;
/// A busy machine delays every process.
const SLACK_NS: u64 = 100_000_000;

/// A number that a variable of the environment sets.
fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Two hosts, and a relay between them.
fn relayed(test: &str) -> Option<(TwoHosts, Relay)> {
    let hosts = TwoHosts::new(test)?;
    let path = hosts.system.folder().join("system.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let address = text.split("address = \"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    let relay = Relay::start(address.parse::<SocketAddr>().unwrap());
    std::fs::write(&path, text.replace(&address, &relay.address().to_string())).unwrap();
    Some((hosts, relay))
}

/// All outputs of the actuator.
struct Outputs {
    observer: Observer<Actuation>,
    seen: RefCell<Vec<Actuation>>,
    // Dropped last.
    _bus: Bus,
}

impl Outputs {
    fn of(system: &TestSystem) -> Self {
        let bus = Bus::open(&system.domain(), "test").unwrap();
        Self { observer: Observer::new(&bus).unwrap(), seen: RefCell::default(), _bus: bus }
    }

    fn poll(&self) {
        self.observer.poll(|actuation| self.seen.borrow_mut().push(*actuation)).unwrap();
    }

    /// Commands that drive and were published within a time.
    fn drives(&self, from_ns: u64, to_ns: u64) -> Vec<Actuation> {
        self.poll();
        let seen = self.seen.borrow();
        let drives = seen.iter().filter(|actuation| actuation.kind == ActuationKind::Drive.wire());
        drives.filter(|actuation| (from_ns..to_ns).contains(&published_ns(actuation))).copied().collect()
    }

    /// Waits until the actuator drives by a command for a scan that was published after `since_ns`.
    fn wait_for_drive(&self, system: &TestSystem, what: &str, since_ns: u64) {
        system.wait_until(what, |_| {
            self.drives(since_ns, u64::MAX).iter().any(|actuation| scanned_ns(actuation) > since_ns)
        });
    }

    /// Waits until this share of a period has passed since a scan was published.
    fn wait_for_phase(&self, system: &TestSystem, phase: f64) {
        self.poll();
        let newest_ns = self.seen.borrow().iter().map(scanned_ns).max().expect("an output");
        let periods = (monotonic_ns() - newest_ns) / PERIOD_NS + 1;
        self.wait_for_time(system, newest_ns + periods * PERIOD_NS + (phase * PERIOD_NS as f64) as u64);
    }

    /// Waits for a moment, with all outputs received.
    fn wait_for_time(&self, system: &TestSystem, until_ns: u64) {
        system.wait_until("time passes", |_| {
            self.poll();
            monotonic_ns() >= until_ns
        });
    }
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}

fn scanned_ns(actuation: &Actuation) -> u64 {
    actuation.header.scan_published_ns()
}

/// A disturbance of the network, which begins at a phase of the period.
fn disturb(hosts: &TwoHosts, outputs: &Outputs, phase: f64, seconds: f64, set: impl Fn(bool)) {
    outputs.wait_for_phase(&hosts.system, phase);
    let began_ns = monotonic_ns();
    set(true);
    let end_ns = began_ns + (1e9 * seconds) as u64;
    outputs.wait_for_time(&hosts.system, end_ns);
    set(false);
    outputs.wait_for_drive(&hosts.system, "it drives again", end_ns);
    let what = format!("{seconds} s at phase {phase}");
    // The last command before may answer one period late, and is followed for one and a half.
    let blocked = outputs.drives(began_ns + 5 * PERIOD_NS / 2 + SLACK_NS, end_ns);
    assert!(blocked.is_empty(), "{what}: {} commands drove during the outage", blocked.len());
    for actuation in outputs.drives(began_ns, u64::MAX) {
        let age_ns = published_ns(&actuation) - scanned_ns(&actuation);
        assert!(age_ns <= 3 * PERIOD_NS, "{what}: a command drove {age_ns} ns after its scan");
    }
    for actuation in outputs.drives(end_ns, u64::MAX) {
        let before_ns = end_ns.saturating_sub(scanned_ns(&actuation));
        assert!(before_ns <= 2 * PERIOD_NS, "{what}: a scan of {before_ns} ns before the end drove");
    }
}

#[test]
fn each_sample_that_the_network_loses_has_a_reason_in_the_ledger() {
    repeat_when_late(|| {
        let Some((mut hosts, relay)) = relayed("losses between hosts") else { return };
        hosts.start_agent();
        hosts.start(&["free", "--set", "goal.x_m=8"]);
        hosts.system.wait_until_driving();
        let outputs = Outputs::of(&hosts.system);
        let scan = || hosts.system.status().map_or(0, |status| status.scan);
        relay.lose(0.5);
        let first = scan();
        hosts.system.wait_until("thirty scans", |_| scan() > first + 30);
        relay.lose(0.0);
        outputs.wait_for_drive(&hosts.system, "it drives again", monotonic_ns());
        disturb(&hosts, &outputs, 0.0, 0.35, |on| relay.hold(on));
        drop(outputs);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        let ledger = &report.ledger;
        assert_eq!((report.scans.unaccounted, ledger.residual), (0, 0), "{:?}", ledger.faults);
        assert_eq!((ledger.duplicates, ledger.reordered), (0, 0), "{:?}", ledger.faults);
        assert!(ledger.topics.iter().all(|row| row.residual == 0), "{:?}", ledger.topics);
        let count = |reason: &str| ledger.link_losses.get(reason).copied().unwrap_or(0);
        assert!(count("link") > 0 && count("age") > 0, "{:?}", ledger.link_losses);
        assert!(ledger.topics.iter().any(|row| row.reasons.contains_key("link")), "{:?}", ledger.topics);
        assert!(report.scans.lost_reasons.contains_key("age"), "{:?}", report.scans);
        hosts.end();
    });
}

/// Outages of each length, each at the next of several phases.
fn outages_block_the_wheels(hosts: &mut TwoHosts, relay: &Relay, first_phase: f64) {
    hosts.start_agent();
    hosts.start(&["endless", "--duration", "100000"]);
    hosts.system.wait_until_driving();
    let outputs = Outputs::of(&hosts.system);
    outputs.wait_for_drive(&hosts.system, "it drives", 0);
    let count = number("SCANLOOP_HOST_OUTAGES", 5);
    for number in 0..count {
        let phase = (first_phase + number as f64 * 0.618) % 1.0;
        match number % 5 {
            0 => disturb(hosts, &outputs, phase, 0.1, |on| relay.cut(on)),
            1 => disturb(hosts, &outputs, phase, 0.1, |on| relay.hold(on)),
            2 => disturb(hosts, &outputs, phase, 1.0, |on| relay.cut(on)),
            3 => disturb(hosts, &outputs, phase, 1.0, |on| relay.hold(on)),
            _ => disturb(hosts, &outputs, phase, 3.0, |on| relay.cut(on)),
        }
    }
    drop(outputs);
    let stop = hosts.system.run(&["stop"]);
    assert_eq!(stop.status.code(), Some(0), "{}", String::from_utf8_lossy(&stop.stderr));
    assert_eq!(hosts.system.wait().code(), Some(1), "{} {}", hosts.system.stderr(), hosts.messages());
    let report = hosts.system.report();
    assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Interrupted, 0), "{:?}", report.scans);
    assert_eq!(report.ledger.residual, 0, "{:?}", report.ledger.faults);
    let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
    assert_eq!(restarts, [0; 5], "an outage is no hang");
    println!("{count} outages: {:?} {:?}", report.scans, report.ledger.link_losses);
    hosts.end();
}

#[test]
fn an_outage_blocks_the_wheels_and_no_old_sample_drives_them() {
    repeat_when_late(|| {
        let Some((mut hosts, relay)) = relayed("outages") else { return };
        outages_block_the_wheels(&mut hosts, &relay, 0.0);
    });
}

#[test]
fn an_outage_of_an_encrypted_network_blocks_the_wheels_and_no_old_sample_drives_them() {
    repeat_when_late(|| {
        let Some((mut hosts, relay)) = relayed("outages over quic") else { return };
        hosts.trust("keys", "orchestrator", "system.toml");
        hosts.trust("keys", "lab", "agent.toml");
        outages_block_the_wheels(&mut hosts, &relay, 0.5);
    });
}

#[test]
fn hosts_connect_over_a_network_that_loses_one_of_twenty() {
    repeat_when_late(|| {
        let Some((mut hosts, relay)) = relayed("connections over a bad network") else { return };
        relay.lose(0.05);
        hosts.start_agent();
        for _ in 0..number("SCANLOOP_HOST_STARTS", 2) {
            let begun_ns = monotonic_ns();
            hosts.start(&["endless", "--duration", "100000"]);
            hosts.system.wait_until_driving();
            println!("drives after {} ms", (monotonic_ns() - begun_ns) / 1_000_000);
            let stop = hosts.system.run(&["stop"]);
            assert_eq!(stop.status.code(), Some(0), "{}", String::from_utf8_lossy(&stop.stderr));
            hosts.system.wait();
        }
        hosts.end();
    });
}

#[test]
fn scans_are_answered_in_time_over_a_network_that_loses_one_of_a_hundred() {
    repeat_when_late(|| {
        let Some((mut hosts, relay)) = relayed("a lossy network") else { return };
        let scans = number("SCANLOOP_HOST_SCANS", 100);
        relay.lose(0.01);
        relay.delay(Duration::from_millis(1), Duration::from_millis(1));
        hosts.start_agent();
        let duration = format!("{}", scans / 10);
        hosts.start(&["endless", "--duration", &duration]);
        hosts.system.wait_until_driving();
        let ended = loop {
            match hosts.system.wait_at_most(Duration::from_secs(30)) {
                Some(status) => break status,
                None => continue,
            }
        };
        let report = hosts.system.report();
        let scans = &report.scans;
        println!("lossy network: {ended} {scans:?} {:?}", report.latency_us.scan_to_actuation);
        assert_eq!((scans.unaccounted, report.ledger.residual), (0, 0), "{:?}", report.ledger.faults);
        let in_time = scans.commanded - scans.late;
        assert!(1000 * (scans.published - in_time) <= scans.published + 1000, "{scans:?}");
        hosts.end();
    });
}

#[test]
fn links_that_are_killed_start_no_storm_of_restarts_and_without_its_agent_the_robot_stops() {
    repeat_when_late(|| {
        let Some((mut hosts, _relay)) = relayed("kills of links and agents") else { return };
        let kills = number("SCANLOOP_HOST_KILLS", 3);
        hosts.start_agent();
        hosts.start(&["endless", "--duration", "100000"]);
        hosts.system.wait_until_driving();
        let outputs = Outputs::of(&hosts.system);
        let mut outages_ms = Vec::new();
        for kill in 0..kills {
            // A moment of the scan that is another one each time.
            outputs.wait_for_time(&hosts.system, monotonic_ns() + PERIOD_NS + kill * 37_000_000 % PERIOD_NS);
            let killed_ns = monotonic_ns();
            let link =
                if kill % 2 == 0 { processes_of_link(hosts.system.id()) } else { link_of_agent(&hosts) };
            kill_process(link, Signal::KILL).unwrap();
            outputs.wait_for_drive(
                &hosts.system,
                &format!("it drives after kill {kill}"),
                killed_ns + PERIOD_NS,
            );
            outages_ms.push((monotonic_ns() - killed_ns) / 1_000_000);
        }
        let restarts = || -> Vec<u32> {
            let status = hosts.system.status().unwrap();
            status.processes.iter().map(|process| process.restarts).collect()
        };
        outages_ms.sort_unstable();
        println!("{kills} kills of links: restarts {:?}, outages [ms] {outages_ms:?}", restarts());
        assert_eq!(restarts(), [0; 5], "the end of a link is no end of a process");
        let (_, mut agent) = hosts.agents.pop().unwrap();
        agent.kill().unwrap();
        agent.wait().unwrap();
        let killed_ns = monotonic_ns();
        // Not the link of the orchestrator: the drive ends by itself.
        while hosts.system.wait_at_most(Duration::from_millis(10)).is_none() {
            outputs.poll();
            assert!(monotonic_ns() < killed_ns + 60_000_000_000, "the drive does not end");
        }
        assert!(outputs.drives(killed_ns + 5 * PERIOD_NS / 2 + SLACK_NS, u64::MAX).is_empty());
        drop(outputs);
        let report = hosts.system.report();
        println!("without its agent: {:?}, {:?}", report.outcome, report.scans);
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Stopped, 0), "{:?}", report.scans);
        hosts.system.assert_nothing_left();
    });
}

/// The link of the agent, by its command line.
fn link_of_agent(hosts: &TwoHosts) -> Pid {
    let file = std::fs::read_to_string(hosts.system.folder().join("agent.toml")).unwrap();
    let address = file.split("listen = \"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let is_link = |pid: &i32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line).into_owned();
        line.contains("\0agent\0lab\0") && line.contains(&address)
    };
    pids.filter(is_link).find_map(Pid::from_raw).expect("the link of the agent")
}
