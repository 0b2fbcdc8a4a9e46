//! The acts of the demo. Each does what a user would do, observes the drive, tells it, and notes what was measured.

use std::time::Duration;

use anyhow::Context;
use console::exit::Failure;
use handover::swap::{Certificate, SwapOutcome};
use report::Report;
use report::latency::STAGES;
use runtime::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use shared_types::Role;

use super::drive_view::{Watch, median};
use super::show::Show;

/// Time of the undisturbed drive, and after the death of the orchestrator.
const DRIVE: Duration = Duration::from_secs(4);
const WITHOUT_ORCHESTRATOR: Duration = Duration::from_secs(1);
/// The latest time after a scan at which its answer arrives here [ns].
const ARRIVES_NS: u64 = 300_000_000;
/// A busy machine may delay a candidate so long that it is refused: a swap is requested again.
const SWAPS: usize = 3;
/// The stage that gets a delay, the fault that is one, how long the delay is [ms] and how long it lasts.
const DELAYED: (Role, &str, f64) = (Role::Obstacles, "obstacles-late-5ms", 5.0);
const DELAY_LASTS: Duration = Duration::from_millis(1700);
/// Rounds with and without the delay, in turns: load of the machine meets both.
const ROUNDS: usize = 2;
/// The scenario that is driven twice.
const TWICE: &str = "corridor";

