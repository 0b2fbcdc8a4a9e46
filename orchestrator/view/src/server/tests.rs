//! The server over real connections, with a source of numbered frames.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

use super::*;
use crate::history::tests::stored;
use crate::source::Update;

/// No test waits longer for an answer.
const DEADLINE: Duration = Duration::from_secs(20);

/// Makes a frame at each poll.
struct Numbers(u64);

impl Source for Numbers {
    fn poll(&mut self, now_s: f64) -> Update {
        self.0 += 1;
        Update { frame: Some(stored(self.0, now_s)), system: Some("{}".to_owned()), events: Vec::new() }
    }
}

fn start() -> (Arc<Site>, SocketAddr) {
    let site = Arc::new(
        Site::new(Actions::new("view-test", Vec::new()), Questions::new("view-test", None), None).unwrap(),
    );
    let listener = listen(IpAddr::from([127, 0, 0, 1]), 0).unwrap();
    let address = listener.local_addr().unwrap();
    start_accepting(listener, Arc::clone(&site)).unwrap();
    (site, address)
}

fn send(address: SocketAddr, bytes: &[u8]) -> TcpStream {
    let mut client = TcpStream::connect(address).unwrap();
    client.set_read_timeout(Some(DEADLINE)).unwrap();
    // A server that refuses early closes before all is written.
    let _ = client.write_all(bytes);
    client
}

fn answer(address: SocketAddr, request: &str) -> String {
    let request = request.replace("ADDRESS", &address.to_string());
    let mut text = String::new();
    send(address, request.as_bytes()).read_to_string(&mut text).unwrap();
    text
}

fn get(address: SocketAddr, path: &str) -> String {
    answer(address, &format!("GET {path} HTTP/1.1\r\nHost: ADDRESS\r\n\r\n"))
}

#[test]
fn pages_are_served_and_nothing_beside_them() {
    let (site, address) = start();
    site.hub.publish(Numbers(0).poll(0.0), 0.0);
    let page = get(address, "/");
    assert!(page.starts_with("HTTP/1.1 200 OK") && page.contains("default-src 'none'"), "{page}");
    assert!(get(address, "/frame?number=1").ends_with("\r\n\r\n1"));
    assert!(get(address, "/history").contains("\"number\":1"));
    for path in
        ["/../Cargo.toml", "/..%2fCargo.toml", "//etc/passwd", "/frame", "/frame?number=-1", "/page.css/"]
    {
        assert!(get(address, path).starts_with("HTTP/1.1 404"), "{path}");
    }
}

#[test]
fn control_needs_the_token_and_is_refused_without_the_option() {
    let (site, address) = start();
    let token = site.token.text();
    let ask = |headers: &str| {
        let body = r#"{"action":"stop"}"#;
        let length = body.len();
        answer(
            address,
            &format!("POST /control HTTP/1.1\r\nContent-Length: {length}\r\n{headers}\r\n\r\n{body}"),
        )
    };
    assert!(ask("Host: ADDRESS").starts_with("HTTP/1.1 403"));
    assert!(ask(&format!("Host: evil.example\r\nAuthorization: Bearer {token}")).starts_with("HTTP/1.1 403"));
    let origin = format!("Host: ADDRESS\r\nOrigin: http://evil.example\r\nAuthorization: Bearer {token}");
    assert!(ask(&origin).starts_with("HTTP/1.1 403"));
    let refused = ask(&format!("Host: ADDRESS\r\nAuthorization: Bearer {token}"));
    assert!(refused.starts_with("HTTP/1.1 400") && refused.contains("not allowed"), "{refused}");
    assert!(get(address, "/control").starts_with("HTTP/1.1 403"));
}

/// The next frames of a stream.
fn frames(reader: &mut impl BufRead, count: usize) -> Vec<u64> {
    let mut found = Vec::new();
    let mut line = String::new();
    let mut is_frame = false;
    while found.len() < count {
        line.clear();
        assert!(reader.read_line(&mut line).unwrap() > 0, "the stream ended");
        match line.trim_end().split_once(": ") {
            Some(("event", name)) => is_frame = name == "frame",
            Some(("data", data)) if is_frame => found.push(data.parse().unwrap()),
            _ => {}
        }
    }
    found
}

#[test]
fn a_stream_that_is_not_read_delays_no_other() {
    let (site, address) = start();
    let request = format!("GET /stream HTTP/1.1\r\nHost: {address}\r\n\r\n");
    let stuck: Vec<TcpStream> = (0..5).map(|_| send(address, request.as_bytes())).collect();
    let mut reader = BufReader::new(send(address, request.as_bytes()));
    let hub = Arc::clone(&site);
    let is_over = Arc::new(AtomicUsize::new(0));
    let over = Arc::clone(&is_over);
    let collector = std::thread::spawn(move || {
        collect(&mut Numbers(0), &hub.hub, || over.load(Ordering::SeqCst) == 0 && !wait_for(&[], 1_000_000));
    });
    let seen = frames(&mut reader, 300);
    assert!(seen.is_sorted() && seen.windows(2).all(|two| two[0] < two[1]), "{seen:?}");
    is_over.store(1, Ordering::SeqCst);
    collector.join().unwrap();
    drop(stuck);
    site.end();
}

#[test]
fn half_open_connections_are_closed_and_the_page_is_served_meanwhile() {
    let (_site, address) = start();
    let mut half: Vec<TcpStream> =
        (0..MAX_CONNECTIONS / 2).map(|_| send(address, b"GET / HTTP/1.1\r\nHo")).collect();
    assert!(get(address, "/").starts_with("HTTP/1.1 200"));
    for client in &mut half {
        let mut text = String::new();
        match client.read_to_string(&mut text) {
            Ok(_) => assert!(text.starts_with("HTTP/1.1 408"), "{text}"),
            Err(error) => assert_ne!(error.kind(), ErrorKind::WouldBlock, "it was not closed"),
        }
    }
}

#[test]
fn a_request_is_heard_whatever_number_of_connections_its_user_keeps_silent() {
    let (_site, address) = start();
    let silent: Vec<TcpStream> = (0..600).filter_map(|_| TcpStream::connect(address).ok()).collect();
    assert!(silent.len() > MAX_CONNECTIONS);
    let asked = Instant::now();
    assert!(get(address, "/").starts_with("HTTP/1.1 200 OK"));
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
}

#[test]
fn ten_thousand_garbage_requests_leave_the_page_as_it_was() {
    let (site, address) = start();
    let garbage = prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..200),
        "[ -~]{0,60}\r\n\r\n".prop_map(String::into_bytes),
        "(GET|POST|PUT) [ -~]{0,30} HTTP/1.1\r\n(Host: [ -~]{0,20}\r\n)?\r\n".prop_map(String::into_bytes),
    ];
    let mut runner = TestRunner::new(Config { failure_persistence: None, ..Config::with_cases(10_000) });
    let asked = runner.run(&garbage, |bytes| {
        let mut client = TcpStream::connect(address).unwrap();
        let _ = client.write_all(&bytes);
        let _ = client.shutdown(Direction::Write);
        let mut text = Vec::new();
        let _ = client.read_to_end(&mut text);
        let text = String::from_utf8_lossy(&text);
        prop_assert!(!text.starts_with("HTTP/1.1 200") && !text.contains("token="), "{}", text);
        Ok(())
    });
    asked.unwrap();
    assert!(get(address, "/").starts_with("HTTP/1.1 200"));
    assert!(site.logged.lock().unwrap().len() <= 4, "each kind is logged once");
}
