//! The table `[vehicle]`: one description of the robot for all stages.
//!
//! Every stage gets a copy of the table. Keys that stages had of their own before there was this table still hold for
//! that stage alone, with a warning. A key that the scenario sets for the true robot also holds for the description, and
//! so do its surroundings.

use toml::{Table, Value};
use vehicle::correction::Calibration;
use vehicle::{Description, Invalid, Key, Setting, VehicleModel, read};

/// Name of the table, in the system file and in the table of each stage.
pub(crate) const VEHICLE: &str = "vehicle";
/// The key that the scenario has in its table `[track]`; all others are in `[robot]`.
const SURROUNDINGS: &str = "surroundings";
/// The true tyres may have forces without a limit, which is 0 there; the description has none.
const FRICTION: &str = "tyre_friction";
/// The stages that know the robot.
const STAGES: [&str; 4] = ["estimator", "obstacles", "controller", "actuator"];

/// The calibration of a vehicle of another model, where its file has none.
const IDENTITY: &str = "identity";

/// The calibration that a system without one has.
pub(crate) fn usual_calibration(system: &Table) -> Calibration {
    let model = system.get(VEHICLE).and_then(|vehicle| vehicle.get("model")).cloned();
    let model = model.and_then(|model| model.try_into::<VehicleModel>().ok()).unwrap_or_default();
    if model == VehicleModel::CounterSteered { Calibration::Default } else { Calibration::Identity }
}

/// A key that a stage had of its own: where it was, where it is in the description, and the factor between the units.
pub(crate) struct OldKey {
    pub(crate) stage: &'static str,
    pub(crate) key: &'static str,
    pub(crate) place: &'static [&'static str],
    pub(crate) factor: f64,
}

const fn old(stage: &'static str, key: &'static str, place: &'static [&'static str]) -> OldKey {
    OldKey { stage, key, place, factor: 1.0 }
}

/// All renames: files are read, and rewritten by `check --migrate`, by this table.
pub(crate) const OLD_KEYS: [OldKey; 10] = [
    old("estimator", "blocked_deceleration_mps2", &["blocked_deceleration_mps2"]),
    OldKey { factor: 1e-3, ..old("estimator", "extra_latency_ms", &["command_delay_s"]) },
    old("obstacles", "body_length_m", &["length_m"]),
    old("obstacles", "body_width_m", &["width_m"]),
    old("controller", "body_length_m", &["length_m"]),
    old("controller", "body_width_m", &["width_m"]),
    old("controller", "deceleration_mps2", &["blocked_deceleration_mps2"]),
    old("controller", "parameters", &[]),
    old("controller", "bounds", &["bounds"]),
    old("actuator", "bounds", &["bounds"]),
];

/// Copies explicit keys of the true robot, and the surroundings, to keys of the description that have the same name and
/// are not set.
pub(crate) fn adopt_scenario(scenario: &Table, system: &mut Table) {
    let value = |table: &str, key: &str| scenario.get(table).and_then(|table| table.get(key));
    let entry = system.entry(VEHICLE.to_owned()).or_insert_with(|| Value::Table(Table::new()));
    let Value::Table(vehicle) = entry else { return };
    for Key { name, .. } in Description::keys() {
        let tables: &[&str] = if name == SURROUNDINGS { &["track", "course"] } else { &["robot"] };
        let is_no_limit = |value: &&Value| name == FRICTION && number(value) == Some(0.0);
        let given = tables.iter().find_map(|table| value(table, name));
        let given = given.filter(|value| !vehicle.contains_key(name) && !is_no_limit(value));
        if let Some(value) = given {
            vehicle.insert(name.to_owned(), value.clone());
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|number| number as f64))
}

/// The old keys of a stage, dotted, that set the key `name` of its description.
pub(crate) fn old_keys_of(stage: &str, name: &str) -> Vec<String> {
    let moved = |old: &OldKey| {
        let place = old.place.join(".");
        let rest = if place.is_empty() {
            Some(format!(".{name}"))
        } else {
            name.strip_prefix(&place).map(str::to_owned)
        };
        rest.filter(|rest| rest.is_empty() || rest.starts_with('.'))
            .map(|rest| format!("{stage}.{}{rest}", old.key))
    };
    OLD_KEYS.iter().filter(|old| old.stage == stage).filter_map(moved).collect()
}

