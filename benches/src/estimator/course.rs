//! What is driven: a robot, a setting of the estimator, and a course of the length asked for.

use std::fmt::Write as _;

use clap::ValueEnum;
use emulator::Scenario;
use emulator::noise::{NoiseStream, Purpose};
use plan::{Choice, Plan};

use super::EstimatorArguments;

/// True robots with the keys that make them.
pub(super) const ROBOTS: [(&str, &[&str]); 3] = [
    ("ideal", &["robot.preset=ideal", "noise.odometry_m=0.02", "noise.odometry_rad=0.01"]),
    ("summit", &["robot.preset=summit"]),
    ("worn", &["robot.preset=worn"]),
];

/// Settings of the estimator that are compared, with their keys.
const LASERS: [(&str, &[&str]); 2] =
    [("off", &["estimator.laser=off"]), ("match", &["estimator.laser=match"])];

/// Slower than this no robot drives in the mean, so it has reached its goal or stands for good [m/s].
const SLOWEST_MPS: f64 = 0.2;
/// Distance from the goal to the end of the track [m].
const BEHIND_GOAL_M: f64 = 10.0;
/// Distance of the fronts of rooms from the middle of the corridor [m].
const FRONT_M: f64 = 1.9;
/// Distance of the backs of rooms from there [m].
const BACK_M: f64 = 4.5;
/// Thickness of the walls of rooms [m].
const WALL_M: f64 = 0.1;

/// What stands along the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Ground {
    /// A box every 5.5 m in a hall with pillars, placed by the seed.
    Endless,
    /// Nothing on the track, in a hall with pillars.
    Empty,
    /// Two plain walls and nothing else: they do not show how far the robot has driven.
    PlainWalls,
    /// A corridor between rooms with open doors, which the seed draws; only the scanner sees them.
    Rooms,
}

/// One robot under one setting on one kind of course.
#[derive(Debug, Clone, Copy)]
pub(super) struct Condition {
    pub(super) ground: Ground,
    pub(super) robot: &'static str,
    pub(super) laser: &'static str,
    keys: [&'static [&'static str]; 2],
}

impl Condition {
    /// The chosen courses with the chosen robots, each with all settings.
    pub(super) fn all(arguments: &EstimatorArguments) -> Vec<Self> {
        let is_chosen =
            |name: &str| arguments.robots.is_empty() || arguments.robots.iter().any(|robot| robot == name);
        let mut conditions = Vec::new();
        for &ground in &arguments.grounds {
            for (robot, of_robot) in ROBOTS.into_iter().filter(|(name, _)| is_chosen(name)) {
                let of_laser = |(laser, keys)| Self { ground, robot, laser, keys: [of_robot, keys] };
                conditions.extend(LASERS.into_iter().map(of_laser));
            }
        }
        conditions
    }

    /// A system without a drive, whose pose is corrected by the laser; keys that the user sets win.
    ///
    /// # Errors
    /// As [`Self::plan`].
    pub(super) fn alone(arguments: &EstimatorArguments) -> anyhow::Result<Plan> {
        let text = "name = \"follow\"\n[goal]\nx_m = 10.0\n";
        let own = LASERS[1].1.iter().map(|key| (*key).to_owned());
        let overrides = own.chain(arguments.choice.overrides.iter().cloned()).collect();
        let choice = Choice { overrides, ..arguments.choice.clone() };
        Plan::of(&Scenario::parse(text, "follow")?, &choice)
    }

    /// Whether it is the first one of its robot and course: the odometer is measured there.
    pub(super) fn is_first_setting(&self) -> bool {
        self.laser == LASERS[0].0
    }

    /// What is driven with a seed; keys that the user sets win.
    ///
    /// # Errors
    /// One message with key, value and allowed range; exit code 2.
    pub(super) fn plan(&self, arguments: &EstimatorArguments, seed: u64) -> anyhow::Result<Plan> {
        let way_m = arguments.way;
        let timeout_s = arguments.duration.unwrap_or(30.0 + way_m / SLOWEST_MPS);
        let text = self.ground.text(way_m, timeout_s, seed);
        let scenario = Scenario::parse(&text, self.ground.name())?;
        let own = self.keys.iter().copied().flatten().map(|key| (*key).to_owned());
        // The rooms are surroundings that the scanner sees, and no scenery of the track.
        let seen = (self.ground == Ground::Rooms).then(|| "vehicle.surroundings=hall".to_owned());
        let overrides = own.chain(seen).chain(arguments.choice.overrides.iter().cloned()).collect();
        Plan::of(&scenario, &Choice { overrides, seed: Some(seed), ..arguments.choice.clone() })
    }
}

