//! Rounds of a robot: it publishes a scan and is told what to do.

use runtime::monotonic_ns;
use shared_types::{Role, Topic};
use supervision::private_system::Order;

use super::{ANSWER_NS, Message, TestBench, Tried, incarnation_of};

impl TestBench<'_> {
    /// Waits for the next odometry, which is returned, and answers it with the order.
    pub(super) fn robot_round(&mut self) -> Tried<Message> {
        let last = self.scan_id - 1;
        let is_new = |received: &&Message| received.topic() == Topic::Odometry && received.scan_id() > last;
        if self.setup.lockstep {
            self.system.direct(|directive| directive.granted_scan = self.scan_id)?;
        }
        let odometry = self.find(ANSWER_NS, |bench| bench.received.iter().rev().find(is_new).cloned())?;
        let Some(odometry) = odometry else {
            return self.no_answer(&format!("scan after scan {last}"));
        };
        self.scan_id = odometry.scan_id() + 1;
        if let Some(order) = self.order {
            let mut actuation = self.actuation(&odometry, order);
            self.publish(&mut actuation)?;
            self.last_actuation = Some(actuation);
        }
        Ok(odometry)
    }

    /// Straight on.
    pub(crate) fn forward(&self) -> Order {
        Order::Drive(self.suite.vehicle.mps(0.7), 0.0)
    }

    /// What a robot is told because of its scan.
    pub(crate) fn actuation(&self, odometry: &Message, order: Order) -> Message {
        let header = odometry.header();
        let now_ns = if self.setup.lockstep { header.scan_published_ns() } else { monotonic_ns() };
        Message::new(&order.answer(header, incarnation_of(Role::Actuator), now_ns))
    }
}
