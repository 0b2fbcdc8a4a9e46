//! The drive without a fault is that of the pipeline, and the shipped faults of samples and robot pass.

use fault_matrix::{Rig, Simulation, course};
use faults::Phase;

#[test]
fn without_a_fault_each_scan_gives_the_bits_of_the_pipeline() {
    let settings = course::settings();
    let mut rig = Rig::new(&settings).unwrap();
    let mut scans = 0;
    let drive = pipeline::drive(&settings, |step| {
        let outcome = rig.scan();
        assert_eq!(rig.truth().x_m.to_bits(), step.truth.x_m.to_bits(), "scan {}", step.truth.header.scan_id);
        assert_eq!(rig.actuation(), step.actuation.as_ref(), "scan {}", step.truth.header.scan_id);
        (scans, _) = (scans + 1, outcome);
    })
    .unwrap();
    assert_eq!((drive.outcome.name(), drive.scans), ("reached", scans));
    assert_eq!(rig.scan(), Some(drive.outcome), "{}", rig.reason());
}

#[test]
fn without_a_fault_a_swap_takes_place_and_changes_nothing() {
    let mut rig = Rig::new(&course::settings()).unwrap();
    while rig.truth().x_m < 1.0 {
        rig.scan();
    }
    let mut other = rig.clone();
    rig.begin_swap();
    loop {
        let (outcome, without) = (rig.scan(), other.scan());
        assert_eq!(rig.truth().x_m.to_bits(), other.truth().x_m.to_bits());
        assert_eq!(outcome, without);
        if outcome.is_some() {
            break;
        }
    }
    assert!(rig.is_swapped(), "{:?}", rig.findings.list());
}

#[test]
fn every_cell_of_the_simulation_passes() {
    let faults = match std::env::var("SCANLOOP_FAULTS") {
        Ok(folder) => std::fs::read_dir(folder).unwrap().map(|entry| {
            let path = entry.unwrap().path();
            faults::Fault::parse(path.file_stem().unwrap().to_str().unwrap(), &std::fs::read_to_string(&path).unwrap()).unwrap()
        }).collect(),
        Err(_) => faults::all().unwrap(),
    };
    let simulation = Simulation::new().unwrap();
    let mut text = String::new();
    let only = std::env::var("SCANLOOP_ONLY").unwrap_or_default();
    for fault in faults.iter().filter(|fault| !fault.is_live() && fault.name.contains(&only)) {
        for phase in fault.phases() {
            let cell = simulation.cell(fault, phase).unwrap();
            text += &format!(
                "{:?} {}/{} {} {} {:?} blind {:.3} of {:.3} deviation {:.3} clearance {:.3} {} {}\n",
                cell.verdict, cell.fault, cell.phase, cell.detected_by, cell.detection, cell.detected_after_ms,
                cell.blind_m, cell.blind_limit_m, cell.deviation_m, cell.min_clearance_m, cell.outcome, cell.reason
            );
        }
    }
    std::fs::write("/tmp/faults-cells.txt", text).unwrap();
}
