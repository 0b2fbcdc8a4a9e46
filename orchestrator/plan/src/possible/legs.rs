//! Whether the robot can get from goal to goal, and land at each.
//!
//! Along a line it drives forwards only and does not turn round. Its turns are circles of the steady state, 4 % larger where it has to get
//! into the turn first, and larger by the curvature that the controller leaves for corrections where it plans a path to the
//! goal. That path begins a scan period after the start, and does not leave the track. Along a course it is the bends that must
//! not be sharper than a planned turn. Obstacles count for nothing here: the stages do not know them.

use std::f64::consts::FRAC_PI_2;

use emulator::Scenario;
use emulator::scenario::{Goal, Start};
use nmpc::ControllerConfig;
use vehicle::{Control, Course, Goals, Invalid};

/// By how much a turn is larger than a steady one, because the robot has to get into it.
const ENTRY_SHARE: f64 = 1.04;
/// How far the robot may leave its bounds [m].
const OUTSIDE_M: f64 = 0.05;
/// Largest share of the tolerance of the goal that half the way of one scan period may be: the rest is for the estimate.
const LANDING_SHARE: f64 = 0.5;
/// Share of the stopping distance by which a landing may miss: drives missed by so much whose robot has no lag, while the
/// description has one.
const STOP_ERROR_SHARE: f64 = 0.75;
/// Radius of the turns of a robot that hardly turns [m].
const STRAIGHT_M: f64 = 1e6;
/// Step of the search for the nearest goal [m].
const STEP_M: f64 = 0.01;

/// The way from one place to land at to the next one, along and across the course.
pub(crate) struct Leg {
    pub(super) start: Start,
    pub(super) goal: Goal,
    /// Keys of the two in messages.
    from: String,
    to: String,
}

/// All legs of a drive in their order.
pub(super) fn all(scenario: &Scenario) -> Vec<Leg> {
    let goals = scenario.goals_on_course().into_iter().enumerate();
    legs(scenario.start_on_course(), goals, &scenario.goal)
}

/// The legs from a place through goals with their numbers among all; places are along and across the course.
pub(crate) fn legs(mut start: Start, goals: impl Iterator<Item = (usize, Goal)>, all: &Goals) -> Vec<Leg> {
    let mut from = "start".to_owned();
    let leg = |(index, goal): (usize, Goal)| {
        let to = all.key(index);
        let leg = Leg { start, goal, from: from.clone(), to: to.clone() };
        (start, from) = (Start { x_m: goal.x_m, y_m: goal.y_m, yaw_rad: 0.0 }, to);
        leg
    };
    goals.map(leg).collect()
}

/// Passes when each goal can be reached from the one before it, or from the start, on an empty track, and the robot can land
/// there.
///
/// `controller` has the track of the scenario.
///
/// # Errors
/// [`Invalid`] with a key of the scenario, its value and what is possible.
pub(crate) fn require_goals(scenario: &Scenario, controller: &ControllerConfig) -> Result<(), Invalid> {
    require_legs(scenario, controller, &all(scenario))
}

/// The same for these legs of the drive.
///
/// # Errors
/// As [`require_goals`].
pub(crate) fn require_legs(
    scenario: &Scenario,
    controller: &ControllerConfig,
    legs: &[Leg],
) -> Result<(), Invalid> {
    require_speeds(scenario, controller)?;
    legs.iter().enumerate().try_for_each(|(index, leg)| require_goal(scenario, controller, leg, index == 0))
}

