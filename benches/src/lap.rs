//! A lap recorded once, so that every stage is timed on inputs it meets in a drive.
//!
//! Stages keep state from scan to scan (filter, tracks, warm start), and cost different amounts at different places
//! of a lap. So a stage always runs whole laps from their start, and the result is the mean over the scans of a lap.
//! It is no measure of the worst scan: for that see the maxima in the report of a run.

use std::time::{Duration, Instant};

use emulator::Scenario;
use pipeline::{PipelineSettings, Step, Tuning, drive};

/// All samples of one run in simulated time.
pub struct Lap {
    /// The scenario, with the default settings.
    pub settings: PipelineSettings,
    /// One element per scan.
    pub steps: Vec<Step>,
}

impl Lap {
    /// Drives a shipped scenario.
    ///
    /// # Panics
    /// When the scenario is not shipped or not allowed: both are errors of the bench.
    pub fn record(scenario: &str) -> Self {
        let text = Scenario::shipped(scenario).expect("benches drive shipped scenarios");
        let settings =
            PipelineSettings::of(Scenario::parse(text, scenario).expect("shipped scenarios are valid"));
        let mut steps = Vec::new();
        drive(&settings, |step| steps.push(*step)).expect("default settings are valid");
        Self { settings, steps }
    }

    /// Settings of the stages as they are in a run of this scenario.
    pub fn tuning(&self) -> Tuning {
        self.settings.tuning.clone().for_scenario(&self.settings.scenario)
    }

    /// Time of `iterations` scans, measured over whole laps of those scans that `counts` picks.
    ///
    /// `fresh` makes the stage before each lap and `work` does one scan with it; scans that do not count are done
    /// as well, untimed. Zero when no scan counts.
    pub fn time<T>(
        &self,
        iterations: u64,
        mut fresh: impl FnMut() -> T,
        counts: impl Fn(&Step) -> bool,
        mut work: impl FnMut(&mut T, &Step),
    ) -> Duration {
        let (mut timed, mut elapsed) = (0, Duration::ZERO);
        while timed < iterations {
            let mut stage = fresh();
            for step in &self.steps {
                let started = Instant::now();
                work(&mut stage, step);
                if counts(step) {
                    elapsed += started.elapsed();
                    timed += 1;
                }
            }
            if timed == 0 {
                return Duration::ZERO;
            }
        }
        elapsed.mul_f64(iterations as f64 / timed as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_laps_are_driven_until_enough_scans_are_timed() {
        let lap =
            Lap { settings: PipelineSettings::of(Scenario::default()), steps: vec![Step::default(); 4] };
        let mut worked = 0;
        lap.time(6, || (), |_| true, |(), _| worked += 1);
        assert_eq!(worked, 8, "six scans need two laps of four");
        assert_eq!(lap.time(6, || (), |_| false, |(), _| ()), Duration::ZERO, "no scan counts");
    }
}
