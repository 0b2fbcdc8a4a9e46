//! Fault injection in a built-in implementation, when the run allows it.
//!
//! A thread looks for the fault file of the role, so that the process itself touches no file. It hands the fault over
//! when it begins, and again when its time is over.

use std::sync::mpsc::{Receiver, Sender, channel};

use anyhow::Context;
use faults::{ActiveFault, Change, Changed, InjectedFault, Injection, PERMIT_FILE, SampleFault, fault_file};
use runtime::{Domain, Tamper, monotonic_ns, tamper_with, wait_for};
use shared_types::{Role, SampleType, Topic};

/// Time between two looks at the file [ns].
const POLL_NS: u64 = 10_000_000;
/// Stack of the thread, which reads two small files [bytes].
const STACK: usize = 256 << 10;

/// Lets this process take faults, if the run allows it. Returns what changes the emulated robot: tables of the scenario, an
/// empty one for none.
///
/// # Errors
/// A thread that can't be started.
pub(super) fn arm(role: Role) -> anyhow::Result<impl FnMut() -> Option<toml::Table> + use<>> {
    let (to_robot, of_robot) = channel();
    let domain = Domain::of_this_process().ok().filter(|domain| domain.folder().contains(PERMIT_FILE));
    if let Some(domain) = domain {
        let (to_samples, of_samples) = channel();
        tamper_with(Box::new(Tampering { faults: of_samples, current: None }));
        let thread = std::thread::Builder::new().name("faults".to_owned()).stack_size(STACK);
        thread.spawn(move || watch(&domain, role, &to_samples, &to_robot)).context("thread for faults")?;
    }
    Ok(move || of_robot.try_recv().ok())
}

/// Hands over each fault of a role at its begin and at its end, as long as the process lives.
fn watch(
    domain: &Domain,
    role: Role,
    samples: &Sender<Option<(Change, Topic)>>,
    robot: &Sender<toml::Table>,
) {
    let mut current: Option<ActiveFault> = None;
    loop {
        let found = read(domain, role);
        if found != current {
            let fault = found.as_ref().and_then(|active| faults::find(&active.name).ok().flatten());
            match &fault {
                Some(fault) => tracing::warn!(fault = fault.name, "a fault is injected"),
                None => tracing::warn!("the injected fault is over"),
            }
            let of_samples = fault.as_ref().and_then(of_samples);
            let is_over = samples.send(of_samples.and_then(change)).is_err();
            if role == Role::Robot {
                let _ = robot.send(fault.as_ref().map(of_robot).unwrap_or_default());
            }
            if is_over {
                return;
            }
            current = found;
        }
        wait_for(&[], POLL_NS);
    }
}

/// The fault of the role now.
fn read(domain: &Domain, role: Role) -> Option<ActiveFault> {
    let text = domain.folder().read_text(&fault_file(role)).ok()?;
    toml::from_str::<ActiveFault>(&text).ok().filter(|active| active.until_ns > monotonic_ns())
}

fn of_samples(fault: &InjectedFault) -> Option<&SampleFault> {
    match &fault.inject {
        Injection::Sample(fault) => Some(fault),
        Injection::Scenario(_) | Injection::Process(_) | Injection::Person(_) => None,
    }
}

fn of_robot(fault: &InjectedFault) -> toml::Table {
    match &fault.inject {
        Injection::Scenario(fault) => fault.set.clone(),
        Injection::Sample(_) | Injection::Process(_) | Injection::Person(_) => toml::Table::new(),
    }
}

fn change(fault: &SampleFault) -> Option<(Change, Topic)> {
    Change::new(fault).ok().map(|change| (change, fault.topic))
}

/// Changes the samples of a process as its fault says.
struct Tampering {
    faults: Receiver<Option<(Change, Topic)>>,
    current: Option<(Change, Topic)>,
}

impl Tampering {
    fn change_of(&mut self, topic: Topic) -> Option<&mut Change> {
        if let Ok(fault) = self.faults.try_recv() {
            self.current = fault;
        }
        self.current.as_mut().filter(|(_, of)| *of == topic).map(|(change, _)| change)
    }
}

impl Tamper for Tampering {
    fn delay(&mut self, topic: Topic) {
        if let Some(delay_ns) = self.change_of(topic).and_then(|change| change.delay_ns()) {
            wait_for(&[], delay_ns);
        }
    }

    fn change(&mut self, of: &SampleType, sample: &mut [u8]) -> bool {
        match self.change_of(of.topic) {
            // The first sample of a fault that repeats one is the one that it repeats.
            Some(change) if change.needs_sample() => {
                change.keep(sample);
                true
            }
            Some(change) => change.apply(of, sample) != Changed::Nothing,
            None => true,
        }
    }
}
