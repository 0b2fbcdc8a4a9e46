use std::f64::consts::PI;

use super::*;
use crate::Plan;

/// A system with one table of each list.
const LISTS: &str = "[[host]]\nname = \"lab\"\naddress = \"127.0.0.1:7000\"\ntransport = \"udp\"\n\
    [[process]]\nrole = \"controller\"\ncommand = [\"mine\"]\n\
    [[process.also_reads]]\ntopic = \"wind\"\n\
    [[topic]]\nname = \"wind\"\nlayout = \"wind.toml\"\nwriter = \"operator\"\n\
    [[topic.agree]]\nfield = \"x\"\n";
const COURSE: &str = "[course]\nwaypoints = [{ x_m = 0 }, { x_m = 6 }, { x_m = 12 }]\n";
const OBSTACLE: &str = "[[obstacle]]\nshape = \"box\"\nx_m = 6.0\ny_m = 0.0\nlength_m = 0.5\nwidth_m = 0.4\n";

fn written(scenario: &str, system: &str, overrides: &[&str]) -> anyhow::Result<Written> {
    let mut source = SourceFile::parse(system.to_owned(), "lab.toml".to_owned())?;
    crate::system::add_built_in(&mut source.table);
    let scenario = SourceFile::parse(scenario.to_owned(), "course.toml".to_owned())?;
    let overrides = overrides.iter().map(ToString::to_string).collect();
    Written::new(scenario, source, &Choice { overrides, ..Choice::default() })
}

