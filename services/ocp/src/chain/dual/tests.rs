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
    let (mut initial, mut weights) = (coarse.initial, coarse.weights);
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

/// How many programs there were, and in how many of them a method found no answer.
#[derive(Debug, Default)]
struct Counts {
    programs: usize,
    search: usize,
    interior: usize,
    /// From where the search ended, and from nothing.
    dual: usize,
    condensed: usize,
    /// Those that a run would hand to Clarabel.
    unsolved: usize,
}

/// All methods on the programs of `seeds`; every answer is checked.
fn compare(seeds: std::ops::Range<u64>) -> Counts {
    let mut counts = Counts::default();
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
        let tried = |what: &str, is_solved: bool, found: &QpSolution| {
            if is_solved {
                check(what, found);
            }
            usize::from(!is_solved)
        };
        let mut found = QpSolution::default();
        let search = tried("search", chain.solve(&shooting, &blocks, &mut found), &found);
        let dual = tried("dual", chain.solve_dual(&shooting, &blocks, &mut found), &found);
        chain.exact.reset(qp.variables(), qp.row_count());
        let again = tried("dual from nothing", chain.solve_dual(&shooting, &blocks, &mut found), &found);
        let interior = tried("interior", chain.solve_from_inside(&shooting, &blocks, &mut found), &found);
        let mut condensed = QpSolution::default();
        let is_condensed = DenseActiveSet::default().solve(&qp, &mut condensed);
        counts.condensed += tried("condensed", is_condensed, &condensed);
        counts.programs += 1;
        counts.search += search;
        counts.interior += interior;
        counts.dual += dual + again;
        counts.unsolved += search * interior * dual;
    }
    counts
}

#[test]
fn every_method_agrees_with_clarabel() {
    let counts = compare(0..2_000);
    println!("{counts:?}");
    // The search alone would fail in most of them: they start with nothing active.
    assert!(counts.programs > 1_900 && counts.search > 100);
    assert!(counts.interior + counts.dual + counts.condensed == 0, "{counts:?}");
}

#[test]
#[ignore = "takes minutes: cargo test --release -p ocp -- --ignored"]
fn every_method_agrees_with_clarabel_on_a_hundred_thousand_programs() {
    let counts = compare(0..100_000);
    println!("{counts:?}");
    assert!(counts.programs > 95_000 && counts.unsolved == 0, "{counts:?}");
    assert!(counts.dual + counts.condensed + counts.interior < counts.programs / 100, "{counts:?}");
}
