//! Waking: no published sample is slept through, for every kind of publisher and subscriber.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use signal_hook::consts::SIGUSR1;

use super::typed::{Wire, publisher, subscriber};
use super::{Lab, pose};
use crate::bell::bit;
use crate::process::MAX_WAIT_NS;
use crate::*;
use shared_types::{Authority, Directive, Obstacles, Odometry, Phase, Pose, Role, Sample, Topic};

/// Samples that each of two publishers hammers onto one topic.
const HAMMERED: u64 = 100_000;
/// Lost wake-ups that are enough to know.
const MANY: u64 = 20;
/// What a lost wake-up would cost in these tests [ns].
const LONG_NS: u64 = 2_000_000_000;

/// What one publisher and the reader know of each other.
struct Lane {
    /// When publishing each sample was over, waking included; 0 before [ns].
    done_ns: Vec<AtomicU64>,
    /// The newest sample that was read.
    read: AtomicU64,
}

impl Lane {
    fn new() -> Self {
        Self { done_ns: (0..=HAMMERED).map(|_| AtomicU64::new(0)).collect(), read: AtomicU64::new(0) }
    }

    /// Publishes all samples, in bursts of one to four. After each it waits until the reader has got them, so that a
    /// wake-up that is lost is not made good by the next sample; and a random time, so that the two publishers and the
    /// reader meet at all moments.
    fn hammer(&self, seed: u64, mut publish: impl FnMut(u64)) {
        let (mut random, mut burst) = (seed, 1);
        for number in 1..=HAMMERED {
            publish(number);
            self.done_ns[number as usize].store(monotonic_ns(), Ordering::SeqCst);
            burst -= 1;
            if burst > 0 {
                continue;
            }
            while self.read.load(Ordering::SeqCst) < number {
                std::thread::yield_now();
            }
            burst = 1 + (next(&mut random) >> 62);
            spin(next(&mut random) % 3000);
        }
    }
}

/// The next of a sequence of random numbers, of which the upper bits are good.
fn next(random: &mut u64) -> u64 {
    *random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *random >> 32 << 32 | *random >> 32
}

/// Works for a time [ns].
fn spin(time_ns: u64) {
    let until = monotonic_ns() + time_ns;
    while monotonic_ns() < until {
        std::hint::spin_loop();
    }
}

/// What came of two publishers hammering one reader.
#[derive(Debug, Default)]
struct Hammering {
    /// Sleeps that did not last to their time-out.
    woken: u64,
    /// Sleeps to the time-out although a sample had been published, waking included, before that time.
    overslept: u64,
}

/// Lets the publishers end, also when the reader fails.
struct Release<'a>(&'a [Lane; 2], &'a AtomicBool);

impl Drop for Release<'_> {
    fn drop(&mut self) {
        self.0.iter().for_each(|lane| lane.read.store(HAMMERED, Ordering::SeqCst));
        self.1.store(true, Ordering::SeqCst);
    }
}

/// Lets two threads hammer one reader that gives up a sleep after `timeout_ns`; ends early when it overslept too
/// often.
///
/// The reader sleeps, tells of each sample who sent it and its number, and returns whether it was woken.
fn hammer<P: FnMut(u64, u32)>(
    lab: &Lab,
    timeout_ns: u64,
    publisher: impl Fn(&Bus) -> P + Sync,
    mut reader: impl FnMut(&mut dyn FnMut(u32, u64)) -> bool,
) -> Hammering {
    let lanes = [Lane::new(), Lane::new()];
    let (ready, over) = (AtomicU64::new(0), AtomicBool::new(false));
    let (mut result, mut random) = (Hammering::default(), 7);
    std::thread::scope(|scope| {
        for (who, lane) in lanes.iter().enumerate() {
            let (domain, publisher, ready, over) = (&lab.domain, &publisher, &ready, &over);
            scope.spawn(move || {
                let bus = Bus::open(domain, "hammer").unwrap();
                let mut publish = publisher(&bus);
                ready.fetch_add(1, Ordering::SeqCst);
                while ready.load(Ordering::SeqCst) < 3 {
                    std::thread::yield_now();
                }
                lane.hammer(who as u64, |number| publish(number, who as u32));
                // What was published lies in memory of this thread until it was read.
                while !over.load(Ordering::SeqCst) {
                    std::thread::yield_now();
                }
            });
        }
        while ready.load(Ordering::SeqCst) < 2 {
            std::thread::yield_now();
        }
        ready.fetch_add(1, Ordering::SeqCst);
        let _release = Release(&lanes, &over);
        while lanes.iter().any(|lane| lane.read.load(Ordering::SeqCst) < HAMMERED) {
            // A reader that works before it sleeps again: whatever comes meanwhile must not be slept through.
            spin(next(&mut random) % 3000);
            let before = monotonic_ns();
            let mut late = false;
            let awake = reader(&mut |who, number| {
                let lane = &lanes[who as usize];
                let done_ns = lane.done_ns[number as usize].load(Ordering::SeqCst);
                late |= done_ns > 0 && done_ns < before + timeout_ns;
                lane.read.store(number, Ordering::SeqCst);
            });
            result.woken += u64::from(awake);
            result.overslept += u64::from(!awake && late);
            if result.overslept > MANY {
                break;
            }
        }
    });
    result
}