fn require_goal(
    scenario: &Scenario,
    controller: &ControllerConfig,
    leg: &Leg,
    is_first: bool,
) -> Result<(), Invalid> {
    let Leg { start, goal, from, to } = leg;
    let radius_m = turning_radius(controller);
    let distance_m = (goal.x_m - start.x_m).hypot(goal.y_m - start.y_m);
    let [low, high] = controller.y_range();
    let reach_m = goal.tolerance_m + OUTSIDE_M;
    if !(low - reach_m..=high + reach_m).contains(&goal.y_m) {
        let (low, high) = (ceil(low), floor(high));
        let allowed = format!("{low} to {high}, the bounds of the robot's centre between the walls");
        return Err(Invalid::new(&format!("{to}.y_m"), goal.y_m, allowed));
    }
    require_landing(goal, to, controller)?;
    if distance_m <= goal.tolerance_m {
        return Ok(());
    }
    if goal.x_m <= start.x_m {
        let allowed = format!(
            "above {from}.x_m = {}: along a line the robot does not turn round; a [course] with turn_radius_m does",
            start.x_m
        );
        return Err(Invalid::new(&format!("{to}.x_m"), goal.x_m, allowed));
    }
    if is_first {
        require_heading(scenario, controller, ENTRY_SHARE * radius_m)?;
    }
    let turns = Turns::new(start, goal, controller, ENTRY_SHARE * radius_m);
    if let Some(course) = &scenario.course {
        require_reverse(course, controller)?;
        require_bends(course, controller, radius_m)?;
        return require_beside(course, leg, turns);
    }
    if turns.reach(goal.x_m, goal.y_m) {
        return Ok(());
    }
    let nearest = (1..).map(|step| goal.x_m + f64::from(step) * STEP_M);
    let nearest =
        nearest.take_while(|x_m| *x_m <= controller.track.x_m[1]).find(|x_m| turns.reach(*x_m, goal.y_m));
    let place =
        format!("{from}.x_m = {}, {from}.y_m = {} and yaw_rad = {}", start.x_m, start.y_m, start.yaw_rad);
    let allowed = match nearest {
        Some(x_m) => format!("at least {}", ceil(x_m)),
        None => "none on the track".to_owned(),
    };
    let allowed = format!(
        "{allowed} for {to}.y_m = {}, as the smallest planned turn from {place} has {} m radius and stays on the track",
        goal.y_m,
        ceil(turns.radius_m)
    );
    Err(Invalid::new(&format!("{to}.x_m"), goal.x_m, allowed))
}

/// Passes when half the way of one scan period at the smallest velocity is well within the tolerance of the goal, and also with
/// the error of the stop from that velocity.
fn require_landing(goal: &Goal, key: &str, controller: &ControllerConfig) -> Result<(), Invalid> {
    let slowest_mps = controller.vehicle.bounds.velocity_min_mps;
    let stop_m = slowest_mps * slowest_mps / (2.0 * controller.vehicle.blocked_deceleration_mps2);
    let half_way_m = slowest_mps * controller.period_s / 2.0;
    let needed_m = (half_way_m / LANDING_SHARE).max(half_way_m + STOP_ERROR_SHARE * stop_m);
    // Rounding of the product.
    if needed_m <= goal.tolerance_m + 1e-9 {
        return Ok(());
    }
    let allowed = format!(
        "at least {}, for the way of one scan period of {} s and the stop at vehicle.bounds.velocity_min_mps = {slowest_mps}",
        ceil(needed_m),
        ceil(controller.period_s)
    );
    Err(Invalid::new(&format!("{key}.tolerance_m"), goal.tolerance_m, allowed))
}

/// Passes when the robot can drive as slowly as the course demands.
fn require_speeds(scenario: &Scenario, controller: &ControllerConfig) -> Result<(), Invalid> {
    let slowest_mps = controller.vehicle.bounds.velocity_min_mps;
    let waypoints = scenario.course.iter().flat_map(|course| &course.keys().waypoints).enumerate();
    for (index, speed_mps) in waypoints.filter_map(|(index, waypoint)| Some((index, waypoint.speed_mps?))) {
        if speed_mps < slowest_mps {
            let allowed = format!("at least vehicle.bounds.velocity_min_mps = {slowest_mps}");
            return Err(Invalid::new(&format!("course.waypoints[{index}].speed_mps"), speed_mps, allowed));
        }
    }
    Ok(())
}

/// Passes when the vehicle drives backwards where the course does.
fn require_reverse(course: &Course, controller: &ControllerConfig) -> Result<(), Invalid> {
    let mut backwards = course.keys().waypoints.iter().enumerate().filter(|(_, waypoint)| waypoint.reverse);
    match backwards.next().filter(|_| controller.vehicle.bounds.mirrored().is_none()) {
        Some((index, _)) => {
            let bounds = &controller.vehicle.bounds;
            let allowed = format!(
                "a vehicle that drives backwards: vehicle.bounds.reverse_max_mps = {} is below velocity_min_mps = {}",
                bounds.reverse_max_mps, bounds.velocity_min_mps
            );
            Err(Invalid::new(&format!("course.waypoints[{index}].reverse"), true, allowed))
        }
        None => Ok(()),
    }
}

