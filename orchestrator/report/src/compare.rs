//! Two recorded drives, or two sets of drives, aligned by way instead of time.
//!
//! A drive is what its robot did at stations every 10 cm along the course, each when it first came so far. So a drive
//! that waited is compared where it drove, and the wait counts as time. Figures of one drive a side have no interval.
//! With several they have one of 99 %: of the differences of drives with the same seed if both sides have the same
//! seeds, else of the difference of the means, with the degrees of freedom of the smaller side.

mod drive;

use std::path::{Path, PathBuf};

use console::exit::Failure;
use console::user_file;
use figures::{Align, Table, student};
use serde::Serialize;
use shared_types::Header;

use self::drive::{Drive, Station};
use crate::LatencyReport;
use crate::latency::reaction_ns;

/// Distance between stations [m].
pub(super) const STEP_M: f64 = 0.1;
/// Drives part where they differ by more than this across the course [m] or in speed [m/s].
const PART_M: f64 = 0.005;
const PART_MPS: f64 = 0.02;
/// A way has at most so many stations, evenly chosen.
const MAX_STATIONS: usize = 2000;
/// First bytes of a recording.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// How two drives, or two sets of drives, differ.
#[derive(Debug, Serialize)]
pub struct ComparedDrives {
    /// Number of drives of A and B.
    drives: [usize; 2],
    /// Whether drives of the same seed were compared.
    by_seed: bool,
    /// Where drives part; those of equal drives are missing.
    parts: Vec<Part>,
    figures: Vec<Figure>,
    /// Of A and B, no part of the answer as JSON.
    #[serde(skip)]
    ways: [Vec<ComparedWay>; 2],
}

/// A drive at its stations, for charts.
#[derive(Debug, Serialize)]
pub struct ComparedWay {
    /// The seed of its scenario.
    pub seed: Option<u64>,
    /// At each station: its place [m], position across the course [m], speed [m/s], desired steering angle [rad], clearance [m],
    /// and time from scan to actuation [ms], `null` where nothing is near or known.
    pub stations: Vec<[Option<f64>; 6]>,
    /// The answer to the scan of each station, where its stamps are those of a clock.
    #[serde(skip)]
    pub answers: Vec<Option<Header>>,
    /// Of the whole drive; `None` where time was simulated.
    #[serde(skip)]
    pub latency: Option<LatencyReport>,
}

/// Where two drives part.
#[derive(Debug, Serialize)]
struct Part {
    seed: Option<u64>,
    /// Place along the course [m].
    along_m: f64,
    /// The scans of A and B there.
    scans: [u64; 2],
    /// B minus A there.
    across_m: f64,
    speed_mps: f64,
    /// The largest distance across the course, and where [m].
    max_across_m: f64,
    max_along_m: f64,
}

/// One figure of both sides, means over their drives.
#[derive(Debug, Serialize)]
struct Figure {
    name: &'static str,
    /// Number of drives of A and B that have it: nothing may be near, and a drive that ends early has no ride.
    drives: [usize; 2],
    a: f64,
    b: f64,
    /// B minus A.
    difference: f64,
    interval: Option<[f64; 2]>,
}

/// Whether a file or folder is compared as drives.
pub fn is_drives(path: &Path) -> bool {
    let begins_so = || user_file::read_start(path, MAGIC.len() as u64).is_ok_and(|start| start == MAGIC);
    path.is_dir() || path.extension().is_some_and(|kind| kind == "mcap") || begins_so()
}

/// Compares the drives of two files or folders.
///
/// # Errors
/// A folder without recordings, a file that is none or has no drive; exit code 2.
pub fn compare(paths: [&Path; 2]) -> anyhow::Result<ComparedDrives> {
    let [mut a, mut b] = [side(paths[0])?, side(paths[1])?];
    let seeds = |side: &[Drive]| side.iter().map(|drive| drive.seed).collect::<Vec<_>>();
    [&mut a, &mut b].into_iter().for_each(|side| side.sort_by_key(|drive| drive.seed));
    let are_distinct = a.windows(2).all(|pair| pair[0].seed != pair[1].seed);
    let by_seed = a.len() > 1 && are_distinct && seeds(&a) == seeds(&b);
    let is_pair = a.len() == 1 && b.len() == 1;
    let pairs = a.iter().zip(&b).filter(|_| by_seed || is_pair);
    let parts = pairs.filter_map(|(a, b)| part(a, b)).collect();
    let figures = drive::FIGURES.iter().filter_map(|(name, value)| {
        let [mut a, mut b] = [&a, &b].map(|side| side.iter().map(value).collect::<Vec<Option<f64>>>());
        if by_seed {
            // Of a pair, either both have the figure or none.
            a.iter_mut()
                .zip(&mut b)
                .for_each(|(a, b)| [*a, *b] = a.zip(*b).map_or([None; 2], |(a, b)| [Some(a), Some(b)]));
        }
        let [a, b] = [a, b].map(|side| side.into_iter().flatten().collect::<Vec<f64>>());
        figure(name, &a, &b, by_seed)
    });
    Ok(ComparedDrives {
        drives: [a.len(), b.len()],
        by_seed,
        parts,
        figures: figures.collect(),
        ways: [&a, &b].map(|side| side.iter().map(way).collect()),
    })
}

