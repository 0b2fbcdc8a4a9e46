//! A source on real lines: TCP on the loopback interface and pseudo terminals, with an emulated scanner at the other end.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::Write;
use std::net::TcpListener;
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Instant;

use shared_types::{FRONT_BEAM, Scan};
use urg::{
    DeviceFault, Port, Reading, ScannerConfig, ScannerConnection, ScannerEmulator, ScannerPlace, SourceState,
    UrgError,
};

const MS: u64 = 1_000_000;
/// What there is before the first scan.
const NONE: Reading =
    Reading { error_ns: 0, arrived_ns: 0, stamp_ms: 0, event: urg::ClockEvent::Regular, is_missing: true };

fn now_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64 + 1_000 * MS
}

enum Order {
    Fault(DeviceFault),
    Disconnect,
}

/// An emulated scanner on a thread, which ends with this.
struct Scanner {
    orders: Option<Sender<Order>>,
    thread: Option<JoinHandle<()>>,
}

impl Scanner {
    fn start(mut port: Port) -> Self {
        let (orders, received): (Sender<Order>, Receiver<Order>) = channel();
        let thread = std::thread::spawn(move || {
            loop {
                match received.try_recv() {
                    Ok(Order::Fault(fault)) => port.emulator.inject(fault, now_ns()),
                    Ok(Order::Disconnect) => port.disconnect(),
                    Err(std::sync::mpsc::TryRecvError::Disconnected) => return,
                    Err(std::sync::mpsc::TryRecvError::Empty) => {}
                }
                port.serve(10 * MS, now_ns).unwrap();
            }
        });
        Self { orders: Some(orders), thread: Some(thread) }
    }

    fn order(&self, order: Order) {
        self.orders.as_ref().unwrap().send(order).unwrap();
    }
}

impl Drop for Scanner {
    fn drop(&mut self) {
        self.orders = None;
        self.thread.take().unwrap().join().unwrap();
    }
}

fn source(place: &str) -> ScannerConnection {
    ScannerConnection::open(
        ScannerConfig { rate_hz: Some(10.0), ..ScannerConfig::new(ScannerPlace::parse(place).unwrap()) },
        now_ns,
    )
}

/// Waits up to ten seconds until a condition holds.
fn until(
    source: &mut ScannerConnection,
    condition: impl Fn(&ScannerConnection, Option<&(Reading, Scan)>) -> bool,
) -> (Reading, Scan) {
    let mut last = None;
    let end_ns = now_ns() + 10_000 * MS;
    while now_ns() < end_ns {
        let mut scan = Scan::default();
        if let Some(reading) = source.next(100 * MS, &mut scan).unwrap() {
            last = Some((reading, scan));
        }
        if condition(source, last.as_ref()) {
            return last.unwrap_or((NONE, Scan::default()));
        }
    }
    panic!("{}: {} {:?}", source.state().name(), source.message(), source.counters());
}

fn measures(source: &ScannerConnection, _: Option<&(Reading, Scan)>) -> bool {
    source.state() == SourceState::Measuring
}

#[test]
fn scans_come_over_tcp_and_again_after_a_lost_connection() {
    let port = Port::tcp("127.0.0.1:0", ScannerEmulator::new(now_ns(), 2500)).unwrap();
    let address = port.address().unwrap().to_string();
    let scanner = Scanner::start(port);
    let mut source = source(&address);
    let (reading, scan) = until(&mut source, measures);
    assert_eq!(scan.ranges_mm[FRONT_BEAM], 2500);
    assert!(scan.header.acquired_ns < reading.arrived_ns && reading.arrived_ns <= now_ns());
    scanner.order(Order::Disconnect);
    until(&mut source, |source, _| source.state() == SourceState::Connecting);
    assert_eq!(source.message(), format!("{address}: closed by the scanner"));
    until(&mut source, measures);
    assert_eq!(source.failed_connections(), 1);
}

