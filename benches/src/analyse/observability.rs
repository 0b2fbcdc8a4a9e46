//! `scanloop analyse observability`: the rank of the observability matrix, and which states it leaves open.

use std::fmt::Write as _;

use console::exit::Exit;
use estimator::Measured;
use estimator::observability::{STATES, motion_jacobian, observability_matrix, rank};
use report::picture::chart::{Chart, Curve};
use serde::Serialize;
use vehicle::model::steady_turn;
use vehicle::{Bounds, Control, Invalid, Parameters, State, require};

use super::{ObservabilityArguments, publish, refuse};

/// Time between two measurements: one scan period [s].
const PERIOD_S: f64 = 0.1;

const ALL: [Measured; STATES] = [Measured::Yaw, Measured::X, Measured::Y];

const DEFINITION: &str = "rank of (H; H A; H A^2), (7.2), for the state (yaw, x, y): A moves it by one scan period \
    of 100 ms in a steady turn, H picks what is measured; singular values above 1e-9 of the largest count";

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct ObservabilityResult {
    rank: usize,
    states: usize,
    observable: bool,
    measured: Vec<&'static str>,
    open: Vec<&'static str>,
    reason: String,
    moving: bool,
    velocity_mps: f64,
    steering_rad: f64,
    singular_values: Vec<f64>,
    definition: &'static str,
}

pub(super) fn analyse(arguments: &ObservabilityArguments) -> anyhow::Result<Exit> {
    let bounds = Bounds::default();
    let velocities = bounds.velocity_min_mps..=bounds.velocity_max_mps;
    require("velocity", arguments.velocity, velocities).map_err(refuse)?;
    require("steering", arguments.steering, -bounds.steering_max_rad..=bounds.steering_max_rad)
        .map_err(refuse)?;
    let measured = &arguments.measure;
    if measured.iter().enumerate().any(|(index, state)| measured[..index].contains(state)) {
        let names: Vec<_> = measured.iter().map(|state| state.name()).collect();
        return Err(refuse(Invalid::new("measure", names.join(","), "each of yaw, x, y at most once")));
    }
    let result = result(arguments);
    let (table, chart) = (table(&result), chart(&result, measured));
    publish(&arguments.output, "observability", &table, &chart, &result, result.observable)
}

/// The displacement in one period, in the frame of the robot at its start [m].
fn displacement(velocity: f64, steering: f64) -> [f64; 2] {
    let (parameters, control) = (Parameters::default(), Control { velocity, steering });
    let (sideslip, yaw_rate) = steady_turn(&parameters, &control);
    let start = State { sideslip, yaw_rate, ..State::default() };
    let end = vehicle::integrate::integrate(&parameters, &start, &control, PERIOD_S);
    [end.x, end.y]
}

/// Singular values of (7.2), the largest first.
fn singular_values(measured: &[Measured], [x, y]: [f64; 2]) -> Vec<f64> {
    let matrix = observability_matrix(measured, &motion_jacobian(x, y));
    let mut values: Vec<f64> = matrix.singular_values().iter().copied().collect();
    values.sort_by(|left, right| right.total_cmp(left));
    values
}

fn result(arguments: &ObservabilityArguments) -> ObservabilityResult {
    let measured = &arguments.measure;
    let moving = !arguments.standing;
    let velocity_mps = if moving { arguments.velocity } else { 0.0 };
    let displacement = if moving { displacement(arguments.velocity, arguments.steering) } else { [0.0; 2] };
    let matrix = observability_matrix(measured, &motion_jacobian(displacement[0], displacement[1]));
    let found = rank(&matrix);
    // A state is determined when measuring it would not raise the rank.
    let open: Vec<Measured> = ALL
        .into_iter()
        .filter(|state| {
            let mut more = matrix;
            more[(state.index(), state.index())] = 1.0;
            rank(&more) > found
        })
        .collect();
    ObservabilityResult {
        rank: found,
        states: STATES,
        observable: found == STATES,
        measured: measured.iter().map(|state| state.name()).collect(),
        reason: reason(&open, moving),
        open: open.iter().map(|state| state.name()).collect(),
        moving,
        velocity_mps,
        steering_rad: arguments.steering,
        singular_values: singular_values(measured, displacement),
        definition: DEFINITION,
    }
}

fn reason(open: &[Measured], moving: bool) -> String {
    let why = |state: &Measured| match state {
        Measured::Yaw if moving => "yaw is open: this way driven does not show it in what is measured",
        Measured::Yaw => "yaw is open: only a robot that moves shows it in its position",
        Measured::X => "x is open: nothing measured depends on it",
        Measured::Y => "y is open: nothing measured depends on it",
    };
    match open {
        [] => "yaw, x and y are determined".to_owned(),
        open => open.iter().map(why).collect::<Vec<_>>().join("; "),
    }
}

fn table(result: &ObservabilityResult) -> String {
    let mut text = format!("measured        {}\n", result.measured.join(", "));
    let motion = if result.moving {
        format!("moving, {} m/s, {:+} rad", result.velocity_mps, result.steering_rad)
    } else {
        "standing".to_owned()
    };
    let _ = writeln!(text, "motion          {motion}");
    let values: Vec<String> = result.singular_values.iter().map(|value| format!("{value:.4}")).collect();
    let _ = writeln!(text, "singular values {}", values.join("  "));
    let verdict = if result.observable { "observable" } else { "not observable" };
    let _ = writeln!(text, "result          rank {} of {STATES}: {verdict}; {}", result.rank, result.reason);
    let _ = writeln!(text, "definition      {DEFINITION}");
    text
}

fn chart(result: &ObservabilityResult, measured: &[Measured]) -> Chart {
    /// Points of a curve.
    const POINTS: usize = 60;
    let lowest = Bounds::default().velocity_min_mps;
    let highest = Bounds::default().velocity_max_mps;
    let curve = |index: usize| {
        let point = |step: usize| {
            let velocity = lowest + (highest - lowest) * step as f64 / POINTS as f64;
            [velocity, singular_values(measured, displacement(velocity, result.steering_rad))[index]]
        };
        let name = ["largest singular value", "second singular value", "third singular value"][index];
        // Values that are zero up to rounding are not drawn.
        let points = (0..=POINTS).map(point).filter(|point| point[1] > 1e-9).collect();
        Curve { name: name.to_owned(), points, dots: false }
    };
    let smallest = result.singular_values.iter().rev().find(|value| **value > 1e-9);
    Chart {
        title: format!("Observability of ({}): rank {} of {STATES}", result.measured.join(", "), result.rank),
        subtitle: result.reason.clone(),
        x: "velocity [m/s]".to_owned(),
        y: "singular values of (H; H A; H A^2)".to_owned(),
        logarithmic: true,
        curves: (0..STATES).map(curve).filter(|curve| !curve.points.is_empty()).collect(),
        mark: smallest
            .map(|value| ("smallest that counts, as asked".to_owned(), [result.velocity_mps, *value])),
        ..Chart::default()
    }
}
