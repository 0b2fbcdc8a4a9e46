//! Maps in the format of ROS `map_server`: a YAML file with the keys of the map, and its image, a PGM of form P5.
//!
//! `estimator.map` names one; its straight surfaces take the place of the key, so settings, recordings and other hosts need no
//! file. Of YAML, what `map_saver` of ROS and of ROS 2 writes is read: keys with a value, or with a list in brackets or below.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::str::FromStr;

use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use estimator::laser::grid::{Grid, GridCell, GridFrame, MAX_CELLS, RESOLUTION_M};
use estimator::laser::map::{DEVIATION, MAX_SURFACES, surfaces};
use toml::{Table, Value};

/// Largest origin [m], and its largest yaw [rad].
const ORIGIN: (f64, f64) = (1e4, 6.3);
/// A map is off by so much at most [m].
pub const MAX_DEVIATION_M: f64 = 1.0;
/// Thresholds that are written: `map_saver` has the same.
const THRESHOLDS: [f64; 2] = [0.196, 0.65];
/// Shades that it writes, of occupied, unknown and free cells.
const SHADES: [u8; 3] = [0, 205, 254];
/// Bytes of an image before its pixels, at most.
const HEADER_BYTES: usize = 4096;

/// Puts the surfaces of `estimator.map` into a system, where it has one; the file is looked for beside that of the system.
///
/// # Errors
/// A map that can't be read or used, with file and key; exit code 2.
pub(crate) fn read(system: &mut Table, system_file: &str) -> anyhow::Result<()> {
    let Some(estimator) = system.get_mut("estimator").and_then(Value::as_table_mut) else { return Ok(()) };
    let Some(map) = estimator.get("map").and_then(Value::as_str) else { return Ok(()) };
    if estimator.contains_key("surfaces") {
        let both = "either `map` or `surfaces`, not both";
        return Err(Failure::bad_input(format!(
            "{system_file}: estimator.map = {map} is not allowed: {both}"
        )));
    }
    let file = Path::new(system_file).with_file_name(map);
    let (grid, own_m) = read_file(&file)?;
    let found = surfaces(&grid);
    if found.is_empty() || found.len() > MAX_SURFACES {
        let allowed = format!("a map has 1 to {MAX_SURFACES}");
        return Err(Failure::bad_input(format!(
            "{}: {} straight surfaces are not allowed: {allowed}",
            file.display(),
            found.len()
        )));
    }
    estimator.remove("map");
    estimator.insert("surfaces".to_owned(), Value::try_from(found)?);
    let of_cell_m = grid.frame.resolution_m * DEVIATION;
    estimator.entry("map_deviation_m").or_insert(Value::Float(own_m.hypot(of_cell_m)));
    estimator.entry("surface_deviation_m").or_insert(Value::Float(of_cell_m));
    Ok(())
}

/// Reads a map with its image, and how far it may be off [m].
///
/// # Errors
/// A file that can't be read, with its name; a key that is missing or has a value that is not allowed; an image of another form or
/// size; exit code 2.
fn read_file(path: &Path) -> anyhow::Result<(Grid, f64)> {
    let refuse = |path: &Path, reason: String| Failure::bad_input(format!("{}: {reason}", path.display()));
    let text =
        user_file::read(path, TEXT_BYTES).map_err(|error| refuse(path, format!("estimator.map: {error}")))?;
    let keys = MapKeys::parse(&text).map_err(|reason| refuse(path, reason))?;
    let image = path.with_file_name(&keys.image);
    let limit = (MAX_CELLS + HEADER_BYTES) as u64;
    let bytes = user_file::read_bytes(&image, limit)
        .map_err(|error| refuse(path, format!("image = {}: {error}", keys.image)))?;
    let (size, pixels) = pgm(&bytes).map_err(|reason| refuse(&image, reason))?;
    Ok((keys.grid(size, pixels), keys.deviation_m))
}

