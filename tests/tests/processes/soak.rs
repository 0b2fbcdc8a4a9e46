//! A short soak in every run of the tests; the long one is the program `soak`.

use scanloop_tests::long_drive::{LongDrive, LongTally, drive};
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::soak::{faults, swap_in_lockstep, swap_live};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn a_hundred_swaps_in_lock_step_change_no_bit() {
    repeat_when_late(|| assert_eq!(swap_in_lockstep(EXECUTABLE, 100, 1).lockstep_swaps, 100));
}

#[test]
fn swaps_at_random_moments_of_a_drive_are_as_certified() {
    repeat_when_late(|| assert_eq!(swap_live(EXECUTABLE, 10, 1).live_swaps, 10));
}

#[test]
fn whatever_is_killed_or_stopped_the_robot_drives_on_or_rests() {
    repeat_when_late(|| {
        let tally = faults(EXECUTABLE, 24, 10, 1);
        assert_eq!((tally.kills, tally.stops), (24, 10));
        assert_eq!(tally.went_on + tally.came_to_rest, 34);
        assert!(tally.adopted > 0 && tally.alone > 0, "{tally:?}");
    });
}

#[test]
fn nothing_grows_or_is_unexplained_in_a_drive_with_scanner_faults_and_swaps() {
    repeat_when_late(|| {
        let mut tally = LongTally::default();
        drive(EXECUTABLE, &LongDrive { seed: 9, duration_s: 1800.0, rate_hz: 10.0, live: false }, &mut tally);
        assert_eq!(tally.problems, Vec::<String>::new(), "{tally}");
        assert!(tally.scanner_faults > 15 && tally.swaps > 0 && tally.stopped_by_scanner == 0, "{tally}");
    });
}
