//! What an agent refuses.

use shared_types::Role;

use super::*;
use crate::message::RemoteStart;

fn agent() -> Agent {
    let file = AgentFile {
        name: "lab".to_owned(),
        implementations: vec!["nmpc".to_owned()],
        ..AgentFile::default()
    };
    Agent {
        file,
        logs: PathBuf::new(),
        link: None,
        link_ended_ns: 0,
        served: None,
        offset_ns: None,
        connected_ns: None,
        watched_ns: 0,
    }
}

fn down(version: &str) -> Down {
    Down {
        version: version.to_owned(),
        system_id: "main".to_owned(),
        run_id: "abcdefghij".to_owned(),
        incarnation: 7,
        role: Role::Controller,
        order: RemoteOrder::Start,
        stopped: false,
        start: None,
    }
}

fn start() -> RemoteStart {
    RemoteStart {
        implementation: "nmpc".to_owned(),
        restart: false,
        candidate: None,
        period_ns: 100_000_000,
        realtime: runtime::Realtime::default(),
        settings: String::new(),
        receives: vec!["scan".to_owned()],
        sends: vec!["command".to_owned()],
        handover: None,
    }
}

#[test]
fn values_that_no_orchestrator_sends_are_refused_by_name() {
    let good = Down { start: Some(start()), ..down(&link_version()) };
    assert_eq!(agent().refuses(&good), None);
    type Change = fn(&mut Down, &mut RemoteStart);
    let changes: [(&str, Change); 17] = [
        ("run_id", |down, _| down.run_id = "../../x".to_owned()),
        ("run_id", |down, _| down.run_id.clear()),
        ("system_id", |down, _| down.system_id = "a/b".to_owned()),
        ("system_id", |down, _| down.system_id = "x".repeat(17)),
        ("incarnation", |down, _| down.incarnation = 0),
        ("period_ns", |_, start| start.period_ns = 0),
        ("period_ns", |_, start| start.period_ns = 1),
        ("period_ns", |_, start| start.period_ns = u64::MAX),
        ("receives", |_, start| start.receives = vec!["no-such-topic".to_owned()]),
        ("sends", |_, start| start.sends = vec!["command\nscan".to_owned()]),
        ("sends", |_, start| start.sends = vec!["command".to_owned(); 1000]),
        ("candidate", |_, start| start.candidate = Some(0)),
        ("settings", |_, start| start.settings = "x".repeat(2 << 20)),
        ("handover", |_, start| start.handover = Some("zz".to_owned())),
        ("handover", |_, start| start.handover = Some("00".repeat(2 << 20))),
        ("realtime.poll_us", |_, start| start.realtime.poll_us = 1_000_000),
        ("implementations", |_, start| start.implementation = "sh".to_owned()),
    ];
    for (key, change) in changes {
        let (mut down, mut start) = (good.clone(), start());
        change(&mut down, &mut start);
        let reason = agent().refuses(&Down { start: Some(start), ..down }).unwrap_or_default();
        assert!(reason.contains(&format!("{key} = ")) && reason.len() < 300, "{key}: {reason:?}");
    }
    let reason = agent().refuses(&down(&link_version()));
    assert!(reason.is_some_and(|reason| reason.contains("start = ")));
}

#[test]
fn an_orchestrator_of_another_version_or_with_other_samples_is_refused_by_name() {
    let own = link_version();
    assert_eq!(agent().refuses(&Down { start: Some(start()), ..down(&own) }), None);
    let (version, samples) = own.split_once(' ').unwrap();
    for other in [format!("9.9.9 {samples}"), format!("{version} 0123456789abcdef")] {
        let reason = agent().refuses(&down(&other)).unwrap();
        assert!(reason.contains(&own) && reason.contains(&other), "{reason}");
    }
}

#[test]
fn an_address_that_is_taken_or_of_another_machine_is_told_so() {
    let stream = TcpListener::bind("127.0.0.1:0").unwrap();
    let datagrams = UdpSocket::bind("127.0.0.1:0").unwrap();
    let taken = "another program has taken the port; name another one";
    for (transport, held) in [
        (Transport::Tcp, stream.local_addr().unwrap()),
        (Transport::Udp, datagrams.local_addr().unwrap()),
        (Transport::Quic, datagrams.local_addr().unwrap()),
    ] {
        assert_eq!(refusal_of_address(transport, &held.to_string()), taken);
    }
    let foreign = refusal_of_address(Transport::Udp, "192.0.2.1:7000");
    assert_eq!(foreign, "it is not an address of this machine");
    assert_eq!(refusal_of_address(Transport::Tcp, "127.0.0.1:0"), "see the message of the link");
}
