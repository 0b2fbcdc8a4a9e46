//! The vehicle of a suite. What the cases say of lengths and speeds holds for the default robot; here it is what it is for
//! another one.

use std::path::{Path, PathBuf};

use console::exit::Failure;
use emulator::Scenario;
use pipeline::PipelineSettings;
use plan::{Choice, Plan, System};
use vehicle::Description;

/// The robot of the courses follows at once, and the stages know.
const WITHOUT_LAG: [&str; 3] =
    ["vehicle.command_delay_s=0", "vehicle.velocity_lag_s=0", "vehicle.steering_lag_s=0"];

/// The vehicle of the courses, and how large they are.
#[derive(Debug, Clone, Default)]
pub(crate) struct SuiteVehicle {
    /// System file that describes it; without one it is the default robot.
    file: Option<PathBuf>,
    /// What is described.
    pub(crate) description: Description,
    /// All lengths of the courses are larger by this factor than those of the default robot.
    scale: f64,
}

impl SuiteVehicle {
    /// The vehicle of a system file, or without one the default robot, on courses that are `scale` times as large; and the
    /// system.
    ///
    /// # Errors
    /// What is wrong with the file, and a course that is too large or too small.
    pub(crate) fn read(file: Option<&Path>, scale: f64) -> anyhow::Result<(Self, System)> {
        let vehicle = Self { file: file.map(Path::to_owned), scale, ..Self::default() };
        let system = vehicle.plan(&Scenario::default())?.system;
        Ok((Self { description: system.vehicle, ..vehicle }, system))
    }

    fn plan(&self, scenario: &Scenario) -> anyhow::Result<Plan> {
        let scenario = scenario.scaled(self.scale);
        let scenario =
            scenario.map_err(|error| Failure::bad_input(format!("--scale {}: {error}", self.scale)))?;
        let overrides = WITHOUT_LAG.map(str::to_owned).to_vec();
        Plan::of(&scenario, &Choice { system: self.file.clone(), overrides, ..Choice::default() })
    }

    /// The drive of a course for the default robot, as it is for this one.
    ///
    /// # Errors
    /// A course or a file that is not allowed.
    pub(crate) fn settings(&self, scenario: &Scenario) -> anyhow::Result<PipelineSettings> {
        let mut settings = self.plan(scenario)?.simulated();
        let cruise_mps = &mut settings.tuning.controller.cruise_mps;
        *cruise_mps = cruise_mps.min(self.scale);
        Ok(settings)
    }

    /// A length of the default robot's courses [m].
    pub(crate) fn m(&self, usual_m: f64) -> f64 {
        usual_m * self.scale
    }

    /// A speed at which the default robot drives, whose largest one is 1 m/s: the same share of what this one drives on these
    /// courses [m/s].
    pub(crate) fn mps(&self, usual_mps: f64) -> f64 {
        usual_mps * self.description.bounds.velocity_max_mps.min(self.scale)
    }

    /// A speed backwards at which the default robot drives, whose largest one is 0.3 m/s, negative [m/s].
    pub(crate) fn back_mps(&self, usual_mps: f64) -> f64 {
        -usual_mps * self.description.bounds.reverse_max_mps / 0.3
    }

    /// A distance ahead of the reference point that is `gap_m` in front of the body [m].
    pub(crate) fn ahead_m(&self, gap_m: f64) -> f64 {
        self.description.length_m / 2.0 + self.description.body_x_m + gap_m
    }

    /// So many times the time in which blocked wheels stop it on these courses [ns].
    pub(crate) fn stopping_ns(&self, times: f64) -> u64 {
        (times * self.mps(1.0) / self.description.blocked_deceleration_mps2 * 1e9) as u64
    }
}

#[cfg(test)]
mod tests {
    use pipeline::Tuning;
    use vehicle::Bounds;

    use super::*;

    #[test]
    fn the_numbers_of_the_cases_are_those_of_the_default_robot() {
        let usual = SuiteVehicle::read(None, 1.0).unwrap().0;
        let close = |one: f64, other: f64| assert!((one - other).abs() < 1e-12, "{one} {other}");
        close(usual.m(3.3), 3.3);
        close(usual.mps(0.7), 0.7);
        close(usual.back_mps(0.2), -0.2);
        close(usual.ahead_m(0.0), 0.28);
        assert_eq!(usual.stopping_ns(1.5), 300_000_000);
        let tuning = usual.settings(&Scenario::default()).unwrap().tuning;
        assert_eq!(tuning, Tuning::of(Description::default().without_lag()));
        let bounds = Bounds { velocity_max_mps: 5.0, reverse_max_mps: 0.6, ..Bounds::default() };
        let description = Description { bounds, length_m: 2.0, body_x_m: 0.5, ..usual.description };
        let other = SuiteVehicle { description, scale: 2.0, file: None };
        close(other.m(3.3), 6.6);
        close(other.mps(0.7), 1.4);
        close(other.back_mps(0.2), -0.4);
        close(other.ahead_m(0.1), 1.6);
    }
}
