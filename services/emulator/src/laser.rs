//! The emulated Hokuyo URG-04LX.
//!
//! The scanner sits at the robot's centre, or where `robot.scanner_x_m` and its neighbours put it, and covers 240 deg.
//! Its beams are taken one after the other: each starts where the scanner is at that beam's time, and hits what is there
//! at that time, so the scan of a moving robot is skewed. The body of the robot is not seen.
//!
//! Noise, in this order: a beam across an edge may mix both distances (`noise.mixed_pixels`), the range gets
//! normal noise of `noise.range_m` or of the share `noise.range_share` of the range, whichever is larger, and a
//! beam may be lost (`noise.dropout`). The data sheet's +-10 mm below 1 m and +-1 % above are bounds, about three
//! standard deviations of 0.003 m and 0.003; the default of 0.01 m at any range is harsher up to 3 m.

use std::ops::RangeInclusive;

use nalgebra::Vector2;
use shared_types::{BEAMS, FRONT_BEAM, MIN_RANGE_MM, PITCH_RAD, Scan};
use vehicle::State;
use vehicle::frame::{heading, to_track, wrap_angle};

use crate::history::History;
use crate::noise::{Purpose, Stream};
use crate::scenario::{Noise, Scenario, Values};
use crate::scene::{PlacedObstacle, Scene};

/// Largest range that the scanner reports [m].
pub const MAX_RANGE_M: f64 = 5.6;

/// Error code where nothing came back, or from too far away.
pub const NO_RETURN: u16 = 0;

/// Error code where too little light came back: a dropout.
const LOW_INTENSITY: u16 = 1;

/// Error code of a surface nearer than 20 mm.
const TOO_NEAR: u16 = 19;

/// Neighbouring beams whose ranges differ by more than this lie on two sides of an edge [m].
const EDGE_M: f64 = 0.1;

/// When the beams of a scan are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sweep {
    /// Scan id, which the noise depends on.
    pub scan_id: u64,
    /// Time of the front beam [ns].
    pub front_ns: u64,
    /// How long the sweep over all beams lasts [ns].
    pub duration_ns: u64,
}

impl Sweep {
    /// Time of one beam [ns]; times before the start of the run are the start.
    pub fn beam_ns(&self, beam: usize) -> u64 {
        let before_front =
            |beams: usize| (beams as u128 * u128::from(self.duration_ns) / BEAMS as u128) as u64;
        if beam >= FRONT_BEAM {
            self.front_ns.saturating_add(before_front(beam - FRONT_BEAM))
        } else {
            self.front_ns.saturating_sub(before_front(FRONT_BEAM - beam))
        }
    }
}

/// One beam: where it starts, where it goes, and when.
#[derive(Debug, Clone, Copy)]
struct Beam {
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    time_s: f64,
}

/// The scanner with its buffers.
#[derive(Debug, Clone)]
pub struct Laser {
    seed: u64,
    noise: Noise,
    mount: Mount,
    beams: Vec<Beam>,
    ranges: Vec<f64>,
    mixed: Vec<f64>,
}

