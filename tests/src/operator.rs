//! Random actions of an operator during live drives: whatever happens, the wheels come to rest and nothing is left.
//!
//! A *trial* is one live drive through the executable with one to three actions at random times and a `scanloop stop` at its
//! end. All that is done is drawn from the seed of the trial ([`TrialPlan::of`]); the moments are those of the machine.
//! The [`verdict`] is given from outside: by what `stop` returned and when, by the log of the emulator, by the truth
//! that an observer wrote down, by exit codes, messages and reports, and by what is left on the machine.
//!
//! Where this fails: a robot process that is killed has no wheels any more, so only its successor's dead man could be
//! judged; after damage to the files of the bus, crashes are allowed and only the end is judged.

pub mod evidence;
pub mod place;
pub mod plan;
pub mod program;
mod socket;
pub mod trial;
pub mod verdict;
pub mod wheels;

use std::fmt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

pub use evidence::TrialEvidence;
pub use plan::TrialPlan;

/// What became of one trial.
#[derive(Debug)]
pub struct Judged {
    /// What was done.
    pub plan: TrialPlan,
    /// How long each `scanloop stop` took, from its start to its end [s].
    pub stops_s: Vec<f64>,
    /// How long after the request wheels were blocked, as `stop` prints [ms].
    pub blocked_ms: Vec<f64>,
    /// Samples of the truth that were seen.
    pub truths: usize,
    /// How the first orchestrator ended.
    pub run: String,
    /// Actions that were not possible, with the reason.
    pub skipped: Vec<String>,
    /// How long the trial took.
    pub took: Duration,
    /// What was wrong; nothing in a good trial.
    pub problems: Vec<String>,
    /// Where the files of the trial are, if they were kept.
    pub kept: Option<PathBuf>,
}

impl fmt::Display for Judged {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.problems.is_empty() { "ok" } else { "FAILED" };
        let worst_s = self.stops_s.iter().copied().fold(0.0, f64::max);
        write!(formatter, "{verdict} {}; ", self.plan)?;
        match self.stops_s.len() {
            0 => write!(formatter, "ended by itself")?,
            count => write!(formatter, "{count} stops, worst {worst_s:.3} s")?,
        }
        write!(formatter, "; run {}, {} truths; {:.1} s", self.run, self.truths, self.took.as_secs_f64())?;
        self.skipped.iter().try_for_each(|reason| write!(formatter, "; skipped {reason}"))?;
        self.problems.iter().try_for_each(|problem| write!(formatter, "\n    {problem}"))?;
        self.kept.iter().try_for_each(|path| write!(formatter, "\n    files: {}", path.display()))
    }
}

/// Does the trial of a seed and judges it; the files of a failed one stay, those of a good one when they are to be kept.
pub fn trial(executable: &str, seed: u64, keeps: bool) -> Judged {
    let started = Instant::now();
    let plan = TrialPlan::of(seed);
    let (system, evidence) = trial::drive(executable, &plan);
    let problems = verdict::problems(&plan, &evidence);
    let kept = (keeps || !problems.is_empty()).then(|| keep(seed, system.folder())).flatten();
    Judged {
        stops_s: evidence.stops().filter_map(|stop| stop.took_s()).collect(),
        blocked_ms: evidence.stops().filter_map(|stop| verdict::blocked_after_ms(&stop.printed)).collect(),
        truths: evidence.truth.len(),
        run: evidence.programs.first().map(program::Ended::how).unwrap_or_default(),
        skipped: evidence.skipped,
        took: started.elapsed(),
        plan,
        problems,
        kept,
    }
}

/// Moves the folder of a trial to a place where it stays.
fn keep(seed: u64, folder: &std::path::Path) -> Option<PathBuf> {
    let kept = std::env::temp_dir().join(format!("scanloop-operator-{seed}-{}", std::process::id()));
    std::fs::rename(folder, &kept).ok()?;
    Some(kept)
}

/// The value below which a share of all values lies; 0 when there are none.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (share * values.len() as f64).ceil() as usize;
    values.get(index.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::quantile;

    #[test]
    fn a_quantile_is_one_of_the_values() {
        let mut values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!((quantile(&mut values, 0.5), quantile(&mut values, 1.0)), (2.0, 4.0));
        assert_eq!(quantile(&mut [], 0.5), 0.0);
    }
}
