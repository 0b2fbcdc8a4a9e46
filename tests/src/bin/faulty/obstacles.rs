//! Obstacle detectors with a fault.

use std::error::Error;

use runtime::{Input, Process, join};
use shared_types::{MIN_RANGE_MM, Obstacle, Obstacles, Pose, Role, Scan, ScannerHealth, ScannerState};

use crate::Outcome;

/// The scan from which descriptions are spoiled that were good until then: the robot drives by then.
const SPOILED: u64 = 15;

/// Faults: `small`, `phantom`, `needs-returns`, `far-first`, `renumbers`, `forgets`, `unpaired`, `trusting`, `timid`,
/// `unforgiving`, `needs-scans`, `keeps`, `travels`, `nothing`, `always-blind`; from the scan [`SPOILED`] on `nan`, `heap`, `inside`.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Obstacles)?;
    let mut detector =
        obstacles::ObstacleDetector::new(process.settings::<obstacles::ObstaclesConfig>("obstacles")?)?;
    let scans = process.input::<Scan>()?;
    let poses = process.input::<Pose>()?;
    let output = process.output::<Obstacles>()?;
    if !process.start()? {
        return Ok(());
    }
    let mut last = Pose::default();
    let mut memory = Memory::default();
    while process.wait(None)? {
        for (scan, pose) in pairs(fault, &scans, &poses, &mut last)? {
            let has_returns = scan.ranges().iter().any(|range| *range >= MIN_RANGE_MM);
            if fault == "needs-returns" && !has_returns || fault == "needs-scans" && scan.missing.is_set() {
                continue;
            }
            let mut description = detector.step(&scan, &pose);
            memory.see(&scan, &pose, &description);
            spoil(fault, &mut description, &mut memory);
            if scan.header.scan_id >= SPOILED {
                invent(fault, &pose, &mut description);
            }
            output.publish(&mut description)?;
        }
    }
    Ok(())
}

/// Scans with their poses; `unpaired` takes the newest pose.
fn pairs(
    fault: &str,
    scans: &Input<Scan>,
    poses: &Input<Pose>,
    last: &mut Pose,
) -> Result<Vec<(Scan, Pose)>, Box<dyn Error>> {
    let mut pairs = Vec::new();
    if fault == "unpaired" {
        while let Some(pose) = poses.take() {
            *last = *pose;
        }
        while let Some(scan) = scans.take() {
            pairs.push((*scan, *last));
        }
    } else {
        while let Some((scan, pose)) = join(scans, poses) {
            pairs.push((*scan, *pose));
        }
    }
    Ok(pairs)
}

/// What faults depend on.
#[derive(Default)]
struct Memory {
    count: u32,
    /// The scan before, and the way since its ranges were new [m].
    ranges_mm: Vec<u32>,
    x_m: f64,
    way_m: f64,
    /// All ellipses that were ever reported.
    known: Vec<Obstacle>,
    /// The last state that stopped the robot.
    stopped: Option<ScannerState>,
}

impl Memory {
    fn see(&mut self, scan: &Scan, pose: &Pose, description: &Obstacles) {
        self.count += 1;
        if self.ranges_mm != scan.ranges() {
            (self.ranges_mm, self.x_m) = (scan.ranges().to_vec(), pose.x_m);
        }
        self.way_m = pose.x_m - self.x_m;
        for item in description.list() {
            if self.known.iter().all(|known| known.id != item.id) {
                self.known.push(*item);
            }
        }
        let state = description.scanner.state();
        self.stopped = if state.is_stop() { Some(state) } else { self.stopped };
    }
}

fn spoil(fault: &str, description: &mut Obstacles, memory: &mut Memory) {
    let mut list = description.list().to_vec();
    let health = &mut description.scanner;
    match fault {
        "small" => list.iter_mut().for_each(|item| (item.a_m, item.b_m) = (0.1, 0.1)),
        "phantom" if list.is_empty() => {
            list.push(Obstacle { id: 1, a_m: 1.0, b_m: 1.0, ..Obstacle::default() });
        }
        "far-first" => list.reverse(),
        "renumbers" => list.iter_mut().for_each(|item| item.id += 100 * memory.count),
        "nothing" => list.clear(),
        "always-blind" => health.state = ScannerState::Blind.wire(),
        "forgets" => list.retain(|item| item.unseen_s == 0.0),
        "keeps" => list.clone_from(&memory.known),
        "travels" => list.iter_mut().for_each(|item| item.x_m += memory.way_m),
        "trusting" => *health = ScannerHealth::healthy(5.0),
        "timid" if health.valid_share < 0.3 => health.state = ScannerState::Blind.wire(),
        "unforgiving" => health.state = memory.stopped.map_or(health.state, ScannerState::wire),
        _ => {}
    }
    description.items = Default::default();
    description.count = list.len() as u32;
    description.items[..list.len()].copy_from_slice(&list);
}

/// Replaces what was described by bodies that are not there.
fn invent(fault: &str, pose: &Pose, description: &mut Obstacles) {
    match fault {
        "nan" => description.items[0] = Obstacle { y_m: f64::NAN, ..body(1, 5.0, 0.0) },
        // Half of them around the same place, the others turned on the spot.
        "heap" => {
            description.items = std::array::from_fn(|index| {
                let turn = index as f64;
                let spread = if index % 2 == 0 { 0.2 } else { 0.0 };
                let (x, y) = (6.0 + spread * turn.cos(), 0.4 + spread * turn.sin());
                Obstacle { box_yaw_rad: turn, ..body(index as u32 + 1, x, y) }
            });
        }
        "inside" => description.items[0] = body(1, pose.x_m, pose.y_m),
        _ => return,
    }
    description.count = if fault == "heap" { description.items.len() as u32 } else { 1 };
}

fn body(id: u32, x: f64, y: f64) -> Obstacle {
    let (a_m, b_m, [box_length_m, box_width_m]) = (1.2, 0.8, [0.1, 0.4]);
    let [x_m, y_m, box_x_m, box_y_m] = [x, y, x, y];
    Obstacle {
        id,
        body: id,
        x_m,
        y_m,
        a_m,
        b_m,
        box_x_m,
        box_y_m,
        box_length_m,
        box_width_m,
        ..Obstacle::default()
    }
}
