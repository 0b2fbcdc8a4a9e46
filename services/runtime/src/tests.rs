//! Samples through real shared memory: what comes out of an input, and what never does.

mod journal;
mod preparing;
mod queues;
mod reserve;
mod tampering;
mod typed;
mod waking;

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use shared_types::{
    Actuation, Authority, Checkpoint, Command, Directive, Header, Obstacles, Pose, Role, Sample, Topic,
};

use crate::counters::Counters;
use crate::input::{Input, join};
use crate::output::Output;
use crate::shared::Shared;
use crate::{Bus, Clock, Domain, Observer, Process, Publisher};

/// Scan period of all systems here [ns].
const PERIOD_NS: u64 = 1_000_000_000;

static NEXT: AtomicU32 = AtomicU32::new(0);

/// A system of its own in shared memory, removed at the end.
struct Lab {
    bus: Option<Bus>,
    domain: Domain,
}

impl Lab {
    fn new() -> Self {
        let id = format!("u{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let domain = Domain::create(&id).unwrap();
        Self { bus: Some(Bus::create(&domain, PERIOD_NS).unwrap()), domain }
    }

    fn bus(&self) -> &Bus {
        self.bus.as_ref().unwrap()
    }

    /// Settings as the orchestrator writes them, for processes that join.
    fn write_settings(&self) {
        let text = "[run]\nperiod_ns = 1000000000\nclock = \"simulated\"\norphan_stop_ns = 60000000000\n\
                    orphan_timeout_ns = 60000000000\n";
        for role in Role::ALL {
            self.domain.folder().write(&crate::settings_file(*role), text.as_bytes()).unwrap();
        }
    }

    /// What a process of a role shares; the estimator in charge is incarnation 7, the obstacles are 8.
    fn shared(&self, role: Role, incarnation: u32) -> Rc<Shared> {
        let mut directive = Directive::default();
        for (role, incarnation) in [(Role::Estimator, 7), (Role::Obstacles, 8)] {
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        }
        Rc::new(Shared {
            role,
            incarnation,
            guard: crate::guard::Guard::new(role, None),
            notes: crate::journal::Notes::default(),
            tamper: RefCell::default(),
            device: RefCell::default(),
            clock: Clock::simulated(),
            counters: Counters::default(),
            stamps: Cell::default(),
            directive: RefCell::new(directive),
            period_ns: 100_000_000,
            produced: Cell::new(false),
            worked: Cell::new(false),
            expected_ns: Cell::new(0),
            acquired_ns: Cell::new(0),
            known_scan: Cell::default(),
            answered_in_ns: Cell::new([0; 2]),
        })
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        drop(self.bus.take());
        self.domain.remove().unwrap();
    }
}

fn pose(scan_id: u64, x_m: f64) -> Pose {
    let mut pose = Pose { x_m, ..Pose::default() };
    pose.header.scan_id = scan_id;
    // Of a scanner with the period of the processes here.
    pose.header.acquired_ns = scan_id * 100_000_000;
    pose
}

#[test]
fn a_published_sample_wakes_its_reader_and_carries_the_stamps_of_its_stage() {
    let lab = Lab::new();
    let (estimator, controller) = (lab.shared(Role::Estimator, 7), lab.shared(Role::Controller, 9));
    let output = Output::<Pose>::new(lab.bus(), Rc::clone(&estimator)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    input.reader().drain().unwrap();
    estimator.clock.advance_to(42);
    output.publish(&mut pose(3, 1.5)).unwrap();
    assert!(lab.bus().bells().role(Role::Controller).poll() != 0);
    input.reader().drain().unwrap();
    let waiting = input.reader().account();
    assert_eq!((waiting.waiting, waiting.waiting_sum, waiting.open), (1, 1, 1));
    let taken = input.take().unwrap();
    assert_eq!(input.reader().account().waiting, 0);
    assert_eq!((taken.x_m, taken.header.scan_id, taken.header.sequence), (1.5, 3, 1));
    assert_eq!((taken.header.layout, taken.header.incarnation), (Pose::LAYOUT, 7));
    assert_eq!(taken.header.stage(Role::Estimator).published_ns, 42);
    assert!(input.take().is_none());
    assert_eq!(estimator.counters.undelivered.get(), 0);
}

#[test]
fn a_process_can_publish_checkpoints_from_the_moment_it_attaches() {
    let lab = Lab::new();
    lab.write_settings();
    let process = Process::attach_as(Role::Estimator, lab.domain.clone(), 7).unwrap();
    let publisher = lab.bus().publisher(Checkpoint::TYPE).unwrap();
    assert_eq!(publisher.publishers(), 2, "its own and this test's");
    drop(process);
}

#[test]
fn a_directive_does_not_move_the_time_at_which_the_next_input_is_expected() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    controller.clock.advance_to(42);
    controller.taken(Topic::Obstacles, &pose(3, 0.0).header);
    controller.clock.advance_to(44);
    controller.taken(Topic::Directive, &Directive::default().header);
    assert_eq!(controller.expected_ns.get(), 100_000_042);
}

#[test]
fn the_next_input_is_expected_as_far_from_the_last_one_as_that_was_from_the_one_before() {
    let lab = Lab::new();
    let estimator = lab.shared(Role::Estimator, 7);
    let take = |topic, acquired_ns| {
        estimator.taken(topic, &Header { acquired_ns, ..Header::default() });
        estimator.expected_ns.get()
    };
    assert_eq!(take(Topic::Odometry, 1_000_000_000), 100_000_000, "the period of the settings");
    assert_eq!(take(Topic::Actuation, 1_050_000_000), 100_000_000, "it answers odometry");
    assert_eq!(take(Topic::Odometry, 1_098_000_000), 98_000_000);
    assert_eq!(take(Topic::Odometry, 1_350_000_000), 100_000_000, "a gap is no period");
    assert_eq!(take(Topic::Odometry, 1_300_000_000), 100_000_000, "a stamp that jumped back");
}

#[test]
fn bad_foreign_repeated_and_old_samples_never_come_out() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    // Two publishers of one incarnation number their samples alike, as a process that repeats itself does.
    let (mut publisher, mut echo) =
        (Publisher::<Pose>::new(lab.bus()).unwrap(), Publisher::<Pose>::new(lab.bus()).unwrap());
    input.reader().drain().unwrap();
    let say = |publisher: &mut Publisher<Pose>, incarnation, x_m| {
        let mut sample = pose(1, x_m);
        sample.header.incarnation = incarnation;
        publisher.publish(&mut sample, false).unwrap();
        input.reader().drain().unwrap();
        input.take().map(|taken| taken.x_m)
    };
    assert_eq!(say(&mut publisher, 7, 1.0), Some(1.0));
    assert_eq!(say(&mut echo, 7, 2.0), None, "a duplicate");
    assert_eq!(say(&mut publisher, 7, f64::NAN), None, "not a number");
    assert_eq!(say(&mut publisher, 6, 3.0), None, "no authority");
    assert_eq!(say(&mut publisher, 7, 4.0), Some(4.0));
    assert_eq!(say(&mut echo, 7, 5.0), None, "its number has come before");
    assert_eq!(say(&mut echo, 7, 6.0), None, "older than what was taken");
    let account = input.reader().account();
    assert_eq!((account.duplicate, account.reordered), (2, 1));
    assert_eq!((account.invalid, account.foreign, input.reader().dropped()), (1, 1, 1));
    // The publisher's third number came under another incarnation; the echo brought it late.
    assert_eq!((account.missing, account.used, account.open), (0, 2, 0));
    assert_eq!(account.late, shared_types::Span { incarnation: 7, first: 3, last: 3, reserved: 0 });
}

