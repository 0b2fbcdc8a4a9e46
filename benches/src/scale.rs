//! `bench scale`: what companions and topics of your own cost the loop.
//!
//! Systems in real time, one after the other, each with other processes beside the loop: more of them, more topics, more
//! readers of one topic, or larger samples. Each is the built-in system with companions of this executable. Measured are
//! the latency of the loop, which no companion is part of, the shared memory, the memory of all processes, and the time
//! until the system drives. A line is fitted to each figure by least squares.
//!
//! Limit: the companions do nothing but copy, so these are the costs of the mechanism and not of a computation.

pub(crate) mod companion;
mod fit;
mod system;

use std::path::PathBuf;

use clap::Args;
use console::output::data;
use console::{answer, note};
use figures::{Align, Figures, PROFILE, Table};
use serde::Serialize;

use self::fit::{Line, line};
use self::system::{Measured, Shape, measure};

/// Arguments of `bench scale`.
#[derive(Debug, Args)]
pub(crate) struct ScaleArguments {
    /// How long each system drives [s].
    #[arg(long, value_name = "S", default_value_t = 8.0)]
    duration: f64,
    /// The series to measure; all without it.
    #[arg(long, value_enum, value_name = "SERIES")]
    only: Option<Series>,
    /// The executable that runs the systems; without it the one next to this.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Print the figures as JSON to standard output.
    #[arg(long)]
    json: bool,
}

/// What changes from system to system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
enum Series {
    /// All processes of the system: 5 to 50.
    Processes,
    /// All topics of the system: 10 to 100, written by five companions.
    Topics,
    /// Readers of one topic: 1 to 24.
    Readers,
    /// Bytes of a sample between header and stamps: 64 to 4 million.
    Bytes,
}

impl Series {
    const ALL: [Self; 4] = [Self::Processes, Self::Topics, Self::Readers, Self::Bytes];

    /// The values, and the system for each.
    fn shapes(self) -> Vec<(usize, Shape)> {
        let one = Shape { writers: 1, topics: 1, readers: 1, bytes: 64 };
        let shapes = |values: &[usize], of: fn(usize, Shape) -> Shape| {
            values.iter().map(|value| (*value, of(*value, one))).collect()
        };
        match self {
            // Each reads a topic of the loop and writes one of its own.
            Self::Processes => shapes(&[5, 10, 20, 30, 40, 50], |all, one| {
                let writers = all - ROLES;
                Shape { writers, topics: writers, readers: 0, ..one }
            }),
            Self::Topics => shapes(&[15, 20, 40, 60, 80, 100], |all, one| Shape {
                writers: 5,
                topics: all - BUILT_IN,
                readers: 0,
                ..one
            }),
            Self::Readers => shapes(&[1, 4, 8, 12, 16, 20, 24], |readers, one| Shape { readers, ..one }),
            Self::Bytes => shapes(&[64, 1024, 16_384, 262_144, 1_048_576, 4_000_000], |bytes, one| Shape {
                bytes,
                ..one
            }),
        }
    }
}

/// Processes of the loop.
const ROLES: usize = shared_types::ROLES;
/// Topics of the loop.
const BUILT_IN: usize = shared_types::TOPICS.len();

/// The figures of one series.
#[derive(Debug, Serialize)]
struct Row {
    series: Series,
    points: Vec<Point>,
    fits: Fits,
}

#[derive(Debug, Serialize)]
struct Point {
    value: usize,
    #[serde(flatten)]
    measured: Measured,
}

/// Lines through the points; nothing where no line can be drawn.
#[derive(Debug, Serialize)]
struct Fits {
    latency_p50_us: Option<Line>,
    latency_p99_us: Option<Line>,
    shared_memory_kib: Option<Line>,
    memory_kib: Option<Line>,
    start_ms: Option<Line>,
}

#[derive(Debug, Serialize)]
struct Results {
    profile: &'static str,
    duration_s: f64,
    series: Vec<Row>,
}

/// Measures all series and prints them.
///
/// # Errors
/// A system that can't be started or does not drive; exit code 4.
pub(crate) fn scale(arguments: &ScaleArguments) -> anyhow::Result<console::exit::Exit> {
    session::arguments::check_duration(Some(arguments.duration))?;
    let program = arguments.program.clone().map_or_else(system::program, Ok)?;
    let mut results = Results { profile: PROFILE, duration_s: arguments.duration, series: Vec::new() };
    for series in Series::ALL.into_iter().filter(|series| arguments.only.is_none_or(|only| only == *series)) {
        let mut points = Vec::new();
        for (value, shape) in series.shapes() {
            note!("{series:?} {value}");
            points.push(Point { value, measured: measure(&program, &shape, arguments.duration)? });
        }
        let fit = |figure: fn(&Measured) -> f64| {
            line(
                &points.iter().map(|point| (point.value as f64, figure(&point.measured))).collect::<Vec<_>>(),
            )
        };
        let fits = Fits {
            latency_p50_us: fit(|measured| measured.scan_to_actuation_us.p50),
            latency_p99_us: fit(|measured| measured.scan_to_actuation_us.p99),
            shared_memory_kib: fit(|measured| measured.shared_memory_kib as f64),
            memory_kib: fit(|measured| measured.memory_kib as f64),
            start_ms: fit(|measured| measured.start_ms),
        };
        let row = Row { series, points, fits };
        answer!(arguments.json, "{}", table(&row))?;
        results.series.push(row);
    }
    if arguments.json {
        data(&serde_json::to_string_pretty(&results)?)?;
    }
    Ok(console::exit::Exit::Done)
}

fn table(row: &Row) -> String {
    let name = format!("{:?}", row.series).to_lowercase();
    let right = Align::Right;
    let mut table = Table::new(&[
        (name.as_str(), Align::Left),
        ("p50 [us]", right),
        ("p99 [us]", right),
        ("lost", right),
        ("samples", right),
        ("missed", right),
        ("shm [KiB]", right),
        ("memory [KiB]", right),
        ("start [ms]", right),
    ]);
    for Point { value, measured } in &row.points {
        let Figures { p50, p99, .. } = measured.scan_to_actuation_us;
        table.row([
            value.to_string(),
            format!("{p50:.0}"),
            format!("{p99:.0}"),
            measured.lost.to_string(),
            measured.samples.to_string(),
            measured.missed.to_string(),
            measured.shared_memory_kib.to_string(),
            measured.memory_kib.to_string(),
            format!("{:.0}", measured.start_ms),
        ]);
    }
    let fits = [
        ("p50 [us]", &row.fits.latency_p50_us),
        ("p99 [us]", &row.fits.latency_p99_us),
        ("shm [KiB]", &row.fits.shared_memory_kib),
        ("memory [KiB]", &row.fits.memory_kib),
        ("start [ms]", &row.fits.start_ms),
    ];
    let lines = fits.iter().filter_map(|(figure, line)| Some((figure, (*line).as_ref()?)));
    lines.fold(table.to_string(), |text, (figure, line)| {
        let Line { intercept, slope, r_squared } = line;
        format!("{text}{figure} = {intercept:.1} + {slope:.6} per unit of {name}, r^2 = {r_squared:.2}\n")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_reach_the_sizes_that_the_bench_is_for() {
        let ends = Series::ALL.map(|series| {
            let shapes = series.shapes();
            (shapes[0].0, shapes[shapes.len() - 1].0)
        });
        assert_eq!(ends, [(5, 50), (15, 100), (1, 24), (64, 4_000_000)]);
    }
}
