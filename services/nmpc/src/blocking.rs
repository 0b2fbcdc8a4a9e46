//! Which obstacle a stop is for, the gap past it, and the gap that the robot needs.

use shared_types::{Blocking, MAX_OBSTACLES};
use vehicle::State;

use crate::predicted_obstacle::PredictedObstacle;
use crate::scene::Scene;

/// The obstacle with this index as the reason of a stop.
///
/// The gap is the widest part across the track that no obstacle covers where the robot would pass this one.
pub(crate) fn blocking(scene: &Scene, index: usize) -> Blocking {
    let obstacle = &scene.predicted[index];
    let [x, y] = obstacle.centre;
    let place = scene.config.course.in_plane(&State { x, y, ..State::default() });
    let vehicle = &scene.config.vehicle;
    let margin = scene.margin.sum(0.0, vehicle.bounds.velocity_min_mps);
    Blocking {
        x_m: place.x,
        y_m: place.y,
        gap_m: widest_gap(scene, obstacle),
        needed_m: vehicle.width_m + 2.0 * margin,
        id: obstacle.id,
        reserved: 0,
    }
}

/// The widest free part across the track beside an obstacle [m]; negative by the overlap when there is none.
fn widest_gap(scene: &Scene, obstacle: &PredictedObstacle) -> f64 {
    let half_width = scene.config.vehicle.width_m / 2.0;
    let [right, left] = if scene.config.track.walls {
        scene.config.track.y_m
    } else {
        let [right, left] = scene.y_range_at(obstacle.centre[0]);
        [right - half_width, left + half_width]
    };
    let along = extent(obstacle, 0);
    let reach = scene.config.vehicle.reach_m();
    let mut covered = [[0.0; 2]; MAX_OBSTACLES];
    let mut count = 0;
    for other in scene.predicted.iter().take(MAX_OBSTACLES) {
        let [from, to] = extent(other, 0);
        if from < along[1] + reach && to > along[0] - reach {
            covered[count] = extent(other, 1);
            count += 1;
        }
    }
    let covered = &mut covered[..count];
    covered.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut free_from, mut widest) = (right, f64::NEG_INFINITY);
    for [from, to] in covered.iter() {
        widest = widest.max(from.min(left) - free_from);
        free_from = free_from.max(*to);
    }
    widest.max(left - free_from)
}

/// Lowest and highest coordinate of an obstacle's box along the axis.
fn extent(obstacle: &PredictedObstacle, axis: usize) -> [f64; 2] {
    let corners = obstacle.body.corners().map(|corner| corner[axis]);
    [corners.into_iter().fold(f64::INFINITY, f64::min), corners.into_iter().fold(f64::NEG_INFINITY, f64::max)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;

    fn obstacle(id: u32, x: f64, low: f64, high: f64) -> PredictedObstacle {
        let centre = f64::midpoint(low, high);
        let body = Rectangle { centre: Vector2::new(x, centre), yaw: 0.0, length: 0.1, width: high - low };
        PredictedObstacle {
            id,
            centre: [x, centre],
            velocity: [0.0, 0.0],
            a: 1.2,
            b: 0.8,
            body,
            in_plane: None,
        }
    }

    #[test]
    fn the_gap_is_the_widest_between_obstacles_and_bounds() {
        let config = ControllerConfig::default();
        // Free without walls: -1.7 to -0.8, and 0.3 to 0.9; the third is 3 m further on.
        let predicted =
            [obstacle(7, 5.0, -0.8, 0.3), obstacle(8, 5.2, 0.9, 2.0), obstacle(9, 8.0, -3.0, 3.0)];
        let found = blocking(&Scene::new(&config, &predicted, State::default()), 0);
        assert_eq!((found.id, found.x_m), (7, 5.0));
        assert!((found.gap_m - 0.9).abs() < 1e-12);
        // Body 0.4 m, twice 0.05 + 0.015 + 0.015 m.
        assert!((found.needed_m - 0.56).abs() < 1e-12);
        let closed = blocking(&Scene::new(&config, &predicted, State::default()), 2);
        assert!(closed.gap_m < 0.0, "{closed:?}");
    }
}
