//! Bad input ends with exit code 2 and one message that names file, key, value and what is allowed.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::os::unix::ffi::OsStrExt;

use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs a command that must be refused and checks what its message names.
fn refused(system: &TestSystem, arguments: &[&str], names: &[&str]) {
    let output = system.run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    for name in names {
        assert!(message.contains(name), "{arguments:?}: `{name}` is missing in: {message}");
    }
    assert!(!message.contains("panicked"), "{message}");
    system.assert_nothing_left();
}

/// A scenario file with this text must be refused.
fn scenario(text: &str, names: &[&str]) {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::write(system.folder().join("lab.toml"), text).unwrap();
    for command in [["run", "lab.toml"], ["check", "lab.toml"]] {
        refused(&system, &command, &[&["lab.toml"], names].concat());
    }
}

#[test]
fn scenarios_are_checked() {
    scenario("speed = 1.0", &["speed", "unknown"]);
    scenario("[robot]\nvelocity_facto = 1.0", &["robot.velocity_facto", "unknown"]);
    scenario("timeout_s = \"long\"", &["timeout_s", "long"]);
    scenario("[noise]\nrange_m = nan", &["noise.range_m", "NaN", "0 to 1"]);
    scenario("[noise]\ndropout = 2.0", &["noise.dropout", "2", "0 to 1"]);
    scenario(
        "[[obstacle]]\nshape = \"box\"\nx_m = 0.0\ny_m = 0.0\nlength_m = 0.1\nwidth_m = 0.4",
        &["obstacle[0]"],
    );
    scenario("[[obstacle]]\nshape = \"star\"\nx_m = 5.0\ny_m = 0.0", &["obstacle[0].shape", "star"]);
    scenario("[goal]\nx_m = 30.0", &["goal.x_m", "30"]);
    scenario("[track", &["line 1"]);
}

#[test]
fn the_driver_of_a_ros_2_robot_is_checked() {
    let system = TestSystem::new(EXECUTABLE);
    let robot = include_str!("../../../examples/ros2/system.toml");
    assert!(robot.lines().count() <= 15, "a user has fifteen lines to write");
    let file = system.folder().join("ros2.toml");
    let with = |key: &str| robot.replace("domain = 0", key);
    for (text, names) in [
        (with("domain = 233"), &["ros2.toml", "ros2.domain", "233", "0 to 232"]),
        (with("interface = \"lo\""), &["ros2.toml", "ros2.interface", "\"lo\"", "127.0.0.1"]),
        (with("remap = [\"laser:=/scan\"]"), &["ros2.toml", "ros2.remap[0]", "laser:=/scan", "FROM:=TO"]),
        (with("domian = 1"), &["ros2.toml", "ros2.domian", "unknown", "`domain`"]),
        (robot.replace("\"twist\"", "\"joy\""), &["ros2.toml", "ros2.command", "joy", "ackermann"]),
    ] {
        std::fs::write(&file, text).unwrap();
        refused(&system, &["check", "ros2.toml"], names);
    }
    std::fs::write(&file, robot).unwrap();
    refused(&system, &["run", "--lockstep", "--system", "ros2.toml"], &["--lockstep", "ros2"]);
    refused(&system, &["run", "--system", "ros2.toml", "--set", "ros2.domain=-1"], &["ros2.domain", "-1"]);
}

