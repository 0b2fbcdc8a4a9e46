//! Robot and actuator on another host than the orchestrator: the wheels are blocked there, without a network.

use runtime::{Bus, Observer, monotonic_ns};
use scanloop_tests::SHORTENED_LONG;
use scanloop_tests::machine::repeat_when_late;
use shared_types::{Actuation, ActuationKind, Truth};

use super::*;

const ROBOT: [(Role, &str); 2] = [(Role::Robot, "bot"), (Role::Actuator, "bot")];

/// One scan period and a half, and what a busy machine delays a process by [ns].
const BLOCK_LIMIT_NS: u64 = 150_000_000 + 60_000_000;

/// What the wheels do on the host of the robot, by observers of its bus.
struct Wheels {
    actuations: Observer<Actuation>,
    truths: Observer<Truth>,
    _bus: Bus,
}

impl Wheels {
    fn of(id: &str) -> Self {
        let bus = Bus::open(&Domain::existing(id).unwrap(), "test").unwrap();
        let wheels = Self {
            actuations: Observer::new(&bus).unwrap(),
            truths: Observer::new(&bus).unwrap(),
            _bus: bus,
        };
        wheels.actuations.connect();
        wheels.truths.connect();
        wheels
    }

    /// When the first actuation was published that blocks, of those since the last call [ns].
    fn first_block_ns(&self) -> Option<u64> {
        let mut first = None;
        self.actuations
            .poll(|actuation| {
                if actuation.kind == ActuationKind::Block.wire() {
                    first.get_or_insert(actuation.header.stage(Role::Actuator).published_ns);
                }
            })
            .unwrap();
        first
    }

    /// The newest true speed since the last call [m/s].
    fn speed_mps(&self) -> Option<f64> {
        let mut newest = None;
        self.truths.poll(|truth| newest = Some(truth.speed_mps)).unwrap();
        newest
    }
}

#[test]
fn a_robot_on_another_host_is_driven_from_here_and_lands() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("a robot on another host", &ROBOT) else { return };
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        hosts.system.wait_until_driving();
        for role in [Role::Robot, Role::Actuator] {
            assert!(process_of(&hosts.other_id(), role).is_some(), "{role} does not run there");
        }
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        assert!(report.drive.final_distance_m < 0.1, "{:?}", report.drive);
        hosts.end();
    });
}

#[test]
fn a_robot_and_a_lab_are_driven_by_an_orchestrator_on_a_third_host() {
    repeat_when_late(|| {
        let lab = [Role::Estimator, Role::Obstacles, Role::Controller].map(|role| (role, "lab"));
        let places = [ROBOT.as_slice(), &lab].concat();
        let Some(mut hosts) = TwoHosts::with("a robot and a lab", &places) else { return };
        hosts.start_agent();
        hosts.start_recorded(&SHORT_FREE);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        hosts.assert_replayed();
        hosts.end();
    });
}

#[test]
fn a_stop_reaches_the_wheels_on_another_host_and_is_confirmed_from_there() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("a stop of a robot on another host", &ROBOT) else { return };
        hosts.start_agent();
        hosts.start(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        let wheels = Wheels::of(&hosts.other_id());
        hosts.system.wait_until("it drives", |_| wheels.speed_mps().is_some_and(|speed| speed > 0.5));
        wheels.first_block_ns();
        let asked_ns = monotonic_ns();
        let output = hosts.system.run(&["stop"]);
        let text = scanloop_tests::printed(&output);
        assert_eq!(output.status.code(), Some(0), "{text}");
        assert!(text.contains("wheels blocked after "), "{text}");
        let blocked_ns = wheels.first_block_ns().expect("a block");
        assert!(blocked_ns > asked_ns && blocked_ns - asked_ns < 400_000_000, "{} ns", blocked_ns - asked_ns);
        assert_eq!(hosts.system.wait().code(), Some(1), "{}", hosts.system.stderr());
        assert_eq!(hosts.system.report().outcome, Outcome::Interrupted);
        hosts.end();
    });
}

#[test]
fn without_the_link_the_actuator_blocks_the_wheels_by_itself_and_the_drive_goes_on_later() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("an outage before a robot on another host", &ROBOT) else {
            return;
        };
        hosts.start_agent();
        hosts.start(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        let wheels = Wheels::of(&hosts.other_id());
        hosts.system.wait_until("it drives", |_| wheels.speed_mps().is_some_and(|speed| speed > 0.5));
        wheels.first_block_ns();
        let link = processes_of_link(hosts.system.id());
        kill_process(link, Signal::STOP).unwrap();
        let cut_ns = monotonic_ns();
        let mut blocked_ns = None;
        // Both topics are polled until the robot rests, so that none of their samples is lost.
        let rests = std::cell::Cell::new(false);
        while !rests.get() {
            blocked_ns = blocked_ns.or(wheels.first_block_ns());
            rests.set(wheels.speed_mps().is_some_and(|speed| speed <= 0.0));
            assert!(monotonic_ns() - cut_ns < 2_000_000_000, "it does not come to rest");
            scanloop_tests::pause();
        }
        let blocked_ns = blocked_ns.or(wheels.first_block_ns()).expect("a block");
        // The last command may have left just before the outage.
        assert!(blocked_ns < cut_ns + BLOCK_LIMIT_NS, "{} ms", (blocked_ns - cut_ns) as f64 * 1e-6);
        kill_process(link, Signal::CONT).unwrap();
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!(report.outcome, Outcome::Reached);
        assert_eq!(report.processes.iter().map(|process| process.restarts).collect::<Vec<_>>(), [0; 5]);
        hosts.end();
    });
}

