//! Cells with real processes: a system is started just before the phase, the fault is injected, and 4 s are observed.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use commands::inject::act::{act, faulty_role};
use console::new_file::Scratch;
use fault_matrix::course::{BY_HAND_MPS, begins, live_scenario, settings};
use fault_matrix::{DetectionLimits, DrivenWay, Finding, FindingPlace, Observed, Simulation, judge};
use faults::{DrivePhase, InjectedFault, Injection, ProcessAction, ProcessFault};
use pipeline::PipelineSettings;
use runtime::monotonic_ns;

use super::observed::Watch;
use super::system::CellSystem;
use super::{Driven, Matrix, name};

/// How long a cell lasts after its fault has begun.
const LASTS: Duration = Duration::from_secs(4);
/// A phase must begin within this time.
const LEAD_TIMEOUT: Duration = Duration::from_secs(20);
/// Time between two polls of the bus.
const PAUSE: Duration = Duration::from_millis(2);
/// Scans from the request of a swap to the fault: the candidate computes in shadow by then.
const SHADOWED: usize = 8;
/// Set in a mount namespace where shared memory may be filled.
const INSIDE: &str = "SCANLOOP_FAULTS_INSIDE";
/// Gives the command a shared memory of its own, which fits one system with a candidate.
const MOUNT: &str = "mount -t tmpfs -o mode=1777,size=64m tmpfs /dev/shm && exec \"$0\" \"$@\"";

/// Drives cells, one after the other.
#[derive(Debug, Default)]
pub(super) struct Live {
    unaffected: BTreeMap<DrivePhase, DrivenWay>,
}

impl Live {
    /// Drives one cell; the inner error names a cell that can't run here.
    ///
    /// # Errors
    /// A system that can't be started, and errors of the bus or the file system.
    pub(super) fn cell(&mut self, fault: &InjectedFault, phase: DrivePhase) -> anyhow::Result<Driven> {
        let Injection::Process(process) = &fault.inject else {
            return Ok(Err(format!("{}: it is no fault of a process", name(&fault.name, phase))));
        };
        if process.action == ProcessAction::Fill && std::env::var_os(INSIDE).is_none() {
            return in_a_namespace(fault, phase);
        }
        let settings = PipelineSettings { scenario: live_scenario(phase), ..settings() };
        let observed = drive(process, phase, &settings)?;
        let unaffected = self.unaffected(phase, &settings)?;
        let limits = DetectionLimits::of(&settings, 1.0);
        Ok(Ok(judge(fault, phase, &Observed { unaffected, ..observed }, &limits)))
    }

    /// The same drive in simulated time, without a fault.
    fn unaffected(&mut self, phase: DrivePhase, settings: &PipelineSettings) -> anyhow::Result<DrivenWay> {
        if let Some(course) = self.unaffected.get(&phase) {
            return Ok(course.clone());
        }
        let course = Simulation::unaffected(settings, phase)?;
        self.unaffected.insert(phase, course.clone());
        Ok(course)
    }
}

