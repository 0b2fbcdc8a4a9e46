//! A shadow with hand-made outputs, at 10 Hz: scan k is published at k * 100 ms.

use shared_types::{Command, CommandKind, Role};

use super::{ShadowReport, Study};
use crate::swap::{OutputSummary, Party, SwapOutput};

const PERIOD_NS: u64 = 100_000_000;

fn output(scan: u64, after_ms: f64, content: Result<OutputSummary, String>) -> SwapOutput {
    let published_ns = scan * PERIOD_NS + (after_ms * 1e6) as u64;
    SwapOutput {
        scan,
        sequence: scan,
        scan_published_ns: scan * PERIOD_NS,
        published_ns,
        compute_ns: (after_ms * 0.5e6) as u64,
        stamps_ns: [published_ns; 2],
        content,
    }
}

fn command(steering_rad: f64) -> OutputSummary {
    let kind = CommandKind::Drive.wire();
    OutputSummary::from(&Command { kind, velocity_mps: 1.0, steering_rad, ..Command::default() })
}

/// Scans 1 to `scans`, all answered by the live one after 2 ms, and by the shadow with the outputs of `shadow`.
fn study(scans: u64, shadow: impl Fn(u64) -> Vec<SwapOutput>) -> ShadowReport {
    let mut study = Study::new(Role::Controller, PERIOD_NS, scans);
    for scan in 1..=scans {
        study.output(scan * PERIOD_NS, Party::Old, output(scan, 2.0, Ok(command(0.04))));
        for output in shadow(scan) {
            study.output(scan * PERIOD_NS, Party::New, output);
        }
    }
    study.report()
}

#[test]
fn differences_and_times_are_those_of_the_pairs() {
    let report = study(300, |scan| {
        let steering = 0.042 + if scan % 2 == 0 { 0.001 } else { -0.001 };
        vec![output(scan, 3.0, Ok(command(steering)))]
    });
    assert_eq!((report.scans, report.answered, report.compared), (300, 300, 300));
    assert_eq!((report.late, report.invalid, report.repeated, report.kind_differs), (0, 0, 0, 0));
    let [velocity, steering] = &report.differences[..] else { panic!("two quantities") };
    assert_eq!((velocity.mean, velocity.mean_interval), (0.0, Some([0.0, 0.0])));
    let [low, high] = steering.mean_interval.unwrap();
    // They alternate, so every block has the mean of all.
    assert!([steering.mean, low, high].iter().all(|value| (value - 0.002).abs() < 1e-4), "{low} {high}");
    assert!((steering.max_abs - 0.003).abs() < 1e-9);
    assert_eq!(steering.unit, "rad");
    let reaction = &report.reaction_ms;
    assert_eq!((reaction.live_p50, reaction.shadow_p50, reaction.ratio_p50), (2.0, 3.0, 1.5));
    assert_eq!(reaction.ratio_p99_interval, Some([1.5, 1.5]));
    assert_eq!((report.compute_ms.live_p99, report.compute_ms.shadow_p99), (1.0, 1.5));
}

#[test]
fn scans_count_from_the_first_output_on_and_the_share_shows_gaps() {
    let report = study(100, |scan| {
        if !(21..=60).contains(&scan) { Vec::new() } else { vec![output(scan, 3.0, Ok(command(0.04)))] }
    });
    // The newest scan may still be answered, so it is no gap.
    assert_eq!((report.scans, report.answered), (79, 40));
    assert!((report.answered_share - 40.0 / 79.0).abs() < 1e-12);
    let never = study(50, |_| Vec::new());
    assert_eq!((never.scans, never.answered, never.answered_share), (50, 0, 0.0));
    assert_eq!(never.differences[0].mean_interval, None);
}

#[test]
fn late_invalid_repeated_and_other_outputs_are_counted_apart() {
    let stop = OutputSummary::from(&Command::default());
    let report = study(20, |scan| match scan {
        3 => vec![output(scan, 60.0, Ok(command(0.04)))],
        5 => vec![output(scan, 3.0, Err("command is not finite".to_owned()))],
        7 => vec![output(scan, 3.0, Ok(stop.clone()))],
        // Of a thousand, sixteen are received; the numbers of those that follow show the others.
        9 => (0..16).map(|_| output(scan, 3.0, Ok(command(0.04)))).collect(),
        11 => {
            let no_such_scan = SwapOutput { scan: u64::MAX, ..output(scan, 3.0, Ok(command(0.04))) };
            vec![no_such_scan, output(scan, 3.0, Ok(command(0.04)))]
        }
        20 => vec![SwapOutput { sequence: 1019, ..output(scan, 3.0, Ok(command(0.04))) }],
        _ => vec![output(scan, 3.0, Ok(command(0.04)))],
    });
    assert_eq!((report.scans, report.answered, report.late), (20, 20, 1));
    assert_eq!((report.invalid, report.kind_differs, report.repeated, report.compared), (1, 1, 999, 19));
}

#[test]
fn the_table_names_quantities_units_and_intervals() {
    let text = study(30, |scan| vec![output(scan, 3.0, Ok(command(0.05)))]).to_string();
    for part in [
        "answered 30 (100.0 %)",
        "steering angle [rad]",
        "0.010000  [0.010000, 0.010000]",
        "1.50 [1.50, 1.50]",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}
