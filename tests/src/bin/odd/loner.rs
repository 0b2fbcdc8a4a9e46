//! An estimator that does by itself what the runtime does for others, and leaves one thing out.

use runtime::{Bus, INCARNATION_VARIABLE, Observer, Publisher, Shutdown, monotonic_ns};
use shared_types::{Directive, Heartbeat, Odometry, Phase, Pose, ProcessState, Role, StageStamps};

use crate::Outcome;

const ORPHAN_NS: u64 = 1_000_000_000;

/// Faults: `none`, `unready`, `silent`, `early-only`, `deaf`, `immortal`, `fickle`, `litters`.
pub(crate) fn run(fault: &str) -> Outcome {
    let incarnation: u32 = std::env::var(INCARNATION_VARIABLE)?.parse()?;
    let domain = crate::domain()?;
    let shutdown = Shutdown::on_signals()?;
    let bus = Bus::open(&domain, "loner")?;
    let directives = Observer::<Directive>::new(&bus)?;
    let odometry = Observer::<Odometry>::waking(&bus)?;
    let mut poses = Publisher::<Pose>::new(&bus)?;
    let mut heart = Publisher::<Heartbeat>::new(&bus)?;
    if fault == "litters" {
        std::fs::write(format!("/dev/shm/{}odd", domain.shared_memory_prefix()), "left")?;
    }
    let (mut state, mut directive) = (ProcessState::Attached, Directive::default());
    let (mut received_ns, mut beat_ns, mut activations, mut orchestrator) = (monotonic_ns(), 0, 0, 0);
    loop {
        odometry.wait(5_000_000);
        activations += 1;
        let before = state;
        directives.poll(|newest| (directive, received_ns) = (*newest, monotonic_ns()))?;
        let phase = Phase::try_from(directive.phase)?;
        let connects = phase == Phase::Connecting || phase > Phase::Connecting && fault != "early-only";
        if state == ProcessState::Attached && connects {
            state = ProcessState::Connected;
        }
        if orchestrator == 0 {
            orchestrator = directive.orchestrator_pid;
        }
        let orphan = monotonic_ns() - received_ns > ORPHAN_NS && fault != "immortal";
        let fickle = fault == "fickle" && directive.orchestrator_pid != orchestrator;
        if orphan || fickle || shutdown.requested() && fault != "deaf" {
            return Ok(());
        }
        let mut answers = Vec::new();
        odometry.poll(|sample| answers.push(*sample))?;
        if state == ProcessState::Attached {
            answers.clear();
        }
        for measured in &answers {
            let Odometry { header, x_m, y_m, yaw_rad, .. } = *measured;
            let mut pose = Pose { header, x_m, y_m, yaw_rad, ..Pose::default() };
            let now = monotonic_ns();
            pose.header.incarnation = incarnation;
            *pose.header.stage_mut(Role::Estimator) =
                StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
            poses.publish(&mut pose, true)?;
            if fault != "unready" {
                state = ProcessState::Ready;
            }
        }
        let due = monotonic_ns() - beat_ns > 90_000_000 && fault != "silent";
        if beat_ns == 0 || state != before || due {
            beat_ns = monotonic_ns();
            let mut beat = Heartbeat {
                role: Role::Estimator.wire(),
                state: state.wire(),
                pid: u64::from(std::process::id()),
                issued_ns: beat_ns,
                activations,
                ..Heartbeat::default()
            };
            beat.header.incarnation = incarnation;
            heart.publish(&mut beat, false)?;
        }
    }
}
