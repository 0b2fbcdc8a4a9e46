//! Drives the courses of a condition and reads the figures from the true robot.

use std::ops::Range;

use emulator::{Outcome, Scenario};
use pipeline::{Pipeline, PipelineSettings, Step};
use plan::Plan;
use shared_types::{ActuationKind, BlockReason, StopReason, Truth};
use vehicle::Invalid;

use super::PriceArguments;
use super::condition::{self, Condition};
use super::course;
use super::search::smallest;
use crate::cores;

/// Widest gap that is tried, beyond the width of the body [cm].
const WIDEST_CM: u32 = 160;
/// Spacing of the places at which the sudden box appears, as driven at the cruising speed of the settings [m].
const SPACING_M: f64 = 0.0025;
/// Most such places per seed.
const MAX_PLACES: u32 = 80;

/// What is driven under one condition.
pub(super) struct Measurement {
    overrides: Vec<String>,
    /// Settings of the run, or why a run is refused.
    plan: Result<Box<Plan>, String>,
    seeds: Range<u64>,
}

/// What was measured under one condition.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Figures {
    pub(super) smallest_gap_m: Option<f64>,
    pub(super) stopping_distance_m: Option<f64>,
    pub(super) speed_mps: Option<f64>,
    /// Why a figure is missing, and every contact.
    pub(super) notes: Vec<String>,
    /// Number of drives in which the robot touched a box.
    pub(super) contacts: usize,
}

/// How the drive towards a sudden box ended.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stop {
    /// Distance from the appearance to standstill [m], and speed at the appearance [m/s].
    Stands { distance_m: f64, speed_mps: f64 },
    /// The body touched the box; speed at the appearance [m/s].
    Touches { speed_mps: f64 },
    /// The robot never came near the box.
    Stays,
}

impl Measurement {
    /// What has to be driven for these conditions: conditions without a difference share a measurement.
    pub(super) fn of_conditions(arguments: &PriceArguments, conditions: &[Condition]) -> Vec<Self> {
        let mut measurements: Vec<Self> = Vec::new();
        for condition in conditions {
            if !measurements.iter().any(|measurement| measurement.belongs_to(condition)) {
                measurements.push(Self::new(arguments, &condition.overrides));
            }
        }
        measurements
    }

    fn new(arguments: &PriceArguments, overrides: &[String]) -> Self {
        let plan = condition::read(arguments, overrides).map(Box::new).map_err(|error| error.to_string());
        let first = plan.as_ref().map_or(0, |plan| plan.scenario.seed);
        Self { overrides: overrides.to_vec(), plan, seeds: first..first.saturating_add(arguments.seeds) }
    }

    /// Whether this is the measurement of a condition.
    pub(super) fn belongs_to(&self, condition: &Condition) -> bool {
        self.overrides == condition.overrides
    }

    /// Drives both courses; what a run would refuse becomes a note.
    pub(super) fn figures(&self) -> Figures {
        let measured = self.plan.as_ref().map_err(String::clone).and_then(|plan| {
            let mut figures = Figures::default();
            let drive = Drives { plan, seeds: self.seeds.clone() };
            drive
                .gap(&mut figures)
                .and_then(|()| drive.stopping(&mut figures))
                .map_err(|error| error.to_string())?;
            Ok(figures)
        });
        measured.unwrap_or_else(|reason| Figures { notes: vec![reason], ..Figures::default() })
    }

    /// The scans of its drives grow with the rate.
    fn rate_hz(&self) -> f64 {
        self.plan.as_ref().map_or(0.0, |plan| plan.system.rate_hz)
    }
}

/// The figures of all measurements in their order, from all cores; `done` is called after each.
///
/// # Errors
/// A thread that can't be started.
pub(super) fn on_all_cores(
    measurements: &[Measurement],
    mut done: impl FnMut(),
) -> std::io::Result<Vec<Figures>> {
    // The longest first, so that no core waits long for the last one.
    let mut order: Vec<usize> = (0..measurements.len()).collect();
    order.sort_by(|a, b| measurements[*b].rate_hz().total_cmp(&measurements[*a].rate_hz()));
    let figures = cores::on_all_cores(order.len(), |place| measurements[order[place]].figures(), &mut done)?;
    let mut figures: Vec<(usize, Figures)> = order.into_iter().zip(figures).collect();
    figures.sort_by_key(|(index, _)| *index);
    Ok(figures.into_iter().map(|(_, figures)| figures).collect())
}

