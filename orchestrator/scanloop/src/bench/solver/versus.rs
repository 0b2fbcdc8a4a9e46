//! The comparison of one peer with the solver in its default settings, case by case.
//!
//! Two solvers that found the same optimum agree in their controls; where they do not, both may be right, because an
//! obstacle is passed on either side. Those cases are listed with both objectives and do not count as different answers.

use figures::{Distribution, Figures};
use ocp::Solution;
use serde::Serialize;

use super::peers::Answer;

/// Largest difference of a control (velocity [m/s], steering [rad]) of the same optimum: both sides stop at a gradient
/// of about 1e-6, and the flattest curvature is the control weight, of order one.
pub(super) const SAME: f64 = 1e-5;
/// How many times faster than IPOPT acados was on these cases, at the median, in the published comparison.
const ACADOS: f64 = 11.4;

/// What was seen of a peer so far.
#[derive(Debug, Clone)]
pub(super) struct Versus {
    name: String,
    cases: u64,
    converged: u64,
    solve: Distribution,
    iterations: Distribution,
    same: u64,
    largest_difference: f64,
    largest_difference_as_stopped: f64,
    others: Vec<Other>,
}

/// A case in which the two found different optima.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Other {
    /// Line in the file of cases.
    pub line: usize,
    /// Largest difference of a control.
    pub difference: f64,
    /// Objective of Scanloop.
    pub objective: f64,
    /// Objective of the peer.
    pub peer_objective: f64,
}

/// What is printed of a peer.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Row {
    /// Of the peer.
    pub name: String,
    /// Number of intervals.
    pub n: usize,
    /// How many cases it converged in.
    pub converged: u64,
    /// How many it did not.
    pub failed: u64,
    /// Converged solve [us].
    pub solve_us: Figures,
    /// Its iterations.
    pub iterations: Figures,
    /// Its median over that of Scanloop.
    pub ratio_p50: f64,
    /// The same of the 99 % quantiles.
    pub ratio_p99: f64,
    /// The ratio that acados would have by the published comparison with IPOPT; for IPOPT only.
    pub ratio_acados_p50: Option<f64>,
    /// Cases in which both found the same optimum.
    pub same: u64,
    /// Largest difference of a control in those, to the peer's optimum solved to 1e-10.
    pub largest_difference: f64,
    /// The same to the controls at which the timed solve stopped.
    pub largest_difference_as_stopped: f64,
    /// Cases with different optima.
    pub others: Vec<Other>,
}

impl Versus {
    pub(super) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            cases: 0,
            converged: 0,
            solve: Distribution::of_times(),
            iterations: Distribution::of_counts(),
            same: 0,
            largest_difference: 0.0,
            largest_difference_as_stopped: 0.0,
            others: Vec::new(),
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Adds the case of a line.
    pub(super) fn add(&mut self, line: usize, answer: &Answer, ours: Option<&Solution>) {
        self.cases += 1;
        let (true, Some(us)) = (answer.converged, answer.us) else { return };
        self.converged += 1;
        self.solve.record((1000.0 * us) as u64);
        self.iterations.record(answer.iterations);
        let (Some(ours), Some(optimum)) = (ours, &answer.optimum) else { return };
        let difference = difference(ours, &optimum.controls);
        if difference < SAME {
            self.same += 1;
            self.largest_difference = self.largest_difference.max(difference);
            let stopped = self::difference(ours, &answer.controls);
            self.largest_difference_as_stopped = self.largest_difference_as_stopped.max(stopped);
        } else {
            let (objective, peer_objective) = (ours.objective, optimum.objective);
            self.others.push(Other { line, difference, objective, peer_objective });
        }
    }

    /// The comparison with the times of the default solver.
    pub(super) fn row(&self, intervals: usize, ours: &Figures) -> Row {
        let solve_us = self.solve.figures();
        let ratio = |peer: f64, ours: f64| if ours > 0.0 { peer / ours } else { 0.0 };
        let ratio_p50 = ratio(solve_us.p50, ours.p50);
        Row {
            name: self.name.clone(),
            n: intervals,
            converged: self.converged,
            failed: self.cases - self.converged,
            solve_us,
            iterations: self.iterations.figures(),
            ratio_p50,
            ratio_p99: ratio(solve_us.p99, ours.p99),
            ratio_acados_p50: (self.name == "casadi-ipopt").then_some(ratio_p50 / ACADOS),
            same: self.same,
            largest_difference: self.largest_difference,
            largest_difference_as_stopped: self.largest_difference_as_stopped,
            others: self.others.clone(),
        }
    }
}

/// Largest difference of a control; infinite where there are not the same number of them.
fn difference(ours: &Solution, controls: &[f64]) -> f64 {
    let ours = ours.trajectory.controls.iter().flat_map(|control| [control.velocity, control.steering]);
    if ours.clone().count() != controls.len() {
        return f64::INFINITY;
    }
    ours.zip(controls).map(|(mine, other)| (mine - other).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::super::peers::Optimum;
    use super::*;
    use ocp::Trajectory;
    use vehicle::Control;

    fn ours(velocity: f64) -> Solution {
        let controls = vec![Control { velocity, steering: 0.0 }];
        Solution {
            trajectory: Trajectory { states: Vec::new(), controls },
            objective: 1.0,
            ..Solution::default()
        }
    }

    fn answer(velocity: f64, us: f64) -> Answer {
        let controls = vec![velocity, 0.0];
        let optimum = Some(Optimum { controls: controls.clone(), objective: 1.5 });
        Answer {
            name: "casadi-ipopt".into(),
            converged: true,
            us: Some(us),
            iterations: 9,
            controls,
            optimum,
        }
    }

    #[test]
    fn cases_with_another_optimum_are_listed_and_not_counted_as_the_same() {
        let mut versus = Versus::new("casadi-ipopt");
        versus.add(2, &answer(0.9, 1000.0), Some(&ours(0.9)));
        versus.add(3, &answer(0.5, 3000.0), Some(&ours(0.9)));
        versus.add(4, &answer(0.9, 2000.0), None);
        versus.add(5, &Answer { converged: false, ..answer(0.9, 1.0) }, Some(&ours(0.9)));
        let row = versus.row(6, &Figures { count: 3, p50: 10.0, p99: 30.0, ..Figures::default() });
        assert_eq!((row.same, row.others.len(), row.converged, row.failed), (1, 1, 3, 1));
        assert_eq!((row.others[0].line, row.others[0].peer_objective), (3, 1.5));
        // Percentiles are exact to three digits.
        assert!((row.ratio_p50 - 200.0).abs() < 1.0 && (row.ratio_p99 - 100.0).abs() < 1.0);
        assert!((row.ratio_acados_p50.unwrap() - 200.0 / 11.4).abs() < 0.1);
    }
}
