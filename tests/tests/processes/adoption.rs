//! The orchestrator is killed: the robot drives on and is adopted, or it comes to rest and all processes end.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::process::{Command, Stdio};

use emulator::Outcome;
use report::Report;
use rustix::process::Signal;
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, TestSystem, TruthWatch};
use session::control::SystemStatus;
use shared_types::{Role, Truth};

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-controller");

/// True wheels are blocked at the latest three scan periods after the last actuation.
const MAX_BLIND_S: f64 = 0.3;

/// A system that drives and whose orchestrator was killed.
fn orphaned(arguments: &[&str]) -> (TestSystem, TruthWatch) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(arguments);
    let watch = TruthWatch::new(&system);
    system.kill_orchestrator();
    (system, watch)
}

/// Process ids of all roles.
fn pids(status: &SystemStatus) -> Vec<i32> {
    status.processes.iter().map(|process| process.pid).collect()
}

/// The rows of `status` of a system without an orchestrator.
fn orphaned_status(system: &TestSystem) -> SystemStatus {
    let output = system.run(&["status", "--json"]);
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)))
}

fn pid_of(status: &SystemStatus, role: Role) -> i32 {
    status.processes.iter().find(|process| process.role == role).unwrap().pid
}

/// Waits for the end of an adopted run that reaches its goal.
fn assert_reached(mut system: TestSystem) -> Report {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Reached);
    assert!(report.adopted && report.adopted_from_scan > Some(3), "{:?}", report.adopted_from_scan);
    assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
    assert!(
        !report.drive.truth.unwrap().collided && report.drive.truth.unwrap().longest_blind_s <= MAX_BLIND_S,
        "{:?}",
        report.drive
    );
    system.assert_nothing_left();
    report
}

fn stderr(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn the_robot_drives_on_without_an_orchestrator_and_is_adopted_as_it_is() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let before = pids(&system.status().unwrap());
        let watch = TruthWatch::new(&system);
        system.kill_orchestrator();
        let from = watch.wait_for(&system, "the truth continues", |_| true);
        let later =
            watch.wait_for(&system, "ten scans", |truth| truth.header.scan_id >= from.header.scan_id + 10);
        assert!(later.blocked == 0 && later.speed_mps > 0.5 && later.x_m > from.x_m + 0.5, "{later:?}");
        system.adopt(&[]);
        assert_eq!(pids(&system.status().unwrap()), before);
        let report = assert_reached(system);
        assert_eq!((report.scans.lost, report.scans.duplicates), (0, 0), "{:?}", report.scans);
        let first = report.adopted_from_scan.unwrap();
        assert!(first > later.header.scan_id && report.scans.commanded > 20, "{first}: {:?}", report.scans);
        assert!(report.processes.iter().all(|process| process.restarts == 0), "{:?}", report.processes);
    });
}

#[test]
fn an_adopted_run_knows_which_goals_were_reached() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let goals = "[[goal]]\nx_m = 2.0\nstay_s = 0.5\n\n[[goal]]\nx_m = 5.0\n";
        std::fs::write(system.folder().join("two.toml"), goals).unwrap();
        system.start(&["two.toml"]);
        let noted = || system.domain().folder().read_text("progress.toml").unwrap_or_default();
        system.wait_until("the first goal is reached", |_| noted().contains("reached_s"));
        system.kill_orchestrator();
        system.adopt(&[]);
        let report = assert_reached(system);
        let reached_s: Vec<_> = report.goals.iter().filter_map(|goal| goal.reached_s).collect();
        assert!(reached_s.len() == 2 && reached_s[0] < reached_s[1], "{:?}", report.goals);
    });
}

