//! The quadratic program by Clarabel's interior-point method.
//!
//! It has no warm start and allocates, but it failed in none of thousands of degenerate programs. Rows that no
//! admissible step can bring to their limits are left out, which is exact; most bounds of the state are such rows.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus, SupportedConeT,
};

use super::{BoundState, Qp, QpSolution, RowState};
use crate::dense::{dot, fill, refill};

/// Solves `qp` into `solution`; false where Clarabel finds no solution.
pub(crate) fn solve(qp: &Qp, solution: &mut QpSolution) -> bool {
    let count = qp.variables();
    let reachable: Vec<usize> = (0..qp.row_count()).filter(|&row| reachable(qp, row)).collect();

    let mut columns: Vec<Vec<(usize, f64)>> = vec![Vec::new(); count + reachable.len()];
    let mut limits = Vec::new();
    let mut owners = Vec::new();
    for (index, column) in columns.iter_mut().enumerate().take(count) {
        for (sign, limit) in [(1.0, qp.upper[index]), (-1.0, qp.lower[index])] {
            column.push((limits.len(), sign));
            limits.push(sign * limit);
            owners.push((Owner::Bound(index), sign));
        }
    }
    for (slack, &row) in reachable.iter().enumerate() {
        for (sign, limit) in [(1.0, qp.row_upper[row]), (-1.0, qp.row_lower[row])] {
            if limit.is_infinite() {
                continue;
            }
            for (column, &entry) in qp.row(row).iter().enumerate() {
                if entry != 0.0 {
                    columns[column].push((limits.len(), sign * entry));
                }
            }
            columns[count + slack].push((limits.len(), -1.0));
            limits.push(sign * limit);
            owners.push((Owner::Row(row), sign));
        }
        columns[count + slack].push((limits.len(), -1.0));
        limits.push(0.0);
        owners.push((Owner::Slack, 1.0));
    }

    let mut gradient = qp.gradient.clone();
    gradient.resize(count + reachable.len(), qp.slack_linear);
    let hessian = upper_triangle(qp, reachable.len());
    let constraints = from_columns(&columns, limits.len());
    let cones = [SupportedConeT::NonnegativeConeT(limits.len())];
    let data = Data { hessian, gradient, constraints, limits, cones };
    // Refinement costs 40 % and is seldom needed; the second try has it, and the scaling of badly scaled data.
    let Some(result) = attempt(&data, false).or_else(|| attempt(&data, true)) else { return false };

    fill(
        &mut solution.step,
        result.0[..count].iter().zip(&qp.lower).zip(&qp.upper).map(|((v, low), high)| v.max(*low).min(*high)),
    );
    refill(&mut solution.bound_multipliers, count, 0.0);
    refill(&mut solution.row_multipliers, qp.row_count(), 0.0);
    for ((owner, sign), value) in owners.iter().zip(&result.1) {
        match *owner {
            Owner::Bound(index) => solution.bound_multipliers[index] += sign * value,
            Owner::Row(row) => solution.row_multipliers[row] += sign * value,
            Owner::Slack => {}
        }
    }
    classify(qp, solution);
    true
}

/// Derives the active set from an interior solution: a constraint is active when its multiplier exceeds its distance.
fn classify(qp: &Qp, solution: &mut QpSolution) {
    solution.bound_states.clear();
    for (index, (&value, &multiplier)) in solution.step.iter().zip(&solution.bound_multipliers).enumerate() {
        let state = if multiplier > qp.upper[index] - value {
            BoundState::Upper
        } else if -multiplier > value - qp.lower[index] {
            BoundState::Lower
        } else {
            BoundState::Free
        };
        solution.bound_states.push(state);
    }
    solution.row_states.clear();
    for row in 0..qp.row_count() {
        let value = dot(qp.row(row), &solution.step);
        let multiplier = solution.row_multipliers[row];
        let side = |distance: f64, multiplier: f64| {
            // The multiplier of `slack >= 0` is what the row's multiplier lacks of its largest value.
            let rest = qp.slack_linear + 2.0 * qp.slack_quadratic * (-distance).max(0.0) - multiplier;
            if -distance > rest { Some(true) } else { (multiplier > distance).then_some(false) }
        };
        let above = side(qp.row_upper[row] - value, multiplier).map(|beyond| (true, beyond));
        let below = || side(value - qp.row_lower[row], -multiplier).map(|beyond| (false, beyond));
        let state =
            above.or_else(below).map_or(RowState::Inside, |(upper, beyond)| RowState::held(upper, beyond));
        solution.row_states.push(state);
    }
}