/// Drives with a fault from the beginning of its phase on.
fn drive(fault: &ProcessFault, phase: DrivePhase, settings: &PipelineSettings) -> anyhow::Result<Observed> {
    let mut system = CellSystem::start(&settings.scenario)?;
    let domain = system.wait_until_driving()?;
    let mut watch = Watch::new(&domain)?;
    wait_for(&mut watch, phase, settings)?;
    let velocity = format!("--velocity={BY_HAND_MPS}");
    let mut asking = match phase {
        DrivePhase::Swap => Some(system.begin(&["swap", "controller", "--to", "nmpc"])?),
        // It ends with the system.
        DrivePhase::Person => Some(system.begin(&["teleop", &velocity, "--for=60"])?),
        _ => None,
    };
    if asking.is_some() {
        let requested = watch.passed.len();
        wait_until(&mut watch, |watch| watch.passed.len() >= requested + SHADOWED)?;
    }
    let (from_ns, began) = (monotonic_ns(), Instant::now());
    watch.injected(from_ns, faulty_role(fault));
    let before = watch.passed.len().saturating_sub(1);
    let mut acting = act(fault, system.targets(fault.process), &domain)?;
    let is_orchestrator = fault.process == faults::ProcessName::Orchestrator;
    let mut is_over = false;
    while began.elapsed() < LASTS && !is_over {
        watch.poll()?;
        if fault.seconds.is_some_and(|seconds| began.elapsed().as_secs_f64() >= seconds) {
            acting.release();
        }
        if system.has_ended() && !is_orchestrator {
            is_over = true;
            watch.note_end();
        }
        std::thread::sleep(PAUSE);
    }
    let report = if is_over { system.report() } else { None };
    acting.release();
    drop(acting);
    drop(system);
    if let Some(asking) = &mut asking {
        let _ = asking.wait();
    }
    let course = DrivenWay(watch.passed.split_off(before.min(watch.passed.len())));
    let stands = watch.newest.speed_mps == 0.0;
    let outcome = match &report {
        Some(report) => report.outcome.name(),
        None if is_over => "failed",
        None if stands => "stopped",
        None => "driving",
    };
    let ends_as_planned = report.as_ref().is_some_and(|report| report.outcome.exit_code() == 0);
    Ok(Observed {
        from_ns,
        findings: with_ways(watch.findings(), &course, ends_as_planned),
        unaffected: DrivenWay::default(),
        outcome: outcome.to_owned(),
        digest: String::new(),
        ended: false,
        touched: watch.newest.collided == 1 || outcome == "collision",
        min_clearance_m: watch.newest.min_clearance_m,
        course,
    })
}

/// Findings with the way driven until each. The end of a run that reached its goal is none.
fn with_ways(findings: Vec<Finding>, course: &DrivenWay, ends_as_planned: bool) -> Vec<Finding> {
    let is_end = |finding: &Finding| finding.by == "orchestrator" && finding.what == "ended";
    let of = |finding: Finding| {
        let at_ns = finding.place.at_ns;
        Finding { place: FindingPlace { at_ns, way_m: course.way_m(at_ns) }, ..finding }
    };
    findings.into_iter().filter(|finding| !(ends_as_planned && is_end(finding))).map(of).collect()
}

/// Waits until a phase begins.
fn wait_for(watch: &mut Watch, phase: DrivePhase, settings: &PipelineSettings) -> anyhow::Result<()> {
    wait_until(watch, |watch| !watch.passed.is_empty() && begins(phase, settings, 1.0, &watch.newest))
}

fn wait_until(watch: &mut Watch, condition: impl Fn(&Watch) -> bool) -> anyhow::Result<()> {
    let started = Instant::now();
    loop {
        watch.poll()?;
        if condition(watch) {
            return Ok(());
        }
        anyhow::ensure!(started.elapsed() < LEAD_TIMEOUT, "the phase of a cell does not begin");
        std::thread::sleep(PAUSE);
    }
}

/// Runs this command for one cell in a mount namespace with a shared memory of its own.
fn in_a_namespace(fault: &InjectedFault, phase: DrivePhase) -> anyhow::Result<Driven> {
    let cell = name(&fault.name, phase);
    let may_mount = Command::new("unshare").args(["-m", "true"]).stderr(Stdio::null()).status();
    if !may_mount.is_ok_and(|status| status.success()) {
        return Ok(Err(format!("{cell}: mounting is not permitted")));
    }
    let out = Scratch::new()?;
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", MOUNT]).arg(std::env::current_exe().context("path of this executable")?);
    command
        .args(["faults", "--json", "--only", &format!("{cell}*"), "--out"])
        .arg(out.path())
        .env(INSIDE, "1");
    let output = command.stdin(Stdio::null()).output().context("unshare")?;
    let printed = || String::from_utf8_lossy(&output.stderr).into_owned();
    let matrix: Matrix =
        serde_json::from_slice(&output.stdout).with_context(|| format!("{cell}: {}", printed()))?;
    matrix.cells.into_iter().next().map(Ok).with_context(|| format!("{cell}: {}", printed()))
}
