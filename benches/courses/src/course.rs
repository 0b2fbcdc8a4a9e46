//! Random courses for campaigns.
//!
//! One to three obstacles of any kind up to 0.5 m wide, 5.5 m apart or a little more, none nearer than 3.5 m after
//! the start or 4.5 m before the goal; half of them near the line, the others anywhere; sometimes walls; noise up to
//! the largest that the stack is designed for. A course need not be passable: see [`crate::feasible::passable`].

mod curved;
pub mod hostile;
mod random_obstacle;
mod reversing;

use shared_types::named_enum;

use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{Goal, Noise, Scenario, ScenarioObstacle, Shape, Track};
use random_obstacle::obstacle;

pub use curved::curved;
pub use reversing::reversing;

/// No surface of an obstacle stands nearer to the start than this [m].
const AFTER_START_M: f64 = 3.5;

/// No surface of an obstacle stands nearer to the goal than this [m].
const BEFORE_GOAL_M: f64 = 4.5;

/// Smallest distance from obstacle to obstacle along the track [m].
const SPACING_M: f64 = 5.5;

/// Largest distance of the goal from the start, so that the robot can overshoot within the track [m].
const GOAL_MAX_M: f64 = 21.5;

/// The course of a seed.
pub fn random(seed: u64) -> Scenario {
    let seed = seed & i64::MAX as u64;
    let mut stream = NoiseStream::new(seed, Purpose::Course, 0);
    let count = 1 + (3.0 * stream.uniform()) as usize;
    let mut obstacles: Vec<ScenarioObstacle> = (0..count).map(|_| obstacle(&mut stream)).collect();

    // What is left of the track after the needed distances is divided at random.
    let reach = |obstacles: &[ScenarioObstacle], index: usize| obstacles[index].reach();
    let needed = AFTER_START_M
        + reach(&obstacles, 0)
        + (count - 1) as f64 * SPACING_M
        + reach(&obstacles, count - 1)
        + BEFORE_GOAL_M;
    let mut spare = GOAL_MAX_M - needed;
    let mut take = |stream: &mut NoiseStream| {
        let share = spare * stream.uniform() / 2.0;
        spare -= share;
        share
    };
    let mut x_m = AFTER_START_M + reach(&obstacles, 0) + take(&mut stream);
    for (index, obstacle) in obstacles.iter_mut().enumerate() {
        if index > 0 {
            x_m += SPACING_M + take(&mut stream);
        }
        obstacle.x_m = x_m;
    }
    let goal_m = x_m + reach(&obstacles, count - 1) + BEFORE_GOAL_M + take(&mut stream);

    let walls = stream.chance(0.3);
    let y_m = if walls { [-1.9, 1.9] } else { [-1.5, 1.5] };
    Scenario {
        name: format!("course-{seed}"),
        seed,
        track: Track { y_m, walls, ..Track::default() },
        goal: Goal { x_m: goal_m, ..Goal::default() }.into(),
        obstacles,
        noise: Noise {
            range_m: stream.between(0.0, 0.02),
            dropout: stream.between(0.0, 0.05),
            odometry_m: stream.between(0.0, 0.02),
            odometry_rad: stream.between(0.0, 0.01),
            ..Noise::default()
        },
        ..Scenario::default()
    }
}

named_enum! {
    /// What kind of course a campaign drives.
    pub enum Family {
        /// Obstacles at rest anywhere, as [`random`] places them.
        Plain "plain",
        /// All obstacles exactly on the line.
        Symmetric "symmetric",
        /// The track is closed.
        Blocked "blocked",
        /// An obstacle appears 1.0 to 3.0 m ahead.
        Sudden "sudden",
        /// One obstacle crosses the track or comes along it.
        Moving "moving",
    }
}

