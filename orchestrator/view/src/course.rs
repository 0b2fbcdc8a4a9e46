//! The course of a run: track, goals and body, from the settings that the orchestrator wrote.

use serde_json::{Value, json};
use shared_types::GivenGoal;
use toml::Table;
use vehicle::{Course, State};

/// The goals of a run, which may change while it drives.
#[derive(Debug, Clone, Default)]
pub(crate) struct Goals {
    way: Option<Course>,
    /// Along and across the way.
    goals: Vec<Value>,
}

impl Goals {
    fn of(controller: &Table) -> Self {
        let part = |name: &str| json!(controller.get(name));
        let next = part("next_goals").as_array().cloned().unwrap_or_default();
        let way = controller.get("course").and_then(|way| way.clone().try_into::<Course>().ok());
        let goals = std::iter::once(part("goal")).chain(next).map(
            |goal| json!({ "x_m": goal["x_m"], "y_m": goal["y_m"], "tolerance_m": goal["tolerance_m"] }),
        );
        Self { way: way.filter(|way| !way.is_line()), goals: goals.collect() }
    }

    /// The goals in the plane as JSON, with others in the place of some.
    pub(crate) fn with<'g>(&self, given: impl IntoIterator<Item = &'g GivenGoal>) -> Value {
        let mut goals = self.goals.clone();
        for GivenGoal { index, x_m, y_m, tolerance_m, .. } in given {
            if let Some(goal) = goals.get_mut(*index as usize) {
                *goal = json!({ "x_m": x_m, "y_m": y_m, "tolerance_m": tolerance_m });
            }
        }
        for goal in &mut goals {
            goal["along_m"] = goal["x_m"].clone();
            if let Some(way) = &self.way {
                let [x, y] = ["x_m", "y_m"].map(|key| number(&goal[key]));
                let place = way.in_plane(&State { x, y, ..State::default() });
                (goal["x_m"], goal["y_m"]) = (json!(place.x), json!(place.y));
            }
        }
        goals.into()
    }
}

/// The course as JSON from the text of the controller's settings, and its goals; `null` where they have none of it.
pub(crate) fn course(settings: &str) -> (Value, Goals) {
    settings.parse().map_or_else(|_| (Value::Null, Goals::default()), |file: Table| of_settings(&file))
}

fn of_settings(file: &Table) -> (Value, Goals) {
    let Some(controller) = file.get("controller").and_then(toml::Value::as_table) else {
        return (Value::Null, Goals::default());
    };
    let part = |name: &str| json!(controller.get(name));
    let (track, vehicle) = (part("track"), part("vehicle"));
    let goals = Goals::of(controller);
    let mut course = json!({
        "track": { "x_m": track["x_m"], "y_m": track["y_m"], "walls": track["walls"] },
        "goals": goals.with([]),
        "body": { "length_m": vehicle["length_m"], "width_m": vehicle["width_m"] },
        "scanner": {
            "x_m": vehicle["scanner_x_m"], "y_m": vehicle["scanner_y_m"], "yaw_rad": vehicle["scanner_yaw_rad"],
        },
        "bounds": {
            "velocity_max_mps": vehicle["bounds"]["velocity_max_mps"],
            "steering_max_rad": vehicle["bounds"]["steering_max_rad"],
        },
    });
    if let Some(way) = &goals.way {
        place(way, &mut course);
    }
    course["goal"] = course["goals"].as_array().and_then(|goals| goals.last()).cloned().unwrap_or_default();
    (course, goals)
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_default()
}

/// Puts a track, which is along and across a course, into the plane: the way as lines, `way`, in place of the bounds.
/// Points of the lines are at equal distances along the course, from the first to the second of `along_m`.
fn place(way: &Course, course: &mut Value) {
    let along_m = [0, 1].map(|end| number(&course["track"]["x_m"][end]));
    let outline = way.outline(along_m);
    (course["track"]["x_m"], course["track"]["y_m"]) = (Value::Null, Value::Null);
    course["way"] = json!({
        "centre": outline.centre, "left": outline.left, "right": outline.right, "along_m": along_m,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_the_controller_name_the_course() {
        let text = "[controller.goal]\nx_m = 10.0\ny_m = 0.5\ntolerance_m = 0.1\n[controller.track]\n\
            x_m = [0.0, 22.0]\ny_m = [-1.5, 1.5]\nwalls = true\n[controller.vehicle]\nlength_m = 0.56\n\
            width_m = 0.4\n[controller.vehicle.bounds]\nsteering_max_rad = 0.06\n";
        let (course, _) = of_settings(&text.parse().unwrap());
        assert_eq!((&course["goal"]["y_m"], &course["track"]["walls"]), (&json!(0.5), &json!(true)));
        assert_eq!(course["bounds"]["steering_max_rad"], json!(0.06));
        assert_eq!(course["bounds"]["velocity_max_mps"], Value::Null);
        assert_eq!((&course["way"], of_settings(&Table::new()).0), (&Value::Null, Value::Null));
        assert!(!course.as_object().unwrap().contains_key("way"), "only with a course");
    }

    #[test]
    fn a_course_is_drawn_in_the_plane_with_its_goal() {
        let text = "[controller]\ngoal = { x_m = 3.0, y_m = 0.0, tolerance_m = 0.1 }\n\
            next_goals = [{ x_m = 9.0, y_m = 0.5, tolerance_m = 0.1 }]\n\
            track = { x_m = [-2.0, 12.0], y_m = [-1.5, 1.5], walls = false }\n\
            course = { waypoints = [{ x_m = 5.0, y_m = 0.0 }, { x_m = 5.0, y_m = 10.0 }] }\n";
        let (course, goals) = of_settings(&text.parse().unwrap());
        let close = |value: &Value, expected: f64| (value.as_f64().unwrap() - expected).abs() < 1e-9;
        assert!(
            close(&course["goal"]["x_m"], 4.5) && close(&course["goal"]["y_m"], 9.0),
            "{}",
            course["goal"]
        );
        assert!(close(&course["goals"][0]["x_m"], 5.0) && close(&course["goals"][0]["y_m"], 3.0));
        let left = &course["way"]["left"];
        assert!(close(&left[0][0], 3.5) && close(&left[0][1], -2.0), "{left}");
        assert_eq!((&course["track"]["x_m"], &course["goals"][1]["along_m"]), (&Value::Null, &json!(9.0)));
        // Another last goal, 8 m along the way.
        let given = GivenGoal { from_scan: 7, index: 1, x_m: 8.0, ..GivenGoal::default() };
        let changed = goals.with([&given]);
        assert_eq!((&changed[0], &changed[1]["along_m"]), (&course["goals"][0], &json!(8.0)));
        assert!(close(&changed[1]["x_m"], 5.0) && close(&changed[1]["y_m"], 8.0), "{changed}");
    }
}
