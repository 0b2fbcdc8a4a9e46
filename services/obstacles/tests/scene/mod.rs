//! A small scene with a ray-caster: what the scanner would measure, with noise and dropouts.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    reason = "each test file uses its part of the scene"
)]

use nalgebra::Vector2;
use obstacles::{CoverRule, ObstacleDetector, ObstaclesConfig};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shared_types::{BEAMS, Header, Obstacles, Pose, Scan, ScanGeometry};
use vehicle::frame::to_robot;
use vehicle::geometry::Rectangle;
use vehicle::{Description, Surroundings};

/// Scan period [ns].
pub const PERIOD_NS: u64 = 100_000_000;

/// A body that may move.
#[derive(Clone, Copy)]
pub enum Body {
    Box(Rectangle, Vector2<f64>),
    Circle(Vector2<f64>, f64),
}

/// The robot's true motion at the front beam.
#[derive(Clone, Copy, Default)]
pub struct Robot {
    pub x: f64,
    pub y: f64,
    pub yaw: f64,
    pub speed: f64,
    pub yaw_rate: f64,
}

impl Robot {
    pub fn at(x: f64, y: f64, yaw: f64) -> Self {
        Self { x, y, yaw, speed: 0.0, yaw_rate: 0.0 }
    }

    /// Where it is after `time` at constant speed and yaw rate.
    pub fn after(&self, time: f64) -> Self {
        let middle = self.yaw + self.yaw_rate * time / 2.0;
        Self {
            x: self.x + self.speed * time * middle.cos(),
            y: self.y + self.speed * time * middle.sin(),
            yaw: self.yaw + self.yaw_rate * time,
            ..*self
        }
    }

    pub fn body(&self) -> Rectangle {
        Rectangle { centre: Vector2::new(self.x, self.y), yaw: self.yaw, length: 0.56, width: 0.40 }
    }
}

/// Bodies, walls and noise.
pub struct Scene {
    pub bodies: Vec<Body>,
    pub walls: Option<[f64; 2]>,
    pub range_noise: f64,
    pub dropout: f64,
    pub mixed: bool,
    /// Directions from which nothing returns [rad].
    pub dead_rad: Option<[f64; 2]>,
    pub pose_noise: (f64, f64),
    pub random: Pcg64Mcg,
    pub scans: u64,
}

impl Scene {
    pub fn of(bodies: &[Body]) -> Self {
        Self {
            bodies: bodies.to_vec(),
            walls: None,
            range_noise: 0.0,
            dropout: 0.0,
            mixed: false,
            dead_rad: None,
            pose_noise: (0.0, 0.0),
            random: Pcg64Mcg::seed_from_u64(1),
            scans: 0,
        }
    }

    /// Ranges with 2 cm noise, 5 % dropouts, mixed pixels and a pose with 1.5 cm and 0.01 rad noise.
    pub fn noisy(mut self, seed: u64) -> Self {
        (self.range_noise, self.dropout, self.mixed, self.pose_noise) = (0.02, 0.05, true, (0.015, 0.01));
        self.random = Pcg64Mcg::seed_from_u64(seed);
        self
    }

    pub fn with_walls(mut self, low: f64, high: f64) -> Self {
        self.walls = Some([low, high]);
        self
    }

    /// The next scan, 100 ms after the one before, and the pose reported for it.
    pub fn scan(&mut self, robot: &Robot) -> (Scan, Pose) {
        self.scans += 1;
        let header = Header { scan_id: self.scans, acquired_ns: self.scans * PERIOD_NS, ..Header::default() };
        let mut scan = Scan {
            header,
            sweep_ns: PERIOD_NS * 2 / 3,
            period_ns: PERIOD_NS,
            ..Scan::of(ScanGeometry::URG_04LX)
        };
        let mut last = None;
        for beam in 0..BEAMS {
            let time = scan.beam_time_s(beam);
            let seen = robot.after(time);
            let angle = seen.yaw + ScanGeometry::URG_04LX.yaw_rad(beam);
            let direction = Vector2::new(angle.cos(), angle.sin());
            let now = self.scans as f64 * 0.1 + time;
            let sharp = self.cast(Vector2::new(seen.x, seen.y), direction, now);
            let mut range = sharp;
            if let (true, Some(before), Some(here)) = (self.mixed, last, sharp) {
                // One beam in two at an edge sees both surfaces.
                let step: f64 = here - before;
                if step.abs() > 0.2 && self.uniform() < 0.5 {
                    range = Some(before + step * self.uniform());
                }
            }
            last = sharp;
            let noise = self.range_noise * self.gauss();
            let is_dead =
                |[low, high]: [f64; 2]| (low..=high).contains(&ScanGeometry::URG_04LX.yaw_rad(beam));
            let lost = self.uniform() < self.dropout || self.dead_rad.is_some_and(is_dead);
            scan.ranges_mm[beam] = match range {
                Some(range) if !lost && range + noise < 5.6 => {
                    ((range + noise).max(0.02) * 1e3).round() as u32
                }
                _ => 0,
            };
        }
        let (metres, radians) = self.pose_noise;
        let pose = Pose {
            header,
            x_m: robot.x + metres * self.gauss(),
            y_m: robot.y + metres * self.gauss(),
            yaw_rad: robot.yaw + radians * self.gauss(),
            speed_mps: robot.speed,
            yaw_rate_radps: robot.yaw_rate,
            ..Pose::default()
        };
        (scan, pose)
    }