#[test]
fn an_adopted_run_is_supervised_like_any_other() {
    repeat_when_late(|| {
        // These roles recover without a state: on a busy machine it may be older than half a second.
        let (mut system, watch) = orphaned(&["endless", "--set", "timeout_s=600"]);
        system.adopt(&[]);
        let restarted = |system: &TestSystem, role: Role, before: i32| {
            system.wait_until("a successor", |system| {
                system.status().is_some_and(|status| {
                    status.processes.iter().any(|process| {
                        process.role == role
                            && process.pid != before
                            && process.pid != 0
                            && process.state.name() == "ready"
                            && process.restarts > 0
                    })
                })
            });
        };
        for (role, signal) in [(Role::Controller, Signal::KILL), (Role::Actuator, Signal::STOP)] {
            let pid = system.pid(role);
            system.signal(pid, signal);
            restarted(&system, role, pid);
        }
        assert!(system.stderr().contains("exit code unknown, as it was adopted"), "{}", system.stderr());
        let controller = system.pid(Role::Controller);
        assert_eq!(system.run(&["restart", "controller"]).status.code(), Some(0));
        restarted(&system, Role::Controller, controller);
        let swapped = system.run(&["swap", "actuator", "--to", "actuation", "--shadow-scans", "3"]);
        assert_eq!(swapped.status.code(), Some(0), "{}", stderr(&swapped));
        watch.wait_for(&system, "it drives", |truth| truth.blocked == 0 && truth.speed_mps > 0.5);
        // Again, with processes of which some were adopted twice.
        let before = pids(&system.status().unwrap());
        system.kill_orchestrator();
        system.adopt(&[]);
        assert_eq!(pids(&system.status().unwrap()), before);
        let status = system.status().unwrap();
        let restarts: Vec<u32> = status.processes.iter().map(|process| process.restarts).collect();
        assert_eq!(restarts, [0, 0, 0, 2, 1], "they are remembered");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1));
        let report = system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Interrupted, 0));
        assert_eq!(report.drive.final_speed_mps, 0.0);
        assert!(
            report.drive.truth.unwrap().longest_blind_s <= MAX_BLIND_S
                && !report.drive.truth.unwrap().collided
        );
        system.assert_nothing_left();
    });
}

#[test]
fn a_controller_that_died_meanwhile_is_restarted_and_rests_before_it_drives() {
    repeat_when_late(|| {
        let (mut system, watch) = orphaned(&SHORT_CORRIDOR);
        let controller = pid_of(&orphaned_status(&system), Role::Controller);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        system.signal(controller, Signal::KILL);
        let blocked = watch.wait_for(&system, "blocked wheels", |truth| truth.blocked == 1);
        assert!(blocked.header.scan_id <= blocked.actuation_scan + 2, "{blocked:?}");
        assert!(blocked.longest_blind_s <= MAX_BLIND_S);
        system.adopt(&[]);
        // Its state was lost with the orchestrator.
        let log = system.folder().join("out/logs/controller.log");
        system.wait_until("it says what it waits for", |_| {
            std::fs::read_to_string(&log).is_ok_and(|log| log.contains("the robot has to rest first"))
        });
        let report = assert_reached(system);
        assert_eq!(report.processes[Role::Controller.index()].restarts, 1);
    });
}

#[test]
fn a_controller_resumes_from_the_state_of_one_that_hung_for_longer_than_a_state_may_be_old() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        // At 5 Hz a hang is found after 0.6 s; the state was young when it began.
        system.start(&["corridor", "--set", "rate_hz=5"]);
        let watch = TruthWatch::new(&system);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        let pid = system.pid(Role::Controller);
        system.signal(pid, Signal::STOP);
        let rests = |truth: &Truth| truth.blocked == 1 && truth.speed_mps == 0.0;
        let rest = watch.wait_for(&system, "it rests", rests);
        watch.wait_for(&system, "it drives again", |truth| {
            truth.header.scan_id > rest.header.scan_id && truth.blocked == 0 && truth.speed_mps > 0.5
        });
        let log = std::fs::read_to_string(system.folder().join("out/logs/controller.log")).unwrap();
        assert!(!log.contains("the state of the process before this one"), "{log}");
        assert!(!log.contains("the robot has to rest first"), "{log}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        let report = system.report();
        assert_eq!((report.scans.unaccounted, report.drive.truth.unwrap().collided), (0, false));
        system.assert_nothing_left();
    });
}

