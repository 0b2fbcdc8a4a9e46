//! `scanloop analyse intervals`: how many intervals a horizon needs, or the longest horizon of N intervals.

use std::fmt::Write as _;

use crate::analysis::intervals::{ControlFamily, Definition, ErrorMeasure, Grid, Horizons, Worst};
use console::exit::Exit;
use report::picture::chart::{Chart, Curve};
use serde::Serialize;
use vehicle::require;

use super::arguments::{ERRORS, FAMILIES, GRIDS, SCHEMES, name_of};
use super::{IntervalsArguments, OperatingPoint, publish, refuse};

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct IntervalsResult {
    /// 1: the smallest number of intervals is asked for; 2: the longest horizon.
    bilevel: u8,
    /// The smallest number of intervals within the tolerance, or the number asked about.
    n: Option<usize>,
    /// Largest error for `n` intervals over `tf_s`; without `n`, the smallest of `errors`.
    max_error: f64,
    /// For 1, 2, ... intervals.
    errors: Vec<f64>,
    worst_controls: Vec<OperatingPoint>,
    lengths_s: Vec<f64>,
    tf_s: f64,
    tol: f64,
    scheme: &'static str,
    error: &'static str,
    controls: &'static str,
    grid: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_tf_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_tf: Option<MaxTf>,
    other_definitions: Vec<OtherDefinition>,
    other_schemes: Vec<OtherScheme>,
    definition: String,
}

/// The longest horizon.
#[derive(Debug, Serialize)]
struct MaxTf {
    max_error: f64,
    worst_controls: Vec<OperatingPoint>,
    lengths_s: Vec<f64>,
    at_limit: bool,
}

/// The same intervals judged by another definition.
#[derive(Debug, Serialize)]
struct OtherDefinition {
    error: &'static str,
    controls: &'static str,
    max_error: f64,
}

/// The same definition with another scheme.
#[derive(Debug, Serialize)]
struct OtherScheme {
    scheme: &'static str,
    max_error: f64,
    n: Option<usize>,
}

pub(super) fn analyse(arguments: &IntervalsArguments) -> anyhow::Result<Exit> {
    let definition = Definition {
        scheme: arguments.scheme,
        error: arguments.error,
        controls: arguments.controls,
        grid: arguments.grid,
        tolerance: arguments.tol,
        ..Definition::default()
    };
    definition.validate(arguments.tf, arguments.n.unwrap_or(1)).map_err(refuse)?;
    let max = definition.max_intervals();
    let limit = arguments.limit.unwrap_or(max.min(24));
    require("limit", limit as f64, 1.0..=max as f64).map_err(refuse)?;

    let (errors, found, n) = match arguments.n {
        Some(n) => {
            let worst = definition.worst(arguments.tf, n);
            let fewer = (1..n).map(|n| definition.worst(arguments.tf, n).error);
            (fewer.chain([worst.error]).collect(), worst, Some(n))
        }
        None => {
            let counts = definition.smallest_count(arguments.tf, limit);
            let errors: Vec<f64> = counts.worst.iter().map(|worst| worst.error).collect();
            let best = (0..errors.len()).min_by(|left, right| errors[*left].total_cmp(&errors[*right]));
            let index = counts.smallest.map(|count| count - 1).or(best).unwrap_or(0);
            let found = counts.worst[index].clone();
            (errors, found, counts.smallest)
        }
    };
    let horizons = arguments.n.map(|n| definition.longest_horizon(n));
    let schemes = other_schemes(&definition, arguments.tf, found.lengths_s.len(), limit)?;
    let result = result(arguments, &definition, errors, &found, n, horizons.as_ref(), schemes);
    let chart = match &horizons {
        None => count_chart(&result, &definition),
        Some(horizons) => horizon_chart(&result, horizons),
    };
    let is_kept = match &horizons {
        None => result.n.is_some(),
        Some(horizons) => horizons.longest_s.is_some(),
    };
    publish(&arguments.output, "intervals", &table(&result, limit), &chart, &result, is_kept)
}

/// All schemes on equal intervals: the error of `count` intervals, and the smallest number for a held control.
fn other_schemes(
    definition: &Definition,
    horizon_s: f64,
    count: usize,
    limit: usize,
) -> std::io::Result<Vec<OtherScheme>> {
    let of = move |(name, scheme): &(&'static str, ocp::Scheme)| {
        let equal = Definition { scheme: *scheme, grid: Grid::Uniform, ..*definition };
        // For piecewise controls the search takes too long for all schemes and numbers.
        let held = equal.controls == ControlFamily::Constant;
        let n = held.then(|| equal.smallest_count(horizon_s, limit).smallest).flatten();
        OtherScheme { scheme: name, max_error: equal.worst(horizon_s, count).error, n }
    };
    std::thread::scope(|scope| {
        let start = |named| std::thread::Builder::new().spawn_scoped(scope, move || of(named));
        let workers = SCHEMES.iter().map(start).collect::<Result<Vec<_>, _>>()?;
        Ok(workers.into_iter().filter_map(|worker| worker.join().ok()).collect())
    })
}