    pub fn cast(&self, from: Vector2<f64>, direction: Vector2<f64>, now: f64) -> Option<f64> {
        let mut nearest = f64::INFINITY;
        for body in &self.bodies {
            let hit = match *body {
                Body::Box(rectangle, velocity) => {
                    let moved = Rectangle { centre: rectangle.centre + velocity * now, ..rectangle };
                    cast_box(&moved, from, direction)
                }
                Body::Circle(centre, radius) => cast_circle(centre - from, radius, direction),
            };
            nearest = nearest.min(hit.unwrap_or(f64::INFINITY));
        }
        for wall in self.walls.iter().flatten() {
            let range = (wall - from.y) / direction.y;
            if range > 0.0 {
                nearest = nearest.min(range);
            }
        }
        (nearest < 5.6).then_some(nearest)
    }

    pub fn uniform(&mut self) -> f64 {
        (self.random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn gauss(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

fn cast_box(rectangle: &Rectangle, from: Vector2<f64>, direction: Vector2<f64>) -> Option<f64> {
    let offset = from - rectangle.centre;
    let start = to_robot(rectangle.yaw, offset.x, offset.y);
    let ray = to_robot(rectangle.yaw, direction.x, direction.y);
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for (start, ray, half) in
        [(start.x, ray.x, rectangle.length / 2.0), (start.y, ray.y, rectangle.width / 2.0)]
    {
        let (one, two) = ((-half - start) / ray, (half - start) / ray);
        enter = enter.max(one.min(two));
        leave = leave.min(one.max(two));
    }
    (enter < leave).then_some(enter)
}

fn cast_circle(centre: Vector2<f64>, radius: f64, direction: Vector2<f64>) -> Option<f64> {
    let along = centre.dot(&direction);
    let across = centre.norm_squared() - along * along;
    let range = along - (radius * radius - across).max(0.0).sqrt();
    (across < radius * radius && range > 0.0).then_some(range)
}

/// A box at rest.
pub fn block(x: f64, y: f64, length: f64, width: f64, yaw: f64) -> Body {
    Body::Box(rectangle(x, y, length, width, yaw), Vector2::zeros())
}

/// A box that moves.
pub fn mover(x: f64, y: f64, size: f64, velocity_x: f64, velocity_y: f64) -> Body {
    Body::Box(rectangle(x, y, size, size, 0.0), Vector2::new(velocity_x, velocity_y))
}

pub fn rectangle(x: f64, y: f64, length: f64, width: f64, yaw: f64) -> Rectangle {
    Rectangle { centre: Vector2::new(x, y), yaw, length, width }
}

/// Settings for a scene in which nothing is around the track.
pub fn open() -> ObstaclesConfig {
    let vehicle = Description { surroundings: Surroundings::Open, ..Description::default() };
    ObstaclesConfig { vehicle, ..ObstaclesConfig::default() }
}

/// A detector with the ellipses of (7.35).
pub fn detector() -> ObstacleDetector {
    ObstacleDetector::new(ObstaclesConfig { cover: CoverRule::Source, ..open() }).unwrap()
}

/// A detector with the default ellipses.
pub fn tight() -> ObstacleDetector {
    ObstacleDetector::new(open()).unwrap()
}

pub fn with_walls() -> ObstacleDetector {
    let config = ObstaclesConfig { walls: true, cover: CoverRule::Source, ..open() };
    ObstacleDetector::new(config).unwrap()
}

/// Descriptions of `count` scans from a robot that moves on between them.
pub fn run(
    detector: &mut ObstacleDetector,
    scene: &mut Scene,
    robot: &mut Robot,
    count: usize,
) -> Vec<Obstacles> {
    (0..count)
        .map(|_| {
            let (scan, pose) = scene.scan(robot);
            *robot = robot.after(0.1);
            detector.step(&scan, &pose)
        })
        .collect()
}

/// How many different bodies a description holds.
pub fn bodies(obstacles: &Obstacles) -> usize {
    let mut bodies: Vec<u32> = obstacles.list().iter().map(|item| item.body).collect();
    bodies.sort_unstable();
    bodies.dedup();
    bodies.len()
}