/// Passes when no bend of the course is sharper than the turns that the controller plans.
fn require_bends(course: &Course, controller: &ControllerConfig, radius_m: f64) -> Result<(), Invalid> {
    let (sharpest, smallest_m) = (course.sharpest(), radius_m / controller.curvature_share());
    if sharpest.radius_m >= smallest_m {
        return Ok(());
    }
    let value = format!("a bend with a radius of {} m", floor(sharpest.radius_m));
    let allowed = format!(
        "at least {} m, the smallest planned turn at controller.cruise_mps = {}",
        ceil(smallest_m),
        controller.cruise_mps
    );
    Err(Invalid::new(&format!("course.waypoints[{}]", sharpest.waypoint), value, allowed))
}

/// Passes when a turn leads to a goal that is beside the course. In its bends the robot turns with the course, so the turn is
/// taken as sharper by the sharpest bend, and the way as longer by the outer side of it.
fn require_beside(course: &Course, leg: &Leg, mut turns: Turns) -> Result<(), Invalid> {
    let Leg { start, goal, from, to } = leg;
    let turn_m = turns.radius_m;
    let curvature = 1.0 / course.sharpest().radius_m;
    turns.radius_m = 1.0 / (1.0 / turn_m + curvature);
    let outer = 1.0 + curvature * start.y_m.abs().max(goal.y_m.abs());
    if turns.reach(start.x_m + (goal.x_m - start.x_m) * outer, goal.y_m) {
        return Ok(());
    }
    let allowed = format!(
        "farther along the course, or nearer to it: from {from} it is {} m along and {} m to the left, and the smallest planned \
         turn has {} m radius",
        floor(goal.x_m - start.x_m),
        floor(goal.y_m - start.y_m),
        ceil(turn_m)
    );
    Err(Invalid::new(to, format!("{} m along the course", floor(goal.x_m)), allowed))
}

/// Passes when the robot can turn into the direction of the track or the course before it leaves it.
fn require_heading(scenario: &Scenario, controller: &ControllerConfig, radius_m: f64) -> Result<(), Invalid> {
    let start = scenario.start_on_course();
    let [low, high] = controller.y_range();
    let to_side_m = if start.yaw_rad > 0.0 { high - start.y_m } else { start.y_m - low } + OUTSIDE_M;
    // A turn from an angle leads radius (1 - cos angle) to the side, and from beyond a right angle also back.
    let mut largest = (1.0 - to_side_m / radius_m).clamp(-1.0, 1.0).acos();
    let back_m = start.x_m - controller.track.x_m[0] + OUTSIDE_M;
    if start.yaw_rad.abs() > FRAC_PI_2 && radius_m * (1.0 - start.yaw_rad.abs().sin()) > back_m {
        largest = largest.min(FRAC_PI_2);
    }
    if start.yaw_rad.abs() <= largest {
        return Ok(());
    }
    let Start { x_m, y_m, yaw_rad } = scenario.start;
    let (value, track) = match scenario.course {
        Some(_) => (
            format!("{yaw_rad} ({:.3} from the direction of the course)", start.yaw_rad),
            "way of the course",
        ),
        None => (yaw_rad.to_string(), "track"),
    };
    let allowed = format!(
        "at most {} to this side, as a turn of {} m radius from start.x_m = {x_m} and start.y_m = {y_m} leads off the {track}",
        floor(largest),
        ceil(radius_m)
    );
    Err(Invalid::new("start.yaw_rad", value, allowed))
}

/// The sharpest paths that the controller plans: a turn to one side, and back into the direction of the track before its bound.
struct Turns {
    /// Where the turns begin: x, y and yaw.
    from: [f64; 3],
    radius_m: f64,
    /// Bounds of the robot's centre across the track.
    y_m: [f64; 2],
    /// How near to the goal a path has to lead: its tolerance without the way of one scan period at the smallest velocity, of
    /// which the landing may miss a half.
    within_m: f64,
}

impl Turns {
    fn new(start: &Start, goal: &Goal, controller: &ControllerConfig, radius_m: f64) -> Self {
        let late_m = controller.cruise_mps * controller.period_s;
        let (sin, cos) = start.yaw_rad.sin_cos();
        let landing_m = controller.vehicle.bounds.velocity_min_mps * controller.period_s;
        Self {
            from: [start.x_m + late_m * cos, start.y_m + late_m * sin, start.yaw_rad],
            radius_m: radius_m / controller.curvature_share(),
            y_m: controller.y_range(),
            within_m: (goal.tolerance_m - landing_m).max(0.0),
        }
    }

