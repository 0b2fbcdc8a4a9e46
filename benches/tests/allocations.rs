//! A solve allocates nothing once its buffers have grown to the size of its problems.

#![expect(unsafe_code, reason = "a global allocator is an unsafe trait")]

#[path = "../../services/ocp/tests/problems/mod.rs"]
mod problems;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use ocp::{Budget, Hessian, Problem, Solution, Solver, SolverSettings, Trajectory};
use problems::random;

/// The system's allocator with a count of what it is asked for.
struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is handed to the system's allocator unchanged; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`, and the pointer came from the system's allocator.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `realloc`, and the pointer came from the system's allocator.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of the solves of `problems`, after those of `warm_up` in the same solver.
fn count(
    settings: SolverSettings,
    warm_up: &[(Problem, Trajectory)],
    problems: &[(Problem, Trajectory)],
) -> u64 {
    let mut solver = Solver::new(settings);
    let mut solution = Solution::default();
    let budget = Budget::Iterations(60);
    for (problem, guess) in warm_up {
        solver.solve_into(problem, guess, &budget, &mut solution);
    }
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    for (problem, guess) in problems {
        solver.solve_into(problem, guess, &budget, &mut solution);
    }
    let after = ALLOCATIONS.load(Ordering::Relaxed);
    assert_eq!(solver.fallbacks(), 0, "the interior-point method allocates: {:?}", settings.hessian);
    after - before
}

// One test only: the count is that of the whole process.
#[test]
fn a_solve_allocates_nothing_after_warm_up() {
    let problems: Vec<_> = (0..500).map(random).collect();
    // Numbers of ellipses and of active constraints vary; fifty problems have met what the others need.
    for hessian in [Hessian::GaussNewton, Hessian::Bfgs, Hessian::Exact] {
        let settings = SolverSettings { hessian, ..SolverSettings::default() };
        assert_eq!(count(settings, &problems[..50], &problems[50..]), 0, "{hessian:?}");
    }
    // Stage by stage the memory is that of the largest number of equations, which seldom comes: all have been met.
    let settings = SolverSettings { condense_up_to: 0, ..SolverSettings::default() };
    assert_eq!(count(settings, &problems, &problems), 0);
    // The counter does count.
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    drop(std::hint::black_box(vec![1]));
    assert_eq!(ALLOCATIONS.load(Ordering::Relaxed), before + 1);
}
