//! Preparation between scans: when it happens, and when it is left out.

use std::cell::RefCell;

use shared_types::{Authority, Directive, Odometry, Phase, Pose, Role};

use super::Lab;
use crate::{Input, Output, Process, Publisher, monotonic_ns, settings_file};

/// Scan period of these tests [ns]: of a rate at which caches get cold.
const PERIOD_NS: u64 = 20_000_000;
/// Lead of the warm-up in them, the largest that is allowed [ns].
const LEAD_NS: u64 = 2_000_000;
/// Scans in which a preparation must have happened: a busy machine wakes a process too late for some.
const SCANS: usize = 100;

/// An estimator in real time, and the robot and the orchestrator that it knows.
struct Stage {
    process: Process,
    odometry: Input<Odometry>,
    _poses: std::rc::Rc<Output<Pose>>,
    robot: Publisher<Odometry>,
    orchestrator: Publisher<Directive>,
    scan_id: u64,
    // Dropped last.
    _lab: Lab,
}

/// One preparation: when it began, and when the input was expected [ns].
type Prepared = (u64, u64);

impl Stage {
    fn new(realtime: &str, clock: &str) -> Self {
        let lab = Lab::new();
        let text = format!(
            "[run]\nperiod_ns = {PERIOD_NS}\nclock = \"{clock}\"\norphan_stop_ns = 60000000000\n\
             orphan_timeout_ns = 60000000000\n[realtime]\nwarm_up_us = {}\n{realtime}",
            LEAD_NS / 1000
        );
        lab.domain.folder().write(&settings_file(Role::Estimator), text.as_bytes()).unwrap();
        let mut process = Process::attach_as(Role::Estimator, lab.domain.clone(), 7).unwrap();
        let (odometry, poses) = (process.input().unwrap(), process.output().unwrap());
        let (orchestrator, robot) = (Publisher::new(lab.bus()).unwrap(), Publisher::new(lab.bus()).unwrap());
        let mut stage = Self { process, odometry, _poses: poses, robot, orchestrator, scan_id: 0, _lab: lab };
        stage.direct(0);
        assert!(stage.process.start().unwrap());
        stage
    }

    fn direct(&mut self, stop: u32) {
        let mut directive = Directive { phase: Phase::Driving.wire(), stop, ..Directive::default() };
        directive.authority[Role::Robot.index()] = Authority { incarnation: 5, ..Authority::default() };
        self.orchestrator.publish(&mut directive, true).unwrap();
    }

    fn publish(&mut self) {
        self.scan_id += 1;
        let mut measured = Odometry::default();
        (measured.header.incarnation, measured.header.scan_id) = (5, self.scan_id);
        measured.header.acquired_ns = monotonic_ns();
        self.robot.publish(&mut measured, true).unwrap();
    }

    /// Takes a new sample, waits until well after the next is expected without one, and returns the preparations.
    fn period(&mut self, work: &dyn Fn(u64)) -> Vec<Prepared> {
        self.publish();
        while self.odometry.take().is_none() {
            self.process.wait(None).unwrap();
        }
        let prepared = RefCell::new(Vec::new());
        let until_ns = monotonic_ns() + PERIOD_NS + LEAD_NS;
        while monotonic_ns() < until_ns {
            let mut prepare = |due_ns| {
                prepared.borrow_mut().push((monotonic_ns(), due_ns));
                work(due_ns);
            };
            self.process.wait_preparing(Some(until_ns), &mut prepare).unwrap();
        }
        prepared.into_inner()
    }

    /// The first period with a preparation, after at most [`SCANS`].
    fn first(&mut self, work: &dyn Fn(u64)) -> Prepared {
        let prepared = (0..SCANS).find_map(|_| self.period(work).first().copied());
        prepared.expect("no preparation")
    }
}

/// Works until a time [ns].
fn work_until(time_ns: u64) {
    while monotonic_ns() < time_ns {
        std::hint::spin_loop();
    }
}

#[test]
fn a_stage_prepares_once_per_scan_shortly_before_the_next_is_expected() {
    let mut stage = Stage::new("", "monotonic");
    let mut count = 0;
    for _ in 0..SCANS {
        let before_ns = monotonic_ns();
        let prepared = stage.period(&|_| {});
        assert!(prepared.len() <= 1, "{prepared:?}");
        for (at_ns, due_ns) in prepared {
            assert!((due_ns - LEAD_NS..due_ns).contains(&at_ns), "{at_ns} for {due_ns}");
            assert!(due_ns >= before_ns + PERIOD_NS * 7 / 8, "{due_ns} after {before_ns}");
            count += 1;
        }
    }
    assert!(count > 0);
}

#[test]
fn nothing_is_prepared_in_simulated_time_when_switched_off_or_for_blocked_wheels() {
    for (realtime, clock, stop) in
        [("", "simulated", 0), ("rehearse = false", "monotonic", 0), ("", "monotonic", 1)]
    {
        let mut stage = Stage::new(realtime, clock);
        stage.direct(stop);
        for _ in 0..10 {
            assert_eq!(stage.period(&|_| {}), [], "{realtime:?} {clock} {stop}");
        }
    }
}

#[test]
fn after_a_preparation_that_took_too_long_the_next_ones_are_left_out_for_three_periods() {
    let mut stage = Stage::new("", "monotonic");
    let (_, due_ns) = stage.first(&|due_ns| work_until(due_ns + 1_000_000));
    let (at_ns, _) = stage.first(&|_| {});
    assert!(at_ns > due_ns + 3 * PERIOD_NS, "{} ms", (at_ns - due_ns) / 1_000_000);
}
