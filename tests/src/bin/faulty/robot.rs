//! Robots with a fault.

use emulator::{Emulator, Scenario};
use runtime::{Process, monotonic_ns};
use shared_types::{Actuation, ActuationKind, BEAMS, MAX_BEAMS, Odometry, Phase, Role, Scan, Truth};

use crate::{Outcome, everything};

/// Faults of its outputs: `halves`, `stamps`, `nan`, `jumps`, `astray`, `truthless`, `runs-ahead`, `random`, `restless`,
/// `stubborn`, which is truthless and does not end either, and `withholding` and `forgetful`, which open the topic of the
/// truth and publish none on it, or none from scan 20 on. Of its device: those of [`Device`]. Of its inputs: `mirrored`, `rolls`, `tireless`,
/// `trusts`, `believes`, `repeats`, and `stuck`, which stands whatever it is told. Of
/// what comes at all: `scanless`, `silent`, and `timeless` and `backward`, whose stamps stand still and run backwards.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Robot)?;
    let scenario = process.settings::<Scenario>("scenario")?;
    let mut emulator = Emulator::new(&scenario, process.period_ns());
    let actuations = process.input::<Actuation>()?;
    let scans = process.output::<Scan>()?;
    let odometries = process.output::<Odometry>()?;
    let is_truthless =
        ["truthless", "stubborn", "scanless", "silent", "timeless", "backward"].contains(&fault);
    let truths = if is_truthless { None } else { Some(process.output::<Truth>()?) };
    let (_bus, all) = everything::<Actuation>()?;
    if !process.start()? {
        return Ok(());
    }
    let simulated = process.clock().is_simulated();
    let origin_ns = process.clock().now_ns();
    let (mut scan_id, mut answered) = (1, 0);
    let mut last = Actuation::default();
    let mut device = Device { origin_ns, period_ns: process.period_ns(), ..Device::default() };
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    loop {
        let due_ns = origin_ns + emulator.scan_ready_ns(scan_id);
        if !process.wait(Some(due_ns))? {
            if fault != "stubborn" {
                return Ok(());
            }
            runtime::wait_for(&[], 10_000_000);
            continue;
        }
        let mut told = Vec::new();
        let raw = ["trusts", "believes", "repeats"].contains(&fault);
        while let Some(actuation) = actuations.take() {
            answered = actuation.header.scan_id;
            if !raw {
                told.push(*actuation);
            }
        }
        while let Some((actuation, sound)) = all.next()? {
            let named = process.directive().authority[Role::Actuator.index()]
                .accepts(actuation.header.incarnation, 0);
            let taken = match fault {
                "trusts" => sound.is_ok(),
                "believes" => named,
                "repeats" => sound.is_ok() && named,
                _ => false,
            };
            if taken {
                told.push(actuation);
            }
        }
        if fault == "tireless" && told.is_empty() {
            told.push(last);
        }
        if !simulated {
            emulator.advance_to(process.clock().now_ns() - origin_ns);
        }
        if fault == "stuck" {
            told.clear();
        }
        for mut actuation in told {
            last = actuation;
            obey(fault, &mut actuation);
            emulator.actuate(&actuation);
        }
        let directive = process.directive();
        let granted = answered + 1 == scan_id && scan_id <= directive.granted_scan;
        let due =
            if simulated { granted || fault == "runs-ahead" } else { process.clock().now_ns() >= due_ns };
        if !due || directive.phase == Phase::Stopping.wire() && fault != "restless" {
            continue;
        }
        let ready_ns = emulator.scan_ready_ns(scan_id);
        process.clock().advance_to(origin_ns + ready_ns);
        process.begin();
        emulator.advance_to(ready_ns);
        emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        for header in [&mut scan.header, &mut odometry.header, &mut truth.header] {
            header.scan_id = scan_id;
            header.acquired_ns = origin_ns + emulator.acquired_ns(scan_id);
            match fault {
                "stamps" => header.acquired_ns += process.period_ns(),
                "timeless" if scan_id > 5 => header.acquired_ns = origin_ns + emulator.acquired_ns(5),
                "backward" if scan_id > 5 => header.acquired_ns -= 2 * emulator.acquired_ns(scan_id - 5),
                _ => {}
            }
        }
        match fault {
            "nan" if scan_id == 5 => odometry.yaw_rad = f64::NAN,
            "jumps" => odometry.dx_m += 0.01,
            // From where no track is, while it drives.
            "astray" if scan_id >= 20 => odometry.x_m += 4e5,
            "random" => odometry.y_m += 1e-12 * (monotonic_ns() % 1000) as f64,
            _ => {}
        }
        device.disturb(fault, process.clock().now_ns(), &mut scan, &mut odometry);
        let keeps_truth = fault == "withholding" || fault == "forgetful" && scan_id >= 20;
        if let Some(truths) = truths.as_ref().filter(|_| !keeps_truth) {
            truths.publish_silently(&mut truth)?;
        }
        if fault != "scanless" && fault != "silent" && (fault != "halves" || !scan_id.is_multiple_of(4)) {
            scans.publish(&mut scan)?;
        }
        if fault != "silent" {
            odometries.publish(&mut odometry)?;
        }
        scan_id += 1;
    }
}

