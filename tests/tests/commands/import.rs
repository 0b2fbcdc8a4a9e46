//! Drives of other programs, imported as recordings: what is taken, what is left out and why, and what is refused.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use recording::mcap::{Channel, Schema, Writer};
use recording::ros2::{BaseOdometry, LaserScan, Ros2Message};
use scanloop_tests::{SHORT_CORRIDOR, TestSystem, printed};
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
/// Where the log of a real rover is expected, from the folder of this crate.
const ROVER: &str = "../../shared/recordings/urg-rover.dat";
/// Address space of a command that reads forged files [KiB].
const MEMORY_KIB: u64 = 900 << 10;
const START_NS: u64 = 1_700_000_000_000_000_000;
const PERIOD_NS: u64 = 100_000_000;

/// Runs a command that must succeed, and reads its JSON.
fn json(system: &TestSystem, arguments: &[&str]) -> Value {
    let output = system.run(arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", printed(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn import(system: &TestSystem, file: &str, more: &[&str]) -> Value {
    json(system, &[&["recording", "import", file, "--out", "new.mcap", "--force", "--json"], more].concat())
}

/// Fails unless the import ends with exit code 2, says this, and leaves no file.
fn refused(system: &TestSystem, file: &str, more: &[&str], says: &str) {
    let out = system.folder().join("refused.mcap");
    let script = format!("ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\"");
    let mut command = Command::new("sh");
    command
        .args(["-c", &script, EXECUTABLE, "recording", "import", file, "--out", "refused.mcap"])
        .args(more);
    let output = command.current_dir(system.folder()).output().unwrap();
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(2), "{file} {more:?}: {text}");
    assert!(text.contains(says), "{file} {more:?}: `{says}` is missing in: {text}");
    assert!(!out.exists(), "{text}");
}

/// A scan of a room of 4 m, all around from straight ahead.
fn scan(index: u64) -> LaserScan {
    LaserScan {
        stamp_ns: START_NS + index * PERIOD_NS,
        angles_rad: [0.0, 359.0_f32.to_radians(), 1.0_f32.to_radians()],
        times_s: [0.0, 0.1],
        limits_m: [0.1, 12.0],
        ranges_m: vec![2.0; 360],
        ..LaserScan::default()
    }
}

/// The robot drives 1 cm per scan.
fn odometry(index: u64) -> BaseOdometry {
    BaseOdometry {
        stamp_ns: START_NS + index * PERIOD_NS,
        pose: [0.01 * index as f64, 0.0, 0.0],
        velocity: [0.1, 0.0, 0.0],
        ..BaseOdometry::default()
    }
}

/// A bag that is written message by message.
struct Bag(Writer<File>);

impl Bag {
    /// With these topics, each of a type.
    fn new(path: &Path, topics: &[(&str, &str)]) -> Self {
        let schema = |(_, kind): &(&str, &str)| Schema {
            name: (*kind).to_owned(),
            encoding: "ros2msg".to_owned(),
            text: String::new(),
        };
        let channel = |(schema, (topic, _)): (u16, &(&str, &str))| Channel {
            topic: (*topic).to_owned(),
            schema,
            encoding: "cdr".to_owned(),
            metadata: Vec::new(),
        };
        let schemas: Vec<Schema> = topics.iter().map(schema).collect();
        let channels: Vec<Channel> = (1..).zip(topics).map(channel).collect();
        Self(Writer::new(File::create(path).unwrap(), "another", &schemas, &channels).unwrap())
    }

    /// Recorded a millisecond after the stamp of its index.
    fn add(&mut self, channel: u16, index: u64, data: &[u8]) {
        self.0.message(channel, 0, START_NS + index * PERIOD_NS + 1_000_000, &[data]);
    }

    fn finish(self) {
        self.0.finish().unwrap();
    }
}

const USUAL: [(&str, &str); 2] = [("/scan", LaserScan::TYPE), ("/odom", BaseOdometry::TYPE)];

