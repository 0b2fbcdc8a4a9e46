//! Files that commands write: never over their own input, never over a file of the user unasked, never through a link.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::os::unix::fs::{PermissionsExt, lchown, symlink};
use std::path::Path;
use std::process::Stdio;

use scanloop_tests::{SHORT_FREE, TestSystem};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs a command that must end with exit code 2, and returns its message.
fn refused(system: &TestSystem, arguments: &[&str]) -> String {
    let output = system.run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    message
}

fn succeeds(system: &TestSystem, arguments: &[&str]) {
    let output = system.run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_recording_is_not_destroyed_by_an_output_onto_itself() {
    let system = TestSystem::new(EXECUTABLE);
    system.lockstep(&[&SHORT_FREE[..], &["--record=drive.mcap"]].concat());
    let place = |name: &str| system.folder().join(name);
    let whole = std::fs::read(place("drive.mcap")).unwrap();
    for folder in ["bag", "tables"] {
        std::fs::create_dir(place(folder)).unwrap();
    }
    symlink("drive.mcap", place("soft.mcap")).unwrap();
    for name in ["hard.mcap", "bag/recording.mcap", "tables/scan.csv"] {
        std::fs::hard_link(place("drive.mcap"), place(name)).unwrap();
    }
    for arguments in [
        &["cut", "drive.mcap", "--out", "drive.mcap"][..],
        &["cut", "drive.mcap", "--out", "./soft.mcap"],
        &["cut", "soft.mcap", "--to", "1", "--out", "hard.mcap"],
        &["repair", "drive.mcap", "--out", "drive.mcap"],
        &["repair", "drive.mcap", "--out", "hard.mcap"],
        &["export", "bag/recording.mcap", "--rosbag2", "bag"],
        &["export", "drive.mcap", "--rosbag2", "bag"],
        &["export", "tables/scan.csv", "--csv", "tables"],
    ] {
        for force in [&[][..], &["--force"]] {
            let message = refused(&system, &[&["recording"], arguments, force].concat());
            assert!(message.contains("the same file as the input"), "{arguments:?}: {message}");
            assert!(!message.contains("--force"), "{message}");
            assert!(std::fs::read(place("drive.mcap")).unwrap() == whole, "{arguments:?}");
        }
    }
    // Nothing is left in its folder either.
    assert_eq!(files(&place("bag")), ["recording.mcap"]);
    assert_eq!(files(&place("tables")), ["scan.csv"]);
    // A link to another file is replaced, and the file it leads to is not.
    std::fs::write(place("precious"), "stays").unwrap();
    symlink("precious", place("link.mcap")).unwrap();
    let cut = ["recording", "cut", "drive.mcap", "--to", "2", "--out", "link.mcap"];
    assert!(refused(&system, &cut).contains("replace it with --force"));
    succeeds(&system, &[&cut[..], &["--force"]].concat());
    assert_eq!(std::fs::read_to_string(place("precious")).unwrap(), "stays");
    succeeds(&system, &["recording", "info", "link.mcap"]);
    // A command that fails leaves neither a part nor the loss of what was there.
    let none = ["recording", "cut", "drive.mcap", "--from", "1000", "--out", "link.mcap", "--force"];
    assert!(refused(&system, &none).contains("no whole second"));
    succeeds(&system, &["recording", "info", "link.mcap"]);
    assert!(files(system.folder()).iter().all(|name| !name.starts_with(".scanloop")));
}

#[test]
fn a_run_does_not_record_over_its_scenario_or_its_system() {
    let system = TestSystem::new(EXECUTABLE);
    let path = system.folder().join("recording.mcap");
    let run = ["run", "--lockstep", "--quiet", "--out", ".", "--force", "--record"];
    for (text, arguments) in
        [("[goal]\nx_m = 4.0\n", &["recording.mcap"][..]), ("rate_hz = 5\n", &["--system", "recording.mcap"])]
    {
        std::fs::write(&path, text).unwrap();
        let message = refused(&system, &[&run[..], arguments].concat());
        assert!(message.contains("the same file as the input"), "{message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }
}

#[test]
fn a_file_of_the_user_is_replaced_only_when_asked_for() {
    let system = TestSystem::new(EXECUTABLE);
    let place = |name: &str| system.folder().join(name);
    let drive = ["calibrate", "velocity", "--drive", "--out", "."];
    let analyse = ["analyse", "observability", "--out", "."];
    let run = ["run", "--lockstep", "--quiet", "--out", ".", "free", "--set", "goal.x_m=4"];
    let faults = ["faults", "--only", "actuation-clock-ahead/start", "--out", "."];
    for (name, arguments) in [
        ("velocity.csv", &drive[..]),
        ("velocity.svg", &drive),
        ("observability.svg", &analyse),
        ("report.json", &run),
        ("drive.svg", &run),
        ("recording.mcap", &[&run[..], &["--record"]].concat()),
        ("faults.html", &faults),
    ] {
        std::fs::write(place(name), "own").unwrap();
        let message = refused(&system, arguments);
        assert!(message.contains(name) && message.contains("--force"), "{name}: {message}");
        assert_eq!(std::fs::read_to_string(place(name)).unwrap(), "own");
        std::fs::remove_file(place(name)).unwrap();
    }
    // What a command wrote it replaces, until the user changes it.
    for arguments in [&drive[..], &drive, &analyse, &analyse, &run, &run] {
        succeeds(&system, arguments);
    }
    let table = std::fs::read_to_string(place("velocity.csv")).unwrap();
    std::fs::write(place("velocity.csv"), format!("# with my own run\n{table}1.0,6.0,8.4\n")).unwrap();
    assert!(refused(&system, &drive).contains("velocity.csv"));
    succeeds(&system, &[&drive[..], &["--force"]].concat());
    assert_eq!(std::fs::read_to_string(place("velocity.csv")).unwrap(), table);
    // A log of scans is kept also before a scanner is found.
    std::fs::write(place("scans"), "own").unwrap();
    assert!(
        refused(&system, &["urg", "log", "--tcp", "127.0.0.1:1", "scans"]).contains("scans: the file exists")
    );
}

#[test]
fn a_run_leaves_what_the_user_has_in_its_folder() {
    let system = TestSystem::new(EXECUTABLE);
    let place = |name: &str| system.folder().join(name);
    let read = |name: &str| std::fs::read_to_string(place(name)).unwrap();
    let run = |more: &[&str]| {
        refused(&system, &[&["run", "--lockstep", "--out", "d"], &SHORT_FREE[..], more].concat())
    };
    std::fs::create_dir_all(place("d/logs")).unwrap();
    std::fs::write(place("d/logs/recorder.log"), "mine\n").unwrap();
    let message = run(&["--record"]);
    assert!(message.contains("recorder.log: the file is no log of a run"), "{message}");
    assert_eq!(read("d/logs/recorder.log"), "mine\n");
    // A list that can't be written: the report is not written, and what has its name stays.
    std::fs::remove_dir_all(place("d")).unwrap();
    std::fs::create_dir_all(place("d/.scanloop")).unwrap();
    std::fs::write(place("d/report.json"), "mine\n").unwrap();
    let output = system.run(&[&["run", "--lockstep", "--out", "d", "--force"], &SHORT_FREE[..]].concat());
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(
        message.contains("the results were not written") && message.contains("d/report.json"),
        "{message}"
    );
    assert_eq!(read("d/report.json"), "mine\n");
    // A recording in the place of a file of the run itself, and behind a link that leads nowhere yet.
    symlink("stick/drive.mcap", place("link.mcap")).unwrap();
    symlink("new", place("to-new")).unwrap();
    for (file, reason) in [
        ("new/logs/robot.log", "the run writes this file itself"),
        ("new/.scanloop", "the run writes this file itself"),
        ("new/report.json", "the run writes this file itself"),
        ("new/more/../report.json", "the run writes this file itself"),
        ("to-new/report.json", "the run writes this file itself"),
        ("to-new/logs/robot.log", "the run writes this file itself"),
        ("link.mcap", "the file exists"),
    ] {
        let record = format!("--record={file}");
        let run = ["run", "--lockstep", "--out", "new", &record];
        let message = refused(&system, &[&run[..], &SHORT_FREE[..]].concat());
        assert!(message.contains(reason), "{file}: {message}");
    }
    assert!(place("link.mcap").is_symlink());
    // A file that took the place of the recording of an earlier run.
    let run = [&["run", "--lockstep", "--quiet", "--out", "again", "--record"], &SHORT_FREE[..]].concat();
    succeeds(&system, &run);
    succeeds(&system, &run);
    std::fs::write(place("again/recording.mcap"), "mine\n").unwrap();
    assert!(refused(&system, &run).contains("recording.mcap: the file exists"));
    assert_eq!(read("again/recording.mcap"), "mine\n");
}

#[test]
fn nothing_is_written_into_a_pipe_of_another_user() {
    if !rustix::process::geteuid().is_root() {
        println!("skipped: a pipe of another user can be made by root only");
        return;
    }
    let system = TestSystem::new(EXECUTABLE);
    let pipe = system.folder().join("drive.html");
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RWXU).unwrap();
    lchown(&pipe, Some(1234), None).unwrap();
    let drive = concat!(env!("CARGO_MANIFEST_DIR"), "/data/drive-0.1.mcap");
    let message = refused(&system, &["report", drive]);
    assert!(message.contains("drive.html: the file exists"), "{message}");
}

#[test]
fn a_report_of_a_version_without_lists_is_replaced() {
    let system = TestSystem::new(EXECUTABLE);
    let run = ["run", "--lockstep", "--quiet", "--out", "out", "free", "--set", "goal.x_m=4"];
    succeeds(&system, &run);
    std::fs::remove_file(system.folder().join("out/.scanloop")).unwrap();
    succeeds(&system, &run);
}

#[test]
fn links_in_a_shared_folder_are_not_followed() {
    let system = TestSystem::new(EXECUTABLE);
    let place = |name: &str| system.folder().join(name);
    std::fs::create_dir(place("shared")).unwrap();
    for name in ["victim", "victim.svg"] {
        std::fs::write(place(name), "stays").unwrap();
    }
    // The shell has the process id that the command will have.
    let plants = "ln -s ../victim shared/.scanloop-$$; ln -s ../victim shared/.observability.svg.$$.tmp; ";
    let picture = "ln -s ../victim.svg shared/observability.svg; ";
    for (script, force) in [(plants.to_owned(), None), (plants.to_owned() + picture, Some("--force"))] {
        let _ = std::fs::remove_file(place("shared/observability.svg"));
        let mut command = std::process::Command::new("sh");
        command.args(["-c", &(script + "exec \"$0\" \"$@\""), EXECUTABLE]);
        command.args(["analyse", "observability", "--out", "shared"]).args(force);
        let output = command.current_dir(system.folder()).stdin(Stdio::null()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        for name in ["victim", "victim.svg"] {
            assert_eq!(std::fs::read_to_string(place(name)).unwrap(), "stays");
        }
    }
    assert!(!place("shared/observability.svg").is_symlink());
    // Nor is the link of a log.
    std::fs::create_dir_all(place("shared/logs")).unwrap();
    symlink("../../victim", place("shared/logs/controller.log")).unwrap();
    succeeds(&system, &["run", "--lockstep", "--quiet", "--out", "shared", "free", "--set", "goal.x_m=4"]);
    assert_eq!(std::fs::read_to_string(place("victim")).unwrap(), "stays");
    system.assert_nothing_left();
}

#[test]
fn a_link_to_a_folder_that_another_user_has_placed_is_refused() {
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let system = TestSystem::new(EXECUTABLE);
    let place = |name: &str| system.folder().join(name);
    for name in ["shared", "theirs"] {
        std::fs::create_dir(place(name)).unwrap();
        std::fs::set_permissions(place(name), PermissionsExt::from_mode(0o777)).unwrap();
    }
    let link = place("shared/logs");
    symlink(place("theirs"), &link).unwrap();
    lchown(&link, Some(65_534), None).unwrap();
    let free = ["free", "--set", "goal.x_m=4"];
    for out in ["shared", "shared/logs"] {
        let message =
            refused(&system, &[&["run", "--lockstep", "--quiet", "--out", out], &free[..]].concat());
        assert!(message.contains("logs: a link of user 65534, which is not followed"), "{message}");
    }
    let message = refused(&system, &["man", "shared/logs/pages"]);
    assert!(message.contains("which is not followed"), "{message}");
    assert_eq!(files(&place("theirs")), [""; 0]);
    lchown(&link, Some(0), None).unwrap();
    succeeds(&system, &[&["run", "--lockstep", "--quiet", "--out", "shared"], &free[..]].concat());
    assert!(files(&place("theirs")).contains(&"controller.log".to_owned()));
    system.assert_nothing_left();
}

#[test]
fn a_map_of_a_drive_is_driven_in_and_the_new_recording_needs_no_map() {
    let system = TestSystem::new(EXECUTABLE);
    let drive = |more: &[&str]| system.lockstep(&[&SHORT_FREE[..], more].concat());
    drive(&["--record=first.mcap"]);
    let map = ["map", "first.mcap", "--out", "hall"];
    succeeds(&system, &map);
    let image = std::fs::read(system.folder().join("hall.pgm")).unwrap();
    assert!(image.starts_with(b"P5\n") && image.contains(&0), "a wall was seen");
    let message = refused(&system, &map);
    assert!(message.contains("hall.yaml") && message.contains("--force"), "{message}");
    succeeds(&system, &[&map[..], &["--force"]].concat());
    assert_eq!(std::fs::read(system.folder().join("hall.pgm")).unwrap(), image);
    drive(&["--record=second.mcap", "--set", "estimator.map=hall.yaml"]);
    for name in ["hall.yaml", "hall.pgm"] {
        std::fs::remove_file(system.folder().join(name)).unwrap();
    }
    succeeds(&system, &["replay", "second.mcap"]);
    let message = refused(&system, &["map", "first.mcap", "--out", "hall", "--resolution", "2"]);
    assert!(message.contains("--resolution") && message.contains("0.005 to 1"), "{message}");
    assert_eq!(files(system.folder()).iter().filter(|name| name.starts_with("hall")).count(), 0);
}