/// The YAML file and the image of a map that may be off by `deviation_m`; `image` is the name of the latter.
pub fn written(grid: &Grid, deviation_m: f64, image: &str) -> [Vec<u8>; 2] {
    let GridFrame { resolution_m, origin: [x, y, yaw], size: [width, height] } = grid.frame;
    let [free, occupied] = THRESHOLDS;
    let text = format!(
        "image: {image}\nmode: trinary\nresolution: {resolution_m:?}\norigin: [{x:?}, {y:?}, {yaw:?}]\n\
         negate: 0\noccupied_thresh: {occupied}\nfree_thresh: {free}\n\
         # Standard deviation of where it is [m], for Scanloop:\ndeviation: {deviation_m:.4}\n"
    );
    let mut pixels = format!("P5\n# {resolution_m:?} m/pixel\n{width} {height}\n255\n").into_bytes();
    let shade = |cell: &GridCell| match cell {
        GridCell::Occupied => SHADES[0],
        GridCell::Unknown => SHADES[1],
        GridCell::Free => SHADES[2],
    };
    // The first row of an image is the upper one.
    pixels.extend(grid.cells.chunks(width.max(1)).rev().flatten().map(shade));
    [text.into_bytes(), pixels]
}

/// What a map says beside its image.
#[derive(Debug, Clone, PartialEq)]
struct MapKeys {
    image: String,
    resolution_m: f64,
    origin: [f64; 3],
    is_negated: bool,
    /// Below the first a cell is free, above the second occupied.
    thresholds: [f64; 2],
    /// Standard deviation of where it is [m]; a key of ours.
    deviation_m: f64,
}

impl MapKeys {
    /// The keys of a file, checked.
    fn parse(text: &str) -> Result<Self, String> {
        let keys = entries(text)?;
        let value = |key: &str| keys.get(key).cloned().ok_or_else(|| format!("the key {key} is missing"));
        let image = value("image")?;
        if image.is_empty() {
            return Err(refusal("image", "\"\"", "the name of a PGM file"));
        }
        let [low_m, high_m] = RESOLUTION_M;
        let resolution_m = number("resolution", &value("resolution")?, [low_m, high_m])?;
        let text = value("origin")?;
        let three = "three numbers [x, y, yaw]";
        let list = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
        let list: Vec<&str> = list.map(|list| list.split(',').map(str::trim).collect()).unwrap_or_default();
        let [x, y, yaw] = list[..] else { return Err(refusal("origin", &text, three)) };
        let place = |text: &str| number("origin", text, [-ORIGIN.0, ORIGIN.0]);
        let origin = [place(x)?, place(y)?, number("origin", yaw, [-ORIGIN.1, ORIGIN.1])?];
        let is_negated = match value("negate")?.as_str() {
            "0" | "false" => false,
            "1" | "true" => true,
            other => return Err(refusal("negate", other, "0 or 1")),
        };
        let thresholds = [
            number("free_thresh", &value("free_thresh")?, [0.0, 1.0])?,
            number("occupied_thresh", &value("occupied_thresh")?, [0.0, 1.0])?,
        ];
        if thresholds[0] >= thresholds[1] {
            return Err(refusal("free_thresh", thresholds[0], "less than occupied_thresh"));
        }
        match keys.get("mode").map_or("trinary", String::as_str) {
            "trinary" | "scale" => {}
            other => return Err(refusal("mode", other, "trinary or scale")),
        }
        let deviation_m = keys
            .get("deviation")
            .map_or(Ok(0.0), |text| number("deviation", text, [0.0, MAX_DEVIATION_M]))?;
        Ok(Self { image, resolution_m, origin, is_negated, thresholds, deviation_m })
    }

    /// The grid of an image of this size, whose pixels are from black, 0, to white, 1.
    fn grid(&self, size: [usize; 2], pixels: impl Iterator<Item = f64>) -> Grid {
        let [free, occupied] = self.thresholds;
        let cell = |shade: f64| match if self.is_negated { shade } else { 1.0 - shade } {
            share if share > occupied => GridCell::Occupied,
            share if share < free => GridCell::Free,
            _ => GridCell::Unknown,
        };
        let upper_first: Vec<GridCell> = pixels.map(cell).collect();
        let cells = upper_first.chunks(size[0]).rev().flatten().copied().collect();
        Grid { frame: GridFrame { resolution_m: self.resolution_m, origin: self.origin, size }, cells }
    }
}

fn refusal(key: &str, value: impl Display, allowed: impl Display) -> String {
    format!("{key} = {value} is not allowed: {allowed}")
}

/// A number between two others.
fn number(key: &str, text: &str, [low, high]: [f64; 2]) -> Result<f64, String> {
    let allowed = || format!("a number from {low} to {high}");
    // YAML has these names for what is no number.
    let value = f64::from_str(text).map_err(|_| refusal(key, text, allowed()))?;
    if (low..=high).contains(&value) { Ok(value) } else { Err(refusal(key, text, allowed())) }
}

