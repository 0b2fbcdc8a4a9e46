//! What held the robot up in a drive is over when its cause has gone, through the executable.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use emulator::Outcome;
use report::Report;
use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// The report of a drive of this scenario.
fn drive(system: &TestSystem, text: &str, keys: &[&str]) -> Report {
    let file = system.folder().join("scene.toml");
    std::fs::write(&file, text).unwrap();
    let mut arguments = vec![file.to_str().unwrap()];
    keys.iter().for_each(|key| arguments.extend(["--set", key]));
    let report = system.lockstep(&arguments);
    assert_eq!(report.outcome, Outcome::Reached, "{keys:?}: {}", report.reason);
    assert!(report.drive.truth.unwrap().min_clearance_m > 0.0, "{keys:?}");
    report
}

#[test]
fn a_cart_that_crossed_the_way_is_waited_for_and_forgotten() {
    let system = TestSystem::new(EXECUTABLE);
    let cart = "name = \"cart\"\n[[obstacle]]\nshape = \"box\"\nx_m = 5.0\ny_m = -1.0\nlength_m = 0.6\n\
                width_m = 1.0\nvelocity_y_mps = 0.5\nappears_s = 1.0\n";
    for surroundings in ["track.surroundings='hall'", "track.surroundings='open'"] {
        for rate in ["rate_hz=5", "rate_hz=10"] {
            drive(&system, cart, &[surroundings, rate]);
        }
    }
    system.assert_nothing_left();
}

#[test]
fn a_corner_of_a_room_and_boxes_that_overlap_are_driven_past() {
    let system = TestSystem::new(EXECUTABLE);
    let corner = "name = \"corner\"\n[goal]\nx_m = 11.0\n[[obstacle]]\nshape = \"box\"\nx_m = 10.0\ny_m = -1.2\n\
                  length_m = 12.0\nwidth_m = 0.1\n[[obstacle]]\nshape = \"box\"\nx_m = 16.0\ny_m = -0.2\n\
                  length_m = 0.1\nwidth_m = 2.1\n";
    let report = drive(&system, corner, &[]);
    assert!(report.drive.truth.unwrap().min_clearance_m > 0.9, "the wall is 0.95 m beside the robot");
    let overlapping = "name = \"overlapping\"\n[[obstacle]]\nshape = \"box\"\nx_m = 5.636\ny_m = -0.321\n\
                       length_m = 0.775\nwidth_m = 0.446\n[[obstacle]]\nshape = \"circle\"\nx_m = 5.571\n\
                       y_m = -0.021\nradius_m = 0.332\n";
    for preset in ["robot.preset='ideal'", "robot.preset='summit'"] {
        drive(&system, overlapping, &[preset]);
    }
    system.assert_nothing_left();
}

/// The robot stopped before both and stood to the end of the run: the scanner was thought to be degraded.
#[test]
fn a_cart_behind_a_box_is_waited_for_and_forgotten() {
    let system = TestSystem::new(EXECUTABLE);
    let scene = "name = \"behind\"\n[goal]\nx_m = 12.0\n[[obstacle]]\nshape = \"box\"\nx_m = 8.48\ny_m = -0.27\n\
                 length_m = 0.22\nwidth_m = 0.27\n[[obstacle]]\nshape = \"box\"\nx_m = 9.9\ny_m = -1.93\n\
                 length_m = 0.52\nwidth_m = 0.3\nvelocity_y_mps = 0.2\n";
    for (preset, seed) in [("ideal", 1), ("summit", 2), ("summit", 5)] {
        drive(&system, scene, &[&format!("robot.preset='{preset}'"), &format!("seed={seed}")]);
    }
    system.assert_nothing_left();
}