impl Laser {
    /// The scanner of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            seed: scenario.seed,
            noise: scenario.noise,
            mount: Mount::new(&scenario.robot_values()),
            beams: Vec::with_capacity(BEAMS),
            ranges: Vec::with_capacity(BEAMS),
            mixed: Vec::with_capacity(BEAMS),
        }
    }

    /// Ranges of one sweep past what stands around the robot [mm, or an error code below 20].
    pub fn measure(&mut self, sweep: &Sweep, history: &History, scene: &Scene, ranges_mm: &mut [u16; BEAMS]) {
        self.cast(sweep, history, scene);
        let mut stream = Stream::new(self.seed, Purpose::Laser, sweep.scan_id);
        self.mix_edges(&mut stream);
        for (reading, range) in ranges_mm.iter_mut().zip(&self.mixed) {
            *reading = reading_of(*range, &self.noise, &mut stream);
        }
    }

    /// True ranges of one sweep [m], infinite where a beam hits nothing within reach.
    pub fn cast(&mut self, sweep: &Sweep, history: &History, scene: &Scene) -> &[f64] {
        let motion = self.aim(sweep, history);
        self.ranges.clear();
        self.ranges.resize(BEAMS, f64::INFINITY);
        if let Some(walls) = scene.walls() {
            for (range, beam) in self.ranges.iter_mut().zip(&self.beams) {
                *range = wall_range(beam, walls);
            }
        }
        let half_sweep_s = sweep.duration_ns as f64 * 0.5e-9;
        for near in scene.near(motion.origin, MAX_RANGE_M + motion.travel) {
            for window in visible(near, &motion, half_sweep_s) {
                self.cast_at(near, window);
            }
        }
        &self.ranges
    }

    /// Computes where all beams start and go, and how far the robot moves meanwhile.
    fn aim(&mut self, sweep: &Sweep, history: &History) -> Motion {
        let front = history.at(sweep.front_ns).state;
        let (origin, yaw) = self.mount.pose(&front);
        let mut motion = Motion { origin, yaw, travel: 0.0, turn: 0.0, time_s: sweep.front_ns as f64 * 1e-9 };
        let mut walk = history.walk();
        self.beams.clear();
        for index in 0..BEAMS {
            let time_ns = sweep.beam_ns(index);
            let state = walk(time_ns).state;
            let (origin, yaw) = self.mount.pose(&state);
            motion.travel = motion.travel.max((origin - motion.origin).norm());
            motion.turn = motion.turn.max((yaw - motion.yaw).abs());
            self.beams.push(Beam {
                origin,
                direction: heading(yaw + Scan::beam_yaw_rad(index)),
                time_s: time_ns as f64 * 1e-9,
            });
        }
        motion
    }

    /// Shortens the ranges of the beams in `window` that hit an obstacle.
    fn cast_at(&mut self, near: &PlacedObstacle, window: RangeInclusive<usize>) {
        let fixed = if near.is_permanent() { near.solid(0.0) } else { None };
        for index in window {
            let beam = &self.beams[index];
            if let Some(solid) = fixed.or_else(|| near.solid(beam.time_s))
                && let Some(range) = solid.ray(beam.origin, beam.direction)
                && range < self.ranges[index]
            {
                self.ranges[index] = range;
            }
        }
    }

    /// Copies the true ranges, with mixed ones at edges.
    fn mix_edges(&mut self, stream: &mut Stream) {
        self.mixed.clear();
        self.mixed.extend_from_slice(&self.ranges);
        if self.noise.mixed_pixels <= 0.0 {
            return;
        }
        for index in 1..BEAMS {
            let (before, after) = (self.ranges[index - 1], self.ranges[index]);
            let is_edge = before <= MAX_RANGE_M && after <= MAX_RANGE_M && (before - after).abs() > EDGE_M;
            // The beam's spot covers both surfaces: the distance comes out somewhere between them.
            if is_edge && stream.chance(self.noise.mixed_pixels) {
                self.mixed[index] = stream.between(before.min(after), before.max(after));
            }
        }
    }
}

/// Where the scanner is on the robot.
#[derive(Debug, Clone, Copy)]
struct Mount {
    forward_m: f64,
    left_m: f64,
    yaw_rad: f64,
}

impl Mount {
    fn new(robot: &Values) -> Self {
        let Values { scanner_x_m, scanner_y_m, scanner_yaw_rad, .. } = *robot;
        Self { forward_m: scanner_x_m, left_m: scanner_y_m, yaw_rad: scanner_yaw_rad }
    }

    /// Position and yaw of the scanner on a robot.
    fn pose(&self, robot: &State) -> (Vector2<f64>, f64) {
        let centre = Vector2::new(robot.x, robot.y);
        if self.forward_m == 0.0 && self.left_m == 0.0 {
            return (centre, robot.yaw + self.yaw_rad);
        }
        (centre + to_track(robot.yaw, self.forward_m, self.left_m), robot.yaw + self.yaw_rad)
    }
}

/// Pose at the front beam and the largest deviation from it during the sweep.
#[derive(Debug, Clone, Copy)]
struct Motion {
    origin: Vector2<f64>,
    yaw: f64,
    travel: f64,
    turn: f64,
    time_s: f64,
}

