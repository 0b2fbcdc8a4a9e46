//! `scanloop urg` with its own emulated scanner at the other end of the line.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::{BufRead, BufReader};
use std::net::{TcpListener, ToSocketAddrs};
use std::process::{Child, Stdio};

use scanloop_tests::TestSystem;
use scanloop_tests::namespace::is_inside;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// An emulated scanner; dropping it ends it.
struct Scanner {
    process: Child,
    place: String,
}

impl Scanner {
    fn start(system: &TestSystem, arguments: &[&str]) -> Self {
        let mut command = system.command(&[&["urg", "emulate", "--duration", "60"], arguments].concat());
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut place = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut place).unwrap();
        Self { process, place: place.trim().to_owned() }
    }
}

impl Drop for Scanner {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn info_prints_what_a_scanner_tells_about_itself() {
    let system = TestSystem::new(EXECUTABLE);
    let scanner = Scanner::start(&system, &["--tcp", "127.0.0.1:0"]);
    let output = system.run(&["urg", "info", "--json", "--tcp", &scanner.place]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let info: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&info["model"], &info["fits"]), (&"URG-04LX(emulated)".into(), &true.into()));
    assert_eq!((&info["version"]["SERI"], &info["state"]["LASR"]), (&"E0000001".into(), &"OFF".into()));
}

/// A name with two addresses; the scanner listens at the second one.
#[test]
fn every_address_of_a_name_is_tried() {
    let hosts = "printf '::1 twin\\n127.0.0.1 twin\\n' > /tmp/scanloop-twin-$$ && \
                 mount --bind /tmp/scanloop-twin-$$ /etc/hosts && rm /tmp/scanloop-twin-$$ &&";
    if !is_inside(concat!(module_path!(), "::every_address_of_a_name_is_tried"), hosts, |_| {}) {
        return;
    }
    let system = TestSystem::new(EXECUTABLE);
    let scanner = Scanner::start(&system, &["--tcp", "127.0.0.1:0"]);
    let place = scanner.place.replace("127.0.0.1", "twin");
    let addresses: Vec<_> = place.to_socket_addrs().unwrap().collect();
    assert_eq!(addresses.len(), 2);
    if !addresses[0].is_ipv6() {
        eprintln!("skipped: this machine has no IPv6, whose address would be tried first");
        return;
    }
    let output = system.run(&["urg", "info", "--json", "--tcp", &place]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let output = system.run(&["urg", "info", "--tcp", &format!("twin:{closed}")]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && message.contains("Connection refused"), "{message}");
}

#[test]
fn a_log_has_the_columns_of_the_coreslam_logs() {
    let system = TestSystem::new(EXECUTABLE);
    let scanner = Scanner::start(&system, &["--fault", "checksum@0"]);
    let arguments = ["urg", "log", "--device", &scanner.place, "-n", "6", "scans.dat"];
    let output = system.run(&arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    let text = std::fs::read_to_string(system.folder().join("scans.dat")).unwrap();
    let rows: Vec<Vec<u64>> =
        text.lines().map(|line| line.split(' ').map(|value| value.parse().unwrap()).collect()).collect();
    assert_eq!((rows.len(), rows[0].len()), (6, 707));
    assert!(rows.iter().all(|row| row[24 + 340] == 3000 || row[6] == 1), "{message}");
    assert_eq!(rows.iter().map(|row| row[6]).sum::<u64>(), 1, "the damaged one is marked: {message}");
    for pair in rows.windows(2) {
        let (stamped_us, mapped_us) = ((pair[1][4] - pair[0][4]) * 1000, pair[1][0] - pair[0][0]);
        assert!(stamped_us.abs_diff(mapped_us) <= pair[0][5] + pair[1][5], "{stamped_us} {mapped_us}");
    }
}

/// As a driver in any language reads them: each line when its scan has come, and the numbers alone.
#[test]
fn a_pipe_gets_each_scan_at_once() {
    let system = TestSystem::new(EXECUTABLE);
    let scanner = Scanner::start(&system, &[]);
    let mut command = system.command(&["urg", "log", "--device", &scanner.place, "-n", "5", "/dev/stdout"]);
    let mut log = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut ages_us = Vec::new();
    for line in BufReader::new(log.stdout.take().unwrap()).lines() {
        let columns: Vec<u64> = line.unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect();
        assert_eq!(columns.len(), 707);
        ages_us.push(runtime::monotonic_ns() / 1000 - columns[1]);
    }
    let ended = log.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(ended.status.success() && message.contains("5 scans"), "{message}");
    // Held back until the end, the first would be 400 ms old.
    assert!(ages_us.len() == 5 && ages_us[0] < 200_000, "{ages_us:?}");
}

#[test]
fn a_plot_shows_the_room() {
    let system = TestSystem::new(EXECUTABLE);
    let scanner = Scanner::start(&system, &[]);
    let output = system.run(&["urg", "plot", "--device", &scanner.place, "-n", "1"]);
    let picture = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && picture.starts_with("scan 1: 3.000 m ahead, 100 %"), "{picture}");
    assert!(picture.contains('o') && picture.contains('\u{2809}'), "{picture}");
}

#[test]
fn a_scanner_that_is_not_there_or_does_not_answer_is_named() {
    let system = TestSystem::new(EXECUTABLE);
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let silent_place = silent.local_addr().unwrap().to_string();
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    for (arguments, exit, names) in [
        (&["urg", "info", "--tcp", &closed][..], 2, &[closed.as_str(), "Connection refused"][..]),
        (&["urg", "plot", "--device", "/dev/no-scanner"], 2, &["/dev/no-scanner", "No such file"]),
        (&["urg", "log", "--device", "/dev/null", "file"], 2, &["/dev/null", "is no serial line"]),
        (&["urg", "info", "--tcp", "nowhere"], 2, &["nowhere", "HOST:PORT"]),
        (&["urg", "info"], 2, &["--device", "--tcp"]),
        (&["urg", "plot", "--tcp", &closed, "--range", "0"], 2, &["--range 0", "0.1 to 100"]),
        (&["urg", "log", "--tcp", &closed, "--duration", "0", "file"], 2, &["--duration 0"]),
        (&["urg", "emulate", "--fault", "fire@3"], 2, &["fire@3", "half-scan"]),
        (&["urg", "info", "--tcp", &silent_place], 2, &["does not answer QT"]),
    ] {
        let output = system.run(arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(exit), "{arguments:?}: {message}");
        for name in names {
            assert!(message.contains(name), "{arguments:?}: `{name}` is missing in: {message}");
        }
    }
    assert!(!system.folder().join("file").exists());
}