impl Show<'_> {
    /// Drives undisturbed.
    pub(super) fn drive(&mut self) -> anyhow::Result<()> {
        // The first scans are the slowest, and the robot has to get up to speed.
        self.observe(Duration::from_secs(1))?;
        let from_ns = monotonic_ns();
        self.observe(DRIVE)?;
        let until_ns = monotonic_ns().saturating_sub(ARRIVES_NS);
        let watch = self.watch()?;
        let unanswered = watch.unanswered(from_ns, until_ns);
        let times = || watch.answers_in(from_ns, until_ns).filter_map(|answer| answer.reaction_ms);
        let (count, longest_ms) = (times().count(), times().fold(0.0, f64::max));
        let (median_ms, speed_mps) = (median(times()).unwrap_or(f64::NAN), watch.newest.speed_mps);
        self.story.tell(
            "drive",
            &format!(
                "{speed_mps:.2} m/s; {count} scans, {unanswered} without an answer; from scan to actuation \
                 {median_ms:.2} ms in the median, {longest_ms:.1} ms at most"
            ),
        );
        self.claims.measured("answered_scans", count as f64);
        self.claims.measured("unanswered_scans", unanswered as f64);
        self.claims.measured("scan_to_actuation_ms", if count > 0 { longest_ms } else { f64::NAN });
        Ok(())
    }

    /// Kills the process of a role.
    pub(super) fn kill(&mut self, role: Role) -> anyhow::Result<()> {
        let status = self.system.status().context("the orchestrator does not answer")?;
        let row = status.processes.iter().find(|row| row.role == role);
        let pid =
            row.and_then(|row| Pid::from_raw(row.pid)).with_context(|| format!("no process of {role}"))?;
        let from_ns = monotonic_ns();
        kill_process(pid, Signal::KILL)?;
        let back_ns = self.wait(|watch| watch.drives_after(from_ns))?;
        // The truth of a later scan includes all that happened until then.
        let scans = self.watch()?.scans.len();
        self.wait(|watch| (watch.scans.len() > scans + 1).then_some(()))?;
        let back_s = (back_ns - from_ns) as f64 * 1e-9;
        let watch = self.watch()?;
        let blind_ms = watch.newest.longest_blind_s * 1e3;
        let blocks = watch.blocks(from_ns, back_ns);
        let wheels = match (blocks, role) {
            (0, Role::Actuator) => "the robot itself watched over its wheels",
            (0, _) => "the successor was in time, the wheels were not blocked",
            (_, Role::Actuator) => "its successor began with blocked wheels",
            _ => "the actuator blocked the wheels meanwhile",
        };
        self.story.tell(
            "kill -9",
            &format!(
                "{role} (pid {}): {wheels}; drives again after {back_s:.2} s; until now the wheels turned {blind_ms:.0} \
                 ms at most without an actuation",
                pid.as_raw_nonzero()
            ),
        );
        self.claims.measured(&format!("killed_{role}_blind_ms"), blind_ms);
        self.claims.measured(&format!("killed_{role}_back_s"), back_s);
        Ok(())
    }

    /// Kills the orchestrator, and adopts the processes.
    pub(super) fn kill_orchestrator(&mut self) -> anyhow::Result<()> {
        let from_ns = monotonic_ns();
        let pid = self.system.kill_orchestrator().context("there is no orchestrator")?;
        self.observe(WITHOUT_ORCHESTRATOR)?;
        self.system.adopt(self.shutdown)?;
        let back_s = (monotonic_ns() - from_ns) as f64 * 1e-9;
        self.observe(Duration::from_nanos(2 * ARRIVES_NS))?;
        let until_ns = monotonic_ns().saturating_sub(ARRIVES_NS);
        let watch = self.watch()?;
        let (unanswered, blocks) = (watch.unanswered(from_ns, until_ns), watch.blocks(from_ns, until_ns));
        let count = watch.answers_in(from_ns, until_ns).count();
        self.story.tell(
            "kill -9",
            &format!(
                "orchestrator (pid {pid}): the others drove on, {count} scans answered, {unanswered} not, {blocks} with \
                 blocked wheels; another one has adopted them after {back_s:.1} s"
            ),
        );
        let measured = |value: usize| if count > 0 { value as f64 } else { f64::NAN };
        self.claims.measured("killed_orchestrator_unanswered", measured(unanswered));
        self.claims.measured("killed_orchestrator_blocks", measured(blocks));
        Ok(())
    }

    /// Swaps the process of a role under way.
    pub(super) fn swap(&mut self, role: Role, implementation: &str) -> anyhow::Result<()> {
        let (name, mut swapped) = (format!("swap-{role}"), false);
        let (mut missed, mut twice) = (0, 0);
        for _ in 0..SWAPS {
            let from_s = self.story.time_s();
            let arguments = ["swap", role.name(), "--to", implementation, "--json"];
            self.system.run(&name, &arguments, self.shutdown)?;
            self.watch()?.poll()?;
            let text = self.system.written(&name, "out");
            let certificate: Certificate =
                serde_json::from_str(&text).with_context(|| self.system.written(&name, "err"))?;
            missed += certificate.missed_scans;
            twice += certificate.duplicate_scans;
            swapped = certificate.outcome == SwapOutcome::Swapped;
            let lasted_s = self.story.time_s() - from_s;
            self.story.tell("swap", &format!("{certificate}; certificate after {lasted_s:.1} s"));
            if swapped {
                break;
            }
        }
        let measured = |value: u64| if swapped { value as f64 } else { f64::NAN };
        self.claims.measured(&format!("swapped_{role}_missed"), measured(missed));
        self.claims.measured(&format!("swapped_{role}_twice"), measured(twice));
        Ok(())
    }

    /// Plants a delay in one stage, and looks for it in the stamps of all stages.
    pub(super) fn delay(&mut self) -> anyhow::Result<()> {
        let (stage, fault, planted_ms) = DELAYED;
        let (mut without, mut with) = (Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            let from_ns = monotonic_ns();
            self.observe(DELAY_LASTS)?;
            without.extend(self.stages(from_ns)?);
            self.inject(fault, DELAY_LASTS)?;
            let from_ns = monotonic_ns() + ARRIVES_NS / 2;
            self.observe(DELAY_LASTS - Duration::from_millis(250))?;
            with.extend(self.stages(from_ns)?);
            self.observe(Duration::from_millis(500))?;
        }
        let of = |all: &[[f64; 4]], index: usize| {
            median(all.iter().map(|stages| stages[index])).unwrap_or(f64::NAN)
        };
        let more: Vec<f64> = (0..STAGES.len()).map(|index| of(&with, index) - of(&without, index)).collect();
        let found =
            |role: Role| STAGES.iter().position(|of| *of == role).map_or(f64::NAN, |index| more[index]);
        let others = STAGES.iter().filter(|role| **role != stage).map(|role| found(*role));
        let elsewhere_ms = others.map(f64::abs).fold(0.0, |most: f64, value| most.max(value));
        let differences: Vec<String> =
            STAGES.iter().zip(&more).map(|(role, ms)| format!("{role} {ms:+.2} ms")).collect();
        let text = format!("{planted_ms} ms planted in {stage}; the stamps show {}", differences.join(", "));
        self.story.tell("find a delay", &text);
        let is_measured = !with.is_empty() && !without.is_empty();
        self.claims.measured("planted_delay_error_ms", (found(stage) - planted_ms).abs());
        let elsewhere_ms = if is_measured { elsewhere_ms } else { f64::NAN };
        self.claims.measured("planted_delay_elsewhere_ms", elsewhere_ms);
        Ok(())
    }

    /// Blinds the scanner: the robot must stop, and the run ends.
    pub(super) fn blind(&mut self) -> anyhow::Result<()> {
        let before_m = self.watch()?.newest.path_length_m;
        let from_ns = monotonic_ns();
        self.inject("scanner-dead", Duration::from_secs(60))?;
        let stands = |watch: &Watch| {
            let newest = &watch.newest;
            (newest.header.acquired_ns > from_ns && newest.speed_mps == 0.0)
                .then_some(newest.header.acquired_ns)
        };
        let stands_ns = self.wait(stands)?;
        let stop_s = (stands_ns - from_ns) as f64 * 1e-9;
        let way_m = self.watch()?.newest.path_length_m - before_m;
        let text = format!(
            "nothing comes back to the scanner: the robot stands {stop_s:.2} s and {way_m:.2} m later"
        );
        self.story.tell("blind", &text);
        self.claims.measured("blind_scanner_stop_s", stop_s);
        Ok(())
    }

    /// Drives one scenario twice in simulated time and compares the digests of all topics.
    pub(super) fn lockstep(&mut self) -> anyhow::Result<()> {
        let mut reports = Vec::new();
        for name in ["first", "second"] {
            let out = self.system.folder.join(name);
            let out = out.to_str().context("--out: the path of the folder is not UTF-8")?;
            self.system.run(name, &["run", TWICE, "--lockstep", "--quiet", "--out", out], self.shutdown)?;
            let path = self.system.folder.join(name).join("report.json");
            reports.push(Report::read(&path).map_err(|error| {
                Failure::process(format!("{}: {error}: {}", path.display(), self.system.written(name, "err")))
            })?);
        }
        let [first, second] = [&reports[0].digests, &reports[1].digests];
        let differs = |topic: &&String| first.get(*topic) != second.get(*topic);
        let topics = first.keys().chain(second.keys().filter(|topic| !first.contains_key(*topic)));
        let (count, different) = (topics.clone().count(), topics.filter(differs).count());
        let text = format!(
            "{TWICE} driven two times in lock-step, {} scans each: {different} of {count} topics differ in a bit",
            reports[0].scans.published
        );
        self.story.tell("same again", &text);
        self.claims.measured("lockstep_topics", count as f64);
        self.claims.measured("lockstep_differences", different as f64);
        Ok(())
    }
}
