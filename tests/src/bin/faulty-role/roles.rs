//! The built-in roles, step by step, with an outlet that can mistreat a sample.

use std::error::Error;

use runtime::{Input, Process, join};
use shared_types::{Actuation, Command, Obstacles, Odometry, Phase, Pose, Role, Sample, Scan, Truth};

use crate::Trouble;
use crate::outlet::Outlet;

type Ended = Result<(), Box<dyn Error>>;

/// The emulated robot.
pub(crate) fn robot(trouble: Trouble) -> Ended {
    let role = Role::Robot;
    let mut process = Process::attach(role)?;
    let scenario = process.settings::<emulator::Scenario>("scenario")?;
    let mut emulator = emulator::Emulator::new(&scenario, process.period_ns());
    let actuations = process.input::<Actuation>()?;
    let mut scans = Outlet::<Scan>::new(&mut process, role, trouble)?;
    let mut odometries = Outlet::<Odometry>::new(&mut process, role, trouble)?;
    let mut truths = Outlet::<Truth>::new(&mut process, role, trouble)?;
    if !process.start()? {
        return Ok(());
    }
    let simulated = process.clock().is_simulated();
    let origin_ns = process.clock().now_ns();
    let (mut scan_id, mut answered) = (1, 0);
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    loop {
        let ready_ns = emulator.scan_ready_ns(scan_id);
        if !process.wait(Some(origin_ns + ready_ns))? {
            return Ok(());
        }
        while let Some(actuation) = actuations.take() {
            if !simulated {
                emulator.advance_to(process.clock().now_ns() - origin_ns);
            }
            emulator.actuate(&actuation);
            answered = if actuation.answers == 1 { actuation.header.scan_id } else { answered };
        }
        let directive = process.directive();
        let due = if simulated {
            answered + 1 == scan_id && scan_id <= directive.granted_scan
        } else {
            process.clock().now_ns() >= origin_ns + ready_ns
        };
        if !due || directive.phase == Phase::Stopping.wire() {
            continue;
        }
        process.clock().advance_to(origin_ns + ready_ns);
        process.begin();
        emulator.advance_to(ready_ns);
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        for header in [&mut scan.header, &mut odometry.header, &mut truth.header] {
            header.scan_id = scan_id;
            header.acquired_ns = origin_ns + emulator.acquired_ns(scan_id);
        }
        truths.publish(&mut truth)?;
        scans.publish(&mut scan)?;
        odometries.publish(&mut odometry)?;
        scan_id += 1;
    }
}

/// The estimator.
pub(crate) fn estimator(trouble: Trouble) -> Ended {
    let mut process = Process::attach(Role::Estimator)?;
    let mut estimator = estimator::Estimator::new(&process.settings("estimator")?)?;
    let odometry = process.input::<Odometry>()?;
    let actuation = process.input::<Actuation>()?;
    let mut poses = Outlet::<Pose>::new(&mut process, Role::Estimator, trouble)?;
    if !process.start()? {
        return Ok(());
    }
    let mut actuated = 0;
    while process.wait(None)? {
        while let Some(scan_id) = odometry.next_scan() {
            while let Some(newer) = actuation.take() {
                actuated = newer.header.scan_id;
                estimator.note(&newer, process.clock().now_ns());
            }
            if process.clock().is_simulated() && actuated + 1 < scan_id {
                break;
            }
            poses.before_take(scan_id);
            let Some(measured) = odometry.take() else { break };
            poses.taken(scan_id);
            if let Some(mut pose) = estimator.step(&measured, None, process.clock().now_ns()) {
                poses.publish(&mut pose)?;
            }
        }
    }
    Ok(())
}

/// The obstacle detector.
pub(crate) fn obstacles(trouble: Trouble) -> Ended {
    let mut process = Process::attach(Role::Obstacles)?;
    let mut detector = obstacles::ObstacleDetector::new(process.settings("obstacles")?)?;
    let scans = process.input::<Scan>()?;
    let poses = process.input::<Pose>()?;
    let mut described = Outlet::<Obstacles>::new(&mut process, Role::Obstacles, trouble)?;
    if !process.start()? {
        return Ok(());
    }
    while process.wait(None)? {
        while let Some((scan, pose)) = join_late(&scans, &poses, &described) {
            described.taken(scan.header.scan_id);
            described.publish(&mut detector.step(&scan, &pose))?;
        }
    }
    Ok(())
}

/// The controller.
pub(crate) fn controller(trouble: Trouble) -> Ended {
    let mut process = Process::attach(Role::Controller)?;
    let config = process.settings::<nmpc::ControllerConfig>("controller")?;
    let budget = nmpc::Budget::Iterations(config.budget_iterations);
    let mut controller = nmpc::Controller::new(config)?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.input::<Obstacles>()?;
    let mut commands = Outlet::<Command>::new(&mut process, Role::Controller, trouble)?;
    if !process.start()? {
        return Ok(());
    }
    while process.wait(None)? {
        while let Some((pose, obstacles)) = join_late(&poses, &obstacles, &commands) {
            commands.taken(pose.header.scan_id);
            commands.publish(&mut controller.step(&pose, &obstacles, &budget))?;
        }
    }
    Ok(())
}

/// The actuator.
pub(crate) fn actuator(trouble: Trouble) -> Ended {
    let mut process = Process::attach(Role::Actuator)?;
    let mut actuator = actuation::Actuator::new(process.settings("actuator")?, process.period_ns())?;
    let commands = process.input::<Command>()?;
    let mut actuations = Outlet::<Actuation>::new(&mut process, Role::Actuator, trouble)?;
    if !process.start()? {
        return Ok(());
    }
    let poll_ns = process.period_ns() / 10;
    while process.wait(Some(process.clock().now_ns() + poll_ns))? {
        if process.directive().stop == 1 && !actuator.is_stopped() {
            actuations.publish(&mut actuator.stop(process.clock().now_ns(), false))?;
        }
        while let Some(scan_id) = commands.next_scan() {
            actuations.before_take(scan_id);
            let Some(command) = commands.take() else { break };
            actuations.taken(scan_id);
            actuations.publish(&mut actuator.answer(&command, process.clock().now_ns()))?;
        }
        if !process.clock().is_simulated()
            && let Some(mut block) = actuator.tick(process.clock().now_ns())
        {
            actuations.publish(&mut block)?;
        }
    }
    actuations.publish(&mut actuator.stop(process.clock().now_ns(), false))?;
    Ok(())
}

/// Joins two inputs; waits before that if it is planned and both are there.
fn join_late<A: Sample, B: Sample, C: Sample>(
    one: &Input<A>,
    other: &Input<B>,
    outlet: &Outlet<C>,
) -> Option<(runtime::Taken<A>, runtime::Taken<B>)> {
    if let (Some(scan_id), Some(also)) = (one.next_scan(), other.next_scan())
        && scan_id == also
    {
        outlet.before_take(scan_id);
    }
    join(one, other)
}
