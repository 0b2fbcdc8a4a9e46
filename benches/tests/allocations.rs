//! A solve allocates nothing once its buffers have grown to the size of its problems.

#[path = "../../services/ocp/tests/problems/mod.rs"]
mod problems;

use ocp::{Budget, Hessian, Problem, Solution, Solver, SolverSettings, Trajectory};
use problems::random;
use scanloop_bench::{CountingAllocator, allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

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
    let before = allocations();
    for (problem, guess) in problems {
        solver.solve_into(problem, guess, &budget, &mut solution);
    }
    let after = allocations();
    assert_eq!(solver.fallbacks(), 0, "the interior-point method allocates: {:?}", settings.hessian);
    after - before
}

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
    let before = allocations();
    drop(std::hint::black_box(vec![1]));
    assert_eq!(allocations(), before + 1);
}