#[test]
fn the_driver_of_a_player_server_is_checked() {
    let system = TestSystem::new(EXECUTABLE);
    let robot = include_str!("../../../examples/player/system.toml");
    let file = system.folder().join("player.toml");
    for (text, names) in [
        (robot.replace("6665", "0"), &["player.toml", "player.port", "0", "1 to 65535"]),
        (robot.replace("127.0.0.1", ""), &["player.toml", "player.host", "\"\"", "name or address"]),
        (
            robot.replace("sweep_s = 0.0 ", "steering_sign = 2.0"),
            &["player.toml", "player.steering_sign", "2", "1 or -1"],
        ),
        (robot.replace("host =", "hots ="), &["player.toml", "player.hots", "unknown", "`host`"]),
        (
            robot.replace("sweep_s = 0.0 ", "scanner = \"sonar\" "),
            &["player.toml", "player.scanner", "sonar", "`laser`"],
        ),
        (
            robot.replace("sweep_s = 0.0 ", "urg = \"ttyACM0\" "),
            &["player.toml", "player.urg", "ttyACM0", "HOST:PORT"],
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        refused(&system, &["check", "player.toml"], names);
    }
    std::fs::write(&file, robot).unwrap();
    refused(&system, &["run", "--lockstep", "--system", "player.toml"], &["--lockstep", "player"]);
}

#[test]
fn systems_and_options_are_checked() {
    let system = TestSystem::new(EXECUTABLE);
    let file = system.folder().join("system.toml");
    let mut built_in = String::new();
    for (role, implementation) in [
        ("robot", "emulator"),
        ("estimator", "ekf"),
        ("obstacles", "ellipses"),
        ("controller", "nmpc"),
        ("actuator", "actuation"),
    ] {
        built_in += &format!("[[process]]\nrole = \"{role}\"\nimplementation = \"{implementation}\"\n");
    }
    let with = |more: &str| std::fs::write(&file, format!("{built_in}{more}")).unwrap();

    with("[[process]]\nrole = \"controller\"\ncommand = [\"true\"]");
    refused(
        &system,
        &["run", "--system", "system.toml"],
        &["system.toml", "controller", "would write topic command"],
    );
    with("[[process]]\nrole = \"pilot\"\ncommand = [\"true\"]");
    refused(&system, &["check", "--system", "system.toml"], &["process[5].role", "pilot", "robot"]);
    std::fs::write(&file, built_in.replace("\"nmpc\"", "\"mpc\"")).unwrap();
    refused(&system, &["run", "--system", "system.toml"], &["process[3].implementation", "mpc", "nmpc"]);

    refused(&system, &["run", "nowhere.toml"], &["nowhere.toml", "corridor"]);
    refused(&system, &["run", "--system", "nowhere.toml"], &["nowhere.toml"]);
    refused(&system, &["run", "--set", "rate_hz=0"], &["rate_hz", "0.5 to 1000"]);
    refused(
        &system,
        &["run", "--set", "rate_hz=0.5", "--set", "vehicle.sudden_m=0.2"],
        &["rate_hz = 0.5", "at least ", "vehicle.sudden_m = 0.2", "vehicle.blocked_deceleration_mps2 = 5"],
    );
    refused(&system, &["run", "--set", "controller.horizon=1"], &["controller.horizon", "unknown"]);
    let sides = ["controller.side = \"up\"", "search", "left", "right", "nearest"];
    refused(&system, &["check", "--set", "controller.side=up"], &sides);
    let profiles = ["controller.profile = \"thesis\"", "scanloop", "source"];
    refused(&system, &["run", "--set", "controller.profile=thesis"], &profiles);
    let source = ["check", "--set", "controller.profile=source", "--set", "controller.intervals=1"];
    refused(&system, &source, &["controller.intervals = 1", "2 to "]);
    refused(&system, &["run", "--set", "robot.width_m=wide"], &["robot.width_m", "wide"]);
    refused(&system, &["run", "--set", "actuator.calibration=best"], &["actuator.calibration", "best"]);
    refused(&system, &["check", "--set", "goal.tolerance_m=0.001"], &["goal.tolerance_m", "0.001"]);
    refused(&system, &["run", "--set", "seed"], &["KEY=VALUE"]);
    refused(&system, &["run", "--duration", "-1"], &["--duration"]);
    refused(&system, &["run", "--duration", "nan"], &["--duration"]);
    refused(&system, &["run", "--out", "system.toml"], &["--out"]);
    refused(&system, &["service", "warp"], &["warp", "nmpc"]);
    refused(&system, &["topic", "echo", "scans"], &["scans", "odometry"]);
    refused(&system, &["topic", "echo", "scan"], &["not running"]);
    refused(&system, &["status"], &["not running"]);
    refused(&system, &["stop"], &["not running"]);
    refused(&system, &["fly"], &["fly"]);
}

/// Runs a command below a limit of the shell; its exit code and message.
fn limited(system: &TestSystem, limit: &str, arguments: &str) -> (Option<i32>, String) {
    let id = system.id();
    let script = format!("ulimit {limit}; exec {EXECUTABLE} --system-id {id} run --quiet {arguments}");
    let mut shell = std::process::Command::new("bash");
    let output = shell.args(["-c", &script]).current_dir(system.folder()).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!message.contains("panicked") && !message.contains("overflow"), "{script}: {message}");
    system.assert_nothing_left();
    (output.status.code(), message)
}

