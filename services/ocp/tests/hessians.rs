//! The kinds of Hessian against each other on random problems of the closed loop.

mod problems;

use ocp::{Budget, Hessian, Solution, Solver, SolverSettings, Status};
use problems::random;

const COUNT: u64 = 300;

struct Run {
    solutions: Vec<Solution>,
    failed: usize,
    median: u32,
    p90: u32,
    p99: u32,
}

fn run(settings: SolverSettings) -> Run {
    let mut solver = Solver::new(SolverSettings { max_iterations: 200, ..settings });
    let solutions: Vec<_> = (0..COUNT)
        .map(|seed| {
            let (problem, guess) = random(seed);
            solver.solve(&problem, &guess, &Budget::Iterations(200))
        })
        .collect();
    let mut iterations: Vec<_> = solutions.iter().map(|solution| solution.iterations).collect();
    iterations.sort_unstable();
    let at = |share: f64| iterations[(share * (iterations.len() - 1) as f64) as usize];
    let failed = solutions.iter().filter(|solution| solution.status != Status::Converged).count();
    Run { failed, median: at(0.5), p90: at(0.9), p99: at(0.99), solutions }
}

#[test]
fn all_hessians_converge_to_the_same_solutions() {
    let classic = SolverSettings { refine: false, ..SolverSettings::default() };
    let settings = SolverSettings::default();
    let reference = run(settings);
    println!("{:28} {:>6} {:>6} {:>4} {:>4} {:>9}", "", "failed", "median", "p90", "p99", "elsewhere");
    // Measured failures, of 300, and median iterations: 0, 0, 1 and 4, 4, 4 refined; 26, 22, 34 and 8, 8, 5 not refined.
    for (name, settings, failed, median) in [
        ("gauss-newton", settings, 1, 5),
        ("bfgs", SolverSettings { hessian: Hessian::Bfgs, ..settings }, 3, 5),
        ("exact", SolverSettings { hessian: Hessian::Exact, ..settings }, 3, 5),
        ("gauss-newton, not refined", classic, 40, 10),
        ("bfgs, not refined", SolverSettings { hessian: Hessian::Bfgs, ..classic }, 35, 10),
        ("exact, not refined", SolverSettings { hessian: Hessian::Exact, ..classic }, 50, 8),
    ] {
        let found = run(settings);
        // Where both converge and the obstacle is avoided on another side, or not avoided elsewhere.
        let elsewhere = reference
            .solutions
            .iter()
            .zip(&found.solutions)
            .filter(|(mine, theirs)| {
                let both = [mine, theirs].iter().all(|solution| solution.status == Status::Converged);
                both && (mine.objective - theirs.objective).abs() > 1e-5 * (1.0 + mine.objective)
            })
            .count();
        let Run { failed: failures, median: iterations, p90, p99, .. } = found;
        println!("{name:28} {failures:6} {iterations:6} {p90:4} {p99:4} {elsewhere:9}");
        assert!(failures <= failed && iterations <= median && elsewhere <= 15, "{name}");
    }
}