impl Ground {
    /// Its name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Endless => "endless",
            Self::Empty => "empty",
            Self::PlainWalls => "plain-walls",
            Self::Rooms => "rooms",
        }
    }

    /// The scenario file.
    fn text(self, way_m: f64, timeout_s: f64, seed: u64) -> String {
        let (name, end_m) = (self.name(), way_m + BEHIND_GOAL_M);
        let more = match self {
            Self::Endless => "[endless]\n".to_owned(),
            Self::Empty => String::new(),
            Self::PlainWalls => "[track]\nwalls = true\ny_m = [-1.9, 1.9]\n".to_owned(),
            Self::Rooms => format!("[track]\nsurroundings = \"open\"\n{}", rooms(end_m, seed)),
        };
        let track = if more.contains("[track]\n") { "" } else { "[track]\n" };
        let more =
            format!("{track}{more}").replacen("[track]\n", &format!("[track]\nx_m = [0.0, {end_m:?}]\n"), 1);
        format!("name = {name:?}\ntimeout_s = {timeout_s:?}\n[goal]\nx_m = {way_m:?}\n{more}")
    }
}

/// Rooms of 2 to 6 m length on both sides of the corridor up to `end_m`, with doors of 0.8 to 1.4 m, and its two ends.
fn rooms(end_m: f64, seed: u64) -> String {
    let mut boxes = String::new();
    let mut add = |x_m: [f64; 2], y_m: [f64; 2]| {
        let [x, y] = [x_m, y_m].map(|[from, to]| f64::midpoint(from, to));
        let _ = write!(
            boxes,
            "[[obstacle]]\nshape = \"box\"\nx_m = {x:?}\ny_m = {y:?}\nlength_m = {:?}\nwidth_m = {:?}\n",
            x_m[1] - x_m[0],
            y_m[1] - y_m[0]
        );
    };
    let begin_m = -BEHIND_GOAL_M / 2.0;
    for (side, number) in [(1.0, 0), (-1.0, 1)] {
        let mut stream = NoiseStream::new(seed, Purpose::Course, number);
        let across = |from: f64, to: f64| if side > 0.0 { [from, to] } else { [-to, -from] };
        let mut x_m = begin_m;
        while x_m < end_m {
            // A room from one partition to the next, with one door in its front.
            let (length_m, door_m) = (stream.between(2.0, 6.0), stream.between(0.8, 1.4));
            let door_at_m = x_m + stream.between(0.2, length_m - door_m - 0.2);
            let next_m = x_m + length_m;
            let front = across(FRONT_M, FRONT_M + WALL_M);
            add([x_m, door_at_m], front);
            add([door_at_m + door_m, next_m], front);
            add([x_m, x_m + WALL_M], across(FRONT_M + WALL_M, BACK_M));
            add([x_m, next_m], across(BACK_M, BACK_M + WALL_M));
            x_m = next_m;
        }
    }
    for x_m in [begin_m - WALL_M, end_m + BEHIND_GOAL_M] {
        add([x_m, x_m + WALL_M], [-BACK_M, BACK_M]);
    }
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_course_has_its_length_and_rooms_differ_by_seed() {
        for ground in Ground::value_variants() {
            let read = |seed| Scenario::parse(&ground.text(40.0, 99.0, seed), ground.name()).unwrap();
            let scenario = read(1);
            assert_eq!((scenario.goal.last().x_m, scenario.track.x_m), (40.0, [0.0, 50.0]));
            assert_eq!((scenario.timeout_s, scenario.track.walls), (99.0, *ground == Ground::PlainWalls));
            assert_eq!(scenario.obstacles == read(2).obstacles, *ground != Ground::Rooms);
        }
        let rooms = Scenario::parse(&Ground::Rooms.text(40.0, 99.0, 3), "rooms").unwrap().obstacles;
        assert!(rooms.len() > 60, "{}", rooms.len());
        assert!(rooms.iter().all(|wall| wall.y_m.abs() > FRONT_M || wall.x_m < 0.0 || wall.x_m > 50.0));
    }
}
