//! Two commands run in turns: A B, B A, A B, ...

use std::process::{Command, Stdio};

use console::exit::Failure;
use console::note;
use figures::difference::{median, rounds};
use runtime::monotonic_ns;
use serde_json::Value;

use super::verdict::Verdict;

/// The metric for the run time of the command.
pub(super) const WALL: &str = "wall";

/// The results of all rounds.
pub(super) struct Turns {
    /// One verdict per metric.
    pub verdicts: Vec<Verdict>,
    /// Figures of the first metric per round, A and B.
    pub figures: Vec<[f64; 2]>,
}

/// Runs both commands `count` times and compares `metrics`.
///
/// # Errors
/// A command that fails (exit code 4), or that does not print the figure (exit code 2).
pub(super) fn compare(commands: &[String], count: usize, metrics: &[String]) -> anyhow::Result<Turns> {
    // For each metric, for each round, A and B.
    let mut figures = vec![vec![[0.0; 2]; count]; metrics.len()];
    for round in 0..count {
        let order = if round % 2 == 0 { [0, 1] } else { [1, 0] };
        for which in order {
            let values = run(&commands[which], metrics)?;
            for (of_metric, value) in figures.iter_mut().zip(values) {
                of_metric[round][which] = value;
            }
        }
        let [a, b] = figures[0][round];
        note!("round {:>3} of {count}   A {a:.3}   B {b:.3}", round + 1);
    }
    let verdicts = metrics
        .iter()
        .zip(&figures)
        .filter_map(|(metric, of_rounds)| {
            let differences: Vec<f64> = of_rounds.iter().map(|[a, b]| b - a).collect();
            let middle = [0, 1].map(|which| {
                let mut values: Vec<f64> = of_rounds.iter().map(|pair| pair[which]).collect();
                values.sort_unstable_by(f64::total_cmp);
                median(&values)
            });
            let name = if metric == WALL { "wall_s" } else { metric };
            rounds(&differences).map(|difference| Verdict::new(name, middle, &difference, count))
        })
        .collect();
    Ok(Turns { verdicts, figures: figures.swap_remove(0) })
}

/// Runs a command once and returns its figures.
fn run(command: &str, metrics: &[String]) -> anyhow::Result<Vec<f64>> {
    let started_ns = monotonic_ns();
    let output = Command::new("sh")
        .args(["-c", command])
        .stdin(Stdio::null())
        .output()
        .map_err(|error| Failure::process(format!("sh: {error}")))?;
    let wall_s = (monotonic_ns() - started_ns) as f64 * 1e-9;
    if !output.status.success() {
        let messages = String::from_utf8_lossy(&output.stderr);
        let last = messages.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("nothing");
        return Err(Failure::process(format!(
            "`{command}` ended with {}; last message: {last}",
            output.status
        )));
    }
    let printed = String::from_utf8_lossy(&output.stdout);
    let json = value_of(&printed);
    metrics
        .iter()
        .map(|metric| match metric.as_str() {
            WALL => Ok(wall_s),
            metric => json.as_ref().and_then(|json| super::figure(json, metric)).ok_or_else(|| {
                Failure::bad_input(format!("`{command}` does not print JSON with a number at {metric}"))
            }),
        })
        .collect()
}

/// All of the text as JSON, or its last line that is.
fn value_of(printed: &str) -> Option<Value> {
    let whole = serde_json::from_str(printed).ok();
    whole.or_else(|| printed.lines().rev().find_map(|line| serde_json::from_str(line).ok()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn figures_come_from_the_whole_output_or_its_last_line_of_json() {
        let commands =
            ["echo '{\"t_us\": {\"p50\": 5}}'", "echo working; echo '{\"t_us\": {\"p50\": 8.5}}'; echo done"];
        let commands = commands.map(str::to_owned);
        let turns = compare(&commands, 8, &metrics(&["t_us.p50", "wall"])).unwrap();
        assert_eq!(turns.figures, vec![[5.0, 8.5]; 8]);
        let verdict = &turns.verdicts[0];
        assert_eq!((verdict.verdict, verdict.difference, verdict.a), ("slower", 3.5, 5.0));
        assert_eq!(turns.verdicts[1].metric, "wall_s");
    }

    #[test]
    fn commands_that_fail_or_print_something_else_are_named() {
        let refusal = |command: &str| run(command, &metrics(&["t_us"])).unwrap_err().to_string();
        assert!(
            refusal("echo broken >&2; exit 3").contains("ended with exit status: 3; last message: broken")
        );
        assert!(refusal("echo '{}'").contains("does not print JSON with a number at t_us"));
        assert!(refusal("true").contains("does not print JSON"));
    }
}
