//! Waking: nothing that was published is slept through, whoever publishes and whoever sleeps.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::ipc;
use shared_types::{Odometry, Phase, Topic};
use signal_hook::consts::SIGUSR1;

use super::{Lab, pose};
use crate::bell::ANY;
use crate::bus::{WirePublisher, WireSubscriber};
use crate::process::Process;
use crate::wire::Wire;
use crate::*;
use shared_types::{Authority, Directive, Pose, Role, Sample};

/// Samples that each of two publishers hammers onto one topic.
const HAMMERED: u64 = 150_000;
/// What a lost wake-up would cost in these tests [ns].
const LONG_NS: u64 = 2_000_000_000;

/// When publishing each sample was over, all wake-ups included; 0 before [ns].
struct Done(Vec<AtomicU64>);

impl Done {
    fn new() -> Self {
        Self((0..=HAMMERED).map(|_| AtomicU64::new(0)).collect())
    }

    /// Publishes all samples in bursts with pauses of a random length, so that the reader falls asleep at all moments.
    fn hammer(&self, seed: u64, mut publish: impl FnMut(u64)) {
        let mut random = seed;
        for number in 1..=HAMMERED {
            publish(number);
            self.0[number as usize].store(monotonic_ns(), Ordering::SeqCst);
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            if random >> 62 == 0 {
                let until = monotonic_ns() + (random >> 32) % 6000;
                while monotonic_ns() < until {
                    std::hint::spin_loop();
                }
            }
        }
    }
}

/// Reads until both publishers have sent their last; returns how often it slept to the end of its time although a
/// sample had been published, and its readers woken, before that end; and how often it was woken.
fn read_all(observer: &Observer<Pose>, done: &[Done; 2], timeout_ns: u64) -> (u64, u64) {
    let (mut newest, mut overslept, mut woken) = ([0; 2], 0, 0);
    while newest != [HAMMERED; 2] {
        let before = monotonic_ns();
        let awake = observer.wait(timeout_ns);
        woken += u64::from(awake);
        let mut late = false;
        observer
            .poll(|pose| {
                let (who, number) = (pose.header.incarnation as usize, pose.header.scan_id);
                let done_ns = done[who].0[number as usize].load(Ordering::SeqCst);
                late |= done_ns > 0 && done_ns < before + timeout_ns;
                newest[who] = number;
            })
            .unwrap();
        overslept += u64::from(!awake && late);
    }
    (overslept, woken)
}

#[test]
fn two_writers_who_hammer_one_reader_never_let_it_sleep_through_a_sample() {
    let lab = Lab::new();
    let done = [Done::new(), Done::new()];
    let observer = Observer::<Pose>::waking(lab.bus()).unwrap();
    let ready = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for (who, done) in done.iter().enumerate() {
            let (domain, ready) = (&lab.domain, &ready);
            scope.spawn(move || {
                let bus = Bus::open(domain, "hammer").unwrap();
                let mut voice = Voice::<Pose>::new(&bus).unwrap();
                ready.fetch_add(1, Ordering::SeqCst);
                done.hammer(who as u64, |number| {
                    let mut sample = pose(number, 0.0);
                    sample.header.incarnation = who as u32;
                    voice.say(&mut sample, true).unwrap();
                });
                // The last sample lies in this publisher's memory until it was read.
                while ready.load(Ordering::SeqCst) < 100 {
                    std::thread::yield_now();
                }
            });
        }
        while ready.load(Ordering::SeqCst) < 2 {
            observer.poll(|_| ()).unwrap();
        }
        let (overslept, woken) = read_all(&observer, &done, LONG_NS);
        ready.store(100, Ordering::SeqCst);
        assert_eq!(overslept, 0, "in {woken} wake-ups");
    });
}

#[test]
fn a_wake_up_that_the_plain_events_lose_is_healed_by_the_time_out() {
    let lab = Lab::new();
    let done = [Done::new(), Done::new()];
    let observer = Observer::<Pose>::waking(lab.bus()).unwrap();
    let ready = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for (who, done) in done.iter().enumerate() {
            let (domain, ready) = (&lab.domain, &ready);
            scope.spawn(move || {
                let bus = Bus::open(domain, "hammer").unwrap();
                let plain = Plain::<Pose, Pose>::new(&bus);
                ready.fetch_add(1, Ordering::SeqCst);
                done.hammer(who as u64, |number| {
                    let mut sample = pose(number, 0.0);
                    sample.header.incarnation = who as u32;
                    plain.publish(sample);
                });
                while ready.load(Ordering::SeqCst) < 100 {
                    std::thread::yield_now();
                }
            });
        }
        while ready.load(Ordering::SeqCst) < 2 {
            observer.poll(|_| ()).unwrap();
        }
        // However many were lost, all samples that the buffer still holds come out, and the last of both among them.
        let (overslept, woken) = read_all(&observer, &done, 20_000_000);
        ready.store(100, Ordering::SeqCst);
        println!("{overslept} wake-ups lost, {woken} not");
        assert!(woken > 0, "the events are heard");
    });
}