/// The beams that may hit an obstacle at some time of the sweep, as up to two windows.
fn visible(
    near: &PlacedObstacle,
    motion: &Motion,
    half_sweep_s: f64,
) -> impl Iterator<Item = RangeInclusive<usize>> {
    let reach = near.reach() + motion.travel + near.speed() * half_sweep_s;
    let offset = near.centre(motion.time_s) - motion.origin;
    let distance = offset.norm();
    let (middle, half) = if distance <= reach {
        (0.0, std::f64::consts::PI)
    } else {
        let bearing = wrap_angle(offset.y.atan2(offset.x) - motion.yaw);
        (bearing, (reach / distance).asin() + motion.turn + PITCH_RAD)
    };
    let in_range = distance - reach <= MAX_RANGE_M;
    // An obstacle behind the robot may reach into the field of view from both ends.
    [-1.0, 0.0, 1.0].into_iter().filter_map(move |turns: f64| {
        let centre = middle + turns * std::f64::consts::TAU;
        let low = ((centre - half) / PITCH_RAD).floor() + FRONT_BEAM as f64;
        let high = ((centre + half) / PITCH_RAD).ceil() + FRONT_BEAM as f64;
        let is_seen = in_range && high >= 0.0 && low <= (BEAMS - 1) as f64;
        is_seen.then(|| low.max(0.0) as usize..=(high as usize).min(BEAMS - 1))
    })
}

fn wall_range(beam: &Beam, [low, high]: [f64; 2]) -> f64 {
    if beam.direction.y.abs() < 1e-12 {
        // Along the walls.
        return f64::INFINITY;
    }
    let wall = if beam.direction.y > 0.0 { high } else { low };
    // Behind a wall the range is zero: an error code.
    ((wall - beam.origin.y) / beam.direction.y).max(0.0)
}

