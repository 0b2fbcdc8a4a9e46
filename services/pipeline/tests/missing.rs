//! Scans that are missing at the scanner, and stamps that err, in the loop of one process.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use emulator::{Outcome, Scenario};
use pipeline::{Settings, drive};

/// Drives the corridor with these keys of the robot; scan ids, stamps and sequence numbers of the odometry.
fn driven(robot: &str) -> (Outcome, Vec<(u64, u64, u64)>) {
    let text = Scenario::shipped("corridor").unwrap().replace("[robot]\n", &format!("[robot]\n{robot}\n"));
    let mut seen = Vec::new();
    let end = drive(&Settings::of(Scenario::parse(&text, "test").unwrap()), |step| {
        let header = step.odometry.header;
        assert_eq!(
            (header.scan_id, header.acquired_ns),
            (step.scan.header.scan_id, step.truth.header.acquired_ns)
        );
        assert_eq!(step.actuation.map(|actuation| actuation.header.scan_id), Some(header.scan_id));
        seen.push((header.scan_id, header.acquired_ns, header.sequence));
    });
    (end.unwrap().outcome, seen)
}

#[test]
fn the_loop_goes_on_with_the_next_scan_and_reaches_the_goal() {
    let (outcome, seen) = driven("scan_missing_every = 20\nscan_stamp_jitter_s = 0.002");
    let gaps = seen.windows(2).filter(|pair| pair[1].0 > pair[0].0 + 1).count();
    assert_eq!(outcome, Outcome::Reached);
    assert!(gaps >= 2, "{gaps} of {}", seen.len());
    for (index, (scan_id, stamp_ns, sequence)) in seen.iter().enumerate() {
        assert_eq!(*sequence, index as u64 + 1, "numbers of samples have no gap");
        assert!(stamp_ns.abs_diff(scan_id * 100_000_000) <= 6_000_000);
    }
    assert!(seen.iter().any(|(scan_id, stamp_ns, _)| *stamp_ns != scan_id * 100_000_000));
}
