//! Why the robot did what it did: the answer of `scanloop why` in the picture.

/// Columns of what a sentence is about.
const ABOUT: usize = 11;

/// An answer that is shown.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Reasons {
    /// The scan that was asked about.
    pub(super) scan: u64,
    /// The lines of the answer; none while it is not there.
    pub(super) lines: Vec<String>,
}

impl Reasons {
    /// What the key asks about next: the last stop, then the newest scan, then nothing.
    pub(super) fn next(shown: Option<&Self>, stop: Option<u64>, newest: u64) -> Option<u64> {
        match (shown, stop) {
            (None, Some(stop)) => Some(stop),
            (None, None) => Some(newest),
            (Some(shown), Some(stop)) if shown.scan == stop && stop < newest => Some(newest),
            _ => None,
        }
    }

    /// The answer in so many columns and rows; what does not fit is named.
    pub(super) fn picture(&self, [columns, rows]: [usize; 2]) -> Vec<String> {
        if self.lines.is_empty() {
            return vec![format!(" scan {}: asking ...", self.scan)];
        }
        let mut picture: Vec<String> =
            self.lines.iter().flat_map(|line| wrapped(line, columns - 1)).collect();
        if picture.len() > rows {
            picture.truncate(rows.saturating_sub(1));
            picture.push(format!(" ... the rest: scanloop why {}", self.scan));
        }
        picture
    }
}

/// A line in pieces of so many columns, the later ones below its sentence.
fn wrapped(line: &str, columns: usize) -> Vec<String> {
    let mut pieces = vec![String::from(" ")];
    for word in line.split_inclusive(' ') {
        let length = |text: &str| text.trim_end().chars().count();
        let Some(last) = pieces.last_mut() else { continue };
        if length(last) > ABOUT && last.chars().count() + length(word) > columns {
            pieces.push(" ".repeat(ABOUT + 1));
        }
        if let Some(last) = pieces.last_mut() {
            last.push_str(word);
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_sentence_continues_below_itself_and_what_does_not_fit_is_named() {
        let lines = ["scan 57".to_owned(), "wheels     driven with 1.000 m/s, sent as 1.400 m/s".to_owned()];
        let reasons = Reasons { scan: 57, lines: lines.to_vec() };
        let whole = [
            " scan 57",
            " wheels     driven with 1.000 ",
            "            m/s, sent as 1.400 ",
            "            m/s",
        ];
        assert_eq!(reasons.picture([32, 4]), whole);
        assert_eq!(reasons.picture([32, 3]), [whole[0], whole[1], " ... the rest: scanloop why 57"]);
        assert_eq!(Reasons { scan: 57, lines: vec![] }.picture([32, 3]), [" scan 57: asking ..."]);
    }

    #[test]
    fn the_key_asks_about_the_last_stop_then_the_newest_scan_then_closes() {
        let of = |scan| Reasons { scan, ..Reasons::default() };
        assert_eq!(Reasons::next(None, Some(40), 57), Some(40));
        assert_eq!(Reasons::next(Some(&of(40)), Some(40), 57), Some(57));
        assert_eq!(Reasons::next(Some(&of(57)), Some(40), 60), None);
        assert_eq!(Reasons::next(None, None, 57), Some(57));
        assert_eq!(Reasons::next(Some(&of(57)), None, 58), None);
    }
}