fn way(drive: &Drive) -> ComparedWay {
    let rounded = |value: f64| (value * 1e4).round() / 1e4;
    let row = |station: &Station| {
        let Station { along_m, across_m, speed_mps, steering_rad, clearance_m, answer, .. } = *station;
        let reaction_ms = answer.and_then(|header| reaction_ns(&header)).map(|ns| ns as f64 * 1e-6);
        [Some(along_m), Some(across_m), Some(speed_mps), steering_rad, clearance_m, reaction_ms]
            .map(|value| value.map(rounded).filter(|value| value.is_finite()))
    };
    let step = drive.stations.len().div_ceil(MAX_STATIONS).max(1);
    let shown = || drive.stations.values().step_by(step);
    ComparedWay {
        seed: drive.seed,
        stations: shown().map(row).collect(),
        answers: shown().map(|station| station.answer).collect(),
        latency: drive.latency.clone(),
    }
}

/// The drives of a file, or of the recordings in a folder and the folders in it.
fn side(path: &Path) -> anyhow::Result<Vec<Drive>> {
    let mut files = vec![path.to_owned()];
    if path.is_dir() {
        files =
            recordings(path).map_err(|error| Failure::bad_input(format!("{}: {error}", path.display())))?;
    }
    if files.is_empty() {
        return Err(Failure::bad_input(format!("{}: it holds no recording, *.mcap", path.display())));
    }
    files.iter().map(|file| Drive::read(file)).collect()
}

fn recordings(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let entries = |folder: &Path| -> std::io::Result<Vec<PathBuf>> {
        std::fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect()
    };
    let mut found = Vec::new();
    for path in entries(folder)? {
        if path.is_dir() { found.extend(entries(&path)?) } else { found.push(path) }
    }
    found.retain(|path| path.is_file() && path.extension().is_some_and(|kind| kind == "mcap"));
    found.sort();
    Ok(found)
}

/// Where two drives part; `None` for drives that do not.
fn part(a: &Drive, b: &Drive) -> Option<Part> {
    let pairs: Vec<(&Station, &Station)> =
        a.stations.iter().filter_map(|(place, station)| Some((station, b.stations.get(place)?))).collect();
    let across = |(a, b): &(&Station, &Station)| b.across_m - a.across_m;
    let differs = |pair: &&(&Station, &Station)| {
        across(pair).abs() > PART_M || (pair.1.speed_mps - pair.0.speed_mps).abs() > PART_MPS
    };
    let first = pairs.iter().find(differs)?;
    let largest = pairs.iter().max_by(|one, other| across(one).abs().total_cmp(&across(other).abs()))?;
    Some(Part {
        seed: a.seed,
        along_m: first.0.along_m,
        scans: [first.0.scan_id, first.1.scan_id],
        across_m: across(first),
        speed_mps: first.1.speed_mps - first.0.speed_mps,
        max_across_m: across(largest),
        max_along_m: largest.0.along_m,
    })
}

/// A figure of each drive of both sides, and the interval of its difference.
fn figure(name: &'static str, a: &[f64], b: &[f64], by_seed: bool) -> Option<Figure> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let squared_error = |values: &[f64]| {
        let squares: f64 = values.iter().map(|value| (value - mean(values)).powi(2)).sum();
        squares / (values.len() - 1) as f64 / values.len() as f64
    };
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let difference = mean(b) - mean(a);
    let fewest = a.len().min(b.len());
    let half = (fewest > 1).then(|| {
        let squared = if by_seed {
            squared_error(&a.iter().zip(b).map(|(a, b)| b - a).collect::<Vec<_>>())
        } else {
            squared_error(a) + squared_error(b)
        };
        student(fewest - 1) * squared.sqrt()
    });
    let interval = half.map(|half| [difference - half, difference + half]);
    Some(Figure { name, drives: [a.len(), b.len()], a: mean(a), b: mean(b), difference, interval })
}

impl ComparedDrives {
    /// The ways of A and B.
    pub fn ways(&self) -> &[Vec<ComparedWay>; 2] {
        &self.ways
    }
}

