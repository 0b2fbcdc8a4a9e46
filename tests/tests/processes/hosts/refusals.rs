//! Hosts that do not trust each other, and files that are refused: each is named with what is wrong.

use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

use runtime::{LINK_SOCKET, Realtime, link_version, reply_socket};
use scanloop_tests::printed;
use serde_json::{Value, json};

use super::*;

/// What the run prints about an end of the link whose certificate the authority of the other has not signed.
const FOREIGN: &str = "another authority has signed it";

/// The folder of certificates `keys`, whose certificate of the lab has expired.
fn expire(hosts: &TwoHosts) {
    let made = Command::new(link_folder().unwrap().join("scanloop-link"))
        .args(["pair", "keys", "lab", "127.0.0.1", "-1"])
        .current_dir(hosts.system.folder())
        .status();
    assert!(made.unwrap().success());
    // The orchestrator's is made again, and valid.
    let valid = hosts.system.folder().join("keys/orchestrator");
    let expired = hosts.system.folder().join("expired");
    std::fs::rename(hosts.system.folder().join("keys/lab"), &expired).unwrap();
    hosts.trust("keys", "orchestrator", "system.toml");
    assert!(valid.exists() && expired.exists());
}

#[test]
fn a_host_with_certificates_of_another_authority_is_named_at_both_ends_and_gets_no_sample() {
    let Some(mut hosts) = TwoHosts::new("a foreign certificate") else { return };
    hosts.trust("keys", "orchestrator", "system.toml");
    hosts.trust("foreign", "lab", "agent.toml");
    hosts.start_agent();
    hosts.start(&SHORT_FREE);
    hosts.system.wait_until("status names it", |system| {
        let status = system.status();
        status.is_some_and(|status| status.hosts.iter().any(|host| host.refused.contains(FOREIGN)))
    });
    let shown = hosts.system.run(&["status"]);
    let shown = scanloop_tests::printed(&shown);
    assert!(shown.contains("host lab: refused: its certificate is not accepted: "), "{shown}");
    assert_eq!(hosts.system.wait().code(), Some(4), "{}", hosts.system.stderr());
    let stderr = hosts.system.stderr();
    assert!(stderr.contains("host lab: refused: quic/127.0.0.1:") && stderr.contains(FOREIGN), "{stderr}");
    let messages = hosts.messages();
    let there = "refused: a peer that has connected: it does not accept the certificate of this host";
    assert!(messages.contains(there) && messages.contains(FOREIGN), "{messages}");
    assert!(!messages.contains("serves system"), "{messages}");
    hosts.end();
}

#[test]
fn a_host_whose_certificate_has_expired_is_named() {
    let Some(mut hosts) = TwoHosts::new("an expired certificate") else { return };
    expire(&hosts);
    let file = std::fs::read_to_string(hosts.system.folder().join("agent.toml")).unwrap();
    let address = file.lines().find_map(|line| line.strip_prefix("listen = \"")?.strip_suffix('"')).unwrap();
    // The agent itself would refuse to start with it.
    let link = Command::new(link_folder().unwrap().join("scanloop-link"))
        .args(["agent", "lab", &format!("quic/{address}?rel=0"), "expired"])
        .current_dir(hosts.system.folder())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut link = link.unwrap();
    let mut line = String::new();
    BufReader::new(link.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, "listening\n");
    hosts.start(&SHORT_FREE);
    assert_eq!(hosts.system.wait().code(), Some(4), "{}", hosts.system.stderr());
    let stderr = hosts.system.stderr();
    assert!(stderr.contains("its certificate is not accepted: it has expired"), "{stderr}");
    drop(link.stdin.take());
    assert!(link.wait().unwrap().success());
    hosts.system.assert_nothing_left();
}