#[test]
fn what_a_restored_state_contains_is_skipped_and_the_newest_replaces_what_is_older() {
    let lab = Lab::new();
    let input = Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap();
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let publish = |scans: std::ops::RangeInclusive<u64>| {
        scans.for_each(|scan| output.publish(&mut pose(scan, scan as f64)).unwrap());
        input.reader().drain().unwrap();
    };
    let replaced = || input.reader().account().replaced;
    assert!(input.next_scan().is_none() && input.reader().is_empty());
    publish(3..=9);
    assert!(input.next_scan() == Some(3) && !input.reader().is_empty());
    input.reader().skip_to(5);
    assert_eq!((input.next_scan(), replaced()), (Some(6), 3));
    input.reader().skip(&|bytes| bytemuck::from_bytes::<Pose>(bytes).x_m < 7.5);
    assert_eq!((input.next_scan(), replaced()), (Some(8), 5));
    assert_eq!(input.take_newest().map(|pose| pose.header.scan_id), Some(9));
    assert_eq!((input.next_scan(), replaced(), input.reader().account().used), (None, 6, 1));
    assert!(input.take_newest().is_none());
}

#[test]
fn an_actuation_is_too_old_for_the_robot_only() {
    let lab = Lab::new();
    let read_by = |role: Role| {
        let mut shared = lab.shared(role, 9);
        Rc::get_mut(&mut shared).unwrap().clock = Clock::Monotonic;
        shared.directive.borrow_mut().authority[Role::Actuator.index()].incarnation = 7;
        (Input::<Actuation>::new(lab.bus(), Rc::clone(&shared)).unwrap(), shared)
    };
    let readers = [Role::Robot, Role::Estimator].map(read_by);
    let mut publisher = Publisher::<Actuation>::new(lab.bus()).unwrap();
    readers.iter().for_each(|(input, _)| input.reader().drain().unwrap());
    let mut block = Actuation::default();
    (block.header.incarnation, block.header.scan_id) = (7, 1);
    block.header.acquired_ns = crate::monotonic_ns() - 400_000_000;
    publisher.publish(&mut block, false).unwrap();
    let taken = readers.each_ref().map(|(input, _)| {
        input.reader().drain().unwrap();
        input.take().is_some()
    });
    assert_eq!(taken, [false, true], "it asks nothing of the estimator, but tells it what the wheels did");
}

