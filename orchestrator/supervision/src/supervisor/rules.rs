//! All short traces and random ones: no sequence of events breaks a rule of the simulated world.

use proptest::prelude::*;
use shared_types::{Phase, ProcessState, Role};

use super::world::{Found, World, policies};
use super::{Action, Event, ProcessExit, ProcessPolicy, Supervisor};

const KILLED: ProcessExit = ProcessExit::Signal(9);

/// What can happen next in a run of a robot and a controller.
fn step(world: &mut World, choice: u32) {
    let exit = ProcessExit::Code(1);
    match choice {
        0 => Role::ALL.iter().for_each(|role| world.answer(*role, true)),
        1 => world.answer(Role::Controller, false),
        2 => world.roles().into_iter().for_each(|role| {
            let reached = match world.supervisor.phase() {
                Phase::Starting => ProcessState::Attached,
                Phase::Connecting => ProcessState::Connected,
                _ => ProcessState::Ready,
            };
            world.report(role, reached);
        }),
        3 => world.die(Role::Controller, exit),
        4 => world.die(Role::Robot, exit),
        5 => Role::ALL.iter().for_each(|role| world.clean(*role)),
        6 => {
            world.advance(400);
            world.send(Event::Tick);
        }
        7 => world.send(Event::RestartRequested { role: Role::Controller }),
        _ => world.send(Event::StopRequested),
    }
}

fn explore(world: &World, depth: u32, traces: &mut u32) {
    *traces += 1;
    let mut ended = world.clone();
    ended.bring_down(depth.is_multiple_of(2));
    if depth == 0 {
        return;
    }
    for choice in 0..9 {
        let mut next = world.clone();
        step(&mut next, choice);
        explore(&next, depth - 1, traces);
    }
}

#[test]
fn every_short_trace_keeps_the_rules_and_can_be_ended() {
    let mut traces = 0;
    for (lockstep, driving) in [(false, false), (false, true), (true, false), (true, true)] {
        let two = [Role::Robot, Role::Controller].map(|role| ProcessPolicy::new(role, 100));
        let mut world = World::new(two.into(), lockstep);
        world.send(Event::Start);
        if driving {
            world.bring_up();
        }
        explore(&world, 5, &mut traces);
    }
    // 1 + 9 + 81 + 729 + 6561 + 59049 traces from each of four starts.
    assert_eq!(traces, 4 * 66_430);
}

#[test]
fn every_short_trace_after_an_adoption_keeps_the_rules_and_can_be_ended() {
    let mut traces = 0;
    let found = [Found::Alive, Found::Gone, Found::NeverStarted];
    for phase in Phase::ALL {
        for robot in found {
            for controller in found {
                let two = [Role::Robot, Role::Controller].map(|role| ProcessPolicy::new(role, 100));
                let of = |role| if role == Role::Robot { robot } else { controller };
                let world = World::adopted(two.into(), false, *phase, of);
                explore(&world, 3, &mut traces);
            }
        }
    }
    // 1 + 9 + 81 + 729 traces from each of 4 phases and 9 findings.
    assert_eq!(traces, 36 * 820);
}

/// One thing that the world can do.
#[derive(Debug, Clone)]
enum Deed {
    Answer(Role, bool),
    Report(Role, ProcessState),
    Progress(Role),
    Starve(Role),
    Refuse(Role, Role),
    Die(Role, ProcessExit),
    Clean(Role),
    Wait(u64),
    WaitForDeadline,
    Restart(Role),
    Stop,
    /// Something that belongs to no incarnation alive.
    Stray(Event),
}

fn any_role() -> impl Strategy<Value = Role> {
    prop::sample::select(Role::ALL)
}

fn any_state() -> impl Strategy<Value = ProcessState> {
    prop::sample::select(ProcessState::ALL)
}

fn any_exit() -> impl Strategy<Value = ProcessExit> {
    prop_oneof![(0..3).prop_map(ProcessExit::Code), (1..16).prop_map(ProcessExit::Signal)]
}

fn any_stray() -> impl Strategy<Value = Event> {
    let incarnation = || 1_000_000_u32..;
    prop_oneof![
        (any_role(), incarnation()).prop_map(|(role, incarnation)| Event::Spawned {
            role,
            pid: 7,
            incarnation
        }),
        (any_role(), incarnation()).prop_map(|(role, incarnation)| Event::Progress { role, incarnation }),
        (any_role(), incarnation(), any_state())
            .prop_map(|(role, incarnation, state)| Event::StateReported { role, incarnation, state }),
        (any_role(), incarnation(), any_exit()).prop_map(|(role, incarnation, exit)| Event::Exited {
            role,
            incarnation,
            exit
        }),
        Just(Event::Start),
    ]
}

fn any_deed() -> impl Strategy<Value = Deed> {
    prop_oneof![
        8 => (any_role(), prop::bool::weighted(0.9)).prop_map(|(role, started)| Deed::Answer(role, started)),
        12 => (any_role(), any_state()).prop_map(|(role, state)| Deed::Report(role, state)),
        6 => any_role().prop_map(Deed::Progress),
        2 => any_role().prop_map(Deed::Starve),
        3 => (any_role(), any_role()).prop_map(|(role, reader)| Deed::Refuse(role, reader)),
        6 => (any_role(), any_exit()).prop_map(|(role, exit)| Deed::Die(role, exit)),
        8 => any_role().prop_map(Deed::Clean),
        6 => (0_u64..5_000).prop_map(Deed::Wait),
        4 => Just(Deed::WaitForDeadline),
        2 => any_role().prop_map(Deed::Restart),
        1 => Just(Deed::Stop),
        2 => any_stray().prop_map(Deed::Stray),
    ]
}