/// The course of a seed in a campaign, and its family: six in ten are plain, the others share the rest.
pub fn of_campaign(seed: u64) -> (Family, Scenario) {
    let mut course = random(seed);
    let mut stream = NoiseStream::new(course.seed, Purpose::Course, 1);
    let draw = stream.uniform();
    let family = match draw {
        _ if draw < 0.6 => Family::Plain,
        _ if draw < 0.7 => Family::Symmetric,
        _ if draw < 0.8 => Family::Blocked,
        _ if draw < 0.9 => Family::Sudden,
        _ => Family::Moving,
    };
    let half_width = course.track.y_m[1];
    match family {
        Family::Plain => {}
        Family::Symmetric => course.obstacles.iter_mut().for_each(|obstacle| obstacle.y_m = 0.0),
        Family::Blocked => {
            let which = (stream.uniform() * course.obstacles.len() as f64) as usize;
            let shape = Shape::Box {
                length_m: stream.between(0.05, 0.5),
                width_m: 2.0 * half_width + stream.between(-0.3, 0.6),
                yaw_rad: 0.0,
            };
            course.obstacles[which] = ScenarioObstacle::fixed(shape, course.obstacles[which].x_m, 0.0);
        }
        Family::Sudden => {
            let which = (stream.uniform() * course.obstacles.len() as f64) as usize;
            course.obstacles[which].appears_ahead_m = Some(stream.between(1.0, 3.0));
        }
        Family::Moving => {
            let obstacle = &mut course.obstacles[0];
            let side = if stream.chance(0.5) { 1.0 } else { -1.0 };
            if stream.chance(0.7) {
                // It is on the line about when the robot gets there at full speed.
                let speed = stream.between(0.1, 0.6);
                let meeting_s = obstacle.x_m * stream.between(0.8, 1.6);
                obstacle.y_m = side * (speed * meeting_s).min(half_width + 1.0);
                obstacle.velocity_y_mps = -side * speed;
            } else {
                obstacle.velocity_x_mps = stream.between(-0.3, 0.2);
            }
        }
    }
    (family, course)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_course_is_valid_and_within_its_rules() {
        for seed in 0..2000 {
            let course = random(seed);
            assert_eq!(course.validate(), Ok(()));
            let (first, last) = (course.obstacles.first().unwrap(), course.obstacles.last().unwrap());
            assert!(first.x_m - first.reach() >= AFTER_START_M - 1e-9);
            assert!(course.goal.last().x_m - last.x_m - last.reach() >= BEFORE_GOAL_M - 1e-9);
            assert!(course.goal.last().x_m <= GOAL_MAX_M && course.obstacles.len() <= 3);
            for pair in course.obstacles.windows(2) {
                assert!(pair[1].x_m - pair[0].x_m >= SPACING_M - 1e-9);
            }
        }
    }

    #[test]
    fn a_campaign_has_all_families_and_only_the_closed_ones_are_impassable() {
        let courses: Vec<(Family, Scenario)> = (0..200).map(of_campaign).collect();
        for family in Family::ALL {
            assert!(courses.iter().any(|(other, _)| other == family), "{}", family.name());
        }
        for (family, course) in courses.iter().filter(|(family, _)| *family != Family::Moving) {
            assert_eq!(course.validate(), Ok(()), "{}", course.name);
            assert_eq!(crate::feasible::passable(course), *family != Family::Blocked, "{}", course.name);
        }
    }

    #[test]
    fn the_courses_of_a_seed_never_change() {
        let numbers = (0..200).flat_map(|seed| {
            let Scenario { goal, track, noise, obstacles, .. } = of_campaign(seed).1;
            let ahead_m = |obstacle: &ScenarioObstacle| obstacle.appears_ahead_m.unwrap_or(-1.0);
            let places = obstacles.into_iter().flat_map(move |obstacle| {
                let ScenarioObstacle { x_m, y_m, velocity_x_mps, velocity_y_mps, .. } = obstacle;
                [x_m, y_m, obstacle.reach(), velocity_x_mps, velocity_y_mps, ahead_m(&obstacle)]
            });
            let rest = [
                goal.last().x_m,
                track.y_m[1],
                noise.range_m,
                noise.dropout,
                noise.odometry_m,
                noise.odometry_rad,
            ];
            rest.into_iter().chain(places)
        });
        // 64-bit FNV-1a over the bits of all numbers.
        let bytes = numbers.flat_map(|number: f64| number.to_bits().to_le_bytes());
        let hash = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        assert_eq!(hash, 9656979905609659860);
    }

    #[test]
    fn courses_come_with_all_counts_shapes_and_with_and_without_walls() {
        let courses: Vec<Scenario> = (0..100).map(random).collect();
        assert_eq!(courses[7], random(7));
        for count in 1..=3 {
            assert!(courses.iter().any(|course| course.obstacles.len() == count));
        }
        for walls in [false, true] {
            assert!(courses.iter().any(|course| course.track.walls == walls));
        }
        let shapes = courses.iter().flat_map(|course| &course.obstacles).map(|obstacle| obstacle.shape);
        assert!(shapes.clone().any(|shape| matches!(shape, Shape::Circle { .. })));
        assert!(shapes.clone().any(|shape| matches!(shape, Shape::Box { yaw_rad, .. } if yaw_rad != 0.0)));
    }
}
