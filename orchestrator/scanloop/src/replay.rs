//! `scanloop replay`: recomputes a recorded drive and compares it with the recording.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use replay::{ReplayOptions, replay as replay_recording};
use shared_types::Role;
use supervision::child::this_program;
use supervision::entry::IMPLEMENTATIONS;

use crate::print_json;

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The recording.
    pub file: PathBuf,
    /// Only this stage: robot, estimator, obstacles, controller or actuator; may be repeated.
    #[arg(long, value_name = "ROLE")]
    pub stage: Vec<String>,
    /// The first scan; the stages start from the recorded state nearest before it.
    #[arg(long, value_name = "SCAN")]
    pub from: Option<u64>,
    /// The last scan.
    #[arg(long, value_name = "SCAN")]
    pub to: Option<u64>,
    /// Change a key of a stage, for example `controller.horizon_s=2`; may be repeated. Outputs may then differ within the
    /// bounds of a swap's agreement.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Another program in place of a stage: `controller=./mine --fast`, or the name of a built-in implementation; may be
    /// repeated for other stages. It receives the recorded inputs in a system of its own, in simulated time. Its outputs
    /// may differ within the same bounds.
    #[arg(long, value_name = "ROLE=COMMAND")]
    pub with: Vec<String>,
    /// Replay as fast as possible, `max`, or as fast as the drive was, `1`.
    #[arg(long, value_name = "1|max", default_value = "max", value_parser = ["1", "max"], hide_possible_values = true)]
    pub speed: String,
    /// Factor on these bounds.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub tolerance: f64,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Replays a recording.
///
/// # Errors
/// A file, a stage or a key that is not allowed, and a recording of which nothing can be compared; exit code 2.
pub(crate) fn replay(arguments: &ReplayArguments) -> anyhow::Result<Exit> {
    let ReplayArguments { file, stage, from, to, set, with, speed, tolerance, json } = arguments;
    let stages = stage.iter().map(|name| name.parse::<Role>()).collect::<Result<_, _>>();
    let stages = stages.map_err(|error| Failure::bad_input(format!("--stage: {error}")))?;
    if let (Some(from), Some(to)) = (from, to)
        && from > to
    {
        return Err(Failure::bad_input(format!(
            "--from {from} --to {to}: the last scan is before the first"
        )));
    }
    if !(0.0..=1e6).contains(tolerance) {
        return Err(Failure::bad_input(format!("--tolerance {tolerance} is not allowed: 0 to 1000000")));
    }
    let with = with.iter().map(|text| program(text, &this_program())).collect::<Result<Vec<_>, _>>();
    let with = with.map_err(|error| Failure::bad_input(format!("--with {error}")))?;
    let is_changed = !(set.is_empty() && with.is_empty());
    let (from, to, in_real_time) = (*from, *to, speed == "1");
    let options =
        ReplayOptions { stages, from, to, set: set.clone(), with, tolerance: *tolerance, in_real_time };
    let started = Instant::now();
    let report = replay_recording(file, &options)?;
    print_json(*json, &report)?;
    let seconds = started.elapsed().as_secs_f64();
    answer!(
        *json,
        "{}: {} scans, {} outputs, {} compared, {} identical, {} skipped, {seconds:.2} s",
        file.display(),
        report.scans,
        report.samples,
        report.compared,
        report.identical,
        report.skipped
    )?;
    if report.injected > 0 {
        answer!(*json, "{} outputs were changed by an injected fault", report.injected)?;
    }
    for skipped in &report.reasons {
        answer!(
            *json,
            "skipped {} of {} by process {}: {}",
            skipped.samples,
            skipped.topic,
            skipped.incarnation,
            skipped.reason
        )?;
    }
    for process in &report.not_compared {
        answer!(*json, "{process}")?;
    }
    for other in &report.not_replayed {
        answer!(*json, "{} is not replayed, another layout: {}", other.role, other.fields.join("; "))?;
    }
    for difference in &report.differences {
        answer!(*json, "{difference}")?;
    }
    for statistics in &report.statistics {
        answer!(*json, "{statistics}")?;
    }
    if is_changed {
        answer!(*json, "{} outputs beyond the bounds, with tolerance {tolerance}", report.beyond)?;
    }
    if report.compared == 0 {
        let changed = "injected faults have changed all outputs";
        let reason = report.reasons.first().map_or(changed, |skipped| &skipped.reason);
        return Err(Failure::bad_input(format!("{}: nothing was compared: {reason}", file.display())));
    }
    let is_good = if is_changed { report.beyond == 0 } else { report.is_identical() };
    Ok(if is_good { Exit::Done } else { Exit::NotReached })
}

/// Reads `ROLE=COMMAND`: a command with its arguments, or a built-in implementation of the role in the executable `product`.
///
/// # Errors
/// What is wrong with it.
pub fn program(text: &str, product: &Path) -> Result<(Role, Vec<String>), String> {
    let (role, command) = text.split_once('=').ok_or_else(|| format!("{text}: expected ROLE=COMMAND"))?;
    let role: Role = role.parse().map_err(|error| format!("{text}: {error}"))?;
    if IMPLEMENTATIONS.contains(&(command, role)) {
        let program = product.to_string_lossy().into_owned();
        return Ok((role, vec![program, "service".to_owned(), command.to_owned()]));
    }
    let words = words(command).map_err(|error| format!("{text}: {error}"))?;
    if words.is_empty() {
        return Err(format!("{text}: the command is empty"));
    }
    Ok((role, words))
}

/// The words of a command; blanks within quotes belong to a word.
fn words(text: &str) -> Result<Vec<String>, &'static str> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for letter in text.chars() {
        match (quote, letter) {
            (Some(open), letter) if letter == open => quote = None,
            (None, '"' | '\'') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, letter) if letter.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    if quote.is_some() { Err("a quote is not closed") } else { Ok(words) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_split_at_blanks_outside_of_quotes() {
        let expected = vec!["python3".to_owned(), "my file.py".to_owned(), String::new(), "-x".to_owned()];
        assert_eq!(words(r#"python3  'my file.py' "" -x "#), Ok(expected));
        assert!(words("a 'b").is_err());
        let parsed = |text| program(text, Path::new("scanloop"));
        assert_eq!(parsed("controller=./mine --fast").unwrap().1, ["./mine", "--fast"]);
        assert_eq!(parsed("controller=nmpc").unwrap().1, ["scanloop", "service", "nmpc"]);
        assert!(parsed("wheels=./mine").is_err() && parsed("controller").is_err());
        assert!(parsed("controller= ").is_err());
    }
}
