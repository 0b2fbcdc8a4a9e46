//! The results of a run: its report, its picture, its summary.

use std::path::{Path, PathBuf};

use console::exit::Exit;
use console::out_folder::OutFolder;
use emulator::scenario::{ScenarioObstacle, Shape};
use emulator::scene::{PlacedObstacle, Scene};
use emulator::{JudgedBy, Scenario};
use plan::Plan;
use plan::difference::Property;
use report::recorder::Recorder;
use report::{DifferenceReport, Report, picture, summary};
use supervision::runs::{LivingRun, RunProcess};
use vehicle::Goal;
use vehicle::frame::to_track;

use crate::session::Session;

/// A moving obstacle is drawn at so many places at most.
const MAX_PLACES: f64 = 20.0;

const REPORT: &str = "report.json";
const PICTURE: &str = "drive.svg";

/// The folder of the results of a run. A report of a version that kept no list of its results is known by its keys.
///
/// # Errors
/// A file of one of the names that no run has written, unless `force`; exit code 2.
pub(crate) fn claim(out: &Path, force: bool) -> anyhow::Result<OutFolder> {
    let is_older = || Report::read(&out.join(REPORT)).is_ok_and(|report| report.schema > 0);
    OutFolder::claim(out, &[REPORT, PICTURE], force || !OutFolder::has_list(out) && is_older())
}

/// Drives to the end, writes the results and prints the summary.
pub(crate) fn conclude(mut session: Session, plan: &Plan, out: &OutFolder) -> anyhow::Result<Exit> {
    let result = session.drive()?;
    let run_id = session.run_id().to_owned();
    let (recorder, digests) = session.finish();
    // Also after a stop: a signal or a request over the control socket ends no strays, only `scanloop stop` does.
    name_strays(&run_id);
    let report = Report { digests: digests.texts(), ..recorder.report(&result) };
    // The scenario tells nothing about a robot that is not emulated.
    let has_truth = report.judged_by == JudgedBy::Truth;
    let report = Report { differences: if has_truth { differences(plan) } else { Vec::new() }, ..report };
    let written = write_results(&report, &plan.scenario, &recorder, out);
    runtime::print_answer(&summary::text(&report, Some(&near(out.folder()))));
    let is_recorded = report.recording.as_ref().is_none_or(|recording| recording.error.is_empty());
    let is_whole = written.is_ok() && is_recorded;
    if let Err(error) = written {
        runtime::print(runtime::Priority::Error, &format!("error: the results were not written: {error:#}"));
    }
    Ok(match result.outcome.exit_code() {
        // The drive is over, and its outcome stays; but who reads the code alone must not look for files that are not there.
        0 if !is_whole => Exit::ProcessFailed,
        0 => Exit::Done,
        3 => Exit::Collision,
        4 => Exit::ProcessFailed,
        _ => Exit::NotReached,
    })
}

/// Names the processes that a run has left: started by its processes, in groups of their own.
fn name_strays(run_id: &str) {
    let strays: Vec<String> = LivingRun::seen(run_id)
        .map_or_else(Vec::new, |run| run.strays().map(RunProcess::description).collect());
    for stray in strays {
        let text = format!("warning: the run has left {stray}: `scanloop stop` ends it");
        runtime::print(runtime::Priority::Warning, &text);
    }
}

/// Where the scenario differs from the description, as the report has it.
fn differences(plan: &Plan) -> Vec<DifferenceReport> {
    let found = plan.differences().into_iter();
    let row = |difference: plan::PropertyDifference| {
        let plan::PropertyDifference { key, truth, believed, .. } = difference;
        DifferenceReport { key: key.to_owned(), truth: value(truth), believed: value(believed) }
    };
    found.map(row).collect()
}

fn value(property: Property) -> serde_json::Value {
    match property {
        Property::Number(number) => number.into(),
        Property::Surroundings(surroundings) => surroundings.name().into(),
    }
}

