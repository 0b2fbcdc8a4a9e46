//! The rehearsal of the next scan, so that code and data are in the caches when it comes.

use std::hint::black_box;

use ocp::Budget;
use shared_types::{GivenGoal, Obstacles, Pose};

use crate::{Controller, ControllerState};

/// Does the step of `controller` that is expected `period_ns` after the one on the `last` inputs, and puts its state
/// back. What follows gives the same bits as without.
pub(crate) fn rehearse(
    controller: &mut Controller,
    last: (&Pose, &Obstacles),
    period_ns: u64,
    budget: &Budget,
) {
    let before = controller.state();
    // A goal that counts from the next scan on is heeded then, once.
    controller.resume(&ControllerState { given: GivenGoal::default(), ..before });
    let (pose, obstacles) = (next_pose(last.0, period_ns), next_obstacles(last.1, period_ns));
    black_box(controller.step(&pose, &obstacles, budget));
    controller.resume(&before);
}

/// The pose of a robot that drives on.
fn next_pose(last: &Pose, period_ns: u64) -> Pose {
    let period_s = seconds(period_ns);
    let (way, turn) = (last.speed_mps * period_s, last.yaw_rate_radps * period_s);
    let predicted_way = last.predicted_speed_mps * period_s;
    Pose {
        header: last.header.next(period_ns),
        yaw_rad: last.yaw_rad + turn,
        x_m: last.x_m + way * last.yaw_rad.cos(),
        y_m: last.y_m + way * last.yaw_rad.sin(),
        predicted_ns: last.predicted_ns.saturating_add(period_ns),
        predicted_yaw_rad: last.predicted_yaw_rad + last.predicted_yaw_rate_radps * period_s,
        predicted_x_m: last.predicted_x_m + predicted_way * last.predicted_yaw_rad.cos(),
        predicted_y_m: last.predicted_y_m + predicted_way * last.predicted_yaw_rad.sin(),
        ..*last
    }
}

/// The obstacles, moved on by their velocities.
fn next_obstacles(last: &Obstacles, period_ns: u64) -> Obstacles {
    let mut next = Obstacles { header: last.header.next(period_ns), ..*last };
    for item in &mut next.items {
        let dx = item.velocity_x_mps * seconds(period_ns);
        let dy = item.velocity_y_mps * seconds(period_ns);
        (item.x_m, item.y_m) = (item.x_m + dx, item.y_m + dy);
        (item.box_x_m, item.box_y_m) = (item.box_x_m + dx, item.box_y_m + dy);
    }
    next
}

fn seconds(time_ns: u64) -> f64 {
    time_ns as f64 * 1e-9
}