/// The outputs whose samples a controller joins, and its inputs.
type Joined = (Output<Pose>, Output<Obstacles>, Input<Pose>, Input<Obstacles>);

fn joined(lab: &Lab, controller: &Rc<Shared>) -> Joined {
    let poses = Output::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let described = Output::new(lab.bus(), lab.shared(Role::Obstacles, 8)).unwrap();
    let pose_input = Input::new(lab.bus(), Rc::clone(controller)).unwrap();
    let obstacle_input = Input::new(lab.bus(), Rc::clone(controller)).unwrap();
    pose_input.reader().drain().unwrap();
    obstacle_input.reader().drain().unwrap();
    (poses, described, pose_input, obstacle_input)
}

#[test]
fn a_join_gives_pairs_of_one_scan_and_counts_what_it_replaced() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let (poses, described, pose_input, obstacle_input) = joined(&lab, &controller);
    for scan_id in 1..=3 {
        poses.publish(&mut pose(scan_id, 0.0)).unwrap();
    }
    let publish = |scan_id| {
        let mut obstacles = Obstacles::default();
        obstacles.header.scan_id = scan_id;
        described.publish(&mut obstacles).unwrap();
        obstacle_input.reader().drain().unwrap();
    };
    pose_input.reader().drain().unwrap();
    assert!(join(&pose_input, &obstacle_input).is_none());
    publish(2);
    let (pose, obstacles) = join(&pose_input, &obstacle_input).unwrap();
    assert_eq!((pose.header.scan_id, obstacles.header.scan_id), (2, 2));
    drop((pose, obstacles));
    publish(3);
    assert_eq!(join(&pose_input, &obstacle_input).unwrap().0.header.scan_id, 3);
    assert_eq!(pose_input.reader().account().replaced, 1);
}

