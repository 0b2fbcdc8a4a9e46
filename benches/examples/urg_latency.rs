//! Time from the last byte of a sweep to its scan in the driver, over TCP on the loopback interface.
//!
//! ```text
//! cargo run --profile dist -p scanloop-lab --example urg_latency [SCANS]
//! ```
//!
//! A thread plays the scanner. It sends each scan but for its last byte, waits until the driver has taken it and sleeps
//! again, and notes the time at which it sends the last byte. The figures contain the wake-up of the driver, the check
//! of the last line, the ranges of the 682 beams and the mapping of the stamp. Heap allocations of the driver are counted
//! from the tenth scan on.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context;
use laboratory::{CountingAllocator, allocations};
use runtime::monotonic_ns;
use shared_types::Scan;
use urg::{ScannerConfig, ScannerConnection, ScannerEmulator, ScannerPlace};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Scans before the figures begin.
const WARM_UP: usize = 10;
/// Pause between the first bytes of a scan and its last one, and between two scans.
const PAUSE: Duration = Duration::from_millis(5);

fn main() -> anyhow::Result<()> {
    let scans: usize = std::env::args().nth(1).map_or(Ok(1000), |count| count.parse()).context("SCANS")?;
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let place = ScannerPlace::parse(&listener.local_addr()?.to_string())?;
    let sent_ns = Arc::new(AtomicU64::new(0));
    let noted_ns = Arc::clone(&sent_ns);
    // It ends when the driver closes the connection.
    std::thread::spawn(move || listener.accept().map(|(stream, _)| play(stream, &noted_ns)));
    let mut source = ScannerConnection::open(ScannerConfig::new(place), monotonic_ns);
    let mut scan = Scan::default();
    let mut delays_ns = Vec::with_capacity(scans);
    let (mut count, mut before) = (0, 0);
    while delays_ns.len() < scans {
        if source.next(1_000_000_000, &mut scan)?.is_none() {
            anyhow::ensure!(source.failed_connections() == 0, "{}", source.message());
            continue;
        }
        let now_ns = monotonic_ns();
        count += 1;
        match count {
            0..WARM_UP => {}
            WARM_UP => before = allocations(),
            _ => delays_ns.push(now_ns - sent_ns.load(Ordering::Acquire)),
        }
    }
    let allocated = allocations() - before;
    delays_ns.sort_unstable();
    let at = |share: f64| delays_ns[((scans - 1) as f64 * share) as usize] as f64 * 1e-3;
    println!("scans {scans}, allocations {allocated}");
    println!("last byte to scan: p50 {:.1} us, p99 {:.1} us, max {:.1} us", at(0.5), at(0.99), at(1.0));
    Ok(())
}

/// Plays a scanner whose scans come one byte late.
fn play(mut stream: TcpStream, sent_ns: &AtomicU64) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut emulator = ScannerEmulator::in_a_room(monotonic_ns());
    let mut bytes = [0; 256];
    // The answer to the last command is followed by scans.
    loop {
        let count = stream.read(&mut bytes)?;
        if count == 0 {
            return Ok(());
        }
        emulator.receive(&bytes[..count], monotonic_ns());
        let reply: Vec<u8> = emulator.output().drain(..).collect();
        stream.write_all(&reply)?;
        if reply.starts_with(b"MD") {
            break;
        }
    }
    while let Some(due_ns) = emulator.due_ns() {
        // Its time runs as fast as scans are sent.
        emulator.advance(due_ns);
        let scan: Vec<u8> = emulator.output().drain(..).collect();
        let (last, first) = scan.split_last().ok_or(std::io::ErrorKind::InvalidData)?;
        stream.write_all(first)?;
        std::thread::sleep(PAUSE);
        sent_ns.store(monotonic_ns(), Ordering::Release);
        stream.write_all(&[*last])?;
        std::thread::sleep(PAUSE);
    }
    Ok(())
}
