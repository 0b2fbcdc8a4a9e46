//! The companion `ros2-view`: shows a drive to the tools of ROS 2.

use driver::ros2::Ros2Config;
use runtime::{Companion, monotonic_ns};
use shared_types::{Actuation, Command, Obstacles, Odometry, Pose, Scan};

use crate::arguments::{self, set};
use crate::drawing::Drawing;
use crate::goal::{self, Goals};
use crate::message::PoseStamped;
use crate::node::{RosNode, best_effort, reliable};
use crate::system::System;

/// Poses of the driven path that are shown.
const SHOWN: usize = 1000;
/// States are published this often [ns].
const STATES_NS: u64 = 1_000_000_000;
/// Where the topics are, unless an argument says otherwise: the robot may have a `/scan` of its own.
const NAMESPACE: &str = "/scanloop";

/// How a drive is shown.
#[derive(Debug)]
pub(crate) struct ViewOptions {
    config: Ros2Config,
    /// Where the scanner is on the robot [m, m, rad].
    scanner: [f64; 3],
    /// Whether goals are taken.
    has_control: bool,
}

impl ViewOptions {
    /// Those of arguments `KEY=VALUE`, and `--control`.
    ///
    /// # Errors
    /// An argument that is none of them, with what is allowed.
    pub(crate) fn read(arguments: &[&str]) -> Result<Self, String> {
        let (mut scanner, mut has_control) = ([0.0; 3], false);
        let known = ", scanner=X,Y,YAW, --control";
        let config = arguments::read(arguments, NAMESPACE, known, |key, value| match key {
            "scanner" => set(&mut scanner, arguments::three(value)),
            "--control" => set(&mut has_control, value.is_empty().then_some(true)),
            _ => false,
        })?;
        Ok(Self { config, scanner, has_control })
    }
}

/// Runs until asked to end.
///
/// # Errors
/// A node that can't be made, topics that the system file does not have, and errors of the bus.
pub(crate) fn run(options: &ViewOptions) -> anyhow::Result<()> {
    let ViewOptions { config, scanner, has_control } = options;
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
    let wanted = node.subscribe::<PoseStamped>(goal::TOPIC, best_effort())?;
    let mut goals = Goals::of(if *has_control { Some(System::running(None)?) } else { None });
    if !companion.start()? {
        return Ok(());
    }
    let drawing = Drawing { offset_s: node.now_s() - monotonic_ns() as f64 * 1e-9, scanner: *scanner };
    let mut driven: Vec<PoseStamped> = Vec::with_capacity(SHOWN + 1);
    let mut told_ns = 0;
    // What no node takes is lost: a view is no part of the drive.
    while companion.wait(None)? {
        while let Ok(Some((goal, _))) = wanted.take() {
            goals.take(goal);
        }
        goals.turn();
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
                let _ = states.publish(drawing.states(&sample, goals.refused.as_deref()));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scanner_and_whether_goals_are_taken_are_arguments() {
        let options = ViewOptions::read(&["domain=7", "scanner=0.1,0,1.5"]).unwrap();
        assert_eq!(
            (options.config.topic("scan").as_str(), options.scanner),
            ("/scanloop/scan", [0.1, 0.0, 1.5])
        );
        assert!(!options.has_control && ViewOptions::read(&["--control"]).unwrap().has_control);
        for wrong in ["scanner=1", "--control=no"] {
            assert!(
                ViewOptions::read(&[wrong])
                    .unwrap_err()
                    .starts_with(&format!("{wrong} is not allowed: some of "))
            );
        }
    }
}