/// Which constraint a line of Clarabel's form belongs to.
#[derive(Clone, Copy)]
enum Owner {
    Bound(usize),
    Row(usize),
    Slack,
}

struct Data {
    hessian: CscMatrix<f64>,
    gradient: Vec<f64>,
    constraints: CscMatrix<f64>,
    limits: Vec<f64>,
    cones: [SupportedConeT<f64>; 1],
}

/// Whether a step within its bounds can bring the row to a limit.
fn reachable(qp: &Qp, row: usize) -> bool {
    let (mut smallest, mut largest) = (0.0, 0.0);
    for ((entry, low), high) in qp.row(row).iter().zip(&qp.lower).zip(&qp.upper) {
        let (at_low, at_high) = (entry * low, entry * high);
        smallest += at_low.min(at_high);
        largest += at_low.max(at_high);
    }
    largest >= qp.row_upper[row] || smallest <= qp.row_lower[row]
}

/// Primal and dual values, or nothing where the status is not Solved.
fn attempt(data: &Data, refine: bool) -> Option<(Vec<f64>, Vec<f64>)> {
    /// The SQP must reach 1e-6: 1e-4 here is not enough for it, and below 1e-9 rounding errors cause failures.
    const TOLERANCE: f64 = 1e-9;
    let settings: DefaultSettings<f64> = DefaultSettingsBuilder::default()
        .verbose(false)
        .max_threads(1)
        .presolve_enable(false)
        .equilibrate_enable(refine)
        .iterative_refinement_enable(refine)
        .tol_gap_abs(TOLERANCE)
        .tol_gap_rel(TOLERANCE)
        .tol_feas(TOLERANCE)
        .build()
        .ok()?;
    let mut solver = DefaultSolver::new(
        &data.hessian,
        &data.gradient,
        &data.constraints,
        &data.limits,
        &data.cones,
        settings,
    )
    .ok()?;
    solver.solve();
    let solved = matches!(solver.solution.status, SolverStatus::Solved)
        || (refine && matches!(solver.solution.status, SolverStatus::AlmostSolved));
    let finite = solver.solution.x.iter().chain(&solver.solution.z).all(|value| value.is_finite());
    (solved && finite).then(|| (solver.solution.x.clone(), solver.solution.z.clone()))
}

/// Upper triangle of H with the curvature of the slacks on the diagonal.
fn upper_triangle(qp: &Qp, slacks: usize) -> CscMatrix<f64> {
    let count = qp.variables();
    let columns: Vec<Vec<(usize, f64)>> = (0..count)
        .map(|column| (0..=column).map(|row| (row, qp.hessian[row * count + column])).collect())
        .chain((0..slacks).map(|slack| vec![(count + slack, 2.0 * qp.slack_quadratic)]))
        .collect();
    from_columns(&columns, count + slacks)
}

fn from_columns(columns: &[Vec<(usize, f64)>], height: usize) -> CscMatrix<f64> {
    let mut starts = vec![0];
    let (mut places, mut values) = (Vec::new(), Vec::new());
    for column in columns {
        for &(row, value) in column {
            places.push(row);
            values.push(value);
        }
        starts.push(places.len());
    }
    CscMatrix::new(height, columns.len(), starts, places, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_soft_row_is_exceeded_where_its_penalty_is_cheaper() {
        // minimise 1/2 v^2 - 10 v with v <= 1 soft: 10 - v = L1 + 2 L2 (v - 1) beyond the limit.
        let mut qp = Qp {
            hessian: vec![1.0],
            gradient: vec![-10.0],
            lower: vec![-100.0],
            upper: vec![100.0],
            rows: vec![1.0],
            row_lower: vec![f64::NEG_INFINITY],
            row_upper: vec![1.0],
            slack_linear: 4.0,
            slack_quadratic: 2.0,
        };
        let mut solution = QpSolution::default();
        assert!(solve(&qp, &mut solution));
        // v = (10 - 4 + 4) / (1 + 4) = 2 and the multiplier is 8.
        assert!((solution.step[0] - 2.0).abs() < 1e-6 && (solution.row_multipliers[0] - 8.0).abs() < 1e-5);
        assert!(qp.residual(&solution, &mut Vec::new()) < 1e-5);
        qp.slack_linear = 20.0;
        assert!(solve(&qp, &mut solution));
        assert!((solution.step[0] - 1.0).abs() < 1e-6 && (solution.row_multipliers[0] - 9.0).abs() < 1e-5);
        assert!(dot(qp.row(0), &solution.step) < 1.0 + 1e-6);
    }
}
