//! `scanloop report`: the page with a recording enclosed in it, as one file that opens without a server.
//!
//! The scripts are those of the live page, but for their source: `enclosed.js` stands for `link.js`. What the page shows
//! over time, its rows, is enclosed of each scan, in steps of the resolution in [`COLUMNS`]. Frames, with scan, plan and
//! obstacles, are larger: they are enclosed of each scan too where they fit into [`MAX_BYTES`], else of as many scans as
//! fit, at equal distances, and of those at which something happened. Ranges are rounded to 1 cm, plans to 1 mm, latencies to 1 us.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use replay::NearDrive;
use replay::why::{Why, told_by_samples, why};
use report::compare::{ComparedWay, compare, sentences};
use serde_json::{Value, json};

use crate::events::Event;
use crate::frame::latency;
use crate::history::Row;
use crate::pages;
use crate::recorded::RecordedDrive;

/// The largest file [bytes].
const MAX_BYTES: usize = 3_000_000;
/// Rows of a longer recording than two hours at 10 Hz stand for some scans each.
const MAX_ROWS: usize = 72_000;
/// So many frames tell how large one is.
const TRIED: usize = 64;
/// Frames that are enclosed because something happened, at most.
const MAX_HAPPENED: usize = 300;
/// So many whole answers of `why` are enclosed, for which the controller computes again: of all scans, in a longer drive of
/// those at which something happened.
const MAX_ASKED: usize = 200;
/// So many rows before an event the scan is looked for that it answers.
const MAX_BEFORE: usize = 20;

/// Name, values per unit, and value of a column of rows.
type Column = (&'static str, f64, fn(&Row) -> f64);

const COLUMNS: &[Column] = &[
    ("number", 1.0, |row| row.number as f64),
    ("time_s", 1e3, |row| row.time_s),
    ("scan_id", 1.0, |row| row.scan_id as f64),
    ("x_m", 1e3, |row| row.x_m),
    ("y_m", 1e3, |row| row.y_m),
    ("yaw_rad", 1e3, |row| row.yaw_rad),
    ("true_x_m", 1e3, |row| row.true_x_m),
    ("true_y_m", 1e3, |row| row.true_y_m),
    ("speed_mps", 1e3, |row| row.speed_mps),
    ("desired_velocity_mps", 1e3, |row| row.desired_velocity_mps),
    ("desired_steering_rad", 1e4, |row| row.desired_steering_rad),
    ("clearance_m", 1e3, |row| row.clearance_m),
    ("margin_m", 1e3, |row| row.margin_m),
    ("reaction_us", 1.0, |row| row.reaction_us),
    ("blocked", 1.0, |row| f64::from(row.blocked)),
];

/// Arguments of `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArguments {
    /// The recording.
    #[arg(value_name = "FILE", required_unless_present = "compare")]
    pub file: Option<PathBuf>,
    /// Compare two recordings, or two folders of them, along their way instead: charts of both, where they part, and the figures
    /// of `compare` in one page.
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "file")]
    pub compare: Vec<PathBuf>,
    /// The page; without it `drive.html`, or `compare.html`.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace a file of that name.
    #[arg(long)]
    pub force: bool,
}

/// Writes the page with a recording in it.
///
/// # Errors
/// A recording that can't be read, or has no scan of a drive; a page that exists or can't be written; exit code 2.
pub fn report(arguments: &ReportArguments) -> anyhow::Result<Exit> {
    let ReportArguments { file, compare, out, force } = arguments;
    let inputs: Vec<&Path> = file.iter().chain(compare).map(PathBuf::as_path).collect();
    let default = if compare.is_empty() { "drive.html" } else { "compare.html" };
    let out = out.as_deref().unwrap_or(Path::new(default));
    // Before the work: whether it may be written.
    let files: Vec<&Path> = inputs.iter().copied().filter(|input| !input.is_dir()).collect();
    let mut page = NewFile::create(out, Existing::forced(*force), &files)?;
    let (text, what) = match inputs[..] {
        [a, b] => (compared([a, b])?, "drives compared".to_owned()),
        _ => {
            let Enclosed { text, rows, frames } = enclosed(inputs[0])?;
            (text, format!("{rows} scans, {frames} of them with map and plan"))
        }
    };
    page.write_all(text.as_bytes())?;
    page.finish()?;
    answer!(false, "{}: {:.2} MB, {what}", out.display(), text.len() as f64 * 1e-6)?;
    Ok(Exit::Done)
}

