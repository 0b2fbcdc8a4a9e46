//! Scans without ranges, irregular and late scans, and stamps that err, in the loop of one process.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use emulator::{Outcome, Scenario};
use pipeline::{DriveResult, PipelineSettings, Step, drive};
use shared_types::{ActuationKind, BlockReason, StopReason};

const PERIOD_NS: u64 = 100_000_000;

/// Drives a shipped scenario with these keys of robot and scanner.
fn driven(scenario: &str, robot: &str, scanner: &str) -> (DriveResult, Vec<Step>) {
    let text = Scenario::shipped(scenario).unwrap();
    let robot = format!("[robot]\n{robot}\n");
    let text = match text.contains("[robot]\n") {
        true => text.replace("[robot]\n", &robot),
        false => format!("{text}\n{robot}"),
    };
    let mut steps = Vec::new();
    let settings =
        PipelineSettings::of(Scenario::parse(&format!("{text}\n[scanner]\n{scanner}"), "test").unwrap());
    let end = drive(&settings, |step| steps.push(*step)).unwrap();
    (end, steps)
}

fn turns(step: &Step) -> bool {
    step.actuation.unwrap().kind == ActuationKind::Drive.wire()
}

fn reason(step: &Step) -> BlockReason {
    BlockReason::try_from(step.actuation.unwrap().reason).unwrap()
}

fn gaps(steps: &[Step]) -> u64 {
    steps.last().unwrap().actuation.unwrap().gaps
}

#[test]
fn a_scan_without_ranges_is_announced_and_blocks_nothing() {
    let (end, steps) = driven("corridor", "scan_missing_every = 20\nscan_stamp_jitter_s = 0.002", "");
    assert_eq!(end.outcome, Outcome::Reached);
    let mut missing = 0;
    for (index, step) in steps.iter().enumerate() {
        let (scan, odometry) = (&step.scan, &step.odometry.header);
        assert_eq!((scan.header.scan_id, odometry.scan_id), (index as u64 + 1, index as u64 + 1));
        assert_eq!((odometry.sequence, odometry.acquired_ns), (odometry.scan_id, scan.header.acquired_ns));
        assert!(odometry.acquired_ns.abs_diff(odometry.scan_id * PERIOD_NS) <= 6_000_000);
        assert_eq!(step.actuation.map(|actuation| actuation.header.scan_id), Some(odometry.scan_id));
        assert_eq!(scan.missing.is_set(), scan.ranges_mm.iter().all(|range| *range == 0), "scan {index}");
        if scan.missing.is_set() {
            missing += 1;
            let landed = step.command.unwrap().reason == StopReason::Landed.wire();
            // Before the first ranges nothing ahead is seen.
            let is_first = steps[..index].iter().all(|step| step.scan.missing.is_set());
            assert!(turns(step) || landed || is_first, "scan {index}: {:?}", reason(step));
        }
    }
    assert!(missing >= 3, "{missing} of {}", steps.len());
    assert!(steps.iter().any(|step| step.scan.header.acquired_ns % PERIOD_NS != 0));
    assert_eq!(gaps(&steps), 0);
}

#[test]
fn without_any_ranges_from_the_start_the_robot_never_drives() {
    let (end, steps) = driven("corridor", "", "missing_every = 1");
    assert_eq!((end.outcome, end.reason.as_str()), (Outcome::Stopped, "wheels blocked for 5 s: scanner"));
    assert!(steps.iter().all(|step| step.scan.missing.is_set() && step.truth.speed_mps == 0.0));
}

#[test]
fn irregular_scans_are_driven_and_their_gaps_end_with_the_next_command() {
    for scenario in ["corridor", "slalom", "walls", "crossing"] {
        for robot in ["preset = \"ideal\"", "preset = \"summit\""] {
            if scenario == "corridor" && robot.contains("summit") {
                // The shipped file sets it.
                continue;
            }
            let robot = if scenario == "corridor" { "" } else { robot };
            let (end, steps) = driven(scenario, robot, "period_s = [0.005, 0.255]\nstamp_jitter_s = 0.02");
            assert_eq!(end.outcome, Outcome::Reached, "{scenario}, {robot}: {}", end.reason);
            let mut counted = 0;
            for pair in steps.windows(2) {
                let [before, after] = [0, 1].map(|index| pair[index].scan.header.scan_published_ns());
                let is_gap = after - before > 3 * PERIOD_NS / 2 && pair[0].command.is_some();
                counted += u64::from(is_gap);
                assert!(pair[0].scan.header.acquired_ns < pair[1].scan.header.acquired_ns);
                assert_ne!(reason(&pair[1]), BlockReason::NoCommand, "{scenario}, {robot}");
                assert_ne!(reason(&pair[1]), BlockReason::StaleCommand, "{scenario}, {robot}");
            }
            assert!(counted >= 2 && gaps(&steps) == counted, "{scenario}: {counted} and {}", gaps(&steps));
        }
    }
}

#[test]
fn late_scans_block_the_wheels_until_they_come_in_time_again() {
    let (end, steps) = driven("corridor", "", "late_s = 0.3\nfrom_s = 3\nto_s = 5");
    assert_eq!(end.outcome, Outcome::Reached, "{}", end.reason);
    let late = |step: &&Step| (2.999..4.999).contains(&step.truth.time_s);
    assert_eq!(steps.iter().filter(late).count(), 20);
    assert!(steps.iter().filter(late).all(|step| reason(step) == BlockReason::StaleCommand));
    let after = steps.iter().filter(|step| step.truth.time_s > 5.5);
    assert!(after.clone().take(20).all(turns), "{:?}", after.map(reason).collect::<Vec<_>>());
    let standing = steps.iter().filter(late).filter(|step| step.truth.speed_mps == 0.0).count();
    assert!(standing >= 10, "{standing} scans at rest");

    let (end, steps) = driven("corridor", "", "late_s = 0.3\nfrom_s = 3");
    assert_eq!(end.outcome, Outcome::Stopped);
    assert_eq!(end.reason, "wheels blocked for 5 s: stale_command");
    assert!(!steps.iter().any(|step| step.truth.collided == 1));
}