/// Gives the velocities of the controller that are not set the nearest values to their defaults that `[vehicle]` allows, and a
/// vehicle of another model no calibration of the SUMMIT.
///
/// So a file that describes a slower robot needs no key of the controller.
pub(crate) fn fit_stages(system: &mut Table) {
    let Some(Value::Table(vehicle)) = system.get(VEHICLE) else { return };
    let Ok(Description { bounds, model, .. }) = read::<Description>(vehicle.clone()) else { return };
    let defaults = nmpc::ControllerConfig::default();
    if model != VehicleModel::CounterSteered {
        let entry = system.entry("actuator".to_owned()).or_insert_with(|| Value::Table(Table::new()));
        let Value::Table(actuator) = entry else { return };
        actuator.entry("calibration".to_owned()).or_insert_with(|| IDENTITY.into());
    }
    let entry = system.entry("controller".to_owned()).or_insert_with(|| Value::Table(Table::new()));
    let Value::Table(controller) = entry else { return };
    for (key, default) in [("cruise_mps", defaults.cruise_mps), ("careful_mps", defaults.careful_mps)] {
        let fitting = default.min(bounds.velocity_max_mps).max(bounds.velocity_min_mps);
        if fitting != default {
            controller.entry(key.to_owned()).or_insert(Value::Float(fitting));
        }
    }
}

/// Gives each stage its copy of the description; returns a warning for each old key.
///
/// # Errors
/// [`Invalid`] with the first key of the description that is not allowed.
pub(crate) fn distribute(system: &mut Table) -> Result<Vec<String>, Invalid> {
    let within = |invalid: Invalid| invalid.within(VEHICLE);
    let description = match system.get(VEHICLE) {
        Some(Value::Table(table)) => table.clone(),
        Some(other) => return Err(Invalid::new(VEHICLE, other, "a table")),
        None => Table::new(),
    };
    let checked: Description = read(description.clone()).map_err(within)?;
    checked.require_ranges().map_err(within)?;
    checked.bounds.require_order().map_err(|invalid| within(invalid.within("bounds")))?;
    let view = checked.scanner.require_view(checked.scanner_yaw_rad);
    view.map_err(|invalid| within(invalid.within("scanner")))?;
    let mut warnings = Vec::new();
    for stage in STAGES {
        let entry = system.entry(stage.to_owned()).or_insert_with(|| Value::Table(Table::new()));
        // The reader of the whole file refuses what is no table, with the name of the key.
        let Value::Table(table) = entry else { continue };
        let mut copy = description.clone();
        if let Some(Value::Table(own)) = table.remove(VEHICLE) {
            overlay(&mut copy, own);
        }
        for old in OLD_KEYS.iter().filter(|old| old.stage == stage) {
            let Some(value) = table.remove(old.key) else { continue };
            let place =
                std::iter::once(VEHICLE).chain(old.place.iter().copied()).collect::<Vec<_>>().join(".");
            warnings.push(format!("{stage}.{} holds for this stage only; set {place} instead", old.key));
            overlay(&mut copy, nested(old.place, scaled(value, old.factor)));
        }
        table.insert(VEHICLE.to_owned(), Value::Table(copy));
    }
    Ok(warnings)
}

/// The table that has `value` at `place`; with an empty place, `value` itself.
fn nested(place: &[&str], value: Value) -> Table {
    let wrapped = place
        .iter()
        .rev()
        .fold(value, |value, key| Value::Table(Table::from_iter([((*key).to_owned(), value)])));
    match wrapped {
        Value::Table(table) => table,
        _ => Table::new(),
    }
}

fn scaled(value: Value, factor: f64) -> Value {
    match value {
        Value::Integer(number) if factor != 1.0 => Value::Float(scale(number as f64, factor)),
        Value::Float(number) => Value::Float(scale(number, factor)),
        value => value,
    }
}

/// A number in the unit of the description.
pub(crate) fn scale(number: f64, factor: f64) -> f64 {
    number * factor
}

