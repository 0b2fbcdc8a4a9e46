use super::bodies::SUDDEN_M;
use super::*;
use crate::judge::{Judge, Limits};
use emulator::Scenario;
use vehicle::bounds::STEERING_MAX_RAD;

fn courses(family: Hostile, count: u64) -> Vec<HostileCourse> {
    (0..count).map(|seed| hostile(family, seed)).collect()
}

#[test]
fn every_course_is_valid_and_its_file_reads_back() {
    for family in Hostile::ALL.iter().copied() {
        for course in courses(family, 300) {
            let scenario = course.scenario;
            assert_eq!(scenario.validate(), Ok(()), "{}", scenario.name);
            assert_eq!(Scenario::parse(&scenario.to_toml(), "written").unwrap(), scenario);
            assert_eq!(
                course.gap_m.is_some(),
                matches!(family, Hostile::Width | Hostile::Gap | Hostile::Walls)
            );
        }
    }
    assert_eq!(hostile(Hostile::Clutter, 7), hostile(Hostile::Clutter, 7));
    assert_ne!(hostile(Hostile::Clutter, 7), hostile(Hostile::Clutter, 8));
}

#[test]
fn most_courses_can_be_driven_and_closed_ones_cannot() {
    for family in Hostile::ALL.iter().copied() {
        let courses = courses(family, 25);
        let is_passable = |course: &&HostileCourse| {
            let margin_m = 0.25;
            Judge::passable(
                &course.scenario,
                &Limits { margin_m, ..Limits::of(&course.scenario, STEERING_MAX_RAD) },
            )
        };
        let passable = courses.iter().filter(is_passable).count();
        println!("{family}: {passable} of {} are passable", courses.len());
        let expected = if family == Hostile::Closed { 0..=0 } else { 15..=25 };
        assert!(expected.contains(&passable), "{family}: {passable}");
    }
}

#[test]
fn families_have_what_their_names_promise() {
    let clutter = hostile(Hostile::Clutter, 1).scenario;
    assert_eq!(clutter.obstacles.len(), 10);
    for family in [Hostile::Crossing, Hostile::HeadOn, Hostile::Overtaking] {
        for course in courses(family, 100) {
            let movers: Vec<_> =
                course.scenario.obstacles.iter().filter(|obstacle| obstacle.moves()).collect();
            let speed = movers[0].velocity_x_mps.hypot(movers[0].velocity_y_mps);
            assert!(movers.len() == 1 && (0.08..0.54).contains(&speed), "{family}: {speed}");
        }
    }
    for course in courses(Hostile::Appearing, 100) {
        let ahead = course.scenario.obstacles.iter().filter_map(|obstacle| obstacle.appears_ahead_m);
        assert!(ahead.clone().all(|ahead_m| ahead_m >= SUDDEN_M));
    }
    let widths = courses(Hostile::Gap, 300).into_iter().filter_map(|course| course.gap_m);
    let (low, high) = widths.fold((f64::INFINITY, 0.0_f64), |(low, high), gap| (low.min(gap), high.max(gap)));
    assert!(low < 0.65 && high > 1.9, "{low} to {high}");
}