#[test]
fn an_expired_certificate_of_this_host_is_refused_with_its_file() {
    let Some(hosts) = TwoHosts::new("an expired certificate of this host") else { return };
    expire(&hosts);
    let path = hosts.system.folder().join("agent.toml");
    let text = std::fs::read_to_string(&path).unwrap().replace("transport = \"udp\"\n", "");
    write_private(&path, &format!("credentials = \"expired\"\n{text}"));
    let system = std::fs::read_to_string(hosts.system.folder().join("system.toml")).unwrap();
    let system = system.replace("credentials = \"keys/orchestrator\"", "credentials = \"expired\"");
    std::fs::write(hosts.system.folder().join("expired.toml"), system).unwrap();
    for arguments in [&["agent"][..], &["run", "free", "--system", "expired.toml"]] {
        let output = hosts.system.command(arguments).env("PATH", &hosts.path).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
        // The orchestrator needs a certificate of its own, however long that of a host is valid.
        let reason =
            if arguments[0] == "agent" { "it is valid from" } else { "it is the certificate of lab" };
        let reason = format!("expired/certificate.pem: {reason}");
        assert!(stderr.contains("credentials: ") && stderr.contains(&reason), "{stderr}");
    }
}

#[test]
fn a_key_that_others_can_read_is_refused() {
    let Some(hosts) = TwoHosts::new("a key that others can read") else { return };
    hosts.trust("keys", "orchestrator", "system.toml");
    let key = hosts.system.folder().join("keys/orchestrator/key.pem");
    std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o644)).unwrap();
    let output =
        hosts.system.command(&["run", "free", "--system", "system.toml"]).env("PATH", &hosts.path).output();
    let output = output.unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("keys/orchestrator/key.pem: mode 644 is not allowed: 600"), "{stderr}");
}

#[test]
fn keys_and_certificates_that_do_not_belong_together_are_refused_with_the_file() {
    let Some(hosts) = TwoHosts::new("files of two pairs") else { return };
    hosts.trust("keys", "orchestrator", "system.toml");
    hosts.trust("foreign", "lab", "agent.toml");
    let own = |name: &str| hosts.system.folder().join("keys/orchestrator").join(name);
    let foreign =
        |name: &str| std::fs::read(hosts.system.folder().join("foreign/orchestrator").join(name)).unwrap();
    let marked = |name: &str| [&b"\xef\xbb\xbf"[..], &std::fs::read(own(name)).unwrap()].concat();
    for (name, content, reason) in [
        ("key.pem", foreign("key.pem"), "it is the key of another certificate"),
        ("key.pem", Vec::new(), "it is empty"),
        ("certificate.pem", marked("certificate.pem"), "it begins with a byte order mark"),
        ("authority.pem", foreign("authority.pem"), "this authority has not signed certificate.pem"),
    ] {
        let good = std::fs::read(own(name)).unwrap();
        std::fs::write(own(name), content).unwrap();
        let arguments = ["run", "free", "--system", "system.toml"];
        let output = hosts.system.command(&arguments).env("PATH", &hosts.path).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(&format!("keys/orchestrator/{name}: {reason}")), "{stderr}");
        std::fs::write(own(name), good).unwrap();
    }
}

/// A folder of keys, or part of it, that is not as it should be, changes nothing; each part has a certificate of its own.
#[test]
fn keys_are_not_replaced_unasked_and_each_is_for_one_part() {
    let Some(hosts) = TwoHosts::new("keys of one part each") else { return };
    hosts.trust("keys", "orchestrator", "agent.toml");
    let folder = hosts.system.folder();
    let refused = |arguments: &[&str]| {
        let output = hosts.system.command(arguments).env("PATH", &hosts.path).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
        stderr
    };
    let key = std::fs::read(folder.join("keys/lab/key.pem")).unwrap();
    let again = refused(&["agent", "pair", "lab", "127.0.0.1", "--out", "keys"]);
    assert!(
        again.contains("keys/lab: the host has been paired already") && again.contains("--force"),
        "{again}"
    );
    std::fs::set_permissions(folder.join("keys"), std::fs::Permissions::from_mode(0o777)).unwrap();
    let open = refused(&["agent", "pair", "desk", "127.0.0.1", "--out", "keys"]);
    assert!(
        open.contains("keys has mode 0777 instead of 0700") && !folder.join("keys/desk").exists(),
        "{open}"
    );
    std::fs::set_permissions(folder.join("keys"), std::fs::Permissions::from_mode(0o700)).unwrap();
    assert!(std::fs::read(folder.join("keys/lab/key.pem")).unwrap() == key);
    let other = refused(&["agent", "agent.toml"]);
    assert!(other.contains("it is the certificate of orchestrator, this agent needs that of lab"), "{other}");
    // Without keys, anyone who reaches the address drives the robot.
    let system = std::fs::read_to_string(folder.join("system.toml")).unwrap();
    std::fs::write(folder.join("far.toml"), system.replace("127.0.0.1:", "192.0.2.1:")).unwrap();
    let checked = hosts.system.run(&["check", "--system", "far.toml"]);
    let text = printed(&checked);
    assert!(checked.status.success() && text.contains("transport = \"udp\" at 192.0.2.1:"), "{text}");
}