/// A bag of 20 scans, and what is made of each message before it is written.
fn bag(system: &TestSystem, name: &str, change: impl Fn(u64, &mut LaserScan, &mut BaseOdometry)) -> PathBuf {
    let path = system.folder().join(name);
    let mut bag = Bag::new(&path, &USUAL);
    for index in 0..20 {
        let (mut scan, mut odometry) = (scan(index), odometry(index));
        change(index, &mut scan, &mut odometry);
        bag.add(1, index, &odometry.encode());
        bag.add(0, index, &scan.encode());
    }
    bag.finish();
    path
}

/// Fails unless both stages compute an output for each scan of `new.mcap`, and the page of a report shows them.
fn is_whole(system: &TestSystem, scans: u64) {
    for stage in ["estimator", "obstacles"] {
        let replayed = json(system, &["replay", "new.mcap", "--stage", stage, "--json"]);
        for key in ["scans", "compared", "identical"] {
            assert_eq!(replayed[key], scans, "{stage} {key}: {replayed}");
        }
    }
    // From a recorded state on.
    let half = (scans / 2).to_string();
    let replayed = json(system, &["replay", "new.mcap", "--stage", "obstacles", "--from", &half, "--json"]);
    assert_eq!((&replayed["identical"], &replayed["skipped"]), (&(scans - scans / 2 + 1).into(), &0.into()));
    let info = json(system, &["recording", "info", "new.mcap", "--json"]);
    let channels = &info["channels"];
    assert_eq!((&info["complete"], &channels["/scanloop/scan"]), (&true.into(), &scans.into()), "{info}");
    assert_eq!(
        (&channels["/scanloop/pose"], &channels["/scanloop/obstacles"]),
        (&scans.into(), &scans.into())
    );
    let output = system.run(&["report", "new.mcap", "-o", "page.html", "--force"]);
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    // Of two scans that come at once, the page shows one.
    let shown: u64 =
        text.split("MB, ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap().parse().unwrap();
    assert!(shown <= scans && shown * 50 >= scans * 49, "{text}");
}

#[test]
fn a_drive_comes_back_from_a_bag_scan_by_scan() {
    let system = TestSystem::new(EXECUTABLE);
    system.lockstep(&[&SHORT_CORRIDOR[..], &["--record=drive.mcap"]].concat());
    let exported = system.run(&["recording", "export", "drive.mcap", "--rosbag2", "bag"]);
    assert_eq!(exported.status.code(), Some(0), "{}", printed(&exported));
    let before = json(&system, &["recording", "info", "drive.mcap", "--json"]);
    let scans = before["channels"]["/scanloop/scan"].as_u64().unwrap();
    for from in ["bag", "bag/recording.mcap"] {
        let imported = import(&system, from, &["--scenario", "corridor"]);
        assert_eq!((&imported["scans"], &imported["taken"]), (&scans.into(), &scans.into()), "{imported}");
        assert_eq!((&imported["beams"], &imported["range_m"]), (&682.into(), &5.6.into()));
        is_whole(&system, scans);
    }
    // Ranges to the millimetre; error codes and the furthest range of a scanner are no returns.
    let table = |file: &str, folder: &str| {
        let exported = system.run(&["recording", "export", file, "--csv", folder]);
        assert_eq!(exported.status.code(), Some(0), "{}", printed(&exported));
        let text = std::fs::read_to_string(system.folder().join(folder).join("scan.csv")).unwrap();
        let names: Vec<String> = text.lines().next().unwrap().split(',').map(str::to_owned).collect();
        let first = names.iter().position(|name| name == "ranges_mm.0").unwrap();
        let ranges = |line: &str| -> Vec<u32> {
            let beams = line.split(',').skip(first).take(682);
            beams
                .map(|range| range.parse().unwrap())
                .map(|range| if (20..5599).contains(&range) { range } else { 0 })
                .collect()
        };
        text.lines().skip(1).map(ranges).collect::<Vec<_>>()
    };
    assert!(table("drive.mcap", "before") == table("new.mcap", "after"), "the ranges differ");
    system.assert_nothing_left();
}

#[test]
fn each_scan_is_taken_or_left_out_for_a_reason() {
    let system = TestSystem::new(EXECUTABLE);
    bag(&system, "bag.mcap", |index, scan, odometry| match index {
        // Without a stamp, and with the one before: the log time holds.
        3 => scan.stamp_ns = 0,
        5 => scan.stamp_ns = START_NS,
        // Other rays, also a number of them.
        7 => (scan.angles_rad[2], scan.ranges_m) = (0.9_f32.to_radians(), vec![2.0; 400]),
        8 => scan.angles_rad[2] = f32::NAN,
        9 => scan.angles_rad = [f32::NAN; 3],
        10 => scan.ranges_m[..5].copy_from_slice(&[f32::NAN, f32::INFINITY, -f32::INFINITY, 0.0, 1e30]),
        11 => odometry.pose[0] = f64::NAN,
        12 => odometry.velocity[2] = 1e300,
        // The base was started anew.
        15.. => odometry.pose[0] += 7.0,
        _ => {}
    });
    let imported = import(&system, "bag.mcap", &[]);
    let count = |key: &str| imported[key].as_u64().unwrap();
    assert_eq!(
        (count("scans"), count("taken"), count("impossible"), count("jumps")),
        (20, 19, 1, 1),
        "{imported}"
    );
    assert_eq!((count("odometry"), count("not_finite"), count("beams")), (20, 2, 360), "{imported}");
    let stamps = &imported["scan_stamps"];
    assert_eq!((&stamps["zero"], &stamps["wrong"], &stamps["left_out"]), (&1.into(), &1.into(), &0.into()));
    is_whole(&system, 19);
    // Odometry that ends early.
    let path = system.folder().join("short.mcap");
    let mut short = Bag::new(&path, &USUAL);
    for index in 0..20 {
        if index < 10 {
            short.add(1, index, &odometry(index).encode());
        }
        short.add(0, index, &scan(index).encode());
    }
    short.finish();
    let imported = import(&system, "short.mcap", &[]);
    assert_eq!((&imported["taken"], &imported["without_odometry"]), (&12.into(), &8.into()), "{imported}");
    is_whole(&system, 12);
}

#[test]
fn topics_are_found_by_type_and_chosen_by_name() {
    let system = TestSystem::new(EXECUTABLE);
    let path = system.folder().join("two.mcap");
    let topics = [
        ("/front", LaserScan::TYPE),
        ("/odom", "nav_msgs/Odometry"),
        ("/rear", LaserScan::TYPE),
        ("/camera", "sensor_msgs/msg/Image"),
    ];
    let mut two = Bag::new(&path, &topics);
    for index in 0..20 {
        two.add(1, index, &odometry(index).encode());
        two.add(0, index, &scan(index).encode());
        two.add(2, index, &LaserScan { ranges_m: vec![3.0; 360], ..scan(index) }.encode());
        two.add(3, index, b"no image");
    }
    two.finish();
    let several = "several topics have sensor_msgs/msg/LaserScan, choose one with --scan: /front, /rear";
    refused(&system, "two.mcap", &[], several);
    refused(&system, "two.mcap", &["--scan", "/camera"], "there are: /front, /rear");
    refused(&system, "two.mcap", &["--scan", "/rear", "--odometry", "/rear"], "there are: /odom");
    let imported = import(&system, "two.mcap", &["--scan", "/rear"]);
    assert_eq!(
        (&imported["topics"], &imported["taken"]),
        (&serde_json::json!(["/rear", "/odom"]), &20.into())
    );
    // Upside down and to the back it is the same room.
    let turned = import(&system, "two.mcap", &["--scan", "/rear", "--scan-yaw", "-3.1416", "--upside-down"]);
    assert_eq!((&turned["taken"], &turned["valid_share"]), (&20.into(), &1.0.into()));
}

#[test]
fn what_is_no_drive_is_refused_by_name_and_what_was_cut_off_is_read() {
    let system = TestSystem::new(EXECUTABLE);
    let write = |name: &str, bytes: &[u8]| std::fs::write(system.folder().join(name), bytes).unwrap();
    refused(&system, "missing.mcap", &[], "missing.mcap: No such file");
    for (name, bytes, says) in [
        ("bag.db3", &b"SQLite format 3\0...."[..], "`ros2 bag convert -i bag.db3"),
        ("bag.bag", b"#ROSBAG V2.0\n", "`rosbags-convert`"),
        ("text", b"hello\n", "neither a bag of ROS 2 in MCAP nor a log of a rover"),
        ("binary", b"\x7fELF\x02\x01\x01\0", "neither a bag of ROS 2 in MCAP nor a log of a rover"),
        ("empty", b"", "the file is empty"),
        ("half", b"\x89MCAP0\r\n\x01\x05", "half"),
    ] {
        write(name, bytes);
        refused(&system, name, &[], says);
    }
    for (folder, file, says) in [
        ("db3", "db3_0.db3", "`ros2 bag convert -i db3"),
        ("packed", "bag_0.mcap.zstd", "`unzstd"),
        ("other", "metadata.yaml", "no file ends with .mcap"),
    ] {
        std::fs::create_dir(system.folder().join(folder)).unwrap();
        write(&format!("{folder}/{file}"), b"");
        refused(&system, folder, &[], says);
    }
    let of = |name: &str, topics: &[(&str, &str)]| Bag::new(&system.folder().join(name), topics).finish();
    of("none.mcap", &[("/camera", "sensor_msgs/msg/Image")]);
    refused(&system, "none.mcap", &[], "no topic has sensor_msgs/msg/LaserScan; its topics are: /camera");
    of("still.mcap", &USUAL[..1]);
    refused(&system, "still.mcap", &[], "no topic has nav_msgs/msg/Odometry");
    let whole = std::fs::read(bag(&system, "bag.mcap", |_, _, _| {})).unwrap();
    for (more, says) in [
        (&["--scan-yaw", "4"][..], "--scan-yaw 4 is not allowed: -3.15 to 3.15"),
        (&["--wheel-factors", "1"], "--wheel-factors are two numbers"),
        (&["--wheel-factors", "1,0"], "--wheel-factors 0 is not allowed: 0.1 to 10"),
        (&["--system", "nothing.toml"], "nothing.toml"),
        (&["--scenario", "nothing"], "nothing"),
        (&["--set", "vehicle.length_m=-1"], "vehicle.length_m"),
        (&["--set", "vehicle.scanner.beams=359"], "its scans describe the beams of the scanner"),
    ] {
        refused(&system, "bag.mcap", more, says);
    }
    import(&system, "bag.mcap", &[]);
    let there = system.run(&["recording", "import", "bag.mcap", "--out", "new.mcap"]);
    assert!(there.status.code() == Some(2) && printed(&there).contains("--force"), "{}", printed(&there));
    let itself = system.run(&["recording", "import", "bag.mcap", "--out", "bag.mcap", "--force"]);
    assert!(itself.status.code() == Some(2) && printed(&itself).contains("the same file as the input"));
    // Within its only chunk nothing is whole.
    write("cut.mcap", &whole[..whole.len() / 4]);
    refused(&system, "cut.mcap", &[], "cut.mcap");
    // Behind it only the summary is missing.
    write("cut.mcap", &whole[..whole.len() - 100]);
    let output = system.run(&["recording", "import", "cut.mcap", "--out", "new.mcap", "--force"]);
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("20 of 20 scans of /scan") && text.contains("it was cut off"), "{text}");
}

