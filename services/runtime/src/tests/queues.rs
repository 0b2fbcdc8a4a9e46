//! How many readers a topic has, and how many samples wait at each.

use shared_types::{Odometry, Pose, Role};

use super::{Lab, PERIOD_NS, pose};
use crate::input::Input;
use crate::output::Output;
use crate::qos::MAX_READERS;
use crate::{Bus, Domain, Observer, PROCESS_QUEUE, RuntimeError, observer_queue};

#[test]
fn a_topic_of_the_loop_has_24_readers_and_the_next_one_is_refused() {
    let lab = Lab::new();
    let observers: Vec<_> = (0..MAX_READERS).map(|_| Observer::<Odometry>::new(lab.bus()).unwrap()).collect();
    assert!(matches!(Observer::<Odometry>::new(lab.bus()), Err(RuntimeError::Bus { .. })));
    let writer = Output::<Odometry>::new(lab.bus(), lab.shared(Role::Robot, 3)).unwrap();
    observers.iter().for_each(Observer::connect);
    writer.publish(&mut Odometry::default()).unwrap();
    for observer in &observers {
        assert!(observer.next().unwrap().is_some());
    }
}

#[test]
fn the_samples_of_a_second_wait_at_an_observer_and_sixteen_at_a_process() {
    let domain = Domain::create(&format!("q{}", std::process::id())).unwrap();
    let (lab, period_ns) = (Lab::new(), PERIOD_NS / 100);
    let bus = Bus::create(&domain, period_ns).unwrap();
    let observer = Observer::<Pose>::new(&bus).unwrap();
    let process = Input::<Pose>::new(&bus, lab.shared(Role::Controller, 9)).unwrap();
    let writer = Output::<Pose>::new(&bus, lab.shared(Role::Estimator, 7)).unwrap();
    assert_eq!(observer.capacity(), observer_queue(size_of::<Pose>(), period_ns));
    (1..=200).for_each(|scan_id| writer.publish(&mut pose(scan_id, 0.0)).unwrap());
    let (mut waited, mut last) = (0, 0);
    observer.poll_checked(|sample, _| (waited, last) = (waited + 1, sample.header.sequence)).unwrap();
    assert_eq!((waited, last), (100, 200));
    process.reader().drain().unwrap();
    let arrived = process.reader().account().arrived;
    assert_eq!(arrived as usize, PROCESS_QUEUE);
    drop((observer, process, writer, bus));
    domain.remove().unwrap();
}
