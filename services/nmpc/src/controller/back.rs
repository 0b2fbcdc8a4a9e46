//! Where a robot that stands turns to: the next leg of the course, the way out of a dead end, or out of the way of a body.

use shared_types::{DrivenBy, Pose, StopReason};
use vehicle::State;

use super::{Controller, rests};
use crate::braking::Stopping;
use crate::config::SideRule;
use crate::escape::back_away;
use crate::margin::MarginModel;
use crate::predicted_obstacle::PredictedObstacle;
use crate::query::Query;
use crate::scene::Scene;
use crate::sights::Sights;
use crate::state::Arrival;

/// The robot drives back so much further than to where a path begins, where it can [m].
const SPARE_BACK_M: f64 = 0.75;
/// A robot that is turned further from the course than this can't be planned for from there [rad].
const TURNED_MAX_RAD: f64 = 0.9;

impl Controller {
    /// Drives the next leg, back to a goal that was passed, or forwards again behind the way out of a dead end.
    pub(super) fn turn(&mut self, pose: &Pose) {
        let state = &mut self.state;
        if state.back.overshoots() {
            let here = State { x: pose.x_m, y: pose.y_m, yaw: pose.yaw_rad, ..State::default() };
            let here = self.config.course.on_course(&here, state.along().unwrap_or(here.x));
            let [x, y] = state.back.to_m;
            state.back.begin(here.x, &State { x, y, ..State::default() });
            state.plan[0].x_m = self.legs.seen_from_end(here.x);
        } else if state.back.drives == 1 {
            state.back.end();
            state.sights.take_back([pose.x_m, pose.y_m]);
            state.plan[0].x_m = self.legs.seen_from_end(state.plan[0].x_m);
        } else {
            state.leg = state.leg.saturating_add(1);
        }
        (state.arrival, state.blocked_scans, state.sides) = (Arrival::OnTheWay.wire(), 0, Default::default());
    }

    /// Looks for a way out of a dead end in which the robot stands, at one place behind it, or out of the way of a body that
    /// comes. What blocks it and came `lately` may go again.
    pub(super) fn look_back(&mut self, reason: StopReason, pose: &Pose, period_s: f64, lately: bool) {
        let stands = matches!(reason, StopReason::Blocked | StopReason::Unverified | StopReason::Unseen);
        let is_driven = self.state.driven_by == DrivenBy::Controller.wire();
        if !stands || !is_driven || !rests(pose) || self.config.side != SideRule::Search {
            self.state.back.stood = 0;
            return;
        }
        let Self { config, legs, state, predicted, search, alternative, .. } = self;
        let here = State {
            x: pose.predicted_x_m,
            y: pose.predicted_y_m,
            yaw: pose.predicted_yaw_rad,
            ..State::default()
        };
        let here = config.course.on_course(&here, state.along().unwrap_or(here.x));
        let before = |sights: &Sights, way_m: f64| {
            let place = sights.before([pose.x_m, pose.y_m], way_m)?;
            let place = config.course.on_course(&place, here.x - way_m);
            (place.x < here.x && place.yaw.abs() < TURNED_MAX_RAD).then_some(place)
        };
        let moves = predicted.iter().any(PredictedObstacle::moves);
        if moves && legs.can_return() {
            let margin = MarginModel::of(config, pose);
            let scene = Scene::new(config, predicted, here).keeping(margin, 0.0);
            let stopping = Stopping::new(config, period_s, margin.age_s());
            let place = |way_m: f64| before(&state.sights, way_m).filter(|_| way_m <= config.back_out_m);
            if let Some(way_m) = back_away(&scene, &stopping, legs.reverse_mps(), place) {
                let to = place(way_m + SPARE_BACK_M).or_else(|| place(way_m)).unwrap_or(here);
                let tries = state.back.tries;
                state.back.begin(here.x, &to);
                // It does not look for a way on from there.
                state.back.tries = tries;
                state.plan[0].x_m = legs.seen_from_end(here.x);
                (state.blocked_scans, state.sides) = (0, Default::default());
                return;
            }
        }
        let Some(way_m) = state.back.stand(here.x, period_s, config.back_out_m) else { return };
        if state.back.drives == 1 {
            // The way back ends here.
            state.arrival = Arrival::LegDriven.wire();
            return;
        }
        if !legs.can_return() || moves {
            state.back.stood = 0;
            return;
        }
        let Some(place) = before(&state.sights, way_m) else { return };
        // The path from there will be only just clear.
        let further = before(&state.sights, way_m + SPARE_BACK_M).unwrap_or(place);
        let margin = MarginModel::of(config, pose);
        config.guide.range_m += way_m;
        let scene = Scene::new(config, predicted, place).keeping(margin, 0.0);
        let speed = config.vehicle.bounds.velocity_min_mps;
        let query = Query { scene, speed, narrow: true, sides: &state.sides, forced: None };
        search.find(&query, alternative);
        let is_found = alternative.clear && !alternative.misses_goal;
        if is_found && lately {
            state.back.stay();
        } else if is_found {
            state.back.begin(here.x, &further);
            state.plan[0].x_m = legs.seen_from_end(here.x);
            (state.blocked_scans, state.sides) = (0, Default::default());
        }
    }
}
