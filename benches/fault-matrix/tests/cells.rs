//! The drive without a fault is that of the pipeline, and the shipped faults of samples and robot pass.

use fault_matrix::{CellVerdict, Rig, Simulation, course};
use faults::DrivePhase;

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
    assert!(rig.is_swapped(), "{:?}", rig.findings().list());
}

#[test]
fn every_cell_of_the_simulation_passes() {
    let courses = DrivePhase::ALL.map(|phase| (phase, course::settings_of(phase)));
    let simulation = Simulation::new(Vec::new(), &courses, 1.0).unwrap();
    let (mut cells, mut failed) = (0, String::new());
    for fault in faults::all().unwrap().iter().filter(|fault| !fault.is_live()) {
        for phase in fault.phases() {
            let cell = simulation.cell(fault, phase).unwrap();
            cells += 1;
            if cell.verdict == CellVerdict::Fail {
                failed += &format!("{}/{}: {} {cell:?}\n", cell.fault, cell.phase, cell.reason);
            }
        }
    }
    assert!(cells >= 500, "{cells}");
    assert!(failed.is_empty(), "\n{failed}");
}
