//! The ellipses of the optimal control problem, (7.34).

use ocp::EllipsePath;

use crate::predicted_obstacle::PredictedObstacle;
use crate::scene::Scene;

/// Fills the ellipses that the horizon can reach before the goal, nearest first.
pub(crate) fn fill_ellipses(
    scene: &Scene,
    margin: impl Fn(&PredictedObstacle, f64) -> f64,
    ellipses: &mut Vec<EllipsePath>,
    owners: &mut Vec<usize>,
) {
    owners.clear();
    let Scene { config, predicted, initial, .. } = *scene;
    let reach = config.vehicle.bounds.velocity_max_mps * config.horizon_s;
    let in_reach = |obstacle: &PredictedObstacle| {
        let [x, y] = obstacle.centre;
        let travel = obstacle.velocity[0].hypot(obstacle.velocity[1]) * config.horizon_s;
        (x - initial.x).abs() < reach + obstacle.a + travel
            && (y - initial.y).abs() < reach + obstacle.b + travel
            && x + obstacle.a + travel > initial.x
            && !scene.is_beyond_goal(obstacle)
    };
    let distance =
        |obstacle: &PredictedObstacle| (obstacle.centre[0] - initial.x).hypot(obstacle.centre[1] - initial.y);
    let mut count = 0;
    let mut farthest = None;
    // Selection in place of a sort: there are at most sixteen, and nothing is allocated.
    while count < config.max_ellipses {
        let next = (0..predicted.len())
            .filter(|&index| in_reach(&predicted[index]))
            .map(|index| (distance(&predicted[index]), index))
            .filter(|&candidate| farthest.is_none_or(|last| candidate > last))
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some((_, index)) = next else { break };
        farthest = next;
        owners.push(index);
        if ellipses.len() <= count {
            ellipses.push(EllipsePath { a: 0.0, b: 0.0, centres: Vec::with_capacity(config.intervals + 1) });
        }
        let (obstacle, ellipse) = (&predicted[index], &mut ellipses[count]);
        // The margin grows until the robot gets there.
        let margin = margin(obstacle, (obstacle.centre[0] - obstacle.a - initial.x).max(0.0));
        (ellipse.a, ellipse.b) = (obstacle.a + margin, obstacle.b + margin);
        // The ellipse holds at the nodes. A straight piece between two of them cuts it, in the mean by two thirds of its
        // sagitta, and the nodes move with every scan.
        let piece = config.cruise_mps * config.interval_s();
        ellipse.b += piece * piece * ellipse.b / (12.0 * ellipse.a * ellipse.a);
        ellipse.centres.clear();
        let interval_s = config.interval_s();
        ellipse
            .centres
            .extend((0..=config.intervals).map(|node| obstacle.centre_at(node as f64 * interval_s)));
        count += 1;
    }
    ellipses.truncate(count);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use nalgebra::Vector2;
    use vehicle::State;
    use vehicle::geometry::Rectangle;

    #[test]
    fn the_nearest_ellipses_are_taken_and_those_behind_left_out() {
        let obstacle = |id: u32, x: f64| PredictedObstacle {
            id,
            centre: [x, 0.0],
            velocity: [0.0, 0.0],
            a: 1.2,
            b: 0.5,
            body: Rectangle { centre: Vector2::new(x, 0.0), yaw: 0.0, length: 0.1, width: 0.1 },
            in_plane: None,
        };
        let predicted =
            [obstacle(1, 3.0), obstacle(2, -1.5), obstacle(3, 2.0), obstacle(4, 9.0), obstacle(5, 1.0)];
        let config = ControllerConfig {
            max_ellipses: 2,
            horizon_s: 2.72,
            intervals: 6,
            ..ControllerConfig::default()
        };
        let mut ellipses = Vec::new();
        let scene = Scene::new(&config, &predicted, State::default());
        fill_ellipses(&scene, |_, _| 0.02, &mut ellipses, &mut Vec::new());
        let centres: Vec<f64> = ellipses.iter().map(|ellipse| ellipse.centres[0][0]).collect();
        assert_eq!(centres, [1.0, 2.0]);
        // Two thirds of the sagitta of 0.4533 m, where the radius is a^2 / b.
        let cut = 0.453_333_f64.powi(2) * 0.52 / (12.0 * 1.22 * 1.22);
        assert!((ellipses[0].b - 0.52 - cut).abs() < 1e-6 && ellipses[0].centres.len() == 7);
    }
}
