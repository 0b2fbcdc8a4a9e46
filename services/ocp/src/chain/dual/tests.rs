use super::*;
use crate::collocation::{Collocation, Scheme};
use crate::condense::condense;
use crate::problem::{EllipsePath, Problem, Trajectory};
use crate::qp::active_set::dense::DenseActiveSet;
use crate::qp::{Qp, clarabel};
use crate::shooting::{Iterate, Sweep};
use crate::{hessian, testing};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use vehicle::Control;

/// A random program of 2 to 24 intervals past up to three ellipses, which may overlap or hold the guess, as condensed and as
/// stages; `None` where the guess cannot be driven.
fn program(seed: u64) -> Option<(Qp, Chain, Shooting, Vec<Block>)> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let count = rng.random_range(2..=24usize);
    let coarse = testing::problem();
    let mut uniform = |low: f64, high: f64| rng.random_range(low..high);
    let interval = 2.72 / count as f64;
    let (velocity, steering, bend) = (uniform(0.15, 1.0), uniform(-0.06, 0.06), uniform(-0.1, 0.1));
    let (mut initial, mut weights) = (coarse.initial, coarse.weights.clone());
    (initial.yaw, initial.y) = (uniform(-0.4, 0.4), uniform(-1.4, 1.4));
    weights.slack_linear = 10f64.powf(uniform(1.0, 3.0));
    weights.slack_quadratic = 10f64.powf(uniform(1.0, 3.0));
    weights.goal = [(0, 0.0); 2];
    weights.change = [uniform(0.0, 1.0), uniform(0.0, 60.0)];
    let ellipses = (0..uniform(0.0, 4.0) as usize)
        .map(|_| {
            let (x, y) = (initial.x + uniform(0.3, 3.5), uniform(-0.9, 0.9));
            EllipsePath { a: 1.2, b: uniform(0.4, 0.9), centres: vec![[x, y]; count + 1] }
        })
        .collect();
    let problem = Problem {
        intervals: vec![interval; count],
        initial,
        references: (1..=count)
            .map(|node| vehicle::State { x: initial.x + interval * node as f64, ..vehicle::State::default() })
            .collect(),
        weights,
        ellipses,
        ..coarse
    };
    let controls = (0..count)
        .map(|index| Control { velocity, steering: steering + bend * index as f64 / count as f64 })
        .collect();
    let (mut iterate, mut shooting) = (Iterate::default(), Shooting::default());
    iterate.start(&problem, &Trajectory { states: Vec::new(), controls });
    let collocation = Collocation::new(Scheme::Radau3);
    if !shooting.sweep(&problem, &collocation, &mut iterate, Sweep::Close, true) {
        return None;
    }
    let (mut qp, mut chain, mut blocks) = (Qp::default(), Chain::default(), Vec::new());
    condense(&problem, &iterate, &shooting, 0.0, &mut qp);
    chain.build(&problem, &iterate, 0.0, &mut Vec::new());
    hessian::gauss_newton(&problem, &mut blocks);
    Some((qp, chain, shooting, blocks))
}

/// All methods on the programs of `seeds`; how often search and interior point end without an answer, and the number of
/// programs.
fn compare(seeds: std::ops::Range<u64>) -> [usize; 3] {
    let mut counts = [0; 3];
    for seed in seeds {
        let Some((qp, mut chain, shooting, blocks)) = program(seed) else { continue };
        let mut expected = QpSolution::default();
        assert!(clarabel::solve(&qp, &mut expected), "seed {seed}");
        let check = |what: &str, found: &QpSolution| {
            let size = qp.gradient.iter().chain(&found.row_multipliers).fold(1.0, |a: f64, b| a.max(b.abs()));
            let residual = qp.residual(found, &mut Vec::new()) / size;
            assert!(residual < 1e-6, "seed {seed}, {what}: {residual:.1e}");
            for (a, b) in found.step.iter().zip(&expected.step) {
                // Clarabel stops at a share of the objective, whose flattest curvature is that of the velocity.
                assert!((a - b).abs() < 2e-3, "seed {seed}, {what}: {a} {b}");
            }
        };
        counts[2] += 1;
        let mut searched = QpSolution::default();
        if chain.solve(&shooting, &blocks, &mut searched) {
            check("search", &searched);
        } else {
            counts[0] += 1;
        }
        // From where the search ended, and from nothing.
        let mut found = QpSolution::default();
        assert!(chain.solve_dual(&shooting, &blocks, &mut found), "seed {seed}");
        check("dual", &found);
        chain.exact.reset(qp.variables(), qp.row_count());
        assert!(chain.solve_dual(&shooting, &blocks, &mut found), "seed {seed}");
        check("dual from nothing", &found);
        let mut condensed = QpSolution::default();
        assert!(DenseActiveSet::default().solve(&qp, &mut condensed), "seed {seed}");
        check("condensed", &condensed);
        if chain.solve_from_inside(&shooting, &blocks, &mut found) {
            check("interior point", &found);
        } else {
            counts[1] += 1;
        }
    }
    counts
}

#[test]
fn every_method_agrees_with_clarabel() {
    let [searched, inside, programs] = compare(0..2_000);
    println!("{programs} programs: the search fails in {searched}, the interior point in {inside}");
    assert!(programs > 1_900 && searched > 100 && inside < programs / 50);
}

#[test]
#[ignore = "takes minutes"]
fn every_method_agrees_with_clarabel_on_a_hundred_thousand_programs() {
    let [searched, inside, programs] = compare(0..100_000);
    println!("{programs} programs: the search fails in {searched}, the interior point in {inside}");
    assert!(programs > 95_000);
}