    /// Whether a path leads to a place.
    fn reach(&self, x_m: f64, y_m: f64) -> bool {
        let [from_x_m, from_y_m, yaw_rad] = self.from;
        let [low_m, high_m] = self.y_m;
        let ahead_m = x_m - from_x_m;
        self.reach_to_left(ahead_m, y_m - from_y_m, yaw_rad, high_m - from_y_m)
            && self.reach_to_left(ahead_m, from_y_m - y_m, -yaw_rad, from_y_m - low_m)
    }

    /// Whether a place that is so far ahead and to the left of the start is not beyond the path that turns sharpest to the
    /// left, with the bound of the track at `bound_m` to the left. To the right, all is mirrored.
    fn reach_to_left(&self, ahead_m: f64, left_m: f64, yaw_rad: f64, bound_m: f64) -> bool {
        let Self { radius_m, within_m, .. } = *self;
        let (sin, cos) = yaw_rad.sin_cos();
        if (ahead_m + radius_m * sin).hypot(left_m - radius_m * cos) < radius_m - within_m {
            return false;
        }
        // From this angle on the robot turns back, and is parallel to the track at the bound.
        let cos_back = (1.0 + cos - bound_m / radius_m) / 2.0;
        if cos_back <= 0.0 || cos_back >= 1.0 || yaw_rad.abs() >= FRAC_PI_2 {
            return true;
        }
        let sin_back = (1.0 - cos_back * cos_back).sqrt();
        let back_m = radius_m * (sin_back - sin);
        let parallel_m = back_m + radius_m * sin_back;
        let is_on_way_back = (back_m..parallel_m).contains(&ahead_m);
        !is_on_way_back || (ahead_m - parallel_m).hypot(left_m - bound_m + radius_m) <= radius_m + within_m
    }
}

/// Radius of a steady turn at full lock and cruising velocity [m].
fn turning_radius(controller: &ControllerConfig) -> f64 {
    let velocity = controller.cruise_mps;
    let control = Control { velocity, steering: controller.vehicle.bounds.steering_max_rad };
    let (_, yaw_rate) = vehicle::model::steady_turn(&controller.vehicle.parameters(), &control);
    let radius_m = velocity / yaw_rate;
    // A robot that turns round by itself has no steady turn: its radius is negative.
    if radius_m > 0.0 { radius_m.min(STRAIGHT_M) } else { STRAIGHT_M }
}

/// Rounded up to three decimals.
pub(super) fn ceil(value: f64) -> f64 {
    (value * 1e3 - 1e-6).ceil() / 1e3
}