/// Puts all keys of `over` into `table`.
fn overlay(table: &mut Table, over: Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) => overlay(inner, over),
            (_, value) => _ = table.insert(key, value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Table {
        text.parse().unwrap()
    }

    #[test]
    fn every_stage_gets_the_whole_table() {
        let mut system = table("[vehicle]\nwidth_m = 0.5\n[vehicle.bounds]\nvelocity_max_mps = 0.8");
        assert_eq!(distribute(&mut system), Ok(Vec::new()));
        for stage in STAGES {
            assert_eq!(system[stage]["vehicle"]["width_m"].as_float(), Some(0.5));
            assert_eq!(system[stage]["vehicle"]["bounds"]["velocity_max_mps"].as_float(), Some(0.8));
        }
    }

    #[test]
    fn the_calibration_of_the_summit_is_for_its_model_alone() {
        for (text, expected) in [
            ("[vehicle]\nmodel = \"bicycle\"", Some("identity")),
            ("[vehicle]\nmodel = \"bicycle\"\n[actuator]\ncalibration = \"default\"", Some("default")),
            ("[vehicle]\nwidth_m = 0.5", None),
        ] {
            let mut system = table(text);
            fit_stages(&mut system);
            let calibration = system.get("actuator").and_then(|actuator| actuator["calibration"].as_str());
            assert_eq!(calibration, expected);
        }
    }

    #[test]
    fn an_old_key_holds_for_its_stage_alone_and_warns() {
        let mut system = table(
            "[controller]\nbody_width_m = 0.6\n[controller.parameters]\nmass_kg = 20\n[estimator]\nextra_latency_ms = 30",
        );
        let warnings = distribute(&mut system).unwrap();
        assert_eq!(system["controller"]["vehicle"]["width_m"].as_float(), Some(0.6));
        assert_eq!(system["controller"]["vehicle"]["mass_kg"].as_integer(), Some(20));
        assert_eq!(system["estimator"]["vehicle"]["command_delay_s"].as_float(), Some(0.03));
        assert!(system["obstacles"]["vehicle"].get("width_m").is_none());
        assert_eq!(warnings.len(), 3);
        assert!(warnings[1].contains("controller.body_width_m") && warnings[1].contains("vehicle.width_m"));
    }

    #[test]
    fn explicit_keys_of_the_robot_are_adopted_unless_the_description_has_them() {
        let scenario =
            table("[robot]\nwidth_m = 1.4\nlength_m = 0.9\nvelocity_factor = 1.3\npreset = \"worn\"");
        let mut system = table("[vehicle]\nlength_m = 0.6");
        adopt_scenario(&scenario, &mut system);
        let vehicle = system["vehicle"].as_table().unwrap();
        assert_eq!(vehicle["width_m"].as_float(), Some(1.4));
        assert_eq!(vehicle["length_m"].as_float(), Some(0.6));
        assert_eq!(vehicle.len(), 2);
    }

    #[test]
    fn errors_of_sensors_and_wheels_stay_with_the_emulated_robot() {
        let robot = "[robot]\ngyro_bias_radps = 0.001\ngyro_scale = 0.005\nwheel_smaller = 0.01\nslip_share = 0.3\n\
            slip_at_m = 5\nslip_length_m = 1\nsteering_backlash_rad = 0.006\npushed_left_m = 0.5\npushed_yaw_rad = 0.1";
        let mut system = Table::new();
        adopt_scenario(&table(robot), &mut system);
        assert_eq!(system["vehicle"].as_table().map(Table::len), Some(0));
    }

    #[test]
    fn tyres_without_a_limit_are_those_of_the_emulated_robot_alone() {
        for (friction, adopted) in [("0", None), ("0.0", None), ("0.4", Some(0.4))] {
            let mut system = table("");
            adopt_scenario(&table(&format!("[robot]\ntyre_friction = {friction}")), &mut system);
            assert_eq!(system["vehicle"].get("tyre_friction").and_then(Value::as_float), adopted);
        }
    }

    #[test]
    fn surroundings_of_the_track_are_adopted_unless_the_description_has_them() {
        for scenario in
            ["[track]\nsurroundings = \"open\"\nwalls = false", "[course]\nsurroundings = \"open\""]
        {
            for (system, expected) in [("", "open"), ("[vehicle]\nsurroundings = \"hall\"", "hall")] {
                let mut system = table(system);
                adopt_scenario(&table(scenario), &mut system);
                let vehicle = system["vehicle"].as_table().unwrap();
                assert_eq!((vehicle["surroundings"].as_str(), vehicle.len()), (Some(expected), 1));
            }
        }
    }

    #[test]
    fn a_wrong_key_of_the_description_is_named_there() {
        let message = |text: &str| distribute(&mut table(text)).unwrap_err().to_string();
        assert_eq!(message("[vehicle]\nwidth_m = 9"), "vehicle.width_m = 9 is not allowed: 0.1 to 3");
        assert!(
            message("[vehicle]\nwidht_m = 0.4")
                .starts_with("vehicle.widht_m = 0.4 is not allowed: the key is unknown")
        );
    }
}
