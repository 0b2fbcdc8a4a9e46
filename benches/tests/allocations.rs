//! A solve allocates nothing once its buffers have grown to the size of its problems, a scanner's driver nothing per
//! scan, and the estimator nothing in a drive.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../../services/ocp/tests/problems/mod.rs"]
mod problems;

use emulator::scenario::Preset;
use emulator::{Emulator, Scenario};
use estimator::{Estimator, EstimatorConfig};
use laboratory::{CountingAllocator, allocations};
use ocp::{Budget, Hessian, Problem, Solution, Solver, SolverSettings, Trajectory};
use problems::random;
use shared_types::{Actuation, ActuationKind, Header, Odometry, Role, Scan, Truth};
use urg::{DeviceFault, ScannerConfig, ScannerEmulator, ScannerPlace, ScannerSession};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Allocations of the solves of `problems`, after those of `warm_up` in the same solver.
fn count(
    settings: SolverSettings,
    warm_up: &[(Problem, Trajectory)],
    problems: &[(Problem, Trajectory)],
) -> u64 {
    let mut solver = Solver::new(settings);
    let mut solution = Solution::default();
    let budget = Budget::Iterations(60);
    for (problem, guess) in warm_up {
        solver.solve_into(problem, guess, &budget, &mut solution);
    }
    let before = allocations();
    for (problem, guess) in problems {
        solver.solve_into(problem, guess, &budget, &mut solution);
    }
    let after = allocations();
    assert_eq!(solver.fallbacks(), 0, "the interior-point method allocates: {:?}", settings.hessian);
    after - before
}

#[test]
fn a_solve_allocates_nothing_after_warm_up() {
    let problems: Vec<_> = (0..500).map(random).collect();
    // Numbers of ellipses and of active constraints vary; fifty problems have met what the others need.
    for hessian in [Hessian::GaussNewton, Hessian::Bfgs, Hessian::Exact] {
        let settings = SolverSettings { hessian, ..SolverSettings::default() };
        assert_eq!(count(settings, &problems[..50], &problems[50..]), 0, "{hessian:?}");
    }
    // Stage by stage the memory is that of the largest number of equations, which seldom comes: all have been met.
    let settings = SolverSettings { condense_up_to: 0, ..SolverSettings::default() };
    assert_eq!(count(settings, &problems, &problems), 0);
    // The counter does count.
    let before = allocations();
    drop(std::hint::black_box(vec![1]));
    assert_eq!(allocations(), before + 1);
}

/// The bytes of an emulated scanner in pieces of at most 500, each with its time, until `end_ms`.
fn deliver(
    session: &mut ScannerSession,
    emulator: &mut ScannerEmulator,
    begin_ms: u64,
    end_ms: u64,
) -> (u64, u64) {
    let (mut scans, mut allocated) = (0, 0);
    let mut scan = Scan::default();
    for now_ns in (begin_ms..end_ms).map(|ms| ms * 1_000_000) {
        session.poll(now_ns);
        emulator.receive(session.output(), now_ns);
        session.sent(usize::MAX);
        emulator.advance(now_ns);
        let bytes: Vec<u8> = emulator.output().drain(..).collect();
        let before = allocations();
        for piece in bytes.chunks(500) {
            let mut taken = 0;
            while taken < piece.len() {
                let (count, reading) = session.receive(&piece[taken..], now_ns, &mut scan).unwrap();
                taken += count;
                scans += u64::from(reading.is_some());
            }
        }
        allocated += allocations() - before;
    }
    (scans, allocated)
}

#[test]
fn a_scan_of_a_scanner_allocates_nothing_after_the_start() {
    let mut session = ScannerSession::new(ScannerConfig::new(ScannerPlace::parse("/dev/none").unwrap()));
    let mut emulator = ScannerEmulator::in_a_room(0);
    session.connected(0);
    let (scans, allocated) = deliver(&mut session, &mut emulator, 0, 3_000);
    assert!(
        scans > 10 && allocated > 0,
        "{scans} scans, {allocated} allocations: the start reads parameters"
    );
    // Damaged ones as well.
    emulator.inject(DeviceFault::Checksum, 3_000_000_000);
    let (scans, allocated) = deliver(&mut session, &mut emulator, 3_000, 60_000);
    assert!(scans > 560, "{scans}");
    assert_eq!(allocated, 0);
}

/// Allocations of the estimator, by steps and by scans, in a drive straight ahead after 30 scans.
fn of_estimator(name: &str, preset: Preset) -> [u64; 2] {
    const PERIOD_NS: u64 = 100_000_000;
    let mut scenario = Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap();
    scenario.robot.preset = preset;
    let config = EstimatorConfig { track: scenario.track, ..EstimatorConfig::default() };
    let mut estimator = Estimator::new(&config).unwrap();
    let mut robot = Emulator::new(&scenario, PERIOD_NS);
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    let mut allocated = [0; 2];
    for scan_id in 1..=100 {
        let now_ns = robot.scan_ready_ns(scan_id);
        robot.advance_to(now_ns);
        robot.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        let acquired_ns = robot.acquired_ns(scan_id);
        let header = Header { scan_id, sequence: scan_id, acquired_ns, ..Header::default() };
        (scan.header, odometry.header) = (header, header);
        let begun = allocations();
        let pose = estimator.step(&odometry, None, now_ns).unwrap();
        let stepped = allocations();
        estimator.see(&scan);
        if scan_id > 30 {
            allocated = [allocated[0] + stepped - begun, allocated[1] + allocations() - stepped];
        }
        let mut sent = Actuation {
            header: pose.header,
            kind: ActuationKind::Drive.wire(),
            answers: 1,
            desired_velocity_mps: 0.5,
            sent_velocity_mps: 0.7,
            ..Actuation::default()
        };
        sent.header.stage_mut(Role::Actuator).published_ns = now_ns;
        estimator.note(&sent, now_ns);
        robot.actuate(&sent);
    }
    assert!(truth.x_m > 2.0, "{truth:?}");
    allocated
}

#[test]
fn the_estimator_allocates_nothing_in_a_drive() {
    for name in ["corridor", "crossing", "noisy", "imperfect-robot", "walls"] {
        for preset in [Preset::Ideal, Preset::Summit] {
            assert_eq!(of_estimator(name, preset), [0; 2], "{name} {preset:?}");
        }
    }
}
