//! Samples of a drive as messages of ROS 2.

use shared_types::{
    Actuation, ActuationKind, Command, Header as SampleHeader, MIN_RANGE_MM, Obstacle, Obstacles,
    Odometry as Reported, Pose as Estimated, Role, Scan,
};

use crate::goal::FRAME as TRACK;
use crate::message::{
    ColorRGBA, DiagnosticArray, DiagnosticStatus, Duration, Header, KeyValue, LaserScan, Marker, MarkerArray,
    Odometry, Path, Pose, PoseStamped, Quaternion, TFMessage, Time, Transform, TransformStamped, Vector3,
};

/// The frame in which the robot reports its pose.
const REPORTED: &str = "odom";
/// The frame of the robot.
const ROBOT: &str = "base_link";
/// The frame of the scanner.
const SCANNER: &str = "scanner";
/// Error code of a beam that is not measured.
const NOT_MEASURED: u32 = 19;
/// Longest range of a scan [m].
const MAX_RANGE_M: f32 = 5.6;
/// Kind of a marker: a cylinder, stretched to an ellipse.
const CYLINDER: i32 = 3;
/// Action of a marker: it is removed with all others.
const DELETE_ALL: i32 = 3;
/// Obstacles are drawn this high [m].
const HEIGHT_M: f64 = 0.3;
/// Level of a state that is as it should be.
const OK: u8 = 0;
/// See [`OK`].
const WARN: u8 = 1;

/// Makes messages of samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drawing {
    /// The clock of the messages minus CLOCK_MONOTONIC [s].
    pub(crate) offset_s: f64,
    /// Where the scanner is on the robot [m, m, rad].
    pub(crate) scanner: [f64; 3],
}

impl Drawing {
    fn header(&self, time_ns: u64, frame: &str) -> Header {
        Header { stamp: Time::of_seconds(time_ns as f64 * 1e-9 + self.offset_s), frame_id: frame.to_owned() }
    }

    /// A scan; its stamp is that of the first beam.
    pub(crate) fn scan(&self, scan: &Scan) -> LaserScan {
        let range = |range_mm: &u32| match *range_mm {
            NOT_MEASURED => f32::NAN,
            range_mm if range_mm < MIN_RANGE_MM => f32::INFINITY,
            range_mm => range_mm as f32 / 1e3,
        };
        let first_ns = (scan.beam_time_s(0) * 1e9) as i64;
        LaserScan {
            header: self.header(scan.header.acquired_ns.saturating_add_signed(first_ns), SCANNER),
            angle_min: scan.beam_yaw_rad(0) as f32,
            angle_max: scan.beam_yaw_rad(scan.ranges().len().saturating_sub(1)) as f32,
            angle_increment: scan.increment_rad as f32,
            time_increment: (scan.sweep_ns as f64 * 1e-9 / scan.ranges().len().max(1) as f64) as f32,
            scan_time: (scan.period_ns as f64 * 1e-9) as f32,
            range_min: MIN_RANGE_MM as f32 * 1e-3,
            range_max: MAX_RANGE_M,
            ranges: scan.ranges().iter().map(range).collect(),
            intensities: Vec::new(),
        }
    }

    /// What the robot reported.
    pub(crate) fn odometry(&self, reported: &Reported) -> Odometry {
        let mut message = Odometry {
            header: self.header(reported.header.acquired_ns, REPORTED),
            child_frame_id: ROBOT.to_owned(),
            ..Odometry::default()
        };
        message.pose.pose = flat([reported.x_m, reported.y_m, reported.yaw_rad]);
        message.twist.twist.linear.x = reported.speed_mps;
        message.twist.twist.angular.z =
            if reported.dt_s > 0.0 { reported.dyaw_rad / reported.dt_s } else { 0.0 };
        message
    }

