//! Clients of the live page that misbehave: the page is served, the drive continues, and the log stays short.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};

use rustix::process::Signal;
use scanloop_tests::{DEADLINE, TestSystem};

use crate::view::{View, is_driving};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
/// Requests that are not well formed, in all.
const GARBAGE: usize = 10_000;
/// Clients at the same time.
const CLIENTS: usize = 8;

/// What a connection answers to some bytes; empty when it was closed without one.
fn answer(address: &str, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    // A server that refuses early closes before all is written.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    let mut text = Vec::new();
    let _ = stream.read_to_end(&mut text);
    String::from_utf8_lossy(&text).into_owned()
}

/// The garbage of a number: the same in every run.
fn garbage(number: usize) -> Vec<u8> {
    let noise = |count: usize| (0..count).map(|at| (number * 31 + at * at * 7) as u8);
    match number % 6 {
        0 => noise(number % 200).collect(),
        1 => format!("GET /{} HTTP/1.1\r\n\r\n", "../".repeat(number % 50)).into_bytes(),
        2 => format!("POST /control HTTP/1.1\r\nContent-Length: {number}0\r\n\r\n").into_bytes(),
        3 => format!("GET / HTTP/1.1\r\nHost: site-{number}.example\r\n\r\n").into_bytes(),
        4 => format!("PUT /frame?number=-{number} HTTP/9.9\r\nHost: x\r\nHost: y\r\n\r\n").into_bytes(),
        _ => b"GET /stream HTTP/1.1\r\n".iter().copied().chain(noise(number % 9000)).collect(),
    }
}

/// A tunnel changes the port and a page of another site the name: the token admits the first, and nothing the second.
#[test]
fn through_a_tunnel_the_token_decides_and_another_name_is_refused() {
    let system = TestSystem::new(EXECUTABLE);
    let view = View::start(&system, &["--control"]);
    for (host, token, code) in [
        ("localhost:8391", view.token.as_str(), 200),
        ("localhost:8391", "0123", 403),
        ("site.example", view.token.as_str(), 403),
    ] {
        let head = format!("GET /system HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\n\r\n");
        let answered = answer(&view.address, head.as_bytes());
        assert!(answered.starts_with(&format!("HTTP/1.1 {code}")), "{host} {token}: {answered}");
    }
}

#[test]
fn clients_that_misbehave_change_neither_page_nor_drive() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let view = View::start(&system, &["--control"]);
        let before = view.wait_for(&system, "the page shows the drive", is_driving);
        let address = &view.address;

        // One connection reads nothing, and some never finish their request.
        let mut stuck = TcpStream::connect(address).unwrap();
        write!(stuck, "GET /stream HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let half_open: Vec<TcpStream> = (0..20)
            .map(|_| {
                let mut stream = TcpStream::connect(address).unwrap();
                stream.write_all(b"GET / HTTP/1.1\r\nHo").unwrap();
                stream
            })
            .collect();
        std::thread::scope(|scope| {
            for client in 0..CLIENTS {
                scope.spawn(move || {
                    for number in (client..GARBAGE).step_by(CLIENTS) {
                        let text = answer(address, &garbage(number));
                        assert!(!text.starts_with("HTTP/1.1 200"), "{number}: {text}");
                    }
                });
            }
        });
        for mut stream in half_open {
            stream.set_read_timeout(Some(DEADLINE)).unwrap();
            let mut text = String::new();
            let _ = stream.read_to_string(&mut text);
            assert!(text.is_empty() || text.starts_with("HTTP/1.1 408"), "{text}");
        }
        for path in
            ["/../../etc/passwd", "/..%2f..%2fetc%2fpasswd", "//etc/passwd", "/page.css/../../Cargo.toml"]
        {
            assert_eq!(view.ask(&format!("GET {path}"), "", "").0, 404, "{path}");
        }
        let wrong = format!("Authorization: Bearer {}\r\n", "0".repeat(32));
        assert_eq!(view.ask("POST /control", &wrong, r#"{"action":"stop"}"#).0, 403);

        let after = view.wait_for(&system, "the drive continues", |shown| {
            is_driving(shown)
                && shown["status"]["scan"].as_u64() > before["status"]["scan"].as_u64().map(|scan| scan + 5)
        });
        let mut restarts =
            after["status"]["processes"].as_array().unwrap().iter().map(|row| &row["restarts"]);
        assert!(restarts.all(|count| *count == 0), "{after}");
        drop(stuck);
        let (ended, log) = view.end();
        assert_eq!(ended.code(), Some(0));
        assert!(log.lines().count() <= 6, "each kind is logged once: {log}");
        system.signal(system.orchestrator(), Signal::INT);
        system.wait();
        assert_eq!(system.report().scans.unaccounted, 0);
        system.assert_nothing_left();
    });
}
