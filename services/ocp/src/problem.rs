//! The optimal control problem of one scan, and its solution.

use std::sync::Arc;

use vehicle::{Bounds, Control, State};

use crate::model::LateralModel;
use crate::node_frame::NodeFrame;

/// An ellipse that the planned positions stay outside of, (7.34), with its predicted centre at each node.
#[derive(Debug, Clone, PartialEq)]
pub struct EllipsePath {
    /// Semi-axis along the track, a [m].
    pub a: f64,
    /// Semi-axis across the track, b, with its margin [m].
    pub b: f64,
    /// Centre at nodes 0 to N [m].
    pub centres: Vec<[f64; 2]>,
}

/// Quadratic weights, already multiplied by the interval length where the objective is an integral.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Weights of (sideslip, yaw, yaw rate, x, y) at nodes 1 to N-1.
    pub node: [f64; 5],
    /// Weights of (sideslip, yaw, yaw rate, x, y) at node N.
    pub terminal: [f64; 5],
    /// Weights of (velocity, steering) about the control reference, per interval.
    pub control: [f64; 2],
    /// Weights of the differences of (velocity, steering) between intervals, and to the control before the first.
    pub change: [f64; 2],
    /// Linear weight of each slack; large enough makes the penalty exact.
    pub slack_linear: f64,
    /// Quadratic weight of each slack.
    pub slack_quadratic: f64,
    /// Two nodes with weights of y in addition; node 0 for none.
    pub goal: [(usize, f64); 2],
}

/// Everything that defines the problem of one scan.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The vehicle.
    pub model: Arc<dyn LateralModel>,
    /// Hard bounds of the controls and soft bounds of sideslip, yaw and yaw rate, (7.41)-(7.44).
    pub bounds: Bounds,
    /// Soft bounds of the position along the track, (7.45) [m].
    pub x_range: [f64; 2],
    /// Soft bounds of the lateral position, (7.46) [m].
    pub y_range: [f64; 2],
    /// Lengths of the N intervals [s].
    pub intervals: Vec<f64>,
    /// State at node 0.
    pub initial: State,
    /// Control in effect before node 0; `None` leaves the first change free.
    pub previous: Option<Control>,
    /// Reference state at nodes 1 to N (index 0 is node 1).
    pub references: Vec<State>,
    /// Reference of the controls.
    pub control_reference: Control,
    /// Weights of the objective.
    pub weights: Weights,
    /// Ellipses, most relevant first.
    pub ellipses: Vec<EllipsePath>,
    /// The frames of nodes 1 to N, each seen from the one before; empty where all nodes have the frame of node 0.
    pub frames: Vec<NodeFrame>,
}

/// States at nodes 0 to N and controls of the intervals 0 to N-1.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    /// States at nodes 0 to N.
    pub states: Vec<State>,
    /// Controls of intervals 0 to N-1.
    pub controls: Vec<Control>,
}

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The KKT residual is within its tolerance.
    Converged,
    /// The iteration limit came first, or no step improves the iterate any more.
    MaxIterations,
    /// The time budget came first.
    OutOfTime,
    /// The input is invalid, or no step could be computed.
    Failed,
}

/// Result of a solve.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The best iterate.
    pub trajectory: Trajectory,
    /// How the solve ended.
    pub status: Status,
    /// SQP iterations.
    pub iterations: u32,
    /// Infinity norm of the scaled KKT conditions.
    pub kkt_residual: f64,
    /// Largest defect of the shooting nodes and violation of a hard bound.
    pub largest_violation: f64,
    /// Largest slack of an ellipse, in units of (7.34).
    pub slack: f64,
    /// Value of the objective with the penalty of the slacks.
    pub objective: f64,
    /// Active constraints.
    pub active_constraints: u32,
    /// Active ellipse constraints (7.34) among them.
    pub active_ellipses: u32,
}

/// A soft limit of the problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Limit {
    /// The bound of a component of the state: sideslip, yaw, yaw rate, x, y.
    State(usize),
    /// An ellipse (7.34), by its place in the problem.
    Ellipse(usize),
}

/// A limit at one node that shapes the solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActiveLimit {
    /// The node, from 1 on.
    pub node: usize,
    /// What it limits.
    pub limit: Limit,
    /// By how much the objective falls if the limit is one unit further away.
    pub multiplier: f64,
}

impl Problem {
    /// Reference of (velocity, steering) in an interval.
    #[inline]
    pub(crate) fn control_reference(&self, interval: usize) -> [f64; 2] {
        let Control { velocity, steering } = self.control_reference;
        [velocity, self.frames.get(interval).map_or(steering, |frame| steering + frame.steering)]
    }
}

impl Default for Solution {
    /// Empty, as after a solve that failed.
    fn default() -> Self {
        Self {
            trajectory: Trajectory::default(),
            status: Status::Failed,
            iterations: 0,
            kkt_residual: f64::INFINITY,
            largest_violation: f64::INFINITY,
            slack: f64::INFINITY,
            objective: f64::INFINITY,
            active_constraints: 0,
            active_ellipses: 0,
        }
    }
}

/// How long a solve may take.
pub enum Budget<'a> {
    /// Until the clock, in nanoseconds, has passed the deadline.
    Deadline {
        /// Last moment [ns].
        deadline_ns: u64,
        /// The clock.
        now_ns: &'a dyn Fn() -> u64,
    },
    /// That many SQP iterations; the same on every machine.
    Iterations(u32),
}

impl Budget<'_> {
    /// Whether another iteration may start after `iterations` of them.
    pub fn allows(&self, iterations: u32) -> bool {
        match self {
            Self::Deadline { deadline_ns, now_ns } => now_ns() < *deadline_ns,
            Self::Iterations(limit) => iterations < *limit,
        }
    }
}
