//! A file has only what differs, a refusal names what was written and where, and a name that is nearly right is guessed.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::process::Command;

use emulator::Outcome;
use scanloop_tests::{TestSystem, printed};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// The message of a command that is refused.
fn refusal(system: &TestSystem, arguments: &[&str]) -> String {
    let output = system.run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    message
}

#[test]
fn a_part_of_a_system_file_drives() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("system.toml");
    for text in [
        "[vehicle]\nwidth_m = 0.45\nlength_m = 0.6\nmass_kg = 15.0\nsudden_m = 1.0\n",
        "[vehicle.bounds]\nvelocity_max_mps = 0.8\n",
        "[[process]]\nrole = \"controller\"\ngrace_ms = 700\n",
        "[[process]]\nrole = \"estimator\"\nimplementation = \"ekf\"\n[[process]]\nrole = \"companion\"\nname = \"idle\"\n\
         command = [\"sleep\", \"60\"]\nlockstep = false\n",
    ] {
        std::fs::write(&file, text).unwrap();
        assert_eq!(system.run(&["check", "--system", "system.toml"]).status.code(), Some(0), "{text}");
        if text.contains("companion") {
            continue;
        }
        let report = system.lockstep(&["free", "--system", "system.toml", "--set", "goal.x_m=3"]);
        assert_eq!(report.outcome, Outcome::Reached, "{text}: {}", report.reason);
    }
    system.assert_nothing_left();
}

#[test]
fn a_refusal_names_what_was_written_and_where() {
    let system = TestSystem::new(EXECUTABLE);
    let write = |name: &str, text: &str| std::fs::write(system.folder().join(name), text).unwrap();
    write("system.toml", "rate_hz = 20.0\n\n[vehicle.bounds]\nsteering_max_rad = 0.3\n");
    write("course.toml", "[goal]\nx_m = 8.0\ntolerance_m = 7.0\n");
    write("mixed.toml", "seed = 1\n[vehicle]\nwidth_m = 0.5\n");
    let steering = "vehicle.bounds.steering_max_rad = 0.3 is not allowed: 0.001 to 0.12, as `sent_steering_max_rad` is 0.12\n";
    for (arguments, expected) in [
        (
            &["--set", "vehicle.bounds.steering_max_rad=0.3"][..],
            format!("error: --set vehicle.bounds.steering_max_rad=0.3: {steering}"),
        ),
        (&["--system", "system.toml"], format!("error: system.toml: line 4: {steering}")),
        (
            &["course.toml"],
            "error: course.toml: line 3: goal.tolerance_m = 7 is not allowed: 0.01 to 1\n".to_owned(),
        ),
        (
            &["--set", "track.x_m=[0, 5]"],
            "error: --set track.x_m=[0, 5] is not allowed with goal.x_m = 10, for which is allowed: "
                .to_owned(),
        ),
        (&["mixed.toml"], "error: mixed.toml: line 2: vehicle is not allowed here: ".to_owned()),
    ] {
        let message = refusal(&system, &[&["run"], arguments].concat());
        assert!(message.starts_with(&expected), "{arguments:?}: {message}");
    }
}

#[test]
fn a_name_that_is_nearly_right_is_guessed() {
    let system = TestSystem::new(EXECUTABLE);
    for (line, meant) in [
        ("run coridor", "corridor"),
        ("check coridor", "corridor"),
        ("run --set controler.cruise_mps=1", "controller"),
        ("run --set controller.cruise=1", "cruise_mps"),
        ("run --set process.controller.implementation=nmcp", "nmpc"),
        ("check --set controller.side=lef", "left"),
        ("swap controler --to nmpc", "controller"),
        ("set contoller.cruise_mps=1", "controller"),
        ("restart estimater", "estimator"),
        ("topic echo odometri", "odometry"),
        ("replay none.mcap --stage obstacle", "obstacles"),
        ("conformance estimator --to efk", "ekf"),
        ("conformance estimator --to ekf --only every-scans", "every-scan"),
        ("faults --only pose-lat-30ms", "pose-late-30ms"),
        ("demo --promise clearence_m=1", "clearance_m"),
        ("reference steering_backlas_rad", "steering_backlash_rad"),
        ("service nmp", "nmpc"),
        ("urg emulate --fault stal@3", "stall"),
    ] {
        let message = refusal(&system, &line.split(' ').collect::<Vec<_>>());
        assert!(message.contains(&format!("Did you mean `{meant}`?")), "{line}: {message}");
    }
    let message = refusal(&system, &["statu"]);
    assert!(message.contains("similar subcommand") && message.contains("status"), "{message}");
}

