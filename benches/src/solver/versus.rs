//! The comparison of one peer with the solver in its default settings, case by case.
//!
//! Two solvers that found the same optimum agree in their controls. Where they do not, both may be right, because an
//! obstacle can be passed on either side. Those cases are listed with both objectives.

use figures::{Distribution, Figures};
use ocp::Solution;
use serde::Serialize;

use super::contender::ContenderRow;
use super::peers::PeerResult;

/// Largest difference of a control (velocity [m/s], steering [rad]) of the same optimum with six intervals: both solvers
/// stop at a gradient of about 1e-6, and the smallest curvature is the control weight, of order one. It is shared by more
/// intervals where there are more.
pub(super) const SAME_OPTIMUM: f64 = 1e-5;

/// The comparison with a peer so far.
#[derive(Debug, Clone)]
pub(super) struct Versus {
    solve: Distribution,
    step: Distribution,
    feedback: Distribution,
    iterations: Distribution,
    /// Without figures and ratios.
    row: PeerRow,
}

/// A case in which the two solvers found different optima.
#[derive(Debug, Clone, Serialize)]
pub(super) struct OtherOptimum {
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
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct PeerRow {
    /// Name of the peer.
    pub name: String,
    /// Number of intervals.
    pub n: usize,
    /// Number of cases in which it converged.
    pub converged: u64,
    /// Number of cases in which it did not.
    pub failed: u64,
    /// Time of a converged solve, and of a single step and its feedback where it makes only those [us].
    pub solve_us: Figures,
    /// See `solve_us`.
    pub step_us: Figures,
    /// See `solve_us`.
    pub feedback_us: Figures,
    /// Iterations of a converged solve.
    pub iterations: Figures,
    /// Ratio of its median time of a solve to that of Scanloop; 0 where it makes only steps.
    pub ratio_p50: f64,
    /// The same of the 99 % quantiles.
    pub ratio_p99: f64,
    /// Ratios of its times to those of Scanloop: of a solve, a step and a feedback; medians, then 99 % quantiles; 0 where
    /// it has none.
    pub ratios: [[f64; 2]; 3],
    /// Cases in which both found the same optimum.
    pub same: u64,
    /// Largest difference of a control in those, to the peer's optimum solved to 1e-10.
    pub largest_difference: f64,
    /// The same to the controls at which the timed solve stopped.
    pub largest_difference_as_stopped: f64,
    /// Cases with different optima.
    pub others: Vec<OtherOptimum>,
}

impl Versus {
    pub(super) fn new(name: &str) -> Self {
        Self {
            solve: Distribution::of_times(),
            step: Distribution::of_times(),
            feedback: Distribution::of_times(),
            iterations: Distribution::of_counts(),
            row: PeerRow { name: name.to_owned(), ..PeerRow::default() },
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.row.name
    }

    /// Adds the case of a line.
    pub(super) fn add(&mut self, line: usize, peer: &PeerResult, ours: Option<&Solution>) {
        let row = &mut self.row;
        if !peer.converged {
            row.failed += 1;
            return;
        }
        row.converged += 1;
        for (times, us) in [
            (&mut self.solve, peer.us),
            (&mut self.step, peer.step_us),
            (&mut self.feedback, peer.feedback_us),
        ] {
            us.into_iter().for_each(|us| times.record((1000.0 * us) as u64));
        }
        self.iterations.record(peer.iterations);
        let (Some(ours), Some(optimum)) = (ours, &peer.optimum) else { return };
        let difference = difference(ours, &optimum.controls);
        if difference < SAME_OPTIMUM * (ours.trajectory.controls.len() as f64 / 6.0).max(1.0) {
            row.same += 1;
            row.largest_difference = row.largest_difference.max(difference);
            let stopped = self::difference(ours, &peer.controls);
            row.largest_difference_as_stopped = row.largest_difference_as_stopped.max(stopped);
        } else {
            let (objective, peer_objective) = (ours.objective, optimum.objective);
            row.others.push(OtherOptimum { line, difference, objective, peer_objective });
        }
    }

    /// The comparison with the times of the default solver.
    pub(super) fn row(&self, ours: &ContenderRow) -> PeerRow {
        let [solve_us, step_us, feedback_us] =
            [&self.solve, &self.step, &self.feedback].map(Distribution::figures);
        let ratio = |peer: f64, ours: f64| if ours > 0.0 { peer / ours } else { 0.0 };
        let ratios =
            [(&solve_us, &ours.solve_us), (&step_us, &ours.step_us), (&feedback_us, &ours.feedback_us)]
                .map(|(peer, ours)| [ratio(peer.p50, ours.p50), ratio(peer.p99, ours.p99)]);
        let iterations = self.iterations.figures();
        let [[ratio_p50, ratio_p99], ..] = ratios;
        PeerRow {
            n: ours.n,
            solve_us,
            step_us,
            feedback_us,
            iterations,
            ratio_p50,
            ratio_p99,
            ratios,
            ..self.row.clone()
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

    fn peer(velocity: f64, us: f64) -> PeerResult {
        let controls = vec![velocity, 0.0];
        let optimum = Some(Optimum { controls: controls.clone(), objective: 1.5 });
        PeerResult {
            name: "casadi-ipopt".into(),
            converged: true,
            us: Some(us),
            step_us: None,
            feedback_us: None,
            iterations: 9,
            controls,
            optimum,
        }
    }

    #[test]
    fn cases_with_another_optimum_are_listed_and_not_counted_as_the_same() {
        let mut versus = Versus::new("casadi-ipopt");
        versus.add(2, &peer(0.9, 1000.0), Some(&ours(0.9)));
        versus.add(3, &peer(0.5, 3000.0), Some(&ours(0.9)));
        versus.add(4, &peer(0.9, 2000.0), None);
        versus.add(5, &PeerResult { converged: false, ..peer(0.9, 1.0) }, Some(&ours(0.9)));
        let solve_us = Figures { count: 3, p50: 10.0, p99: 30.0, ..Figures::default() };
        let row = versus.row(&ContenderRow { solve_us, ..ContenderRow::default() });
        assert_eq!((row.same, row.others.len(), row.converged, row.failed), (1, 1, 3, 1));
        assert_eq!((row.others[0].line, row.others[0].peer_objective), (3, 1.5));
        // Percentiles are exact to three digits.
        assert!((row.ratios[0][0] - 200.0).abs() < 1.0 && (row.ratios[0][1] - 100.0).abs() < 1.0);
        assert_eq!(row.ratios[1], [0.0; 2]);
    }

    #[test]
    fn a_peer_that_only_makes_a_step_is_compared_in_steps_and_feedback() {
        let mut versus = Versus::new("acados-rti");
        let step = PeerResult {
            us: None,
            step_us: Some(80.0),
            feedback_us: Some(30.0),
            optimum: None,
            ..peer(0.9, 0.0)
        };
        versus.add(2, &step, Some(&ours(0.5)));
        let of = |p50| Figures { count: 1, p50, p99: p50, ..Figures::default() };
        let ours = ContenderRow { step_us: of(16.0), feedback_us: of(1.0), ..ContenderRow::default() };
        let row = versus.row(&ours);
        assert_eq!((row.converged, row.same, row.others.len(), row.solve_us.count), (1, 0, 0, 0));
        assert!((row.ratios[1][0] - 5.0).abs() < 0.01 && (row.ratios[2][1] - 30.0).abs() < 0.1);
    }
}
