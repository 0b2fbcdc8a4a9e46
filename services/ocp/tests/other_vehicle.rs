//! The solver with a vehicle that is not the robot of this project.

use std::sync::Arc;

use ocp::{
    Budget, Collocation, EllipsePath, Hessian, LateralModel, LateralSlope, Problem, Scheme, Solver,
    SolverSettings, Status, Trajectory, Weights, roll_out,
};
use vehicle::{Bounds, Control, State};

/// A kinematic vehicle, whose sideslip and yaw rate follow velocity and steering angle with a lag.
#[derive(Debug)]
struct Kinematic {
    /// Distance of the axles [m].
    wheelbase_m: f64,
    /// Distance of the reference point to the rear axle as a share of the wheelbase.
    share: f64,
    /// Time constant [s].
    lag_s: f64,
}

impl LateralModel for Kinematic {
    fn is_sound(&self) -> bool {
        self.wheelbase_m > 0.0 && self.lag_s > 0.0
    }

    fn slopes(&self, [velocity, steering]: [f64; 2], states: &[[f64; 2]], slopes: &mut [LateralSlope]) {
        let Self { wheelbase_m, share, lag_s } = *self;
        for (slope, [sideslip, yaw_rate]) in slopes.iter_mut().zip(states) {
            *slope = LateralSlope {
                value: [
                    (share * steering - sideslip) / lag_s,
                    (velocity * steering / wheelbase_m - yaw_rate) / lag_s,
                ],
                by_state: [[-1.0 / lag_s, 0.0], [0.0, -1.0 / lag_s]],
                by_control: [
                    [0.0, share / lag_s],
                    [steering / wheelbase_m / lag_s, velocity / wheelbase_m / lag_s],
                ],
            };
        }
    }

    fn curvature(&self, _: [f64; 2], _: [f64; 2], weights: [f64; 2]) -> [[f64; 4]; 4] {
        let mut curvature = [[0.0; 4]; 4];
        curvature[2][3] = weights[1] / self.wheelbase_m / self.lag_s;
        curvature[3][2] = curvature[2][3];
        curvature
    }
}

/// Twelve intervals of 0.3 s past an ellipse, along the x axis at up to 1 m/s.
fn problem() -> Problem {
    let (count, interval) = (12, 0.3);
    let reference = |node: usize| State { x: interval * node as f64, ..State::default() };
    Problem {
        model: Arc::new(Kinematic { wheelbase_m: 0.5, share: 0.5, lag_s: 0.1 }),
        bounds: Bounds { steering_max_rad: 0.4, sideslip_max_rad: 0.3, ..Bounds::default() },
        x_range: [-1.0, 20.0],
        y_range: [-1.5, 1.5],
        intervals: vec![interval; count],
        initial: State::default(),
        previous: None,
        references: (1..=count).map(reference).collect(),
        control_reference: Control { velocity: 0.9, steering: 0.0 },
        weights: Weights {
            node: [0.0, 0.1, 0.0, 1.0, 1.0],
            terminal: [0.0, 0.1, 0.0, 5.0, 5.0],
            control: [0.1, 0.1],
            change: [0.1, 0.5],
            slack_linear: 100.0,
            slack_quadratic: 100.0,
            goal: [(0, 0.0); 2],
        },
        ellipses: vec![EllipsePath { a: 0.6, b: 0.4, centres: vec![[1.5, 0.05]; count + 1] }],
        frames: Vec::new(),
    }
}

#[test]
fn a_vehicle_with_another_lateral_model_is_led_around_an_ellipse() {
    let problem = problem();
    let controls = vec![Control { velocity: 0.9, steering: -0.05 }; problem.intervals.len()];
    let guess = Trajectory { states: Vec::new(), controls };
    let mut objectives = Vec::new();
    for hessian in [Hessian::GaussNewton, Hessian::Exact] {
        let mut solver = Solver::new(SolverSettings { hessian, ..SolverSettings::default() });
        let solution = solver.solve(&problem, &guess, &Budget::Iterations(60));
        assert_eq!(solution.status, Status::Converged, "{hessian:?}: {:.1e}", solution.kkt_residual);
        assert!(solution.slack < 1e-6, "{hessian:?}: {}", solution.slack);
        // It turns further than the robot of this project can.
        assert!(solution.trajectory.controls.iter().any(|control| control.steering.abs() > 0.1));
        let (collocation, Trajectory { states, controls }) =
            (Collocation::new(Scheme::default()), &solution.trajectory);
        let rolled =
            roll_out(problem.model.as_ref(), &collocation, &problem.initial, controls, &problem.intervals);
        for (planned, driven) in states.iter().zip(&rolled.unwrap().states) {
            assert!((planned.to_vector() - driven.to_vector()).amax() < 1e-9);
        }
        objectives.push(solution.objective);
    }
    assert!((objectives[0] - objectives[1]).abs() < 1e-6 * objectives[0], "{objectives:?}");
}
