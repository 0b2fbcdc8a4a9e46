//! What a trial does: drawn from its seed, before anything is started.

use std::fmt;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rustix::process::Signal;
use shared_types::Role;

/// Signals that an operator, a terminal, a shell or a fault sends.
const SIGNALS: [(&str, Signal); 12] = [
    ("SIGSTOP", Signal::STOP),
    ("SIGKILL", Signal::KILL),
    ("SIGKILL", Signal::KILL),
    ("SIGTERM", Signal::TERM),
    ("SIGINT", Signal::INT),
    ("SIGHUP", Signal::HUP),
    ("SIGSEGV", Signal::SEGV),
    ("SIGBUS", Signal::BUS),
    ("SIGILL", Signal::ILL),
    ("SIGABRT", Signal::ABORT),
    ("SIGTSTP", Signal::TSTP),
    ("SIGCONT", Signal::CONT),
];
/// Scan rates [Hz]; half of all trials have the first.
const RATES_HZ: [u32; 6] = [10, 10, 10, 5, 20, 100];
/// Limits of open files under which a run may or may not start.
const DESCRIPTORS: [u32; 5] = [12, 24, 32, 48, 64];

/// A process of the system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActionTarget {
    /// The one that was started last.
    Orchestrator,
    /// The one that fills a role, or any of several.
    Of(Role),
}

impl fmt::Display for ActionTarget {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Orchestrator => formatter.write_str("orchestrator"),
            Self::Of(role) => formatter.write_str(role.name()),
        }
    }
}

/// A command that runs at the same time as a `stop`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rival {
    /// `adopt`, after the orchestrator was killed.
    Adopt,
    /// `swap` of a role.
    Swap(Role),
    /// `run` of the same system.
    Run,
    /// Another `stop`.
    Stop,
}

/// What is sent to the control socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Traffic {
    /// Random bytes.
    Garbage,
    /// A line without an end.
    EndlessLine,
    /// Connections that send nothing.
    Connections,
}

/// The process that is to take over in a swap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrialSuccessor {
    /// The built-in one.
    BuiltIn,
    /// A program that ends at once.
    Fails,
    /// A program that never joins.
    Sleeps,
}

/// One action of the operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OperatorAction {
    /// A signal, by its name.
    Signal(ActionTarget, &'static str, Signal),
    /// SIGSTOP, and SIGCONT after so many milliseconds.
    Pause(ActionTarget, u64),
    /// `scanloop restart`.
    Restart(Role),
    /// `scanloop swap`.
    Swap(Role, TrialSuccessor),
    /// Kills the orchestrator and starts `scanloop adopt` after so many milliseconds.
    Adopt(u64),
    /// A second `scanloop run` of the same system.
    Run,
    /// `stop` and a rival at the same time; the rival first when that is set.
    Race(Rival, bool),
    /// Traffic on the control socket.
    Socket(Traffic),
    /// Damages one of the files of the bus, by a number that chooses it; cut to nothing when that is set.
    Damage(u64, bool),
    /// Busy processes, with real-time priority when that is set.
    Load(bool),
    /// Fills shared memory, or the file system of the systems, but for so many bytes.
    Fill(bool, u64),
    /// Limits the open files of a process that runs.
    Descriptors(ActionTarget, u32),
}

impl fmt::Display for OperatorAction {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Signal(target, name, _) => write!(formatter, "{name} {target}"),
            Self::Pause(target, ms) => write!(formatter, "SIGSTOP {target} for {ms} ms"),
            Self::Restart(role) => write!(formatter, "restart {role}"),
            Self::Swap(role, successor) => write!(formatter, "swap {role} {successor:?}"),
            Self::Adopt(ms) => write!(formatter, "SIGKILL orchestrator, adopt after {ms} ms"),
            Self::Run => write!(formatter, "second run"),
            Self::Race(rival, first) => {
                let order = if *first { "just before" } else { "just after" };
                write!(formatter, "{rival:?} {order} stop")
            }
            Self::Socket(traffic) => write!(formatter, "socket {traffic:?}"),
            Self::Damage(_, true) => write!(formatter, "file of the bus cut"),
            Self::Damage(_, false) => write!(formatter, "garbage in a file of the bus"),
            Self::Load(fifo) => write!(formatter, "load{}", if *fifo { " with FIFO" } else { "" }),
            Self::Fill(shared, left) => {
                let place = if *shared { "/dev/shm" } else { "system directory" };
                write!(formatter, "{place} full but {left} bytes")
            }
            Self::Descriptors(target, count) => write!(formatter, "{target} may open {count} files"),
        }
    }
}

/// Where the standard error of the orchestrator leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StderrTarget {
    /// To a file.
    File,
    /// To a pipe that is full and not read.
    Stalled,
    /// To a pipe without a reader.
    Gone,
    /// Nowhere: it is closed.
    Closed,
}

/// All that a trial does.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialPlan {
    /// What it was drawn from.
    pub seed: u64,
    /// Name of a shipped scenario.
    pub scenario: &'static str,
    /// Scans per second.
    pub rate_hz: u32,
    /// Silence of the orchestrator after which wheels are blocked [s].
    pub orphan_stop_s: f64,
    /// Standard error of the first orchestrator.
    pub output: StderrTarget,
    /// Limit of open files under which the system is started.
    pub descriptors: Option<u32>,
    /// Actions, each after so many milliseconds of driving.
    pub steps: Vec<(u64, OperatorAction)>,
    /// When the last `stop` comes, likewise [ms].
    pub stop_ms: u64,
}

