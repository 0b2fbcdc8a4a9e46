//! The reference path through the obstacles, with it the passing sides, and the path on the other side where that may cost less.

use shared_types::MAX_OBSTACLES;
use vehicle::State;

use super::Controller;
use crate::config::SideRule;
use crate::contest::Contest;
use crate::explicit_side;
use crate::predicted_obstacle::PredictedObstacle;
use crate::query::Query;
use crate::reference_path::ReferencePath;
use crate::scene::Scene;
use crate::side::{self, Passing, held};
use crate::start::Start;

/// Velocities at which a path past moving obstacles is searched, as shares of the cruising velocity.
const SLOWER: [f64; 4] = [1.0, 0.6, 0.35, 0.15];
/// A moving obstacle is passed on the other side when that costs less than this share.
const SWITCH_SHARE: f64 = 0.8;
/// A way to the goal that begins so much slower than the robot is comes too late [m/s]: the robot is beside the obstacles.
const SUDDEN_MPS: f64 = 0.2;
/// Nearer to the goal no slow way is looked for [m]: a robot that creeps beside a body that moves unnoticed is touched.
const SLOW_WAY_M: f64 = 2.0;
/// Share of the drive's largest deceleration with which a path slows down for a narrow place.
const SLOWING_SHARE: f64 = 0.35;

impl Controller {
    /// Finds the reference path, and with it the passing sides.
    pub(super) fn find_reference_path(&mut self, start: &Start) {
        let (config, predicted) = (&self.config, &self.predicted);
        let (goal, initial) = (&config.goal, &start.initial);
        let cruise = config.cruise_mps.min(start.limit_mps);
        let slowest = config.vehicle.bounds.velocity_min_mps;
        let reach = initial.x + config.guide.range_m;
        let (low, high) = (initial.y.min(goal.y_m) - 0.1, initial.y.max(goal.y_m) + 0.1);
        let margin = config.ellipse_margin_m + config.guide.comfort_m + start.margin.growth(0.0, cruise);
        let in_the_way = |obstacle: &PredictedObstacle| {
            let [x, y] = obstacle.centre;
            obstacle.moves()
                || (x - obstacle.a < reach
                    && x + obstacle.a + margin > initial.x
                    && y - obstacle.b - margin < high
                    && y + obstacle.b + margin > low)
        };
        if config.side != SideRule::Search {
            let scene = start.scene(config, predicted);
            explicit_side::find(&scene, &self.state.sides, cruise, &mut self.reference_path);
        } else if predicted.iter().any(in_the_way) {
            let scene = start.scene(config, predicted);
            let mut find = |speed: f64, narrow: bool| {
                let query = Query { scene, speed, narrow, sides: &self.state.sides, forced: None };
                self.search.find(&query, &mut self.reference_path);
                self.reference_path.clear
            };
            let moving = predicted.iter().any(PredictedObstacle::moves);
            if moving {
                self.find_way_past_moving(start, [slowest, cruise]);
            } else if !find(cruise, false) && find(slowest, true) {
                slow_down(&mut self.reference_path, &scene, [slowest, cruise]);
            }
            if self.reference_path.clear && self.reference_path.misses_goal && !moving {
                self.find_way_to_goal(start, [slowest, cruise]);
            }
            if !self.reference_path.clear {
                // It leads to what blocks it, as fast as that can be stopped for.
                self.reference_path.speed = cruise;
            }
        } else {
            self.reference_path.set_line(initial.x, goal.y_m, cruise);
        }
        self.find_alternative(start);
        let choose = |obstacle: &PredictedObstacle| self.reference_path.side_of(obstacle);
        side::renew(&mut self.state.sides, &self.predicted, choose);
    }

    /// The fastest path past bodies that move which leads to the goal; without one, the fastest that is clear.
    fn find_way_past_moving(&mut self, start: &Start, [slowest, cruise]: [f64; 2]) {
        let Self { config, search, predicted, reference_path, alternative, state, .. } = self;
        let scene = start.scene(config, predicted);
        let mut is_found = false;
        for share in SLOWER {
            let speed = (cruise * share).max(slowest);
            let query = Query { scene, speed, narrow: true, sides: &state.sides, forced: None };
            search.find(&query, alternative);
            let arrives = alternative.clear && !alternative.misses_goal;
            if arrives || !is_found {
                std::mem::swap(reference_path, alternative);
                is_found = reference_path.clear;
            }
            if arrives {
                break;
            }
        }
    }

