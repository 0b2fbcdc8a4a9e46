//! Bad courses as files that `scanloop run` replays, one folder per cause.

use std::fmt::Write as _;
use std::path::PathBuf;

use console::out_folder::OutFolder;
use courses::judge::Verdict;
use emulator::Outcome;
use serde::Serialize;

use super::arguments::CampaignArguments;
use super::run::CourseRun;

/// Cause of a course that is bad only because of its ways to rest.
const WITHOUT_REST: &str = "no-way-to-rest";

/// A course with a wrong outcome.
#[derive(Debug, Clone, Serialize)]
pub(super) struct BadCourse {
    pub(super) seed: u64,
    pub(super) family: String,
    pub(super) cause: String,
    pub(super) outcome: Outcome,
    pub(super) reason: String,
    pub(super) scenario: PathBuf,
}

/// Whether a course ended wrongly, or had a scan without a way to rest.
pub(super) fn is_bad(run: &CourseRun) -> bool {
    run.without_rest > 0 || is_wrong(run)
}

fn is_wrong(run: &CourseRun) -> bool {
    matches!(run.judgement.verdict, Verdict::StoppedWrongly | Verdict::Missed | Verdict::Collision)
}

/// A bad course, and the file that replays it.
pub(super) struct Bad {
    pub(super) course: BadCourse,
    name: String,
    text: String,
}

impl Bad {
    /// What is to be told and written of a bad course.
    pub(super) fn of(run: &CourseRun, arguments: &CampaignArguments, results: &OutFolder) -> Self {
        let cause = if is_wrong(run) { run.judgement.cause.clone() } else { WITHOUT_REST.to_owned() };
        let mut reason = run.reason.clone();
        if run.without_rest > 0 {
            let _ = write!(reason, ", {} scans without a way to rest", run.without_rest);
        }
        let set = settings(arguments);
        let text = format!(
            "# {}: {reason}\n# scanloop run --lockstep FILE{set}\n{}",
            run.outcome,
            run.scenario.to_toml()
        );
        let name = format!("{cause}/{}.toml", run.scenario.name);
        let (seed, family) = (run.course.seed, run.family.clone());
        let course = BadCourse {
            seed,
            family,
            cause,
            outcome: run.outcome,
            reason,
            scenario: results.folder().join(&name),
        };
        Self { course, name, text }
    }

    /// Writes its scenario to the folder of its cause.
    ///
    /// # Errors
    /// A file of the user, and errors of the file system; exit code 2.
    pub(super) fn save(&self, results: &OutFolder) -> anyhow::Result<()> {
        results.write(&self.name, self.text.as_bytes()).map(drop)
    }
}

/// System and overrides as arguments of `run`.
pub(super) fn settings(arguments: &CampaignArguments) -> String {
    let system = arguments.system.iter().map(|file| format!(" --system {}", file.display()));
    system.chain(arguments.overrides.iter().map(|text| format!(" --set '{text}'"))).collect()
}
