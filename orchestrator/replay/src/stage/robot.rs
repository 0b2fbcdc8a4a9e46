//! Recomputes what the emulated robot measured, from its seed and the recorded actuations.

use emulator::{Emulator, Scenario};
use shared_types::{Actuation, Header, Odometry, Role, Scan, Truth};

use super::{Findings, Window};
use crate::{Drive, Options};

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let window = Window::of(drive, options);
    let mut odometries: Vec<&Odometry> = drive.odometries.samples.iter().collect();
    odometries.sort_by_key(|odometry| (odometry.header.incarnation, odometry.header.sequence));
    let Some(first) = odometries.first().map(|odometry| odometry.header) else { return Ok(()) };
    let reason = match drive.foreign(first.incarnation) {
        Some(_) => Some("not_compared: the process is no implementation of this program"),
        None if first.sequence != 1 => Some("the start of the robot was not recorded"),
        None => None,
    };
    let scenario: Scenario = drive.table(Role::Robot, "scenario")?;
    let mut emulator = Emulator::new(&scenario, drive.period_ns);
    let origin_ns = first.acquired_ns.wrapping_sub(emulator.stamp_ns(first.scan_id));
    let mut actuations =
        drive.actuations.samples.iter().filter(|sample| drive.counts(Role::Actuator, &sample.header));
    let mut pending = actuations.next();
    for odometry in odometries {
        let header = odometry.header;
        let reason = reason.or((header.incarnation != first.incarnation).then_some("a robot that took over"));
        if header.scan_id > window.to {
            continue;
        }
        if let Some(reason) = reason {
            if window.holds(&header, findings) {
                findings.skip(odometry, reason);
            }
            continue;
        }
        let ready_ns = emulator.scan_ready_ns(header.scan_id);
        while let Some(actuation) = pending {
            // In lock-step the answer to a scan acts before the next one; in real time at its publication.
            let acts_ns = match drive.simulated {
                true => 0,
                false => published_ns(actuation).wrapping_sub(origin_ns),
            };
            let is_before = match drive.simulated {
                true => actuation.header.scan_id < header.scan_id,
                false => acts_ns < ready_ns,
            };
            if !is_before {
                break;
            }
            emulator.advance_to(acts_ns.max(emulator.now_ns()));
            emulator.actuate(actuation);
            pending = actuations.next();
        }
        emulator.advance_to(ready_ns);
        let (mut scan, mut measured, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
        emulator.measure(header.scan_id, &mut scan, &mut measured, &mut truth);
        let acquired_ns = origin_ns.wrapping_add(emulator.stamp_ns(header.scan_id));
        for header_of in [&mut scan.header, &mut measured.header, &mut truth.header] {
            *header_of = Header { scan_id: header.scan_id, acquired_ns, ..Header::default() };
        }
        if !window.holds(&header, findings) {
            continue;
        }
        let role = Role::Robot;
        findings.compare(odometry, measured, role, drive, options);
        let is_same =
            |other: &Header| other.incarnation == header.incarnation && other.scan_id == header.scan_id;
        if let Some(recorded) = drive.scans.of_scan(header.scan_id).find(|scan| is_same(&scan.header)) {
            findings.compare(recorded, scan, role, drive, options);
        }
        if let Some(recorded) = drive.truths.of_scan(header.scan_id).find(|truth| is_same(&truth.header)) {
            findings.compare(recorded, truth, role, drive, options);
        }
    }
    Ok(())
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}