#[test]
fn a_join_gives_all_pairs_that_a_period_is_enough_for_and_else_the_newest() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let (poses, described, pose_input, obstacle_input) = joined(&lab, &controller);
    for scan_id in 1..=6 {
        poses.publish(&mut pose(scan_id, 0.0)).unwrap();
        let mut obstacles = Obstacles::default();
        obstacles.header.scan_id = scan_id;
        described.publish(&mut obstacles).unwrap();
        if scan_id == 3 || scan_id == 6 {
            pose_input.reader().drain().unwrap();
            obstacle_input.reader().drain().unwrap();
            // Three of them take just less than 100 ms, or just not.
            controller.answered_in_ns.set([if scan_id == 3 { 33_333_333 } else { 33_333_334 }; 2]);
            let scans: Vec<u64> = std::iter::from_fn(|| join(&pose_input, &obstacle_input))
                .map(|(pose, _)| pose.header.scan_id)
                .collect();
            assert_eq!(scans, if scan_id == 3 { vec![1, 2, 3] } else { vec![6] });
        }
    }
    assert_eq!((pose_input.reader().account().replaced, obstacle_input.reader().account().replaced), (2, 2));
}

#[test]
fn a_scan_that_would_be_too_old_when_it_is_answered_gives_way_to_the_newest() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let (poses, described, pose_input, obstacle_input) = joined(&lab, &controller);
    controller.clock.advance_to(400_000_000);
    // Ages 290, 280 and 150 ms; 300 are too old. The quicker of two answers promises to catch up with all of them.
    for (scan_id, acquired_ns) in [(1, 110_000_000), (2, 120_000_000), (3, 250_000_000)] {
        let (mut pose, mut obstacles) = (pose(scan_id, 0.0), Obstacles::default());
        obstacles.header.scan_id = scan_id;
        (pose.header.acquired_ns, obstacles.header.acquired_ns) = (acquired_ns, acquired_ns);
        poses.publish(&mut pose).unwrap();
        described.publish(&mut obstacles).unwrap();
    }
    pose_input.reader().drain().unwrap();
    obstacle_input.reader().drain().unwrap();
    let next = || join(&pose_input, &obstacle_input).map(|(pose, _)| pose.header.scan_id);
    controller.answered_in_ns.set([1_000_000, 15_000_000]);
    assert_eq!(next(), Some(2), "answered 5 ms before it is too old");
    controller.answered_in_ns.set([1_000_000, 150_000_000]);
    assert_eq!((next(), next()), (Some(3), None), "the newest is answered whatever its age");
}

#[test]
fn a_sample_is_dropped_when_its_scan_is_too_old_or_lies_in_the_future() {
    let lab = Lab::new();
    let mut controller = Rc::into_inner(lab.shared(Role::Controller, 9)).unwrap();
    controller.clock = Clock::Monotonic;
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::new(controller)).unwrap();
    input.reader().drain().unwrap();
    // Three periods of 100 ms are allowed, before and after.
    let now_ns = crate::monotonic_ns();
    for (scan_id, acquired_ns) in
        [(1, now_ns - 300_000_001), (2, now_ns + 200_000_000), (3, now_ns + 10_000_000_000)]
    {
        let mut pose = pose(scan_id, 0.0);
        pose.header.acquired_ns = acquired_ns;
        output.publish(&mut pose).unwrap();
    }
    assert_eq!(taken(&input), [(2, 7)]);
    assert_eq!(input.reader().account().stale, 2);
    let refusal = input.reader().refusal();
    assert_eq!((refusal.scan_id, refusal.rule), (3, shared_types::Rule::FromTheFuture.wire()));
}

