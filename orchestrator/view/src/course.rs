//! What stays the same during a run: track, goal and body, from the settings that the orchestrator wrote.

use serde_json::{Value, json};
use toml::Table;

/// The course as JSON from the text of the controller's settings; `null` where they have none of it.
pub(crate) fn course(settings: &str) -> Value {
    settings.parse().map_or(Value::Null, |file: Table| of_settings(&file))
}

fn of_settings(file: &Table) -> Value {
    let Some(controller) = file.get("controller").and_then(toml::Value::as_table) else { return Value::Null };
    let part = |name: &str| json!(controller.get(name));
    let (track, goal, vehicle) = (part("track"), part("goal"), part("vehicle"));
    json!({
        "track": { "x_m": track["x_m"], "y_m": track["y_m"], "walls": track["walls"] },
        "goal": { "x_m": goal["x_m"], "y_m": goal["y_m"], "tolerance_m": goal["tolerance_m"] },
        "body": { "length_m": vehicle["length_m"], "width_m": vehicle["width_m"] },
        "scanner": {
            "x_m": vehicle["scanner_x_m"], "y_m": vehicle["scanner_y_m"], "yaw_rad": vehicle["scanner_yaw_rad"],
        },
        "bounds": {
            "velocity_max_mps": vehicle["bounds"]["velocity_max_mps"],
            "steering_max_rad": vehicle["bounds"]["steering_max_rad"],
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_the_controller_name_the_course() {
        let text = "[controller.goal]\nx_m = 10.0\ny_m = 0.5\ntolerance_m = 0.1\n[controller.track]\n\
            x_m = [0.0, 22.0]\ny_m = [-1.5, 1.5]\nwalls = true\n[controller.vehicle]\nlength_m = 0.56\n\
            width_m = 0.4\n[controller.vehicle.bounds]\nsteering_max_rad = 0.06\n";
        let course = of_settings(&text.parse().unwrap());
        assert_eq!((&course["goal"]["y_m"], &course["track"]["walls"]), (&json!(0.5), &json!(true)));
        assert_eq!(course["bounds"]["steering_max_rad"], json!(0.06));
        assert_eq!(course["bounds"]["velocity_max_mps"], Value::Null);
        assert_eq!(of_settings(&Table::new()), Value::Null);
    }
}
