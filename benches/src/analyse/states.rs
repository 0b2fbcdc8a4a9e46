//! `scanloop-lab analyse observability --states`: which errors of the robot a driven way shows.

use console::exit::Exit;
use figures::Table;
use pipeline::Step;
use plan::{Choice, Plan};
use report::picture::chart::{Chart, Curve};
use serde::Serialize;
use shared_types::LEARNED;

use super::{ObservabilityArguments, publish};

/// A state is shown where its standard deviation is less than this share of what it was at the start.
const SHOWN: f64 = 0.5;

const DEFINITION: &str = "the estimator drives the scenario and learns; a state is observable over the way where its standard \
    deviation falls below half of what is believed before the drive";

/// One state that is learned.
#[derive(Debug, Default, Serialize)]
struct LearnedState {
    name: &'static str,
    deviation_at_start: f64,
    deviation_at_end: f64,
    /// Way after which it was known to half of that [m].
    shown_after_m: Option<f64>,
    /// Way [m], and share of the deviation at the start.
    #[serde(skip)]
    curve: Vec<[f64; 2]>,
}

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct StatesResult {
    scenario: String,
    outcome: emulator::Outcome,
    way_m: f64,
    states: [LearnedState; 6],
    definition: &'static str,
}

/// Drives a scenario and says what of the robot became known; exit code 0 when all of it did.
///
/// # Errors
/// A scenario or a setting that is not allowed; exit code 2.
pub(super) fn analyse(scenario: &str, arguments: &ObservabilityArguments) -> anyhow::Result<Exit> {
    let choice = Choice { overrides: arguments.overrides.clone(), ..Choice::default() };
    let settings = Plan::read(Some(scenario), &choice)?.simulated();
    let (name, period_ns) = (settings.scenario.name.clone(), settings.period_ns);
    let mut states = LEARNED.map(|name| LearnedState { name, ..LearnedState::default() });
    let mut way_m = 0.0;
    let drive = pipeline::drive(&settings, |Step { truth, pose, .. }| {
        way_m += truth.speed_mps.abs() * period_ns as f64 * 1e-9;
        let Some(pose) = pose else { return };
        states.iter_mut().zip(pose.learned_deviation).for_each(|(state, now)| state.follow(way_m, now));
    })?;
    let is_shown = states.iter().all(|state| state.shown_after_m.is_some());
    let result =
        StatesResult { scenario: name, outcome: drive.outcome, way_m, states, definition: DEFINITION };
    publish(&arguments.output, "states", &table(&result), &chart(&result), &result, is_shown)
}

impl LearnedState {
    fn follow(&mut self, way_m: f64, deviation: f64) {
        if self.deviation_at_start == 0.0 {
            self.deviation_at_start = deviation;
        }
        self.deviation_at_end = deviation;
        let share = deviation / self.deviation_at_start;
        if share < SHOWN {
            self.shown_after_m.get_or_insert(way_m);
        }
        if share > 0.0 {
            self.curve.push([way_m, share]);
        }
    }
}

fn table(result: &StatesResult) -> String {
    let mut table = Table::of_numbers("state", &["at the start", "at the end", "observable after"]);
    for LearnedState { name, deviation_at_start, deviation_at_end, shown_after_m, .. } in &result.states {
        let after = shown_after_m.map_or_else(|| "not".to_owned(), |way_m| format!("{way_m:.1} m"));
        let [first, last] =
            [deviation_at_start, deviation_at_end].map(|deviation| format!("{deviation:.2e}"));
        table.row([(*name).to_owned(), first, last, after]);
    }
    let StatesResult { scenario, way_m, outcome, .. } = result;
    format!("scenario        {scenario}, {way_m:.1} m, {outcome}\n{table}definition      {DEFINITION}\n")
}

fn chart(result: &StatesResult) -> Chart {
    let of =
        |state: &LearnedState| Curve { name: state.name.into(), points: state.curve.clone(), dots: false };
    Chart {
        title: format!("What {:.0} m of {} show of the robot", result.way_m, result.scenario),
        x: "way [m]".to_owned(),
        y: "standard deviation as share of that at the start".to_owned(),
        logarithmic: true,
        curves: result.states.iter().filter(|state| !state.curve.is_empty()).map(of).collect(),
        ..Chart::default()
    }
}