#[test]
fn after_a_long_outage_the_run_ends_and_the_agent_serves_the_next_one() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("a long outage", &ROBOT) else { return };
        hosts.start_agent();
        let settings = ["--set", "orphan_timeout_s=1"];
        hosts.start(&[&SHORTENED_LONG[..], &settings].concat());
        hosts.system.wait_until_driving();
        let link = processes_of_link(hosts.system.id());
        kill_process(link, Signal::STOP).unwrap();
        hosts.system.wait_until("robot and actuator have ended there", |_| {
            ROBOT.iter().all(|(role, _)| process_of(&hosts.other_id(), *role).is_none())
        });
        kill_process(link, Signal::CONT).unwrap();
        assert_eq!(hosts.system.wait().code(), Some(4), "{} {}", hosts.system.stderr(), hosts.messages());
        assert!(hosts.system.stderr().contains("robot (emulator@bot)"), "{}", hosts.system.stderr());
        hosts.start(&SHORT_FREE);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        hosts.end();
    });
}

#[test]
fn an_agent_that_ends_blocks_the_wheels_and_ends_the_robot_at_rest() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("the end of an agent with a robot", &ROBOT) else { return };
        hosts.start_agent();
        hosts.start(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        let wheels = Wheels::of(&hosts.other_id());
        hosts.system.wait_until("it drives", |_| wheels.speed_mps().is_some_and(|speed| speed > 0.5));
        let robot = process_of(&hosts.other_id(), Role::Robot).unwrap();
        let (_, agent) = &hosts.agents[0];
        kill_process(Pid::from_child(agent), Signal::TERM).unwrap();
        let last_mps = std::cell::Cell::new(f64::NAN);
        hosts.system.wait_until("the robot has ended", |_| {
            if let Some(speed_mps) = wheels.speed_mps() {
                last_mps.set(speed_mps);
            }
            !processes_of(&hosts.other_id()).contains(&robot.as_raw_nonzero().get())
        });
        last_mps.set(wheels.speed_mps().unwrap_or(last_mps.get()));
        assert!(last_mps.get() <= 0.0, "it moved with {} m/s at its end", last_mps.get());
        drop(wheels);
        assert_eq!(hosts.system.wait().code(), Some(4), "{} {}", hosts.system.stderr(), hosts.messages());
        hosts.end();
    });
}

#[test]
fn a_host_that_is_gone_for_good_ends_the_run_and_its_processes_end_by_themselves() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::with("the death of the host of a robot", &ROBOT) else { return };
        hosts.start_agent();
        hosts.start(&[&SHORTENED_LONG[..], &["--set", "orphan_timeout_s=1"]].concat());
        hosts.system.wait_until_driving();
        let (_, agent) = &mut hosts.agents[0];
        agent.kill().unwrap();
        agent.wait().unwrap();
        assert_eq!(hosts.system.wait().code(), Some(4), "{} {}", hosts.system.stderr(), hosts.messages());
        let stderr = hosts.system.stderr();
        assert!(stderr.contains("host bot: nothing came from its agent for 3.0 s"), "{stderr}");
        hosts.system.assert_nothing_left();
        hosts.system.wait_until("its processes have ended", |_| processes_of(&hosts.other_id()).is_empty());
        hosts.agents.clear();
        // An agent that is started again removes what is left, and serves the next run.
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        hosts.end();
    });
}

#[test]
fn a_host_that_stood_still_is_missed_and_comes_back_and_no_old_sample_acts() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a host that stands still") else { return };
        hosts.start_agent();
        hosts.start(&SHORTENED_LONG);
        hosts.system.wait_until_driving();
        // All of the lab: the agent, its link, and the processes.
        let (_, agent) = &hosts.agents[0];
        let agent = Pid::from_child(agent);
        let children = format!("/proc/{0}/task/{0}/children", agent.as_raw_nonzero());
        let children = std::fs::read_to_string(children).unwrap();
        let children = children.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().unwrap()));
        let all: Vec<Pid> = children.chain([agent]).collect();
        assert!(all.len() >= 5, "{all:?}");
        all.iter().for_each(|pid| kill_process(*pid, Signal::STOP).unwrap());
        hosts
            .system
            .wait_until("it is missed", |system| system.stderr().contains("host lab: nothing comes from it"));
        all.iter().for_each(|pid| kill_process(*pid, Signal::CONT).unwrap());
        // Its link has to start anew: the listener of Zenoh may not accept again.
        hosts.system.wait_until("it is back", |system| system.stderr().contains("host lab: connected again"));
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.late), (Outcome::Reached, 0), "{:?}", report.scans);
        hosts.end();
    });
}
