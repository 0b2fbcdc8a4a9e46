//! The drive with the least J over the same course.
//!
//! # What it is compared with
//! It starts from the state of the first drive command and ends at the same place as the measured part of the drive.
//! It has the model, the bounds, the ellipses and the margin of the controller. Controls change every 0.1 s; nodes,
//! and with them the ellipses, are as far apart.
//!
//! # What it knows
//! What the robot knew: an ellipse counts from the node on at which it was first described in the drive. The optimum
//! may be ahead of the drive or behind it, so that node is the first one that is as late, or as far along the track,
//! as the drive was then. The optimum plans to the end with the ellipses known at the start, follows this plan to the
//! next first sight, plans again from its own state there, and so on. So a body is passed on the side that is best by
//! what is known, and its last description is known from the first sight on.
//!
//! # Sides
//! Each plan is the best of the solutions for all combinations of passing sides, at most 2^5; a moving body is tried
//! at several speeds as well. What is best by what is known may turn out bad behind the next obstacle, and a drive
//! may have been lucky. So the sides of the drive are tried once more as a whole, and the better result counts. A
//! solution counts with a slack of 1e-6 and a scaled KKT residual of 1e-3 at most.
//!
//! # The end
//! The time that the optimum takes is a result. Each plan is solved for a duration; the last interval is then
//! lengthened or shortened by the distance that is missing to the end, until none is. This is the least J as far as
//! arriving later costs more; with a free duration CasADi found 1.2e-4 less at most, where a body crosses. Horizons
//! have 200 intervals at most. A plan over a longer way ends earlier, with the weights of the end there, and is
//! renewed after 5 s: what is known lies a few metres ahead.

mod course;
mod ellipse;
mod guess;
mod plan;
mod sides;
mod sightings;

use ocp::Trajectory;
use vehicle::State;

use course::From;
use ellipse::Ellipse;
use plan::{best_plan, solver};
use report::ride::measure;
use report::ride::{Issued, RideMoment, RideTrace};
use sides::Sides;

pub(crate) use course::Course;
pub(crate) use plan::{NoOptimum, Plan};
pub(crate) use sightings::Sightings;

/// Number of intervals after which a plan that ends before the course is renewed.
const RENEWED_INTERVALS: usize = 50;
/// Maximum number of plans, for a course that leads nowhere.
const MAX_PLANS: usize = 100;

/// The optimum of a course.
#[derive(Debug, Clone)]
pub(crate) struct Optimum {
    /// What is driven; clearances are not known here.
    pub drive: RideTrace,
    /// The plans, in the order in which they were followed.
    pub plans: Vec<Plan>,
}

/// The optimum of a course.
///
/// # Errors
/// [`NoOptimum`] when there is no solution without slack from some state on.
pub(crate) fn optimum(course: &Course) -> Result<Optimum, NoOptimum> {
    let objective =
        |optimum: &Optimum| measure(&optimum.drive, &course.goal).map(|figures| figures.objective);
    let (best, taken) = (with(course, Sides::Both), with(course, Sides::Taken));
    match (&best, &taken) {
        (Ok(one), Ok(other)) if objective(other) >= objective(one) => best,
        (Ok(_), Err(_)) => best,
        (Err(_), Err(_)) => best,
        _ => taken,
    }
}

/// The optimum when these sides are tried.
fn with(course: &Course, tried: Sides) -> Result<Optimum, NoOptimum> {
    let mut solver = solver();
    let mut from = From { time_s: course.start_s, state: course.start, previous: None };
    let mut optimum = Optimum { drive: RideTrace::default(), plans: Vec::new() };
    optimum.drive.moments.push(moment(from.time_s, from.state, 0.0));
    while optimum.plans.len() < MAX_PLANS {
        let known = known(course, &from);
        let plan = best_plan(&mut solver, course, &from, &known, tried)?;
        let followed = follow(course, &from, &known, &plan, &mut optimum.drive);
        optimum.plans.push(plan);
        let Some(next) = followed else { return Ok(optimum) };
        from = next;
    }
    Err(NoOptimum { combinations: 0 })
}

/// The ellipses that are known, without standing ones that are behind.
fn known<'a>(course: &'a Course, from: &From) -> Vec<&'a Ellipse> {
    let State { x, .. } = from.state;
    let counts = |ellipse: &&Ellipse| {
        let ahead = ellipse.moves() || ellipse.centre_at(from.time_s)[0] + ellipse.a > x;
        ellipse.is_known(from.time_s, x) && ahead
    };
    course.ellipses.iter().filter(counts).collect()
}

