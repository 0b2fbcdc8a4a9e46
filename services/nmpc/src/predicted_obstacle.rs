//! The obstacles of one scan, predicted over the horizon for planning and verification.
//!
//! Every ellipse becomes a [`PredictedObstacle`] whose time counts from the start of the plan, which is when the
//! command will act. A body whose velocity is not significant against its own covariance counts as standing:
//! prediction with a noisy velocity would move its ellipse by decimetres over the horizon.
//! Assumed: bodies keep their velocity over the horizon, along and across the course. Where they do not, the next scan
//! corrects it.

use nalgebra::Vector2;
use shared_types::{Obstacle, Obstacles};
use vehicle::Course;
use vehicle::frame::to_robot;
use vehicle::geometry::Rectangle;

/// Speed from which a body counts as moving: in standard deviations, and in any case [m/s].
const MOVES: (f64, f64) = (2.0, 0.08);
/// The same for a body that moved at the scan before: near the robot its ends are hidden, so the velocity is uncertain.
const STILL_MOVES: (f64, f64) = (0.7, 0.04);
/// By how much a short ellipse is longer than body and robot, to each side [m].
const SHORT_M: f64 = 0.35;
/// Obstacles are looked for on the course up to this far behind the robot and ahead of it [m].
const BEHIND_M: f64 = 8.0;
const AHEAD_M: f64 = 12.0;
/// Smallest length beside a bend as a share of that on the course.
const MIN_STRETCH: f64 = 0.2;
/// Largest position that is accepted [m].
const LARGEST_M: f64 = 1e5;

/// One ellipse and the box of the body inside it, at the start of the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PredictedObstacle {
    /// Identity of the ellipse.
    pub(crate) id: u32,
    /// Centre of the ellipse at the start of the plan [m].
    pub(crate) centre: [f64; 2],
    /// Velocity of the body, zero when not significant [m/s].
    pub(crate) velocity: [f64; 2],
    /// Semi-axis along the track, a of (7.34) [m].
    pub(crate) a: f64,
    /// Semi-axis across the track, b of (7.35) [m].
    pub(crate) b: f64,
    /// Box of the body at the start of the plan.
    pub(crate) body: Rectangle,
    /// The same in the plane of one at rest, where that is not the course: what lies beside the course at no length of it is
    /// elsewhere there.
    pub(crate) in_plane: Option<Rectangle>,
}

impl PredictedObstacle {
    /// Centre of the ellipse `t` seconds after the start of the plan [m].
    pub(crate) fn centre_at(&self, t: f64) -> [f64; 2] {
        [self.centre[0] + self.velocity[0] * t, self.centre[1] + self.velocity[1] * t]
    }

    /// Right-hand side of (7.34) for a position `t` seconds after the start of the plan: 1 on the ellipse.
    pub(crate) fn value(&self, t: f64, x: f64, y: f64) -> f64 {
        let [centre_x, centre_y] = self.centre_at(t);
        ((x - centre_x) / self.a).powi(2) + ((y - centre_y) / self.b).powi(2)
    }

    /// The same with both semi-axes enlarged.
    pub(crate) fn grown(&self, growth: f64) -> Self {
        Self { a: self.a + growth, b: self.b + growth, ..*self }
    }

    /// Box of the body `t` seconds after the start of the plan.
    pub(crate) fn body_at(&self, t: f64) -> Rectangle {
        let travel = Vector2::new(self.velocity[0] * t, self.velocity[1] * t);
        Rectangle { centre: self.body.centre + travel, ..self.body }
    }

    /// Makes the ellipse no longer along the track than the body with the robot's own reach and [`SHORT_M`] to each side.
    ///
    /// The ellipses of short bodies are longer than they need be, (7.35). The clearance of the bodies stays.
    pub(crate) fn shorten(&mut self, reach_m: f64) {
        let (sin, cos) = self.body.yaw.sin_cos();
        let half_length = (self.body.length * cos.abs() + self.body.width * sin.abs()) / 2.0;
        self.a = self.a.min(half_length + reach_m + SHORT_M);
    }

    /// Whether the body moves.
    pub(crate) fn moves(&self) -> bool {
        self.velocity != [0.0, 0.0]
    }
}

/// Fills `predicted` with the obstacles as they will be at the start of the plan, `lead_s` after the scan; `moved` tells
/// which ellipses moved at the scan before.
///
/// Returns false when a number is not finite or a size is impossible: then no plan may be made.
pub(crate) fn read(
    obstacles: &Obstacles,
    place: OnCourse<'_>,
    lead_s: f64,
    moved: impl Fn(u32) -> bool,
    predicted: &mut Vec<PredictedObstacle>,
) -> bool {
    predicted.clear();
    for item in obstacles.list() {
        if !is_sound(item) {
            return false;
        }
        let velocity = significant_velocity(item, if moved(item.id) { STILL_MOVES } else { MOVES });
        let travel = [velocity[0] * lead_s, velocity[1] * lead_s];
        let described = PredictedObstacle {
            id: item.id,
            centre: [item.x_m + travel[0], item.y_m + travel[1]],
            velocity,
            a: item.a_m,
            b: item.b_m,
            body: Rectangle {
                centre: Vector2::new(item.box_x_m + travel[0], item.box_y_m + travel[1]),
                yaw: item.box_yaw_rad,
                length: item.box_length_m,
                width: item.box_width_m,
            },
            in_plane: None,
        };
        predicted.push(place.of(described));
    }
    true
}

