//! An obstacle as random courses have it.

use emulator::noise::NoiseStream;
use emulator::scenario::{ScenarioObstacle, Shape};

/// An obstacle of random shape and lateral position; where it stands along the track comes later.
pub(super) fn obstacle(stream: &mut NoiseStream) -> ScenarioObstacle {
    let shape = if stream.chance(0.4) {
        Shape::Circle { radius_m: stream.between(0.05, 0.25) }
    } else {
        Shape::Box {
            length_m: stream.between(0.05, 0.5),
            width_m: stream.between(0.1, 0.5),
            yaw_rad: if stream.chance(0.5) { stream.between(-0.8, 0.8) } else { 0.0 },
        }
    };
    let aside = if stream.chance(0.5) { 0.4 } else { 1.3 };
    ScenarioObstacle::fixed(shape, 0.0, stream.between(-aside, aside))
}
