//! Where a [`Model`] comes from: the samples on the bus, and the status over the control socket.
//!
//! The status is asked for in a thread of its own, because an orchestrator that hangs answers late or never.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use report::latency::{Latencies, reaction_ns};
use runtime::{Bus, Domain, Observer, RuntimeError, settings_file, settings_table};
use session::control::Status;
use shared_types::{Actuation, Command, Directive, Obstacles, Pose, Role, Sample, Scan, Truth};
use toml::Table;

use super::model::{Course, Model};
use crate::status;

/// Pause between two requests for the status.
const STATUS_PAUSE: Duration = Duration::from_millis(500);

/// A connection to a running system.
pub(super) struct Feed {
    news: Receiver<News>,
    directives: Observer<Directive>,
    scans: Observer<Scan>,
    poses: Observer<Pose>,
    obstacles: Observer<Obstacles>,
    commands: Observer<Command>,
    actuations: Observer<Actuation>,
    truths: Observer<Truth>,
    directive: Directive,
    latencies: Latencies,
    // Dropped last: the ports above belong to it.
    _bus: Bus,
}

/// What the thread of the status found.
enum News {
    Status(Box<Status>),
    Trouble(String),
    /// The system has ended.
    Gone,
}

impl Feed {
    /// Joins the system as an observer.
    ///
    /// # Errors
    /// Errors of the bus: a system that is just being made can't be joined yet.
    pub(super) fn join(domain: &Domain, model: &mut Model) -> anyhow::Result<Self> {
        let bus = Bus::open(domain, "observer")?;
        let feed = Self {
            news: ask_for_status(domain.clone()),
            directives: Observer::new(&bus)?,
            scans: Observer::new(&bus)?,
            poses: Observer::new(&bus)?,
            obstacles: Observer::new(&bus)?,
            commands: Observer::new(&bus)?,
            actuations: Observer::new(&bus)?,
            truths: Observer::new(&bus)?,
            directive: Directive::default(),
            latencies: Latencies::new(false),
            _bus: bus,
        };
        model.course = course(domain).unwrap_or_default();
        Ok(feed)
    }

    /// Takes what has come; false when the system has ended.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(super) fn poll(&mut self, model: &mut Model) -> Result<bool, RuntimeError> {
        for news in self.news.try_iter() {
            match news {
                News::Status(status) => (model.status, model.trouble) = (Some(*status), None),
                News::Trouble(text) => model.trouble = Some(text),
                News::Gone => return Ok(false),
            }
        }
        let Self { directive, latencies, .. } = self;
        self.directives.poll(|newest| *directive = *newest)?;
        self.poses.poll(|pose| take(directive, pose, &mut model.pose))?;
        self.truths.poll(|truth| take(directive, truth, &mut model.truth))?;
        let mut newest_scan = None;
        self.scans.poll(|scan| take(directive, scan, &mut newest_scan))?;
        if let Some(scan) = newest_scan {
            model.place(&scan);
        }
        self.obstacles.poll(|obstacles| {
            if counts(directive, obstacles) {
                model.obstacles = Some(Box::new(*obstacles));
            }
        })?;
        self.commands.poll(|command| {
            if counts(directive, command) {
                model.command = Some(Box::new(*command));
            }
        })?;
        let mut answers = Vec::new();
        self.actuations.poll(|actuation| {
            take(directive, actuation, &mut model.actuation);
            if counts(directive, actuation) && actuation.answers == 1 {
                latencies.record(&actuation.header);
                answers.extend(reaction_ns(&actuation.header));
            }
        })?;
        if !answers.is_empty() {
            answers.into_iter().for_each(|time_ns| model.react(time_ns as f64 * 1e-6));
            let report = latencies.report().stages;
            let [estimator, obstacles, controller, actuator] =
                report.compute.each().map(|figures| figures.p50);
            model.stages_ms = [estimator, obstacles, controller, actuator, report.transport.p50]
                .map(|time_us| time_us * 1e-3);
        }
        Ok(true)
    }
}

/// Whether a sample is of the process in charge.
fn counts<S: Sample>(directive: &Directive, sample: &S) -> bool {
    directive.header.incarnation == 0 || directive.counts(S::TOPIC, sample.header())
}

fn take<S: Sample + Copy>(directive: &Directive, sample: &S, place: &mut Option<S>) {
    if counts(directive, sample) {
        *place = Some(*sample);
    }
}

/// Starts the thread that asks for the status until the system has ended or the receiver is gone.
fn ask_for_status(domain: Domain) -> Receiver<News> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        while tell_status(&domain, &sender) {
            std::thread::sleep(STATUS_PAUSE);
        }
    });
    receiver
}

/// Whether there is more to tell.
fn tell_status(domain: &Domain, sender: &Sender<News>) -> bool {
    let news = match status::current(domain) {
        Ok(status) => News::Status(Box::new(status)),
        Err(_) if !is_there(domain) => News::Gone,
        Err(error) => News::Trouble(format!("{error:#}")),
    };
    let is_gone = matches!(news, News::Gone);
    sender.send(news).is_ok() && !is_gone
}

/// Whether the directory of the system is still that of this run.
fn is_there(domain: &Domain) -> bool {
    let found = supervision::runs::find(domain.system_id()).ok().flatten();
    found.is_some_and(|found| found.run_id() == domain.run_id())
}

/// Course and robot from the settings of the controller.
fn course(domain: &Domain) -> anyhow::Result<Course> {
    let role = Role::Controller;
    let mut table: Table = domain.folder().read_text(&settings_file(role))?.parse()?;
    let own = table.remove(settings_table(role)).unwrap_or_else(|| Table::new().into());
    let nmpc::Config { track, goal, vehicle, .. } = own.try_into()?;
    Ok(Course { track, goal, vehicle })
}
