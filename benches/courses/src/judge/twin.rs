//! What was touched, and a twin that brakes in time.
//!
//! Both repeat the drive: the emulated robot depends on the scenario and on the actuations only.

use nalgebra::Vector2;
use shared_types::{Actuation, ActuationKind, Header, Odometry, Scan, Truth};
use vehicle::frame::heading;
use vehicle::geometry::Rectangle;

use emulator::emulator::Emulator;
use emulator::scenario::{Scenario, ScenarioObstacle};

/// What the body has touched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Touched {
    /// A body that moves.
    Moving(ScenarioObstacle),
    /// A body at rest.
    Fixed,
    /// A wall.
    Wall,
}

/// The drive once more.
struct Repetition<'a> {
    scenario: &'a Scenario,
    emulator: Emulator,
    scan_id: u64,
}

/// What was touched at the end of a drive with these actuations, one per scan.
pub(super) fn touched(scenario: &Scenario, period_ns: u64, sent: &[Option<Actuation>]) -> Touched {
    let mut drive = Repetition::new(scenario, period_ns);
    let last = sent.len().saturating_sub(1);
    for actuation in &sent[..last] {
        drive.advance();
        drive.send(actuation.as_ref());
    }
    drive.advance();
    drive.nearest()
}

/// Time after which a robot can know that a body in its view has another motion: two scans, and one to answer [s].
const CHANGE_KNOWN_S: f64 = 0.3;

/// Whether a mover touches the robot that brakes fully from the first scan that can show it; where the body has changed its
/// motion, [`CHANGE_KNOWN_S`] later.
pub(super) fn twin_is_touched(
    scenario: &Scenario,
    period_ns: u64,
    sent: &[Option<Actuation>],
    mover: &ScenarioObstacle,
) -> bool {
    let mut twin = Repetition::new(scenario, period_ns);
    let known_s = if mover.appears_s > 0.0 { mover.appears_s + CHANGE_KNOWN_S } else { 0.0 };
    let mut brakes = false;
    loop {
        twin.advance();
        if twin.is_touched() {
            return matches!(twin.nearest(), Touched::Moving(_));
        }
        brakes = brakes || (twin.time_s() >= known_s && twin.can_see(mover));
        let driven = sent.get(twin.scan_id as usize - 1);
        // Without a sight there is nothing to brake for: the drive itself is the twin.
        match driven {
            Some(driven) if !brakes => twin.send(driven.as_ref()),
            _ => twin.send(Some(&twin.block())),
        }
        if twin.time_s() >= scenario.timeout_s {
            return false;
        }
    }
}

impl<'a> Repetition<'a> {
    fn new(scenario: &'a Scenario, period_ns: u64) -> Self {
        Self { scenario, emulator: Emulator::new(scenario, period_ns), scan_id: 0 }
    }

    /// Moves on until the next scan is published.
    fn advance(&mut self) {
        self.scan_id += 1;
        self.emulator.advance_to(self.emulator.scan_ready_ns(self.scan_id));
    }

    fn send(&mut self, actuation: Option<&Actuation>) {
        if let Some(actuation) = actuation {
            self.emulator.actuate(actuation);
        }
    }

    /// The answer to this scan that blocks the wheels.
    fn block(&self) -> Actuation {
        let header = Header { scan_id: self.scan_id, ..Header::default() };
        Actuation { header, kind: ActuationKind::Block.wire(), answers: 1, ..Actuation::default() }
    }

    fn time_s(&self) -> f64 {
        self.emulator.now_ns() as f64 * 1e-9
    }

    fn is_touched(&mut self) -> bool {
        let (mut scan, mut odometry, mut truth) =
            (Box::<Scan>::default(), Odometry::default(), Truth::default());
        self.emulator.measure(self.scan_id, &mut scan, &mut odometry, &mut truth);
        truth.collided != 0 || truth.struck != 0
    }

    fn body(&self) -> Rectangle {
        let state = self.emulator.plant().state();
        self.scenario.body(state.x, state.y, state.yaw)
    }

    /// What is nearest to the body now.
    fn nearest(&self) -> Touched {
        let (body, time_s, scene) = (self.body(), self.time_s(), self.emulator.scene());
        let walls = scene.walls().map_or(f64::INFINITY, |[low, high]| {
            let middle = (low + high) / 2.0;
            body.distance_to_wall(low, middle).min(body.distance_to_wall(high, middle))
        });
        let mut nearest = (walls, Touched::Wall);
        for near in scene.near(body.centre, self.scenario.true_scanner().range_m) {
            let distance = near.solid(time_s).map_or(f64::INFINITY, |solid| solid.distance_to(&body));
            if distance < nearest.0 {
                let obstacle = *near.obstacle();
                nearest =
                    (distance, if obstacle.moves() { Touched::Moving(obstacle) } else { Touched::Fixed });
            }
        }
        nearest.1
    }

    /// Whether a beam can reach a body now: nothing hides it, and it is within the range and the view of the scanner.
    fn can_see(&self, obstacle: &ScenarioObstacle) -> bool {
        let (state, time_s) = (self.emulator.plant().state(), self.time_s());
        let values = self.scenario.robot_values();
        let (forward, left) = (heading(state.yaw), heading(state.yaw + std::f64::consts::FRAC_PI_2));
        let origin =
            Vector2::new(state.x, state.y) + forward * values.scanner_x_m + left * values.scanner_y_m;
        let scanner = self.scenario.true_scanner();
        let near: Vec<_> = self.emulator.scene().near(origin, scanner.range_m).collect();
        let beams = scanner.geometry();
        (0..beams.count).any(|beam| {
            let angle = beams.yaw_rad(beam);
            let direction = heading(state.yaw + values.scanner_yaw_rad + angle);
            let range = |solid: emulator::scene::Solid| solid.ray(origin, direction).unwrap_or(f64::INFINITY);
            let (mut nearest, mut is_it) = (scanner.range_m, false);
            for near in &near {
                let range = near.solid(time_s).map_or(f64::INFINITY, range);
                if range <= nearest {
                    (nearest, is_it) = (range, near.obstacle() == obstacle);
                }
            }
            is_it
        })
    }
}
