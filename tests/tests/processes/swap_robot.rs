//! The robot itself swapped while it drives: the new or the old process continues where it is.

use handover::swap::SwapOutcome;
use report::Report;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{
    assert_reached, rolls_back_a_hang_in_charge, stop, survives_the_death_of_the_standby, swap_in_vain,
    swap_seamlessly,
};
use scanloop_tests::{SHORT_CORRIDOR, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-robot");

/// Noise, drift and play, so that an incomplete state is detected; and an obstacle that waits for the robot.
const EVENTFUL: [&str; 9] = [
    "imperfect-robot",
    "--set",
    "noise.odometry_m=0.01",
    "--set",
    "robot.odometry_lateral_rate=0.0005",
    "--set",
    "noise.dropout=0.02",
    "--set",
    "noise.mixed_pixels=0.2",
];

/// Largest distance between where the robot is and where its motion from scan to scan so far would have taken it,
/// around a scan [m].
fn leap_at(report: &Report, scan: u64) -> f64 {
    let leap = |rows: &[[f64; 4]]| {
        let step = |from: usize, axis: usize| rows[from + 1][axis] - rows[from][axis];
        (step(1, 1) - step(0, 1)).hypot(step(1, 2) - step(0, 2))
    };
    // Row 0 is scan 1.
    let rows = &report.trajectory[scan as usize - 3..scan as usize + 2];
    rows.windows(3).map(leap).fold(0.0, f64::max)
}

#[test]
fn a_swapped_robot_continues_where_it_is() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&EVENTFUL);
        let old = system.pid(Role::Robot);
        let mut certificates = Vec::new();
        for _ in 0..2 {
            certificates.push(swap_seamlessly(&system, &["robot", "--to", "emulator"]));
        }
        assert_ne!(system.pid(Role::Robot), old);
        system.wait();
        let report = system.report();
        assert_eq!(report.trajectory.len() as u64, report.scans.published, "one truth per scan");
        for certificate in &certificates {
            // At most the effect of another speed or direction during one scan period; the drive of the robot changes its speed
            // by at most 3 m/s^2, which is 3 cm in two periods of 0.1 s.
            let leap_m = leap_at(&report, certificate.first_scan_new.unwrap());
            assert!(leap_m < 0.1 * certificate.command_jump_mps + 0.03, "{leap_m} {certificate:?}");
        }
        assert_eq!(report.outcome, emulator::Outcome::Reached, "{}", report.reason);
        assert_eq!(report.swaps, certificates);
        let scans = &report.scans;
        assert_eq!((scans.lost, scans.unaccounted, scans.duplicates), (0, 0, 0), "{scans:?}");
        system.assert_nothing_left();
    });
}

#[test]
fn in_lock_step_noise_drift_and_what_waits_for_the_robot_are_the_same_to_the_last_bit() {
    repeat_when_late(|| {
        let arguments = [
            &["sudden", "--set", "goal.x_m=20.0", "--set", "obstacle.0.x_m=15.0", "--set", "rate_hz=200"][..],
            &EVENTFUL[1..],
        ]
        .concat();
        let undisturbed = TestSystem::new(EXECUTABLE).lockstep(&arguments);
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&["--lockstep"], &arguments[..]].concat());
        let certificate = swap_seamlessly(&system, &["robot", "--to", "emulator"]);
        system.wait();
        let report = system.report();
        assert!(report.trajectory.len() as u64 > certificate.first_scan_new.unwrap());
        assert_eq!(report.digests, undisturbed.digests);
        assert_eq!(report.drive, undisturbed.drive, "clearances and all that is counted");
        system.assert_nothing_left();
    });
}

#[test]
fn a_bad_robot_is_refused_with_the_reason() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let mut certificates = Vec::new();
        for (fault, reason) in [
            (vec!["nan"], "odometry is not finite"),
            (vec!["jump"], "true position differs by 0.1000 m, allowed are 0.0100 m"),
            (vec!["exit-after", "3"], "the new process ended: exit code 1: "),
            (vec!["hang-after", "3"], "late: no output for scan"),
        ] {
            let arguments = [vec!["robot", "--", FAULTY], fault].concat();
            certificates.push(swap_in_vain(&system, &arguments, SwapOutcome::Refused, reason));
        }
        assert_reached(system, &certificates);
    });
}

#[test]
fn a_robot_that_hangs_in_charge_is_rolled_back_and_no_scan_is_missed() {
    repeat_when_late(|| {
        rolls_back_a_hang_in_charge(TestSystem::new(EXECUTABLE), Role::Robot, FAULTY);
    });
}

#[test]
fn the_new_robot_stays_when_the_old_one_is_killed_during_its_standby() {
    repeat_when_late(|| {
        survives_the_death_of_the_standby(TestSystem::new(EXECUTABLE), Role::Robot, "emulator");
    });
}

#[test]
fn a_robot_that_fails_in_lock_step_is_rolled_back_too() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep", "--duration", "9000"]);
        for fault in [["hang-after", "20"], ["exit-after", "20"]] {
            let standby = ["robot", "--standby-scans", "40", "--", FAULTY];
            swap_in_vain(&system, &[&standby[..], &fault].concat(), SwapOutcome::RolledBack, "");
        }
        stop(&mut system);
    });
}
