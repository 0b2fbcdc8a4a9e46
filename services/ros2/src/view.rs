//! The companion `ros2-view`: shows a drive to the tools of ROS 2.

use driver::ros2::Ros2Config;
use runtime::{Companion, monotonic_ns};
use shared_types::{Actuation, Command, Obstacles, Odometry, Pose, Scan};

use crate::drawing::Drawing;
use crate::message::PoseStamped;
use crate::node::{RosNode, best_effort, reliable};

/// Poses of the driven path that are shown.
const SHOWN: usize = 1000;
/// States are published this often [ns].
const STATES_NS: u64 = 1_000_000_000;
/// Where the topics are, unless an argument says otherwise: the robot may have a `/scan` of its own.
const NAMESPACE: &str = "/scanloop";
/// Where tools for ROS 2 send a goal.
const GOAL: &str = "/goal_pose";

/// Where the topics are, of the arguments `KEY=VALUE`: those of the table `[ros2]` with these names.
///
/// # Errors
/// An argument that is none of them, with what is allowed.
pub(crate) fn settings(arguments: &[&str]) -> Result<(Ros2Config, [f64; 3]), String> {
    let mut config = Ros2Config { namespace: NAMESPACE.to_owned(), ..Ros2Config::default() };
    let mut scanner = [0.0; 3];
    for argument in arguments {
        let known = "domain=NUMBER, interface=ADDRESS, namespace=/NAME, scanner=X,Y,YAW";
        let refused = || format!("{argument} is not allowed: some of {known}");
        match argument.split_once('=').ok_or_else(refused)? {
            ("domain", value) => config.domain = value.parse().map_err(|_| refused())?,
            ("interface", value) => config.interface = value.to_owned(),
            ("namespace", value) => config.namespace = value.trim_end_matches('/').to_owned(),
            ("scanner", value) => {
                let numbers: Result<Vec<f64>, _> = value.split(',').map(str::parse).collect();
                scanner = numbers.ok().and_then(|numbers| numbers.try_into().ok()).ok_or_else(refused)?;
            }
            _ => return Err(refused()),
        }
    }
    config.validate().map_err(|invalid| invalid.to_string())?;
    Ok((config, scanner))
}

/// Runs until asked to end.
///
/// # Errors
/// A node that can't be made, topics that the system file does not have, and errors of the bus.
pub(crate) fn run(config: &Ros2Config, scanner: [f64; 3]) -> anyhow::Result<()> {
    let mut companion = Companion::attach()?;
    let scans = companion.input::<Scan>()?;
    let odometries = companion.input::<Odometry>()?;
    let poses = companion.input::<Pose>()?;
    let described = companion.input::<Obstacles>()?;
    let commands = companion.input::<Command>()?;
    let actuations = companion.input::<Actuation>()?;
    let mut node = RosNode::open(config, "scanloop_view")?;
    let scan = node.advertise(&config.topic("scan"), best_effort())?;
    let odometry = node.advertise(&config.topic("odom"), reliable())?;
    let frames = node.advertise("/tf", reliable())?;
    let path = node.advertise(&config.topic("path"), reliable())?;
    let plan = node.advertise(&config.topic("plan"), reliable())?;
    let obstacles = node.advertise(&config.topic("obstacles"), reliable())?;
    let states = node.advertise("/diagnostics", reliable())?;
    let goals = node.subscribe::<PoseStamped>(GOAL, best_effort())?;
    if !companion.start()? {
        return Ok(());
    }
    let drawing = Drawing { offset_s: node.now_s() - monotonic_ns() as f64 * 1e-9, scanner };
    let mut driven: Vec<PoseStamped> = Vec::with_capacity(SHOWN + 1);
    let mut told_ns = 0;
    let mut refused = None;
    // What no node takes is lost: a view is no part of the drive.
    while companion.wait(None)? {
        while let Ok(Some((goal, _))) = goals.take() {
            let reason = not_taken(&goal);
            tracing::warn!("{reason}");
            refused = Some(reason);
        }
        while let Some(sample) = scans.take()? {
            let _ = scan.publish(drawing.scan(&sample));
        }
        while let Some(sample) = odometries.take()? {
            let _ = odometry.publish(drawing.odometry(&sample));
        }
        while let Some(sample) = poses.take()? {
            let _ = frames.publish(drawing.frames(&sample));
            driven.push(drawing.waypoint(&sample));
            if driven.len() > SHOWN {
                driven.remove(0);
            }
            let _ = path.publish(drawing.path(&driven));
        }
        while let Some(sample) = described.take()? {
            let _ = obstacles.publish(drawing.obstacles(&sample));
        }
        while let Some(sample) = commands.take()? {
            let _ = plan.publish(drawing.plan(&sample));
        }
        while let Some(sample) = actuations.take()? {
            if monotonic_ns() >= told_ns + STATES_NS {
                told_ns = monotonic_ns();
                let _ = states.publish(drawing.states(&sample, refused.as_deref()));
            }
        }
    }
    Ok(())
}

/// What is said of a goal that a tool has sent: one that is ignored without a word would be taken for the goal of the drive.
fn not_taken(goal: &PoseStamped) -> String {
    let (place, frame) = (&goal.pose.position, &goal.header.frame_id);
    format!(
        "the goal x {:.2} m, y {:.2} m in `{frame}` from {GOAL} was not taken: the goal of a run is that of its scenario",
        place.x, place.y
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_those_of_the_driver_and_others_are_refused_with_what_is_allowed() {
        let (config, scanner) = settings(&["domain=7", "interface=127.0.0.1", "scanner=0.1,0,1.5"]).unwrap();
        assert_eq!((config.domain, config.topic("scan").as_str()), (7, "/scanloop/scan"));
        assert_eq!(scanner, [0.1, 0.0, 1.5]);
        assert_eq!(settings(&["namespace=/"]).unwrap().0.topic("plan"), "/plan");
        for wrong in ["domain=x", "scanner=1", "colour=red", "namespace"] {
            let refused = settings(&[wrong]).unwrap_err();
            assert!(refused.starts_with(&format!("{wrong} is not allowed: some of domain=")), "{refused}");
        }
        assert_eq!(settings(&["domain=300"]).unwrap_err(), "domain = 300 is not allowed: 0 to 232");
    }
}
