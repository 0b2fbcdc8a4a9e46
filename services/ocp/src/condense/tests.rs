use super::*;
use crate::collocation::{Collocation, Scheme};
use crate::kkt::Multipliers;
use crate::objective::smooth;
use crate::rows::row_excess;
use crate::shooting::Sweep;
use crate::{hessian, kkt, testing};

/// The iterate under the guess's controls, one of them moved.
fn swept(problem: &Problem, moved: usize, by: f64) -> (Iterate, Shooting) {
    let collocation = Collocation::new(Scheme::Radau3);
    let mut iterate = Iterate::default();
    iterate.start(problem, &testing::guess());
    iterate.controls[moved / 2][moved % 2] += by;
    let mut shooting = Shooting::default();
    // The second sweep leaves nothing of the first one's tolerance.
    for _ in 0..2 {
        assert!(shooting.sweep(problem, &collocation, &mut iterate, Sweep::Close, true));
    }
    (iterate, shooting)
}

/// Multipliers of some rows: bounds on either side, and the ellipse.
fn multipliers(qp: &Qp) -> Vec<f64> {
    (0..qp.row_count()).map(|row| if row % 3 == 0 { 0.7 * row as f64 - 9.0 } else { 0.0 }).collect()
}

#[test]
fn rows_and_gradient_are_differences_of_the_sweep() {
    let problem = testing::problem();
    let (iterate, shooting) = swept(&problem, 0, 0.0);
    let mut qp = Qp::default();
    condense(&problem, &iterate, &shooting, 0.0, &mut qp);
    let step = 1e-5;
    for column in 0..12 {
        let (ahead, _) = swept(&problem, column, step);
        let (behind, _) = swept(&problem, column, -step);
        let slope = (smooth(&problem, &ahead) - smooth(&problem, &behind)) / (2.0 * step);
        assert!((slope - qp.gradient[column]).abs() < 1e-6 * (1.0 + slope.abs()));
        for row in 0..qp.row_count() {
            let excess = |iterate| row_excess(&problem, iterate, row, true);
            let slope = (excess(&ahead) - excess(&behind)) / (2.0 * step);
            assert!((slope - qp.row(row)[column]).abs() < 1e-6, "row {row} column {column}");
            // Without gaps the limit is what the row is short of it.
            assert!((excess(&iterate) + qp.row_upper[row]).abs() < 1e-12);
        }
    }
}

#[test]
fn blocks_are_condensed_to_the_hessian_of_the_gradient() {
    let problem = testing::problem();
    let (iterate, shooting) = swept(&problem, 0, 0.0);
    let mut qp = Qp::default();
    condense(&problem, &iterate, &shooting, 0.3, &mut qp);
    let weights = qp.hessian.clone();
    let mut blocks = Vec::new();
    hessian::gauss_newton(&problem, &mut blocks);
    condense_blocks(&problem, &blocks, 0.3, &qp.rows, &mut qp.hessian);
    // Entries reach some hundred.
    assert!(qp.hessian.iter().zip(&weights).all(|(a, b)| (a - b).abs() < 1e-10));
}

#[test]
fn condensed_exact_blocks_are_the_difference_of_the_gradient_of_the_lagrangian() {
    let problem = testing::problem();
    let collocation = Collocation::new(Scheme::Radau3);
    let lagrangian = |iterate: &Iterate, shooting: &Shooting| {
        let mut qp = Qp::default();
        condense(&problem, iterate, shooting, 0.0, &mut qp);
        let rows = multipliers(&qp);
        let gradient: Vec<f64> = (0..12)
            .map(|column| {
                let sum: f64 = (0..qp.row_count()).map(|row| rows[row] * qp.row(row)[column]).sum();
                qp.gradient[column] + sum
            })
            .collect();
        (qp, rows, gradient)
    };
    let (iterate, shooting) = swept(&problem, 0, 0.0);
    let (mut qp, rows, _) = lagrangian(&iterate, &shooting);
    let (mut costates, mut blocks) = (Vec::new(), Vec::new());
    kkt::costates(&problem, &iterate, &shooting, &rows, &mut costates);
    let multipliers = Multipliers { costates: &costates, rows: &rows };
    hessian::exact(&problem, &collocation, &iterate, &shooting, multipliers, &mut blocks);
    condense_blocks(&problem, &blocks, 0.0, &qp.rows, &mut qp.hessian);
    let step = 1e-5;
    for column in 0..12 {
        let (ahead, ahead_shooting) = swept(&problem, column, step);
        let (behind, behind_shooting) = swept(&problem, column, -step);
        let (_, _, ahead) = lagrangian(&ahead, &ahead_shooting);
        let (_, _, behind) = lagrangian(&behind, &behind_shooting);
        for row in 0..12 {
            let difference = (ahead[row] - behind[row]) / (2.0 * step);
            // Entries reach some hundred; differences of gradients keep seven digits.
            let error = (difference - qp.hessian[row * 12 + column]).abs();
            assert!(error < 1e-4 * (1.0 + difference.abs()), "{row} {column}: {error}");
        }
    }
}

#[test]
fn gaps_move_the_limits_and_the_gradient() {
    let problem = testing::problem();
    let (mut iterate, mut shooting) = swept(&problem, 0, 0.0);
    iterate.states[3][4] += 0.05;
    let collocation = Collocation::new(Scheme::Radau3);
    assert!(shooting.sweep(&problem, &collocation, &mut iterate, Sweep::Keep, true));
    assert!((shooting.gaps[2][4] + 0.05).abs() < 1e-9 && (shooting.gaps[3][4] - 0.05).abs() < 1e-9);
    let (closed, closed_shooting) = swept(&problem, 0, 0.0);
    let (mut open_qp, mut closed_qp) = (Qp::default(), Qp::default());
    condense(&problem, &iterate, &shooting, 0.0, &mut open_qp);
    condense(&problem, &closed, &closed_shooting, 0.0, &mut closed_qp);
    // y moves nothing but itself, so the gap is made up for and bounds and gradient are those of the closed iterate.
    for row in 0..30 {
        assert!((open_qp.row_upper[row] - closed_qp.row_upper[row]).abs() < 1e-9);
    }
    for (open, closed) in open_qp.gradient.iter().zip(&closed_qp.gradient) {
        assert!((open - closed).abs() < 1e-7);
    }
}