/// The page of two drives, or two sets of them, along their way.
fn compared(paths: [&Path; 2]) -> anyhow::Result<String> {
    let compared = compare(paths)?;
    let names = paths.map(|path| path.display().to_string());
    let mut content = json!({
        "names": names, "sentences": sentences(&compared), "compared": compared, "ways": compared.ways(),
    });
    // Stage by stage, of the drive of each side whose values are shown at a place.
    for (side, ways) in compared.ways().iter().enumerate() {
        let Some(ComparedWay { answers, latency: Some(whole), .. }) = ways.first() else { continue };
        let scans: Vec<Option<Value>> = answers.iter().map(|answer| latency(answer.as_ref()?)).collect();
        let shown = &mut content["ways"][side][0];
        (shown["scans"], shown["latency_us"]) = (json!(scans), json!(whole));
        round(&mut shown["scans"], 1.0);
    }
    Ok(pages::compared(&packed(&content)?))
}

/// A page, and what is in it.
struct Enclosed {
    text: String,
    rows: usize,
    frames: usize,
}

fn enclosed(file: &Path) -> anyhow::Result<Enclosed> {
    let mut drive = RecordedDrive::open(file)?;
    let rows = drive.rows(MAX_ROWS);
    let rest = json!({
        "system": drive.system(), "events": drive.events(),
        "columns": COLUMNS.iter().map(|column| steps(&rows, column)).collect::<Vec<_>>(),
    });
    let whole = |frames: &[(usize, Value)]| -> anyhow::Result<String> {
        let mut content = rest.clone();
        content["frames"] = json!(frames);
        Ok(pages::enclosed(&packed(&content)?))
    };
    let smallest = whole(&[])?.len();
    let happened = happened(&rows, drive.events());
    let asked: Vec<usize> =
        if rows.len() <= MAX_ASKED { (0..rows.len()).collect() } else { happened.iter().copied().collect() };
    let mut reasons = Reasons::new(file, asked.into_iter().map(|index| rows[index].scan_id));
    let mut frames_at = |indices: &mut dyn Iterator<Item = usize>| -> anyhow::Result<Vec<(usize, Value)>> {
        let frame = |index: usize| {
            let mut frame = slim(drive.frame(rows[index].time_s)?);
            frame["why"] = reasons.of(rows[index].scan_id);
            Ok((index, frame))
        };
        indices.map(frame).collect()
    };
    let tried = frames_at(&mut (0..rows.len()).step_by(rows.len().div_ceil(TRIED)))?;
    let bytes_each = (whole(&tried)?.len() - smallest) as f64 / tried.len() as f64;
    let mut room = MAX_BYTES.saturating_sub(smallest) as f64 * 0.95;
    while room > bytes_each {
        let regular = (room / bytes_each - happened.len() as f64).max(1.0);
        let step = (rows.len() as f64 / regular).ceil().max(1.0) as usize;
        let mut chosen = happened.clone();
        chosen.extend((0..rows.len()).step_by(step));
        let frames = frames_at(&mut chosen.into_iter())?;
        let text = whole(&frames)?;
        if text.len() <= MAX_BYTES {
            return Ok(Enclosed { text, rows: rows.len(), frames: frames.len() });
        }
        room *= 0.9;
    }
    let reason = format!("its page would be larger than {MAX_BYTES} bytes");
    let cut = "`scanloop recording cut` makes a shorter recording";
    Err(Failure::bad_input(format!("{}: {reason}; {cut}", file.display())))
}

/// The answers of `why`.
struct Reasons {
    /// `None` for recordings that can't be asked: several that were joined, or of a system without settings.
    drive: Option<NearDrive>,
    whole: BTreeMap<u64, Why>,
}

impl Reasons {
    /// Asks for scans.
    fn new(file: &Path, scans: impl Iterator<Item = u64>) -> Self {
        let mut drive = NearDrive::open(file, true).ok();
        let answer = |scan| Some((scan, why(drive.as_mut()?.near(scan).ok()?, scan).ok()?));
        let whole = scans.take(MAX_ASKED).filter_map(answer).collect();
        Self { drive, whole }
    }