#[test]
fn scans_come_over_a_serial_line_and_again_after_a_stuck_scanner() {
    let (port, device) = Port::terminal(ScannerEmulator::new(now_ns(), 2500)).unwrap();
    let scanner = Scanner::start(port);
    let mut source = source(&device);
    until(&mut source, measures);
    let mut second =
        ScannerConnection::open(ScannerConfig::new(ScannerPlace::parse(&device).unwrap()), now_ns);
    assert_eq!(second.next(0, &mut Scan::default()), Ok(None));
    assert_eq!(second.message(), format!("{device}: is used by another process"));
    drop(second);
    scanner.order(Order::Fault(DeviceFault::Stuck));
    until(&mut source, |source, _| source.state() == SourceState::Stalled);
    assert_eq!(source.message(), "no scan comes");
    until(&mut source, measures);
    assert_eq!(source.message(), "");
}

#[test]
fn a_place_without_a_scanner_is_named_with_the_reason() {
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    for (place, reason) in [
        (closed.as_str(), "Connection refused"),
        ("/dev/no-such-scanner", "No such file"),
        ("/dev/null", "is no serial line"),
    ] {
        let mut source = source(place);
        until(&mut source, |source, _| source.failed_connections() > 0);
        assert_eq!(source.state(), SourceState::Connecting);
        assert!(source.message().starts_with(&format!("{place}: ")), "{}", source.message());
        assert!(source.message().contains(reason), "{}", source.message());
    }
}

#[test]
fn a_server_that_floods_delays_no_call_and_is_given_up() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut source = source(&listener.local_addr().unwrap().to_string());
    let flood = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let garbage: Vec<u8> = (0..1 << 16).map(|index: u32| ((index * 97) >> 3) as u8).collect();
        while stream.write_all(&garbage).is_ok() {}
    });
    let end_ns = now_ns() + 8_000 * MS;
    let mut scan = Scan::default();
    while source.failed_connections() == 0 && now_ns() < end_ns {
        let begin_ns = now_ns();
        assert_eq!(source.next(20 * MS, &mut scan).unwrap(), None);
        let took_ns = now_ns() - begin_ns;
        assert!(took_ns < 500 * MS, "{took_ns}");
    }
    assert!(source.message().ends_with("the scanner does not answer QT"), "{}", source.message());
    drop(source);
    flood.join().unwrap();
}

#[test]
fn a_model_of_another_rate_is_refused() {
    let port = Port::tcp("127.0.0.1:0", ScannerEmulator::new(now_ns(), 2500)).unwrap();
    let address = port.address().unwrap().to_string();
    let _scanner = Scanner::start(port);
    let config =
        ScannerConfig { rate_hz: Some(20.0), ..ScannerConfig::new(ScannerPlace::parse(&address).unwrap()) };
    let mut source = ScannerConnection::open(config, now_ns);
    let mut scan = Scan::default();
    let refused = (0..50).find_map(|_| source.next(100 * MS, &mut scan).err());
    assert!(matches!(refused, Some(UrgError::Rate { .. })), "{refused:?}");
}

#[test]
fn a_source_that_only_identifies_leaves_the_laser_off() {
    let port = Port::tcp("127.0.0.1:0", ScannerEmulator::new(now_ns(), 2500)).unwrap();
    let address = port.address().unwrap().to_string();
    let _scanner = Scanner::start(port);
    let config =
        ScannerConfig { identify_only: true, ..ScannerConfig::new(ScannerPlace::parse(&address).unwrap()) };
    let mut source = ScannerConnection::open(config, now_ns);
    until(&mut source, |source, _| source.is_identified());
    assert_eq!(source.identity().value("LASR").unwrap(), "OFF");
    assert_eq!(source.identity().parameters.as_ref().unwrap().model, "URG-04LX(emulated)");
    assert_eq!(source.counters().scans, 0);
}