/// Rounded down to three decimals.
pub(super) fn floor(value: f64) -> f64 {
    (value * 1e3 + 1e-6).floor() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(start: [f64; 3], goal: [f64; 2]) -> Scenario {
        let [x_m, y_m, yaw_rad] = start;
        Scenario {
            start: Start { x_m, y_m, yaw_rad },
            goal: Goal { x_m: goal[0], y_m: goal[1], ..Goal::default() }.into(),
            ..Scenario::default()
        }
    }

    fn refused(start: [f64; 3], goal: [f64; 2]) -> Option<String> {
        require_goals(&scenario(start, goal), &ControllerConfig::default())
            .err()
            .map(|invalid| invalid.to_string())
    }

    #[test]
    fn a_goal_behind_or_beside_the_start_is_refused_and_one_at_the_start_is_not() {
        let behind = refused([6.0, 0.0, 0.0], [4.0, 0.0]).unwrap();
        assert!(behind.starts_with("goal.x_m = 4 is not allowed: above start.x_m = 6: "), "{behind}");
        assert!(refused([6.0, 0.0, 0.0], [6.0, 0.5]).is_some());
        assert_eq!(refused([6.0, 0.0, 0.0], [6.0, 0.0]), None);
        assert_eq!(refused([6.0, 0.0, 0.0], [6.1, 0.0]), None);
    }

    #[test]
    fn a_goal_inside_of_the_planned_turns_is_refused_with_the_nearest_one_that_is_not() {
        // From 0.1 m on, the circle to the left has its centre at y = 3.4 m and 3.4 m radius; 0.09 m of it are allowed.
        let radius = turning_radius(&ControllerConfig::default());
        assert!((radius - 3.1).abs() < 0.01, "{radius}");
        let planned = 1.04 / 0.95 * radius;
        let nearest = 0.1 + ((planned - 0.09_f64).powi(2) - (planned - 0.6).powi(2)).sqrt();
        let message = refused([0.0; 3], [nearest - 0.02, 0.6]).unwrap();
        assert!(
            message.contains("for goal.y_m = 0.6, as the smallest planned turn from start.x_m = 0, "),
            "{message}"
        );
        let named: f64 = message
            .split(&[' ', ','][..])
            .skip_while(|word| *word != "least")
            .nth(1)
            .unwrap()
            .parse()
            .unwrap();
        assert!((named - nearest).abs() < 0.011, "{message}");
        assert_eq!(refused([0.0; 3], [named, 0.6]), None);
        assert_eq!(refused([0.0; 3], [named, -0.6]), None);
    }

    /// What drives have missed by a little, and the nearest goals of the same y that they have reached.
    #[test]
    fn goals_that_drives_miss_are_refused_and_those_that_they_reach_well_are_not() {
        let missed = [
            [0.8, 0.2],
            [1.35, 0.4],
            [1.75, 0.6],
            [2.05, 0.8],
            [2.3, 1.0],
            [2.5, -1.2],
            [2.7, 1.3],
            [2.65, 1.4],
            [2.85, 1.4],
            [3.05, 1.4],
            [3.55, -1.5],
        ];
        for goal in missed {
            assert!(refused([0.0; 3], goal).is_some(), "{goal:?}");
        }
        let reached = [
            [0.95, 0.2],
            [1.5, 0.4],
            [1.9, 0.6],
            [2.25, 0.8],
            [2.45, -1.0],
            [2.8, 1.2],
            [3.3, 1.4],
            [3.65, 1.5],
        ];
        for goal in reached {
            assert_eq!(refused([0.0; 3], goal), None, "{goal:?}");
        }
    }

    #[test]
    fn a_heading_from_which_the_robot_leaves_the_track_is_refused() {
        assert_eq!(refused([0.0, 0.0, 0.9], [10.0, 0.0]), None);
        assert_eq!(refused([0.0, 0.0, -0.9], [10.0, 0.0]), None);
        // 3.1 m * 1.04 * (1 - cos 0.9) are 1.22 m; there are 0.55 m to the left.
        let off = refused([0.0, 1.0, 0.9], [10.0, 0.0]).unwrap();
        assert!(off.starts_with("start.yaw_rad = 0.9 is not allowed: at most 0.59"), "{off}");
        assert!(refused([0.0, 1.0, -0.9], [10.0, 0.0]).is_none());
        assert!(refused([0.0, 0.0, 3.0], [10.0, 0.0]).is_some());
        // On a wide track the robot turns round, where there is room behind the start too.
        let wide = |x_m: f64| {
            let mut controller = ControllerConfig::default();
            controller.track.y_m = [-8.0, 8.0];
            require_goals(&scenario([x_m, 0.0, 2.8], [15.0, 0.0]), &controller)
        };
        assert_eq!(wide(3.0), Ok(()));
        assert!(wide(1.0).is_err());
    }

    #[test]
    fn a_tolerance_that_is_finer_than_the_way_of_a_period_is_refused() {
        let of = |tolerance_m: f64, period_s: f64| {
            let goal = Goal { tolerance_m, ..Goal::default() };
            require_goals(
                &Scenario { goal: goal.into(), ..Scenario::default() },
                &ControllerConfig { period_s, ..ControllerConfig::default() },
            )
        };
        assert_eq!(of(0.01, 0.1), Ok(()));
        assert_eq!(of(0.1, 0.4), Ok(()));
        let refused = of(0.01, 0.4).unwrap_err().to_string();
        assert!(refused.starts_with("goal.tolerance_m = 0.01 is not allowed: at least 0.04, "), "{refused}");
        // The stop from 1 m/s takes 0.1 m.
        let from = |slowest_mps: f64| {
            let mut controller = ControllerConfig::default();
            controller.vehicle.bounds.velocity_min_mps = slowest_mps;
            require_goals(&Scenario::default(), &controller).map_err(|refused| refused.to_string())
        };
        assert_eq!(from(0.8), Ok(()));
        let refused = from(1.0).unwrap_err();
        assert!(refused.starts_with("goal.tolerance_m = 0.1 is not allowed: at least 0.125, "), "{refused}");
    }

    #[test]
    fn walls_leave_less_room_for_the_goal_than_the_track_has() {
        let mut controller = ControllerConfig::default();
        controller.track.walls = true;
        let of = |y_m: f64| require_goals(&scenario([0.0; 3], [10.0, y_m]), &controller);
        assert_eq!(of(1.1), Ok(()));
        let refused = of(1.3).unwrap_err().to_string();
        assert!(refused.starts_with("goal.y_m = 1.3 is not allowed: -1.1 to 1.1, "), "{refused}");
    }

    #[test]
    fn each_of_several_goals_is_reached_from_the_one_before_it() {
        let refused = |text: &str| {
            let scenario = Scenario::parse(text, "goals").unwrap();
            require_goals(&scenario, &ControllerConfig::default()).err().map(|invalid| invalid.to_string())
        };
        assert_eq!(refused("[[goal]]\nx_m = 5\n[[goal]]\nx_m = 9\ny_m = 0.5"), None);
        let behind = refused("[[goal]]\nx_m = 5\n[[goal]]\nx_m = 3").unwrap();
        assert!(
            behind.starts_with("goal[1].x_m = 3 is not allowed: above goal[0].x_m = 5: along a line"),
            "{behind}"
        );
        let near = refused("[[goal]]\nx_m = 5\n[[goal]]\nx_m = 6\ny_m = 1").unwrap();
        assert!(near.starts_with("goal[1].x_m = 6 is not allowed: at least 7."), "{near}");
        let fine = refused("[[goal]]\nx_m = 5\ntolerance_m = 0.01\n[[goal]]\nx_m = 9")
            .map(|text| text[..4].to_owned());
        assert_eq!(fine, None);
    }

    /// A course straight to x = 5 m and from there round a corner of `radius_m`.
    fn corner(radius_m: f64, more: &str) -> Scenario {
        let text = format!(
            "[course]\nwaypoints = [{{ yaw_rad = 0 }}, {{ x_m = 5, yaw_rad = 0 }}, \
             {{ x_m = {}, y_m = {radius_m}, yaw_rad = 1.5707963267948966 }}]\n{more}",
            5.0 + radius_m
        );
        Scenario::parse(&text, "corner").unwrap()
    }

    #[test]
    fn a_bend_that_is_sharper_than_a_planned_turn_is_refused_with_its_waypoint() {
        let controller = ControllerConfig::default();
        let smallest_m = turning_radius(&controller) / controller.curvature_share();
        assert!((smallest_m - 3.1 / 0.95).abs() < 0.01, "{smallest_m}");
        assert_eq!(require_goals(&corner(smallest_m + 0.01, ""), &controller), Ok(()));
        let message = require_goals(&corner(3.0, ""), &controller).unwrap_err().to_string();
        let expected = format!(
            "a bend with a radius of 3 m is not allowed: at least {} m, the smallest planned turn at \
             controller.cruise_mps = 1",
            ceil(smallest_m)
        );
        assert_eq!(message, format!("course.waypoints[1] = {expected}"));
    }

    #[test]
    fn a_goal_beside_a_course_that_no_turn_leads_to_is_refused_with_its_place() {
        let refused = |goal: &str| {
            let scenario = corner(4.0, goal);
            let controller =
                ControllerConfig { track: scenario.track_on_course(), ..ControllerConfig::default() };
            require_goals(&scenario, &controller).err().map(|refused| refused.to_string())
        };
        assert_eq!(refused("[goal]\nx_m = 4\ny_m = 1"), None);
        let message = refused("[goal]\nx_m = 1\ny_m = 1").unwrap();
        assert!(
            message.contains(
                "from start it is 1 m along and 1 m to the left, and the smallest planned turn has 3.39"
            ),
            "{message}"
        );
    }

    #[test]
    fn a_heading_counts_from_the_direction_of_the_course() {
        // Half way round the corner, in its direction and by 1.4 rad to its left.
        let controller = |scenario: &Scenario| ControllerConfig {
            track: scenario.track_on_course(),
            ..ControllerConfig::default()
        };
        for (yaw_rad, is_allowed) in [(0.785, true), (2.185, false), (-0.615, false)] {
            let start = format!("[start]\nx_m = 7.8284\ny_m = 1.1716\nyaw_rad = {yaw_rad}");
            let scenario = corner(4.0, &start);
            let refused = require_goals(&scenario, &controller(&scenario)).err();
            assert_eq!(refused.is_none(), is_allowed, "{yaw_rad}: {refused:?}");
            assert!(
                refused
                    .is_none_or(|refused| refused.to_string().contains("from the direction of the course"))
            );
        }
    }
}