#[test]
fn limits_that_are_too_small_are_named_with_the_command_that_sets_them() {
    let system = TestSystem::new(EXECUTABLE);
    for (limit, value, command) in [
        ("-n 16", "16", "`ulimit -n 256`"),
        ("-n 32", "32", "`ulimit -n 256`"),
        ("-n 128", "128", "`ulimit -n 256`"),
        ("-s 64", "64", "`ulimit -s 1024`"),
        ("-s 256", "256", "`ulimit -s 1024`"),
    ] {
        let (code, message) = limited(&system, limit, "");
        assert_eq!(code, Some(4), "{limit}: {message}");
        assert!(message.contains(value) && message.contains(command), "{limit}: {message}");
    }
    for limit in ["-Sn 32", "-Ss 64"] {
        let (code, message) = limited(&system, limit, "--lockstep --duration 1");
        assert_eq!(code, Some(1), "{limit} may be raised, and the run ends after its duration: {message}");
    }
}

#[test]
fn an_out_folder_that_is_no_utf8_is_refused_before_anything_is_made() {
    let system = TestSystem::new(EXECUTABLE);
    let folder = std::ffi::OsStr::from_bytes(b"out\xff");
    for arguments in [["run", "--quiet", "--out"], ["run", "--lockstep", "--out"]] {
        let output = system.command(&arguments).arg(folder).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("--out") && message.contains("UTF-8"), "{message}");
        assert!(!system.folder().join(folder).exists());
        system.assert_nothing_left();
    }
    // The report names the recording.
    let file = std::ffi::OsStr::from_bytes(b"--record=drive\xff.mcap");
    let output = system.command(&["run", "--lockstep", "--out", "out"]).arg(file).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("--record drive") && message.contains("UTF-8"), "{message}");
}

#[test]
fn files_that_are_no_regular_files_or_too_large_are_refused() {
    let system = TestSystem::new(EXECUTABLE);
    let fifo = system.folder().join("fifo.toml");
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    std::fs::write(system.folder().join("large.toml"), "#".repeat((1 << 20) + 1)).unwrap();
    std::fs::write(system.folder().join("bytes.toml"), [0xff]).unwrap();
    for (file, reason) in [
        ("fifo.toml", "regular file"),
        ("/dev/zero", "regular file"),
        ("/dev/stdin", "regular file"),
        (".", "regular file"),
        ("large.toml", "1048576"),
        ("bytes.toml", "UTF-8"),
    ] {
        for arguments in [
            &["run", file][..],
            &["check", file],
            &["run", "--system", file],
            &["check", "--system", file],
            &["run", "--calibration", file],
        ] {
            refused(&system, arguments, &[file, reason]);
        }
    }
    for command in
        [&["bench", "compare", "fifo.toml", "fifo.toml"][..], &["calibrate", "velocity", "fifo.toml"]]
    {
        refused(&system, command, &["fifo.toml", "regular file"]);
    }
    for file in ["fifo.toml", "/dev/zero"] {
        for arguments in [
            &["recording", "info", file][..],
            &["recording", "repair", file, "--out", "new.mcap"],
            &["recording", "cut", file, "--out", "new.mcap"],
            &["recording", "export", file, "--csv", "tables"],
            &["recording", "export", file, "--rosbag2", "bag"],
            &["recording", "import", file, "--out", "new.mcap"],
            &["replay", file],
            &["report", file],
            &["why", file, "5"],
            &["view", file],
            &["map", file, "--out", "new.svg"],
            &["fork", file, "--at", "5"],
            &["compare", file, file],
        ] {
            refused(&system, arguments, &[file, "regular file"]);
        }
    }
    let folder = system.folder().join("bag");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::rename(fifo, folder.join("fifo.mcap")).unwrap();
    refused(&system, &["recording", "import", "bag", "--out", "new.mcap"], &["fifo.mcap", "regular file"]);
    refused(&system, &["compare", "bag", "bag"], &["bag: it holds no recording"]);
}

