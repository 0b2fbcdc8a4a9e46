//! Passing sides without a path search: an explicit rule gives the side of each obstacle, and a path past it.
//!
//! The solver needs one side per obstacle: its first guess decides on which side the solution is. The path leads along
//! the line to the goal, and around each ellipse on the side of the rule. It gives the first guess and the sides that
//! a plan must have. It is not driven, so it need not be steerable. It is clear when it stays inside the track and
//! outside of all ellipses.
//!
//! A side that was chosen is held. The other one is taken when its detour is shorter by [`SWITCH_M`], which noise does
//! not explain. All ellipses of one body have one side.
//!
//! Source note: the source does not print how a side is chosen.

use crate::config::SideRule;
use crate::predicted_obstacle::PredictedObstacle;
use crate::reference_path::{ReferencePath, SINE_MAX};
use crate::scene::Scene;
use crate::side::{Passing, Sides, held};

/// By how much the detour on the other side must be shorter than that on the side held [m].
const SWITCH_M: f64 = 0.3;
/// How far before and behind an ellipse the path leaves the line [m].
const APPROACH_M: f64 = 1.5;

/// Puts the path of the rule into `path`, for a robot that drives at `speed`.
pub(crate) fn find(scene: &Scene, sides: &Sides, speed: f64, path: &mut ReferencePath) {
    let (guide, start) = (&scene.config.guide, scene.initial);
    let arcs = ((guide.range_m / guide.step_m).ceil() as usize).max(1);
    path.set_line(start.x, scene.config.goal.y_m, speed);
    path.step = guide.step_m;
    path.y.resize(arcs + 1, scene.config.goal.y_m);
    path.sine.resize(arcs + 1, 0.0);
    let chosen = Chosen::of(scene, sides, speed);
    for index in 0..=arcs {
        let way = index as f64 * guide.step_m;
        let [low, high] = chosen.free(scene, start.x + way, way / speed, APPROACH_M);
        path.y[index] = within(scene.config.goal.y_m, [low, high]);
        path.clear &=
            is_free(chosen.free(scene, start.x + way, way / speed, 0.0), scene.y_range_at(start.x + way));
    }
    for index in 0..=arcs {
        let (before, after) = (index.saturating_sub(1), (index + 1).min(arcs));
        let (rise, length) = (path.y[after] - path.y[before], (after - before) as f64 * guide.step_m);
        path.sine[index] = (rise / rise.hypot(length)).clamp(-SINE_MAX, SINE_MAX);
    }
}

/// The side of each obstacle.
struct Chosen {
    sides: [Passing; shared_types::MAX_OBSTACLES],
}

impl Chosen {
    fn of(scene: &Scene, sides: &Sides, speed: f64) -> Self {
        let mut chosen = Self { sides: [Passing::Left; shared_types::MAX_OBSTACLES] };
        for (side, obstacle) in chosen.sides.iter_mut().zip(scene.predicted) {
            *side = choose(detours(scene, obstacle, speed), held(sides, obstacle));
        }
        chosen
    }

    /// Lateral positions at `x` that are outside of all ellipses `t` seconds from now, when each is longer by
    /// `approach_m` at both ends [m].
    fn free(&self, scene: &Scene, x: f64, t: f64, approach_m: f64) -> [f64; 2] {
        let mut free = [f64::NEG_INFINITY, f64::INFINITY];
        let before_goal = |(_, obstacle): &(&Passing, &PredictedObstacle)| !scene.is_beyond_goal(obstacle);
        for (side, obstacle) in self.sides.iter().zip(scene.predicted).filter(before_goal) {
            let [centre_x, centre_y] = obstacle.centre_at(t);
            let along = (x - centre_x) / (obstacle.a + approach_m);
            if along.abs() < 1.0 {
                let reach = obstacle.b * (1.0 - along * along).sqrt();
                match side {
                    Passing::Left => free[0] = free[0].max(centre_y + reach),
                    Passing::Right => free[1] = free[1].min(centre_y - reach),
                }
            }
        }
        free
    }
}

/// The side with the shorter detour of \[left, right\], unless the other one is held and not much longer.
fn choose([left, right]: [f64; 2], held: Option<Passing>) -> Passing {
    match held {
        Some(Passing::Left) if left <= right + SWITCH_M => Passing::Left,
        Some(Passing::Right) if right <= left + SWITCH_M => Passing::Right,
        _ if left <= right => Passing::Left,
        _ => Passing::Right,
    }
}

/// Detours from the line to the left and to the right of a body when the robot gets there [m]; infinite on a side that
/// the rule or the track does not allow.
fn detours(scene: &Scene, obstacle: &PredictedObstacle, speed: f64) -> [f64; 2] {
    let line = scene.config.goal.y_m;
    let pieces = scene.predicted.iter().filter(|piece| piece.body == obstacle.body);
    let [low, high] = pieces.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], piece| {
        let t = ((piece.centre[0] - scene.initial.x) / speed).max(0.0);
        let centre_y = piece.centre_at(t)[1];
        [low.min(centre_y - piece.b), high.max(centre_y + piece.b)]
    });
    let is_on_line = low < line && line < high;
    let allowed = match scene.config.side {
        SideRule::Left if is_on_line => [true, false],
        SideRule::Right if is_on_line => [false, true],
        _ => {
            let [right, left] = scene.y_range_at(obstacle.centre[0]);
            [high <= left, low >= right]
        }
    };
    let [left, right] = [(high - line).max(0.0), (line - low).max(0.0)];
    [if allowed[0] { left } else { f64::INFINITY }, if allowed[1] { right } else { f64::INFINITY }]
}