#[test]
fn forged_messages_are_refused_in_bounded_memory() {
    let system = TestSystem::new(EXECUTABLE);
    let forged = |name: &str, data: &[u8]| {
        let mut bag = Bag::new(&system.folder().join(name), &USUAL);
        for index in 0..3 {
            bag.add(1, index, &odometry(index).encode());
            bag.add(0, index, data);
        }
        bag.finish();
    };
    let good = scan(0).encode();
    let ranges_at = good.len() - 4 - 360 * 4 - 4;
    for length in [1_u32 << 31, u32::MAX, 1 << 20] {
        let mut data = good.clone();
        data[ranges_at..ranges_at + 4].copy_from_slice(&length.to_le_bytes());
        forged("forged.mcap", &data);
        refused(&system, "forged.mcap", &[], "bytes in cdr are no sensor_msgs/msg/LaserScan");
    }
    // The length of the name of its frame.
    let mut data = good.clone();
    data[12..16].copy_from_slice(&(1_u32 << 31).to_le_bytes());
    forged("forged.mcap", &data);
    refused(&system, "forged.mcap", &[], "are no sensor_msgs/msg/LaserScan");
    forged("forged.mcap", &[&[0, 0, 0, 0], &good[4..]].concat());
    refused(&system, "forged.mcap", &[], "little endian");
    forged("forged.mcap", &[0x28, 0xb5, 0x2f, 0xfd, 0, 0]);
    refused(&system, "forged.mcap", &[], "packed one by one; `ros2 bag convert`");
    let of = |scan: LaserScan, says: &str| {
        forged("forged.mcap", &scan.encode());
        refused(&system, "forged.mcap", &[], says);
    };
    of(LaserScan { angles_rad: [f32::NAN; 3], ..scan(0) }, "are no scan");
    of(LaserScan { angles_rad: [0.0, 0.0, 1e-38], ..scan(0) }, "the scanner covers");
    of(LaserScan { ranges_m: vec![1.0; 1 << 20], ..scan(0) }, "1048576 beams from 0.0 to");
    of(
        LaserScan { angles_rad: [-0.7, 0.7, 0.005], ranges_m: vec![1.0; 281], ..scan(0) },
        "at least -60 to 60",
    );
    // All scans have the same stamp, and the log says the same.
    let mut bag = Bag::new(&system.folder().join("once.mcap"), &USUAL);
    for _ in 0..9 {
        bag.add(1, 0, &odometry(0).encode());
        bag.add(0, 0, &good);
    }
    bag.finish();
    refused(&system, "once.mcap", &[], "less than two scans");
    let numbers = |name: &str, change: fn(&mut BaseOdometry)| {
        self::bag(&system, name, |_, _, odometry| change(odometry));
    };
    numbers("nan.mcap", |odometry| odometry.pose = [f64::NAN; 3]);
    refused(&system, "nan.mcap", &[], "none of its 20 messages with odometry can be used");
    numbers("away.mcap", |odometry| odometry.stamp_ns -= 1_000_000_000_000);
    refused(&system, "away.mcap", &[], "none of its 20 scans can be used: 20 without odometry near in time");
}

