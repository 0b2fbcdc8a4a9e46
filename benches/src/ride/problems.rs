//! The problems of an optimum as files, so that another solver can check them.

use console::out_folder::OutFolder;
use ocp::{Problem, Trajectory};
use serde_json::{Value, json};
use vehicle::{Control, State};

use crate::optimum::{Optimum, Plan};

/// Writes the problems of an optimum with their solutions to `NAME.json`.
///
/// # Errors
/// Errors of the file system.
pub(super) fn write(folder: &OutFolder, name: &str, optimum: &Optimum) -> anyhow::Result<()> {
    let plans: Vec<Value> = optimum.plans.iter().map(plan).collect();
    let text = serde_json::to_string_pretty(&json!({ "name": name, "plans": plans }))?;
    folder.write(&format!("{name}.json"), text.as_bytes()).map(drop)
}

fn plan(Plan { problem, trajectory, objective, .. }: &Plan) -> Value {
    let Problem { bounds, weights, .. } = problem;
    let ellipses = problem.ellipses.iter();
    let ellipses: Vec<Value> = ellipses
        .map(|ellipse| json!({ "a_m": ellipse.a, "b_m": ellipse.b, "centres_m": ellipse.centres }))
        .collect();
    let Trajectory { states, controls } = trajectory;
    json!({
        "intervals_s": problem.intervals,
        "initial": of_state(&problem.initial),
        "previous": problem.previous.as_ref().map(of_control),
        "references": problem.references.iter().map(of_state).collect::<Vec<_>>(),
        "control_reference": of_control(&problem.control_reference),
        "weights": {
            "node": weights.node, "terminal": weights.terminal,
            "control": weights.control, "change": weights.change,
        },
        "velocity_mps": [bounds.velocity_min_mps, bounds.velocity_max_mps],
        "steering_max_rad": bounds.steering_max_rad,
        "sideslip_max_rad": bounds.sideslip_max_rad,
        "yaw_max_rad": bounds.yaw_max_rad,
        "yaw_rate_max_radps": bounds.yaw_rate_max_radps,
        "x_m": problem.x_range,
        "y_m": problem.y_range,
        "ellipses": ellipses,
        "states": states.iter().map(of_state).collect::<Vec<_>>(),
        "controls": controls.iter().map(of_control).collect::<Vec<_>>(),
        "objective": objective,
    })
}

fn of_state(state: &State) -> [f64; 5] {
    state.to_vector().into()
}

fn of_control(control: &Control) -> [f64; 2] {
    [control.velocity, control.steering]
}
