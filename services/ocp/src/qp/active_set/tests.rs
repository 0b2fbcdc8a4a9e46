use super::dense::DenseActiveSet;
use crate::qp::{Qp, QpSolution, clarabel};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A random program; some rows are copies or sums of others, some limits are already violated or exactly met.
fn random(seed: u64) -> Qp {
    let mut rng = Pcg64::seed_from_u64(seed);
    let count = rng.random_range(1..14usize);
    let rows = rng.random_range(0..40usize);
    let mut uniform = |low: f64, high: f64| rng.random_range(low..high);
    let root: Vec<f64> = (0..count * count).map(|_| uniform(-1.0, 1.0)).collect();
    let mut hessian = vec![0.0; count * count];
    for row in 0..count {
        for column in 0..count {
            let entry: f64 = (0..count).map(|k| root[k * count + row] * root[k * count + column]).sum();
            hessian[row * count + column] = entry + if row == column { 0.05 } else { 0.0 };
        }
    }
    let mut qp = Qp {
        hessian,
        gradient: (0..count).map(|_| uniform(-20.0, 20.0)).collect(),
        lower: (0..count).map(|_| uniform(-1.0, 0.0)).collect(),
        upper: (0..count).map(|_| uniform(0.0, 1.0)).collect(),
        slack_linear: 10f64.powf(uniform(0.0, 3.0)),
        slack_quadratic: 10f64.powf(uniform(-1.0, 3.0)),
        ..Qp::default()
    };
    for row in 0..rows {
        let kind = uniform(0.0, 1.0);
        if row > 1 && kind < 0.25 {
            let copied: Vec<f64> = qp.row(row - 1).iter().map(|entry| entry * 2.0).collect();
            qp.rows.extend(copied);
        } else if row > 1 && kind < 0.4 {
            let sum: Vec<f64> = qp.row(row - 1).iter().zip(qp.row(row - 2)).map(|(a, b)| a + b).collect();
            qp.rows.extend(sum);
        } else {
            qp.rows.extend((0..count).map(|_| uniform(-1.0, 1.0)));
        }
        let limit = if kind > 0.9 { 0.0 } else { uniform(-1.0, 1.5) };
        qp.row_upper.push(limit);
        qp.row_lower.push(if kind > 0.5 { f64::NEG_INFINITY } else { limit - uniform(0.0, 2.0) });
    }
    qp
}

#[test]
fn it_agrees_with_the_interior_point_method_on_degenerate_programs() {
    let mut solver = DenseActiveSet::default();
    let mut longest = 0;
    for seed in 0..10_000 {
        let qp = random(seed);
        let (mut mine, mut other) = (QpSolution::default(), QpSolution::default());
        assert!(solver.solve(&qp, &mut mine), "seed {seed}");
        longest = longest.max(solver.iterations());
        // Gradients reach some thousand where penalties act: nine digits.
        let residual = qp.residual(&mine, &mut Vec::new());
        assert!(residual < 1e-6, "seed {seed}: {residual:.1e}");
        assert!(clarabel::solve(&qp, &mut other), "seed {seed}");
        for (a, b) in mine.step.iter().zip(&other.step) {
            // The interior point stops at 1e-9 of the objective, whose flattest curvature is 0.05.
            assert!((a - b).abs() < 1e-3, "seed {seed}: {a} {b}");
        }
    }
    assert!(longest < 300, "{longest}");
}

#[test]
fn a_solved_program_needs_one_step_from_its_own_solution() {
    let mut solver = DenseActiveSet::default();
    for seed in 0..300 {
        let qp = random(seed);
        let mut solution = QpSolution::default();
        assert!(solver.solve(&qp, &mut solution));
        let before = solution.clone();
        let cold = solver.iterations();
        assert!(solver.solve(&qp, &mut solution));
        // A dependent or degenerate set may be left by rounding once.
        assert!(solver.iterations() <= 3.max(cold), "seed {seed}: {}", solver.iterations());
        for (a, b) in solution.step.iter().zip(&before.step) {
            assert!((a - b).abs() < 1e-8, "seed {seed}");
        }
    }
}

#[test]
fn a_wrong_start_leads_to_the_same_solution() {
    let mut solver = DenseActiveSet::default();
    for seed in 0..300 {
        let (qp, mut moved) = (random(seed), random(seed));
        for (index, gradient) in moved.gradient.iter_mut().enumerate() {
            *gradient += if index % 2 == 0 { 7.0 } else { -9.0 };
        }
        let (mut cold, mut warm) = (QpSolution::default(), QpSolution::default());
        assert!(solver.solve(&qp, &mut cold));
        assert!(solver.solve(&moved, &mut warm) && solver.solve(&qp, &mut warm));
        for (a, b) in cold.step.iter().zip(&warm.step) {
            assert!((a - b).abs() < 1e-7, "seed {seed}: {a} {b}");
        }
    }
}
