//! Where a [`Model`] comes from: the news of a running system.

use report::latency::{Latencies, reaction_ns};
use runtime::{Domain, settings_file, settings_table};
use shared_types::{Actuation, Role};
use toml::Table;
use view::follower::{Follower, News};

use super::model::{Course, Model};

/// A system that is followed.
pub(super) struct Feed {
    follower: Follower,
    latencies: Latencies,
}

impl Feed {
    /// Waits for the system: a run that shows itself is not there yet when its view begins.
    ///
    /// # Errors
    /// A thread that can't be started.
    pub(super) fn start(system_id: &str) -> anyhow::Result<Self> {
        Ok(Self { follower: Follower::start(system_id)?, latencies: Latencies::new(false) })
    }

    /// Takes what has come; false when the system has ended.
    pub(super) fn poll(&mut self, model: &mut Model) -> bool {
        let Self { follower, latencies } = self;
        let (mut has_ended, mut newest_scan, mut has_answers) = (false, None, false);
        follower.poll(|news| match news {
            News::Found(domain) => model.course = course(domain).unwrap_or_default(),
            News::Gone => has_ended = true,
            News::Status(status) => model.status = Some(status.clone()),
            News::Directive(directive) => model.course.give(&directive.goal),
            News::Scan(scan) => newest_scan = Some(*scan),
            News::Pose(pose) => {
                model.course.heed_goal(pose.header.scan_id);
                model.pose = Some(*pose);
            }
            News::Obstacles(obstacles) => model.obstacles = Some(Box::new(*obstacles)),
            News::Command(command) => model.command = Some(Box::new(*command)),
            News::Truth(truth) => model.truth = Some(*truth),
            News::Actuation(actuation) => {
                if model.actuation.is_some() && !model.is_blocked() && !actuation.drives() {
                    model.stop_scan = Some(actuation.header.scan_id);
                }
                model.actuation = Some(*actuation);
                has_answers |= answer(actuation, latencies, model);
            }
        });
        model.trouble = follower.trouble().map(str::to_owned);
        if let Some(scan) = newest_scan {
            model.place(&scan);
        }
        if has_answers {
            let report = latencies.report().stages;
            let [estimator, obstacles, controller, actuator] =
                report.compute.each().map(|figures| figures.p50);
            model.stages_ms = [estimator, obstacles, controller, actuator, report.transport.p50]
                .map(|time_us| time_us * 1e-3);
        }
        !has_ended
    }
}

/// Records the times of an actuation that answers a scan; whether it does.
fn answer(actuation: &Actuation, latencies: &mut Latencies, model: &mut Model) -> bool {
    let answers = actuation.answers == 1;
    if answers {
        latencies.record(&actuation.header);
        if let Some(time_ns) = reaction_ns(&actuation.header) {
            model.react(time_ns as f64 * 1e-6);
        }
    }
    answers
}

/// Course and robot from the settings of the controller.
fn course(domain: &Domain) -> anyhow::Result<Course> {
    let role = Role::Controller;
    let mut table: Table = domain.folder().read_text(&settings_file(role))?.parse()?;
    let own = table.remove(settings_table(role)).unwrap_or_else(|| Table::new().into());
    let nmpc::ControllerConfig { track, goal, next_goals, course, vehicle, .. } = own.try_into()?;
    Ok(Course::new(track, [vec![goal], next_goals].concat(), course, vehicle))
}