#[test]
fn check_migrate_rewrites_a_file_in_its_place_and_leaves_one_of_today_alone() {
    let system = TestSystem::new(EXECUTABLE);
    let check = |arguments: &[&str]| {
        let output = system.run(&[&["check"], arguments].concat());
        let [stdout, stderr] =
            [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
        (output.status.code(), stdout + &stderr)
    };
    let file = system.folder().join("lab.toml");
    let old = "rate_hz = 10.0 # the scanner's\n[controller]\nbody_width_m = 0.45 # with bumpers\n";
    std::fs::write(&file, old).unwrap();
    std::os::unix::fs::symlink("lab.toml", system.folder().join("link.toml")).unwrap();
    let (code, text) = check(&["--migrate", "link.toml"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("link.toml: controller.body_width_m is now controller.vehicle.width_m"), "{text}");
    assert!(text.contains("a valid system") && !text.contains("warning"), "{text}");
    let new = "rate_hz = 10.0 # the scanner's\n[controller]\n\n[controller.vehicle]\nwidth_m = 0.45 # with bumpers\n";
    assert_eq!(std::fs::read_to_string(&file).unwrap(), new);
    assert!(system.folder().join("link.toml").is_symlink());
    let (code, text) = check(&["--migrate", "lab.toml"]);
    assert_eq!((code, text.contains("lab.toml: nothing to change")), (Some(0), true), "{text}");
    // A shipped scenario is no file that could be rewritten.
    let (code, text) = check(&["--migrate", "corridor"]);
    assert_eq!((code, text.contains("corridor: ")), (Some(2), true), "{text}");
}

#[test]
fn a_file_that_check_migrate_rewrites_keeps_its_mark_the_order_of_its_keys_its_mode_and_its_owner() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("lab.toml");
    let old = "\u{feff}rate_hz = 10.0\r\n[controller]\r\nbody_length_m = 0.7\r\nbody_width_m = 0.45\r\n";
    std::fs::write(&file, old).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
    let is_root = file.metadata().unwrap().uid() == 0;
    if is_root {
        std::os::unix::fs::chown(&file, Some(1000), Some(1001)).unwrap();
    }
    let before = file.metadata().unwrap();
    let output = system.run(&["check", "--migrate", "lab.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
    let new = "\u{feff}rate_hz = 10.0\r\n[controller]\r\n\r\n[controller.vehicle]\r\nlength_m = 0.7\r\nwidth_m = 0.45\r\n";
    assert_eq!(std::fs::read_to_string(&file).unwrap(), new);
    let after = file.metadata().unwrap();
    assert_ne!(after.ino(), before.ino(), "a new file in its place");
    assert_eq!((after.mode(), after.uid(), after.gid()), (before.mode(), before.uid(), before.gid()));
    // A user who can't give the new file to its owner leaves the old one.
    if is_root {
        std::fs::write(&file, old).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o666)).unwrap();
        std::fs::set_permissions(system.folder(), std::fs::Permissions::from_mode(0o777)).unwrap();
        let mut command = Command::new(system.executable_alone("scanloop"));
        command.args(["check", "--migrate", "lab.toml"]).current_dir(system.folder());
        let output = command.uid(4242).gid(4242).output().unwrap();
        let text = printed(&output);
        assert!(output.status.code() == Some(2) && text.contains("it belongs to the user 1000"), "{text}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), old);
    }
}