    /// Where the robot is on the track by the estimate, and the scanner on the robot.
    pub(crate) fn frames(&self, pose: &Estimated) -> TFMessage {
        let time_ns = pose.header.acquired_ns;
        let transform = |parent: &str, child: &str, [x, y, yaw_rad]: [f64; 3]| TransformStamped {
            header: self.header(time_ns, parent),
            child_frame_id: child.to_owned(),
            transform: Transform {
                translation: Vector3 { x, y, z: 0.0 },
                rotation: Quaternion::of_yaw(yaw_rad),
            },
        };
        let of_robot = transform(TRACK, ROBOT, [pose.x_m, pose.y_m, pose.yaw_rad]);
        TFMessage { transforms: vec![of_robot, transform(ROBOT, SCANNER, self.scanner)] }
    }

    /// A pose of the driven path.
    pub(crate) fn waypoint(&self, pose: &Estimated) -> PoseStamped {
        PoseStamped {
            header: self.header(pose.header.acquired_ns, TRACK),
            pose: flat([pose.x_m, pose.y_m, pose.yaw_rad]),
        }
    }

    /// The path that was driven.
    pub(crate) fn path(&self, poses: &[PoseStamped]) -> Path {
        let stamp = poses.last().map_or_else(Time::default, |pose| pose.header.stamp.clone());
        Path { header: Header { stamp, frame_id: TRACK.to_owned() }, poses: poses.to_vec() }
    }

    /// The plan of a command.
    pub(crate) fn plan(&self, command: &Command) -> Path {
        let time_ns = |node: usize| {
            command.plan_start_ns + (node as f64 * command.plan_interval_s.max(0.0) * 1e9) as u64
        };
        let nodes = command.nodes().iter().enumerate();
        let poses = nodes.map(|(index, node)| PoseStamped {
            header: self.header(time_ns(index), TRACK),
            pose: flat([node.x_m, node.y_m, node.yaw_rad]),
        });
        Path { header: self.header(command.header.acquired_ns, TRACK), poses: poses.collect() }
    }

    /// The ellipses of obstacles, in place of those before.
    pub(crate) fn obstacles(&self, obstacles: &Obstacles) -> MarkerArray {
        let header = self.header(obstacles.header.acquired_ns, TRACK);
        let clear =
            Marker { header: header.clone(), action: DELETE_ALL, pose: flat([0.0; 3]), ..Marker::default() };
        let markers = obstacles.list().iter().map(|obstacle| marker(&header, obstacle));
        MarkerArray { markers: std::iter::once(clear).chain(markers).collect() }
    }

    /// What each process of the loop did for the scan of an actuation, and why the newest goal of a tool was not taken.
    pub(crate) fn states(&self, actuation: &Actuation, refused_goal: Option<&str>) -> DiagnosticArray {
        let SampleHeader { acquired_ns, scan_id, .. } = actuation.header;
        let is_blocked = actuation.kind == ActuationKind::Block.wire();
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let state = |role: Role| {
            let stamps = actuation.header.stage(role);
            let has_worked = stamps.published_ns >= acquired_ns && acquired_ns > 0;
            let blocks = role == Role::Actuator && is_blocked;
            let message = match (has_worked, blocks) {
                (_, true) => "the wheels are blocked",
                (true, _) => "works",
                (false, _) => "no output for this scan",
            };
            let mut values = vec![value("scan", scan_id.to_string())];
            if has_worked {
                let latency_ms = (stamps.published_ns - acquired_ns) as f64 * 1e-6;
                let busy_ms = stamps.published_ns.saturating_sub(stamps.taken_ns) as f64 * 1e-6;
                values.push(value("after the front beam [ms]", format!("{latency_ms:.3}")));
                values.push(value("for itself [ms]", format!("{busy_ms:.3}")));
            }
            DiagnosticStatus {
                level: if has_worked && !blocks { OK } else { WARN },
                name: format!("scanloop: {role}"),
                message: message.to_owned(),
                hardware_id: "scanloop".to_owned(),
                values,
            }
        };
        let goal = refused_goal.map(|reason| DiagnosticStatus {
            level: WARN,
            name: "scanloop: goal".to_owned(),
            message: reason.to_owned(),
            hardware_id: "scanloop".to_owned(),
            values: Vec::new(),
        });
        DiagnosticArray {
            header: self.header(acquired_ns, ""),
            status: Role::ALL.iter().copied().map(state).chain(goal).collect(),
        }
    }
}

