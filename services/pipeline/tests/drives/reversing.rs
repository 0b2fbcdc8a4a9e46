//! Backwards: where a body has moved behind the robot, out from before what appeared, and to a goal that was passed.

use emulator::Outcome;
use emulator::scenario::Preset;
use pipeline::PipelineSettings;

use crate::{End, end, parse};

/// Backwards into a place; a body moves towards it, and the robot passes that on its way.
fn parks(body_mps: Option<f64>, preset: Preset) -> End {
    let body = body_mps.map_or_else(String::new, |speed| {
        format!(
            "[[obstacle]]\nshape = \"box\"\nx_m = 9.0\ny_m = -1.2\nlength_m = 0.3\nwidth_m = 0.3\n\
             velocity_x_mps = -{speed}\n"
        )
    });
    let mut scenario = parse(&format!(
        "name = \"parks\"\n[course]\nwidth_m = 2.0\nwaypoints = [\n\
         {{ x_m = 0.0, y_m = 0.0, yaw_rad = 0.0 }},\n\
         {{ x_m = 8.87, y_m = 0.0, yaw_rad = 0.0 }},\n\
         {{ x_m = 6.936, y_m = -0.5, yaw_rad = 0.5054, reverse = true }},\n\
         {{ x_m = 5.0, y_m = -1.0, yaw_rad = 0.0, reverse = true }},\n]\n[goal]\nyaw_rad = 0.0\n{body}"
    ));
    scenario.robot.preset = preset;
    end(&PipelineSettings::of(scenario))
}

#[test]
fn a_place_that_a_body_was_seen_to_move_towards_is_not_backed_into() {
    for preset in [Preset::Ideal, Preset::Summit] {
        assert_eq!(parks(None, preset).outcome, Outcome::Reached, "{preset:?}");
        // Driven on, those with 0.14 and 0.16 m/s are touched on the way, and that with 0.12 m/s touches the robot in its place.
        for speed in [0.12, 0.14, 0.16, 0.25] {
            let end = parks(Some(speed), preset);
            assert_eq!(end.outcome, Outcome::Stopped, "{preset:?} {speed} {end:?}");
            assert!(end.reason.contains("unseen") && end.is_untouched(), "{preset:?} {speed} {end:?}");
        }
    }
}

#[test]
fn what_appears_too_near_to_turn_away_is_passed_after_driving_back() {
    for preset in [Preset::Ideal, Preset::Summit] {
        for ahead in ["1.2", "1.6", "2.0"] {
            let mut scenario = parse(&format!(
                "name = \"post\"\n[goal]\nx_m = 12.0\n[[obstacle]]\nshape = \"circle\"\nx_m = 6.0\ny_m = 0.0\n\
                 radius_m = 0.1\nappears_ahead_m = {ahead}\n"
            ));
            scenario.robot.preset = preset;
            let end = end(&PipelineSettings::of(scenario));
            assert_eq!(end.outcome, Outcome::Reached, "{preset:?} {ahead}: {end:?}");
            assert!(end.clearance_m > 0.15, "{preset:?} {ahead}: {end:?}");
        }
    }
}

#[test]
fn a_goal_close_behind_a_wide_box_is_come_back_to_from_behind() {
    for (goal_m, width_m) in [("9.0", "1.0"), ("9.5", "1.6"), ("10.0", "1.0"), ("10.0", "1.6")] {
        let scenario = parse(&format!(
            "name = \"wide\"\n[goal]\nx_m = {goal_m}\n[[obstacle]]\nshape = \"box\"\nx_m = 8.0\ny_m = 0.1\nlength_m = 0.1\n\
             width_m = {width_m}\n"
        ));
        let end = end(&PipelineSettings::of(scenario));
        assert_eq!(end.outcome, Outcome::Reached, "{goal_m} {width_m}: {end:?}");
        assert!(end.goal_m < 0.05 && end.clearance_m > 0.1, "{goal_m} {width_m}: {end:?}");
    }
}
