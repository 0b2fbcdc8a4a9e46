//! Faults of processes: kills, suspends, floods and fills.

use std::fs::{File, OpenOptions};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;
use faults::{ProcessAction, ProcessFault, ProcessName};
use runtime::{Bus, Domain, Observer, Publisher, RuntimeError};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::process::{Pid, Signal, kill_process};
use shared_types::{Actuation, Command, Obstacles, Pose, Role, Sample, Scan};

/// Time between two samples of a flood: ten thousand a second.
const FLOOD_PAUSE: Duration = Duration::from_micros(100);
/// Where shared memory is.
const SHARED_MEMORY: &str = "/dev/shm";

/// A fault that acts on a system; dropping it ends the flood and frees the memory.
#[derive(Default)]
pub struct Acting {
    suspended: Vec<Pid>,
    flood: Option<Flood>,
    ballast: Option<Ballast>,
}

/// The role whose process is faulty, where it is one.
pub fn faulty_role(fault: &ProcessFault) -> Option<Role> {
    match fault.process {
        ProcessName::Role(role) => Some(role),
        ProcessName::Orchestrator | ProcessName::All => None,
    }
}

/// Injects a fault now, into these processes.
///
/// # Errors
/// A topic that can't be opened, and shared memory that can't be filled.
pub fn act(fault: &ProcessFault, targets: Vec<Pid>, domain: &Domain) -> anyhow::Result<Acting> {
    let send = |signal: Signal| targets.iter().for_each(|pid| _ = kill_process(*pid, signal));
    let mut acting = Acting::default();
    match fault.action {
        ProcessAction::Kill => send(Signal::KILL),
        ProcessAction::Hang => {
            send(Signal::STOP);
            acting.suspended = targets;
        }
        ProcessAction::Flood => {
            acting.flood = faulty_role(fault).map(|role| Flood::start(role, domain)).transpose()?;
        }
        ProcessAction::Fill => acting.ballast = Some(Ballast::fill()?),
    }
    Ok(acting)
}

impl Acting {
    /// Ends what lasts only for a time.
    pub fn release(&mut self) {
        // The orchestrator may have killed it, and its number is not used again within seconds.
        self.suspended.drain(..).for_each(|pid| _ = kill_process(pid, Signal::CONT));
        self.flood = None;
    }
}

/// Repeats the newest sample of a role on its topic, from a thread, until dropped.
struct Flood {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Flood {
    fn start(role: Role, domain: &Domain) -> std::io::Result<Self> {
        let ends = Arc::new(AtomicBool::new(false));
        let (asked, domain) = (Arc::clone(&ends), domain.clone());
        let thread = std::thread::Builder::new().name("flood".to_owned()).spawn(move || {
            // A system that has ended meanwhile can't be flooded.
            let _ = match role {
                Role::Robot => flood::<Scan>(&domain, &asked),
                Role::Estimator => flood::<Pose>(&domain, &asked),
                Role::Obstacles => flood::<Obstacles>(&domain, &asked),
                Role::Controller => flood::<Command>(&domain, &asked),
                Role::Actuator => flood::<Actuation>(&domain, &asked),
            };
        })?;
        Ok(Self { ends, thread: Some(thread) })
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn flood<S: Sample>(domain: &Domain, ends: &AtomicBool) -> Result<(), RuntimeError> {
    let bus = Bus::open(domain, "flood")?;
    let (observer, mut publisher) = (Observer::<S>::new(&bus)?, Publisher::<S>::new(&bus)?);
    let mut newest: Option<S> = None;
    while !ends.load(Ordering::Acquire) {
        // What comes back from the flood itself has the same number.
        observer.poll(|sample| {
            let number = |sample: &S| sample.header().sequence;
            if newest.as_ref().is_none_or(|newest| number(sample) > number(newest)) {
                newest = Some(*sample);
            }
        })?;
        if let Some(sample) = &newest {
            publisher.publish_unchanged(sample, true)?;
        }
        std::thread::sleep(FLOOD_PAUSE);
    }
    Ok(())
}

/// A file that takes all of the shared memory until dropped.
struct Ballast(PathBuf);

impl Ballast {
    fn fill() -> anyhow::Result<Self> {
        let path = PathBuf::from(SHARED_MEMORY).join(format!("scanloop-ballast-{}", std::process::id()));
        let file: File = OpenOptions::new().create_new(true).write(true).open(&path)?;
        let ballast = Self(path);
        let status = statvfs(SHARED_MEMORY)?;
        fallocate(&file, FallocateFlags::empty(), 0, status.f_bavail * status.f_frsize)
            .context("shared memory can't be filled")?;
        Ok(ballast)
    }
}

impl Drop for Ballast {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