/// Writes report and picture. Those of an earlier run are removed when they can't be replaced.
fn write_results(
    report: &Report,
    scenario: &Scenario,
    recorder: &Recorder,
    out: &OutFolder,
) -> anyhow::Result<()> {
    // The file of an earlier run goes when that of this run can't be written.
    let write = |name: &str, text: &str| {
        let written = out.write(name, text.as_bytes());
        written.map(drop).inspect_err(|_| out.remove(name))
    };
    let report_written = write(REPORT, &report.to_json()?);
    let drawing = picture::draw(&scene_of(scenario, recorder.goals(), report), &recorder.drive())?;
    report_written.and(write(PICTURE, &drawing))
}

/// A path as it is seen from the working folder.
fn near(path: &Path) -> PathBuf {
    let here = std::env::current_dir().unwrap_or_default();
    path.strip_prefix(here).unwrap_or(path).to_owned()
}

/// The part of a scenario that the picture shows.
fn scene_of(scenario: &Scenario, goals: &[Goal], report: &Report) -> picture::PictureScene {
    picture::PictureScene {
        title: format!("{}: {}", report.scenario, report.outcome),
        subtitle: report.reason.clone(),
        course: scenario.course_outline(),
        track_x_m: scenario.track.x_m,
        track_y_m: scenario.track.y_m,
        walls: scenario.track.walls,
        obstacles: shapes(scenario, report),
        start_m: [scenario.start.x_m, scenario.start.y_m],
        goals: goals.to_vec(),
        body_length_m: scenario.robot.length_m,
        body_width_m: scenario.robot.width_m,
        body_x_m: scenario.robot.body_x_m,
    }
}

/// The obstacles, and where the moving ones were during the drive.
fn shapes(scenario: &Scenario, report: &Report) -> Vec<picture::ObstacleOutline> {
    let mut scene = Scene::new(scenario);
    // Some appear when the robot comes near.
    report
        .trajectory
        .iter()
        .for_each(|[time_s, x, y, yaw]| scene.trigger(&scenario.body(*x, *y, *yaw), *time_s));
    let end_s = report.trajectory.last().map_or(0.0, |[time_s, ..]| *time_s);
    let mut temporary =
        scene.near(scenario.body(0.0, 0.0, 0.0).centre, 0.0).filter(|placed| !placed.is_permanent());
    let shape = |obstacle: &ScenarioObstacle| {
        let placed = if obstacle.is_permanent() { None } else { temporary.next() };
        let places = placed.filter(|placed| placed.speed() > 0.0).map(|placed| places(placed, end_s));
        picture::ObstacleOutline { points: outline(obstacle), places: places.unwrap_or_default() }
    };
    scenario.placed_obstacles().iter().map(shape).collect()
}

/// Where a moving obstacle was at whole seconds, at most [`MAX_PLACES`].
fn places(placed: &PlacedObstacle, end_s: f64) -> Vec<picture::TimedOffset> {
    let every_s = (end_s / MAX_PLACES).ceil().max(1.0);
    let times = (0..=(end_s / every_s) as u32).map(|step| f64::from(step) * every_s);
    let first = placed.centre(0.0);
    let place = |time_s: f64| {
        let moved = placed.centre(time_s) - first;
        picture::TimedOffset { time_s, x_m: moved.x, y_m: moved.y }
    };
    times.filter(|time_s| placed.solid(*time_s).is_some()).map(place).collect()
}

/// The outline of an obstacle where the scenario puts it; a circle as a polygon of 48 corners.
fn outline(obstacle: &ScenarioObstacle) -> Vec<[f64; 2]> {
    let (x, y) = (obstacle.x_m, obstacle.y_m);
    match obstacle.shape {
        Shape::Circle { radius_m } => (0..48)
            .map(|corner| {
                let (sin, cos) = (f64::from(corner) / 48.0 * std::f64::consts::TAU).sin_cos();
                [x + radius_m * cos, y + radius_m * sin]
            })
            .collect(),
        Shape::Box { length_m, width_m, yaw_rad } => [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
            .map(|(forward, left)| {
                let corner = to_track(yaw_rad, forward * length_m, left * width_m);
                [x + corner.x, y + corner.y]
            })
            .to_vec(),
    }
}