/// The message of a refusal; empty when all is allowed.
fn refused(scenario: &str, system: &str, overrides: &[&str]) -> String {
    let check = || -> anyhow::Result<Option<String>> {
        let written = written(scenario, system, overrides)?;
        let refused = Plan::checked(written.tables()?).err();
        Ok(refused.map(|invalid| written.refusal(&invalid, |tables| Plan::checked(tables).err())))
    };
    match check() {
        Ok(message) => message.unwrap_or_default(),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_file_is_named_with_the_line_and_an_option_as_it_was_typed() {
    let system = "\n[vehicle]\nwidth_m = 9\n";
    assert_eq!(refused("", system, &[]), "lab.toml: line 3: vehicle.width_m = 9 is not allowed: 0.1 to 3");
    assert_eq!(
        refused("", "", &["vehicle.bounds.steering_max_rad=0.3"]),
        "--set vehicle.bounds.steering_max_rad=0.3: vehicle.bounds.steering_max_rad = 0.3 is not allowed: 0.001 to 0.12, as `sent_steering_max_rad` is 0.12"
    );
    assert_eq!(
        refused("", "", &["process.controller.grace_ms=0"]),
        "--set process.controller.grace_ms=0: process[3].grace_ms = 0 is not allowed: 1 to 3600000"
    );
    let twice =
        "[[process]]\nrole = \"robot\"\nimplementation = \"emulator\"\n[[process]]\nrole = \"robot\"\n";
    assert_eq!(
        refused("", twice, &[]),
        "lab.toml: line 5: process[1].role = robot is not allowed: one process per role; 2 processes would write topic \
         scan, odometry"
    );
}

#[test]
fn a_fast_vehicle_is_allowed_what_its_calibration_may_send() {
    let fast = |sent: &str| {
        let file = format!(
            "[vehicle.bounds]\nvelocity_max_mps = 5\nsteering_max_rad = 0.3\nsent_steering_max_rad = 0.4\n{sent}"
        );
        refused("", &file, &["controller.cruise_mps=5", "vehicle.sudden_m=4"])
    };
    assert_eq!(fast("sent_velocity_max_mps = 7.0"), "");
    let refused = fast("sent_velocity_max_mps = 6.0");
    let expected = "at most 4.285, as vehicle.bounds.sent_velocity_max_mps = 6 may be sent, and actuator.calibration sends 1.4 times";
    assert!(refused.contains(expected), "{refused}");
}

#[test]
fn a_value_that_stages_copy_is_named_where_it_was_written() {
    let goal = refused("[goal]\ntolerance_m = 0.001\n", "", &[]);
    assert_eq!(goal, "course.toml: line 2: goal.tolerance_m = 0.001 is not allowed: 0.01 to 1");
    let robot = refused("[robot]\ncareful_mps = 9\n", "", &[]);
    assert!(robot.starts_with("course.toml: line 2: robot.careful_mps = 9"), "{robot}");
    let old = refused("", "[controller]\nbody_width_m = 9.0\n", &[]);
    assert!(old.starts_with("lab.toml: line 2: controller.body_width_m = 9"), "{old}");
}

#[test]
fn a_default_that_does_not_fit_is_told_with_what_was_written() {
    let option = refused("", "", &["vehicle.bounds.velocity_min_mps=1.5"]);
    assert_eq!(
        option,
        "--set vehicle.bounds.velocity_min_mps=1.5: vehicle.bounds.velocity_min_mps = 1.5 is not allowed: 0.02 to 1"
    );
    let option = refused("", "", &["vehicle.bounds.velocity_max_mps=0.05"]);
    assert_eq!(
        option,
        "--set vehicle.bounds.velocity_max_mps=0.05 is not allowed with vehicle.bounds.velocity_min_mps = 0.1, \
         for which is allowed: 0.02 to 0.05"
    );
    let goal = "is not allowed with goal.x_m = 10, for which is allowed: ";
    let track = refused("seed = 1\n[track]\nx_m = [0.0, 5.0]\n", "", &[]);
    assert!(track.starts_with("course.toml: line 3: track.x_m ") && track.contains(goal), "{track}");
    let track = refused("", "", &["seed=3", "track.x_m=[0, 5]", "rate_hz=20"]);
    assert!(track.starts_with(&format!("--set track.x_m=[0, 5] {goal}")), "{track}");
    // The file was right before the option.
    let file = "[controller]\ncruise_mps = 0.9\n";
    let option = refused("", file, &["vehicle.bounds.velocity_max_mps=0.8"]);
    assert_eq!(
        option,
        "--set vehicle.bounds.velocity_max_mps=0.8 is not allowed with controller.cruise_mps = 0.9, \
         for which is allowed: 0.1 to 0.8"
    );
}

#[test]
fn the_value_without_which_all_is_allowed_is_named_before_one_without_which_another_is_refused() {
    // Without `controller.intervals` the rate is too low for the intervals, which is found earlier.
    let goal = "is not allowed with goal.tolerance_m = 0.1, for which is allowed: at least 0.167, ";
    let options = ["rate_hz=0.6", "controller.horizon_s=10", "controller.intervals=2"];
    let option = refused("", "", &options);
    assert!(option.starts_with(&format!("--set rate_hz=0.6 {goal}")), "{option}");
    let system = "rate_hz = 0.6\n[controller]\nhorizon_s = 10.0\nintervals = 2\n";
    let file = refused("", system, &[]);
    assert!(file.starts_with(&format!("lab.toml: line 1: rate_hz {goal}")), "{file}");
    // Nor is a file of ours named for what the user's file does.
    let scenario = SourceFile::shipped("[goal]\ntolerance_m = 0.1\n", "shipped scenario".to_owned()).unwrap();
    let mut source = SourceFile::parse(system.to_owned(), "lab.toml".to_owned()).unwrap();
    crate::system::add_built_in(&mut source.table);
    let written = Written::new(scenario, source, &Choice::default()).unwrap();
    let check = |tables| Plan::checked(tables).err();
    let shipped = written.refusal(&check(written.tables().unwrap()).unwrap(), check);
    assert!(shipped.starts_with(&format!("lab.toml: line 1: rate_hz {goal}")), "{shipped}");
}

#[test]
fn a_copy_of_a_stage_is_named_as_the_files_have_it() {
    let narrow = "[track]\ny_m = [-1.5, 1.5]\nwalls = true\n";
    let track = "track.y_m = [-1.5, 1.5]";
    let allowed =
        "allowed: walls further apart than vehicle.width_m = 2.8 and twice controller.theta_m = 0.2";
    assert_eq!(
        refused(narrow, "", &["vehicle.width_m=2.8"]),
        format!("--set vehicle.width_m=2.8 is not allowed with {track}, for which is {allowed}")
    );
    let file = "[vehicle]\nwidth_m = 2.8\n";
    assert_eq!(
        refused("", file, &["track.walls=true"]),
        format!("--set track.walls=true is not allowed with {track}, for which is {allowed}")
    );
}

#[test]
fn a_table_of_the_other_file_and_an_unknown_key_are_named() {
    let vehicle = refused("seed = 1\n[vehicle]\nwidth_m = 0.5\n", "", &[]);
    assert_eq!(
        vehicle,
        "course.toml: line 2: vehicle is not allowed here: it is a key of a system file, which `--system` names"
    );
    let unknown = refused("", "", &["obstacel.0.x_m=6"]);
    assert!(
        unknown.starts_with("--set obstacel.0.x_m=6: obstacel is unknown. Did you mean `obstacle`?"),
        "{unknown}"
    );
    let unknown = refused("", "", &["controller.cruise_mp=0.5"]);
    assert!(unknown.contains("the key is unknown. Did you mean `cruise_mps`?"), "{unknown}");
    let none = refused("", "", &["obstacle.0.x_m=6"]);
    assert_eq!(none, "--set obstacle.0.x_m=6: obstacle.0.x_m: obstacle has no element `0`, it has 0");
}

#[test]
fn a_part_of_a_file_is_completed_by_the_built_in_system() {
    for system in [
        "",
        "[vehicle]\nwidth_m = 0.5\nlength_m = 0.7\nmass_kg = 20.0\nsudden_m = 1.0\n",
        "[vehicle.bounds]\nvelocity_max_mps = 0.5\n",
        "[vehicle.bounds]\nvelocity_max_mps = 0.2\n",
        "[vehicle.bounds]\nvelocity_min_mps = 0.5\n",
        "[[process]]\nrole = \"controller\"\ncommand = [\"mine\"]\n",
        "[[process]]\nrole = \"robot\"\n",
        "[[process]]\nrole = \"companion\"\nname = \"logger\"\ncommand = [\"mine\"]\nreads = [\"pose\"]\n",
        "process = []\n",
        "[recording]\nring_s = 5.0\n",
    ] {
        assert_eq!(refused("", system, &[]), "", "{system}");
        let [_, table] = written("", system, &[]).unwrap().tables().unwrap();
        let system = Plan::checked([Table::new(), table]).unwrap().system;
        assert_eq!(system.roles().count(), 5);
    }
    let own = "[[process]]\nrole = \"estimator\"\ngrace_ms = 7\n";
    let [_, table] = written("", own, &[]).unwrap().tables().unwrap();
    let system = Plan::checked([Table::new(), table]).unwrap().system;
    let entry = system.entry(shared_types::Role::Estimator).unwrap();
    assert_eq!((entry.grace_ms, entry.implementation.as_deref()), (7, Some("ekf")));
}

/// The two numbers of `A to B`, and whether more is said.
fn range(allowed: &str) -> Option<([f64; 2], bool)> {
    let text = allowed.strip_prefix("two numbers from ").unwrap_or(allowed);
    let (from, rest) = text.split_once(" to ")?;
    let end = rest.find([' ', ',']).unwrap_or(rest.len());
    let number = |text: &str| match text {
        "pi" => Some(PI),
        "-pi" => Some(-PI),
        text => text.parse().ok(),
    };
    let more = rest[end..].trim_start_matches(" each");
    Some(([number(from)?, number(&rest[..end])?], !more.is_empty()))
}

/// All keys with a range, as `--set` takes them.
fn ranges(keys: &[Key], around: &str, found: &mut Vec<(String, Key)>) {
    for key in keys {
        let list = if key.is_list_of_tables() { ".0" } else { "" };
        let name = format!("{around}{}{list}", key.name);
        ranges(&key.keys, &format!("{name}."), found);
        if range(&key.allowed).is_some() {
            found.push((name, key.clone()));
        }
    }
}

/// A number in the form of a key's value.
fn shaped(key: &Key, name: &str, [low, high]: [f64; 2], value: f64) -> String {
    let number =
        |value: f64| match key.default.contains('.') || key.default.contains('e') || value.fract() != 0.0 {
            true => format!("{value:?}"),
            false => format!("{value}"),
        };
    if key.allowed.starts_with("two numbers") {
        let other = if value <= low { high } else { low };
        return format!("[{:?}, {:?}]", value.min(other), value.max(other));
    }
    let count = match (key.default.strip_prefix('['), key.allowed.contains(" each")) {
        (Some(default), _) => default.split(',').count(),
        (None, true) => 2,
        (None, false) => return number(value),
    };
    let list = vec![number(value); count].join(", ");
    if name.ends_with("dropout_steps") { format!("[[{list}]]") } else { format!("[{list}]") }
}

/// What `--set` is told of every printed minimum and maximum, and of what is just outside.
#[test]
fn the_printed_range_of_every_key_is_the_one_that_holds() {
    let mut keys = Vec::new();
    ranges(&Scenario::keys(), "", &mut keys);
    ranges(&System::keys(), "", &mut keys);
    assert!(keys.len() > 150, "{}", keys.len());
    let mut wrong = Vec::new();
    for (name, key) in keys {
        let ([low, high], has_condition) = range(&key.allowed).unwrap();
        let beyond = (high - low).clamp(1.0, 1e3);
        let step =
            if key.default.contains('.') || key.default.is_empty() { 1e-3 * beyond } else { beyond.ceil() };
        for value in [low, high, low - step, high + step] {
            let set = format!("{name}={}", shaped(&key, &name, [low, high], value));
            let lists =
                if name.starts_with("host.") || name.contains("also_reads") || name.starts_with("topic.") {
                    LISTS
                } else {
                    ""
                };
            let mut set = set;
            let scenario = if name.starts_with("course.") { COURSE } else { OBSTACLE };
            let mut message = refused(scenario, lists, &[&set]);
            // The type of a key without a default does not tell how many numbers it has.
            if let Some((_, length)) = message.split_once("an array of length ") {
                let count = length.trim().parse().unwrap();
                set = format!("{name}=[{}]", vec![format!("{value:?}"); count].join(", "));
                message = refused(scenario, lists, &[&set]);
            }
            let is_inside = (low..=high).contains(&value);
            let is_named = message.starts_with(&format!("--set {set}"));
            let right = match (is_inside, message.is_empty()) {
                (true, true) => true,
                (true, false) => is_named && has_condition,
                (false, empty) => !empty && is_named,
            };
            if !right {
                wrong.push(format!("{set} ({}): {message}", key.allowed));
            }
        }
    }
    assert!(wrong.is_empty(), "{}\n{} in all", wrong.join("\n"), wrong.len());
}
