//! Roles that move from one host to another while the robot drives.

use handover::swap::{Certificate, SwapOutcome};
use scanloop_tests::SHORTENED_LONG;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{assert_seamless, assert_seamless_swap, swap};

use super::*;

/// Tries of a move: on a busy machine an output may be late enough for a refusal or a rollback, or one of two controllers
/// gets a sample so late that it plans another way past a body. A user then asks again.
const TRIES: usize = 3;

/// Moves a role, and asserts that no scan was missed, also by tries that were refused or rolled back.
fn move_to(hosts: &TwoHosts, role: Role, to: &str) -> Certificate {
    let mut certificate = swap(&hosts.system, &[role.name(), "--to", to]);
    for _ in 1..TRIES {
        if certificate.outcome == SwapOutcome::RolledBack || is_of_the_load(&certificate.reason) {
            assert_seamless(&certificate);
            certificate = swap(&hosts.system, &[role.name(), "--to", to]);
        }
    }
    assert_seamless_swap(&certificate);
    let (host, is_there) = (to.split_once('@').unwrap().1, process_of(&hosts.other_id(), role));
    let shown = hosts.system.status().unwrap();
    let row = shown.processes.iter().find(|row| row.role == role).unwrap();
    match host {
        "lab" => assert!(is_there.is_some() && row.host.as_deref() == Some("lab"), "{row:?}"),
        _ => {
            assert_eq!(row.host, None, "{row:?}");
            hosts
                .system
                .wait_until("the one there has ended", |_| process_of(&hosts.other_id(), role).is_none());
        }
    }
    certificate
}

/// Whether a move was refused for what load does: an output in time and another one late, or of a late input.
fn is_of_the_load(reason: &str) -> bool {
    ["late:", "disagreement at scan"].iter().any(|begin| reason.starts_with(begin))
}

#[test]
fn the_controller_moves_to_the_robot_and_back_while_it_drives() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a controller that moves") else { return };
        hosts.start_agent();
        hosts.start_recorded(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        let here = move_to(&hosts, Role::Controller, "nmpc@orchestrator");
        assert_eq!((here.from.as_str(), here.to.as_str()), ("nmpc@lab", "nmpc"));
        let there = move_to(&hosts, Role::Controller, "nmpc@lab");
        assert_eq!((there.from.as_str(), there.to.as_str()), ("nmpc", "nmpc@lab"));
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        assert_eq!(report.swaps.iter().filter(|swap| swap.outcome == SwapOutcome::Swapped).count(), 2);
        assert_eq!(report.processes.iter().map(|process| process.restarts).collect::<Vec<_>>(), [0; 5]);
        hosts.assert_replayed();
        hosts.end();
    });
}

/// The pose then crosses both ways: while the estimators change, and because the lab reads it.
#[test]
fn the_estimator_moves_although_the_lab_reads_its_output() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("an estimator that moves") else { return };
        hosts.start_agent();
        hosts.start_recorded(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        move_to(&hosts, Role::Estimator, "ekf@orchestrator");
        move_to(&hosts, Role::Estimator, "ekf@lab");
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        let dropped = report.ledger.topics.iter().filter(|row| row.topic == "pose");
        assert!(
            dropped.clone().all(|row| row.reasons["authority"] >= 10),
            "{:?}",
            dropped.collect::<Vec<_>>()
        );
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        hosts.assert_replayed();
        hosts.end();
    });
}

#[test]
fn the_state_of_a_role_that_moves_has_the_times_of_its_new_host() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::ahead("a move to a clock that is a day behind") else { return };
        hosts.start_recorded(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        move_to(&hosts, Role::Estimator, "ekf@orchestrator");
        move_to(&hosts, Role::Controller, "nmpc@orchestrator");
        move_to(&hosts, Role::Estimator, "ekf@lab");
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        hosts.assert_replayed();
        hosts.end();
    });
}

#[test]
fn what_may_not_move_is_refused() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("refused moves") else { return };
        let file = hosts.system.folder().join("agent.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        write_private(&file, &text.replace(", \"nmpc\"", ""));
        let path = hosts.system.folder().join("system.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        let here = text.replace("role = \"controller\"\nhost = \"lab\"\n", "role = \"controller\"\n");
        let silent = format!(
            "[[host]]\nname = \"desk\"\naddress = \"127.0.0.1:{}\"\ntransport = \"udp\"\n",
            free_port()
        );
        std::fs::write(path, here + &silent).unwrap();
        hosts.start_agent();
        hosts.start(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        for (arguments, message) in [
            (
                ["controller", "--to", "nmpc@attic"],
                "host = attic is not allowed: one of lab, desk, orchestrator",
            ),
            (
                ["actuator", "--to", "actuation@lab"],
                "host = lab is not allowed for actuator: robot and actuator",
            ),
            (["controller", "--to", "ekf@lab"], "implementation = ekf is not allowed: one of nmpc for role"),
        ] {
            let output = hosts.system.run(&[&["swap"], &arguments[..]].concat());
            let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{stderr}");
            assert!(stderr.contains(message), "{stderr}");
        }
        for (host, reason) in [
            ("lab", "host lab: agent.toml: implementations = nmpc is not allowed: one of ekf, ellipses"),
            ("desk", "host desk: no agent answers at udp/127.0.0.1:"),
        ] {
            let refused = swap(&hosts.system, &["controller", "--to", &format!("nmpc@{host}")]);
            assert_eq!(refused.outcome, SwapOutcome::Refused, "{refused:?}");
            assert!(refused.reason.contains(reason), "{refused:?}");
        }
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        hosts.end();
    });
}