/// The place between two limits that is nearest to the line; their middle where they contradict each other.
fn within(line: f64, [low, high]: [f64; 2]) -> f64 {
    if low <= high { line.max(low).min(high) } else { f64::midpoint(low, high) }
}

fn is_free([low, high]: [f64; 2], [right, left]: [f64; 2]) -> bool {
    low <= high && low <= left && high >= right
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use crate::side;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;
    use vehicle::{Goal, State};

    fn config(side: SideRule) -> ControllerConfig {
        ControllerConfig { side, goal: Goal { x_m: 20.0, ..Goal::default() }, ..ControllerConfig::default() }
    }

    fn obstacle(id: u32, x: f64, y: f64, b: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.4 };
        PredictedObstacle { id, centre: [x, y], velocity: [0.0, 0.0], a: 1.2, b, body, in_plane: None }
    }

    /// The path past the obstacles at 1 m/s from the origin.
    fn path(side: SideRule, predicted: &[PredictedObstacle], sides: &Sides) -> ReferencePath {
        let config = config(side);
        let mut path = ReferencePath::default();
        find(&Scene::new(&config, predicted, State::default()), sides, 1.0, &mut path);
        path
    }

    fn side_of(rule: SideRule, obstacle: PredictedObstacle, sides: &Sides) -> Option<Passing> {
        path(rule, &[obstacle], sides).side_of(&obstacle)
    }

    #[test]
    fn an_obstacle_on_the_line_is_passed_on_the_side_of_the_rule_and_others_on_that_of_the_line() {
        let none = Sides::default();
        for y in [-0.3, 0.0, 0.3] {
            assert_eq!(side_of(SideRule::Left, obstacle(1, 4.0, y, 0.8), &none), Some(Passing::Left));
            assert_eq!(side_of(SideRule::Right, obstacle(1, 4.0, y, 0.8), &none), Some(Passing::Right));
        }
        for rule in [SideRule::Left, SideRule::Right, SideRule::Nearest] {
            assert_eq!(side_of(rule, obstacle(1, 4.0, 1.0, 0.8), &none), Some(Passing::Right));
            assert_eq!(side_of(rule, obstacle(1, 4.0, -1.0, 0.8), &none), Some(Passing::Left));
        }
    }

    #[test]
    fn the_nearest_side_is_inside_the_track_and_held_against_noise_only() {
        let (none, mut sides) = (Sides::default(), Sides::default());
        let nearest =
            |y: f64, b: f64, sides: &Sides| side_of(SideRule::Nearest, obstacle(1, 4.0, y, b), sides);
        assert_eq!(nearest(0.1, 0.8, &none), Some(Passing::Right));
        assert_eq!(nearest(0.0, 0.8, &none), Some(Passing::Left));
        side::hold(&mut sides, &obstacle(1, 4.0, -0.1, 0.8), Passing::Left);
        assert_eq!(nearest(0.1, 0.8, &sides), Some(Passing::Left));
        assert_eq!(nearest(0.2, 0.8, &sides), Some(Passing::Right));
        // Left of it ends at 1.55 m, outside of the track.
        assert_eq!(nearest(0.05, 1.5, &sides), Some(Passing::Right));
    }

    #[test]
    fn the_path_touches_the_ellipse_and_is_not_clear_where_the_track_ends() {
        // Its centre is nine arcs of 0.45 m ahead.
        let around = path(SideRule::Left, &[obstacle(1, 4.05, 0.1, 0.8)], &Sides::default());
        assert!((around.y[9] - 0.9).abs() < 1e-9 && around.y[0] == 0.0 && around.clear);
        assert!(around.y[5] > 0.3 && around.sine[5] > 0.1, "{around:?}");
        assert!(!path(SideRule::Left, &[obstacle(1, 4.05, 0.75, 0.8)], &Sides::default()).clear);
        let closed = [obstacle(1, 4.05, 0.75, 0.8), obstacle(2, 4.05, -0.75, 0.8)];
        assert!(!path(SideRule::Nearest, &closed, &Sides::default()).clear);
        assert!(path(SideRule::Nearest, &[], &Sides::default()).clear);
    }

    #[test]
    fn a_moving_body_is_passed_where_it_will_have_left_and_all_pieces_of_a_body_on_one_side() {
        let mut crossing = obstacle(1, 5.0, -1.0, 0.5);
        crossing.velocity = [0.0, 0.3];
        assert_eq!(side_of(SideRule::Nearest, crossing, &Sides::default()), Some(Passing::Right));
        let body = obstacle(1, 4.0, 0.1, 0.5).body;
        let pieces = [-0.2, 0.5].map(|y| PredictedObstacle { body, ..obstacle(1, 4.0, y, 0.5) });
        let path = path(SideRule::Nearest, &pieces, &Sides::default());
        assert_eq!(pieces.map(|piece| path.side_of(&piece)), [Some(Passing::Right); 2]);
    }
}