    /// The answer for a scan: whole, or what its samples tell.
    fn of(&mut self, scan: u64) -> Value {
        let json = |why: &Why, is_short| {
            let sentences: Vec<_> = why.sentences.iter().map(|told| (told.about, &told.text)).collect();
            json!({ "sentences": sentences, "is_short": is_short })
        };
        if let Some(why) = self.whole.get(&scan) {
            return json(why, false);
        }
        let near = self.drive.as_mut().and_then(|drive| drive.near(scan).ok());
        let told = near.and_then(|drive| told_by_samples(drive, scan));
        told.map_or(Value::Null, |why| json(&why, true))
    }
}

/// The rows at which something happened: an event, its scan, or wheels that were blocked or set free.
fn happened(rows: &[Row], events: &[Event]) -> BTreeSet<usize> {
    let at = |event: &Event| {
        rows.partition_point(|row| row.time_s < event.time_s).min(rows.len().saturating_sub(1))
    };
    let scan = |event: &Event| {
        let first = at(event).saturating_sub(MAX_BEFORE);
        let found = rows[first..=at(event)].iter().position(|row| Some(row.scan_id) == event.scan_id);
        found.map(|place| first + place)
    };
    let changes = rows.windows(2).zip(1..).filter(|(pair, _)| pair[0].blocked != pair[1].blocked);
    let all: BTreeSet<usize> = events
        .iter()
        .flat_map(|event| [Some(at(event)), scan(event)])
        .flatten()
        .chain(changes.map(|(_, index)| index))
        .collect();
    let step = all.len().div_ceil(MAX_HAPPENED).max(1);
    all.into_iter().step_by(step).collect()
}

/// A column as steps from row to row, `null` where nothing is known.
fn steps(rows: &[Row], (name, per_unit, value): &Column) -> Value {
    let mut before = 0;
    let mut step = |row| {
        let value = value(row);
        let rounded = value.is_finite().then_some((value * per_unit).round() as i64);
        rounded.map(|rounded| rounded - std::mem::replace(&mut before, rounded))
    };
    json!({ "name": name, "per_unit": per_unit, "steps": rows.iter().map(&mut step).collect::<Vec<_>>() })
}

/// A frame without what its row has, and without digits that no pixel shows.
fn slim(mut frame: Value) -> Value {
    if let Some(frame) = frame.as_object_mut() {
        frame.remove("row");
    }
    if let Some(scan) = frame["scan"].as_object_mut() {
        let ranges = scan.remove("ranges_mm_base64").unwrap_or_default();
        let bytes = STANDARD.decode(ranges.as_str().unwrap_or_default()).unwrap_or_default();
        let mut before = 0;
        let step = |range: &[u8]| {
            // A range below 20 mm is none.
            let cm = (i32::from(u16::from_le_bytes([range[0], range[1]])).min(65_530) + 5) / 10;
            cm - std::mem::replace(&mut before, cm)
        };
        scan.insert("steps_cm".to_owned(), bytes.chunks_exact(2).map(step).collect());
    }
    for node in frame["command"]["plan"].as_array_mut().into_iter().flatten().filter_map(Value::as_array_mut)
    {
        // Only the place is drawn.
        node.truncate(2);
    }
    round(&mut frame["command"]["plan"], 1e3);
    round(&mut frame["latency_us"], 1.0);
    round(&mut frame["system"], 1e1);
    round(&mut frame["pose"]["covariance_m2"], 1e7);
    frame
}

/// Rounds all numbers in a value that are not whole.
fn round(value: &mut Value, per_unit: f64) {
    match value {
        Value::Number(number) if number.is_f64() => {
            *value = json!(number.as_f64().map(|number| (number * per_unit).round() / per_unit));
        }
        Value::Array(values) => values.iter_mut().for_each(|value| round(value, per_unit)),
        Value::Object(values) => values.values_mut().for_each(|value| round(value, per_unit)),
        _ => {}
    }
}

/// A value as compressed JSON in letters.
fn packed(value: &Value) -> anyhow::Result<String> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    serde_json::to_writer(&mut encoder, value)?;
    Ok(STANDARD.encode(encoder.finish()?))
}

#[cfg(test)]
mod tests;