/// Where the drives part, in a sentence each.
pub fn sentences(drives: &ComparedDrives) -> Vec<String> {
    let ComparedDrives { drives: [a, b], by_seed, parts, figures, .. } = drives;
    let is_equal = parts.is_empty() && figures.iter().all(|figure| figure.difference == 0.0);
    let mut lines = Vec::new();
    match (a, b) {
        (1, 1) if is_equal => lines.push("equal: the same way, speed and figures".to_owned()),
        (1, 1) if parts.is_empty() => {
            lines.push(format!("they do not part by more than {PART_M} m or {PART_MPS} m/s"));
        }
        (1, 1) => {}
        _ if *by_seed => lines.push(format!("{a} drives each, by seed; {} of them part", parts.len())),
        _ => {
            lines.push(format!("{a} and {b} drives, not of the same seeds: where they part is not compared"));
        }
    }
    for Part { seed, along_m, scans: [a, b], across_m, speed_mps, max_across_m, max_along_m } in parts {
        let seed = seed.filter(|_| *by_seed).map_or(String::new(), |seed| format!("seed {seed}: "));
        lines.push(format!(
            "{seed}they part at {along_m:.1} m (scan {a} of A, {b} of B): B {}, {}; farthest at {max_along_m:.1} m: {}",
            aside(*across_m),
            faster(*speed_mps),
            aside(*max_across_m)
        ));
    }
    lines
}

/// The comparison as text.
pub fn text(drives: &ComparedDrives) -> String {
    let (mut lines, figures) = (sentences(drives), &drives.figures);
    let right = |name| (name, Align::Right);
    let heads = [("figure", Align::Left), right("A"), right("B"), right("B - A"), right("99 %")];
    let mut table = Table::new(&heads);
    for Figure { name, drives: of, a, b, difference, interval } in figures {
        let number = |value: &f64| format!("{value:.3}");
        let interval = interval.map_or(String::new(), |[low, high]| format!("{low:.3} to {high:.3}"));
        let [some_a, some_b] = *of;
        let of = if *of == drives.drives { String::new() } else { format!(", of {some_a} and {some_b}") };
        table.row([format!("{name}{of}"), number(a), number(b), format!("{difference:+.3}"), interval]);
    }
    lines.push(table.to_string().trim_end().to_owned());
    lines.join("\n")
}

fn aside(across_m: f64) -> String {
    format!("{:.2} m farther {}", across_m.abs(), if across_m < 0.0 { "right" } else { "left" })
}

fn faster(speed_mps: f64) -> String {
    format!("{:.2} m/s {}", speed_mps.abs(), if speed_mps < 0.0 { "slower" } else { "faster" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(seed: u64, across_m: impl Fn(f64) -> f64) -> Drive {
        let station = |place: i64| {
            let along_m = place as f64 * STEP_M;
            let (across_m, scan_id) = (across_m(along_m), place as u64 + 1);
            (place, Station { scan_id, along_m, across_m, speed_mps: 0.5, ..Station::default() })
        };
        Drive { seed: Some(seed), stations: (0..=100).map(station).collect(), ..Drive::default() }
    }

    #[test]
    fn drives_part_where_they_first_differ() {
        let (a, b) = (drive(1, |_| 0.0), drive(1, |along_m| 0.1 * (along_m - 4.0).max(0.0)));
        let part = part(&a, &b).unwrap();
        // 5 mm are exceeded at the station after 4 m, by 1 cm.
        assert!((4.05..4.15).contains(&part.along_m), "{part:?}");
        assert_eq!(part.scans[0], part.scans[1]);
        assert!((part.max_along_m - 10.0).abs() < 1e-9 && (part.max_across_m - 0.6).abs() < 1e-9);
        assert!(super::part(&a, &a).is_none());
    }

    #[test]
    fn differences_of_the_same_seeds_have_the_narrower_interval() {
        let (a, b) = ([1.0, 2.0, 3.0], [1.1, 2.2, 3.3]);
        let [paired, apart] = [true, false].map(|by_seed| figure("", &a, &b, by_seed).unwrap());
        assert!((paired.difference - 0.2).abs() < 1e-12 && (apart.difference - 0.2).abs() < 1e-12);
        // The standard error of 0.1, 0.2, 0.3 is 0.1 / sqrt 3; its factor for two degrees of freedom is 9.925.
        let half = 9.925 * 0.1 / 3.0_f64.sqrt();
        let [low, high] = paired.interval.unwrap();
        assert!((low - 0.2 + half).abs() < 1e-9 && (high - 0.2 - half).abs() < 1e-9);
        assert!(apart.interval.unwrap()[1] > high);
        assert!(figure("", &a[..1], &b[..1], false).unwrap().interval.is_none());
        // A figure that a drive lacks is that of the others.
        let some = figure("", &a, &b[..2], false).unwrap();
        assert!(some.drives == [3, 2] && some.interval.is_some(), "{some:?}");
    }
}