fn flat([x, y, yaw_rad]: [f64; 3]) -> Pose {
    Pose { position: Vector3 { x, y, z: 0.0 }, orientation: Quaternion::of_yaw(yaw_rad) }
}

fn marker(header: &Header, obstacle: &Obstacle) -> Marker {
    let mut pose = flat([obstacle.x_m, obstacle.y_m, 0.0]);
    pose.position.z = HEIGHT_M / 2.0;
    Marker {
        header: header.clone(),
        ns: "obstacles".to_owned(),
        id: obstacle.id.cast_signed(),
        kind: CYLINDER,
        pose,
        scale: Vector3 { x: 2.0 * obstacle.a_m, y: 2.0 * obstacle.b_m, z: HEIGHT_M },
        color: ColorRGBA { r: 0.85, g: 0.35, b: 0.1, a: 0.7 },
        // A view that hears nothing more shows nothing.
        lifetime: Duration { sec: 1, nanosec: 0 },
        ..Marker::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use shared_types::{BEAMS, ScanGeometry};

    const DRAWING: Drawing = Drawing { offset_s: 100.0, scanner: [0.1, 0.0, 0.0] };

    #[test]
    fn a_scan_says_what_returned_what_did_not_and_what_was_not_measured() {
        let mut scan =
            Scan { sweep_ns: 66_000_000, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
        scan.header.acquired_ns = 2_000_000_000;
        scan.ranges_mut().fill(1500);
        (scan.ranges_mm[1], scan.ranges_mm[2]) = (0, NOT_MEASURED);
        let message = DRAWING.scan(&scan);
        assert_eq!((message.ranges[0], message.ranges[1], message.ranges.len()), (1.5, f32::INFINITY, BEAMS));
        assert!(message.ranges[2].is_nan());
        // The first beam is half a sweep, 33 ms, before the front one.
        assert!((message.header.stamp.seconds() - 101.967).abs() < 2e-3, "{:?}", message.header);
        assert!((message.angle_min + 2.086).abs() < 1e-3 && message.angle_increment > 0.0);
    }

    #[test]
    fn obstacles_replace_those_before_and_are_as_large_as_their_ellipses() {
        let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
        obstacles.items[0] =
            Obstacle { id: 7, x_m: 3.0, y_m: -1.0, a_m: 0.4, b_m: 0.25, ..Obstacle::default() };
        let [clear, marker] = &DRAWING.obstacles(&obstacles).markers[..] else { panic!("two markers") };
        assert_eq!((clear.action, marker.action, marker.id, marker.kind), (DELETE_ALL, 0, 7, CYLINDER));
        assert_eq!((marker.scale.x, marker.scale.y, marker.pose.position.x), (0.8, 0.5, 3.0));
        assert_eq!(marker.pose.orientation.w, 1.0);
    }

    #[test]
    fn states_tell_how_long_each_process_took() {
        let mut actuation = Actuation { kind: ActuationKind::Drive.wire(), ..Actuation::default() };
        actuation.header.acquired_ns = 1_000_000_000;
        let stamps = actuation.header.stage_mut(Role::Controller);
        (stamps.taken_ns, stamps.published_ns) = (1_001_000_000, 1_003_500_000);
        let states = DRAWING.states(&actuation, None).status;
        let controller = &states[Role::Controller.index()];
        assert_eq!((controller.level, controller.name.as_str()), (OK, "scanloop: controller"));
        assert_eq!(controller.values[1].value, "3.500");
        assert_eq!(controller.values[2].value, "2.500");
        assert_eq!((states[0].level, states[0].message.as_str()), (WARN, "no output for this scan"));
        let with_goal = DRAWING.states(&actuation, Some("not taken")).status;
        let goal = with_goal.last().unwrap();
        assert_eq!(
            (with_goal.len(), goal.level, goal.message.as_str()),
            (states.len() + 1, WARN, "not taken")
        );
    }
}
