//! A short campaign of random operator actions in every run of the tests; the long one is `soak operator`.
//!
//! File systems are not filled here: `shared_memory.rs` does that.

use scanloop_tests::operator::trial;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Trials side by side.
const JOBS: u64 = 2;
/// Trials of each of them.
const TRIALS: u64 = 6;

#[test]
fn whatever_an_operator_does_the_wheels_come_to_rest_and_nothing_is_left() {
    std::thread::scope(|scope| {
        for job in 0..JOBS {
            scope.spawn(move || {
                for seed in (job * TRIALS + 1)..=(job + 1) * TRIALS {
                    let judged = trial(EXECUTABLE, seed, false);
                    println!("{judged}");
                    assert!(judged.problems.is_empty(), "{judged}");
                }
            });
        }
    });
}
