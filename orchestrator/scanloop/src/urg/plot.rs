//! `scanloop urg plot`: scans as pictures of Braille characters, seen from above.

use std::fmt::Write as _;
use std::io::IsTerminal;

use console::exit::{Exit, Failure};
use console::output::redraw;
use rustix::termios::tcgetwinsize;
use shared_types::{BEAMS, FRONT_BEAM, MIN_RANGE_MM, Scan, ScanGeometry};
use urg::Reading;

use super::arguments::PlotArguments;
use super::scanner::Scanner;

/// Size of the picture where the terminal's is unknown [characters].
const SIZE: (usize, usize) = (72, 24);
/// Dots of a character, in columns and rows.
const DOTS: (usize, usize) = (2, 4);
/// Bit of each dot of a Braille character, by row and column.
const BITS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];

/// Draws scans until the end.
pub(super) fn plot(arguments: &PlotArguments) -> anyhow::Result<Exit> {
    if !(0.1..=100.0).contains(&arguments.range) {
        return Err(Failure::bad_input(format!("--range {} is not allowed: 0.1 to 100", arguments.range)));
    }
    let mut scanner = Scanner::open(&arguments.scanner)?;
    let mut scan = Scan::of(ScanGeometry::URG_04LX);
    let mut count = 0;
    while let Some(reading) = scanner.next(&mut scan)? {
        count += 1;
        let is_terminal = std::io::stdout().is_terminal();
        let (columns, rows) = if is_terminal { terminal_size() } else { SIZE };
        let picture = format!(
            "{}\n{}",
            headline(&reading, &scan, count),
            picture(&scan, arguments.range, columns, rows)
        );
        if !redraw(&picture)? {
            break;
        }
    }
    let counters = scanner.source().counters();
    console::note!("{} scans, {} damaged, {} restarts", counters.scans, counters.broken, counters.restarts);
    Ok(if count > 0 { Exit::Done } else { Exit::NotReached })
}

/// Room for the picture, without the headline [characters].
fn terminal_size() -> (usize, usize) {
    let size = tcgetwinsize(std::io::stdout()).ok().filter(|size| size.ws_col > 0 && size.ws_row > 0);
    size.map_or(SIZE, |size| (usize::from(size.ws_col).min(200), usize::from(size.ws_row.max(4) - 2).min(80)))
}

fn headline(reading: &Reading, scan: &Scan, count: u64) -> String {
    if reading.is_missing {
        return format!("scan {count}: damaged on the way");
    }
    let valid = scan.ranges().iter().filter(|range| **range >= MIN_RANGE_MM).count();
    let ahead = match scan.range_m(FRONT_BEAM) {
        Some(range) => format!("{range:.3} m ahead"),
        None => format!("no return ahead (code {})", scan.ranges_mm[FRONT_BEAM]),
    };
    let share = 100 * valid / BEAMS;
    format!(
        "scan {count}: {ahead}, {share} % of the beams return, stamp within {:.1} ms",
        reading.error_ns as f64 * 1e-6
    )
}

/// The returns of a scan: ahead is up, the scanner is `o`.
fn picture(scan: &Scan, range_m: f64, columns: usize, rows: usize) -> String {
    let mut dots = vec![0_u8; columns * rows];
    // Dots are square; the scanner stands where both sides and the front have `range_m`.
    let dots_per_m = (columns * DOTS.0) as f64 / (2.0 * range_m);
    let dots_per_m = dots_per_m.min((rows * DOTS.1) as f64 / (1.5 * range_m));
    let centre = ((columns * DOTS.0) as f64 / 2.0, range_m * dots_per_m);
    for (beam, range) in (0..BEAMS).filter_map(|beam| scan.range_m(beam).map(|range| (beam, range))) {
        let yaw = scan.beam_yaw_rad(beam);
        let (x, y) = (centre.0 - range * yaw.sin() * dots_per_m, centre.1 - range * yaw.cos() * dots_per_m);
        if x >= 0.0 && y >= 0.0 && x < (columns * DOTS.0) as f64 && y < (rows * DOTS.1) as f64 {
            let (x, y) = (x as usize, y as usize);
            dots[y / DOTS.1 * columns + x / DOTS.0] |= BITS[y % DOTS.1][x % DOTS.0];
        }
    }
    let at = (centre.1 as usize / DOTS.1).min(rows - 1) * columns + columns / 2;
    let mut text = String::new();
    for (row, line) in dots.chunks(columns).enumerate() {
        let characters = line.iter().enumerate().map(|(column, bits)| match bits {
            _ if row * columns + column == at => 'o',
            0 => ' ',
            bits => char::from_u32(0x2800 + u32::from(*bits)).unwrap_or('?'),
        });
        let _ = writeln!(text, "{}", characters.collect::<String>().trim_end());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_ahead_is_drawn_above_the_scanner() {
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        for (beam, range) in scan.ranges_mut().iter_mut().enumerate() {
            let forward = ScanGeometry::URG_04LX.yaw_rad(beam).cos();
            *range = if forward > 0.5 { (1000.0 / forward) as u32 } else { 0 };
        }
        let text = picture(&scan, 2.0, 40, 15);
        let lines: Vec<&str> = text.lines().collect();
        let wall = lines.iter().position(|line| !line.trim().is_empty()).unwrap();
        let scanner = lines.iter().position(|line| line.contains('o')).unwrap();
        // 20 dots a metre: 4 of them are a row.
        assert_eq!((wall, scanner, lines.len()), (5, 10, 15), "\n{text}");
        assert!(lines[wall].trim().chars().count() > 12, "\n{text}");
    }
}
