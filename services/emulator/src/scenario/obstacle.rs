//! One obstacle of the file.
//!
//! In the file all keys stand side by side (`shape`, `x_m`, `radius_m`, ...); in the program the size belongs to
//! the shape, so that a circle without a radius can't exist.

use std::f64::consts::PI;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use toml::Value;
use vehicle::geometry::Rectangle;
use vehicle::{Invalid, Key, Setting, require, settings};

use crate::solid::Solid;

/// Shape and size of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// An upright cylinder.
    Circle {
        /// Radius [m].
        radius_m: f64,
    },
    /// An upright box.
    Box {
        /// Full length along its own axis [m].
        length_m: f64,
        /// Full width [m].
        width_m: f64,
        /// Direction of the length axis [rad].
        yaw_rad: f64,
    },
}

/// An obstacle, where it stands, when it is there, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ObstacleFile", into = "ObstacleFile")]
pub struct ScenarioObstacle {
    /// Shape and size.
    pub shape: Shape,
    /// Position of the centre along the track when it appears [m].
    pub x_m: f64,
    /// Lateral position of the centre when it appears [m].
    pub y_m: f64,
    /// When it appears [s] since the start of the run; ignored where `appears_ahead_m` is given.
    pub appears_s: f64,
    /// It appears when the front of the body has come this near to its surface, measured forward [m].
    pub appears_ahead_m: Option<f64>,
    /// When it vanishes [s] since the start of the run.
    pub disappears_s: Option<f64>,
    /// Velocity along the track from the moment it appears [m/s].
    pub velocity_x_mps: f64,
    /// Velocity across the track from the moment it appears [m/s].
    pub velocity_y_mps: f64,
    /// Whether its surface is black, so that the scanner sees it only from nearby.
    pub black: bool,
}

impl ScenarioObstacle {
    /// An obstacle that stands there all the time.
    pub fn fixed(shape: Shape, x_m: f64, y_m: f64) -> Self {
        Self {
            shape,
            x_m,
            y_m,
            appears_s: 0.0,
            appears_ahead_m: None,
            disappears_s: None,
            velocity_x_mps: 0.0,
            velocity_y_mps: 0.0,
            black: false,
        }
    }

    /// Whether it moves.
    pub fn moves(&self) -> bool {
        self.velocity_x_mps != 0.0 || self.velocity_y_mps != 0.0
    }

    /// Whether it stands still at one place for the whole run.
    pub fn is_permanent(&self) -> bool {
        !self.moves()
            && self.appears_s <= 0.0
            && self.appears_ahead_m.is_none()
            && self.disappears_s.is_none()
    }

    /// Radius of the circle about its centre that holds all of it [m].
    pub fn reach(&self) -> f64 {
        match self.shape {
            Shape::Circle { radius_m } => radius_m,
            Shape::Box { length_m, width_m, .. } => length_m.hypot(width_m) / 2.0,
        }
    }

    /// Its body with the centre at `centre`.
    pub fn solid_at(&self, centre: Vector2<f64>) -> Solid {
        match self.shape {
            Shape::Circle { radius_m } => Solid::circle(centre, radius_m),
            Shape::Box { length_m, width_m, yaw_rad } => {
                Solid::rectangle(Rectangle { centre, yaw: yaw_rad, length: length_m, width: width_m })
            }
        }
    }

    /// Passes when it vanishes after it appears.
    fn require_order(&self) -> Result<(), Invalid> {
        self.disappears_s
            .map_or(Ok(()), |disappears| require("disappears_s", disappears, self.appears_s..=1e6))
    }
}

