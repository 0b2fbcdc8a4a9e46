//! `scanloop analyse correlation`: the angle between the effects of velocity and steering.

use std::fmt::Write as _;

use crate::analysis::correlation::{Angles, CORRELATED_BELOW_DEG, Correlation, CorrelationSettings};
use console::exit::Exit;
use report::picture::chart::{Chart, Curve};
use serde::Serialize;
use vehicle::{Bounds, Control, Parameters};

use super::arguments::{SCHEMES, name_of};
use super::{CorrelationArguments, OperatingPoint, publish, refuse};

const DEFINITION: &str = "angle between the columns of the sensitivity of an end state (sideslip, yaw, yaw rate, x, y, \
    SI units) to (velocity, steering), of the model from the zero state; `interval`: of an interval's end to its own \
    control; `held`: of the same end to a control held since the start";

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct CorrelationResult {
    angle_deg: f64,
    min_angle_deg: f64,
    box_min_angle_deg: f64,
    bfgs_admissible: bool,
    velocity_mps: f64,
    steering_rad: f64,
    tf_s: f64,
    n: usize,
    scheme: &'static str,
    intervals: Vec<Angles>,
    box_worst: OperatingPoint,
    definition: &'static str,
}

pub(super) fn analyse(arguments: &CorrelationArguments) -> anyhow::Result<Exit> {
    let settings = CorrelationSettings {
        parameters: Parameters::default(),
        bounds: Bounds::default(),
        scheme: arguments.scheme,
        horizon_s: arguments.tf,
        count: arguments.n,
    };
    let control = Control { velocity: arguments.velocity, steering: arguments.steering };
    let found = settings.analyse(control).map_err(refuse)?;
    let result = result(arguments, &found);
    let (table, chart) = (table(&result), chart(&settings, &result));
    publish(&arguments.output, "correlation", &table, &chart, &result, result.bfgs_admissible)
}

fn result(arguments: &CorrelationArguments, found: &Correlation) -> CorrelationResult {
    CorrelationResult {
        angle_deg: found.angle_deg(),
        min_angle_deg: found.min_angle_deg,
        box_min_angle_deg: found.box_min_angle_deg,
        bfgs_admissible: found.bfgs_admissible(),
        velocity_mps: arguments.velocity,
        steering_rad: arguments.steering,
        tf_s: arguments.tf,
        n: arguments.n,
        scheme: name_of(&SCHEMES, arguments.scheme),
        intervals: found.intervals.clone(),
        box_worst: OperatingPoint::from(&found.box_worst),
        definition: DEFINITION,
    }
}

fn table(result: &CorrelationResult) -> String {
    let CorrelationResult { velocity_mps, steering_rad, tf_s, n, scheme, .. } = result;
    let mut text =
        format!("operating point {velocity_mps} m/s, {steering_rad:+} rad; {tf_s} s in {n} intervals\n");
    let _ =
        writeln!(text, "  {:>7}  {:>14}  {:>10}  {:>14}", "end [s]", "interval [deg]", "held [deg]", scheme);
    for row in &result.intervals {
        let Angles { time_s, interval_deg, held_deg, scheme_deg } = row;
        let _ = writeln!(text, "  {time_s:>7.4}  {interval_deg:>14.2}  {held_deg:>10.2}  {scheme_deg:>14.2}");
    }
    let _ = writeln!(text, "angle           {:.2} deg, first interval", result.angle_deg);
    let _ = writeln!(
        text,
        "smallest        {:.2} deg of angle and 180 - angle over the horizon",
        result.min_angle_deg
    );
    let _ = writeln!(
        text,
        "over the box    {:.2} deg, at {:.3} m/s, {:+.4} rad",
        result.box_min_angle_deg, result.box_worst.velocity_mps, result.box_worst.steering_rad
    );
    let verdict = if result.bfgs_admissible {
        "not correlated, BFGS is admissible: no angle"
    } else {
        "warning: correlated, BFGS is not advised: an angle"
    };
    let _ = writeln!(text, "result          {verdict} below {CORRELATED_BELOW_DEG} deg");
    let _ = writeln!(
        text,
        "definition      {DEFINITION}; `{scheme}`: as `interval`, but with one collocation interval, which passes over \
         the transient"
    );
    text
}

fn chart(settings: &CorrelationSettings, result: &CorrelationResult) -> Chart {
    /// Points of a curve.
    const POINTS: i32 = 48;
    let bounds = &settings.bounds;
    let curve = |velocity: f64, held: bool| {
        let point = |step: i32| {
            let steering = bounds.steering_max_rad * (2.0 * f64::from(step) / f64::from(POINTS) - 1.0);
            let rows = settings.angles(&Control { velocity, steering }).unwrap_or_default();
            let angle = if held {
                rows.last().map(|row| row.held_deg)
            } else {
                rows.first().map(|row| row.interval_deg)
            };
            [steering, angle.unwrap_or(f64::NAN)]
        };
        let what = if held { "horizon" } else { "interval" };
        Curve {
            name: format!("{what}, {velocity} m/s"),
            points: (0..=POINTS).map(point).collect(),
            dots: false,
        }
    };
    let velocities = [bounds.velocity_min_mps, bounds.velocity_max_mps];
    Chart {
        title: format!(
            "Control-variable correlation: {:.2} deg at {} m/s, {:+} rad",
            result.angle_deg, result.velocity_mps, result.steering_rad
        ),
        subtitle: format!(
            "{} s in {} intervals; smallest of angle and 180 - angle {:.1} deg there, {:.1} deg over the box",
            result.tf_s, result.n, result.min_angle_deg, result.box_min_angle_deg
        ),
        x: "steering [rad]".to_owned(),
        y: "angle [deg]".to_owned(),
        curves: [false, true]
            .into_iter()
            .flat_map(|held| velocities.map(|velocity| curve(velocity, held)))
            .collect(),
        limits: vec![
            ("correlated".to_owned(), CORRELATED_BELOW_DEG),
            ("correlated".to_owned(), 180.0 - CORRELATED_BELOW_DEG),
        ],
        mark: Some(("operating point".to_owned(), [result.steering_rad, result.angle_deg])),
        ..Chart::default()
    }
}
