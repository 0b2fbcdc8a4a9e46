//! A drive as the measure and the optimum see it.

use vehicle::{Control, Course, State};

/// The true robot at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RideMoment {
    /// Time since the start of the run [s].
    pub time_s: f64,
    /// Sideslip, yaw, yaw rate and position; position and yaw along and across a course.
    pub state: State,
    /// Direction of the course there; it grows beyond a half turn where the course does [rad].
    pub way_rad: f64,
    /// Speed over ground [m/s].
    pub speed_mps: f64,
    /// Distance of the body to the nearest obstacle or wall [m].
    pub clearance_m: f64,
}

/// A command, from the time at which it acts until the next one acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Issued {
    /// When it reaches the robot [s].
    pub time_s: f64,
    /// What is asked for; a blocked robot has the velocity zero and the last steering angle.
    pub control: Control,
}

/// A drive: true moments and commands, each in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RideTrace {
    /// The true robot, at least at each scan.
    pub moments: Vec<RideMoment>,
    /// The commands.
    pub commands: Vec<Issued>,
}

impl RideTrace {
    /// When the first command that drives acts [s].
    pub fn start_s(&self) -> Option<f64> {
        self.commands.iter().find(|issued| issued.control.velocity != 0.0).map(|issued| issued.time_s)
    }

    /// A drive in the plane along and across a course.
    #[must_use]
    pub fn along(mut self, course: &Course) -> Self {
        let mut near_m = None;
        for RideMoment { state, way_rad, .. } in &mut self.moments {
            *state = course.on_course(state, near_m.unwrap_or_else(|| course.find(state)));
            (near_m, *way_rad) = (Some(state.x), course.at(state.x).yaw);
        }
        self
    }

    /// The robot at `time_s`, from the last moment before: a robot at rest stays there, another one moves straight on.
    pub fn advanced_to(&self, time_s: f64) -> Option<RideMoment> {
        let before = self.moments.iter().take_while(|moment| moment.time_s <= time_s).last()?;
        let (duration, mut moment) = (time_s - before.time_s, *before);
        let (sin, cos) = (before.state.yaw + before.state.sideslip).sin_cos();
        moment.time_s = time_s;
        moment.state.x += before.speed_mps * cos * duration;
        moment.state.y += before.speed_mps * sin * duration;
        moment.state.yaw += before.state.yaw_rate * duration;
        Some(moment)
    }
}