impl Setting for ScenarioObstacle {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        let file = ObstacleFile::from_value(path, value)?;
        Self::try_from(file).map_err(|error| error.within(path))
    }

    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        let allowed = ObstacleFile::from(*self).require_ranges().and_then(|()| self.require_order());
        allowed.map_err(|error| error.within(name))
    }

    fn keys() -> Vec<Key> {
        ObstacleFile::keys()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ShapeName {
    Circle,
    Box,
}

impl Setting for ShapeName {}

settings! {
    /// The keys as they stand in the file.
    pub(super) struct ObstacleFile {
        /// Shape of the obstacle.
        shape: Option<ShapeName> = None, "must be given";
        /// Position of the centre along the track when the obstacle appears [m].
        x_m: Option<f64> = None, (-20_000.0..=20_000.0, "must be given");
        /// Lateral position of the centre when the obstacle appears [m].
        y_m: Option<f64> = None, (-2_000.0..=2_000.0, "must be given");
        /// Radius of a circle [m].
        radius_m: Option<f64> = None, (0.005..=50.0, "must be given for a circle");
        /// Length of a box along its own axis [m].
        length_m: Option<f64> = None, (0.005..=100.0, "must be given for a box");
        /// Width of a box [m].
        width_m: Option<f64> = None, (0.005..=100.0, "must be given for a box");
        /// Direction of the length axis of a box; without the key 0 [rad].
        yaw_rad: Option<f64> = None, -PI..=PI;
        /// Time at which the obstacle appears; without the key 0 [s].
        appears_s: Option<f64> = None, 0.0..=1e6;
        /// The obstacle appears when its surface is this far ahead of the front of the body [m].
        appears_ahead_m: Option<f64> = None, (0.0..=100.0, "not together with `appears_s`");
        /// Time at which the obstacle disappears [s].
        disappears_s: Option<f64> = None, (0.0..=1e6, "not before `appears_s`");
        /// Velocity along the track from the moment it appears [m/s].
        velocity_x_mps: f64 = 0.0, -5.0..=5.0;
        /// Velocity across the track from the moment it appears [m/s].
        velocity_y_mps: f64 = 0.0, -5.0..=5.0;
        /// Whether the surface is black: it gives no return from farther away than `scanner.black_range_m`.
        black: bool = false;
    }
}

impl TryFrom<ObstacleFile> for ScenarioObstacle {
    type Error = Invalid;

    fn try_from(file: ObstacleFile) -> Result<Self, Invalid> {
        let shape = match file.shape {
            None => return Err(missing("shape", "`box` or `circle`")),
            Some(ShapeName::Circle) => {
                absent("length_m", file.length_m, "box")?;
                absent("width_m", file.width_m, "box")?;
                absent("yaw_rad", file.yaw_rad, "box")?;
                Shape::Circle { radius_m: given("radius_m", file.radius_m)? }
            }
            Some(ShapeName::Box) => {
                absent("radius_m", file.radius_m, "circle")?;
                Shape::Box {
                    length_m: given("length_m", file.length_m)?,
                    width_m: given("width_m", file.width_m)?,
                    yaw_rad: file.yaw_rad.unwrap_or(0.0),
                }
            }
        };
        if let (Some(appears), Some(_)) = (file.appears_s, file.appears_ahead_m) {
            return Err(Invalid::new("appears_s", appears, "either appears_s or appears_ahead_m, not both"));
        }
        Ok(Self {
            shape,
            x_m: given("x_m", file.x_m)?,
            y_m: given("y_m", file.y_m)?,
            appears_s: file.appears_s.unwrap_or(0.0),
            appears_ahead_m: file.appears_ahead_m,
            disappears_s: file.disappears_s,
            velocity_x_mps: file.velocity_x_mps,
            velocity_y_mps: file.velocity_y_mps,
            black: file.black,
        })
    }
}

impl From<ScenarioObstacle> for ObstacleFile {
    fn from(obstacle: ScenarioObstacle) -> Self {
        let (shape, [radius_m, length_m, width_m, yaw_rad]) = match obstacle.shape {
            Shape::Circle { radius_m } => (ShapeName::Circle, [Some(radius_m), None, None, None]),
            Shape::Box { length_m, width_m, yaw_rad } => {
                (ShapeName::Box, [None, Some(length_m), Some(width_m), Some(yaw_rad)])
            }
        };
        Self {
            shape: Some(shape),
            x_m: Some(obstacle.x_m),
            y_m: Some(obstacle.y_m),
            radius_m,
            length_m,
            width_m,
            yaw_rad,
            appears_s: obstacle.appears_ahead_m.is_none().then_some(obstacle.appears_s),
            appears_ahead_m: obstacle.appears_ahead_m,
            disappears_s: obstacle.disappears_s,
            velocity_x_mps: obstacle.velocity_x_mps,
            velocity_y_mps: obstacle.velocity_y_mps,
            black: obstacle.black,
        }
    }
}

fn given(key: &str, value: Option<f64>) -> Result<f64, Invalid> {
    value.ok_or_else(|| missing(key, "a number [m]"))
}

fn missing(key: &str, allowed: &str) -> Invalid {
    Invalid::new(key, "(missing)", format!("{allowed} must be given"))
}

fn absent(key: &str, value: Option<f64>, shape: &str) -> Result<(), Invalid> {
    match value {
        Some(value) => Err(Invalid::new(key, value, format!("only with shape = \"{shape}\""))),
        None => Ok(()),
    }
}