#[test]
fn without_the_program_of_the_link_a_system_of_several_hosts_is_refused_with_the_command_that_builds_it() {
    let Some(hosts) = TwoHosts::new("a link that is not there") else { return };
    let output = hosts.system.run(&["run", "free", "--system", "system.toml"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    let command = "cargo build --release --manifest-path services/link/Cargo.toml";
    assert!(stderr.contains("scanloop-link is neither") && stderr.contains(command), "{stderr}");
    hosts.system.assert_nothing_left();
}

#[test]
fn an_agent_starts_only_what_its_file_names() {
    let Some(mut hosts) = TwoHosts::new("an implementation that is not allowed") else { return };
    let file = hosts.system.folder().join("agent.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    write_private(&file, &text.replace(", \"nmpc\"", ""));
    hosts.start_agent();
    hosts.start(&SHORT_FREE);
    assert_eq!(hosts.system.wait().code(), Some(4), "{}", hosts.system.stderr());
    let stderr = hosts.system.stderr();
    assert!(
        stderr.contains("host lab: agent.toml: implementations = nmpc is not allowed: one of ekf, ellipses"),
        "{stderr}"
    );
    hosts.end();
}

/// An incarnation that no process of a run gets.
const STRANGER: u32 = 4_000_000;

/// Has the link of a run ask the agent of the lab to start a controller, with another value of one key; returns the answer.
fn ask(hosts: &TwoHosts, key: &str, value: &Value) -> Value {
    let domain = hosts.system.domain();
    let reply = domain.directory().join(reply_socket(STRANGER));
    let _ = std::fs::remove_file(&reply);
    let socket = UnixDatagram::bind(reply).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let mut start = json!({
        "implementation": "nmpc", "restart": false, "period_ns": 100_000_000, "realtime": Realtime::default(),
        "settings": "", "receives": ["scan"], "sends": ["command"],
    });
    start[key] = value.clone();
    let message = json!({
        "version": link_version(), "system_id": domain.system_id(), "run_id": domain.run_id(),
        "incarnation": STRANGER, "role": "controller", "order": "start", "start": start,
    });
    let message = format!("lab\n{message}");
    let answer = std::cell::RefCell::new(vec![0; 1 << 16]);
    // A message may be lost.
    hosts.system.wait_until("the agent answers", |_| {
        socket.send_to(message.as_bytes(), domain.directory().join(LINK_SOCKET)).unwrap();
        let received = socket.recv(&mut answer.borrow_mut());
        received.is_ok_and(|length| {
            answer.borrow_mut().truncate(length);
            true
        })
    });
    serde_json::from_slice(&answer.take()).unwrap()
}

#[test]
fn a_request_that_no_orchestrator_makes_is_refused_and_neither_link_nor_process_is_started_again() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a request that no orchestrator makes") else { return };
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        hosts.system.wait_until_driving();
        let before = processes_of(&hosts.other_id());
        for (key, value, reason) in [
            ("period_ns", json!(0), "period_ns = 0 is not allowed: 1000000 to 2000000000"),
            ("receives", json!(["no-such-topic"]), "receives = \"no-such-topic\" is not allowed"),
            ("sends", json!(["pose", "no-such-topic"]), "sends = \"no-such-topic\" is not allowed"),
        ] {
            let answer = ask(&hosts, key, &value);
            let told = answer["state"]["refused"]["reason"].as_str().unwrap_or_default();
            assert!(told.contains(reason), "{answer}");
            let messages = hosts.messages();
            assert!(
                messages.contains("refused controller of system") && messages.contains(reason),
                "{messages}"
            );
        }
        assert_eq!(processes_of(&hosts.other_id()), before);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        assert!(!hosts.messages().contains("link of this host has ended"), "{}", hosts.messages());
        let report = hosts.system.report();
        let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
        assert_eq!((report.outcome, report.scans.unaccounted, restarts), (Outcome::Reached, 0, vec![0; 5]));
        hosts.end();
    });
}
