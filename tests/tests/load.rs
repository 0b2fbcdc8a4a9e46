//! Tests on a busy machine: a program of their own, because the load would disturb other tests.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use emulator::Outcome;
use rustix::process::{Pid, getpriority_process, setpriority_process};
use scanloop_tests::swaps::{assert_every_scan_answered_once, restart_all};
use scanloop_tests::{SHORT_CORRIDOR, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// The load of one test would be part of the other's.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Does something while so many threads for each processor do nothing but keep it busy.
fn beside_busy_threads<T>(each: usize, work: impl FnOnce() -> T) -> T {
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..each * std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        is_over.store(true, Ordering::Relaxed);
        result.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[test]
fn a_restart_under_load_loses_no_scan() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&["endless", "--set", "timeout_s=600"]);
    beside_busy_threads(1, || restart_all(&system));
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    system.wait();
    assert_every_scan_answered_once(&system);
    system.assert_nothing_left();
}

#[test]
fn a_drive_that_gets_little_of_the_processors_is_not_taken_for_a_robot_with_a_fault() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let mut system = TestSystem::new(EXECUTABLE);
    let arguments = ["run", "--quiet", "--out", "out", "--set", "timeout_s=60"];
    system.launch(&[&arguments[..], &SHORT_CORRIDOR].concat(), &[]);
    // Before it starts any process: they get what it has.
    setpriority_process(Pid::from_raw(system.orchestrator()), 10).unwrap();
    system.wait_until_driving();
    for &role in Role::ALL {
        assert_eq!(getpriority_process(Pid::from_raw(system.pid(role))), Ok(10), "{role}");
    }
    // Late or missing samples are no evidence against the robot, so it gets to its goal, or the run ends for its time.
    beside_busy_threads(3, || system.wait());
    let report = system.report();
    let told = format!("{} ({}), {:?}", report.outcome, report.reason, report.scans);
    assert_ne!(report.self_check.alarm, "stop", "{told}");
    assert_ne!(report.outcome, Outcome::Collision, "{told}");
    assert!(report.drive.path_length_m > 2.0, "{told}");
    assert_eq!(report.scans.unaccounted, 0, "{told}");
    system.assert_nothing_left();
}