/// Follows a plan until an ellipse is seen that it does not know, or to its end; the start of the next plan.
fn follow(
    course: &Course,
    from: &From,
    known: &[&Ellipse],
    plan: &Plan,
    drive: &mut RideTrace,
) -> Option<From> {
    let Trajectory { states, controls } = &plan.trajectory;
    let intervals = &plan.problem.intervals;
    // A plan that ends before the course is renewed.
    let renewed = if plan.is_whole { usize::MAX } else { RENEWED_INTERVALS };
    let mut time_s = from.time_s;
    for (index, (control, state)) in controls.iter().zip(&states[1..]).enumerate() {
        drive.commands.push(Issued { time_s, control: *control });
        time_s += intervals[index];
        drive.moments.push(moment(time_s, *state, control.velocity));
        let is_new = |ellipse: &Ellipse| {
            ellipse.is_known(time_s, state.x)
                && !ellipse.is_known(from.time_s, from.state.x)
                && !known.contains(&ellipse)
        };
        let rest = index + 1 < controls.len();
        if rest && (course.ellipses.iter().any(is_new) || index + 1 >= renewed) {
            return Some(From { time_s, state: *state, previous: Some(*control) });
        }
    }
    None
}

fn moment(time_s: f64, state: State, speed_mps: f64) -> RideMoment {
    RideMoment { time_s, state, way_rad: 0.0, speed_mps, clearance_m: f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use vehicle::{Bounds, Goal, Parameters};

    use super::*;
    use ellipse::{Ellipse, Path};
    use report::ride::RideFigures;

    fn course(goal_x_m: f64, ellipses: Vec<Ellipse>) -> Course {
        Course {
            parameters: Parameters::default(),
            bounds: Bounds::default(),
            x_range: [0.0, 1000.0],
            y_range: [-1.5, 1.5],
            goal: Goal { x_m: goal_x_m, ..Goal::default() },
            start_s: 0.1,
            start: State::default(),
            ellipses,
        }
    }

    fn ellipse(x: f64, y: f64, known_x_m: f64) -> Ellipse {
        let known_s = 0.1 + known_x_m;
        let path = Path::Fixed([x, y]);
        Ellipse { body: x as u32, a: 1.36, b: 0.66, passed_left: false, path, known_s, known_x_m }
    }

    fn solved(course: &Course) -> (Optimum, RideFigures) {
        let optimum = optimum(course).unwrap();
        let figures = measure(&optimum.drive, &course.goal).unwrap();
        (optimum, figures)
    }

    /// Largest value by which a node is inside of the ellipses of a course.
    fn entered(course: &Course, optimum: &Optimum) -> f64 {
        let inside = |moment: &RideMoment, ellipse: &Ellipse| {
            let [x, y] = ellipse.centre_at(moment.time_s);
            1.0 - ((moment.state.x - x) / ellipse.a).powi(2) - ((moment.state.y - y) / ellipse.b).powi(2)
        };
        let values = optimum.drive.moments.iter();
        values
            .flat_map(|moment| course.ellipses.iter().map(move |ellipse| inside(moment, ellipse)))
            .fold(-1.0, f64::max)
    }

    #[test]
    fn an_empty_track_from_the_line_costs_nothing() {
        let (optimum, figures) = solved(&course(10.0, Vec::new()));
        assert!(figures.objective < 1e-12 && (figures.time_s - 8.25).abs() < 1e-5, "{figures:?}");
        assert_eq!(optimum.plans.len(), 1);
    }

    #[test]
    fn the_objective_of_a_plan_is_that_of_the_measure() {
        let mut beside = course(10.0, Vec::new());
        beside.start.y = 0.3;
        let (optimum, figures) = solved(&beside);
        // The measure counts half an interval at the start, which no plan can change.
        let start = 8.0 * 0.09 * 0.05;
        let objective = optimum.plans[0].objective + start;
        assert!((figures.objective / objective - 1.0).abs() < 1e-4, "{} {objective}", figures.objective);
        // About as much as the offset costs in a second.
        assert!((figures.objective - 8.0 * 0.09).abs() < 0.1, "{figures:?}");
    }

    #[test]
    fn a_plan_counts_its_end_as_the_measure_does() {
        let mut short = course(2.75, Vec::new());
        short.start.y = 0.3;
        let (optimum, figures) = solved(&short);
        assert!(optimum.drive.moments.last().unwrap().state.y > 0.1, "the end is beside the line");
        let objective = optimum.plans[0].objective + 8.0 * 0.09 * 0.05;
        // The last interval is shorter than the one that the weights of its first node are for.
        assert!((figures.objective / objective - 1.0).abs() < 5e-3, "{} {objective}", figures.objective);
    }

    #[test]
    fn no_other_controls_cost_less() {
        let mut beside = course(4.0, Vec::new());
        beside.start.y = 0.1;
        let (optimum, figures) = solved(&beside);
        let parameters = beside.parameters;
        for (index, steering) in [(0, 1e-3), (5, 1e-3), (5, -1e-3), (12, 1e-3), (20, -1e-3)] {
            let mut controls = optimum.plans[0].trajectory.controls.clone();
            controls[index].steering += steering;
            let mut drive = RideTrace {
                moments: vec![optimum.drive.moments[0]],
                commands: optimum.drive.commands.clone(),
            };
            for (issued, (control, moment)) in
                drive.commands.iter_mut().zip(controls.iter().zip(&optimum.drive.moments[1..]))
            {
                issued.control = *control;
                let last = drive.moments[drive.moments.len() - 1];
                let duration = moment.time_s - last.time_s;
                let state = vehicle::integrate::integrate(&parameters, &last.state, control, duration + 1e-5);
                drive.moments.push(RideMoment { state, ..*moment });
            }
            let other = measure(&drive, &beside.goal).unwrap();
            assert!(other.objective > figures.objective, "{index} {steering} {other:?} {figures:?}");
        }
    }

    #[test]
    fn an_obstacle_is_passed_outside_of_its_ellipse_on_the_shorter_side() {
        let left = course(10.0, vec![ellipse(5.0, -0.1, 0.0)]);
        let (optimum, figures) = solved(&left);
        assert!(entered(&left, &optimum) < 1e-6);
        let highest = optimum.drive.moments.iter().map(|moment| moment.state.y).fold(0.0, f64::max);
        assert!((highest - 0.56).abs() < 0.02, "{highest}");
        let right = course(10.0, vec![ellipse(5.0, 0.1, 0.0)]);
        let mirrored = solved(&right).1;
        assert!((mirrored.objective / figures.objective - 1.0).abs() < 1e-4, "{mirrored:?} {figures:?}");
    }

    #[test]
    fn an_obstacle_that_is_seen_late_costs_more() {
        let early = solved(&course(12.0, vec![ellipse(6.0, 0.2, 0.0)])).1;
        let (optimum, late) = solved(&course(12.0, vec![ellipse(6.0, 0.2, 2.5)]));
        assert_eq!(optimum.plans.len(), 2);
        assert!((optimum.plans[1].problem.initial.x - 2.5).abs() < 0.051);
        assert!(late.objective > early.objective, "{late:?} {early:?}");
        // At once next to it, there is no way round.
        assert!(super::optimum(&course(12.0, vec![ellipse(6.0, 0.2, 4.4)])).is_err());
    }

    #[test]
    fn a_lucky_side_of_the_drive_is_tried_too() {
        // Left of the first is a little shorter; right of it leads better to the second, which is seen only beside
        // the first.
        let lucky = |passed_left: bool| {
            let first = Ellipse { passed_left, ..ellipse(5.0, -0.02, 0.0) };
            solved(&course(16.0, vec![first, ellipse(8.0, 0.35, 4.0)])).1.objective
        };
        assert!(lucky(false) < lucky(true), "{} {}", lucky(false), lucky(true));
    }

    #[test]
    fn a_body_that_crosses_is_met_where_it_is_then() {
        let mut crossing = ellipse(5.0, 0.0, 0.0);
        // It has left the line when the robot arrives, and stood on it before.
        crossing.path =
            Path::Recorded(vec![(0.0, [5.0, 0.0]), (3.0, [5.0, 0.0]), (4.0, [5.0, 1.2])], [0.0, 0.0]);
        let (optimum, figures) = solved(&course(10.0, vec![crossing.clone()]));
        assert!(figures.objective < 0.2, "{figures:?}");
        assert!(entered(&course(10.0, vec![crossing]), &optimum) < 1e-6);
    }

    #[test]
    fn a_course_beyond_the_longest_horizon_is_planned_again() {
        let (optimum, figures) = solved(&course(30.0, vec![ellipse(5.0, 0.1, 0.0)]));
        let short = solved(&course(12.0, vec![ellipse(5.0, 0.1, 0.0)])).1;
        assert!(optimum.plans.len() > 1 && figures.time_s > 28.0);
        // What is behind the obstacle costs the delay alone.
        let delay = figures.time_s - 28.25;
        let more = figures.objective - short.objective - delay * delay * 18.0;
        assert!(more.abs() < 0.05 * short.objective, "{more} {figures:?} {short:?}");
    }

    #[test]
    fn controls_reach_their_bounds_and_stay_within_them() {
        let (optimum, _) = solved(&course(10.0, vec![ellipse(5.0, 0.0, 2.0)]));
        let controls = || optimum.drive.commands.iter().map(|issued| issued.control);
        assert!(controls().all(|control| Bounds::default().contains(control, 1e-9)));
        assert!(controls().any(|control| control.steering > 0.06 - 1e-9), "the largest curvature is needed");
    }
}