impl Figures {
    /// Takes the drives towards boxes that appear `ahead_m` in front of the robot.
    fn stops(&mut self, stops: &[Stop], ahead_m: f64) {
        let distances: Option<Vec<f64>> = stops.iter().map(Stop::distance_m).collect();
        self.stopping_distance_m = distances.into_iter().flatten().reduce(f64::max);
        self.speed_mps = stops.iter().filter_map(Stop::speed_mps).reduce(f64::max);
        let count = |is: fn(&Stop) -> bool| stops.iter().filter(|stop| is(stop)).count();
        let touches = count(|stop| matches!(stop, Stop::Touches { .. }));
        let stays = count(|stop| matches!(stop, Stop::Stays));
        self.contacts += touches;
        for (drives, what) in
            [(touches, "contact: a box that appeared was touched"), (stays, "no box was reached")]
        {
            if drives > 0 {
                self.notes.push(format!("{what} in {drives} of {} drives, {ahead_m} m ahead", stops.len()));
            }
        }
    }
}

impl Stop {
    /// Distance until standstill [m].
    fn distance_m(&self) -> Option<f64> {
        match self {
            Self::Stands { distance_m, .. } => Some(*distance_m),
            Self::Touches { .. } | Self::Stays => None,
        }
    }

    /// Speed at the appearance [m/s].
    fn speed_mps(&self) -> Option<f64> {
        match self {
            Self::Stands { speed_mps, .. } | Self::Touches { speed_mps } => Some(*speed_mps),
            Self::Stays => None,
        }
    }
}

/// The drives under one condition.
struct Drives<'a> {
    plan: &'a Plan,
    seeds: Range<u64>,
}

impl Drives<'_> {
    fn settings(&self, scenario: Scenario) -> PipelineSettings {
        PipelineSettings {
            scenario,
            tuning: self.plan.system.tuning(),
            period_ns: self.plan.system.period_ns(),
        }
    }

    /// Bisects the gap that all seeds pass.
    fn gap(&self, figures: &mut Figures) -> Result<(), Invalid> {
        let body_m = self.plan.scenario.robot.width_m;
        let width_m = |beyond_cm: u32| body_m + f64::from(beyond_cm) * 0.01;
        let found = smallest(0, WIDEST_CM, |beyond_cm| {
            for seed in self.seeds.clone() {
                let scenario = course::gap(&self.plan.scenario, width_m(beyond_cm), seed);
                let (passed, contact) = passes(&self.settings(scenario))?;
                let note =
                    |reason| format!("contact: gap {:.2} m, seed {seed}: {reason}", width_m(beyond_cm));
                figures.contacts += usize::from(contact.is_some());
                figures.notes.extend(contact.map(note));
                if !passed {
                    return Ok(false);
                }
            }
            Ok(true)
        })?;
        if found.is_none() {
            figures
                .notes
                .push(format!("no gap up to {:.2} m was passed with every seed", width_m(WIDEST_CM)));
        }
        figures.smallest_gap_m = found.map(width_m);
        Ok(())
    }

    /// The longest stopping distance over all seeds and over all times within a scan period.
    fn stopping(&self, figures: &mut Figures) -> Result<(), Invalid> {
        let ahead_m = self.plan.system.vehicle.sudden_m;
        let mut stops = Vec::new();
        for seed in self.seeds.clone() {
            for shift_m in self.shifts_m() {
                let (scenario, surface_m) = course::sudden(&self.plan.scenario, ahead_m, shift_m, seed);
                stops.push(stop(&self.settings(scenario), surface_m - ahead_m)?);
            }
        }
        figures.stops(&stops, ahead_m);
        Ok(())
    }

    /// Shifts of the box over the way of one scan period, evenly spaced [m].
    fn shifts_m(&self) -> impl Iterator<Item = f64> + use<> {
        let way_m = self.plan.system.controller.cruise_mps / self.plan.system.rate_hz;
        let places = ((way_m / SPACING_M).ceil() as u32).clamp(1, MAX_PLACES);
        (0..places).map(move |place| way_m * f64::from(place) / f64::from(places))
    }
}

