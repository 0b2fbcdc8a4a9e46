//! Where a recorded drive is left: all its processes in the states in which they were at the beginning of a scan.
//!
//! Each is led there by its journals. Changed settings hold from a scan on; the journals are followed as long as all
//! outputs are those of the recording, so deaths, swaps and late samples until then are part of the state.

mod repetition;

use actuation::ActuatorStage;
use console::exit::Failure;
use emulator::Scenario;
use estimator::EstimatorStage;
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use pipeline::SimulatedLoop;
use serde::de::DeserializeOwned;
use shared_types::{
    Actuation, AnySample, AnyStage, Checkpoint, Directive, GivenGoal, Header, JournalKind, Role, Sample,
    Topic, Truth,
};

pub use self::repetition::Repetition;
use crate::ReplayDrive;
use crate::compare::FieldDifference;
use crate::drive::{DriveSettings, Lane};
use crate::stage::{Led, Recomputed, Robot, lead};

/// What is changed, and from which scan on.
#[derive(Debug, Clone)]
pub struct ForkChange {
    at: u64,
    settings: DriveSettings,
    roles: Vec<Role>,
}

impl ForkChange {
    /// Other values of keys of the recorded settings, and obstacles that are added, each a list of keys of the scenario.
    ///
    /// # Errors
    /// Scans that the recording does not have, and what is wrong with a text; exit code 2.
    pub fn new(drive: &ReplayDrive, at: u64, set: &[String], obstacles: &[String]) -> anyhow::Result<Self> {
        let scans = drive.scans.scans();
        let (first, last) = scans.fold((u64::MAX, 0), |(low, high), scan| (low.min(scan), high.max(scan)));
        let last = drive.last_scan.map_or(last, |end| last.min(end));
        if !(first..=last).contains(&at) {
            return Err(drive.refuse(&format!("--at {at}: this drive has the scans {first} to {last}")));
        }
        let mut settings = drive.settings.clone();
        for text in set {
            settings.set(text).map_err(|reason| Failure::bad_input(format!("--set {reason}")))?;
        }
        for text in obstacles {
            settings
                .add_obstacle(text)
                .map_err(|reason| Failure::bad_input(format!("--obstacle {reason}")))?;
        }
        let roles = Role::ALL.iter().filter(|role| settings.differ(&drive.settings, **role)).copied();
        Ok(Self { at, roles: roles.collect(), settings })
    }

    /// The settings of a role from then on, as its program reads them.
    ///
    /// # Errors
    /// They are missing in the recording.
    pub fn settings_of(&self, role: Role) -> anyhow::Result<String> {
        let table: toml::Table = self.settings.table(role, runtime::settings_table(role))?;
        Ok(toml::to_string(&table)?)
    }

    fn of(&self, role: Role) -> Option<(&DriveSettings, u64)> {
        self.roles.contains(&role).then_some((&self.settings, self.at))
    }
}

/// A drive at the beginning of a scan.
pub struct Fork {
    /// The scan.
    pub scan: u64,
    /// The first output that is another than in the recording, where that is known.
    pub parts: Option<FieldDifference>,
    /// The scenario that is driven on.
    pub scenario: Scenario,
    /// The estimator had fields of a topic of your own after this, without which the drive continues.
    pub lacks_own: bool,
    /// States for programs in the place of stages, where they are known.
    pub states: Vec<(Role, Checkpoint)>,
    robot: Robot,
    stages: Vec<Box<dyn AnyStage>>,
    orders: Vec<(u64, Directive)>,
    /// What was published last on each topic of the loop.
    last: Vec<(Topic, Header)>,
    period_ns: u64,
}

impl Fork {
    /// Where a drive parts from its recording by a change; `None` where no output ever is another. Programs of these roles
    /// are replaced: they count as other ones from the scan of the change on.
    ///
    /// # Errors
    /// A recording without the state of the robot, or of a stage; keys and values that are not allowed. Exit code 2.
    pub fn find(drive: &ReplayDrive, change: &ForkChange, replaced: &[Role]) -> anyhow::Result<Option<Self>> {
        let others = drive.replayable(Role::ALL, &drive.path)?.1;
        if let Some(other) = others.first() {
            let fields = other.fields.join("; ");
            return Err(drive.refuse(&format!("{} has another layout: {fields}", other.role)));
        }
        let robots = drive.scans.samples.iter().map(|scan| scan.header.incarnation);
        if let Some(program) = robots.into_iter().find_map(|robot| drive.foreign(robot)) {
            return Err(drive.refuse(&format!(
                "the robot was `{program}`: no state of it was recorded, so the drive can't be driven on. `scanloop \
                 replay` computes the outputs of the stages again, also with --set and --with"
            )));
        }
        let mut first: Option<FieldDifference> = None;
        for role in &change.roles {
            let found = parts(drive, change, *role)?;
            first = first.into_iter().chain(found).min_by_key(|found| found.scan);
        }
        let is_begun_here = !replaced.is_empty() || (change.roles.is_empty() && drive.simulated);
        let scan = match (&first, is_begun_here) {
            (_, true) => change.at,
            (Some(first), false) => first.scan,
            (None, false) => return Ok(None),
        };
        Self::at(drive, change, scan, first, replaced).map(Some)
    }

