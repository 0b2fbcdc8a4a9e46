//! Tests of the hosts of a system file.

use super::*;
use crate::system::BUILT_IN;

const LAB: &str = "credentials = \"keys\"\n[[host]]\nname = \"lab\"\naddress = \"127.0.0.1:7411\"\n";

/// The built-in system with hosts, whose processes of these roles run on a host.
fn read(hosts: &str, roles: &[(&str, &str)]) -> anyhow::Result<System> {
    let mut table: toml::Table = BUILT_IN.parse().unwrap();
    table.extend(hosts.parse::<toml::Table>().unwrap());
    for entry in table["process"].as_array_mut().unwrap() {
        let entry = entry.as_table_mut().unwrap();
        if let Some((_, host)) = roles.iter().find(|(role, _)| entry["role"].as_str() == Some(role)) {
            entry.insert("host".to_owned(), (*host).into());
        }
    }
    System::from_table(table, "two.toml")
}

fn refusal(hosts: &str, roles: &[(&str, &str)]) -> String {
    read(hosts, roles).unwrap_err().to_string()
}

const IN_THE_LAB: [(&str, &str); 3] = [("estimator", "lab"), ("obstacles", "lab"), ("controller", "lab")];

#[test]
fn with_estimator_obstacles_and_controller_elsewhere_three_topics_cross_there() {
    let system = read(LAB, &IN_THE_LAB).unwrap();
    let names = |from, to| {
        let found = crossings(&system).into_iter().filter(|one| one.from == from && one.to == to);
        found.map(|one| one.topic.name()).collect::<Vec<_>>()
    };
    assert_eq!(names(None, Some("lab")), ["scan", "odometry", "actuation", "directive"]);
    assert_eq!(
        names(Some("lab"), None),
        ["pose", "obstacles", "command", "heartbeat", "checkpoint", "journal"]
    );
    assert_eq!(crossings(&system).len(), 10);
    let text = describe(&system);
    assert!(text.contains("  on lab (quic 127.0.0.1:7411): estimator, obstacles, controller\n"), "{text}");
    assert!(text.contains("  crosses from here to lab: scan, odometry, actuation, directive\n"), "{text}");
}

#[test]
fn between_two_other_hosts_topics_cross_directly() {
    let two = format!("{LAB}[[host]]\nname = \"desk\"\naddress = \"127.0.0.1:7412\"\n");
    let system = read(&two, &[("estimator", "lab"), ("controller", "desk")]).unwrap();
    let pose = Crossing { from: Some("lab"), to: Some("desk"), topic: Topic::Pose };
    assert!(crossings(&system).contains(&pose));
    assert_eq!(hosts(&system).collect::<Vec<_>>(), [None, Some("lab"), Some("desk")]);
}

#[test]
fn on_one_host_nothing_crosses() {
    let system = read("", &[]).unwrap();
    assert_eq!((crossings(&system), describe(&system)), (Vec::new(), String::new()));
    let unused = read(LAB, &[]).unwrap();
    assert_eq!(crossings(&unused), [], "a host without a process");
}

#[test]
fn wrong_hosts_are_refused_with_file_key_and_value() {
    let named = |name: &str| LAB.replace("lab", name);
    assert_eq!(
        refusal(LAB, &[("estimator", "lap")]),
        "two.toml: process[1].host = lap is not allowed: one of lab. Did you mean `lab`?"
    );
    assert!(refusal("", &[("estimator", "lab")]).ends_with("a [[host]] of the file, which has none"));
    let host_alone = LAB.split_once('\n').unwrap().1;
    let twice = format!("{LAB}{}", host_alone.replace("7411", "7412"));
    assert_eq!(refusal(&twice, &[]), "two.toml: host[1].name = lab is not allowed: each name once");
    let same = format!("{LAB}{}", host_alone.replace("lab", "desk"));
    assert!(
        refusal(&same, &[]).contains("host[1].address = 127.0.0.1:7411 is not allowed: each address once")
    );
    for name in ["", "Lab", "9lab", "the-lab", "laboratory2"] {
        assert!(refusal(&named(name), &[]).contains("host[0].name = "), "{name}");
    }
    for address in ["lab:7411", "127.0.0.1", "127.0.0.1:0", "0.0.0.0:7411", "224.0.0.1:7411"] {
        let message = refusal(&LAB.replace("127.0.0.1:7411", address), &[]);
        assert!(message.contains(&format!("host[0].address = {address} is not allowed: an IP")), "{message}");
    }
    let open = refusal(&LAB.replace("credentials = \"keys\"\n", ""), &IN_THE_LAB);
    assert!(
        open.contains("credentials = (missing) is not allowed: a folder that `scanloop agent pair` made"),
        "{open}"
    );
    let transport = refusal(&format!("{LAB}transport = \"ip\"\n"), &[]);
    assert!(transport.contains("host[0].transport = \"ip\" is not allowed"), "{transport}");
}

#[test]
fn robot_and_actuator_are_on_one_host() {
    let apart = refusal(LAB, &[("robot", "lab")]);
    assert!(
        apart.contains("process.host = lab for robot, (the one of the orchestrator) for actuator"),
        "{apart}"
    );
    let away = read(LAB, &[("robot", "lab"), ("actuator", "lab")]).unwrap();
    // Nothing but directives can tell the actuator that its orchestrator is there.
    assert_eq!((away.orphan_stop_s(), read(LAB, &IN_THE_LAB).unwrap().orphan_stop_s()), (0.5, 5.0));
    let to_lab: Vec<_> = crossings(&away).into_iter().filter(|one| one.to == Some("lab")).collect();
    assert_eq!(to_lab.iter().map(|one| one.topic).collect::<Vec<_>>(), [Topic::Command, Topic::Directive]);
    let unnamed = refusal("", &[("robot", "lab"), ("actuator", "lab")]);
    assert!(unnamed.contains("process[0].host = lab is not allowed"), "{unnamed}");
}

#[test]
fn companions_and_commands_of_another_host_are_refused() {
    let mut system = read(LAB, &IN_THE_LAB).unwrap();
    let entry = system.processes.iter_mut().find(|entry| entry.role == "controller").unwrap();
    (entry.implementation, entry.command) = (None, Some(vec!["./mine".to_owned()]));
    assert_eq!(validate(&system).unwrap_err().key, "process[3].command");
}

#[test]
fn the_id_on_each_host_is_short_enough() {
    let system = read(LAB, &IN_THE_LAB).unwrap();
    assert_eq!(require_short_ids(&system, "twelve-chars"), Ok(()));
    let refusal = require_short_ids(&system, "thirteen-char").unwrap_err();
    assert!(refusal.contains("`thirteen-char-lab` on host lab has more than 16 characters"), "{refusal}");
}