/// Whether the robot landed by its own estimate and touched nothing, and the reason of a contact.
fn passes(settings: &PipelineSettings) -> Result<(bool, Option<String>), Invalid> {
    let (mut landed, mut clearance_m) = (false, f64::INFINITY);
    let drive = pipeline::drive(settings, |step| {
        (landed, clearance_m) = (lands(step), step.truth.min_clearance_m);
    })?;
    let arrived = match drive.outcome {
        Outcome::Reached => true,
        Outcome::Missed => landed,
        _ => false,
    };
    let contact = (drive.outcome == Outcome::Collision).then_some(drive.reason);
    Ok((arrived && clearance_m > 0.0, contact))
}

/// Whether the wheels are blocked for landing.
fn lands(step: &Step) -> bool {
    step.actuation.is_some_and(|actuation| {
        actuation.kind == ActuationKind::Block.wire()
            && (actuation.reason == BlockReason::Landed.wire()
                || actuation.stop_reason == StopReason::Landed.wire())
    })
}

/// Drives until the robot stands after its front has passed `appears_m`, where the box appears.
fn stop(settings: &PipelineSettings, appears_m: f64) -> Result<Stop, Invalid> {
    let mut pipeline = Pipeline::new(settings)?;
    let mut speed_mps = None;
    loop {
        let truth = pipeline.step().truth;
        let front_m = front_m(&settings.scenario, &truth);
        if front_m >= appears_m {
            speed_mps = speed_mps.or(Some(truth.speed_mps));
        }
        match speed_mps {
            Some(speed_mps) if truth.collided != 0 => return Ok(Stop::Touches { speed_mps }),
            Some(speed_mps) if truth.speed_mps == 0.0 => {
                return Ok(Stop::Stands { distance_m: front_m - appears_m, speed_mps });
            }
            _ if truth.time_s >= settings.scenario.timeout_s => return Ok(Stop::Stays),
            _ => {}
        }
    }
}

/// Where the front of the body is along the track or course [m].
fn front_m(scenario: &Scenario, truth: &Truth) -> f64 {
    let [along_m, _] = scenario.on_course(truth.x_m, truth.y_m);
    let way_rad = scenario.course.as_ref().map_or(0.0, |course| course.at(along_m).yaw);
    along_m + scenario.robot.length_m / 2.0 * (truth.yaw_rad - way_rad).cos()
}

#[cfg(test)]
mod tests {
    use plan::Choice;

    use super::*;

    fn measurement(set: &[&str]) -> Measurement {
        let overrides = set.iter().map(|text| (*text).to_owned()).collect();
        let choice = Choice { overrides, ..Choice::default() };
        Measurement::new(&PriceArguments { choice, seeds: 1, ..PriceArguments::default() }, &[])
    }

    #[test]
    fn the_places_of_the_box_cover_one_scan_period_evenly() {
        let measurement = measurement(&["rate_hz=100"]);
        let drives = Drives { plan: measurement.plan.as_ref().unwrap(), seeds: 1..2 };
        let shifts: Vec<f64> = drives.shifts_m().collect();
        let expected = [0.0, 0.0025, 0.005, 0.0075];
        assert_eq!(shifts.len(), expected.len());
        assert!(shifts.iter().zip(expected).all(|(shift, expected)| (shift - expected).abs() < 1e-12));
    }

    #[test]
    fn the_longest_stop_counts_and_one_contact_leaves_no_distance() {
        let stands = |distance_m, speed_mps| Stop::Stands { distance_m, speed_mps };
        let mut figures = Figures::default();
        figures.stops(&[stands(0.3, 1.0), stands(0.4, 0.9)], 1.2);
        assert_eq!((figures.stopping_distance_m, figures.speed_mps), (Some(0.4), Some(1.0)));
        assert_eq!((figures.contacts, figures.notes.len()), (0, 0));
        figures.stops(&[stands(0.3, 0.8), Stop::Touches { speed_mps: 0.9 }, Stop::Stays], 1.2);
        assert_eq!((figures.stopping_distance_m, figures.speed_mps, figures.contacts), (None, Some(0.9), 1));
        assert_eq!(
            figures.notes,
            [
                "contact: a box that appeared was touched in 1 of 3 drives, 1.2 m ahead",
                "no box was reached in 1 of 3 drives, 1.2 m ahead"
            ]
        );
    }

    #[test]
    fn what_a_run_refuses_is_a_note_and_no_figure() {
        let refused = measurement(&["rate_hz=0.1"]).figures();
        assert_eq!((refused.smallest_gap_m, refused.stopping_distance_m), (None, None));
        assert!(refused.notes[0].contains("rate_hz = 0.1 is not allowed"), "{:?}", refused.notes);
    }
}