/// A reader of poses that sleeps as observers do.
fn observe(lab: &Lab, timeout_ns: u64) -> impl FnMut(&mut dyn FnMut(u32, u64)) -> bool {
    let observer = Observer::<Pose>::waking(lab.bus()).unwrap();
    move |each| {
        let awake = observer.wait(timeout_ns);
        observer.poll(|pose| each(pose.header.incarnation, pose.header.scan_id)).unwrap();
        awake
    }
}

#[test]
fn two_writers_who_hammer_one_reader_never_let_it_sleep_through_a_sample() {
    let lab = Lab::new();
    let publisher = |bus: &Bus| {
        let mut publisher = Publisher::<Pose>::new(bus).unwrap();
        move |number, who| {
            let mut sample = pose(number, 0.0);
            sample.header.incarnation = who;
            publisher.publish(&mut sample, true).unwrap();
        }
    };
    let result = hammer(&lab, LONG_NS, publisher, observe(&lab, LONG_NS));
    assert_eq!(result.overslept, 0, "{result:?}");
}

#[test]
fn a_process_never_sleeps_through_a_sample_of_its_two_inputs() {
    let lab = Lab::new();
    lab.write_settings();
    let mut process = Process::attach_as(Role::Controller, lab.domain.clone(), 9).unwrap();
    let (obstacles, poses) = (process.input::<Obstacles>().unwrap(), process.input::<Pose>().unwrap());
    let mut directive = Directive { phase: Phase::Driving.wire(), ..Directive::default() };
    for role in [Role::Estimator, Role::Obstacles] {
        directive.authority[role.index()] = Authority { incarnation: 7, ..Authority::default() };
    }
    let mut orchestrator = Publisher::new(lab.bus()).unwrap();
    orchestrator.publish(&mut directive, true).unwrap();
    assert!(process.start().unwrap());
    let publisher = |bus: &Bus| {
        let (mut described, mut poses) =
            (Publisher::<Obstacles>::new(bus).unwrap(), Publisher::<Pose>::new(bus).unwrap());
        let (mut seen, mut pose) = (Obstacles::default(), Pose::default());
        move |number, who| {
            let header = if who == 0 { &mut seen.header } else { &mut pose.header };
            (header.incarnation, header.scan_id) = (7, number);
            if who == 0 { described.publish(&mut seen, true) } else { poses.publish(&mut pose, true) }
                .unwrap();
        }
    };
    let result = hammer(&lab, MAX_WAIT_NS, publisher, |each| {
        let timeouts = process.timeouts();
        process.wait(None).unwrap();
        while let Some(seen) = obstacles.take() {
            each(0, seen.header.scan_id);
        }
        while let Some(pose) = poses.take() {
            each(1, pose.header.scan_id);
        }
        process.timeouts() == timeouts
    });
    assert_eq!(result.overslept, 0, "{result:?}");
}

