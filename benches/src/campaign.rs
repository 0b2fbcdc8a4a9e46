//! `scanloop-lab campaign`: drives many courses through the pipeline, judges each drive, and lists those that went wrong.
//!
//! The judge is [`courses::judge`]; it knows the truth and nothing of the stages.

pub(crate) mod arguments;
mod course;
mod failures;
mod kind;
mod picture;
mod run;
mod summary;
mod text;

use console::answer;
use console::exit::Exit;
use console::out_folder::OutFolder;
use console::progress::Steps;

use crate::cores::on_all_cores;
use arguments::CampaignArguments;
use commands::print_json;
use failures::Bad;
use run::CourseRun;
use summary::Summary;

/// The file of the picture.
const PICTURE: &str = "gaps.svg";

/// Drives the courses and prints how they ended; exit code 3 after a contact that is not excused, 1 when another course was
/// bad.
///
/// # Errors
/// Wrong arguments, exit code 2; errors of the file system.
pub(crate) fn campaign(arguments: &CampaignArguments) -> anyhow::Result<Exit> {
    let results = OutFolder::claim(&arguments.out, &[PICTURE], arguments.force)?;
    let runs = drive_all(arguments)?;
    let mut summary = Summary::of(&runs);
    let bad: Vec<Bad> = runs
        .iter()
        .filter(|run| failures::is_bad(run))
        .map(|run| Bad::of(run, arguments, &results))
        .collect();
    bad.iter().for_each(|bad| summary.add_bad(bad.course.clone()));
    // The results of hours are printed, whatever becomes of the files; and the other way round.
    let printed = answer!(arguments.json, "{}", text::text(&summary, &failures::settings(arguments)))
        .and_then(|_| print_json(arguments.json, &summary));
    let saved: Vec<anyhow::Result<()>> = bad.iter().map(|bad| bad.save(&results)).collect();
    printed?;
    if let Some(picture) = picture::draw(&summary.families, &arguments.robot.name())? {
        answer!(arguments.json, "picture         {}", results.write(PICTURE, picture.as_bytes())?.display())?;
    }
    saved.into_iter().collect::<anyhow::Result<()>>()?;
    Ok(match (summary.collision, summary.bad.is_empty()) {
        (0, true) => Exit::Done,
        (0, false) => Exit::NotReached,
        _ => Exit::Collision,
    })
}

fn drive_all(arguments: &CampaignArguments) -> anyhow::Result<Vec<CourseRun>> {
    let courses = course::all(arguments);
    // What a run would refuse is refused before the first drive.
    for first in courses.iter().step_by(usize::try_from(arguments.runs)?) {
        first.drive(arguments)?;
    }
    let mut steps = Steps::new(courses.len() as u64, "courses");
    let runs =
        on_all_cores(courses.len(), |index| CourseRun::of(courses[index], arguments), || steps.step(""))?;
    runs.into_iter().collect()
}