/// The recording of a real rover is not part of the project: the test uses it where it lies beside the checkout.
#[test]
fn the_log_of_a_real_rover_runs_through_both_stages_without_a_scan_unaccounted() {
    let Ok(log) = Path::new(env!("CARGO_MANIFEST_DIR")).join(ROVER).canonicalize() else {
        let mut stderr = std::io::stderr();
        writeln!(stderr, "skipped: the log of a real rover: {ROVER} is not there").unwrap();
        return;
    };
    let system = TestSystem::new(EXECUTABLE);
    let imported = import(&system, log.to_str().unwrap(), &[]);
    assert_eq!((&imported["scans"], &imported["taken"]), (&756.into(), &756.into()), "{imported}");
    let computed = |key: &str| imported["computed"][key].as_u64().unwrap();
    let states = ["healthy", "degraded", "stopping"].map(computed);
    assert_eq!((computed("poses"), computed("obstacles"), states.iter().sum()), (756, 756, 756));
    // Half of its beams return nothing. Where the wheels slip it says that scans contradict them.
    let valid_share = imported["valid_share"].as_f64().unwrap();
    assert!((0.40..0.50).contains(&valid_share) && states[2] <= 756 / 50, "{imported}");
    assert!(computed("bodies") > 756, "{imported}");
    is_whole(&system, 756);
    // A part of it is a drive too.
    let cut = ["recording", "cut", "new.mcap", "--from", "10", "--to", "20", "--out", "cut.mcap"];
    assert_eq!(system.run(&cut).status.code(), Some(0));
    let page = system.run(&["report", "cut.mcap", "-o", "cut.html"]);
    assert_eq!(page.status.code(), Some(0), "{}", printed(&page));
    // Up to a line that is cut off it is read; a short line in the middle is named.
    let text = std::fs::read_to_string(&log).unwrap();
    let half = &text[..text.len() / 2];
    std::fs::write(system.folder().join("cut.dat"), half).unwrap();
    let output = system.run(&["recording", "import", "cut.dat", "--out", "half.mcap"]);
    assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
    assert!(printed(&output).contains("it was cut off"), "{}", printed(&output));
    std::fs::write(system.folder().join("short.dat"), format!("{half}\n{text}")).unwrap();
    refused(&system, "short.dat", &[], "numbers instead of 706 or more");
    system.assert_nothing_left();
}
