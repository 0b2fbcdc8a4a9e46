//! Tests on a busy machine: a program of their own, because the load would disturb other tests.

use std::sync::atomic::{AtomicBool, Ordering};

use scanloop_tests::TestSystem;
use scanloop_tests::swaps::{assert_every_scan_answered_once, restart_all};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn a_restart_under_load_loses_no_scan() {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&["endless", "--set", "timeout_s=600"]);
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let restarted = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| restart_all(&system)));
        is_over.store(true, Ordering::Relaxed);
        restarted.unwrap();
    });
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    system.wait();
    assert_every_scan_answered_once(&system);
    system.assert_nothing_left();
}