/// The keys of a YAML file with their values, of a list in brackets on one line.
fn entries(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut found: BTreeMap<String, String> = BTreeMap::new();
    let mut last: Option<String> = None;
    for (index, line) in text.lines().enumerate() {
        let line = line.split(" #").next().unwrap_or_default().trim_end();
        let content = line.trim_start();
        if content.is_empty() || content.starts_with('#') || ["---", "..."].contains(&content) {
            continue;
        }
        let refuse = || format!("line {}: expected `KEY: VALUE`", index + 1);
        if let Some(item) = content.strip_prefix("- ") {
            let list = last.as_ref().and_then(|key| found.get_mut(key)).ok_or_else(refuse)?;
            let items = list.trim_start_matches('[').trim_end_matches(']');
            *list = if items.is_empty() { format!("[{item}]") } else { format!("[{items}, {item}]") };
            continue;
        }
        let (key, value) = content.split_once(':').ok_or_else(refuse)?;
        let value = value.trim();
        let quoted = ['"', '\''].iter().find_map(|quote| value.strip_prefix(*quote)?.strip_suffix(*quote));
        // Keys of tables below are none of the map.
        if line.len() == content.len() {
            found.insert(key.trim().to_owned(), quoted.unwrap_or(value).to_owned());
            last = Some(key.trim().to_owned());
        } else {
            last = None;
        }
    }
    Ok(found)
}

