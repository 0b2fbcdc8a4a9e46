//! The rehearsal of the next scan, so that code and data are in the caches when it comes.

use std::hint::black_box;

use ocp::Budget;
use shared_types::{Obstacles, Pose};

use crate::Controller;

/// Rehearses steps of a controller on expected inputs.
#[derive(Debug, Clone)]
pub struct Rehearsal {
    period_ns: u64,
    last: Option<(Pose, Obstacles)>,
}

impl Rehearsal {
    /// A rehearsal for scans every `period_ns`, before the first scan.
    pub fn new(period_ns: u64) -> Self {
        Self { period_ns, last: None }
    }

    /// Keeps the inputs of a step, from which the next are expected.
    pub fn keep(&mut self, pose: &Pose, obstacles: &Obstacles) {
        self.last = Some((*pose, *obstacles));
    }

    /// Does the next step of `controller` on the expected inputs, and puts its state back. What follows gives the same
    /// bits as without. Nothing happens before the first scan.
    pub fn run(&self, controller: &mut Controller, budget: &Budget) {
        let Some((pose, obstacles)) = &self.last else { return };
        let before = controller.state();
        let (pose, obstacles) = (self.next_pose(pose), self.next_obstacles(obstacles));
        black_box(controller.step(&pose, &obstacles, budget));
        controller.resume(&before);
    }

    /// The pose of a robot that drives on.
    fn next_pose(&self, last: &Pose) -> Pose {
        let period_s = self.period_s();
        let (way, turn) = (last.speed_mps * period_s, last.yaw_rate_radps * period_s);
        let predicted_way = last.predicted_speed_mps * period_s;
        Pose {
            header: last.header.next(self.period_ns),
            yaw_rad: last.yaw_rad + turn,
            x_m: last.x_m + way * last.yaw_rad.cos(),
            y_m: last.y_m + way * last.yaw_rad.sin(),
            predicted_ns: last.predicted_ns.saturating_add(self.period_ns),
            predicted_yaw_rad: last.predicted_yaw_rad + last.predicted_yaw_rate_radps * period_s,
            predicted_x_m: last.predicted_x_m + predicted_way * last.predicted_yaw_rad.cos(),
            predicted_y_m: last.predicted_y_m + predicted_way * last.predicted_yaw_rad.sin(),
            ..*last
        }
    }

    /// The obstacles, moved on by their velocities.
    fn next_obstacles(&self, last: &Obstacles) -> Obstacles {
        let mut next = Obstacles { header: last.header.next(self.period_ns), ..*last };
        for item in &mut next.items {
            let (dx, dy) = (item.velocity_x_mps * self.period_s(), item.velocity_y_mps * self.period_s());
            (item.x_m, item.y_m) = (item.x_m + dx, item.y_m + dy);
            (item.box_x_m, item.box_y_m) = (item.box_x_m + dx, item.box_y_m + dy);
        }
        next
    }

    fn period_s(&self) -> f64 {
        self.period_ns as f64 * 1e-9
    }
}
