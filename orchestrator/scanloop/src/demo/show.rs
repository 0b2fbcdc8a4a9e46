//! The state of the demo: the system, what was seen of it, what was told and measured; its start and its end.

use std::time::Duration;

use anyhow::Context;
use report::{Outcome, Report};
use runtime::{Shutdown, monotonic_ns, wait_for};

use super::claims::Claims;
use super::drive_view::Watch;
use super::story::Story;
use super::system::{Interrupted, System, wait_until};

/// What all acts share.
pub(super) struct Show<'a> {
    pub(super) system: System,
    pub(super) watch: Option<Watch>,
    pub(super) story: Story,
    pub(super) claims: Claims,
    pub(super) shutdown: &'a Shutdown,
    /// Time between two acts, to look at the page.
    pub(super) pause: Duration,
}

impl Show<'_> {
    /// Starts the drive; `port` is that of the page.
    ///
    /// # Errors
    /// What the run refuses, with its exit code.
    pub(super) fn start(&mut self, port: Option<u16>) -> anyhow::Result<()> {
        let view = port.map(|port| format!("--view={port}"));
        self.system.start(view.as_deref().as_slice(), self.shutdown)?;
        let domain = self.system.domain().context("the system has no directory")?;
        self.watch = Some(Watch::new(&domain)?);
        let text = "five processes drive a long course past obstacles, ten scans a second";
        self.story.tell("start", text);
        if port.is_some() {
            let link = self.system.link(self.shutdown)?;
            self.story.tell("watch", &format!("live page: {link}"));
        }
        let id = &self.system.id;
        self.story.tell("watch", &format!("in another terminal: scanloop --system-id {id} top"));
        Ok(())
    }

    /// What was seen of the drive.
    pub(super) fn watch(&mut self) -> anyhow::Result<&mut Watch> {
        self.watch.as_mut().context("nothing drives")
    }

    /// Observes for a time.
    pub(super) fn observe(&mut self, lasts: Duration) -> anyhow::Result<()> {
        let until_ns = monotonic_ns() + lasts.as_nanos() as u64;
        while monotonic_ns() < until_ns {
            self.poll()?;
        }
        Ok(())
    }

    fn poll(&mut self) -> anyhow::Result<()> {
        if self.shutdown.requested() {
            return Err(Interrupted.into());
        }
        self.watch()?.poll()?;
        wait_for(&[self.shutdown.descriptor()], 5_000_000);
        Ok(())
    }

    /// Observes until something is seen.
    pub(super) fn wait<T>(&mut self, seen: impl Fn(&Watch) -> Option<T>) -> anyhow::Result<T> {
        let Self { watch, shutdown, .. } = self;
        let watch = watch.as_mut().context("nothing drives")?;
        wait_until(shutdown, || {
            watch.poll()?;
            Ok(seen(watch))
        })
    }

    /// Times of the stages since a time.
    pub(super) fn stages(&mut self, from_ns: u64) -> anyhow::Result<Vec<[f64; 4]>> {
        Ok(self.watch()?.answers_in(from_ns, u64::MAX).filter_map(|answer| answer.stages_ms).collect())
    }

    /// Injects a fault.
    pub(super) fn inject(&mut self, fault: &str, lasts: Duration) -> anyhow::Result<()> {
        let time = format!("{}ms", lasts.as_millis());
        let code = self.system.run("inject", &["inject", fault, "--for", &time], self.shutdown)?;
        anyhow::ensure!(code == Some(0), "{}", self.system.written("inject", "err").trim());
        Ok(())
    }

    /// Ends the drive and reads its report.
    pub(super) fn finish(&mut self, ends_by_itself: bool) -> anyhow::Result<()> {
        let clearance_m = self.watch()?.newest.min_clearance_m;
        if !ends_by_itself {
            self.system.run("stop", &["stop"], self.shutdown)?;
        }
        self.watch = None;
        self.system.wait(self.shutdown)?;
        let path = self.system.drive.join("report.json");
        let report = Report::read(&path).with_context(|| path.display().to_string())?;
        let Report { outcome, scans, .. } = &report;
        let truth = report.drive.truth.unwrap_or_default();
        let clearance_m = clearance_m.min(truth.min_clearance_m);
        let because = if report.reason.is_empty() { String::new() } else { format!(": {}", report.reason) };
        self.story.tell(
            "end",
            &format!(
                "{}{because}; {:.0} m driven, nothing nearer than {clearance_m:.2} m; {} scans in the report, {} \
                 unaccounted for",
                outcome.name(),
                report.drive.path_length_m,
                scans.published,
                scans.unaccounted
            ),
        );
        let is_touched = *outcome == Outcome::Collision || truth.collided;
        self.claims.measured("clearance_m", if is_touched { -1.0 } else { clearance_m });
        self.claims.measured("unaccounted_scans", scans.unaccounted as f64);
        Ok(())
    }

    /// Looks for processes and shared memory.
    pub(super) fn leave(&mut self) -> anyhow::Result<()> {
        let system = &self.system;
        let gone = wait_until(self.shutdown, || Ok((system.left_behind() == 0).then_some(())));
        if gone.as_ref().is_err_and(|error| error.is::<Interrupted>()) {
            return gone;
        }
        self.claims.measured("left_behind", self.system.left_behind() as f64);
        Ok(())
    }
}
