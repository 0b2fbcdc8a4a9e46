//! `scanloop shadow`: runs a process in the shadow of a role of a running system, and prints the report.

use std::time::Duration;

use clap::Args;
use console::exit::{Exit, Failure};
use console::{answer, note};
use runtime::Shutdown;
use session::control::{Reply, Request, ShadowRequest, ask};

use crate::print_json;
use crate::successor::{SuccessorArguments, begin};

/// Time between two polls of a shadow [ns].
const POLL_NS: u64 = 50_000_000;
/// How long a shadow runs without `--for`.
const DEFAULT: Duration = Duration::from_secs(30);
/// Shortest and longest time that can be asked for.
const RANGE: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(24 * 3600)];

/// Arguments of `shadow`.
#[derive(Debug, Args)]
pub struct ShadowArguments {
    /// The process that runs in shadow.
    #[command(flatten)]
    pub successor: SuccessorArguments,
    /// Duration, 1s to 24h, for example 30s, 1500ms, 2m or 1h; a number without unit is in seconds; default 30s. The
    /// option may also stand after the command.
    #[arg(long = "for", value_name = "TIME", value_parser = duration_of)]
    pub duration: Option<Duration>,
    /// Print the report as JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Lets a process run in the shadow and prints the report; Ctrl-C ends it early.
///
/// # Errors
/// An unknown role or implementation; a system that is not running, does not drive, runs in lock-step, or already has a
/// second process for the role; exit code 2.
pub fn shadow(system_id: &str, arguments: &ShadowArguments) -> anyhow::Result<Exit> {
    let (command, duration) = split(&arguments.successor.command, arguments.duration)?;
    let successor = SuccessorArguments { command: command.to_vec(), ..arguments.successor.clone() };
    if command.is_empty() && successor.to.is_none() {
        return Err(Failure::bad_input("a command is missing after `--`"));
    }
    successor.require_script()?;
    let domain = &supervision::runs::existing(system_id)?;
    let shutdown = Shutdown::on_signals()?;
    let request = ShadowRequest { successor: successor.named()?, duration_ms: duration.as_millis() as u64 };
    let number = begin(domain, &Request::Shadow(request))?;
    let mut end_requested = false;
    let report = loop {
        if shutdown.requested() && !end_requested {
            end_requested = true;
            ask(domain, &Request::ShadowEnd { number })?;
        }
        match ask(domain, &Request::ShadowResult { number }) {
            Ok(Reply::Shadow(report)) => break report,
            Ok(Reply::Refused(reason)) => anyhow::bail!(reason),
            Ok(_) => {
                let signal = [shutdown.descriptor()];
                runtime::wait_for(if end_requested { &[] } else { &signal }, POLL_NS);
            }
            Err(error) => {
                note!("the system ended before the shadow did: {error:#}");
                return Ok(Exit::NotReached);
            }
        }
    };
    print_json(arguments.json, &report)?;
    answer!(arguments.json, "{report}")?;
    Ok(if report.outcome.is_good() { Exit::Done } else { Exit::NotReached })
}

/// The command and the time. `--for TIME` at the end of the command belongs to this program, unless it is given before.
fn split(command: &[String], duration: Option<Duration>) -> anyhow::Result<(&[String], Duration)> {
    match (command, duration) {
        (_, Some(duration)) => Ok((command, duration)),
        ([command @ .., option, time], None) if option == "--for" => {
            let duration =
                duration_of(time).map_err(|reason| Failure::bad_input(format!("--for {reason}")))?;
            Ok((command, duration))
        }
        _ => Ok((command, DEFAULT)),
    }
}

fn duration_of(text: &str) -> Result<Duration, String> {
    duration_within(text, RANGE, "1s to 24h")
}

/// A time with its unit, within a range that messages show as `range_text`.
///
/// # Errors
/// What is allowed.
pub(crate) fn duration_within(
    text: &str,
    range: [Duration; 2],
    range_text: &str,
) -> Result<Duration, String> {
    let allowed = || format!("{text} is not allowed: {range_text}, as 30s, 1500ms, 2m or 1h");
    let digits = text.find(|letter: char| !letter.is_ascii_digit() && letter != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let seconds = match unit {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(allowed()),
    };
    let number: f64 = number.parse().map_err(|_| allowed())?;
    let duration = Duration::try_from_secs_f64(number * seconds).map_err(|_| allowed())?;
    if (range[0]..=range[1]).contains(&duration) { Ok(duration) } else { Err(allowed()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units_and_a_range() {
        for (text, seconds) in [("30s", 30.0), ("1500ms", 1.5), ("2m", 120.0), ("1h", 3600.0), ("7", 7.0)] {
            assert_eq!(duration_of(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "s", "0.5s", "25h", "3 s", "-1s", "1.2.3s", "nan", "1e3"] {
            assert!(duration_of(text).unwrap_err().contains("is not allowed: 1s to 24h"), "{text}");
        }
    }

    #[test]
    fn the_time_may_be_at_the_end_of_the_command() {
        let split_at_blanks = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let (all, ten) = (split_at_blanks("./c --fast --for 10s"), Duration::from_secs(10));
        assert_eq!(split(&all, None).unwrap(), (&split_at_blanks("./c --fast")[..], ten));
        assert_eq!(
            split(&all, Some(DEFAULT)).unwrap(),
            (&all[..], DEFAULT),
            "given before, so the second one belongs to the command"
        );
        assert_eq!(split(&split_at_blanks("./c"), None).unwrap().1, DEFAULT);
        assert!(split(&split_at_blanks("./c --for ever"), None).is_err());
    }
}