    /// Where the path passes the goal too far away: one that leads to it, between ellipses that are no longer than they must
    /// be, and slow in narrow places if need be. The ellipses stay so for this scan.
    fn find_way_to_goal(&mut self, start: &Start, [slowest, cruise]: [f64; 2]) {
        let Self { config, search, predicted, reference_path, alternative, state, .. } = self;
        let mut axes = [0.0; MAX_OBSTACLES];
        for (axis, obstacle) in axes.iter_mut().zip(predicted.iter_mut()) {
            *axis = obstacle.a;
            obstacle.shorten(config.vehicle.reach_m());
        }
        let scene = start.scene(config, predicted);
        let is_far = config.goal.x_m - start.initial.x > SLOW_WAY_M;
        let is_found = [cruise, slowest].into_iter().take(1 + usize::from(is_far)).any(|speed| {
            let query = Query { scene, speed, narrow: true, sides: &state.sides, forced: None };
            search.find(&query, alternative);
            if !alternative.clear || alternative.misses_goal {
                return false;
            }
            if speed < cruise {
                slow_down(alternative, &scene, [slowest, cruise]);
            }
            alternative.speed_at(start.initial.x) > start.speed - SUDDEN_MPS
        });
        if is_found {
            std::mem::swap(reference_path, alternative);
        } else {
            predicted.iter_mut().zip(axes).for_each(|(obstacle, axis)| obstacle.a = axis);
        }
    }

    /// Finds a path on the other side of the nearest obstacle whose side is not held, or that moves.
    fn find_alternative(&mut self, start: &Start) {
        self.contest = None;
        let (config, predicted, path) = (&self.config, &self.predicted, &self.reference_path);
        let is_searched = config.side == SideRule::Search;
        if !is_searched || !path.clear || !path.limits.is_empty() || path.y.len() < 2 {
            return;
        }
        let open =
            |obstacle: &&PredictedObstacle| obstacle.moves() || held(&self.state.sides, obstacle).is_none();
        let ahead = |obstacle: &&PredictedObstacle| obstacle.centre[0] > start.initial.x;
        let nearest = predicted
            .iter()
            .filter(ahead)
            .filter(open)
            .min_by(|one, other| one.centre[0].total_cmp(&other.centre[0]));
        let Some((obstacle, side)) = nearest.and_then(|obstacle| Some((obstacle, path.side_of(obstacle)?)))
        else {
            return;
        };
        let query = Query {
            scene: start.scene(config, predicted),
            speed: path.speed,
            narrow: false,
            sides: &self.state.sides,
            forced: Some((obstacle.id, side.other())),
        };
        self.search.find(&query, &mut self.alternative);
        let is_as_good = self.alternative.clear && (path.misses_goal || !self.alternative.misses_goal);
        if is_as_good && self.alternative.side_of(obstacle) == Some(side.other()) {
            let is_held = held(&self.state.sides, obstacle).is_some();
            let share = if is_held { SWITCH_SHARE } else { 1.0 };
            self.contest = Some(Contest { id: obstacle.id, side, share });
        }
    }

    /// Side on which the nearest obstacle that the line leads through is passed.
    pub(super) fn nearest_side(&self, initial: &State) -> i32 {
        let line = self.config.goal.y_m;
        let in_the_way = |obstacle: &&PredictedObstacle| {
            obstacle.centre[0] > initial.x
                && (obstacle.centre[1] - line).abs() < obstacle.b
                && held(&self.state.sides, obstacle).is_some()
        };
        let nearest =
            self.predicted.iter().filter(in_the_way).min_by(|a, b| a.centre[0].total_cmp(&b.centre[0]));
        nearest.and_then(|obstacle| held(&self.state.sides, obstacle)).map_or(0, Passing::wire)
    }
}

/// Slows down along a path that was searched for the slowest speed, only where the margin of a faster one does not fit.
fn slow_down(path: &mut ReferencePath, scene: &Scene, speeds: [f64; 2]) {
    let deceleration = SLOWING_SHARE * scene.config.vehicle.deceleration_max_mps2;
    path.set_limits(deceleration, |x, y, course| scene.fastest_at(x, y, course, speeds));
}