/// The course near the robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OnCourse<'a> {
    /// The course.
    pub(crate) course: &'a Course,
    /// Where the robot is on it [m].
    pub(crate) near_m: f64,
}

impl OnCourse<'_> {
    /// An obstacle in the plane, on the course.
    fn of(&self, obstacle: PredictedObstacle) -> PredictedObstacle {
        let Self { course, near_m } = *self;
        if course.is_line() {
            return obstacle;
        }
        let place = |point: Vector2<f64>| course.within(point, [near_m - BEHIND_M, near_m + AHEAD_M]);
        let (centre, body) = (place(Vector2::from(obstacle.centre)), place(obstacle.body.centre));
        let (here, tangent) = (course.at(centre[0]), course.at(body[0]));
        let velocity = to_robot(here.yaw, obstacle.velocity[0], obstacle.velocity[1]);
        // Beside a bend a metre along the course is another one than on it.
        let stretch = (1.0 - here.curvature * centre[1]).max(MIN_STRETCH);
        PredictedObstacle {
            centre,
            velocity: [velocity.x / stretch, velocity.y],
            body: Rectangle {
                centre: Vector2::from(body),
                yaw: obstacle.body.yaw - tangent.yaw,
                ..obstacle.body
            },
            in_plane: (!obstacle.moves()).then_some(obstacle.body),
            ..obstacle
        }
    }
}

fn is_sound(item: &Obstacle) -> bool {
    let anywhere = [item.x_m, item.y_m, item.box_x_m, item.box_y_m, item.box_yaw_rad];
    let speeds = [item.velocity_x_mps, item.velocity_y_mps];
    let sizes = [item.box_length_m, item.box_width_m];
    anywhere.iter().all(|value| value.abs() < LARGEST_M)
        && speeds.iter().all(|value| value.abs() < 100.0)
        && item.velocity_covariance.iter().all(|value| value.is_finite())
        && sizes.iter().all(|value| (0.0..=100.0).contains(value))
        && [item.a_m, item.b_m].iter().all(|value| (0.01..=100.0).contains(value))
        && is_around_its_body(item)
}

/// Whether the ellipse and the box of its body touch; if not, one of the two is wrong.
fn is_around_its_body(item: &Obstacle) -> bool {
    let apart_m = (item.x_m - item.box_x_m).hypot(item.y_m - item.box_y_m);
    apart_m <= item.a_m.max(item.b_m) + item.box_length_m.hypot(item.box_width_m) / 2.0
}

/// Whether a body is described as one that moves.
pub(crate) fn moves(item: &Obstacle) -> bool {
    [item.velocity_x_mps, item.velocity_y_mps] != [0.0, 0.0]
}

