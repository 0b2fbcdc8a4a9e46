//! Shared memory that is enough, and shared memory that is not.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;

use shared_types::{Actuation, Directive, Obstacles, Odometry, Pose, Role, Scan, Truth};

use super::{Lab, PERIOD_NS};
use crate::reserve::{allocate_files, process_bytes};
use crate::{Domain, Observer, Process, Publisher, Reserve, RuntimeError};

/// Length and allocated bytes of each file that a system has in shared memory.
fn files(domain: &Domain) -> BTreeMap<String, (u64, u64)> {
    let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
    let ours = entries.filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let file = entry.metadata().ok().filter(|_| name.starts_with(domain.shared_memory_prefix()))?;
        Some((name, (file.len(), file.blocks() * 512)))
    });
    ours.collect()
}

fn length(domain: &Domain) -> u64 {
    files(domain).values().map(|(length, _)| length.next_multiple_of(4096)).sum()
}

fn assert_allocated(domain: &Domain) {
    for (name, (length, allocated)) in files(domain) {
        assert!(allocated >= length, "{name} has {length} bytes and {allocated} of memory");
    }
}

#[test]
fn the_reserve_covers_what_a_process_really_needs_and_the_check_what_a_system_does() {
    let lab = Lab::new();
    lab.write_settings();
    let domain = &lab.domain;
    let _looks_on = (
        Observer::<Scan>::new(lab.bus()).unwrap(),
        Observer::<Odometry>::new(lab.bus()).unwrap(),
        Observer::<Truth>::new(lab.bus()).unwrap(),
        Publisher::<Directive>::new(lab.bus()).unwrap(),
    );
    let mut robots = Vec::new();
    for incarnation in 1..=2 {
        let before = length(domain);
        let mut robot = Process::attach_as(Role::Robot, domain.clone(), incarnation).unwrap();
        let ports = (
            robot.output::<Scan>().unwrap(),
            robot.output::<Odometry>().unwrap(),
            robot.output::<Truth>().unwrap(),
            robot.input::<Actuation>().unwrap(),
        );
        let grown = length(domain) - before;
        let reserved = process_bytes(Role::Robot, PERIOD_NS);
        assert!(grown <= reserved && reserved < 2 * grown, "{grown} bytes of {reserved}");
        robots.push((robot, ports));
    }
    let mut obstacles = Process::attach_as(Role::Obstacles, domain.clone(), 3).unwrap();
    let _ports = (
        obstacles.output::<Obstacles>().unwrap(),
        obstacles.input::<Scan>().unwrap(),
        obstacles.input::<Pose>().unwrap(),
    );
    assert!(
        length(domain) < Reserve::of_a_system(PERIOD_NS),
        "{} of {}",
        length(domain),
        Reserve::of_a_system(PERIOD_NS)
    );
}

#[test]
fn what_a_new_port_made_is_allocated_to_its_length() {
    let lab = Lab::new();
    lab.write_settings();
    assert_allocated(&lab.domain);
    let _observer = Observer::<Scan>::new(lab.bus()).unwrap();
    let mut robot = Process::attach_as(Role::Robot, lab.domain.clone(), 1).unwrap();
    let _output = robot.output::<Scan>().unwrap();
    assert!(
        files(&lab.domain).values().any(|(length, allocated)| allocated < length),
        "the bus allocates itself"
    );
    allocate_files(&lab.domain).unwrap();
    assert_allocated(&lab.domain);
}

#[test]
fn what_is_not_there_is_refused_with_what_is_missing_and_takes_nothing() {
    let Err(RuntimeError::SharedMemory(shortage)) = Reserve::take(1 << 60) else { panic!("not refused") };
    assert_eq!(shortage.needed, 1 << 60);
    let missing_kib = shortage.missing().div_ceil(1024);
    assert!(
        shortage.to_string().ends_with(&format!("KiB are needed: {missing_kib} KiB are missing")),
        "{shortage}"
    );
}
