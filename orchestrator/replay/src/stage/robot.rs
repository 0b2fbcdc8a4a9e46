//! Recomputes what the emulated robot measured, from its seed and the recorded actuations.

use emulator::service::RobotState;
use emulator::{Emulator, Scenario};
use shared_types::{Actuation, Header, Odometry, Role, Scan, Truth, YOUNG_NS};

use super::{Findings, Origin, Window, each_process};
use crate::{Drive, Options};

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let window = Window::of(drive, options);
    let role = Role::Robot;
    let scenario: Scenario = drive.table(role, "scenario")?;
    let max_age_ns = (3 * drive.period_ns).max(YOUNG_NS);
    let counts = |actuation: &&Actuation| drive.counts(Role::Actuator, &actuation.header);
    let mut all: Vec<&Actuation> = drive.actuations.samples.iter().filter(counts).collect();
    all.sort_by_key(|actuation| (published_ns(actuation), actuation.header.scan_id));
    each_process::<Odometry, RobotState>(
        role,
        &drive.odometries,
        drive,
        options,
        findings,
        |odometries: &[&Odometry], origin, findings| {
            let Some(first) = odometries.first().map(|odometry| odometry.header) else { return Ok(0) };
            let mut emulator = Emulator::new(&scenario, drive.period_ns);
            let mut origin_ns = first.acquired_ns.wrapping_sub(emulator.stamp_ns(first.scan_id));
            let mut next = 0;
            if let Origin::State(_, state) = &origin {
                emulator.resume(&state.emulator)?;
                origin_ns = state.origin_ns;
                let newest = (state.received_incarnation, state.received_sequence);
                let is_it = |actuation: &&Actuation| {
                    (actuation.header.incarnation, actuation.header.sequence) == newest
                };
                next = all.iter().position(is_it).map_or(0, |place| place + 1);
            }
            for odometry in odometries {
                let header = odometry.header;
                if header.scan_id > window.to {
                    return Ok(odometries.len());
                }
                let ready_ns = emulator.scan_ready_ns(header.scan_id);
                while let Some(actuation) = all.get(next) {
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
                    next += 1;
                    let acquired_ns = actuation.header.acquired_ns;
                    let age_ns = published_ns(actuation).saturating_sub(acquired_ns);
                    if drive.simulated || acquired_ns == 0 || age_ns <= max_age_ns {
                        emulator.advance_to(acts_ns.max(emulator.now_ns()));
                        emulator.actuate(actuation);
                    }
                }
                emulator.advance_to(ready_ns);
                let (mut scan, mut measured, mut truth) =
                    (Scan::default(), Odometry::default(), Truth::default());
                emulator.measure(header.scan_id, &mut scan, &mut measured, &mut truth);
                let acquired_ns = origin_ns.wrapping_add(emulator.stamp_ns(header.scan_id));
                for header_of in [&mut scan.header, &mut measured.header, &mut truth.header] {
                    *header_of = Header { scan_id: header.scan_id, acquired_ns, ..Header::default() };
                }
                if !window.holds(&header, findings) {
                    continue;
                }
                findings.compare(*odometry, measured, role, drive, options);
                let is_same = |other: &Header| {
                    other.incarnation == header.incarnation && other.scan_id == header.scan_id
                };
                if let Some(recorded) = drive.scans.of_scan(header.scan_id).find(|scan| is_same(&scan.header))
                {
                    findings.compare(recorded, scan, role, drive, options);
                }
                if let Some(recorded) =
                    drive.truths.of_scan(header.scan_id).find(|truth| is_same(&truth.header))
                {
                    findings.compare(recorded, truth, role, drive, options);
                }
            }
            Ok(odometries.len())
        },
    )
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}