fn reading_of(range: f64, noise: &Noise, stream: &mut Stream) -> u16 {
    if range > MAX_RANGE_M {
        return NO_RETURN;
    }
    let deviation = noise.range_m.max(noise.range_share * range);
    let measured = if deviation > 0.0 { range + deviation * stream.normal() } else { range };
    if noise.dropout > 0.0 && stream.chance(noise.dropout) {
        return LOW_INTENSITY;
    }
    let millimetres = (measured * 1000.0).round();
    if millimetres > MAX_RANGE_M * 1000.0 {
        NO_RETURN
    } else if millimetres < f64::from(MIN_RANGE_MM) {
        TOO_NEAR
    } else {
        millimetres as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::Node;

    const SWEEP: Sweep = Sweep { scan_id: 1, front_ns: 100_000_000, duration_ns: 66_666_666 };

    fn node(time_ns: u64, state: State) -> Node {
        Node {
            time_ns,
            state,
            speed: 0.0,
            steering: 0.0,
            reported: Vector2::zeros(),
            reported_yaw: 0.0,
            encoder_m: 0.0,
        }
    }

    fn standing() -> History {
        History::new(node(0, State::default()), 1_000_000_000)
    }

    fn quiet(text: &str) -> Scenario {
        Scenario::parse(&format!("{text}\n[noise]\nrange_m = 0.0"), "test").unwrap()
    }

    fn readings(scenario: &Scenario, history: &History) -> [u16; BEAMS] {
        let mut ranges = [7; BEAMS];
        Laser::new(scenario).measure(&SWEEP, history, &Scene::new(scenario), &mut ranges);
        ranges
    }

    fn circle(x: f64, y: f64, radius: f64, more: &str) -> String {
        format!("[[obstacle]]\nshape = \"circle\"\nx_m = {x}\ny_m = {y}\nradius_m = {radius}\n{more}")
    }

    #[test]
    fn a_post_straight_ahead_is_seen_at_its_near_side_by_as_many_beams_as_it_is_wide() {
        let ranges = readings(&quiet(&circle(2.0, 0.0, 0.1, "")), &standing());
        assert_eq!(ranges[FRONT_BEAM], 1900);
        // asin(0.1 / 2) = 2.866 deg to each side, 8.15 pitches of 0.3516 deg: 17 beams.
        let hits: Vec<usize> = (0..BEAMS).filter(|beam| ranges[*beam] >= MIN_RANGE_MM).collect();
        assert_eq!((hits[0], hits.len()), (FRONT_BEAM - 8, 17));
        assert_eq!(ranges[0], NO_RETURN);
    }

    #[test]
    fn a_box_is_seen_with_its_flat_face_and_the_right_beams_come_first() {
        let text = "[[obstacle]]\nshape = \"box\"\nx_m = 3.05\ny_m = -0.5\nlength_m = 0.1\nwidth_m = 1.0";
        let ranges = readings(&quiet(text), &standing());
        // Face at x = 3 from y = -1 to 0: beam 300 points 40 pitches = 14.0625 deg to the right, 3 / cos = 3.0927.
        assert_eq!(ranges[300], 3093);
        assert_eq!(ranges[FRONT_BEAM - 1], 3000);
        assert_eq!(ranges[FRONT_BEAM + 2], NO_RETURN, "nothing on the left");
    }

    #[test]
    fn walls_are_seen_at_their_distance_over_the_cosine() {
        let scenario = quiet("[track]\nwalls = true\ny_m = [-1.9, 1.9]");
        let ranges = readings(&scenario, &standing());
        // 256 pitches are 90 deg.
        assert_eq!((ranges[FRONT_BEAM - 256], ranges[FRONT_BEAM + 256]), (1900, 1900));
        // 171 pitches: 1.9 / sin(60.117 deg) = 2.1914.
        assert_eq!(ranges[FRONT_BEAM + 171], 2191);
        assert_eq!(ranges[FRONT_BEAM], NO_RETURN);
    }

    #[test]
    fn a_moving_robot_sees_a_skewed_scan() {
        // 1 m/s along x: the beam at +60 deg (171 of 682 sweep positions later) starts 16.7 mm further ahead.
        let mut history = History::new(node(0, State::default()), 1_000_000_000);
        history.push(node(200_000_000, State { x: 0.2, ..State::default() }));
        let scenario =
            quiet("[[obstacle]]\nshape = \"box\"\nx_m = 2.15\ny_m = 0\nlength_m = 0.1\nwidth_m = 9");
        let ranges = readings(&scenario, &history);
        // Front beam at t = 0.1 s: robot at 0.1, face at 2.1.
        assert_eq!(ranges[FRONT_BEAM], 2000);
        for beam in [FRONT_BEAM - 128, FRONT_BEAM + 128] {
            // 45 deg; the right beam was taken 12.5 ms earlier and is longer by 25 mm * sqrt(2) than the left one.
            let shift = (beam as f64 - FRONT_BEAM as f64) / BEAMS as f64 * 0.066_666_666;
            let expected = (2.0 - shift) * std::f64::consts::SQRT_2 * 1000.0;
            assert!((f64::from(ranges[beam]) - expected).abs() <= 0.51, "{} {expected}", ranges[beam]);
        }
        assert_eq!(ranges[FRONT_BEAM - 128] - ranges[FRONT_BEAM + 128], 35);
    }

    #[test]
    fn a_moving_obstacle_is_hit_where_it_is_at_the_time_of_the_beam() {
        let scenario = quiet(&circle(3.0, 0.0, 0.2, "velocity_x_mps = -1.0"));
        let ranges = readings(&scenario, &standing());
        assert_eq!(ranges[FRONT_BEAM], 2700);
        let gone = quiet(&circle(3.0, 0.0, 0.2, "disappears_s = 0.0995"));
        let ranges = readings(&gone, &standing());
        assert!(ranges[FRONT_BEAM - 10] > 2000, "still there a millisecond before the front beam");
        assert_eq!(ranges[FRONT_BEAM], NO_RETURN);
    }

    #[test]
    fn culling_changes_nothing() {
        let mut stream = Stream::new(5, Purpose::Course, 0);
        for _ in 0..200 {
            let (x, y) = (stream.between(-5.0, 5.0), stream.between(-5.0, 5.0));
            if x.hypot(y) < 1.5 {
                continue;
            }
            let scenario = quiet(&circle(x, y, stream.between(0.05, 1.0), "velocity_y_mps = 0.7"));
            let yaw = stream.between(-3.0, 3.0);
            let mut history = History::new(node(0, State { yaw, ..State::default() }), 1_000_000_000);
            history.push(node(200_000_000, State { yaw: yaw + 0.3, x: 0.2, ..State::default() }));
            let (mut laser, scene) = (Laser::new(&scenario), Scene::new(&scenario));
            laser.cast(&SWEEP, &history, &scene);
            let culled = laser.ranges.clone();
            let near = scene.near(Vector2::zeros(), 100.0).next().unwrap();
            laser.ranges.fill(f64::INFINITY);
            laser.cast_at(near, 0..=BEAMS - 1);
            for (with, without) in culled.iter().zip(&laser.ranges) {
                assert!(with == without || *without > MAX_RANGE_M);
            }
        }
    }

    #[test]
    fn readings_are_error_codes_below_20_mm_and_beyond_5600_mm() {
        let silent = Noise { range_m: 0.0, ..Noise::default() };
        let mut stream = Stream::new(1, Purpose::Laser, 1);
        let mut reading = |range| reading_of(range, &silent, &mut stream);
        assert_eq!(reading(0.0194), TOO_NEAR);
        assert_eq!(reading(0.0196), 20);
        assert_eq!(reading(5.6), 5600);
        assert_eq!(reading(5.6001), NO_RETURN);
        assert_eq!(reading(f64::INFINITY), NO_RETURN);
        assert!(reading(f64::NAN) < MIN_RANGE_MM, "never a range");
    }

    #[test]
    fn noise_and_dropouts_are_as_frequent_as_asked_for() {
        let scenario = Scenario::parse(
            &format!(
                "{}[noise]\nrange_m = 0.02\ndropout = 0.05",
                "[track]\nwalls = true\ny_m = [-1.0, 1.0]\n"
            ),
            "test",
        )
        .unwrap();
        let (mut laser, scene, history) = (Laser::new(&scenario), Scene::new(&scenario), standing());
        let (mut lost, mut count, mut squares) = (0, 0, 0.0);
        for scan_id in 1..=100 {
            let mut ranges = [0; BEAMS];
            laser.measure(&Sweep { scan_id, ..SWEEP }, &history, &scene, &mut ranges);
            for beam in (0..BEAMS).filter(|beam| laser.ranges[*beam] < 5.0) {
                count += 1;
                if ranges[beam] == LOW_INTENSITY {
                    lost += 1;
                } else {
                    squares += (f64::from(ranges[beam]) * 1e-3 - laser.ranges[beam]).powi(2);
                }
            }
        }
        // About 60000 beams: five standard errors are 0.0045 of the share and 1.5 % of the deviation.
        assert!((f64::from(lost) / f64::from(count) - 0.05).abs() < 0.0045);
        let deviation = (squares / f64::from(count - lost)).sqrt();
        assert!((deviation / 0.02 - 1.0).abs() < 0.015, "{deviation}");
    }

    #[test]
    fn a_mixed_pixel_lies_between_the_two_sides_of_an_edge() {
        let text = format!(
            "{}[[obstacle]]\nshape = \"box\"\nx_m = 3.05\ny_m = 0\nlength_m = 0.1\nwidth_m = 6\n\
             [noise]\nrange_m = 0.0\nmixed_pixels = 1",
            circle(1.5, 0.0, 0.1, "")
        );
        let ranges = readings(&Scenario::parse(&text, "test").unwrap(), &standing());
        let between = ranges.iter().filter(|range| (1600..2900).contains(*range)).count();
        assert!(
            (1..=2).contains(&between),
            "one at each edge of the post unless it lands near a side: {between}"
        );
    }

    #[test]
    fn beams_start_at_the_scanner_and_turn_with_it() {
        let post = circle(2.0, 0.0, 0.1, "");
        let mounted = |keys: &str| readings(&quiet(&format!("{post}\n[robot]\n{keys}")), &standing());
        assert_eq!(mounted("scanner_x_m = 0.25")[FRONT_BEAM], 1650);
        // 0.05 m to the left of the line, the post is hit 2 - sqrt(0.01 - 0.0025) ahead.
        assert_eq!(mounted("scanner_y_m = 0.05")[FRONT_BEAM], 1913);
        // A quarter turn to the left is 256 pitches: the post comes 256 beams earlier.
        let turned = mounted("scanner_yaw_rad = 1.5707963267948966");
        assert_eq!((turned[FRONT_BEAM], turned[FRONT_BEAM - 256]), (NO_RETURN, 1900));
        // Ahead of a robot that looks to the left is to the left of the track.
        let mut history = History::new(node(0, State::default()), 1_000_000_000);
        history.push(node(1, State { yaw: std::f64::consts::FRAC_PI_2, ..State::default() }));
        let scenario = quiet("[track]\nwalls = true\ny_m = [-2.0, 2.0]\n[robot]\nscanner_x_m = 0.25");
        assert_eq!(readings(&scenario, &history)[FRONT_BEAM], 1750);
    }
}