fn result(
    arguments: &IntervalsArguments,
    definition: &Definition,
    errors: Vec<f64>,
    found: &Worst,
    n: Option<usize>,
    horizons: Option<&Horizons>,
    other_schemes: Vec<OtherScheme>,
) -> IntervalsResult {
    let others = definition.others(&found.lengths_s);
    let max_tf = horizons.and_then(|horizons| {
        horizons.worst.as_ref().map(|worst| MaxTf {
            max_error: worst.error,
            worst_controls: worst.controls.iter().map(OperatingPoint::from).collect(),
            lengths_s: worst.lengths_s.clone(),
            at_limit: horizons.at_limit,
        })
    });
    IntervalsResult {
        bilevel: if horizons.is_some() { 2 } else { 1 },
        n,
        max_error: found.error,
        errors,
        worst_controls: found.controls.iter().map(OperatingPoint::from).collect(),
        lengths_s: found.lengths_s.clone(),
        tf_s: arguments.tf,
        tol: arguments.tol,
        scheme: name_of(&SCHEMES, definition.scheme),
        error: name_of(&ERRORS, definition.error),
        controls: name_of(&FAMILIES, definition.controls),
        grid: name_of(&GRIDS, definition.grid),
        max_tf_s: horizons.and_then(|horizons| horizons.longest_s),
        max_tf,
        other_definitions: others
            .iter()
            .map(|other| OtherDefinition {
                error: name_of(&ERRORS, other.error),
                controls: name_of(&FAMILIES, other.controls),
                max_error: other.largest,
            })
            .collect(),
        other_schemes,
        definition: sentence(definition),
    }
}

/// The definition as a sentence.
fn sentence(definition: &Definition) -> String {
    let error = match definition.error {
        ErrorMeasure::PositionEnds => "the larger error of x and y [m] at interval ends",
        ErrorMeasure::AllStatesEnds => {
            "the largest error of all five states [rad, rad/s, m] at interval ends"
        }
        ErrorMeasure::PositionDense => {
            "the larger error of x and y [m] at interval ends and at nine points inside each"
        }
    };
    let controls = match definition.controls {
        ControlFamily::Constant => "one control of the box held over the horizon",
        ControlFamily::Piecewise => "one control of the box per interval (a family that grows with N)",
    };
    let grid = match definition.grid {
        Grid::Uniform => "equal intervals",
        Grid::Free => "interval lengths chosen by search",
    };
    format!(
        "{} collocation, {grid}, from the zero state; {error} against the exact motion, largest over {controls}, found by \
         search",
        name_of(&SCHEMES, definition.scheme)
    )
}

fn table(result: &IntervalsResult, limit: usize) -> String {
    let mut text = format!("definition      {}\n", result.definition);
    let _ = writeln!(text, "horizon         {} s, tolerance {:e}", result.tf_s, result.tol);
    let _ = writeln!(text, "  {:>3}  {:>13}", "N", "largest error");
    for (index, error) in result.errors.iter().enumerate() {
        let count = index + 1;
        let mark = match result.n {
            Some(n) if n == count && *error <= result.tol => "  <- within the tolerance",
            Some(n) if n == count => "  <- above the tolerance",
            _ => "",
        };
        let _ = writeln!(text, "  {count:>3}  {error:>13.3e}{mark}");
    }
    let _ = writeln!(text, "worst controls  {}", controls(&result.worst_controls));
    if result.grid == "free" {
        let _ = writeln!(text, "lengths         {} s", lengths(&result.lengths_s));
    }
    text += &verdict(result, limit);
    let _ = writeln!(text, "same intervals by other definitions");
    for (name, _) in ERRORS {
        let of = |family: &str| {
            let found =
                result.other_definitions.iter().find(|other| other.error == name && other.controls == family);
            found.map_or("not searched".to_owned(), |other| format!("{:.3e}", other.max_error))
        };
        let _ =
            writeln!(text, "  {name:<16} constant {:>9}  piecewise {:>9}", of("constant"), of("piecewise"));
    }
    let _ = writeln!(text, "other schemes, equal intervals");
    for other in &result.other_schemes {
        let n = match (result.controls, other.n) {
            ("piecewise", _) => String::new(),
            (_, Some(n)) => format!("  smallest N {n}"),
            (_, None) => format!("  smallest N above {limit}"),
        };
        let count = result.lengths_s.len();
        let _ = writeln!(text, "  {:<16} {:>9.3e} for N = {count}{n}", other.scheme, other.max_error);
    }
    text
}