#[test]
fn a_signal_at_any_moment_ends_the_sleep() {
    let lab = Lab::new();
    let shutdown = Shutdown::on(&[SIGUSR1]).unwrap();
    let bells = lab.bus().bells();
    shutdown.ring_also(bells, Role::Actuator).unwrap();
    let bell = bells.role(Role::Actuator);
    let seen = bell.look();
    assert!(!bell.sleep(seen, monotonic_ns() + 1_000_000, ANY), "nothing has happened");
    assert!(!shutdown.requested());
    // Between the look and the sleep: the moment at which a flag alone would be missed.
    signal_hook::low_level::raise(SIGUSR1).unwrap();
    assert!(bell.sleep(seen, monotonic_ns() + LONG_NS, ANY));
    assert!(shutdown.requested());
}

#[test]
fn a_sleeper_that_was_killed_stays_counted_and_disturbs_nobody() {
    let lab = Lab::new();
    let bell = lab.bus().bells().role(Role::Controller);
    bell.forget_a_sleeper();
    let seen = bell.look();
    assert!(!bell.sleep(seen, monotonic_ns() + 1_000_000, ANY));
    lab.bus().bells().ring(Topic::Pose);
    assert!(bell.sleep(seen, monotonic_ns() + LONG_NS, ANY));
}

#[test]
fn only_readers_of_a_topic_are_rung_and_everyone_for_a_directive() {
    let lab = Lab::new();
    let bells = lab.bus().bells();
    let looks = || Role::ALL.iter().map(|role| bells.role(*role).look()).collect::<Vec<_>>();
    bells.ring(Topic::Pose);
    assert_eq!(looks(), [0, 0, 1, 1, 0], "obstacles and controller");
    bells.ring(Topic::Directive);
    assert_eq!(looks(), [1, 1, 2, 2, 1]);
    bells.ring(Topic::Truth);
    assert_eq!(looks(), [1, 1, 2, 2, 1]);
}

/// A process that uses the bus's own events only, as one in another language does.
struct Plain<W: Sample, R: Sample> {
    publisher: WirePublisher<W>,
    notifier: Notifier<ipc::Service>,
    subscriber: WireSubscriber<R>,
    listener: Listener<ipc::Service>,
}

impl<W: Sample, R: Sample> Plain<W, R> {
    fn new(bus: &Bus) -> Self {
        Self {
            publisher: bus.publisher::<W>().unwrap().0,
            notifier: bus.events(W::TOPIC).unwrap().notifier_builder().create().unwrap(),
            subscriber: bus.subscriber::<R>().unwrap(),
            listener: bus.events(R::TOPIC).unwrap().listener_builder().create().unwrap(),
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
    let mut process = Process::join(Role::Estimator, domain.clone(), 7).unwrap();
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
    std::fs::write(
        lab.domain.directory().join(SETTINGS_FILE),
        "[run]\nperiod_ns = 1000000000\nclock = \"simulated\"\norphan_timeout_ns = 60000000000\n",
    )
    .unwrap();
    let done = AtomicBool::new(false);
    let mut orchestrator = Voice::<Directive>::new(lab.bus()).unwrap();
    let say = |orchestrator: &mut Voice<Directive>, robot| {
        let mut directive = Directive { phase: Phase::Driving.wire(), ..Directive::default() };
        directive.authority[Role::Robot.index()] = Authority { incarnation: robot, ..Authority::default() };
        orchestrator.say(&mut directive, true).unwrap();
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
        let mut odometry = Voice::<Odometry>::new(lab.bus()).unwrap();
        let mut drive_ours = |orchestrator: &mut Voice<Directive>, incarnation, next: &mut dyn FnMut(u32) -> Odometry| {
            say(orchestrator, incarnation);
            for _ in 0..SCANS {
                let mut sample = next(incarnation);
                let mut answered = false;
                let started = monotonic_ns();
                odometry.say(&mut sample, true).unwrap();
                while !answered {
                    assert!(monotonic_ns() - started < 20_000_000_000, "scan {}", sample.header.scan_id);
                    ours.poll(|pose| answered |= pose.header.scan_id == sample.header.scan_id).unwrap();
                    if !answered {
                        ours.wait(LONG_NS);
                    }
                    // The first samples may find half a connection only.
                    if !answered && sample.header.scan_id == 1 {
                        odometry.say(&mut sample, true).unwrap();
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