/// Width and height of a PGM of form P5, and its pixels from black, 0, to white, 1.
fn pgm(bytes: &[u8]) -> Result<([usize; 2], impl Iterator<Item = f64>), String> {
    const FORM: &str = "it is no PGM of form P5 with one byte a pixel, which map_saver writes";
    let mut at = 2;
    let mut next = || {
        while bytes.get(at).is_some_and(u8::is_ascii_whitespace) || bytes.get(at) == Some(&b'#') {
            let is_comment = bytes[at] == b'#';
            let rest = &bytes[at..];
            at += if is_comment {
                rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len())
            } else {
                1
            };
        }
        let digits =
            bytes.get(at..).unwrap_or_default().iter().take_while(|byte| byte.is_ascii_digit()).count();
        let digits = std::str::from_utf8(&bytes[at..at + digits]).unwrap_or_default();
        at += digits.len();
        digits.parse::<usize>().map_err(|_| FORM.to_owned())
    };
    if !bytes.starts_with(b"P5") {
        return Err(FORM.to_owned());
    }
    let (width, height, white) = (next()?, next()?, next()?);
    let pixels = bytes.get(at + 1..).unwrap_or_default();
    if !(1..=255).contains(&white) {
        return Err(FORM.to_owned());
    }
    let size = format!("{width} x {height}");
    match width.checked_mul(height) {
        Some(cells) if (1..=MAX_CELLS).contains(&cells) => {
            let count = pixels.len();
            if count != cells {
                return Err(format!("it has {count} pixels, where its header says {size}"));
            }
        }
        _ => return Err(format!("a size of {size} pixels is not allowed: 1 to {MAX_CELLS} together")),
    }
    let white = white as f64;
    Ok(([width, height], pixels.iter().map(move |pixel| f64::from(*pixel).min(white) / white)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `map_saver` of ROS writes it.
    const SAVED: &str = "image: room.pgm\nresolution: 0.050000\norigin: [-1.500000, 2.000000, 0.000000]\nnegate: 0\n\
        occupied_thresh: 0.65\nfree_thresh: 0.196\n\n";

    fn keys(from: &str, to: &str) -> Result<MapKeys, String> {
        assert!(SAVED.contains(from), "{from}");
        MapKeys::parse(&SAVED.replacen(from, to, 1))
    }

    #[test]
    fn what_map_saver_writes_is_read() {
        let expected = MapKeys {
            image: "room.pgm".to_owned(),
            resolution_m: 0.05,
            origin: [-1.5, 2.0, 0.0],
            is_negated: false,
            thresholds: [0.196, 0.65],
            deviation_m: 0.0,
        };
        assert_eq!(MapKeys::parse(SAVED), Ok(expected.clone()));
        let below = keys("[-1.500000, 2.000000, 0.000000]", "\n  - -1.5 # [m]\n- 2\n- 0");
        assert_eq!(below, Ok(expected.clone()));
        let of_ros_2 = keys("negate: 0", "mode: trinary\nnegate: false\nlayer:\n  image: other.pgm");
        assert_eq!(of_ros_2, Ok(expected.clone()));
        assert_eq!(keys("image: room.pgm", "---\n# A room.\nimage: \"room.pgm\""), Ok(expected));
    }

    #[test]
    fn a_key_that_is_missing_or_wrong_is_named_with_what_is_allowed() {
        for (from, to, message) in [
            ("0.050000", "0", "resolution = 0 is not allowed: a number from 0.005 to 1"),
            ("0.050000", "-0.05", "resolution = -0.05 is not"),
            ("0.050000", ".nan", "resolution = .nan is not"),
            ("0.050000", "NaN", "resolution = NaN is not"),
            ("0.050000", "50", "resolution = 50 is not"),
            ("0.050000", "5 cm", "resolution = 5 cm is not"),
            ("resolution", "resolutoin", "the key resolution is missing"),
            (", 0.000000]", "]", "origin = [-1.500000, 2.000000] is not allowed: three numbers"),
            ("[-1.500000, 2.000000, 0.000000]", "0.0", "origin = 0.0 is not allowed: three numbers"),
            ("2.000000", "nan", "origin = nan is not allowed: a number from -10000 to 10000"),
            ("0.000000]", "90]", "origin = 90 is not allowed: a number from -6.3 to 6.3"),
            ("negate: 0", "negate: 2", "negate = 2 is not allowed: 0 or 1"),
            ("0.196", "0.7", "free_thresh = 0.7 is not allowed: less than occupied_thresh"),
            ("0.65", "65", "occupied_thresh = 65 is not allowed: a number from 0 to 1"),
            ("negate", "mode: raw\nnegate", "mode = raw is not allowed: trinary or scale"),
            ("room.pgm", "", "image = \"\" is not allowed"),
            ("negate", "deviation: 1.5\nnegate", "deviation = 1.5 is not allowed: a number from 0 to 1"),
            ("image: ", "image ", "line 1: expected"),
        ] {
            let refused = keys(from, to).unwrap_err();
            assert!(refused.starts_with(message), "{refused}");
        }
    }

    #[test]
    fn an_image_of_another_form_or_size_is_refused() {
        let read = |bytes: &[u8]| pgm(bytes).map(|(size, pixels)| (size, pixels.collect::<Vec<_>>()));
        let expected = Ok(([3, 2], vec![0.0, 1.0, 0.0, 1.0, 0.0, 0.2]));
        assert_eq!(
            read(b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n3 2\n255\n\x00\xff\x00\xff\x00\x33"),
            expected
        );
        assert_eq!(read(b"P5 3 2 5 \x00\x05\x00\x05\x00\x01"), expected);
        for (bytes, message) in [
            (&b"P5\n3 2\n255\n\x00\xff\x00\xff\x00"[..], "it has 5 pixels, where its header says 3 x 2"),
            (b"P5\n3 2\n255\n\x00\xff\x00\xff\x00\x00\x00", "it has 7 pixels"),
            (b"P5\n3 2\n65535\n", "it is no PGM"),
            (b"P2\n1 1\n255\n0\n", "it is no PGM"),
            (b"\x89PNG\r\n", "it is no PGM"),
            (b"P5", "it is no PGM"),
            (b"", "it is no PGM"),
            (b"P5\n0 2\n255\n", "a size of 0 x 2 pixels is not allowed: 1 to 16777216 together"),
            (b"P5\n100000 100000\n255\n", "a size of 100000 x 100000"),
            (b"P5\n18446744073709551615 3\n255\n", "a size of 18446744073709551615 x 3"),
        ] {
            let refused = read(bytes).unwrap_err();
            assert!(refused.starts_with(message), "{refused}");
        }
    }

    #[test]
    fn what_is_written_is_read_again_and_the_first_row_of_an_image_is_the_upper_one() {
        use GridCell::{Free, Occupied, Unknown};
        let frame = GridFrame { resolution_m: 0.05, origin: [-0.1, 1e-7, 0.0], size: [3, 2] };
        let grid = Grid { frame, cells: vec![Occupied, Free, Unknown, Free, Free, Free] };
        let [text, image] = written(&grid, 0.08, "a.pgm");
        assert!(image.ends_with(b"3 2\n255\n\xfe\xfe\xfe\x00\xfe\xcd"), "{image:?}");
        let (size, pixels) = pgm(&image).unwrap();
        let keys = MapKeys::parse(std::str::from_utf8(&text).unwrap()).unwrap();
        assert_eq!((keys.grid(size, pixels), keys.deviation_m), (grid, 0.08));
        let negated = MapKeys { is_negated: true, ..keys };
        assert_eq!(negated.grid([1, 1], [1.0].into_iter()).cells, [Occupied]);
    }
}