fn verdict(result: &IntervalsResult, limit: usize) -> String {
    let IntervalsResult { tol, tf_s, .. } = result;
    match (&result.max_tf, result.n) {
        (Some(longest), Some(n)) => {
            let tf = result.max_tf_s.unwrap_or(f64::NAN);
            let more = if longest.at_limit { " or more" } else { "" };
            let mut text = format!(
                "result          {n} intervals keep {tol:e} up to {tf:.3} s{more}, largest error {:.3e}\n",
                longest.max_error
            );
            if result.grid == "free" {
                let _ = writeln!(text, "  with lengths  {} s", lengths(&longest.lengths_s));
            }
            text
        }
        (None, Some(n)) if result.bilevel == 2 => {
            format!("result          {n} intervals keep {tol:e} over no horizon\n")
        }
        (_, Some(n)) => {
            format!("result          N = {n}: largest error {:.4e} over {tf_s} s\n", result.max_error)
        }
        (_, None) => format!(
            "result          more than {limit} intervals are needed: the smallest error is {:.3e}\n",
            result.max_error
        ),
    }
}

fn lengths(lengths_s: &[f64]) -> String {
    lengths_s.iter().map(|length| format!("{length:.4}")).collect::<Vec<_>>().join(" ")
}

/// Controls as text; equal ones are written once.
fn controls(controls: &[OperatingPoint]) -> String {
    let one =
        |point: &OperatingPoint| format!("{:.3} m/s {:+.4} rad", point.velocity_mps, point.steering_rad);
    match controls {
        [first, rest @ ..] if rest.iter().all(|other| other == first) => one(first),
        all => all.iter().map(one).collect::<Vec<_>>().join(", "),
    }
}

fn count_chart(result: &IntervalsResult, definition: &Definition) -> Chart {
    let by_count = |errors: &[f64]| -> Vec<[f64; 2]> {
        errors.iter().enumerate().map(|(index, error)| [(index + 1) as f64, *error]).collect()
    };
    let mut curves = vec![Curve {
        name: format!("{}, as asked", result.scheme),
        points: by_count(&result.errors),
        dots: true,
    }];
    // For comparison the other schemes, with held controls on equal intervals, which are quick to search.
    for name in ["gauss-2", "gauss-3", "radau-2", "radau-3"].into_iter().filter(|name| *name != result.scheme)
    {
        let Some((_, scheme)) = SCHEMES.iter().find(|(other, _)| *other == name) else { continue };
        let other = Definition {
            scheme: *scheme,
            controls: ControlFamily::Constant,
            grid: Grid::Uniform,
            ..*definition
        };
        let count = result.errors.len();
        let errors: Vec<f64> = (1..=count).map(|count| other.worst(result.tf_s, count).error).collect();
        curves.push(Curve {
            name: format!("{name}, constant, uniform"),
            points: by_count(&errors),
            dots: true,
        });
    }
    let title = match result.n {
        Some(n) => format!("Bilevel-I: {n} intervals over {} s keep {:e}", result.tf_s, result.tol),
        None => {
            format!("Bilevel-I: no number of intervals tried keeps {:e} over {} s", result.tol, result.tf_s)
        }
    };
    Chart {
        title,
        subtitle: subtitle(result),
        x: "number of intervals N".to_owned(),
        whole: true,
        y: "largest error".to_owned(),
        logarithmic: true,
        curves,
        limits: vec![("tolerance".to_owned(), result.tol)],
        mark: result.n.map(|n| (format!("N = {n}: {:.3e}", result.max_error), [n as f64, result.max_error])),
        ..Chart::default()
    }
}

fn horizon_chart(result: &IntervalsResult, horizons: &Horizons) -> Chart {
    let count = result.lengths_s.len();
    let title = match result.max_tf_s {
        Some(tf) => format!("Bilevel-II: {count} intervals keep {:e} up to {tf:.3} s", result.tol),
        None => format!("Bilevel-II: {count} intervals keep {:e} over no horizon", result.tol),
    };
    let points = horizons.tried.iter().map(|(horizon, error)| [*horizon, *error]).collect();
    Chart {
        title,
        subtitle: subtitle(result),
        x: "horizon tf [s]".to_owned(),
        y: "largest error".to_owned(),
        logarithmic: true,
        curves: vec![Curve { name: format!("{}, N = {count}", result.scheme), points, dots: true }],
        limits: vec![("tolerance".to_owned(), result.tol)],
        mark: result
            .max_tf
            .as_ref()
            .zip(result.max_tf_s)
            .map(|(longest, tf)| (format!("tf = {tf:.3} s"), [tf, longest.max_error])),
        ..Chart::default()
    }
}

fn subtitle(result: &IntervalsResult) -> String {
    let IntervalsResult { scheme, error, controls, grid, .. } = result;
    format!("{scheme}, error {error}, controls {controls}, grid {grid}, from the zero state")
}
