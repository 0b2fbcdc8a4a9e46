//! The scenario file: what stands on the track, what is wrong with the robot, and what counts as arrived.
//!
//! Every table and key is optional with the default shown in the file's description, except an obstacle's shape,
//! position and size. A scenario that was read has been checked: one from [`Scenario::parse`] or
//! [`Scenario::from_table`] needs no further check. It can be written out again and reads back identically.

mod endless;
mod obstacle;
mod places;
mod preset;
mod robot;
mod scaled;
mod scanner;
mod shipped;
mod way;

use nalgebra::Vector2;
use vehicle::geometry::Rectangle;
use vehicle::{Course, Documented, Invalid, ScannerDescription, settings};

pub use endless::Endless;
pub use obstacle::{ScenarioObstacle, Shape};
pub use places::Start;
pub use preset::Values;
pub use robot::{DriftGrowth, Noise, OdometryModel, Preset, Robot, RobotScanner};
pub use scaled::scale_lengths;
pub use scanner::{MAX_RANGE_M, Scanner};
pub use vehicle::{Goal, Goals, Surroundings, Track};

/// What the name of a scenario may be.
const NAME: &str = "1 to 64 letters, digits, blanks, `-`, `_` and `.`";

const NAME_PATTERN: &str = r"pattern = '^[A-Za-z0-9 ._-]{1,64}$'";
/// Free distance that is asked of the walls in the bound of the centre, theta of (7.35) [m].
const WALL_MARGIN_M: f64 = 0.2;

settings! {
    /// A checked scenario file.
    pub struct Scenario {
        /// Name of the scenario in reports.
        pub name: String = "corridor".to_owned(), Documented { text: NAME, schema: NAME_PATTERN };
        /// The system file of a run without `--system`: a shipped one by its name, or a file beside the scenario.
        pub system: Option<String> = None, "a name or a file";
        /// Seed of all noise and of placed obstacles.
        pub seed: u64 = 1, "0 to 2^63 - 1";
        /// The run ends as `timeout` after this driven time [s].
        pub timeout_s: f64 = 60.0, 0.1..=1e6;
        /// The run ends as `stopped` after the wheels were blocked continuously for this long [s].
        pub stop_final_s: f64 = 5.0, 0.1..=1e6;
        /// Bounds of the track, and whether it has walls.
        pub track: Track = Track::default();
        /// The way that the robot follows, where it is no line along x; not together with `[track]`.
        pub course: Option<Course> = None;
        /// Pose of the robot at the start.
        pub start: Start = Start::default();
        /// Where to land; tables `[[goal]]` are goals one after the other.
        pub goal: Goals = Goals::default();
        /// One table for each obstacle.
        #[serde(rename = "obstacle")]
        pub obstacles: Vec<ScenarioObstacle> = Vec::new();
        /// With this table the seed places boxes along the whole track, in addition to the obstacles above.
        pub endless: Option<Endless> = None;
        /// Body and imperfections of the emulated robot.
        pub robot: Robot = Robot::default();
        /// Noise of scanner and odometer; standard deviations unless stated otherwise.
        pub noise: Noise = Noise::default();
        /// Faults of the scanner; without a key there is none, and obstacles that are marked as black are hard to see.
        /// A scan has a fault when its front beam is taken from `from_s` on and before `to_s`.
        pub scanner: Scanner = Scanner::default();
    }
}

/// Why a scenario can't be driven.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {message}")]
pub struct ScenarioError {
    /// Name of the file.
    pub file: String,
    /// Key, value and what is allowed, or what the parser reports, with the line.
    pub message: String,
}

impl Scenario {
    /// The scenario in `text`; `file` stands in messages only.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range.
    pub fn parse(text: &str, file: &str) -> Result<Self, ScenarioError> {
        let table =
            vehicle::parse(text).map_err(|message| ScenarioError { file: file.to_owned(), message })?;
        Self::from_table(table, file)
    }

    /// The scenario in a table that was read before, possibly with overrides in it.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range.
    pub fn from_table(table: toml::Table, file: &str) -> Result<Self, ScenarioError> {
        Self::checked(table)
            .map_err(|invalid| ScenarioError { file: file.to_owned(), message: invalid.to_string() })
    }

    /// [`Self::from_table`] for a caller that names the source itself.
    ///
    /// # Errors
    /// The first key that is not allowed.
    pub fn checked(table: toml::Table) -> Result<Self, Invalid> {
        let given = way::Given::of(&table);
        let scenario = given.complete(vehicle::read(table)?)?;
        scenario.validate()?;
        Ok(scenario)
    }

    /// This scenario with other values of some keys. Tables in `changes` replace only the keys that they have.
    ///
    /// # Errors
    /// One message with key, value and allowed range.
    pub fn with(&self, changes: &toml::Table) -> Result<Self, ScenarioError> {
        let mut table = self.to_table();
        merge(&mut table, changes);
        Self::from_table(table, "fault")
    }