#[test]
fn adopt_is_refused_without_a_run_and_while_an_orchestrator_drives() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        for arguments in [["adopt", "--quiet"], ["run", "--adopt"]] {
            let output = system.run(&arguments);
            assert_eq!(output.status.code(), Some(2));
            assert!(
                stderr(&output).contains("has no processes that could be adopted"),
                "{}",
                stderr(&output)
            );
        }
        system.assert_nothing_left();
        let mixed = system.run(&["run", "--adopt", "corridor"]);
        assert_eq!(mixed.status.code(), Some(2), "{}", stderr(&mixed));
        system.start(&["--duration", "2"]);
        let output = system.run(&["adopt"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("is already running"), "{}", stderr(&output));
        system.wait();
        assert_eq!(system.report().outcome, Outcome::Timeout);
        system.assert_nothing_left();
        // With nothing to adopt it starts.
        let output = system.run(&["run", "--adopt-or-start", "--quiet", "--duration", "1", "free"]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        system.assert_nothing_left();
    });
}

#[test]
fn a_stranger_under_the_number_of_a_process_is_named_and_left_alone() {
    repeat_when_late(|| {
        let (mut system, watch) = orphaned(&SHORT_CORRIDOR);
        let controller = pid_of(&orphaned_status(&system), Role::Controller);
        system.signal(controller, Signal::KILL);
        watch.wait_for(&system, "blocked wheels", |truth| truth.blocked == 1);
        // Its entry in the list now names a process of another system, with its true start time.
        let mut stranger = Command::new("sleep");
        stranger.arg("600").env("SCANLOOP_RUN_ID", "anotherrun").env("SCANLOOP_INCARNATION", "4");
        let mut stranger = stranger.stdin(Stdio::null()).spawn().unwrap();
        let list = system.domain().directory().join(runtime::PROCESSES_FILE);
        let mut table: toml::Table = std::fs::read_to_string(&list).unwrap().parse().unwrap();
        let mut rows = table["process"].as_array_mut().unwrap().iter_mut().map(|row| &mut row["identity"]);
        let row = rows.find(|row| row["pid"].as_integer() == Some(controller.into())).unwrap();
        row["pid"] = i64::from(stranger.id()).into();
        row["start_ticks"] = runtime::start_ticks(stranger.id()).unwrap().cast_signed().into();
        std::fs::write(&list, table.to_string()).unwrap();
        system.adopt(&[]);
        let printed = system.stderr();
        let name = format!("controller: process {} is a stranger: its SCANLOOP_RUN_ID is", stranger.id());
        assert!(printed.contains(&name), "{printed}");
        assert!(
            system
                .status()
                .unwrap()
                .processes
                .iter()
                .all(|process| process.pid != stranger.id().cast_signed())
        );
        let report = assert_reached(system);
        assert_eq!(report.processes[Role::Controller.index()].restarts, 1);
        assert!(stranger.try_wait().unwrap().is_none(), "the stranger lives");
        stranger.kill().unwrap();
        stranger.wait().unwrap();
    });
}

#[test]
fn a_damaged_list_of_processes_is_named_with_its_line_and_the_processes_can_be_stopped() {
    repeat_when_late(|| {
        let (system, _watch) = orphaned(&SHORT_CORRIDOR);
        let list = system.domain().directory().join(runtime::PROCESSES_FILE);
        let whole = std::fs::read_to_string(&list).unwrap();
        for (text, expected) in [
            (whole.replacen("[[role]]", "[[role", 1), "TOML parse error at line"),
            (String::new(), "its process registry: "),
        ] {
            std::fs::write(&list, text).unwrap();
            let output = system.run(&["adopt", "--quiet"]);
            assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
            assert!(stderr(&output).contains(expected), "{}", stderr(&output));
        }
        let output = system.run(&["stop"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        system.assert_nothing_left();
    });
}

/// Kills the orchestrator when the swap of the controller has reached this state; returns both process ids,
/// the one in charge first.
fn kill_within_swap(system: &mut TestSystem, state: &str) -> [i32; 2] {
    let mut swap = system.command(&["swap", "controller", "--to", "nmpc", "--standby-scans", "50"]);
    let mut swap = swap.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let rows = |system: &TestSystem| -> Vec<(i32, String)> {
        let processes = system.status().map(|status| status.processes).unwrap_or_default();
        let rows = processes.into_iter().filter(|process| process.role == Role::Controller);
        rows.map(|process| (process.pid, process.state.to_string())).collect()
    };
    system.wait_until(state, |system| rows(system).get(1).is_some_and(|(_, of)| of == state));
    let rows = rows(system);
    system.kill_orchestrator();
    swap.wait().unwrap();
    [rows[0].0, rows[1].0]
}

/// A swap whose orchestrator was killed in this state ends with the process in charge.
fn ends_with_the_process_in_charge(state: &str) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&SHORT_CORRIDOR);
    let [in_charge, other] = kill_within_swap(&mut system, state);
    system.adopt(&[]);
    assert_eq!(system.pid(Role::Controller), in_charge);
    system.wait_until("the other one has ended", |system| !system.processes().contains(&other));
    assert!(system.stderr().contains(&format!("controller {other} fills no role")), "{}", system.stderr());
    let report = assert_reached(system);
    assert_eq!((report.scans.lost, report.scans.duplicates), (0, 0), "{:?}", report.scans);
}

