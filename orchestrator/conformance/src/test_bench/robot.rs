//! Rounds of a robot: it publishes a scan and is told what to do.

use runtime::monotonic_ns;
use shared_types::{Actuation, ActuationKind, Role, Topic};

use super::play::stamps_at;
use super::{ANSWER_NS, Message, TestBench, Tried, incarnation_of};

/// What the test bench tells a robot after each scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Order {
    /// Velocity [m/s] and steering angle [rad] sent.
    Drive(f64, f64),
    /// Block the wheels.
    Block,
    /// Publish nothing.
    Silence,
}

impl TestBench<'_> {
    /// Waits for the next odometry, which is returned, and answers it with the order.
    pub(super) fn robot_round(&mut self) -> Tried<Message> {
        let last = self.scan_id - 1;
        let is_new = |received: &&Message| received.topic() == Topic::Odometry && received.scan_id() > last;
        if self.setup.lockstep {
            self.directive.granted_scan = self.scan_id;
            self.dirty = true;
        }
        let odometry = self.find(ANSWER_NS, |bench| bench.received.iter().rev().find(is_new).cloned())?;
        let Some(odometry) = odometry else {
            return self.no_answer(&format!("scan after scan {last}"));
        };
        self.scan_id = odometry.scan_id() + 1;
        if let Some(mut actuation) = self.actuation(&odometry, self.order) {
            self.publish(&mut actuation)?;
            self.last_actuation = Some(actuation);
        }
        Ok(odometry)
    }

    /// What a robot is told because of its scan.
    pub(crate) fn actuation(&self, odometry: &Message, order: Order) -> Option<Message> {
        let (kind, velocity, steering) = match order {
            Order::Drive(velocity, steering) => (ActuationKind::Drive, velocity, steering),
            Order::Block => (ActuationKind::Block, 0.0, 0.0),
            Order::Silence => return None,
        };
        let mut header = odometry.header().answer();
        header.incarnation = incarnation_of(Role::Actuator);
        let now = if self.setup.lockstep { header.scan_published_ns() } else { monotonic_ns() };
        for role in [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator] {
            *header.stage_mut(role) = stamps_at(now);
        }
        let mut actuation = Actuation { header, kind: kind.wire(), answers: 1, ..Actuation::default() };
        (actuation.desired_velocity_mps, actuation.desired_steering_rad) = (velocity, steering);
        (actuation.sent_velocity_mps, actuation.sent_steering_rad) = (velocity, steering);
        Some(Message::new(&actuation))
    }
}
