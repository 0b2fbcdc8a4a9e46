//! The error bound holds with the arrivals of a real scanner on a real rover.
//!
//! The recording is not part of the project: the test uses it where it lies beside the checkout, and tells when not. It
//! has arrivals and no stamps. How late a scan came is its distance from the turns of the scanner, whose speed wanders by
//! some milliseconds; so the earliest scans of each seven seconds count as those without additional delay.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::Write;

use device_clock::{ClockEvent, ClockSettings, DeviceClock};

/// Where the recording is expected, from the folder of this crate.
const FILE: &str = "../../../shared/recordings/urg-rover.dat";
/// Turn of the recorded scanner: with it the arrivals have the smallest mean delay [ns].
const TURN_NS: u64 = 98_700_000;
/// From the stamp to the end of a sweep [ns].
const SWEEP_NS: u64 = 70_000_000;
/// The recording is repeated for this time [ns].
const FIVE_HOURS_NS: u64 = 5 * 3_600_000_000_000;

/// Scans before and after one among which the earliest one has no additional delay.
const NEAR: usize = 37;

/// Time since the scan before, and additional delay, of each recorded scan but the first [ns].
fn gaps_and_delays(text: &str) -> Vec<(u64, u64)> {
    let first = |line: &str| line.split_ascii_whitespace().next().unwrap().parse::<u64>().unwrap() * 1000;
    let times: Vec<u64> = text.lines().filter(|line| !line.trim().is_empty()).map(first).collect();
    // The newest turn that is complete, and each only once.
    let mut next = u64::MAX;
    let turn = |time_ns: &u64| {
        next = (next - 1).min((time_ns - SWEEP_NS) / TURN_NS);
        time_ns - next * TURN_NS
    };
    let mut delays: Vec<u64> = times.iter().rev().map(turn).collect();
    delays.reverse();
    let near = |index: usize| &delays[index.saturating_sub(NEAR)..(index + NEAR).min(delays.len())];
    let excess = |index: usize| delays[index] - near(index).iter().min().unwrap();
    (1..times.len()).map(|index| (times[index] - times[index - 1], excess(index))).collect()
}

/// Arrivals and stamps over five hours [ns].
fn five_hours(recorded: &[(u64, u64)]) -> Vec<(u64, u64)> {
    let (mut arrived_ns, mut stamped_ns) = (100_000_000_000, 0);
    let step = |(gap_ns, delay_ns): &(u64, u64)| {
        arrived_ns += gap_ns;
        stamped_ns = (arrived_ns - SWEEP_NS - delay_ns).max(stamped_ns + 1_000_000);
        (arrived_ns < FIVE_HOURS_NS).then_some((arrived_ns, stamped_ns))
    };
    recorded.iter().cycle().map_while(step).collect()
}

/// Says that a test was skipped, on the standard error of the program: that of a test that passes is not shown.
fn skipped(test: &str) {
    let mut stderr = std::io::stderr();
    writeln!(stderr, "skipped: {test}: {FILE} is not there").unwrap();
}

#[test]
fn the_bound_holds_over_five_hours_of_recorded_arrivals() {
    let Ok(text) = std::fs::read_to_string(FILE) else {
        skipped("the_bound_holds_over_five_hours_of_recorded_arrivals");
        return;
    };
    let recorded = gaps_and_delays(&text);
    assert_eq!(recorded.len(), 755);
    let scans = five_hours(&recorded);
    for drift_ppm in [-120.0, -20.0, 0.0, 40.0, 150.0] {
        let ticks = |time_ns: u64| (time_ns as f64 * (1.0 + drift_ppm * 1e-6) * 1e-6) as u64 % (1 << 24);
        let mut clock = DeviceClock::new(ClockSettings::milliseconds_of_24_bits());
        let asked_ns = scans[0].1 - 1_000_000_000;
        for sent_ns in (0..10).map(|number| asked_ns + number * 20_000_000) {
            clock.round_trip(ticks(sent_ns + 700_000), sent_ns, sent_ns + 1_500_000);
        }
        for (arrived_ns, stamped_ns) in &scans {
            let mapped = clock.arrival(ticks(*stamped_ns), *arrived_ns);
            let error_ns = mapped.time_ns.abs_diff(*stamped_ns);
            assert!(error_ns <= mapped.error_ns, "{error_ns} > {} at {arrived_ns}", mapped.error_ns);
            assert_eq!(mapped.event, ClockEvent::Regular);
        }
    }
}