    /// Text of a shipped scenario.
    pub fn shipped(name: &str) -> Option<&'static str> {
        shipped::SHIPPED.iter().find(|(shipped, _)| *shipped == name).map(|(_, text)| *text)
    }

    /// Names of the shipped scenarios, the default one first.
    pub fn names() -> impl Iterator<Item = &'static str> {
        shipped::SHIPPED.iter().map(|(name, _)| *name)
    }

    /// The file that reads back as this scenario.
    pub fn to_toml(&self) -> String {
        // Numbers, texts and tables with text keys can always be written.
        let written =
            if self.course.is_none() { toml::to_string(self) } else { toml::to_string(&self.to_table()) };
        written.unwrap_or_default()
    }

    /// [`Self::to_toml`] as a table.
    pub fn to_table(&self) -> toml::Table {
        let mut table = toml::Table::try_from(self).unwrap_or_default();
        if self.course.is_some() {
            table.remove("track");
        }
        table
    }

    /// Checks every number and that start, goal and obstacles fit together.
    ///
    /// # Errors
    /// The first key that is not allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        let plain = |letter: char| letter.is_ascii_alphanumeric() || " -_.".contains(letter);
        if self.name.is_empty() || self.name.len() > 64 || !self.name.chars().all(plain) {
            return Err(Invalid::new("name", &self.name, NAME));
        }
        if i64::try_from(self.seed).is_err() {
            return Err(Invalid::new("seed", self.seed, format!("0 to {}", i64::MAX)));
        }
        self.require_ranges()?;
        if let Some(course) = &self.course {
            self.validate_course(course)?;
        } else {
            let start = ("start".to_owned(), self.start.x_m, self.start.y_m);
            let goals = self.goal.all().iter().enumerate();
            let goals = goals.map(|(index, goal)| (self.goal.key(index), goal.x_m, goal.y_m));
            for (table, x_m, y_m) in std::iter::once(start).chain(goals) {
                places::require_inside(&self.track, x_m, y_m).map_err(|error| error.within(&table))?;
            }
        }
        self.validate_goals()?;
        if let Some(endless) = &self.endless {
            endless.validate().map_err(|error| error.within("endless"))?;
        }
        self.scanner.validate().map_err(|error| error.within("scanner"))?;
        self.true_scanner().require_ranges().map_err(|error| error.within("robot.scanner"))?;
        self.validate_start_in_walls()?;
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            self.validate_start_is_free(obstacle)
                .map_err(|error| error.within(&format!("obstacle[{index}]")))?;
        }
        Ok(())
    }

    /// What the robot of this scenario really is.
    pub fn robot_values(&self) -> Values {
        self.robot.values(self.seed)
    }

    /// What its scanner really measures.
    pub fn true_scanner(&self) -> ScannerDescription {
        self.robot.scanner.or(&ScannerDescription::default())
    }

    /// The body of the robot with its reference point at a pose.
    pub fn body(&self, x: f64, y: f64, yaw: f64) -> Rectangle {
        let Robot { length_m, width_m, body_x_m, .. } = self.robot;
        Rectangle::of_robot([x, y, yaw], body_x_m, length_m, width_m)
    }

    /// Obstacles of the file, then those that the seed places.
    pub fn placed_obstacles(&self) -> Vec<ScenarioObstacle> {
        let mut obstacles = self.obstacles.clone();
        if let Some(endless) = &self.endless {
            let last_x_m = self.goal.last().x_m.min(self.track.x_m[1]);
            obstacles.extend(endless.placed(self.seed, &self.start, last_x_m));
        }
        obstacles
    }

    /// Bound of the robot's centre across the track: `track.y_m`, or less where walls stand there [m].
    pub fn centre_y_m(&self) -> [f64; 2] {
        let [low, high] = self.track_on_course().y_m;
        if !self.track.walls {
            return [low, high];
        }
        let shrink = self.robot.width_m / 2.0 + WALL_MARGIN_M;
        [low + shrink, high - shrink]
    }

    /// The body of the robot at the start.
    pub fn start_body(&self) -> Rectangle {
        self.body(self.start.x_m, self.start.y_m, self.start.yaw_rad)
    }

    fn validate_start_in_walls(&self) -> Result<(), Invalid> {
        let [low, high] = self.track.y_m;
        let corners = self.start_body().corners();
        if self.track.walls && corners.iter().any(|corner| corner.y <= low || corner.y >= high) {
            let allowed = format!("the robot's body must stand between the walls at {low} and {high} m");
            return Err(Invalid::new("start.y_m", self.start.y_m, allowed));
        }
        Ok(())
    }

    fn validate_start_is_free(&self, obstacle: &ScenarioObstacle) -> Result<(), Invalid> {
        let distance =
            obstacle.solid_at(Vector2::new(obstacle.x_m, obstacle.y_m)).distance_to(&self.start_body());
        if obstacle.appears_s <= 0.0 && distance <= 0.0 {
            let place = format!("{} (y_m = {})", obstacle.x_m, obstacle.y_m);
            return Err(Invalid::new(
                "x_m",
                place,
                "an obstacle must not touch the robot's body at the start",
            ));
        }
        Ok(())
    }
}

/// Puts the values of `changes` into `table`; arrays are replaced.
fn merge(table: &mut toml::Table, changes: &toml::Table) {
    for (key, value) in changes {
        match (table.get_mut(key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) => merge(inner, changes),
            _ => _ = table.insert(key.clone(), value.clone()),
        }
    }
}

#[cfg(test)]
mod tests;