#[test]
fn at_a_high_rate_scans_may_wait_for_a_third_of_the_age_that_is_young_at_any_rate() {
    let lab = Lab::new();
    let shared = lab.shared(Role::Controller, 9);
    let mut shared = Rc::into_inner(shared).unwrap();
    shared.period_ns = 2_000_000;
    // A third of 25 ms is 8.3 ms, more than four periods.
    for (answer_ns, most) in [(600_000, 13), (1_999_999, 4), (2_000_000, 0)] {
        shared.answered_in_ns.set([answer_ns; 2]);
        let catches_up: Vec<bool> = (1..=20).map(|scans| shared.catches_up(scans)).collect();
        assert_eq!(catches_up.iter().filter(|catches_up| **catches_up).count(), most, "{answer_ns}");
        assert!(catches_up[..most].iter().all(|catches_up| *catches_up));
    }
}

#[test]
fn a_process_that_was_stopped_in_the_middle_of_one_answer_is_not_slow() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let commands = Output::<Command>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    let mut now_ns = 1_000_000;
    let mut answer_in = |duration_ns: u64| {
        controller.clock.advance_to(now_ns);
        controller.taken(Topic::Pose, &pose(1, 0.0).header);
        now_ns += duration_ns;
        controller.clock.advance_to(now_ns);
        commands.publish(&mut Command::default()).unwrap();
    };
    answer_in(30_000_000);
    answer_in(500_000_000);
    assert_eq!(controller.answered_in_ns.get(), [30_000_000, 500_000_000]);
    assert!(controller.catches_up(3) && !controller.catches_up(4));
    answer_in(400_000_000);
    assert!(!controller.catches_up(1), "two in a row are");
}

#[test]
fn an_observer_that_never_looks_does_not_stop_the_writer() {
    let lab = Lab::new();
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let lazy = Observer::<Pose>::new(lab.bus()).unwrap();
    lazy.connect();
    for scan_id in 1..=100 {
        output.publish(&mut pose(scan_id, 0.0)).unwrap();
    }
    let mut seen = Vec::new();
    lazy.poll(|sample| seen.push(sample.header.scan_id)).unwrap();
    assert_eq!(seen.last(), Some(&100), "the newest samples are kept");
    assert_eq!(seen.len(), 16, "as many as the buffer holds");
}

/// Changes who counts as estimator, as a new directive does.
fn authorise(reader: &Rc<Shared>, input: &Input<Pose>, incarnation: u32, previous: u32, from_scan: u64) {
    reader.directive.borrow_mut().authority[Role::Estimator.index()] =
        Authority { incarnation, previous, from_scan };
    input.reader().review();
}

/// The scans that come out, each with the incarnation that answers it.
fn taken(input: &Input<Pose>) -> Vec<(u64, u32)> {
    input.reader().drain().unwrap();
    std::iter::from_fn(|| input.take()).map(|pose| (pose.header.scan_id, pose.header.incarnation)).collect()
}

#[test]
fn during_a_swap_each_scan_is_answered_by_the_process_in_charge() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let old = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let new = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 11)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    input.reader().drain().unwrap();
    old.publish(&mut pose(8, 0.0)).unwrap();
    new.publish(&mut pose(8, 0.0)).unwrap();
    assert_eq!(taken(&input), [(8, 7)], "a shadow is not heard");
    authorise(&controller, &input, 11, 7, 10);
    for scan_id in 9..=11 {
        new.publish(&mut pose(scan_id, 0.0)).unwrap();
        old.publish(&mut pose(scan_id, 0.0)).unwrap();
    }
    assert_eq!(taken(&input), [(9, 7), (10, 11), (11, 11)]);
    authorise(&controller, &input, 11, 0, 0);
    old.publish(&mut pose(12, 0.0)).unwrap();
    assert_eq!(taken(&input), [], "the swap is over");
    authorise(&controller, &input, 7, 11, 11);
    assert_eq!(taken(&input), [], "samples of the standby are dropped at its end");
    let account = input.reader().account();
    assert_eq!((account.duplicate, account.reordered, account.missing), (0, 0, 0));
    assert_eq!(
        (account.used, account.foreign, account.open),
        (4, 5, account.waiting),
        "both of 9, 10 and 11"
    );
}

