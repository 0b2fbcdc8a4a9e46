//! `scanloop analyse drift`: the position error that each form of the correction of measured data leaves.

use crate::analysis::forms::{ErrorCause, Form, LATERAL_RATE, LONGITUDINAL, OFFSET_RAD, errors, largest};
use console::exit::Exit;
use estimator::correction::CorrectionMode;
use figures::Table;
use report::picture::chart::{Chart, Curve};
use serde::Serialize;

use super::{DriftArguments, publish};

const DEFINITION: &str = "largest distance of corrected and true position so far, without noise and filter; sine of \
    0.06 rad and 5 s period at 1 m/s, df = 0.01, dds = 0.053 1/s, offset and play 0.0098 rad";

/// Times of the table [s].
const TIMES_S: [f64; 3] = [5.0, 10.0, 20.0];

/// How long the robot drives [s].
const SECONDS: f64 = 20.0;

const FORMS: [(&str, Form); 5] = [
    ("off", Form { mode: CorrectionMode::Off, reset_s: 0.0 }),
    ("time (printed)", Form { mode: CorrectionMode::Time, reset_s: 0.0 }),
    ("time, reset 6 s", Form { mode: CorrectionMode::Time, reset_s: 6.0 }),
    ("moving", Form { mode: CorrectionMode::Moving, reset_s: 0.0 }),
    ("yaw", Form { mode: CorrectionMode::Yaw, reset_s: 0.0 }),
];

const ROBOTS: [(&str, ErrorCause); 3] = [
    ("constant steering offset", ErrorCause::Offset),
    ("play, zero mean", ErrorCause::Play),
    ("odometry errs as modelled", ErrorCause::Modelled),
];

#[derive(Debug, Serialize)]
struct DriftResult {
    times_s: [f64; 3],
    longitudinal: f64,
    lateral_rate_per_s: f64,
    offset_rad: f64,
    robots: Vec<RobotErrors>,
    definition: &'static str,
}

#[derive(Debug, Serialize)]
struct RobotErrors {
    robot: &'static str,
    forms: Vec<FormErrors>,
}

#[derive(Debug, Serialize)]
struct FormErrors {
    form: &'static str,
    /// Largest error up to each of the times.
    largest_error_m: [f64; 3],
}

pub(super) fn analyse(arguments: &DriftArguments) -> anyhow::Result<Exit> {
    let result = DriftResult {
        times_s: TIMES_S,
        longitudinal: LONGITUDINAL,
        lateral_rate_per_s: LATERAL_RATE,
        offset_rad: OFFSET_RAD,
        robots: ROBOTS.iter().map(|(name, robot)| of_robot(name, *robot)).collect(),
        definition: DEFINITION,
    };
    publish(&arguments.output, "drift", &table(&result), &chart(), &result, true)
}

fn of_robot(name: &'static str, robot: ErrorCause) -> RobotErrors {
    let forms = FORMS.iter().map(|(form_name, form)| {
        let found = errors(robot, *form, SECONDS);
        FormErrors { form: form_name, largest_error_m: TIMES_S.map(|time_s| largest(&found, time_s)) }
    });
    RobotErrors { robot: name, forms: forms.collect() }
}

fn table(result: &DriftResult) -> String {
    let mut table = Table::of_numbers("largest error [m] after", &["5 s", "10 s", "20 s"]);
    for RobotErrors { robot, forms } in &result.robots {
        table.row([(*robot).to_owned()]);
        for FormErrors { form, largest_error_m } in forms {
            let errors = largest_error_m.map(|error_m| format!("{error_m:.3}"));
            table.row(std::iter::once(format!("  {form}")).chain(errors));
        }
    }
    format!("{table}definition      {DEFINITION}\n")
}

/// The errors of the robot with the steering offset, as in the source.
fn chart() -> Chart {
    let curve = |(name, form): &(&str, Form)| Curve {
        name: (*name).to_owned(),
        // The logarithmic axis has no zero; errors below a millimetre do not matter.
        points: errors(ErrorCause::Offset, *form, SECONDS)
            .into_iter()
            .map(|[t, error]| [t, error.max(1e-3)])
            .collect(),
        dots: false,
    };
    Chart {
        title: "What the forms of the correction leave of a steering offset of 0.0098 rad".to_owned(),
        subtitle: "\"moving\" is \"time\" here, as the robot never rests".to_owned(),
        x: "time [s]".to_owned(),
        y: "distance of corrected and true position [m]".to_owned(),
        logarithmic: true,
        curves: FORMS.iter().filter(|(name, _)| *name != "moving").map(curve).collect(),
        ..Chart::default()
    }
}
