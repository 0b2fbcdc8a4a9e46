//! Where the robot was in the last few scan periods, at each plant step.
//!
//! The laser needs the pose at the time of every beam, up to one sweep in the past.

use std::collections::VecDeque;

use nalgebra::Vector2;
use vehicle::State;

/// The robot at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Time since the start of the run [ns].
    pub time_ns: u64,
    /// State of the model; its yaw counts full turns.
    pub state: State,
    /// Speed over ground [m/s].
    pub speed: f64,
    /// Steering angle of the wheels [rad].
    pub steering: f64,
    /// Position that the odometer reports, without noise [m].
    pub reported: Vector2<f64>,
    /// Yaw that the odometer reports, without noise; it counts full turns [rad].
    pub reported_yaw: f64,
    /// Distance that the wheel encoders have counted [m].
    pub encoder_m: f64,
}

/// The last nodes, oldest first; never empty.
#[derive(Debug, Clone, PartialEq)]
pub struct History {
    nodes: VecDeque<Node>,
    keep_ns: u64,
}

impl History {
    /// A history that goes back `keep_ns` and starts with one node.
    pub fn new(first: Node, keep_ns: u64) -> Self {
        Self { nodes: VecDeque::from([first]), keep_ns }
    }

    /// Appends a node; one of the same time replaces the last.
    pub fn push(&mut self, node: Node) {
        if self.nodes.back().is_some_and(|last| last.time_ns >= node.time_ns) {
            self.nodes.pop_back();
        }
        self.nodes.push_back(node);
        let oldest = node.time_ns.saturating_sub(self.keep_ns);
        while self.nodes.len() > 2 && self.nodes[1].time_ns <= oldest {
            self.nodes.pop_front();
        }
    }

    /// Forgets nodes later than a time; the first one stays.
    pub fn forget_after(&mut self, time_ns: u64) {
        while self.nodes.len() > 1 && self.nodes.back().is_some_and(|last| last.time_ns > time_ns) {
            self.nodes.pop_back();
        }
    }

    /// The robot at a time, between two nodes by interpolation; before the first and after the last node it stands.
    ///
    /// Speed and steering are those of the node before, because they jump when an actuation arrives.
    pub fn at(&self, time_ns: u64) -> Node {
        self.walk()(time_ns)
    }

    /// [`Self::at`] for many times in ascending order, which is cheaper.
    pub fn walk(&self) -> impl FnMut(u64) -> Node + '_ {
        let mut after = 0;
        move |time_ns| {
            while after < self.nodes.len() && self.nodes[after].time_ns <= time_ns {
                after += 1;
            }
            match (after.checked_sub(1), self.nodes.get(after)) {
                (Some(before), Some(next)) => self.nodes[before].towards(next, time_ns),
                (Some(before), None) => Node { time_ns, ..self.nodes[before] },
                (None, _) => Node { time_ns, ..self.nodes[0] },
            }
        }
    }
}

impl Node {
    fn towards(&self, next: &Self, time_ns: u64) -> Self {
        let share = (time_ns - self.time_ns) as f64 / (next.time_ns - self.time_ns) as f64;
        let mix = |from: f64, to: f64| from + (to - from) * share;
        let (from, to) = (&self.state, &next.state);
        Self {
            time_ns,
            state: State {
                sideslip: mix(from.sideslip, to.sideslip),
                yaw: mix(from.yaw, to.yaw),
                yaw_rate: mix(from.yaw_rate, to.yaw_rate),
                x: mix(from.x, to.x),
                y: mix(from.y, to.y),
            },
            speed: self.speed,
            steering: self.steering,
            reported: self.reported + (next.reported - self.reported) * share,
            reported_yaw: mix(self.reported_yaw, next.reported_yaw),
            encoder_m: mix(self.encoder_m, next.encoder_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(time_ns: u64, x: f64) -> Node {
        Node {
            time_ns,
            state: State { x, ..State::default() },
            speed: x,
            steering: 0.0,
            reported: Vector2::new(x, 0.0),
            reported_yaw: 0.0,
            encoder_m: x,
        }
    }

    #[test]
    fn between_nodes_poses_are_interpolated_and_controls_are_held() {
        let mut history = History::new(node(0, 0.0), 1000);
        history.push(node(10, 1.0));
        history.push(node(20, 3.0));
        assert_eq!(history.at(15).state.x, 2.0);
        assert_eq!(history.at(15).speed, 1.0);
        assert_eq!(history.at(99).state.x, 3.0);
        let mut walk = history.walk();
        for time in [0, 3, 10, 15, 20, 99] {
            assert_eq!(walk(time), history.at(time));
        }
    }

    #[test]
    fn old_nodes_are_forgotten_but_the_whole_span_stays_covered() {
        let mut history = History::new(node(0, 0.0), 30);
        (1..100).for_each(|step| history.push(node(step * 10, step as f64)));
        assert!(history.nodes.len() <= 5);
        assert_eq!(history.at(960).state.x, 96.0);
        assert_eq!(history.at(1).state.x, 96.0, "before the first node the robot stands there");
    }
}