#[test]
fn a_swap_that_lost_its_orchestrator_in_shadow_ends_with_the_process_in_charge() {
    repeat_when_late(|| {
        ends_with_the_process_in_charge("shadow");
    });
}

#[test]
fn a_swap_that_lost_its_orchestrator_in_standby_ends_with_the_process_in_charge() {
    repeat_when_late(|| {
        ends_with_the_process_in_charge("standby");
    });
}

#[test]
fn a_start_that_lost_its_orchestrator_is_brought_to_its_end() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.launch(&[&["run", "--quiet", "--out", "out"], &SHORT_FREE[..]].concat(), &[]);
        system.wait_until("some process", |system| !system.processes().is_empty());
        system.wait_until("it was written down", |system| {
            system.find().is_some_and(|domain| domain.folder().contains(runtime::PROCESSES_FILE))
        });
        system.kill_orchestrator();
        system.adopt(&[]);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert_eq!((system.report().outcome, system.report().scans.unaccounted), (Outcome::Reached, 0));
        system.assert_nothing_left();
    });
}

#[test]
fn status_and_stop_work_without_an_orchestrator() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["corridor"]);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        let status = orphaned_status(&system);
        assert_eq!((status.state.as_str(), status.scenario.as_str()), ("driverless", "corridor"));
        assert!(status.scan > 3);
        for process in &status.processes {
            assert_eq!(process.state.name(), "ready", "{process:?}");
            assert!(
                process.memory_kib > 1000 && process.rate_hz > 5.0 && process.cpu_percent < 100.0,
                "{process:?}"
            );
        }
        let roles: Vec<&str> = status.processes.iter().map(|process| process.role.name()).collect();
        assert_eq!(roles, ["robot", "estimator", "obstacles", "controller", "actuator"]);
        let stopped = system.run(&["stop"]);
        assert_eq!(stopped.status.code(), Some(0), "{}", stderr(&stopped));
        let last = watch.wait_for(&system, "it rests", |truth| truth.speed_mps <= 0.0);
        assert_eq!((last.blocked, last.speed_mps, last.collided), (1, 0.0, 0));
        assert!(last.longest_blind_s <= MAX_BLIND_S);
        drop(watch);
        system.assert_nothing_left();
        assert_eq!(system.run(&["stop"]).status.code(), Some(2));
        assert_eq!(system.run(&["status"]).status.code(), Some(2));
    });
}

#[test]
fn a_new_run_stops_the_robot_of_an_old_one_first() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["corridor"]);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        let new = system.run(&["run", "--quiet", "--out", "new", "--lockstep", "free"]);
        assert_eq!(new.status.code(), Some(0), "{}", stderr(&new));
        assert!(stderr(&new).contains("an earlier run lost its orchestrator"), "{}", stderr(&new));
        let last = watch.newest().unwrap();
        assert_eq!((last.blocked, last.speed_mps), (1, 0.0));
        system.assert_nothing_left();
    });
}