    fn at(
        drive: &ReplayDrive,
        change: &ForkChange,
        scan: u64,
        parts: Option<FieldDifference>,
        replaced: &[Role],
    ) -> anyhow::Result<Self> {
        let mut robot = at::<Robot>(drive, &drive.scans, change, scan)?;
        for late in late_actuations(drive, robot.actuation, scan) {
            robot.stage.emulator.actuate(late);
        }
        let now_ns = robot.stage.origin_ns + robot.stage.emulator.now_ns();
        let (mut stages, mut states) = (Vec::with_capacity(4), Vec::new());
        for role in Role::ALL.iter().copied().filter(|role| *role != Role::Robot) {
            let stage = stage_at(drive, change, scan, now_ns, role);
            match replaced.contains(&role) {
                true => {
                    let state = stage.ok().and_then(|stage| stage.checkpoint());
                    states
                        .extend(state.or_else(|| drive.state_before(role, scan)).map(|state| (role, state)));
                }
                false => stages.push(stage?),
            }
        }
        let (orders, lacks_own) = later(drive, scan);
        let scenario = change.settings.table(Role::Robot, runtime::settings_table(Role::Robot))?;
        let (robot, period_ns) = (robot.stage, drive.period_ns);
        Ok(Self {
            scan,
            parts,
            scenario,
            lacks_own,
            states,
            robot,
            stages,
            orders,
            last: last(drive, scan),
            period_ns,
        })
    }

    /// The loop that drives on in lock-step, with these programs in the place of the stages that were left out, and the
    /// orders that it gets before scans.
    pub fn into_loop(self, programs: Vec<Box<dyn AnyStage>>) -> (SimulatedLoop, Vec<(u64, Directive)>) {
        let Self { scan, robot, mut stages, orders, last, period_ns, .. } = self;
        let Robot { emulator, origin_ns, goal, .. } = robot;
        stages.extend(programs);
        stages.sort_by_key(|stage| stage.shape().role.index());
        let last = |topic| last.iter().find(|(of, _)| *of == topic).map(|(_, header)| *header);
        let mut driven = SimulatedLoop::continued(emulator, stages, period_ns, origin_ns, scan, &last);
        if goal != GivenGoal::default() {
            driven.give(&goal);
        }
        (driven, orders)
    }
}

/// The first output of a role that is another with the change.
fn parts(drive: &ReplayDrive, change: &ForkChange, role: Role) -> anyhow::Result<Option<FieldDifference>> {
    match role {
        Role::Robot => parts_of::<Robot>(drive, &drive.scans, change),
        Role::Estimator => parts_of::<EstimatorStage>(drive, &drive.poses, change),
        Role::Obstacles => parts_of::<DetectorStage>(drive, &drive.obstacles, change),
        Role::Controller => parts_of::<ControllerStage>(drive, &drive.commands, change),
        Role::Actuator => parts_of::<ActuatorStage>(drive, &drive.actuations, change),
    }
}

fn parts_of<T: Recomputed>(
    drive: &ReplayDrive,
    lane: &Lane<T::Output>,
    change: &ForkChange,
) -> anyhow::Result<Option<FieldDifference>>
where
    T::Settings: DeserializeOwned,
{
    let mut processes: Vec<u32> = Vec::new();
    for scan in lane.scans().filter(|scan| *scan >= change.at) {
        let counted = drive.counted(lane, scan).map(|output| output.header().incarnation);
        processes.extend(counted.filter(|process| processes.last() != Some(process)));
    }
    for process in processes {
        let led = lead::<T>((process, lane), drive, change.of(T::ROLE), u64::MAX)?;
        if let Some(parts) = led.parts {
            // An output of a timeout has the number of the scan before.
            return Ok(Some(FieldDifference { scan: led.scan, ..parts }));
        }
    }
    Ok(None)
}

/// The stage of a role before a scan, with all that was sent to it until then.
fn stage_at(
    drive: &ReplayDrive,
    change: &ForkChange,
    scan: u64,
    now_ns: u64,
    role: Role,
) -> anyhow::Result<Box<dyn AnyStage>> {
    Ok(match role {
        Role::Estimator => {
            let led = at::<EstimatorStage>(drive, &drive.poses, change, scan)?;
            let mut stage: Box<dyn AnyStage> = Box::new(led.stage);
            for late in late_actuations(drive, led.actuation, scan) {
                stage.take(AnySample::of(late), now_ns);
            }
            stage
        }
        Role::Obstacles => Box::new(at::<DetectorStage>(drive, &drive.obstacles, change, scan)?.stage),
        Role::Controller => Box::new(at::<ControllerStage>(drive, &drive.commands, change, scan)?.stage),
        Role::Actuator => Box::new(at::<ActuatorStage>(drive, &drive.actuations, change, scan)?.stage),
        Role::Robot => return Err(drive.refuse("a robot is no stage")),
    })
}

