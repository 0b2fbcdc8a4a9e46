//! Bodies that move are not met, and sides are passed from which the robot gets to its goal.

use emulator::Outcome;
use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A cart, 0.6 by 1 m, that crosses the track at `x_m` from outside of it; `side` is 1 from the right, -1 from the left.
fn cart(x_m: f64, side: f64, speed_mps: f64) -> String {
    let (y_m, velocity_mps) = (-2.6 * side, speed_mps * side);
    format!(
        "[[obstacle]]\nshape = \"box\"\nx_m = {x_m:?}\ny_m = {y_m:?}\nlength_m = 0.6\nwidth_m = 1.0\n\
         velocity_y_mps = {velocity_mps:?}\nappears_s = 0.0\n"
    )
}

/// With 0.5 m/s a cart struck the robot in nine of these places, before one end showed its motion.
#[test]
fn a_cart_that_is_visible_from_the_start_is_waited_for_or_passed() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("cart.toml");
    let places = [3.0, 3.5, 4.0, 4.5, 5.0, 5.5].into_iter().flat_map(|x_m| [(x_m, 1.0), (x_m, -1.0)]);
    for (index, (x_m, side)) in places.enumerate() {
        let (speed_mps, preset) = ([0.5, 0.5, 0.5, 0.7][index % 4], ["ideal", "summit", "worn"][index % 3]);
        std::fs::write(&file, cart(x_m, side, speed_mps)).unwrap();
        let preset = format!("robot.preset={preset}");
        let report = system.lockstep(&["cart.toml", "--set", &preset]);
        let truth = report.drive.truth.unwrap();
        let drive = format!("x {x_m} side {side} {preset}: {}, {truth:?}", report.reason);
        assert!(!truth.collided && !truth.struck && truth.min_clearance_m > 0.0, "{drive}");
        assert_eq!(report.outcome, Outcome::Reached, "{drive}");
    }
}

/// A box on the line, and a thin post behind it that comes into view when the robot is already beside the line.
#[test]
fn a_side_from_which_the_goal_is_reached_is_taken() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("post.toml");
    for (side, box_y_m, goal_x_m, seed) in
        [(1.0, -0.15, 8.7, "2"), (-1.0, -0.15, 8.7, "3"), (1.0, -0.1, 8.7, "1"), (1.0, -0.15, 8.7, "7")]
    {
        let text = format!(
            "[goal]\nx_m = {goal_x_m:?}\n[robot]\npreset = \"summit\"\n\
             [[obstacle]]\nshape = \"box\"\nx_m = 5.0\ny_m = {:?}\nlength_m = 0.1\nwidth_m = 0.75\n\
             [[obstacle]]\nshape = \"circle\"\nx_m = 7.1\ny_m = {:?}\nradius_m = 0.02\n",
            box_y_m * side,
            0.67 * side
        );
        std::fs::write(&file, text).unwrap();
        let report = system.lockstep(&["post.toml", "--seed", seed]);
        let truth = report.drive.truth.unwrap();
        assert_eq!(report.outcome, Outcome::Reached, "{side} {box_y_m} {goal_x_m}: {}", report.reason);
        assert!(truth.min_clearance_m >= 0.05, "{side} {box_y_m} {goal_x_m}: {truth:?}");
    }
}

