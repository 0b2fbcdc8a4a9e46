//! The frames of the nodes of the optimal control problem along a course.
//!
//! Each node has the frame that is tangent to the course beside the guess of its position. So the kinematics are exact,
//! and weights, bounds and ellipses are along and across the course where the node is. A frame has the coordinates of
//! the course at its own place, so a guess and a reference on the course are the same numbers in it.
//!
//! Where it fails: a metre from its place along a frame of 4 m a frame is 12 cm beside the course. The guess of the next
//! scan begins nearer.

use nalgebra::Vector2;
use ocp::{EllipsePath, NodeFrame};
use vehicle::State;

use crate::scene::Scene;

/// Shortest way between two nodes over which the course has a mean curvature [m].
const SHORT_M: f64 = 1e-3;

/// The places of the frames along the course, one for each node; none on a line.
#[derive(Debug, Clone, Default)]
pub(crate) struct Frames {
    along: Vec<f64>,
}

impl Frames {
    /// Places the frames beside the nodes of a guess, and fills `steps` with each as it is seen from the one before.
    pub(crate) fn place(&mut self, scene: &Scene, nodes: &[State], steps: &mut Vec<NodeFrame>) {
        self.along.clear();
        steps.clear();
        let (course, vehicle) = (&scene.config.course, &scene.config.vehicle);
        if course.is_line() {
            return;
        }
        self.along.extend(nodes.iter().map(|node| node.x));
        let (gain, steering_max) = (vehicle.parameters().yaw_rate_gain(), vehicle.bounds.steering_max_rad);
        for pair in self.along.windows(2) {
            let [before, here] = [pair[0], pair[1]].map(|along| course.at(along));
            let [ahead, left] = before.offset(here.point);
            let (angle, way) = (here.yaw - before.yaw, pair[1] - pair[0]);
            let curvature = if way > SHORT_M { angle / way } else { before.curvature };
            let steering = curvature / gain;
            let steering = if steering.is_finite() { steering } else { 0.0 };
            steps.push(NodeFrame {
                from: [pair[0] + ahead, left],
                to: [pair[1], 0.0],
                angle,
                steering: steering.clamp(-steering_max, steering_max),
                y_range: scene.y_range_at(pair[1]),
            });
        }
    }

    /// Puts the centres of the ellipses, which belong to the obstacles `owners`, into the frames of the nodes.
    pub(crate) fn place_ellipses(&self, scene: &Scene, owners: &[usize], ellipses: &mut [EllipsePath]) {
        let (course, interval_s) = (&scene.config.course, scene.config.interval_s());
        for (ellipse, owner) in ellipses.iter_mut().zip(owners) {
            for (node, along) in self.along.iter().enumerate() {
                let [x, y] = scene.predicted[*owner].centre_at(node as f64 * interval_s);
                let centre = course.in_plane(&State { x, y, ..State::default() });
                let [ahead, left] = course.at(*along).offset(Vector2::new(centre.x, centre.y));
                ellipse.centres[node] = [along + ahead, left];
            }
        }
    }

    /// The largest distance between states in these frames and those of a rollout on the course [m].
    pub(crate) fn largest_distance(&self, scene: &Scene, planned: &[State], driven: &[State]) -> f64 {
        if planned.len() != driven.len() {
            return f64::MAX;
        }
        let distance = |(index, (a, b)): (usize, (&State, &State))| {
            let Some(along) = self.along.get(index) else { return (a.x - b.x).hypot(a.y - b.y) };
            let course = &scene.config.course;
            let b = course.in_plane(b);
            (course.at(*along).point(a.x - along, a.y) - Vector2::new(b.x, b.y)).norm()
        };
        planned.iter().zip(driven).enumerate().map(distance).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use crate::rollout::Rollout;
    use crate::sampled::Sampled;
    use crate::scene::Violation;
    use vehicle::course::{CourseKeys, Waypoint, Widths};
    use vehicle::{Control, Course, Goal};

    /// A quarter of a circle of 5 m to the left behind 3 m straight on.
    fn config() -> ControllerConfig {
        let at = |x_m: f64, y_m: f64, yaw_rad: f64| Waypoint::new(x_m, y_m, Some(yaw_rad));
        let waypoints = vec![at(0.0, 0.0, 0.0), at(3.0, 0.0, 0.0), at(8.0, 5.0, std::f64::consts::FRAC_PI_2)];
        let course = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap();
        let goal = Goal { x_m: course.length_m(), ..Goal::default() };
        ControllerConfig { course, goal, ..ControllerConfig::default() }
    }

    #[test]
    fn a_narrow_part_bounds_the_nodes_in_it_and_a_plan_that_leaves_it_is_refused() {
        let mut config = config();
        let keys = CourseKeys { width_m: Widths::Each(vec![3.0, 1.0]), ..config.course.keys().clone() };
        config.course = Course::try_from(keys).unwrap();
        let scene = Scene::new(&config, &[], State { x: 2.0, y: 0.6, ..State::default() });
        let mut rollout = Rollout::default();
        rollout.drive(&scene, &vec![Control { velocity: 1.0, steering: 0.04 }; config.intervals]);
        let mut steps = Vec::new();
        Frames::default().place(&scene, &rollout.nodes, &mut steps);
        let baseline = scene.baseline();
        for (node, step) in rollout.nodes[1..].iter().zip(&steps) {
            let is_narrow = node.x >= 3.0;
            assert_eq!(step.y_range, if is_narrow { [-0.5, 0.5] } else { [-1.5, 1.5] }, "{node:?}");
            let sample = Sampled { t: 0.0, speed: 1.0, state: State { y: 0.6, ..*node } };
            assert_eq!(scene.check(&baseline, &sample), is_narrow.then_some(Violation::Outside), "{node:?}");
        }
        assert!(steps.last().is_some_and(|step| step.y_range[1] < 1.0), "the plan gets there");
    }

    #[test]
    fn the_frames_lead_from_node_to_node_as_the_robot_drives() {
        let config = config();
        let scene = Scene::new(&config, &[], State { x: 1.5, y: 0.2, yaw: 0.05, ..State::default() });
        let mut rollout = Rollout::default();
        rollout.drive(&scene, &vec![Control { velocity: 1.0, steering: 0.07 }; config.intervals]);
        let (mut frames, mut steps) = (Frames::default(), Vec::new());
        frames.place(&scene, &rollout.nodes, &mut steps);
        // A node seen from its own frame is itself, and so it is from the frame before, through the frame.
        for (index, frame) in steps.iter().enumerate() {
            let (before, here) = (rollout.nodes[index], rollout.nodes[index + 1]);
            let tangent = config.course.at(before.x);
            let driven = config.course.in_plane(&here);
            let [ahead, left] = tangent.offset(Vector2::new(driven.x, driven.y));
            let (sin, cos) = frame.angle.sin_cos();
            let (x, y) = (before.x + ahead - frame.from[0], left - frame.from[1]);
            let seen = [frame.to[0] + cos * x + sin * y, frame.to[1] + cos * y - sin * x];
            assert!((seen[0] - here.x).abs() < 1e-9 && (seen[1] - here.y).abs() < 1e-9, "{seen:?} {here:?}");
        }
        assert_eq!(frames.largest_distance(&scene, &rollout.nodes, &rollout.nodes), 0.0);
        // On the circle of 5 m the reference steers for it.
        let gain = config.vehicle.parameters().yaw_rate_gain();
        assert!((steps.last().unwrap().steering * gain - 0.2).abs() < 1e-9);
    }
}
