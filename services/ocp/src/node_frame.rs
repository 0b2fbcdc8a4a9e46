//! Nodes in frames of their own: along a way that bends, each node has the frame that is tangent to the way beside it.
//!
//! The motion inside an interval is that of its first node's frame, and its end is turned into the frame of the next one.
//! So the kinematics are exact, and weights, bounds and yaw are along and across the way at every node.

/// The frame of a node, seen from the frame of the node before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeFrame {
    /// A point in the frame before [m].
    pub from: [f64; 2],
    /// The same point in the new frame [m].
    pub to: [f64; 2],
    /// By how much the new frame is turned to the left [rad].
    pub angle: f64,
    /// The steering angle that keeps along the way in the interval between them, on top of the reference's [rad].
    pub steering: f64,
    /// Soft bounds of the lateral position at the node, instead of the problem's [m].
    pub y_range: [f64; 2],
}

impl NodeFrame {
    /// Cosine and sine of the turn.
    pub(crate) fn direction(&self) -> [f64; 2] {
        let (sin, cos) = self.angle.sin_cos();
        [cos, sin]
    }

    /// A state (sideslip, yaw, yaw rate, x, y) of the frame before in the new one.
    pub(crate) fn apply(&self, state: &[f64; 5]) -> [f64; 5] {
        let [x, y] = turned(self.direction(), [state[3] - self.from[0], state[4] - self.from[1]]);
        [state[0], state[1] - self.angle, state[2], self.to[0] + x, self.to[1] + y]
    }

    pub(crate) fn is_usable(&self) -> bool {
        let numbers =
            self.from.iter().chain(&self.to).chain(&self.y_range).chain([&self.angle, &self.steering]);
        self.y_range[0] <= self.y_range[1] && numbers.into_iter().all(|value| value.is_finite())
    }
}

/// A vector in a frame that is turned to the left by this cosine and sine.
#[inline]
pub(crate) fn turned([cos, sin]: [f64; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    [cos * x + sin * y, cos * y - sin * x]
}

/// The inverse of [`turned`].
#[inline]
pub(crate) fn turned_back([cos, sin]: [f64; 2], vector: [f64; 2]) -> [f64; 2] {
    turned([cos, -sin], vector)
}