#[test]
fn a_number_below_zero_is_a_value_whose_range_is_told() {
    let system = TestSystem::new(EXECUTABLE);
    for (arguments, option) in [
        (&["record", "new.mcap", "--duration", "-1"][..], "--duration"),
        (&["replay", "drive.mcap", "--tolerance", "-1"], "--tolerance"),
        (&["run", "free", "--duration", "-1"], "--duration"),
        (&["latency", "--duration", "-1"], "--duration"),
    ] {
        refused(&system, arguments, &[option, "-1"]);
        let output = system.run(arguments);
        assert!(!String::from_utf8_lossy(&output.stderr).contains("unexpected argument"), "{arguments:?}");
    }
}

#[test]
fn a_system_id_that_is_no_file_name_is_refused() {
    let output = std::process::Command::new(EXECUTABLE).args(["run", "--system-id", "a_b"]).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(message.contains("a_b") && message.contains("letters"), "{message}");
}

#[test]
fn a_service_started_by_hand_is_refused() {
    let system = TestSystem::new(EXECUTABLE);
    refused(&system, &["service", "nmpc"], &["SCANLOOP_INCARNATION"]);
}

#[test]
fn a_command_that_does_not_exist_ends_the_run_with_its_name() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["run", "--quiet", "--set", "process.controller.command=[\"no-such-program\"]"]);
    // `implementation` and `command` together are refused before anything starts.
    assert_eq!(output.status.code(), Some(2));
    failing(&system, "command = [\"no-such-program\"]", "no-such-program");
}

#[test]
fn a_process_that_dies_at_start_three_times_ends_the_run_with_its_last_log_lines() {
    let system = TestSystem::new(EXECUTABLE);
    failing(&system, "command = [\"sh\", \"-c\", \"echo no camera found; exit 7\"]", "no camera found");
}