/// Circles that cross 5 cm behind a box, which was then described with them to the end of the run; carts beside posts;
/// bodies past which a robot crept to the bound of the track, or from which it drove back, before they went; and gates between
/// posts, which were one body with them: nothing that the scanner reaches is behind.
#[test]
fn a_robot_drives_on_when_what_was_beside_a_body_at_rest_has_gone() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("left.toml");
    let box_of = |[x_m, y_m, length_m, width_m]: [f64; 4], more: &str| {
        format!(
            "[[obstacle]]\nshape = \"box\"\nx_m = {x_m:?}\ny_m = {y_m:?}\nlength_m = {length_m:?}\n\
             width_m = {width_m:?}\n{more}"
        )
    };
    let behind = |side: f64, speed_mps: f64| {
        let circle = format!(
            "[[obstacle]]\nshape = \"circle\"\nx_m = 6.03\ny_m = {:?}\nradius_m = 0.3\nvelocity_y_mps = {:?}\n\
             appears_s = 0.6\n",
            1.8 * side,
            -speed_mps * side
        );
        box_of([5.0, 0.82 * side, 1.36, 0.6], "") + &circle
    };
    let goes = |place: [f64; 4], at_s: f64| {
        "[track]\nsurroundings = \"open\"\n".to_owned()
            + &box_of(place, &format!("appears_s = 2.0\ndisappears_s = {at_s:?}\n"))
    };
    let gate = |surroundings: &str, x_m: f64, width_m: f64, posts: &[f64], speed_mps: f64| {
        let place = [x_m, 0.0, 0.1, width_m];
        let opens = format!("appears_s = 7.0\nvelocity_y_mps = {speed_mps:?}\ndisappears_s = 17.0\n");
        let post = |side: &f64| {
            let y_m = side * (width_m / 2.0 + 0.08);
            format!("[[obstacle]]\nshape = \"circle\"\nx_m = {x_m:?}\ny_m = {y_m:?}\nradius_m = 0.06\n")
        };
        format!("[track]\nsurroundings = \"{surroundings}\"\n[goal]\nx_m = 8.5\n")
            + &box_of(place, "disappears_s = 7.0\n")
            + &if speed_mps == 0.0 { String::new() } else { box_of(place, &opens) }
            + &posts.iter().map(post).collect::<String>()
    };
    for (name, text, rate) in [
        ("a gate that is gone, one post", gate("hall", 3.0, 2.2, &[-1.0], 0.0), "5"),
        ("a gate that is gone, two posts", gate("hall", 3.0, 3.0, &[-1.0, 1.0], 0.0), "20"),
        ("a gate in the open, one post", gate("open", 4.5, 2.2, &[1.0], 0.0), "10"),
        ("a gate in the open, two posts", gate("open", 4.5, 3.0, &[-1.0, 1.0], 0.0), "10"),
        ("a gate that slides", gate("hall", 3.0, 3.0, &[-1.0], 0.4), "10"),
        ("a gate that slides away fast", gate("open", 4.5, 2.2, &[-1.0, 1.0], 1.0), "10"),
        ("behind, from the left", behind(1.0, 0.5), "10"),
        ("behind, from the right", behind(-1.0, 0.5), "20"),
        ("behind, faster", behind(1.0, 0.7), "5"),
        ("wide, in open surroundings", goes([4.3065, 0.2979, 0.6, 1.6], 11.5), "10"),
        ("wide, to the other side", goes([4.3065, -0.2979, 0.6, 1.6], 12.5), "20"),
        ("across, gone while the robot is back", goes([5.016, 0.139, 0.477, 1.928], 9.6), "10"),
        ("across, to the other side", goes([5.016, -0.139, 0.477, 1.928], 11.5), "20"),
    ] {
        std::fs::write(&file, "timeout_s = 150.0\nstop_final_s = 40.0\n".to_owned() + &text).unwrap();
        let report = system.lockstep(&["left.toml", "--set", &format!("rate_hz={rate}")]);
        let truth = report.drive.truth.unwrap();
        let drive = format!("{name}: {}, {truth:?}", report.reason);
        assert!(!truth.collided && !truth.struck && truth.min_clearance_m > 0.0, "{drive}");
        assert_eq!(report.outcome, Outcome::Reached, "{drive}");
    }
}

/// Bodies that pass slowly before one at rest, and out of the sensor's watch: what they showed contradicted the motion of the
/// robot, which stood for ever, as the body at rest stayed in view.
#[test]
fn a_body_that_went_past_another_one_in_the_open_contradicts_nothing() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("passes.toml");
    let scene = |rest: [f64; 4], more: &str| {
        let [x_m, y_m, length_m, width_m] = rest;
        format!(
            "[goal]\nx_m = 11.0\n[track]\nsurroundings = \"open\"\n\
             [[obstacle]]\nshape = \"box\"\nx_m = {x_m:?}\ny_m = {y_m:?}\nlength_m = {length_m:?}\n\
             width_m = {width_m:?}\n[[obstacle]]\n{more}"
        )
    };
    let circle = scene(
        [5.0, 0.82, 1.36, 0.6],
        "shape = \"circle\"\nx_m = 3.97\ny_m = 1.8\nradius_m = 0.3\nvelocity_y_mps = -0.25\nappears_s = 0.6\n",
    );
    let cart = scene(
        [5.5, -0.6, 0.4, 0.5],
        "shape = \"box\"\nx_m = 4.85\ny_m = -2.0\nlength_m = 0.8\nwidth_m = 0.5\nvelocity_y_mps = 0.5\n\
         appears_s = 0.0\n",
    );
    for (text, rate, preset) in [
        (&circle, "10", "ideal"),
        (&circle, "20", "summit"),
        (&circle, "50", "worn"),
        (&cart, "10", "summit"),
        (&cart, "20", "worn"),
        (&cart, "50", "ideal"),
    ] {
        std::fs::write(&file, text).unwrap();
        let (rate, preset) = (format!("rate_hz={rate}"), format!("robot.preset={preset}"));
        let report = system.lockstep(&["passes.toml", "--set", &rate, "--set", &preset]);
        let truth = report.drive.truth.unwrap();
        let drive = format!("{rate} {preset}: {}, {truth:?}", report.reason);
        assert!(!truth.collided && !truth.struck && truth.min_clearance_m > 0.0, "{drive}");
        assert_eq!(report.outcome, Outcome::Reached, "{drive}");
    }
}