#[test]
fn a_wake_up_that_the_plain_events_lose_is_healed_by_the_time_out() {
    let lab = Lab::new();
    // The last sample of each writer arrives, so each sleep has ended, whatever was lost.
    let publisher = |bus: &Bus| {
        let plain = Plain::<Pose, Pose>::new(bus);
        move |number, who| {
            let mut sample = pose(number, 0.0);
            sample.header.incarnation = who;
            plain.publish(sample);
        }
    };
    let result = hammer(&lab, 20_000_000, publisher, observe(&lab, 20_000_000));
    println!("{result:?}");
    assert!(result.woken > 0, "the events are heard: {result:?}");
}

#[test]
fn a_thread_of_the_process_ends_its_sleep_and_the_next_one() {
    let lab = Lab::new();
    lab.write_settings();
    let mut process = Process::attach_as(Role::Estimator, lab.domain.clone(), 7).unwrap();
    let waker = process.waker();
    // The first wait only notes the bell.
    assert!(process.wait(Some(0)).unwrap());
    std::thread::spawn(move || waker.wake()).join().unwrap();
    let begun_ns = monotonic_ns();
    assert!(process.wait(Some(begun_ns + LONG_NS)).unwrap());
    assert!(monotonic_ns() - begun_ns < MAX_WAIT_NS / 2, "it slept until its own limit");
}

#[test]
fn a_signal_at_any_moment_ends_the_sleep() {
    let lab = Lab::new();
    let shutdown = Shutdown::on(&[SIGUSR1]).unwrap();
    let bells = lab.bus().bells();
    shutdown.ring_also(bells, Role::Actuator).unwrap();
    let bell = bells.role(Role::Actuator);
    let seen = bell.poll();
    assert!(!bell.sleep(seen, monotonic_ns() + 1_000_000, bit(Topic::Pose)), "nothing has happened");
    assert!(!shutdown.requested());
    // Between the look and the sleep: the moment at which a flag alone would be missed.
    signal_hook::low_level::raise(SIGUSR1).unwrap();
    assert!(bell.sleep(seen, monotonic_ns() + LONG_NS, bit(Topic::Pose)));
    assert!(shutdown.requested());
}

#[test]
fn a_sleeper_that_was_killed_stays_counted_and_disturbs_nobody() {
    let lab = Lab::new();
    let bell = lab.bus().bells().role(Role::Controller);
    bell.leak_a_sleeper(Topic::Pose);
    let seen = bell.poll();
    assert!(!bell.sleep(seen, monotonic_ns() + 1_000_000, bit(Topic::Pose)));
    lab.bus().bells().ring(Topic::Pose);
    assert!(bell.sleep(seen, monotonic_ns() + LONG_NS, bit(Topic::Pose)));
}

#[test]
fn only_readers_of_a_topic_are_rung_and_everyone_for_a_directive() {
    let lab = Lab::new();
    let bells = lab.bus().bells();
    let looks = || Role::ALL.iter().map(|role| bells.role(*role).poll()).collect::<Vec<_>>();
    bells.ring(Topic::Pose);
    assert_eq!(looks(), [0, 0, 1, 1, 0], "obstacles and controller");
    bells.ring(Topic::Directive);
    assert_eq!(looks(), [1, 1, 2, 2, 1]);
    bells.ring(Topic::Truth);
    assert_eq!(looks(), [1, 1, 2, 2, 1]);
}

/// A process that uses the bus's own events only, as one in another language does.
struct Plain<W: Sample, R: Sample> {
    publisher: iceoryx2::port::publisher::Publisher<ipc::Service, Wire<W>, ()>,
    notifier: Notifier<ipc::Service>,
    subscriber: Subscriber<ipc::Service, Wire<R>, ()>,
    listener: Listener<ipc::Service>,
}

impl<W: Sample, R: Sample> Plain<W, R> {
    fn new(bus: &Bus) -> Self {
        Self {
            publisher: publisher(bus),
            notifier: bus.events(W::TOPIC.name()).unwrap().notifier_builder().create().unwrap(),
            subscriber: subscriber(bus),
            listener: bus.events(R::TOPIC.name()).unwrap().listener_builder().create().unwrap(),
        }
    }

    fn publish(&self, mut sample: W) {
        sample.header_mut().layout = W::LAYOUT;
        self.publisher.loan_uninit().unwrap().write_payload(Wire(sample)).send().unwrap();
        self.notifier.notify().unwrap();
    }

