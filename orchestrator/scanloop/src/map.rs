//! `scanloop map`: an occupancy grid from the scans and estimates of a recording.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile, finish_all};
use estimator::laser::grid::{Drawing, GridCell, GridFrame, MAX_CELLS, MapDeviation, RESOLUTION_M, beams};
use estimator::laser::map::{MAX_SURFACES, surfaces};
use nalgebra::Vector2;
use plan::map_file::{self, MAX_DEVIATION_M};
use recording::Recording;
use recording::mcap::Contents;
use recording::read::attachment;
use runtime::{settings_file, settings_table};
use shared_types::{Pose, Role, Scan, Suspect, Topic};
use toml::Table;
use vehicle::{Description, read};

/// Scans that wait for their estimate, at most.
const WAITING: usize = 64;

/// Arguments of `map`.
#[derive(Debug, Args)]
pub struct MapArguments {
    /// The recording.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Name of the map: NAME.yaml and NAME.pgm are written.
    #[arg(short, long, value_name = "NAME", default_value = "map")]
    pub out: PathBuf,
    /// Side of a cell [m].
    #[arg(long, value_name = "M", default_value_t = 0.025)]
    pub resolution: f64,
    /// Replace files of these names.
    #[arg(long)]
    pub force: bool,
}

/// Draws the scans of a recording, seen from the recorded estimates.
///
/// # Errors
/// A recording that can't be read or has no scan with an estimate, a map that is too large; exit code 2.
pub(crate) fn map(arguments: &MapArguments) -> anyhow::Result<Exit> {
    let MapArguments { file, out, resolution, force } = arguments;
    let [low, high] = RESOLUTION_M;
    if !(low..=high).contains(resolution) {
        return Err(Failure::bad_input(format!(
            "--resolution = {resolution} is not allowed: {low} to {high}"
        )));
    }
    let refuse = |reason: String| Failure::bad_input(format!("{}: {reason}", file.display()));
    let name = out.file_name().filter(|_| out.extension().is_none_or(|last| last != "pgm"));
    let Some(name) = name.and_then(OsStr::to_str) else {
        let allowed = "a name in UTF-8, to which .yaml and .pgm are added";
        return Err(Failure::bad_input(format!("--out = {} is not allowed: {allowed}", out.display())));
    };
    let stem = name.strip_suffix(".yaml").unwrap_or(name);
    let image = format!("{stem}.pgm");
    let paths = [format!("{stem}.yaml"), image.clone()].map(|name| out.with_file_name(name));
    let create = |path: &PathBuf| NewFile::create(path, Existing::forced(*force), &[file]);
    let mut files = paths.iter().map(create).collect::<anyhow::Result<Vec<_>>>()?;

    let corners = [f64::INFINITY, f64::NEG_INFINITY].map(Vector2::repeat);
    let ([mut first, mut last], mut views) = (corners, 0);
    let mut deviation = MapDeviation::default();
    each_view(file, |scan, pose, robot| {
        views += 1;
        deviation.see(pose);
        for place in beams(scan, pose, robot).flatten() {
            (first, last) = (first.inf(&place), last.sup(&place));
        }
    })?;
    if first.x > last.x {
        return Err(refuse("no scan with returns has an estimate: nothing can be drawn".to_owned()));
    }
    let Some(frame) = GridFrame::around(first, last, *resolution) else {
        let extent = last - first;
        return Err(refuse(format!(
            "its scans reach over {:.0} m by {:.0} m: more than {MAX_CELLS} cells with --resolution = {resolution}",
            extent.x, extent.y
        )));
    };
    let mut drawing = Drawing::new(frame);
    each_view(file, |scan, pose, robot| {
        beams(scan, pose, robot).for_each(|[from, to]| drawing.beam(from, to));
    })?;
    let (grid, deviation_m) = (drawing.grid(), deviation.root_m().min(MAX_DEVIATION_M));
    for (file, content) in files.iter_mut().zip(map_file::written(&grid, deviation_m, &image)) {
        file.write_all(&content)?;
    }
    finish_all(files)?;
    let [width, height] = frame.size;
    let occupied = grid.cells.iter().filter(|cell| **cell == GridCell::Occupied).count();
    let count = surfaces(&grid).len();
    let more =
        if count > MAX_SURFACES { format!(" (`estimator.map` takes {MAX_SURFACES})") } else { String::new() };
    answer!(
        false,
        "{}: {width} x {height} cells of {resolution} m, {occupied} occupied, {count} straight surfaces{more}, from {views} scans; off by {deviation_m:.3} m",
        paths[0].display()
    )?;
    Ok(Exit::Done)
}

/// Hands over the scans of a recording with the estimates of their poses and the robots of their files, without those of a robot
/// that did not know where it was.
fn each_view(path: &Path, mut take: impl FnMut(&Scan, &Pose, &Description)) -> anyhow::Result<()> {
    let mut recording = Recording::open(path)?;
    let robots = recording.files().iter().map(|contents| described(path, contents));
    let robots = robots.collect::<anyhow::Result<Vec<_>>>()?;
    let mut waiting: BTreeMap<(usize, u64), Box<Scan>> = BTreeMap::new();
    recording.samples(|_, sample| {
        let file = sample.file;
        match sample.topic {
            Topic::Scan => {
                let scan: &Scan = bytemuck::from_bytes(sample.bytes);
                if !scan.missing.is_set() {
                    waiting.insert((file, scan.header.scan_id), Box::new(*scan));
                }
                if waiting.len() > WAITING {
                    waiting.pop_first();
                }
            }
            Topic::Pose => {
                let pose: &Pose = bytemuck::from_bytes(sample.bytes);
                let scan = waiting.remove(&(file, pose.header.scan_id));
                let scan = scan.filter(|_| pose.suspect != Suspect::Position.wire());
                if let Some(scan) = scan {
                    take(&scan, pose, &robots[file]);
                }
            }
            _ => {}
        }
        Ok(())
    })
}

/// The robot as the recorded estimator was told of it.
fn described(path: &Path, contents: &Contents) -> anyhow::Result<Description> {
    let name = settings_file(Role::Estimator);
    let refuse = |reason: String| Failure::bad_input(format!("{}: {name}: {reason}", path.display()));
    let text = attachment(contents, &name)
        .ok_or_else(|| refuse("it is missing: no recording of a drive".to_owned()))?;
    let table: Table = text.parse().map_err(|error| refuse(format!("{error}")))?;
    let vehicle = table.get(settings_table(Role::Estimator)).and_then(|own| own.get("vehicle")?.as_table());
    read(vehicle.cloned().unwrap_or_default()).map_err(|invalid| refuse(invalid.to_string()))
}
