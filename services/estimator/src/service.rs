//! The process of the role `estimator`: odometry and actuation in, pose out.

use runtime::{Handover, Process};
use shared_types::{Actuation, Odometry, Pose, Role};

use crate::{Estimator, EstimatorConfig};

/// Runs until asked to end.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Estimator)?;
    let mut estimator = Estimator::new(&process.settings::<EstimatorConfig>("estimator")?)?;
    let odometry = process.input::<Odometry>()?;
    let actuation = process.input::<Actuation>()?;
    let poses = process.output::<Pose>()?;
    // Without the state of the process before, the correction of the odometry is lost, and with it the position.
    let mut lost = match process.resume()? {
        Handover::State(state) => estimator.resume(&state).is_err(),
        Handover::FirstStart => false,
        Handover::Lost => true,
    };
    // Actuations that the process before did not receive, such as the block that followed its silence.
    process.handed_actuations().for_each(|actuation| estimator.note(&actuation, process.now_ns()));
    if lost {
        tracing::error!("no fresh state to resume from: no pose will be published");
    }
    if !process.start()? {
        return Ok(());
    }
    if let Some((_, state)) = process.join()? {
        lost = estimator.resume(&state).is_err();
        odometry.skip(|measured| !estimator.is_newer(measured));
    }
    let mut actuated = process.handed_scan();
    let (mut last, period_ns) = (None, process.period_ns());
    while process.wait_preparing(None, &mut |due_ns| {
        if let Some(last) = &last {
            estimator.rehearse(last, period_ns, due_ns);
        }
    })? {
        loop {
            while let Some(newer) = actuation.take() {
                actuated = newer.header.scan_id;
                estimator.note(&newer, process.now_ns());
                let state = estimator.state();
                if state.initialised.is_set() {
                    process.save(&newer.header, &state)?;
                }
            }
            let Some(scan_id) = odometry.next_scan() else { break };
            // In lock-step, wait for the actuation of the scan before: the result must not depend on when it arrives.
            if process.clock().is_simulated() && actuated < scan_id.saturating_sub(1) {
                break;
            }
            let Some(measured) = odometry.take() else { break };
            if lost {
                continue;
            }
            if let Some(mut pose) = estimator.step(&measured, None, process.now_ns()) {
                poses.publish(&mut pose)?;
                process.save(&pose.header, &estimator.state())?;
                last = Some(*measured);
            }
        }
    }
    Ok(())
}
