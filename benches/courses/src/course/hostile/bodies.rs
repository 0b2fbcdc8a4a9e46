//! Bodies that move, and obstacles that appear.

use emulator::noise::NoiseStream;
use emulator::scenario::{Scenario, ScenarioObstacle, Shape};

/// Bodies that move along the track are at most this far from its middle [m].
const ASIDE_M: f64 = 1.2;
/// A body that is overtaken starts this far ahead of the robot, at least and at most [m].
const AHEAD_M: [f64; 2] = [2.7, 6.0];
/// Closest distance at which something may appear: `vehicle.sudden_m` [m].
pub(super) const SUDDEN_M: f64 = 1.2;

/// How a body moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    /// Across the track, where the robot is about then.
    Crossing,
    /// Along the track, towards the robot.
    HeadOn,
    /// Along the track, ahead of the robot and slower.
    Overtaking,
}

/// A body that moves, up to 0.5 m/s.
pub(super) fn mover(motion: Motion, scenario: &Scenario, stream: &mut NoiseStream) -> ScenarioObstacle {
    let shape = if stream.chance(0.6) {
        Shape::Circle { radius_m: stream.between(0.1, 0.3) }
    } else {
        Shape::Box { length_m: stream.between(0.1, 0.6), width_m: stream.between(0.1, 0.6), yaw_rad: 0.0 }
    };
    let start = scenario.start;
    let way_m = stream.between(3.0, (scenario.goal.last().x_m - start.x_m - 1.0).min(12.0));
    // The robot is there about then.
    let meeting_s = way_m * stream.between(0.9, 1.7);
    let (meeting_m, speed) = (start.x_m + way_m, stream.between(0.1, 0.5));
    let mut mover = ScenarioObstacle::fixed(shape, meeting_m, stream.between(-ASIDE_M, ASIDE_M));
    match motion {
        Motion::HeadOn => {
            mover.velocity_x_mps = -speed;
            mover.x_m = meeting_m + speed * meeting_s;
        }
        Motion::Overtaking => {
            mover.velocity_x_mps = 0.8 * speed;
            mover.x_m = start.x_m + stream.between(AHEAD_M[0], AHEAD_M[1]);
        }
        Motion::Crossing => {
            let side = if stream.chance(0.5) { 1.0 } else { -1.0 };
            mover.velocity_y_mps = -side * speed;
            mover.velocity_x_mps = if stream.chance(0.5) { stream.between(-0.2, 0.2) } else { 0.0 };
            mover.y_m += side * speed * meeting_s;
            mover.x_m -= mover.velocity_x_mps * meeting_s;
        }
    }
    mover
}

/// A body that changes its motion while the robot comes near: two parts, the second of which begins where the first ends.
pub(super) fn changing(scenario: &Scenario, stream: &mut NoiseStream) -> [ScenarioObstacle; 2] {
    let mut before = mover(Motion::Crossing, scenario, stream);
    let way_m = before.x_m - scenario.start.x_m;
    let [x_mps, y_mps] = [before.velocity_x_mps, before.velocity_y_mps];
    let speed = stream.between(0.2, 0.6);
    let to_line = (scenario.start.y_m - before.y_m).signum();
    let [then_x_mps, then_y_mps] = match stream.count(0, 4) {
        // At rest it begins.
        0 | 1 => {
            (before.velocity_x_mps, before.velocity_y_mps) = (0.0, 0.0);
            before.y_m = to_line * stream.between(-1.4, -0.5);
            [stream.between(-0.2, 0.2), to_line * speed]
        }
        2 => [0.0, 0.0],
        3 => [-x_mps, -y_mps],
        _ => [stream.between(-1.0, 1.0) * speed, y_mps.signum() * speed],
    };
    // The robot, which gets there after about as many seconds as metres, is 0.5 to 3 m away.
    let change_s = (way_m - stream.between(0.5, 3.0)).max(0.5);
    let after = ScenarioObstacle {
        x_m: before.x_m + before.velocity_x_mps * change_s,
        y_m: before.y_m + before.velocity_y_mps * change_s,
        velocity_x_mps: then_x_mps,
        velocity_y_mps: then_y_mps,
        appears_s: change_s,
        ..before
    };
    [ScenarioObstacle { disappears_s: Some(change_s), ..before }, after]
}

/// Lets each obstacle appear when the robot is near; they may be wider.
pub(super) fn appear(scenario: &mut Scenario, stream: &mut NoiseStream) {
    for obstacle in &mut scenario.obstacles {
        // An obstacle nearer to the start would appear nearer than the described distance.
        if obstacle.x_m - obstacle.reach() > scenario.start.x_m + SUDDEN_M + 1.0 {
            obstacle.appears_ahead_m = Some(SUDDEN_M + stream.exponential().min(2.5));
        }
        if let (Shape::Box { width_m, .. }, true) = (&mut obstacle.shape, stream.chance(0.4)) {
            *width_m = stream.between(0.5, 1.5);
        }
    }
}