#[test]
fn scans_that_the_new_one_left_open_are_answered_by_the_one_that_stood_by() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let old = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let new = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 11)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    input.reader().drain().unwrap();
    authorise(&controller, &input, 11, 7, 10);
    for scan_id in 9..=13 {
        old.publish(&mut pose(scan_id, 0.0)).unwrap();
        if scan_id <= 11 {
            new.publish(&mut pose(scan_id, 0.0)).unwrap();
        }
    }
    assert_eq!(taken(&input), [(9, 7), (10, 11), (11, 11)]);
    // The orchestrator has not seen the answer to 11 when it gives the scans back.
    authorise(&controller, &input, 7, 11, 11);
    old.publish(&mut pose(14, 0.0)).unwrap();
    assert_eq!(taken(&input), [(12, 7), (13, 7), (14, 7)], "none is missing and none comes twice");
    assert_eq!(input.reader().account().foreign, 3, "the old one's 10 and 11, the new one's 9");
    new.publish(&mut pose(15, 0.0)).unwrap();
    old.publish(&mut pose(15, 0.0)).unwrap();
    assert_eq!(taken(&input), [(15, 7)]);
}

#[test]
fn the_new_one_answers_for_an_old_one_that_died_before_its_time() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let old = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let new = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 11)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    input.reader().drain().unwrap();
    authorise(&controller, &input, 11, 7, 10);
    old.publish(&mut pose(8, 0.0)).unwrap();
    for scan_id in 8..=9 {
        new.publish(&mut pose(scan_id, 0.0)).unwrap();
    }
    assert_eq!(taken(&input), [(8, 7)]);
    authorise(&controller, &input, 11, 7, 9);
    assert_eq!(taken(&input), [(9, 11)]);
}

#[test]
fn a_sample_that_was_numbered_and_never_sent_is_missing_at_the_reader() {
    let lab = Lab::new();
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap();
    input.reader().drain().unwrap();
    for scan_id in 1..=5 {
        let mut pose = pose(scan_id, 0.0);
        output.complete(&mut pose);
        if scan_id != 3 {
            output.send(&mut pose).unwrap();
        }
    }
    assert_eq!(taken(&input).len(), 4);
    let account = input.reader().account();
    assert_eq!((account.missing, account.hole.first, account.hole.last), (1, 3, 3));
}

#[test]
fn what_a_full_buffer_overwrites_is_not_missing() {
    let lab = Lab::new();
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap();
    input.reader().drain().unwrap();
    for scan_id in 1..=40 {
        output.publish(&mut pose(scan_id, 0.0)).unwrap();
        if scan_id == 1 {
            input.reader().drain().unwrap();
        }
    }
    assert_eq!(taken(&input).last(), Some(&(40, 7)));
    let account = input.reader().account();
    assert_eq!((account.overwritten, account.missing), (23, 0), "1 taken, 16 in the buffer");
    assert_eq!((account.replaced, account.used, account.open), (5, 12, 0), "the newest are kept");
}

