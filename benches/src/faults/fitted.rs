//! A fault as it is for another vehicle.

use emulator::scenario::{Scanner, scale_lengths};
use faults::{InjectedFault, Injection, SampleAction};
use toml::{Table, Value};
use vehicle::Description;

/// What a fault of the default vehicle is for another one, on a course whose lengths are `scale` times as large: angles and speeds
/// grow with its bounds, lags with its own. What needs way to show may take as much longer as the vehicle does for the course.
pub(super) fn fitted(fault: &InjectedFault, vehicle: &Description, scale: f64) -> InjectedFault {
    let (mut fault, usual) = (fault.clone(), Description::default());
    let angle = vehicle.bounds.steering_max_rad / usual.bounds.steering_max_rad;
    let speed = vehicle.bounds.velocity_max_mps / usual.bounds.velocity_max_mps;
    let longer = (scale / speed).max(1.0);
    let of_phases = fault.in_phase.values_mut();
    let times = of_phases.flat_map(|of| of.within_ms.iter_mut().chain(of.detectable_ms.iter_mut()));
    times.chain([&mut fault.expect.within_ms, &mut fault.expect.detectable_ms]).for_each(|ms| *ms *= longer);
    match &mut fault.inject {
        Injection::Sample(sample) if matches!(sample.action, SampleAction::Set | SampleAction::Add) => {
            let is_of = |end: &str| sample.fields.iter().any(|field| field.ends_with(end));
            let by_speed = if is_of("_mps") { speed } else { 1.0 };
            sample.value *= if is_of("steering_rad") { angle } else { by_speed };
        }
        Injection::Scenario(scenario) => {
            scale_lengths(&mut scenario.set, scale);
            if is_black(&scenario.set) && vehicle.sudden_m != usual.sudden_m {
                // It shows in time for a robot of this way to stop.
                let black_range_m = Scanner::default().black_range_m * vehicle.sudden_m / usual.sudden_m;
                let scanner = Value::Table(
                    [("black_range_m".to_owned(), Value::Float(black_range_m))].into_iter().collect(),
                );
                scenario.set.insert("scanner".to_owned(), scanner);
            }
            let robot = scenario.set.get_mut("robot").and_then(Value::as_table_mut);
            for (key, value) in robot.into_iter().flatten() {
                let factor = match key.as_str() {
                    "steering_offset_rad" => angle,
                    "steering_lag_s" => (vehicle.steering_lag_s / usual.steering_lag_s).max(1.0),
                    "velocity_lag_s" => (vehicle.velocity_lag_s / usual.velocity_lag_s).max(1.0),
                    _ => continue,
                };
                *value = Value::Float(value.as_float().unwrap_or(0.0) * factor);
            }
        }
        _ => {}
    }
    fault
}

/// Whether an obstacle of these tables of a scenario is black.
fn is_black(set: &Table) -> bool {
    let obstacles = set.get("obstacle").and_then(Value::as_array);
    obstacles.is_some_and(|all| all.iter().any(|one| one.get("black").and_then(Value::as_bool) == Some(true)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(name: &str) -> InjectedFault {
        faults::all().unwrap().into_iter().find(|fault| fault.name == name).unwrap()
    }

    #[test]
    fn angles_speeds_lengths_and_times_are_those_of_the_vehicle() {
        let usual = Description::default();
        for name in ["command-too-sharp", "scanner-black-obstacle", "steering-slow"] {
            assert_eq!(fitted(&fault(name), &usual, 1.0), fault(name));
        }
        let mut slow = usual;
        (slow.bounds.velocity_max_mps, slow.bounds.steering_max_rad) =
            (0.5, 2.0 * usual.bounds.steering_max_rad);
        slow.steering_lag_s = 4.0 * usual.steering_lag_s;
        let value = |name: &str| match fitted(&fault(name), &slow, 2.0).inject {
            Injection::Sample(sample) => sample.value,
            _ => f64::NAN,
        };
        assert_eq!([value("command-too-sharp"), value("command-too-fast")], [1.0, 2.5]);
        // A factor is one for each vehicle, and so is a place.
        assert_eq!([value("odometry-speed-double"), value("odometry-jump-x")], [2.0, 1.0]);
        let set = |name: &str| match fitted(&fault(name), &slow, 2.0).inject {
            Injection::Scenario(scenario) => scenario.set,
            _ => toml::Table::default(),
        };
        assert_eq!(set("scanner-black-obstacle")["obstacle"][0]["x_m"].as_float(), Some(8.0));
        assert_eq!(set("steering-slow")["robot"]["steering_lag_s"].as_float(), Some(2.0));
        // Twice the way at half the speed.
        let (there, here) = (fitted(&fault("steering-slow"), &slow, 2.0), fault("steering-slow"));
        assert_eq!(there.expect.within_ms, 4.0 * here.expect.within_ms);
    }
}
