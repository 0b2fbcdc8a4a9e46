//! What a cell observes of a running system: the true wheels, and what the processes report.

use fault_matrix::{Finding, FindingPlace, Findings, Passed};
use runtime::{Bus, Domain, Observer, RuntimeError, monotonic_ns};
use shared_types::{Actuation, ActuationKind, BlockReason, Directive, Heartbeat, ROLES, Role, Truth};

/// The counters of a heartbeat, by the names of findings.
type Counters = [(&'static str, u64); 5];

/// Observers of one system, and what they have seen.
pub(super) struct Watch {
    truths: Observer<Truth>,
    actuations: Observer<Actuation>,
    directives: Observer<Directive>,
    heartbeats: Observer<Heartbeat>,
    /// The true robot at each scan.
    pub(super) passed: Vec<Passed>,
    /// The newest truth.
    pub(super) newest: Truth,
    findings: Findings,
    /// By incarnation of the process.
    counters: Vec<(u32, Counters)>,
    incarnations: [u32; ROLES],
    /// The role whose process is faulty: a new process of it is a finding.
    faulty: Option<Role>,
    had_dead_man: bool,
    injected: bool,
    // Dropped last.
    _bus: Bus,
}

impl Watch {
    /// Observes from now on.
    ///
    /// # Errors
    /// [`RuntimeError`] when a topic can't be opened.
    pub(super) fn new(domain: &Domain) -> Result<Self, RuntimeError> {
        let bus = Bus::open(domain, "faults")?;
        Ok(Self {
            truths: Observer::new(&bus)?,
            actuations: Observer::new(&bus)?,
            directives: Observer::new(&bus)?,
            heartbeats: Observer::new(&bus)?,
            passed: Vec::new(),
            newest: Truth::default(),
            findings: Findings::default(),
            counters: Vec::new(),
            incarnations: [0; ROLES],
            faulty: None,
            had_dead_man: false,
            injected: false,
            _bus: bus,
        })
    }

    /// From now on what is found is a finding. `faulty` is the role whose process has the fault.
    pub(super) fn injected(&mut self, from_ns: u64, faulty: Option<Role>) {
        (self.injected, self.faulty, self.had_dead_man) = (true, faulty, self.newest.dead_man == 1);
        self.findings.restart(from_ns);
    }

    /// Takes what has come.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub(super) fn poll(&mut self) -> Result<(), RuntimeError> {
        let Self { truths, actuations, directives, heartbeats, passed, newest, findings, .. } = self;
        let now = FindingPlace { at_ns: monotonic_ns(), way_m: 0.0 };
        let injected = self.injected;
        truths.poll(|truth| {
            *newest = *truth;
            passed.push(Passed {
                at_ns: truth.header.acquired_ns,
                at_m: [truth.x_m, truth.y_m],
                way_m: truth.path_length_m,
                speed_mps: truth.speed_mps.abs(),
            });
        })?;
        if injected && newest.dead_man == 1 && !self.had_dead_man {
            findings.note(Role::Robot.name(), "dead_man", now);
        }
        let stage_is_faulty = self.faulty.is_some_and(|role| role != Role::Robot);
        actuations.poll(|actuation| {
            let reason = BlockReason::try_from(actuation.reason);
            let is_normal = |reason| match reason {
                BlockReason::None | BlockReason::Landed | BlockReason::Commanded => true,
                // The end of the run.
                BlockReason::StopRequested => stage_is_faulty,
                _ => false,
            };
            if injected
                && actuation.kind == ActuationKind::Block.wire()
                && let Ok(reason) = reason
                && !is_normal(reason)
            {
                let at_ns = actuation.header.stage(Role::Actuator).published_ns;
                findings.note(Role::Actuator.name(), reason.name(), FindingPlace { at_ns, ..now });
            }
        })?;
        let (incarnations, faulty) = (&mut self.incarnations, self.faulty);
        directives.poll(|directive| {
            for role in Role::ALL {
                let incarnation = directive.authority[role.index()].incarnation;
                let before = std::mem::replace(&mut incarnations[role.index()], incarnation);
                if injected && before != 0 && before != incarnation && faulty == Some(*role) {
                    findings.note("orchestrator", "replaced", now);
                }
            }
        })?;
        let counters = &mut self.counters;
        heartbeats.poll(|beat| {
            let Ok(role) = Role::try_from(beat.role) else { return };
            let (of, is) = (beat.header.incarnation, counters_of(beat));
            let known = counters.iter_mut().find(|(incarnation, _)| *incarnation == of);
            let Some((_, was)) = known else { return counters.push((of, is)) };
            for ((what, is), (_, was)) in is.into_iter().zip(*was) {
                if injected && is > was {
                    findings.note(role.name(), what, now);
                }
            }
            *was = is;
        })?;
        Ok(())
    }

    /// Notes that the run has ended by itself.
    pub(super) fn note_end(&mut self) {
        self.findings.note("orchestrator", "ended", FindingPlace { at_ns: monotonic_ns(), way_m: 0.0 });
    }

    /// All findings, without the way.
    pub(super) fn findings(&self) -> Vec<Finding> {
        self.findings.list()
    }
}

fn counters_of(beat: &Heartbeat) -> Counters {
    [
        ("not_valid", beat.invalid),
        ("too_old", beat.stale),
        ("duplicate", beat.duplicate),
        ("reordered", beat.reordered),
        ("missing", beat.missing),
    ]
}