/// Publishes poses of a foreign incarnation without a pause, from a thread, until dropped.
struct Flood {
    stop: std::sync::Arc<std::sync::atomic::AtomicBool>,
    published: std::sync::Arc<std::sync::atomic::AtomicU64>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Flood {
    fn start(domain: &Domain) -> Self {
        let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let published = std::sync::Arc::new(std::sync::atomic::AtomicU64::new(0));
        let (asked, count) = (std::sync::Arc::clone(&stop), std::sync::Arc::clone(&published));
        let domain = domain.clone();
        let thread = std::thread::spawn(move || {
            let bus = Bus::open(&domain, "flood").unwrap();
            let mut publisher = Publisher::<Pose>::new(&bus).unwrap();
            let mut sample = pose(1, 0.0);
            sample.header.incarnation = 6;
            while !asked.load(Ordering::Acquire) {
                publisher.publish(&mut sample, false).unwrap();
                count.fetch_add(1, Ordering::Release);
            }
        });
        Self { stop, published, thread: Some(thread) }
    }

    /// Waits until it has published more than a reader's buffer holds, however little the scheduler gives it.
    fn fill_the_buffer(&self) {
        let enough = self.published.load(Ordering::Acquire) + 20;
        let deadline = Instant::now() + Duration::from_secs(60);
        while self.published.load(Ordering::Acquire) < enough {
            assert!(Instant::now() < deadline, "the flood publishes");
            std::thread::yield_now();
        }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let ended = self.thread.take().unwrap().join();
        assert!(ended.is_ok() || std::thread::panicking());
    }
}

#[test]
fn a_producer_that_floods_a_topic_keeps_nobody_from_the_samples_that_count() {
    let lab = Lab::new();
    let controller = lab.shared(Role::Controller, 9);
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&controller)).unwrap();
    let observer = Observer::<Pose>::new(lab.bus()).unwrap();
    let flood = Flood::start(&lab.domain);
    while input.reader().account().foreign == 0 {
        input.reader().drain().unwrap();
    }
    // The flood was there first, so the bus asks it first.
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    input.reader().drain().unwrap();
    observer.poll(|_| {}).unwrap();
    let mut seen = 0;
    for scan_id in 1..=500 {
        output.publish(&mut pose(scan_id, 1.0)).unwrap();
        flood.fill_the_buffer();
        input.reader().drain().unwrap();
        let taken = input.take().map(|taken| taken.header.scan_id);
        assert_eq!(taken, Some(scan_id), "each look ends, and it reaches the one that counts");
        observer.poll(|sample| seen += u64::from(sample.header.incarnation == 7)).unwrap();
    }
    assert_eq!(seen, 500);
    let account = input.reader().account();
    assert_eq!((account.missing, account.replaced), (0, 0));
}

#[test]
fn a_number_that_can_not_be_is_dropped_counted_and_named_and_what_follows_counts() {
    let lab = Lab::new();
    let output = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap();
    input.reader().drain().unwrap();
    assert!(!input.reader().is_rung());
    output.publish(&mut pose(1, 0.0)).unwrap();
    assert!(input.reader().is_rung());
    assert_eq!(taken(&input), [(1, 7)]);
    assert!(!input.reader().is_rung());
    for (index, wrong) in [1 << 63, u64::MAX, 1 << 40, 1_001].into_iter().enumerate() {
        let scan_id = 2 + 2 * index as u64;
        let fields: [fn(&mut Header) -> &mut u64; 2] =
            [|header| &mut header.scan_id, |header| &mut header.sequence];
        for field in fields {
            let mut forged = pose(scan_id, 0.0);
            output.complete(&mut forged);
            *field(&mut forged.header) = wrong;
            // A sequence of 1,001 is possible: that costs this sample and the one behind it.
            output.send(&mut forged).unwrap();
        }
        let before = taken(&input).len();
        assert_eq!(before, usize::from(wrong == 1_001), "{wrong}");
        let refusal = input.reader().refusal();
        assert_eq!(refusal.rule, shared_types::Rule::ImpossibleNumber.wire(), "{wrong}");
        output.publish(&mut pose(scan_id, 0.0)).unwrap();
        output.publish(&mut pose(scan_id + 1, 0.0)).unwrap();
        assert_eq!(taken(&input).last(), Some(&(scan_id + 1, 7)), "{wrong}");
    }
    let account = input.reader().account();
    // 2^63, 2^64 - 1 and 2^40 as sequence are not believed; three of 2^63 to 1,001 as scan are dropped for their content.
    assert_eq!((account.unreadable, account.invalid), (3, 4), "{account:?}");
    assert!(account.missing < 10 && account.open == 0, "{account:?}");
}
