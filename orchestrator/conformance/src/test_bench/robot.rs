//! Rounds of a robot: it publishes a scan and is told what to do.

use runtime::monotonic_ns;
use shared_types::{Actuation, ActuationKind, Role};

use super::play::stamps_at;
use super::{ANSWER_NS, Message, Received, TestBench, Trouble, incarnation_of};

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
    pub(super) fn robot_round(&mut self) -> Result<Received, Trouble> {
        let last = self.scan_id - 1;
        let is_new = |received: &&Received| {
            matches!(received.message, Message::Odometry(_)) && received.message.scan_id() > last
        };
        if self.setup.lockstep {
            self.directive.granted_scan = self.scan_id;
            self.dirty = true;
        }
        self.until(ANSWER_NS, |bench| bench.received.iter().any(|received| is_new(&received)))?;
        let Some(odometry) = self.received.iter().rev().find(is_new).cloned() else {
            return self.no_answer(&format!("scan after scan {last}"));
        };
        self.scan_id = odometry.message.scan_id() + 1;
        if let Some(mut actuation) = self.actuation(&odometry.message, self.order) {
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
        Some(Message::Actuation(Box::new(Actuation {
            header,
            kind: kind.wire(),
            answers: 1,
            desired_velocity_mps: velocity,
            desired_steering_rad: steering,
            sent_velocity_mps: velocity,
            sent_steering_rad: steering,
            ..Actuation::default()
        })))
    }
}
