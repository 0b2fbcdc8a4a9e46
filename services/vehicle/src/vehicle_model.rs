//! Which vehicle it is: the keys `model` of `[vehicle]` and `[robot]`.
//!
//! A model with tyres is a row of [`VehicleModel::shares`], and its equations are those of
//! `single_track.rs`; one without is a file of its own, as `differential.rs`. All have the states
//! and controls of (7.27)-(7.31). The steering angle of a differential drive is that of a front wheel which would lead it on the
//! same path, `front_m` + `rear_m` before its axle.
//!
//! Angles are taken as small, as in (7.27) and (7.29): a bicycle's path has the curvature u2 / (lh + lv). Drivers send the angle
//! of a real wheel for it, [`Parameters::curvature_of`](crate::Parameters::curvature_of).

use serde::{Deserialize, Serialize};

use crate::Setting;

/// How a vehicle turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleModel {
    /// Front and rear axle steer by the same angle in opposite directions, as the SUMMIT's do.
    #[default]
    CounterSteered,
    /// The front axle steers, as that of a car.
    Bicycle,
    /// The rear axle steers, as that of a forklift or of a car that is turned round.
    RearSteered,
    /// Wheels on one axle turn at different speeds: no sideslip, and the yaw rate follows its command with a lag.
    Differential,
}

impl Setting for VehicleModel {}

impl VehicleModel {
    /// How far the front and the rear axle turn to the left per steering angle; `None` where nothing is steered and nothing
    /// slips.
    pub fn shares(self) -> Option<[f64; 2]> {
        match self {
            Self::CounterSteered => Some([1.0, -1.0]),
            Self::Bicycle => Some([1.0, 0.0]),
            Self::RearSteered => Some([0.0, -1.0]),
            Self::Differential => None,
        }
    }

    /// That of the vehicle turned round, whose front axle is the rear one.
    #[must_use]
    pub fn mirrored(self) -> Self {
        match self {
            Self::Bicycle => Self::RearSteered,
            Self::RearSteered => Self::Bicycle,
            same => same,
        }
    }
}
