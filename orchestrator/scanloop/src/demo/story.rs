//! What the demo tells while it runs: a time, an act and a sentence, for a terminal of 80 columns.

use std::time::Instant;

use console::note;

/// Columns of a line.
const COLUMNS: usize = 80;
/// Columns before the sentence.
const INDENT: usize = 22;

/// The lines that were told.
#[derive(Debug)]
pub(super) struct Story {
    started: Instant,
    /// Time [s], act and sentence.
    pub(super) lines: Vec<(f64, &'static str, String)>,
}

impl Story {
    pub(super) fn new() -> Self {
        Self { started: Instant::now(), lines: Vec::new() }
    }

    /// Time since the start [s].
    pub(super) fn time_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Tells what has happened in an act.
    pub(super) fn tell(&mut self, act: &'static str, text: &str) {
        let time_s = self.time_s();
        note!("{}", line(time_s, act, text));
        self.lines.push((time_s, act, text.to_owned()));
    }
}

/// The sentence within its columns.
fn line(time_s: f64, act: &str, text: &str) -> String {
    let mut line = format!("{time_s:5.1} s  {act:<13}");
    let mut column = INDENT;
    for (index, word) in text.split_whitespace().enumerate() {
        if index > 0 && column + 1 + word.chars().count() > COLUMNS {
            // A link is not broken, so it begins as far to the left as it must.
            column = COLUMNS.saturating_sub(word.chars().count()).min(INDENT);
            line += &format!("\n{:column$}", "");
        } else if index > 0 {
            line.push(' ');
            column += 1;
        }
        line += word;
        column += word.chars().count();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_sentence_is_broken_between_words() {
        let text = line(1.25, "drive", &"word ".repeat(30));
        assert!(text.starts_with("  1.2 s  drive        word word"), "{text}");
        assert_eq!(text.lines().count(), 3);
        assert!(text.lines().all(|line| line.len() <= COLUMNS && !line.ends_with(' ')));
        assert!(text.lines().skip(1).all(|line| line.starts_with(&" ".repeat(INDENT))));
        let link = "x".repeat(70);
        assert_eq!(
            line(1.25, "watch", &format!("page: {link}")).lines().next_back(),
            Some(&*format!("{:10}{link}", ""))
        );
    }
}
