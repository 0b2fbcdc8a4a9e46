//! Another program in place of a stage: it runs alone in a system of its own, in lock-step, and receives the recorded
//! inputs of the stage.
//!
//! Each output of the process that was in charge is compared with what the program answers to the same inputs. It starts
//! like the first process of its role; a replay that begins later hands it the recorded state, as to a successor.

mod bench;

use bytemuck::bytes_of;
use console::exit::Failure;
use runtime::Shutdown;
use shared_types::{Actuation, Checkpoint, Command, Header, Obstacles, Pose, Role, Sample, Topic};

use self::bench::Bench;
use crate::drive::Lane;
use crate::stage::{Findings, Window};
use crate::{Drive, Options};

/// A program that leaves so many scans in a row unanswered is given up.
const MAX_UNANSWERED: u32 = 3;

/// A recorded sample that a stage reads.
pub(crate) struct Input {
    pub(crate) topic: Topic,
    /// Samples begin at multiples of eight bytes.
    words: Vec<u64>,
}

impl Input {
    fn of<S: Sample>(sample: &S) -> Self {
        let mut words = vec![0; size_of::<S>().div_ceil(8)];
        bytemuck::cast_slice_mut::<u64, u8>(&mut words)[..size_of::<S>()].copy_from_slice(bytes_of(sample));
        Self { topic: S::TOPIC, words }
    }

    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.words)[..self.topic.size()]
    }
}

/// Replays a role by a program.
pub(crate) fn replay(
    role: Role,
    command: &[String],
    drive: &Drive,
    options: &Options,
) -> anyhow::Result<Findings> {
    let mut findings = Findings::new(role, drive);
    let found = &mut findings;
    match role {
        Role::Robot => {
            return Err(Failure::bad_input(
                "--with robot is not possible: what a robot measures follows from no recorded input; allowed are estimator, obstacles, controller and actuator",
            ));
        }
        Role::Estimator => {
            let mut actuations = Actuations::of(drive);
            run(role, command, drive, options, found, &drive.poses, |pose: &Pose| {
                let mut inputs = actuations.before(pose, drive.simulated);
                let odometry = drive.input(&drive.odometries, Role::Robot, &pose.header)?;
                inputs.push(Input::of(odometry));
                Some(inputs)
            })?;
        }
        Role::Obstacles => {
            run(role, command, drive, options, found, &drive.obstacles, |output: &Obstacles| {
                let scan = drive.input(&drive.scans, Role::Robot, &output.header)?;
                let pose = drive.input(&drive.poses, Role::Estimator, &output.header)?;
                Some(vec![Input::of(scan), Input::of(pose)])
            })?
        }
        Role::Controller => {
            run(role, command, drive, options, found, &drive.commands, |output: &Command| {
                let pose = drive.input(&drive.poses, Role::Estimator, &output.header)?;
                let obstacles = drive.input(&drive.obstacles, Role::Obstacles, &output.header)?;
                Some(vec![Input::of(pose), Input::of(obstacles)])
            })?
        }
        Role::Actuator => {
            run(role, command, drive, options, found, &drive.actuations, |output: &Actuation| {
                let command = drive.input(&drive.commands, Role::Controller, &output.header)?;
                Some(vec![Input::of(command)])
            })?
        }
    }
    Ok(findings)
}

/// Asks the program for each output that counted, and compares the answers.
fn run<S: Sample>(
    role: Role,
    command: &[String],
    drive: &Drive,
    options: &Options,
    findings: &mut Findings,
    lane: &Lane<S>,
    mut inputs_of: impl FnMut(&S) -> Option<Vec<Input>>,
) -> anyhow::Result<()> {
    let window = Window::of(drive, options);
    let outputs: Vec<&S> = lane
        .scans()
        .filter_map(|scan_id| {
            let answers = |sample: &&S| sample.is_answer() && drive.counts(role, sample.header());
            lane.of_scan(scan_id).find(answers)
        })
        .collect();
    let Some(first) = outputs.first().map(|output| output.header().scan_id) else { return Ok(()) };
    let state = state_before(role, drive, options.from.unwrap_or(first));
    let begin = state.map_or(first.max(options.from.unwrap_or(first)), |state| state.header.scan_id + 1);
    let shutdown = Shutdown::on_signals()?;
    let mut bench = Bench::<S>::start(role, command, drive, state, &shutdown)?;
    let mut unanswered = 0;
    for output in outputs {
        let header: Header = *output.header();
        if header.scan_id > window.to {
            break;
        }
        // Also those before the state: the inputs that an estimator has received already are left out.
        let inputs = inputs_of(output);
        if header.scan_id < begin {
            continue;
        }
        let Some(inputs) = inputs else {
            findings.skip(output, "an input was not recorded");
            continue;
        };
        drive.keep_pace(&header);
        inputs.into_iter().try_for_each(|input| bench.publish(input))?;
        let answer = bench.answer(header.scan_id)?;
        unanswered = if answer.is_some() { 0 } else { unanswered + 1 };
        if unanswered == MAX_UNANSWERED {
            return Err(Failure::process(format!(
                "{role}: the command left {MAX_UNANSWERED} scans in a row without an answer, the last is {}{}",
                header.scan_id,
                bench.last_lines()
            )));
        }
        if window.holds(&header, findings) {
            match answer {
                Some((answer, Ok(()))) => findings.compare(output, answer, role, drive, options),
                Some((_, Err(fault))) => findings.refuse(output, &fault.to_string()),
                None => findings.refuse(output, "no answer"),
            }
        }
    }
    Ok(())
}

/// The state that a replay from a scan on begins with; none at the start of a drive.
fn state_before(role: Role, drive: &Drive, from: u64) -> Option<&Checkpoint> {
    let mut states = drive.checkpoints.samples.iter().filter(|state| state.role == role.wire());
    let before = states.clone().rfind(|state| state.header.scan_id < from);
    // A recording that begins in the middle of a drive.
    before.or_else(|| states.find(|_| from > 1))
}

/// The actuations that an estimator receives, in the order of their publication.
struct Actuations<'a> {
    all: Vec<&'a Actuation>,
    next: usize,
}

impl<'a> Actuations<'a> {
    fn of(drive: &'a Drive) -> Self {
        let counts = |actuation: &&Actuation| drive.counts(Role::Actuator, &actuation.header);
        let mut all: Vec<&Actuation> = drive.actuations.samples.iter().filter(counts).collect();
        all.sort_by_key(|actuation| (published_ns(actuation), actuation.header.scan_id));
        Self { all, next: 0 }
    }

    /// Those that were received before the inputs of a pose. In lock-step an estimator waits for the answer to the scan
    /// before: where there was none, the newest actuation is repeated under that number.
    fn before(&mut self, pose: &Pose, simulated: bool) -> Vec<Input> {
        let taken_ns = pose.header.stage(Role::Estimator).taken_ns;
        let scan_before = pose.header.scan_id.saturating_sub(1);
        let is_before = |actuation: &&Actuation| match simulated {
            true => actuation.header.scan_id <= scan_before,
            false => published_ns(actuation) < taken_ns,
        };
        let length = self.all[self.next..].iter().take_while(|actuation| is_before(actuation)).count();
        let received = &self.all[self.next..self.next + length];
        self.next += length;
        let mut inputs: Vec<Input> = received.iter().map(|actuation| Input::of(*actuation)).collect();
        if let Some(newest) = self.all[..self.next].last()
            && newest.header.scan_id < scan_before
        {
            let header = Header { scan_id: scan_before, ..newest.header };
            inputs.push(Input::of(&Actuation { header, ..**newest }));
        }
        inputs
    }
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}
