//! The outputs of two processes of one role, whichever is in charge.

use std::collections::BTreeMap;

use runtime::{Bus, Observer, RuntimeError};
use shared_types::{Actuation, Command, Fault, Header, Obstacles, Odometry, Pose, Role, Sample, Scan, Truth};

use super::agreement::Sensed;
use super::{OutputSummary, Party, SwapOutput};

/// Scans of a robot, of both processes together, whose samples are being collected.
const PARTS: usize = 64;

/// Why a robot without a truth can't take over from one with it.
const NO_TRUTH: &str = "it publishes no truth, by which this run is judged";

/// Observes the topics of one role.
pub enum RoleWatch {
    /// Both topics of a robot.
    Robot(Box<RobotWatch>),
    /// An estimator's.
    Poses(Observer<Pose>),
    /// An obstacle description's.
    Obstacles(Observer<Obstacles>),
    /// A controller's.
    Commands(Observer<Command>),
    /// An actuator's.
    Actuations(Observer<Actuation>),
}

/// The output of a robot consists of samples of three topics.
pub struct RobotWatch {
    scans: Observer<Scan>,
    odometries: Observer<Odometry>,
    truths: Observer<Truth>,
    /// Whether an output without a truth is refused.
    needs_truth: bool,
    /// By scan and incarnation.
    parts: BTreeMap<(u64, u32), Parts>,
}

/// The samples of one robot for one scan, and what is wrong with the first bad one.
#[derive(Default)]
struct Parts {
    scan: Option<Scan>,
    odometry: Option<Odometry>,
    truth: Option<Truth>,
    fault: Option<Fault>,
    passed_on: bool,
}

impl RoleWatch {
    /// Starts to observe what `role` publishes. With `needs_truth` the output of a robot is invalid without a truth.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn new(bus: &Bus, role: Role, needs_truth: bool) -> Result<Self, RuntimeError> {
        Ok(match role {
            Role::Robot => Self::Robot(Box::new(RobotWatch {
                scans: Observer::new(bus)?,
                odometries: Observer::new(bus)?,
                truths: Observer::new(bus)?,
                needs_truth,
                parts: BTreeMap::new(),
            })),
            Role::Estimator => Self::Poses(Observer::new(bus)?),
            Role::Obstacles => Self::Obstacles(Observer::new(bus)?),
            Role::Controller => Self::Commands(Observer::new(bus)?),
            Role::Actuator => Self::Actuations(Observer::new(bus)?),
        })
    }

    /// Hands the outputs of the incarnations `old` and `new` since the last call to `each`.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn poll(
        &mut self,
        old: u32,
        new: u32,
        mut each: impl FnMut(Party, SwapOutput),
    ) -> Result<(), RuntimeError> {
        let mut each = |incarnation: u32, output: SwapOutput| {
            if incarnation == old {
                each(Party::Old, output);
            } else if incarnation == new {
                each(Party::New, output);
            }
        };
        match self {
            Self::Robot(robot) => robot.poll([old, new], &mut each),
            Self::Poses(observer) => take(observer, |_| true, &mut each),
            Self::Obstacles(observer) => take(observer, |_| true, &mut each),
            Self::Commands(observer) => take(observer, |_| true, &mut each),
            // An actuation without a command, as a block, answers no scan.
            Self::Actuations(observer) => take(observer, |sample| sample.answers == 1, &mut each),
        }
    }
}

impl RobotWatch {
    fn poll(&mut self, both: [u32; 2], each: &mut impl FnMut(u32, SwapOutput)) -> Result<(), RuntimeError> {
        let Self { scans, odometries, truths, needs_truth, parts } = self;
        // The truth last: it is published before the others of its scan.
        collect(scans, both, parts, |parts, scan| parts.scan = Some(*scan))?;
        collect(odometries, both, parts, |parts, odometry| parts.odometry = Some(*odometry))?;
        collect(truths, both, parts, |parts, truth| parts.truth = Some(*truth))?;
        for ((_, incarnation), parts) in parts.iter_mut().filter(|(_, parts)| !parts.passed_on) {
            if let (Some(scan), Some(odometry)) = (&parts.scan, &parts.odometry) {
                parts.passed_on = true;
                let sensed = Sensed::new(scan, odometry, parts.truth.as_ref());
                let content = parts.fault.map_or(Ok(OutputSummary::Sensed(Box::new(sensed))), Err);
                let mut output = output_of(&odometry.header, Role::Robot, content);
                if *needs_truth && parts.truth.is_none() && output.content.is_ok() {
                    output.content = Err(NO_TRUTH.to_owned());
                }
                output.stamps_ns[1] = scan.header.stage(Role::Robot).published_ns;
                // A scan answers no other sample; it is due when its sweep is over.
                output.scan_published_ns = scan.header.acquired_ns.saturating_add(scan.period_ns / 3);
                each(*incarnation, output);
            }
        }
        while parts.len() > PARTS {
            parts.pop_first();
        }
        Ok(())
    }
}

fn collect<S: Sample>(
    observer: &Observer<S>,
    both: [u32; 2],
    parts: &mut BTreeMap<(u64, u32), Parts>,
    put: impl Fn(&mut Parts, &S),
) -> Result<(), RuntimeError> {
    observer.poll_checked(|sample, checked| {
        let Header { scan_id, incarnation, .. } = *sample.header();
        if both.contains(&incarnation) && !is_impossible(&checked) {
            let parts = parts.entry((scan_id, incarnation)).or_default();
            put(parts, sample);
            parts.fault = parts.fault.or(checked.err());
        }
    })?;
    Ok(())
}

fn take<S: Sample>(
    observer: &Observer<S>,
    counts: impl Fn(&S) -> bool,
    each: &mut impl FnMut(u32, SwapOutput),
) -> Result<(), RuntimeError>
where
    for<'a> OutputSummary: From<&'a S>,
{
    observer.poll_checked(|sample, checked| {
        if let Some(role) = S::TOPIC.writer()
            && counts(sample)
            && !is_impossible(&checked)
        {
            let header = sample.header();
            each(header.incarnation, output_of(header, role, checked.map(|()| OutputSummary::from(sample))));
        }
    })?;
    Ok(())
}

/// Whether a sample has a number that no scan can have: it answers none.
fn is_impossible(checked: &Result<(), Fault>) -> bool {
    matches!(checked, Err(Fault::ImpossibleNumber { .. }))
}

fn output_of(header: &Header, role: Role, content: Result<OutputSummary, Fault>) -> SwapOutput {
    let stage = header.stage(role);
    SwapOutput {
        scan: header.scan_id,
        sequence: header.sequence,
        scan_published_ns: header.scan_published_ns(),
        published_ns: stage.published_ns,
        stamps_ns: [stage.published_ns; 2],
        // A repeated sample has taken no input.
        compute_ns: if stage.taken_ns == 0 { 0 } else { stage.computed_ns.saturating_sub(stage.taken_ns) },
        content: content.map_err(|fault| fault.to_string()),
    }
}
