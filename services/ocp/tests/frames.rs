//! A problem whose nodes have frames of their own is the same problem.

mod problems;

use ocp::{Budget, EllipsePath, Hessian, NodeFrame, Problem, QpChoice, Solver, SolverSettings, Status};
use problems::{cold_guess, ellipse, loop_weights, problem};
use proptest::prelude::*;
use vehicle::frame::to_track;
use vehicle::{Control, State};

/// A state of the frame before in the frame behind a frame, written down from its definition.
fn seen(frame: &NodeFrame, state: &State) -> State {
    let offset = to_track(-frame.angle, state.x - frame.from[0], state.y - frame.from[1]);
    State { yaw: state.yaw - frame.angle, x: frame.to[0] + offset.x, y: frame.to[1] + offset.y, ..*state }
}

/// The problem with the frames of its nodes turned by `nodes`.
fn in_frames(problem: &Problem, nodes: &[NodeFrame]) -> Problem {
    let mut turned = problem.clone();
    turned.frames = nodes.to_vec();
    for node in 1..=nodes.len() {
        for frame in &nodes[..node] {
            let reference = &mut turned.references[node - 1];
            *reference = seen(frame, reference);
            for ellipse in &mut turned.ellipses {
                let [x, y] = ellipse.centres[node];
                let centre = seen(frame, &State { x, y, ..State::default() });
                ellipse.centres[node] = [centre.x, centre.y];
            }
        }
    }
    turned
}

/// Around a post: weights and ellipse are the same in all directions, and no bound of the position is near.
fn round_problem(y: f64) -> Problem {
    let mut weights = loop_weights();
    for row in [&mut weights.node, &mut weights.terminal] {
        row[4] = row[3];
    }
    weights.goal = [(0, 0.0); 2];
    let post = EllipsePath { b: 0.8, ..ellipse(3.4, y, 0.8, 0.8) };
    let mut problem = problem(State { x: 1.0, ..State::default() }, 10.0, weights, vec![post]);
    (problem.x_range, problem.y_range) = ([-100.0, 100.0], [-100.0, 100.0]);
    problem.bounds.yaw_max_rad = 100.0;
    problem
}

proptest! {
    #[test]
    fn the_controls_are_those_of_one_frame(
        y in prop_oneof![-0.5..-0.1f64, 0.1..0.5f64],
        turns in prop::collection::vec((-0.6..0.6f64, -1.0..3.0f64, -1.0..1.0f64, -5.0..5.0f64), 6),
        exact in any::<bool>(),
    ) {
        let one = round_problem(y);
        let frame = |(angle, x, y, to): (f64, f64, f64, f64)| NodeFrame { from: [x, y], to: [to, -y], angle, steering: 0.0, y_range: [-100.0, 100.0] };
        let frames: Vec<NodeFrame> = turns.into_iter().map(frame).collect();
        let many = in_frames(&one, &frames);
        for qp in [QpChoice::default(), QpChoice::Clarabel] {
            let hessian = if exact { Hessian::Exact } else { Hessian::GaussNewton };
            let mut solver = Solver::new(SolverSettings { hessian, qp, ..SolverSettings::default() });
            let guess = cold_guess(&one);
            let guess = ocp::Trajectory { states: Vec::new(), ..guess };
            let [expected, found] = [&one, &many].map(|problem| solver.solve(problem, &guess, &Budget::Iterations(60)));
            prop_assert_eq!(expected.status, Status::Converged);
            prop_assert_eq!(found.status, Status::Converged);
            for (a, b) in expected.trajectory.controls.iter().zip(&found.trajectory.controls) {
                prop_assert!((a.velocity - b.velocity).abs() < 1e-4, "{} {}", a.velocity, b.velocity);
                prop_assert!((a.steering - b.steering).abs() < 1e-5, "{} {}", a.steering, b.steering);
            }
            prop_assert!((expected.objective - found.objective).abs() < 1e-6 * expected.objective);
            let mut end = expected.trajectory.states[6];
            frames.iter().for_each(|frame| end = seen(frame, &end));
            let state = found.trajectory.states[6];
            prop_assert!((end.x - state.x).hypot(end.y - state.y) < 1e-3 && (end.yaw - state.yaw).abs() < 1e-3);
        }
    }
}

#[test]
fn a_steering_that_keeps_along_the_way_costs_nothing() {
    let mut problem = round_problem(50.0);
    problem.previous = None;
    problem.weights.control[1] = 1e4;
    let steer = |steering: f64| NodeFrame {
        from: [0.0; 2],
        to: [0.0; 2],
        angle: 0.0,
        steering,
        y_range: [-100.0, 100.0],
    };
    problem.frames = [0.01, 0.02, 0.03, 0.03, 0.02, 0.01].map(steer).to_vec();
    let guess =
        ocp::Trajectory { states: Vec::new(), controls: vec![Control { velocity: 0.9, steering: 0.0 }; 6] };
    let solution = Solver::new(SolverSettings::default()).solve(&problem, &guess, &Budget::Iterations(60));
    assert_eq!(solution.status, Status::Converged);
    for (control, frame) in solution.trajectory.controls.iter().zip(&problem.frames) {
        assert!((control.steering - frame.steering).abs() < 3e-3, "{control:?} {frame:?}");
    }
    problem.frames.pop();
    let refused = Solver::new(SolverSettings::default()).solve(&problem, &guess, &Budget::Iterations(60));
    assert_eq!(refused.status, Status::Failed, "one for each interval");
}

#[test]
fn a_node_keeps_the_bounds_of_its_own_frame() {
    let mut problem = problem(State::default(), 10.0, loop_weights(), Vec::new());
    (problem.y_range, problem.weights.goal) = ([-1.5, 1.5], [(0, 0.0); 2]);
    problem.references.iter_mut().for_each(|reference| reference.y = 1.0);
    let count = problem.intervals.len();
    let frame = |node: usize| NodeFrame {
        from: [0.0; 2],
        to: [0.0; 2],
        angle: 0.0,
        steering: 0.0,
        y_range: if node > count / 2 { [-0.05, 0.05] } else { [-1.5, 1.5] },
    };
    let guess = cold_guess(&problem);
    let across = |problem: &Problem| {
        let solution =
            Solver::new(SolverSettings::default()).solve(problem, &guess, &Budget::Iterations(200));
        assert_eq!(solution.status, Status::Converged);
        solution.trajectory.states.iter().map(|state| state.y).collect::<Vec<_>>()
    };
    assert!(across(&problem)[count / 2 + 1] > 0.06, "without them it is beyond them");
    problem.frames = (1..=count).map(frame).collect();
    let kept = across(&problem);
    assert!(kept[count / 2 + 1..].iter().all(|y| y.abs() < 0.05 + 1e-3), "{kept:?}");
}