impl TrialPlan {
    /// The plan of a seed.
    pub fn of(seed: u64) -> Self {
        let mut dice = Pcg64::seed_from_u64(seed);
        let scenario = pick(&mut dice, &["endless", "corridor"]);
        let rate_hz = pick(&mut dice, &RATES_HZ);
        let orphan_stop_s = pick(&mut dice, &[1.0, 5.0]);
        let output = match dice.random_range(0..12) {
            0 => StderrTarget::Stalled,
            1 => StderrTarget::Gone,
            2 => StderrTarget::Closed,
            _ => StderrTarget::File,
        };
        let descriptors = (dice.random_range(0..25) == 0).then(|| pick(&mut dice, &DESCRIPTORS));
        let count = dice.random_range(1..=3);
        let mut steps: Vec<_> = (0..count).map(|_| (dice.random_range(0..2500), action(&mut dice))).collect();
        steps.sort_by_key(|(ms, _)| *ms);
        let stop_ms = steps.last().map_or(0, |(ms, _)| *ms) + dice.random_range(0..2500);
        Self { seed, scenario, rate_hz, orphan_stop_s, output, descriptors, steps, stop_ms }
    }

    /// Scan period [ns].
    pub fn period_ns(&self) -> u64 {
        1_000_000_000 / u64::from(self.rate_hz)
    }

    /// Whether an action meets a condition.
    pub fn any(&self, condition: impl Fn(&OperatorAction) -> bool) -> bool {
        self.steps.iter().any(|(_, action)| condition(action))
    }

    /// Whether `run` is called more than once.
    pub fn runs_again(&self) -> bool {
        self.any(|action| matches!(action, OperatorAction::Run | OperatorAction::Race(Rival::Run, _)))
    }

    /// Whether files of the bus are damaged.
    pub fn damages(&self) -> bool {
        self.any(|action| matches!(action, OperatorAction::Damage(..)))
    }
}

impl fmt::Display for TrialPlan {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, scenario, rate_hz, orphan_stop_s, .. } = self;
        write!(formatter, "seed {seed}: {scenario} {rate_hz} Hz, orphan_stop {orphan_stop_s} s")?;
        if self.output != StderrTarget::File {
            write!(formatter, ", stderr {:?}", self.output)?;
        }
        self.descriptors.iter().try_for_each(|count| write!(formatter, ", {count} files"))?;
        let mut steps = self.steps.iter();
        steps.try_for_each(|(ms, action)| write!(formatter, ", {ms} ms {action}"))?;
        write!(formatter, ", {} ms stop", self.stop_ms)
    }
}

fn pick<T: Copy>(dice: &mut Pcg64, from: &[T]) -> T {
    from[dice.random_range(0..from.len())]
}

fn target(dice: &mut Pcg64) -> ActionTarget {
    match dice.random_range(0..8) {
        0..3 => ActionTarget::Orchestrator,
        _ => ActionTarget::Of(pick(dice, Role::ALL)),
    }
}

fn action(dice: &mut Pcg64) -> OperatorAction {
    let role = pick(dice, Role::ALL);
    match dice.random_range(0..22) {
        0..6 => {
            let (name, signal) = pick(dice, &SIGNALS);
            OperatorAction::Signal(target(dice), name, signal)
        }
        6 => OperatorAction::Pause(target(dice), dice.random_range(50..2500)),
        7 => OperatorAction::Restart(role),
        8 | 9 => OperatorAction::Swap(
            role,
            pick(dice, &[TrialSuccessor::BuiltIn, TrialSuccessor::Fails, TrialSuccessor::Sleeps]),
        ),
        10 => OperatorAction::Adopt(dice.random_range(0..1500)),
        11 => OperatorAction::Run,
        12..15 => {
            let rival = pick(dice, &[Rival::Adopt, Rival::Swap(role), Rival::Run, Rival::Stop]);
            OperatorAction::Race(rival, dice.random_range(0..2) == 0)
        }
        15 => OperatorAction::Socket(pick(
            dice,
            &[Traffic::Garbage, Traffic::EndlessLine, Traffic::Connections],
        )),
        16 | 17 => OperatorAction::Damage(dice.random(), dice.random_range(0..2) == 0),
        18 | 19 => OperatorAction::Load(dice.random_range(0..2) == 0),
        20 => OperatorAction::Fill(dice.random_range(0..2) == 0, pick(dice, &[0, 4 << 10, 100 << 10])),
        _ => OperatorAction::Descriptors(target(dice), pick(dice, &DESCRIPTORS)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_always_gives_the_same_plan_and_seeds_give_all_kinds_of_action() {
        assert_eq!(TrialPlan::of(7), TrialPlan::of(7));
        let plans: Vec<TrialPlan> = (0..500).map(TrialPlan::of).collect();
        let actions: std::collections::BTreeSet<String> = plans
            .iter()
            .flat_map(|plan| &plan.steps)
            .map(|(_, action)| format!("{action:?}").split('(').next().unwrap_or_default().to_owned())
            .collect();
        assert_eq!(actions.len(), 12, "{actions:?}");
        assert!(plans.iter().all(|plan| (1..=3).contains(&plan.steps.len())));
    }
}