#[test]
fn without_an_adoption_the_robot_rests_and_everything_ends_and_is_cleaned_up() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["endless", "--set", "orphan_timeout_s=2"]);
        watch.wait_for(&system, "it drives meanwhile", |truth| truth.speed_mps > 0.5);
        watch.wait_for(&system, "it rests", |truth| truth.blocked == 1 && truth.speed_mps == 0.0);
        system.wait_until("all processes have ended", |system| system.processes().is_empty());
        let last = watch.newest().unwrap();
        assert_eq!((last.blocked, last.collided), (1, 0));
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn an_orphan_that_hangs_is_killed_by_the_last_one_to_end() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["endless", "--set", "orphan_timeout_s=1"]);
        drop(watch);
        let controller = pid_of(&orphaned_status(&system), Role::Controller);
        system.signal(controller, Signal::STOP);
        system.wait_until("all processes have ended", |system| system.processes().is_empty());
        system.assert_nothing_left();
    });
}

#[test]
fn without_anyone_but_actuator_and_robot_the_wheels_are_blocked_within_two_scans() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["corridor"]);
        let status = orphaned_status(&system);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        for role in [Role::Estimator, Role::Obstacles, Role::Controller] {
            system.signal(pid_of(&status, role), Signal::KILL);
        }
        let blocked = watch.wait_for(&system, "blocked wheels", |truth| truth.blocked == 1);
        assert!(blocked.header.scan_id <= blocked.actuation_scan + 2, "{blocked:?}");
        assert_eq!((blocked.dead_man, blocked.collided), (0, 0), "the actuator did it");
        assert!(blocked.longest_blind_s <= MAX_BLIND_S, "{blocked:?}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.assert_nothing_left();
    });
}

#[test]
fn without_the_actuator_the_robot_blocks_its_wheels_itself() {
    repeat_when_late(|| {
        let (system, watch) = orphaned(&["corridor"]);
        let actuator = pid_of(&orphaned_status(&system), Role::Actuator);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        system.signal(actuator, Signal::KILL);
        let blocked = watch.wait_for(&system, "blocked wheels", |truth| truth.blocked == 1);
        assert!(blocked.header.scan_id <= blocked.actuation_scan + 3, "{blocked:?}");
        assert_eq!((blocked.dead_man, blocked.collided), (1, 0));
        assert!(blocked.longest_blind_s <= MAX_BLIND_S, "{blocked:?}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.assert_nothing_left();
    });
}

/// The built-in system with a controller that does `what`, and some keys more in its entry.
fn with_faulty_controller(system: &TestSystem, what: &[&str], keys: &str) -> String {
    let path = system.folder().join("system.toml");
    let command: Vec<String> = what.iter().map(|argument| format!("{argument:?}")).collect();
    let roles =
        [("robot", "emulator"), ("estimator", "ekf"), ("obstacles", "ellipses"), ("actuator", "actuation")];
    let mut text = String::new();
    for (role, implementation) in roles {
        text += &format!("[[process]]\nrole = \"{role}\"\nimplementation = \"{implementation}\"\n");
    }
    text += &format!("[[process]]\nrole = \"controller\"\ncommand = [{}]\n{keys}\n", command.join(", "));
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Runs with such a controller until the run fails because of it; returns standard error.
fn fails(what: &[&str], keys: &str) -> String {
    let mut system = TestSystem::new(EXECUTABLE);
    let file = with_faulty_controller(&system, what, keys);
    system.launch(&["run", "--quiet", "--out", "out", "endless", "--system", &file], &[]);
    assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
    let report = system.report();
    assert_eq!((report.outcome, report.drive.final_speed_mps), (Outcome::Failed, 0.0));
    assert_eq!(report.processes[Role::Controller.index()].state, "failed");
    assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
    system.assert_nothing_left();
    system.stderr()
}

#[test]
fn a_process_that_is_ready_and_dies_again_and_again_ends_the_run() {
    repeat_when_late(|| {
        let printed = fails(&[FAULTY, "exit-after", "2"], "restart_limit = 2\nrestart_window_s = 30.0");
        assert!(printed.contains("died 3 times within 30 s, last: exit code 1"), "{printed}");
    });
}

#[test]
fn a_process_that_publishes_nothing_ends_the_run() {
    repeat_when_late(|| {
        let printed = fails(&[FAULTY, "mute"], "start_limit = 2\nstart_timeout_s = 0.6");
        assert!(
            printed.contains("died 2 times before its first output, last: had no output within 600 ms"),
            "{printed}"
        );
    });
}
