//! Estimators with a fault.

use runtime::{Handover, Process, monotonic_ns, wait_for};
use shared_types::{Actuation, Header, Odometry, Pose, Role};

use crate::{Outcome, everything};

/// Faults of its outputs: `skips`, `twice`, `late`, `header`, `nan`, `infinite`, `random`, `stateless`, `amnesia`,
/// `guesses`, `off`, `behind`, `uncorrected`, `gullible`, `sure`. Of inputs that are not checked: `trusts` (writer,
/// age, repetition), `believes` (content), `stays` (with the first producer), `invents`.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Estimator)?;
    let mut config = process.settings::<estimator::EstimatorConfig>("estimator")?;
    if fault == "uncorrected" {
        config.odometry_longitudinal = Some(0.0);
    }
    if fault == "gullible" {
        (config.gate, config.measurement_noise) = (Some(false), Some([1e-12; 3]));
    }
    let mut estimator = estimator::Estimator::new(&config)?;
    let odometry = process.input::<Odometry>()?;
    let actuation = process.input::<Actuation>()?;
    let poses = process.output::<Pose>()?;
    match process.resume::<estimator::EstimatorState>()? {
        Handover::State(state) if fault != "amnesia" => estimator.resume(&state)?,
        Handover::Lost if fault != "guesses" => return idle(process),
        _ => {}
    }
    let (_bus, all) = everything::<Odometry>()?;
    if !process.start()? {
        return Ok(());
    }
    let raw = ["trusts", "believes", "stays", "invents"].contains(&fault);
    let (mut first, mut last, mut idle) = (0, Odometry::default(), 0);
    while process.wait(None)? {
        while let Some(newer) = actuation.take() {
            estimator.note(&newer, process.clock().now_ns());
        }
        let mut asked = Vec::new();
        while let Some(measured) = odometry.take() {
            if !raw || fault == "invents" {
                asked.push(*measured);
            }
        }
        while let Some((measured, sound)) = all.next()? {
            let directive = process.directive();
            let header = &measured.header;
            let named = directive.authority[Role::Robot.index()].accepts(header.incarnation, header.scan_id);
            if named && first == 0 {
                first = header.incarnation;
            }
            let taken = match fault {
                "trusts" => sound.is_ok(),
                "believes" => named,
                "stays" => sound.is_ok() && header.incarnation == first,
                _ => false,
            };
            if taken {
                asked.push(measured);
            }
        }
        idle = if asked.is_empty() { idle + 1 } else { 0 };
        if fault == "invents" && idle == 1 && last.header.scan_id > 0 {
            last.header.scan_id += 1;
            last.header.sequence += 1;
            last.header.acquired_ns += process.period_ns();
            asked.push(last);
        }
        for measured in asked {
            last = measured;
            let now = process.clock().now_ns();
            // What is not even checked is answered with its content.
            let plain = Pose {
                header: measured.header.answer(),
                x_m: measured.x_m,
                y_m: measured.y_m,
                ..Pose::default()
            };
            let mut pose = if raw { plain } else { estimator.step(&measured, None, now).unwrap_or(plain) };
            if !spoil(fault, &mut pose, &process) {
                continue;
            }
            poses.publish(&mut pose)?;
            if fault == "twice" {
                poses.publish(&mut pose)?;
            }
            if fault != "stateless" {
                process.save(&pose.header, &estimator.state())?;
            }
        }
    }
    Ok(())
}

/// Changes a pose before it is published; false when it is not published.
fn spoil(fault: &str, pose: &mut Pose, process: &Process) -> bool {
    match fault {
        "skips" => return !pose.header.scan_id.is_multiple_of(5),
        "late" => {
            wait_for(&[], process.period_ns() * 3 / 2);
        }
        "header" => pose.header.chain = Header::default().chain,
        "nan" if pose.header.scan_id.is_multiple_of(7) => pose.x_m = f64::NAN,
        "infinite" => pose.x_m = f64::INFINITY,
        "random" => pose.nis = monotonic_ns() as f64,
        "off" => pose.y_m += 0.2,
        "behind" => (pose.predicted_x_m, pose.predicted_ns) = (pose.x_m - 0.1, pose.header.acquired_ns),
        "sure" => pose.covariance = [0.0; 9],
        _ => {}
    }
    true
}

fn idle(mut process: Process) -> Outcome {
    if process.start()? {
        while process.wait(None)? {}
    }
    Ok(())
}