/// The process of a role that counts for a scan, before it.
fn at<T: Recomputed>(
    drive: &ReplayDrive,
    lane: &Lane<T::Output>,
    change: &ForkChange,
    scan: u64,
) -> anyhow::Result<Led<T>>
where
    T::Settings: DeserializeOwned,
{
    let process = drive.in_charge(lane, scan);
    let process = process.ok_or_else(|| drive.refuse(&format!("{}: no output was recorded", T::ROLE)))?;
    if drive.is_elsewhere(process) {
        let reason = format!("{}: it ran on another host, whose clock stands still here", T::ROLE);
        return Err(drive.refuse(&reason));
    }
    lead((process, lane), drive, change.of(T::ROLE), scan)
}

/// Actuations of scans before this one that a process has not used: they come late.
fn late_actuations(drive: &ReplayDrive, used: Option<(u32, u64)>, scan: u64) -> Vec<&Actuation> {
    let counted = drive.actuations.samples.iter().filter(|sent| drive.counts(Role::Actuator, &sent.header));
    let mut sent: Vec<&Actuation> = counted.collect();
    sent.sort_by_key(|sent| (sent.header.stage(Role::Actuator).published_ns, sent.header.scan_id));
    let is_last = |sent: &&Actuation| Some((sent.header.incarnation, sent.header.sequence)) == used;
    let Some(last) = sent.iter().position(is_last) else { return Vec::new() };
    sent.into_iter().skip(last + 1).filter(|sent| sent.header.scan_id < scan).collect()
}

/// What the processes that count for a scan have published last before it.
fn last(drive: &ReplayDrive, scan: u64) -> Vec<(Topic, Header)> {
    fn of<S: Sample>(drive: &ReplayDrive, lane: &Lane<S>, scan: u64) -> Option<(Topic, Header)> {
        let process = lane.of_process(drive.in_charge(lane, scan)?);
        let before = process.map(|sample| *sample.header()).take_while(|header| header.scan_id < scan);
        before.last().map(|header| (S::TOPIC, header))
    }
    let robot =
        [of(drive, &drive.scans, scan), of(drive, &drive.odometries, scan), of(drive, &drive.truths, scan)];
    let stages = [
        of(drive, &drive.poses, scan),
        of(drive, &drive.obstacles, scan),
        of(drive, &drive.commands, scan),
        of(drive, &drive.actuations, scan),
    ];
    robot.into_iter().chain(stages).flatten().collect()
}

/// Orders that processes have taken from this scan on, and whether the estimator had fields of a topic of your own.
fn later(drive: &ReplayDrive, scan: u64) -> (Vec<(u64, Directive)>, bool) {
    let (mut orders, mut has_own) = (Vec::new(), false);
    for journal in drive.all_journals().filter(|journal| journal.header.scan_id >= scan) {
        for entry in journal.used() {
            has_own |= entry.kind == JournalKind::Own.wire() as u16;
            let is_order =
                entry.kind == JournalKind::Taken.wire() as u16 && entry.topic == Topic::Directive as u16;
            let taken = drive.directives.of_number(entry.incarnation, entry.value).filter(|_| is_order);
            orders.extend(taken.map(|directive| (journal.header.scan_id, *directive)));
        }
    }
    orders.sort_by_key(|(scan, directive)| (*scan, directive.header.sequence));
    (orders, has_own)
}

impl ReplayDrive {
    /// The recorded scenario.
    ///
    /// # Errors
    /// It is missing; exit code 2.
    pub fn scenario(&self) -> anyhow::Result<Scenario> {
        self.settings.table(Role::Robot, runtime::settings_table(Role::Robot))
    }

    /// The truths of a drive up to a scan, each with the actuation that answers its scan.
    pub fn truths(&self, to: u64) -> impl Iterator<Item = (&Truth, Option<&Actuation>)> {
        let scans = self.truths.scans().take_while(move |scan| *scan <= to);
        let truth = |scan| Some((self.counted(&self.truths, scan)?, self.counted(&self.actuations, scan)));
        scans.filter_map(truth)
    }

    /// The newest state that processes of a role have saved before a scan.
    fn state_before(&self, role: Role, scan: u64) -> Option<Checkpoint> {
        let is_before = |state: &&Checkpoint| state.role == role.wire() && state.header.scan_id < scan;
        self.checkpoints.samples.iter().rfind(is_before).copied()
    }

    /// The last scan.
    pub fn last_scan(&self) -> u64 {
        self.last_scan.or_else(|| self.scans.scans().last()).unwrap_or(0)
    }

    /// Whether it was driven in lock-step.
    pub fn is_in_lockstep(&self) -> bool {
        self.simulated
    }

    /// Time between two scans [ns].
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }
}
