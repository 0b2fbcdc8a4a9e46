//! The way to rest: where the robot gets when the wheels are blocked now instead of driving on.
//!
//! The robot rolls at its true speed along its present arc until the end of the sweep and for the described delay of a
//! command, then it slides with the described deceleration. What stands or moves on that way is the truth of the
//! scenario, as far as it has appeared. A body that moves into a robot at rest does not count: the robot has stopped.

use emulator::Scenario;
use emulator::scene::Scene;
use nalgebra::Vector2;
use shared_types::Truth;
use vehicle::Description;
use vehicle::geometry::Rectangle;

/// Distance between two places that are checked [m].
const STEP_M: f64 = 0.02;
/// Time from the front beam to the end of the sweep, in scan periods.
const SWEEP_SHARE: f64 = 1.0 / 3.0;
/// Clearances above it are not told apart [m].
const FAR_M: f64 = 1.0;

/// Watches the way to rest in a drive.
#[derive(Debug, Clone)]
pub struct WayToRest {
    scene: Scene,
    vehicle: Description,
    /// Time from the front beam until the wheels can be blocked [s].
    delay_s: f64,
}

impl WayToRest {
    /// A watch at the start of a drive.
    pub fn new(scenario: &Scenario, vehicle: Description, period_ns: u64) -> Self {
        let scene = Scene::new(scenario);
        let delay_s = SWEEP_SHARE * period_ns as f64 * 1e-9 + vehicle.command_delay_s;
        Self { scene, vehicle, delay_s }
    }

    /// The smallest clearance to bodies and walls from the scan of `truth` until rest [m], at most 1 m; 1 m at rest.
    ///
    /// Zero or less: the robot can't come to rest without contact.
    pub fn clearance(&mut self, truth: &Truth) -> f64 {
        self.scene.trigger(&self.body(truth, 0.0), truth.time_s);
        if truth.speed_mps == 0.0 && truth.collided == 0 {
            return FAR_M;
        }
        let (speed, deceleration) = (truth.speed_mps.abs(), self.vehicle.blocked_deceleration_mps2);
        let rolled = if truth.blocked == 0 { speed * self.delay_s } else { 0.0 };
        let length = rolled + speed * speed / (2.0 * deceleration);
        let steps = (length / STEP_M).ceil().max(1.0);
        (0..=steps as usize)
            .map(|step| {
                let way = length * step as f64 / steps;
                let left = (speed * speed - 2.0 * deceleration * (way - rolled).max(0.0)).max(0.0).sqrt();
                let rolling_s = if speed > 0.0 { way.min(rolled) / speed } else { 0.0 };
                let time_s = truth.time_s + rolling_s + (speed - left) / deceleration;
                self.scene.clearance_below(&self.body(truth, way), time_s, FAR_M)
            })
            .fold(FAR_M, f64::min)
    }

    /// The body after `way` metres along the present arc.
    fn body(&self, truth: &Truth, way: f64) -> Rectangle {
        let turn = if truth.speed_mps.abs() > STEP_M {
            truth.yaw_rate_radps / truth.speed_mps.abs() * way
        } else {
            0.0
        };
        let middle = truth.yaw_rad + truth.sideslip_rad + turn / 2.0;
        Rectangle {
            centre: Vector2::new(truth.x_m + way * middle.cos(), truth.y_m + way * middle.sin()),
            yaw: truth.yaw_rad + turn,
            length: self.vehicle.length_m,
            width: self.vehicle.width_m,
        }
    }
}