    /// The next sample that `wanted` accepts, and how many waits ran to their end before it came.
    fn wait_for(&self, wanted: impl Fn(&R) -> bool) -> (R, u32) {
        let mut timeouts = 0;
        loop {
            while let Some(sample) = self.subscriber.receive().unwrap() {
                if wanted(&sample.payload().0) {
                    return (sample.payload().0, timeouts);
                }
            }
            let woken = self.listener.timed_wait(|_| {}, Duration::from_millis(100)).unwrap();
            timeouts += u32::from(woken == 0);
            assert!(timeouts < 100, "no answer for ten seconds");
        }
    }
}

/// An estimator of ours in a thread: it answers each odometry sample.
fn estimate(domain: &Domain, done: &AtomicBool) {
    let mut process = Process::attach_as(Role::Estimator, domain.clone(), 7).unwrap();
    let odometry = process.input::<Odometry>().unwrap();
    let poses = process.output::<Pose>().unwrap();
    assert!(process.start().unwrap());
    while !done.load(Ordering::SeqCst) {
        process.wait(None).unwrap();
        while let Some(measured) = odometry.take() {
            poses.publish(&mut Pose { header: measured.header.answer(), ..Pose::default() }).unwrap();
        }
    }
}

#[test]
fn a_process_that_knows_only_plain_events_may_come_and_go_beside_ours() {
    const SCANS: u64 = 200;
    let lab = Lab::new();
    lab.write_settings();
    let done = AtomicBool::new(false);
    let mut orchestrator = Publisher::<Directive>::new(lab.bus()).unwrap();
    let say = |orchestrator: &mut Publisher<Directive>, robot| {
        let mut directive = Directive { phase: Phase::Driving.wire(), ..Directive::default() };
        directive.authority[Role::Robot.index()] = Authority { incarnation: robot, ..Authority::default() };
        orchestrator.publish(&mut directive, true).unwrap();
    };
    let mut measured = Odometry::default();
    let mut next = |incarnation| {
        let header = &mut measured.header;
        (header.incarnation, header.sequence, header.scan_id) =
            (incarnation, header.sequence + 1, header.scan_id + 1);
        measured
    };
    std::thread::scope(|scope| {
        scope.spawn(|| estimate(&lab.domain, &done));
        let ours = Observer::<Pose>::waking(lab.bus()).unwrap();
        let mut odometry = Publisher::<Odometry>::new(lab.bus()).unwrap();
        let mut drive_ours =
            |orchestrator: &mut Publisher<Directive>, incarnation, next: &mut dyn FnMut(u32) -> Odometry| {
                say(orchestrator, incarnation);
                for _ in 0..SCANS {
                    let mut sample = next(incarnation);
                    let mut answered = false;
                    let started = monotonic_ns();
                    odometry.publish(&mut sample, true).unwrap();
                    while !answered {
                        assert!(monotonic_ns() - started < 20_000_000_000, "scan {}", sample.header.scan_id);
                        ours.poll(|pose| answered |= pose.header.scan_id == sample.header.scan_id).unwrap();
                        if !answered && sample.header.scan_id > 1 {
                            ours.wait(LONG_NS);
                        } else if !answered {
                            // The estimator may just be joining.
                            ours.wait(20_000_000);
                            say(orchestrator, incarnation);
                            odometry.publish(&mut sample, true).unwrap();
                        }
                    }
                }
            };
        drive_ours(&mut orchestrator, 3, &mut next);
        let bus = Bus::open(&lab.domain, "plain").unwrap();
        let plain = Plain::<Odometry, Pose>::new(&bus);
        say(&mut orchestrator, 4);
        let mut timeouts = 0;
        for _ in 0..SCANS {
            let sample = next(4);
            plain.publish(sample);
            timeouts += plain.wait_for(|pose| pose.header.scan_id == sample.header.scan_id).1;
        }
        drop((plain, bus));
        drive_ours(&mut orchestrator, 5, &mut next);
        done.store(true, Ordering::SeqCst);
        // Each wait that ran to its end would be a wake-up that neither side got: 200 of them were waits for a look.
        println!("{timeouts} of {SCANS} plain waits ran to their end");
        assert!(timeouts < SCANS as u32 / 4, "{timeouts} of {SCANS}: ours does not hear plain events");
    });
}
