use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::config::ControllerConfig;
use crate::predicted_obstacle::PredictedObstacle;
use crate::side::{Passing, Sides, hold};
use nalgebra::Vector2;
use vehicle::geometry::Rectangle;
use vehicle::{Goal, State};

fn obstacle_at(id: u32, x: f64, y: f64, b: f64) -> PredictedObstacle {
    let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.1 };
    PredictedObstacle { id, centre: [x, y], velocity: [0.0, 0.0], a: 1.2, b, body, in_plane: None }
}

fn find(start: State, predicted: &[PredictedObstacle], sides: &Sides) -> ReferencePath {
    let config =
        ControllerConfig { goal: Goal { x_m: 30.0, ..Goal::default() }, ..ControllerConfig::default() };
    let query =
        Query { scene: Scene::new(&config, predicted, start), speed: 1.0, narrow: true, sides, forced: None };
    let mut reference_path = ReferencePath::default();
    Search::default().find(&query, &mut reference_path);
    reference_path
}

#[test]
fn a_centred_obstacle_is_passed_outside_of_its_ellipse() {
    let obstacle = obstacle_at(1, 4.5, 0.0, 0.9);
    let reference_path = find(State::default(), &[obstacle], &Sides::default());
    assert!(reference_path.clear);
    for step in 0..60 {
        let x = f64::from(step) * 0.1;
        let (y, _, curvature) = reference_path.at(x);
        assert!(obstacle.value(0.0, x, y) > 0.99, "{x} {y}");
        assert!(y.abs() <= 1.5 && curvature.abs() <= 0.3241);
    }
    assert_ne!(reference_path.side_of(&obstacle), None);
}

#[test]
fn a_closed_side_is_not_taken() {
    let obstacle = obstacle_at(1, 4.5, 0.7, 0.9);
    assert_eq!(
        find(State::default(), &[obstacle], &Sides::default()).side_of(&obstacle),
        Some(Passing::Right)
    );
    let wide = obstacle_at(1, 4.5, 0.0, 1.6);
    assert!(!find(State::default(), &[wide], &Sides::default()).clear);
}

#[test]
fn the_gap_between_two_ellipses_is_used_only_when_it_is_open() {
    let pair = [obstacle_at(1, 4.5, 0.75, 0.7), obstacle_at(2, 4.5, -0.75, 0.7)];
    assert!(find(State::default(), &pair, &Sides::default()).clear);
    let closed = [obstacle_at(1, 4.5, 0.7, 0.85), obstacle_at(2, 4.5, -0.7, 0.85)];
    assert!(!find(State::default(), &closed, &Sides::default()).clear);
}

#[test]
fn the_held_side_is_kept_although_the_other_is_a_little_cheaper() {
    let obstacle = obstacle_at(1, 4.5, 0.03, 0.8);
    assert_eq!(
        find(State::default(), &[obstacle], &Sides::default()).side_of(&obstacle),
        Some(Passing::Right)
    );
    let mut sides = Sides::default();
    hold(&mut sides, &obstacle, Passing::Left);
    assert_eq!(find(State::default(), &[obstacle], &sides).side_of(&obstacle), Some(Passing::Left));
}

#[test]
fn an_obstacle_too_near_has_no_clear_path() {
    assert!(!find(State::default(), &[obstacle_at(1, 2.0, 0.0, 0.9)], &Sides::default()).clear);
}

/// One to three boxes ahead, some turned, some of them moving, some with a held side.
fn random_scene(random: &mut Pcg64Mcg) -> (Vec<PredictedObstacle>, Sides) {
    let mut sides = Sides::default();
    let predicted = (1..=random.random_range(1..4)).map(|id| {
        let (x, y) = (random.random_range(1.5..7.0), random.random_range(-0.8..0.8));
        let (length, width) = (random.random_range(0.1..0.4), random.random_range(0.1..0.5));
        let yaw = if random.random_bool(0.3) { random.random_range(-0.8..0.8) } else { 0.0 };
        let velocity = if random.random_bool(0.2) { [0.0, random.random_range(-0.3..0.3)] } else { [0.0; 2] };
        let body = Rectangle { centre: Vector2::new(x, y), yaw, length, width };
        let (a, b) = (0.5 + length, 0.35 + width);
        let obstacle = PredictedObstacle { id, centre: [x, y], velocity, a, b, body, in_plane: None };
        if random.random_bool(0.5) {
            hold(&mut sides, &obstacle, Passing::of(random.random_range(-1.0..1.0), 0.0));
        }
        obstacle
    });
    (predicted.collect(), sides)
}

#[test]
fn the_path_is_that_of_a_search_of_all_paths() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (mut bounded, mut full) = (Search::default(), Search::default());
    let (mut path, mut expected) = (ReferencePath::default(), ReferencePath::default());
    let (mut clear, mut pruned) = (0, 0);
    for _ in 0..300 {
        let (predicted, sides) = random_scene(&mut random);
        let x_m = if random.random_bool(0.3) { random.random_range(1.0..7.0) } else { 30.0 };
        let config =
            ControllerConfig { goal: Goal { x_m, ..Goal::default() }, ..ControllerConfig::default() };
        let (y, yaw) = (random.random_range(-0.7..0.7), random.random_range(-0.3..0.3));
        let scene = Scene::new(&config, &predicted, State { y, yaw, ..State::default() });
        let narrow = random.random_bool(0.5);
        let forced = predicted
            .first()
            .filter(|_| random.random_bool(0.3))
            .map(|obstacle| (obstacle.id, Passing::Left));
        let query = Query { scene, speed: random.random_range(0.1..1.0), narrow, sides: &sides, forced };
        bounded.find(&query, &mut path);
        let grid = full.prepare(&query);
        full.search(&query, &grid, f64::INFINITY, &mut expected);
        assert_eq!(path, expected);
        let sketched = bounded.sketch(&query, &grid);
        // A bound that is too low for some paths: then all are searched.
        bounded.search(&query, &grid, 0.9 * sketched, &mut path);
        assert_eq!(path, expected);
        clear += u32::from(path.clear);
        pruned += u32::from(sketched < f64::INFINITY);
    }
    assert!(clear > 200 && pruned > 200, "{clear} clear, {pruned} with a bound");
}
