//! The solver against CasADi with IPOPT, on instances that `benches/peers/casadi_reference.py` has written.
//!
//! The oracle has its own transcription of the same program and the exact Hessian; both start from the same controls.

use std::sync::Arc;

use ocp::{
    Budget, EllipsePath, Hessian, Problem, QpChoice, Solver, SolverSettings, Status, Trajectory, Weights,
};
use serde_json::Value;
use vehicle::{Bounds, Control, Parameters, State};

const REFERENCE: &str = include_str!("data/casadi_reference.json");

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list = value.as_array().expect("a list");
    assert_eq!(list.len(), N);
    std::array::from_fn(|index| list[index].as_f64().expect("a number"))
}

fn state(value: &Value) -> State {
    State::from_vector(&numbers::<5>(value).into())
}

fn control(value: &Value) -> Control {
    let [velocity, steering] = numbers(value);
    Control { velocity, steering }
}

fn list<T>(value: &Value, read: impl Fn(&Value) -> T) -> Vec<T> {
    value.as_array().expect("a list").iter().map(read).collect()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().expect("a number")
}

fn problem(instance: &Value, interval: f64) -> Problem {
    let references = list(&instance["references"], state);
    let count = references.len();
    let weights = &instance["weights"];
    Problem {
        model: Arc::new(Parameters::default()),
        bounds: Bounds::default(),
        x_range: numbers(&instance["x_range_m"]),
        y_range: numbers(&instance["y_range_m"]),
        intervals: vec![interval; count],
        initial: state(&instance["initial"]),
        previous: (!instance["previous"].is_null()).then(|| control(&instance["previous"])),
        references,
        control_reference: control(&instance["control_reference"]),
        weights: Weights {
            node: numbers(&weights["node"]),
            terminal: numbers(&weights["terminal"]),
            control: numbers(&weights["control"]),
            change: numbers(&weights["change"]),
            slack_linear: number(weights, "slack_linear"),
            slack_quadratic: number(weights, "slack_quadratic"),
            goal: [(0, 0.0); 2],
        },
        frames: Vec::new(),
        ellipses: list(&instance["ellipses"], |ellipse| EllipsePath {
            a: number(ellipse, "a_m"),
            b: number(ellipse, "b_m"),
            centres: vec![[number(ellipse, "x_m"), number(ellipse, "y_m")]; count + 1],
        }),
    }
}

fn compare(settings: SolverSettings) {
    /// The pure Gauss-Newton method and BFGS creep where an ellipse presses.
    const ITERATIONS: u32 = 300;
    let document: Value = serde_json::from_str(REFERENCE).expect("valid JSON");
    let instances = document["instances"].as_array().expect("a list");
    assert!(instances.len() >= 20);
    let mut solver = Solver::new(SolverSettings { max_iterations: ITERATIONS, ..settings });
    for instance in instances {
        let name = instance["name"].as_str().expect("a name");
        let problem = problem(instance, number(&document, "interval_s"));
        let guess = Trajectory { states: Vec::new(), controls: list(&instance["guess_controls"], control) };
        let solution = solver.solve(&problem, &guess, &Budget::Iterations(ITERATIONS));
        assert_eq!(solution.status, Status::Converged, "{name}: {:.1e}", solution.kkt_residual);
        let expected = &instance["solution"];
        let objective = number(expected, "objective");
        println!(
            "{name}: {} iterations, objective {:.9} {objective:.9}",
            solution.iterations, solution.objective
        );
        for (index, (mine, other)) in
            solution.trajectory.controls.iter().zip(list(&expected["controls"], control)).enumerate()
        {
            // Both stop at 1e-7 or better of the gradient; the flattest curvature of these problems is about 0.01.
            let error = (mine.velocity - other.velocity).abs().max((mine.steering - other.steering).abs());
            assert!(error < 1e-5, "{name}: control {index}: {mine:?} {other:?}");
        }
        for (mine, other) in solution.trajectory.states[1..].iter().zip(list(&expected["states"], state)) {
            assert!((mine.to_vector() - other.to_vector()).amax() < 1e-5, "{name}");
        }
        // A limit may be exceeded by the tolerance, which the penalty multiplies.
        let allowed = 1e-6 * (1.0 + objective) + 2.0 * settings.tolerance * problem.weights.slack_linear;
        assert!(
            (solution.objective - objective).abs() < allowed,
            "{name}: {} {objective}",
            solution.objective
        );
        let slack = number(expected, "slack");
        assert!((solution.slack - slack).abs() < 1e-5, "{name}: {} {slack}", solution.slack);
    }
}

#[test]
fn the_active_set_finds_the_solutions_of_ipopt() {
    compare(SolverSettings { tolerance: 1e-8, ..SolverSettings::default() });
}

#[test]
fn clarabel_finds_the_solutions_of_ipopt() {
    // The interior point leaves 1e-9 of the objective.
    compare(SolverSettings { qp: QpChoice::Clarabel, tolerance: 1e-7, ..SolverSettings::default() });
}

#[test]
fn bfgs_finds_the_solutions_of_ipopt() {
    let settings = SolverSettings { hessian: Hessian::Bfgs, tolerance: 1e-8, ..SolverSettings::default() };
    compare(settings);
    compare(SolverSettings { refine: false, ..settings });
}

#[test]
fn the_exact_hessian_finds_the_solutions_of_ipopt() {
    let settings = SolverSettings { hessian: Hessian::Exact, tolerance: 1e-8, ..SolverSettings::default() };
    compare(settings);
    compare(SolverSettings { refine: false, ..settings });
}

#[test]
fn gauss_newton_without_refinement_finds_the_solutions_of_ipopt() {
    compare(SolverSettings { refine: false, tolerance: 1e-8, ..SolverSettings::default() });
}