/// The velocity where its length is at least `slowest_mps` and so many standard deviations, else zero.
fn significant_velocity(item: &Obstacle, (deviations, slowest_mps): (f64, f64)) -> [f64; 2] {
    let (x, y) = (item.velocity_x_mps, item.velocity_y_mps);
    let speed = x.hypot(y);
    if speed < slowest_mps {
        return [0.0, 0.0];
    }
    let [xx, xy, yy] = item.velocity_covariance;
    let variance = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / (speed * speed);
    if speed * speed > deviations * deviations * variance { [x, y] } else { [0.0, 0.0] }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use vehicle::State;
    use vehicle::course::{CourseKeys, Waypoint};

    use super::*;
    use crate::config::ControllerConfig;
    use crate::scene::Scene;

    fn read_on_line(
        obstacles: &Obstacles,
        lead_s: f64,
        moved: impl Fn(u32) -> bool,
        predicted: &mut Vec<PredictedObstacle>,
    ) -> bool {
        let course = Course::default();
        read(obstacles, OnCourse { course: &course, near_m: 0.0 }, lead_s, moved, predicted)
    }

    fn obstacle() -> Obstacle {
        Obstacle {
            id: 1,
            x_m: 5.0,
            y_m: 0.5,
            a_m: 1.2,
            b_m: 0.8,
            box_x_m: 5.0,
            box_y_m: 0.5,
            ..Obstacle::default()
        }
    }

    fn one(item: Obstacle) -> Obstacles {
        let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
        obstacles.items[0] = item;
        obstacles
    }

    #[test]
    fn a_velocity_within_its_noise_does_not_move_the_ellipse() {
        let mut item =
            Obstacle { velocity_x_mps: -0.3, velocity_covariance: [0.04, 0.0, 0.04], ..obstacle() };
        let mut predicted = Vec::new();
        assert!(read_on_line(&one(item), 0.1, |_| false, &mut predicted));
        assert!(!predicted[0].moves() && predicted[0].centre == [5.0, 0.5]);
        item.velocity_covariance = [0.01, 0.0, 0.01];
        assert!(read_on_line(&one(item), 0.1, |_| false, &mut predicted));
        assert!((predicted[0].centre[0] - 4.97).abs() < 1e-12);
        assert!((predicted[0].centre_at(1.0)[0] - 4.67).abs() < 1e-12);
    }

    #[test]
    fn a_body_that_moved_goes_on_moving_while_its_velocity_is_uncertain() {
        let item = Obstacle { velocity_y_mps: -0.14, velocity_covariance: [0.0, 0.0, 0.01], ..obstacle() };
        let mut predicted = Vec::new();
        assert!(read_on_line(&one(item), 0.1, |_| false, &mut predicted) && !predicted[0].moves());
        assert!(read_on_line(&one(item), 0.1, |id| id == 1, &mut predicted) && predicted[0].moves());
        let slow = Obstacle { velocity_y_mps: -0.03, ..item };
        assert!(read_on_line(&one(slow), 0.1, |_| true, &mut predicted) && !predicted[0].moves());
    }

    #[test]
    fn the_value_is_one_on_the_ellipse() {
        let mut predicted = Vec::new();
        assert!(read_on_line(&one(obstacle()), 0.0, |_| false, &mut predicted));
        assert!((predicted[0].value(0.0, 6.2, 0.5) - 1.0).abs() < 1e-12);
        assert!((predicted[0].value(0.0, 5.0, -0.3) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_short_ellipse_ends_behind_body_and_robot_and_a_long_one_stays() {
        let mut predicted = Vec::new();
        assert!(read_on_line(
            &one(Obstacle { box_length_m: 0.1, ..obstacle() }),
            0.0,
            |_| false,
            &mut predicted
        ));
        // 0.05 m of the body, 0.28 m of the robot and 0.35 m.
        predicted[0].shorten(0.28);
        assert!((predicted[0].a - 0.68).abs() < 1e-12 && predicted[0].b == 0.8);
        assert!(read_on_line(
            &one(Obstacle { box_length_m: 3.0, ..obstacle() }),
            0.0,
            |_| false,
            &mut predicted
        ));
        predicted[0].shorten(0.28);
        assert_eq!(predicted[0].a, 1.2);
    }

    #[test]
    fn a_body_inside_of_a_loop_is_where_it_is_also_at_the_end_of_the_last_lap() {
        let waypoints = [(0.0, 0.0, 0.0), (8.0, 0.0, 0.0), (8.0, 7.0, PI), (0.0, 7.0, PI), (0.0, 0.0, 0.0)];
        let waypoints = waypoints.map(|(x_m, y_m, yaw_rad)| Waypoint::new(x_m, y_m, Some(yaw_rad))).to_vec();
        let course = Course::try_from(CourseKeys { waypoints, laps: 3, ..CourseKeys::default() }).unwrap();
        let config = ControllerConfig { course: course.clone(), ..ControllerConfig::default() };
        let island = Obstacle { x_m: -0.1, box_x_m: 4.0, box_length_m: 11.0, box_width_m: 3.1, ..obstacle() };
        let island = Obstacle { y_m: 3.5, box_y_m: 3.5, a_m: 4.6, b_m: 1.8, ..island };
        let near_m = course.length_m() - 2.0;
        let mut predicted = Vec::new();
        let place = OnCourse { course: &course, near_m };
        assert!(read(&one(island), place, 0.0, |_| false, &mut predicted));
        let here = State { x: near_m, ..State::default() };
        let scene = Scene::new(&config, &predicted, here);
        let apart_m = scene.body_at(&here).distance_to_rectangle(&scene.in_plane(&predicted[0], 0.0));
        // The robot is at (-1.9, 0.5), a corner of the box at (-1.5, 1.95).
        assert!((0.9..1.5).contains(&apart_m), "{apart_m}");
    }

    #[test]
    fn impossible_numbers_are_refused() {
        let mut predicted = Vec::new();
        assert!(!read_on_line(
            &one(Obstacle { x_m: f64::NAN, ..obstacle() }),
            0.0,
            |_| false,
            &mut predicted
        ));
        assert!(!read_on_line(&one(Obstacle { b_m: 0.0, ..obstacle() }), 0.0, |_| false, &mut predicted));
        assert!(!read_on_line(
            &one(Obstacle { velocity_y_mps: f64::INFINITY, ..obstacle() }),
            0.0,
            |_| false,
            &mut predicted
        ));
    }
}
