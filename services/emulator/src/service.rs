//! The process of the role `robot`: actuation in; scan, odometry and truth out.

use runtime::Process;
use shared_types::{Actuation, Odometry, Phase, Role, Scan, Truth};

use crate::{Emulator, Scenario};

/// Runs until asked to end.
///
/// In real time a scan is published when it is due, whatever the others do. In lock-step it is published when the
/// scan before it was answered and the orchestrator has granted it.
///
/// # Errors
/// A scenario that is not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Robot)?;
    let scenario = process.settings::<Scenario>("scenario")?;
    let mut emulator = Emulator::new(&scenario, process.period_ns());
    let actuations = process.input::<Actuation>()?;
    let scans = process.output::<Scan>()?;
    let odometries = process.output::<Odometry>()?;
    let truths = process.output::<Truth>()?;
    if !process.start()? {
        return Ok(());
    }
    let simulated = process.clock().is_simulated();
    let origin_ns = process.clock().now_ns();
    let (mut scan_id, mut answered) = (1, 0);
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    loop {
        let due_ns = origin_ns + emulator.scan_ready_ns(scan_id);
        // The last scan was published: what was due then must not keep a real-time process from sleeping.
        let stopping = process.directive().phase == Phase::Stopping.wire();
        let goes_on = if stopping { process.wait(None)? } else { process.wait_for_time(due_ns)? };
        if !goes_on {
            return Ok(());
        }
        while let Some(actuation) = actuations.take() {
            if !simulated {
                emulator.advance_to(process.clock().now_ns() - origin_ns);
            }
            emulator.actuate(&actuation);
            answered = if actuation.answers == 1 { actuation.header.scan_id } else { answered };
        }
        let directive = process.directive();
        let due = if simulated {
            answered + 1 == scan_id && scan_id <= directive.granted_scan
        } else {
            process.clock().now_ns() >= due_ns
        };
        if !due || directive.phase == Phase::Stopping.wire() {
            if !simulated {
                emulator.advance_to(process.clock().now_ns() - origin_ns);
            }
            continue;
        }
        if !simulated {
            scan_id = newest_due(&emulator, scan_id, process.clock().now_ns() - origin_ns);
        }
        let ready_ns = emulator.scan_ready_ns(scan_id);
        process.clock().advance_to(origin_ns + ready_ns);
        process.begin();
        emulator.advance_to(ready_ns);
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        for header in [&mut scan.header, &mut odometry.header, &mut truth.header] {
            header.scan_id = scan_id;
            header.acquired_ns = origin_ns + emulator.acquired_ns(scan_id);
        }
        truths.publish_silently(&mut truth)?;
        scans.publish(&mut scan)?;
        odometries.publish(&mut odometry)?;
        scan_id += 1;
    }
}

/// The newest scan that is due: a robot that was held up skips the scans it missed instead of rushing through them.
fn newest_due(emulator: &Emulator, scan_id: u64, now_ns: u64) -> u64 {
    let mut newest = scan_id;
    while emulator.scan_ready_ns(newest + 1) <= now_ns {
        newest += 1;
    }
    newest
}