/// A system whose controller does not come up ends with exit code 4 and the reason.
fn failing(system: &TestSystem, controller: &str, expected: &str) {
    let file = system.folder().join("system.toml");
    let text = format!(
        "[[process]]\nrole = \"robot\"\nimplementation = \"emulator\"\n\
         [[process]]\nrole = \"estimator\"\nimplementation = \"ekf\"\n\
         [[process]]\nrole = \"obstacles\"\nimplementation = \"ellipses\"\n\
         [[process]]\nrole = \"controller\"\n{controller}\n\
         [[process]]\nrole = \"actuator\"\nimplementation = \"actuation\"\n"
    );
    std::fs::write(&file, text).unwrap();
    let output = system.run(&["run", "--quiet", "--system", "system.toml"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(4), "{message}");
    assert!(message.contains(expected), "{message}");
    system.assert_nothing_left();
}

#[test]
fn a_folder_that_cannot_be_written_to_is_refused_before_anything_is_started() {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::write(system.folder().join("file"), "").unwrap();
    let commands = [
        &["run"][..],
        &["adopt"],
        &["campaign", "--runs", "1"],
        &["price"],
        &["calibrate", "velocity", "--drive"],
        &["analyse", "observability"],
        &["bench", "latency"],
        &["bench", "transport"],
    ];
    for command in commands {
        for out in ["file", "file/below", "/proc/none"] {
            let names = ["--out", out, "name a folder that you may write to"];
            refused(&system, &[command, &["--out", out]].concat(), &names);
        }
    }
}

#[test]
fn a_choice_of_log_lines_that_cannot_be_read_is_refused_before_anything_is_started() {
    let system = TestSystem::new(EXECUTABLE);
    for value in ["garbage", "nmpc=loud", "debug,garbage", "=", "[a=info"] {
        for command in [&["run"][..], &["status"], &["service", "nmpc"], &["bench", "transport"]] {
            let output = system.command(command).env("SCANLOOP_LOG", value).output().unwrap();
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{value} {command:?}: {message}");
            assert!(message.contains(&format!("SCANLOOP_LOG = `{value}`")), "{message}");
            assert!(message.contains("debug"), "{message}");
        }
    }
    for value in ["", "debug", "warn,nmpc=debug", "OFF"] {
        let output = system.command(&["check"]).env("SCANLOOP_LOG", value).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{value}");
    }
    system.assert_nothing_left();
}

#[test]
fn a_map_is_checked() {
    let system = TestSystem::new(EXECUTABLE);
    let map = "image: room.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n\
        free_thresh: 0.196\n";
    let write = |name: &str, content: &[u8]| std::fs::write(system.folder().join(name), content).unwrap();
    // Five rows of free cells above one of occupied ones.
    let image = |size: &str, pixels: usize| {
        let header = format!("P5\n{size}\n255\n").into_bytes();
        let shade = |number: usize| if number < 50 { 254 } else { 0 };
        header.into_iter().chain((0..pixels).map(shade)).collect::<Vec<u8>>()
    };
    write("room.pgm", &image("10 6", 60));
    write("short.pgm", &image("10 6", 59));
    write("large.pgm", &image("100000 100000", 60));
    write("text.pgm", b"P2\n1 1\n255\n0\n");
    let use_map = ["check", "corridor", "--set", "estimator.map=room.yaml"];
    write("room.yaml", map.as_bytes());
    assert!(system.run(&use_map).status.success());
    for (from, to, names) in [
        ("0.05", "0", &["room.yaml", "resolution", "0.005 to 1"][..]),
        ("0.05", "-0.05", &["room.yaml", "resolution", "-0.05"]),
        ("0.05", ".nan", &["room.yaml", "resolution", ".nan"]),
        ("0.05", "5000", &["room.yaml", "resolution", "5000"]),
        ("0.0, 0.0]", "0.0]", &["room.yaml", "origin", "three numbers"]),
        ("0.0]", "nan]", &["room.yaml", "origin", "nan"]),
        ("negate", "mode: round\nnegate", &["room.yaml", "mode", "round", "trinary"]),
        ("negate", "deviation: -1\nnegate", &["room.yaml", "deviation", "-1", "0 to 1"]),
        ("room.pgm", "none.pgm", &["room.yaml", "image", "none.pgm"]),
        ("room.pgm", "text.pgm", &["text.pgm", "P5"]),
        ("room.pgm", "short.pgm", &["short.pgm", "59 pixels", "10 x 6"]),
        ("room.pgm", "large.pgm", &["large.pgm", "100000 x 100000", "16777216"]),
        ("0.196", "0.0", &["room.yaml", "0 straight surfaces", "1 to 2048"]),
    ] {
        assert!(map.contains(from), "{from}");
        write("room.yaml", map.replacen(from, to, 1).as_bytes());
        for command in ["check", "run"] {
            refused(&system, &[&[command], &use_map[1..]].concat(), names);
        }
    }
    write("room.yaml", map.as_bytes());
    for (set, names) in [
        ("estimator.map=none.yaml", &["none.yaml", "estimator.map"][..]),
        ("estimator.laser=walls", &["estimator.laser", "walls", "match"]),
        ("estimator.profile=scaled", &["estimator.profile=scaled", "estimator.laser", "match"]),
        ("estimator.surfaces=[[0.0, 0.0, 1.0, 0.0]]", &["estimator.map", "not both"]),
    ] {
        refused(&system, &[&use_map[..], &["--set", set]].concat(), names);
    }
    refused(
        &system,
        &["check", "corridor", "--set", "estimator.surfaces=[[0.0, 0.0, 0.0, 0.0]]"],
        &["estimator.surfaces[0]", "0 m long"],
    );
    refused(&system, &["map", "room.yaml"], &["room.yaml", "no MCAP file"]);
    refused(&system, &["map", "none.mcap", "--resolution", "0"], &["--resolution", "0.005 to 1"]);
}