fn perform(world: &mut World, deed: Deed) {
    match deed {
        Deed::Answer(role, started) => world.answer(role, started),
        Deed::Report(role, state) => world.report(role, state),
        Deed::Progress(role) => world.progress(role),
        Deed::Starve(role) => {
            let incarnation = world.incarnation(role);
            world.send(Event::Starved { role, incarnation });
        }
        Deed::Refuse(role, reader) => world.refuse(role, reader),
        Deed::Die(role, exit) => world.die(role, exit),
        Deed::Clean(role) => world.clean(role),
        Deed::Wait(milliseconds) => {
            world.advance(milliseconds);
            world.send(Event::Tick);
        }
        Deed::WaitForDeadline => {
            if let Some(deadline_ns) = world.supervisor.next_deadline() {
                world.now_ns = world.now_ns.max(deadline_ns);
                world.send(Event::Tick);
            }
        }
        Deed::Restart(role) => world.send(Event::RestartRequested { role }),
        Deed::Stop => world.send(Event::StopRequested),
        Deed::Stray(event) => world.send(event),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_run_breaks_the_rules_and_each_can_be_ended(
        deeds in prop::collection::vec(any_deed(), 0..120),
        driving: bool,
        lockstep in prop::bool::weighted(0.2),
        obedient: bool,
    ) {
        let mut world = World::new(policies(), lockstep);
        world.send(Event::Start);
        if driving {
            world.bring_up();
        }
        for deed in deeds {
            perform(&mut world, deed);
        }
        world.bring_down(obedient);
    }

    #[test]
    fn no_adopted_run_breaks_the_rules_and_each_can_be_ended(
        deeds in prop::collection::vec(any_deed(), 0..80),
        found in prop::array::uniform5(prop::sample::select(vec![
            Found::Alive, Found::Alive, Found::Alive, Found::Gone, Found::NeverStarted,
        ])),
        phase in prop::sample::select(Phase::ALL),
        lockstep in prop::bool::weighted(0.2),
        obedient: bool,
    ) {
        let mut world = World::adopted(policies(), lockstep, phase, |role| found[role.index()]);
        for deed in deeds {
            perform(&mut world, deed);
        }
        world.bring_down(obedient);
    }

    #[test]
    fn a_run_that_did_not_fail_drives_again_once_all_goes_well(
        deeds in prop::collection::vec(any_deed(), 0..60),
    ) {
        let mut world = World::driving();
        for deed in deeds {
            perform(&mut world, deed);
        }
        world.bring_up();
        let phase = world.supervisor.phase();
        prop_assert!(world.stopping || phase == Phase::Driving);
        prop_assert_eq!(world.stopping, phase == Phase::Stopping || world.failure.is_some());
    }

    /// Events in any order, also such as no caller would send: what is asked for stays in order.
    #[test]
    fn nonsense_never_starts_a_second_process(
        events in prop::collection::vec((any_role(), 0_u32..12, any_state(), 0_u32..9, 0_u64..3_000), 0..200),
    ) {
        let mut supervisor = Supervisor::new(policies());
        let (mut now_ns, mut last, mut stopped, mut open) = (0, 0, false, [false; shared_types::ROLES]);
        for (role, incarnation, state, kind, pause_ms) in events {
            now_ns += pause_ms * 1_000_000;
            let event = match kind {
                0 => Event::Start,
                1 => Event::Spawned { role, pid: 1, incarnation },
                2 => Event::SpawnFailed { role, error: String::new() },
                3 => Event::StateReported { role, incarnation, state },
                4 => Event::Exited { role, incarnation, exit: KILLED },
                5 => Event::CleanedUp { role },
                6 => Event::RestartRequested { role },
                7 if incarnation == 0 => Event::StopRequested,
                _ => Event::Tick,
            };
            stopped |= event == Event::StopRequested;
            if matches!(event, Event::Exited { .. } | Event::SpawnFailed { .. }) {
                open[role.index()] = false;
            }
            for action in supervisor.handle(now_ns, event) {
                if let Action::Spawn { role, incarnation } = action {
                    prop_assert!(!stopped && incarnation > last && !open[role.index()]);
                    open[role.index()] = true;
                    last = incarnation;
                }
                prop_assert!(action != Action::AllStopped || supervisor.is_finished());
            }
        }
    }
}

#[test]
fn once_a_run_has_failed_a_first_output_is_not_waited_for() {
    let mut world = World::adopted(policies(), false, Phase::Driving, |_| Found::Alive);
    world.advance(7_876);
    world.send(Event::Tick);
    world.die(Role::Estimator, ProcessExit::Code(0));
    assert!(world.failure.is_some());
    world.actions.clear();
    world.advance(2_124);
    world.send(Event::Tick);
    assert_eq!(world.actions, [], "the start time-out is over, but the robot is brought to rest first");
    world.bring_down(true);
}