/// Changes an actuation before the robot obeys it.
fn obey(fault: &str, actuation: &mut Actuation) {
    match fault {
        "mirrored" => actuation.sent_steering_rad *= -1.0,
        "rolls" if actuation.kind == ActuationKind::Block.wire() => {
            (actuation.kind, actuation.sent_velocity_mps) = (ActuationKind::Drive.wire(), 0.3);
        }
        "believes" => {
            actuation.kind = ActuationKind::Drive.wire();
            let velocity = actuation.sent_velocity_mps;
            actuation.sent_velocity_mps = if velocity.is_finite() { velocity.clamp(0.5, 1.0) } else { 0.7 };
            actuation.sent_steering_rad = actuation.sent_steering_rad.clamp(-0.1, 0.1);
        }
        _ => {}
    }
}

/// What a driver makes of a device that fails: `foreign`, `drifts`, `arrival`, `jittery`, `fills`, `resets`, `half`,
/// `old-half`, `backwards`, `apart`, `two-clocks`.
#[derive(Default)]
struct Device {
    origin_ns: u64,
    period_ns: u64,
    /// The ranges published last.
    ranges_mm: Option<[u32; MAX_BEAMS]>,
    /// The pose of the scan before.
    pose: [f64; 3],
    /// Where the base restarted.
    restarted: Option<Odometry>,
}

impl Device {
    /// Spoils what was measured.
    fn disturb(&mut self, fault: &str, now_ns: u64, scan: &mut Scan, odometry: &mut Odometry) {
        let scan_id = scan.header.scan_id;
        let stamp_ns = self.stamp_ns(fault, now_ns, scan_id, scan.header.acquired_ns);
        scan.header.acquired_ns = if fault == "apart" { stamp_ns - 1 } else { stamp_ns };
        odometry.header.acquired_ns = stamp_ns;
        let old = self.ranges_mm.unwrap_or(scan.ranges_mm);
        let pose = [odometry.x_m, odometry.y_m, odometry.yaw_rad];
        match fault {
            // The clock by which its base is mapped is a period behind the one of its scanner.
            "two-clocks" => [odometry.x_m, odometry.y_m, odometry.yaw_rad] = self.pose,
            "fills" if scan_id.is_multiple_of(5) => scan.ranges_mm = old,
            "half" if scan_id.is_multiple_of(5) => scan.ranges_mm[BEAMS / 2..].fill(0),
            "old-half" if scan_id.is_multiple_of(5) => {
                scan.ranges_mm[BEAMS / 2..].copy_from_slice(&old[BEAMS / 2..]);
            }
            "resets" if scan_id >= 30 => {
                let zero = *self.restarted.get_or_insert(*odometry);
                (odometry.x_m, odometry.y_m) = (odometry.x_m - zero.x_m, odometry.y_m - zero.y_m);
            }
            _ => {}
        }
        (self.ranges_mm, self.pose) = (Some(scan.ranges_mm), pose);
    }

    fn stamp_ns(&self, fault: &str, now_ns: u64, scan_id: u64, acquired_ns: u64) -> u64 {
        let run_ns = acquired_ns.saturating_sub(self.origin_ns);
        match fault {
            "foreign" => run_ns,
            "drifts" => acquired_ns - run_ns / 50,
            "arrival" => now_ns,
            "jittery" if scan_id.is_multiple_of(2) => acquired_ns + self.period_ns * 3 / 10,
            "backwards" if scan_id.is_multiple_of(10) => acquired_ns - self.period_ns * 6 / 5,
            _ => acquired_ns,
        }
    }
}
