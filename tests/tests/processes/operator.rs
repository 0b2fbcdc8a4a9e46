//! A short campaign of random operator actions in every run of the tests; the long one is `soak operator`.
//!
//! File systems are not filled here: `shared_memory.rs` does that.

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::operator::trial;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Seeds that have all kinds of action, for two series of trials side by side. Those of 1073 and 2066 once made the
/// orchestrator hang.
const SEEDS: [[u64; 6]; 2] = [[100, 107, 131, 143, 1073, 2003], [113, 151, 164, 2010, 2066, 2080]];

#[test]
fn after_any_actions_of_an_operator_the_wheels_rest_and_nothing_is_left() {
    std::thread::scope(|scope| {
        for seeds in SEEDS {
            scope.spawn(move || {
                for seed in seeds {
                    repeat_when_late(|| {
                        let judged = trial(EXECUTABLE, seed, false);
                        println!("{judged}");
                        assert!(judged.problems.is_empty(), "{judged}");
                    });
                }
            });
        }
    });
}
