//! The solver on problems of the closed loop.

mod problems;

use nmpc::{Budget, Problem, Solution, Solver, SolverSettings, Trajectory};
use problems::{bench_weights, cold_guess, ellipse, problem, random};
use shared_types::SolveStatus;
use vehicle::State;

fn solve(solver: &mut Solver, problem: &Problem, guess: &Trajectory) -> Solution {
    solver.solve(problem, guess, &Budget::Iterations(60))
}

#[test]
fn random_problems_of_the_closed_loop_converge() {
    let mut solver = Solver::new(SolverSettings::default());
    let count: u64 = std::env::var("SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(300);
    let mut iterations = Vec::new();
    let mut failed = 0;
    for seed in 0..count {
        let (problem, guess) = random(seed);
        let solution = solve(&mut solver, &problem, &guess);
        if solution.status != SolveStatus::Converged {
            println!("{seed} {:?} {} {:.1e} slack {:.4} J {:.4} active {} ellipses {}", solution.status, solution.iterations, solution.kkt_residual, solution.slack, solution.objective, solution.active_constraints, problem.ellipses.len());
            failed += 1;
        }
        iterations.push(solution.iterations);
    }
    iterations.sort_unstable();
    let n = iterations.len();
    println!("failed {failed}, median {}, p90 {}, p99 {} max {} fallbacks {}", iterations[n / 2], iterations[n * 9 / 10], iterations[n * 99 / 100], iterations[n - 1], solver.fallbacks());
    assert!(failed <= 3, "{failed}");
}

#[test]
#[ignore]
fn timing() {
    let mut solver = Solver::new(SolverSettings::default());
    let mut problems = Vec::new();
    for seed in 0..300 { problems.push(random(seed)); }
    for round in 0..2 {
        let mut micros = Vec::new();
        let mut per = Vec::new();
        for (problem, guess) in &problems {
            let mut t = f64::INFINITY;
            let mut solution = solve(&mut solver, problem, guess);
            for _ in 0..5 {
            let start = std::time::Instant::now();
            solution = solve(&mut solver, problem, guess);
            t = t.min(start.elapsed().as_secs_f64() * 1e6);
            }
            micros.push(t);
            per.push(t / f64::from(solution.iterations.max(1)));
        }
        micros.sort_by(f64::total_cmp);
        per.sort_by(f64::total_cmp);
        println!("random {round}: median {:.1} p90 {:.1} p99 {:.1} us; per iteration {:.1} {:.1}", micros[150], micros[270], micros[297], per[150], per[297]);
    }
    let mut micros = Vec::new();
    let mut iterations = Vec::new();
    let mut previous: Option<Trajectory> = None;
    let mut state = State { y: 0.02, ..State::default() };
    for step in 0..200 {
        let mut p = problem(state, 12.0, bench_weights(), vec![ellipse(5.0, 0.1, 1.2, 0.8)]);
        p.previous = None;
        let guess = previous.clone().unwrap_or_else(|| cold_guess(&p));
        let mut t = f64::INFINITY;
        let mut solution = solve(&mut solver, &p, &guess);
        for _ in 0..5 {
            let start = std::time::Instant::now();
            solution = solve(&mut solver, &p, &guess);
            t = t.min(start.elapsed().as_secs_f64() * 1e6);
        }
        micros.push(t);
        iterations.push(solution.iterations);
        assert_eq!(solution.status, SolveStatus::Converged, "{step}");
        let u = solution.trajectory.controls[0];
        state = vehicle::integrate::integrate(&p.parameters, &state, &u, 0.1);
        state.y += 0.003 * f64::from(step % 3 - 1);
        previous = Some(solution.trajectory);
        if state.x > 11.5 { break; }
    }
    let n = micros.len();
    micros.sort_by(f64::total_cmp);
    iterations.sort_unstable();
    println!("loop: median {:.1} p90 {:.1} p99 {:.1} max {:.1}; iterations {} {} {}", micros[n/2], micros[n*9/10], micros[n*99/100], micros[n-1], iterations[n/2], iterations[n*9/10], iterations[n-1]);
}

#[test]
#[ignore]
fn one() {
    let seed: u64 = std::env::var("SEED").unwrap().parse().unwrap();
    let (problem, guess) = random(seed);
    let solution = solve(&mut Solver::new(SolverSettings::default()), &problem, &guess);
    eprintln!("{solution:?}");
}
