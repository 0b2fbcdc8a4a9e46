//! The clearance that a verified plan keeps between the body and obstacles: a sum of what is uncertain.
//!
//! base + k sigma of the pose along the plan + a share of speed times age of the data, for which the pose is predicted, +
//! model + perception. Each part stands in the command, so a report can tell which of them closes a gap.

use shared_types::{Margin, Pose};

use crate::config::{ControllerConfig, MarginSettings};

/// The uncertainty grows for this time of a plan at most [s]: about the horizon. Later places are planned again before.
const MAX_GROWTH_S: f64 = 2.7;

/// The margin as a function of the time of the plan and the speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MarginModel {
    base_m: f64,
    settings: MarginSettings,
    /// Largest variance of the position relative to the obstacles, at the start of the plan [m^2].
    variance_m2: f64,
    /// Age of the data when the command acts [s].
    age_s: f64,
}

impl MarginModel {
    /// The margin of a certain pose and data without age.
    pub(crate) fn certain(config: &ControllerConfig) -> Self {
        Self { base_m: config.clearance_m, settings: config.margin, variance_m2: 0.0, age_s: 0.0 }
    }

    /// The margin for a pose.
    pub(crate) fn of(config: &ControllerConfig, pose: &Pose) -> Self {
        let [xx, xy, yy] = [4, 5, 8].map(|index| pose.local_covariance[index]);
        // The larger eigenvalue of the covariance of x and y.
        let variance = f64::midpoint(xx, yy) + ((xx - yy) / 2.0).hypot(xy);
        let age_s = pose.predicted_ns.saturating_sub(pose.header.acquired_ns) as f64 * 1e-9;
        Self { variance_m2: variance.max(0.0), age_s, ..Self::certain(config) }
    }

    /// The margin of a plan that kept it whole when it was made: what is for errors of model and perception may be used up.
    pub(crate) fn used_up(self) -> Self {
        Self { settings: MarginSettings { model_m: 0.0, perception_m: 0.0, ..self.settings }, ..self }
    }

    /// What is kept in any case, and nothing for what is uncertain.
    pub(crate) fn bare(self) -> Self {
        let settings = MarginSettings {
            pose_sigmas: 0.0,
            pose_growth_m: 0.0,
            model_m: 0.0,
            perception_m: 0.0,
            ..self.settings
        };
        Self { settings, age_s: 0.0, ..self }
    }

    /// What a person keeps who may pass closer: nothing for what is uncertain but the whole way until the command acts.
    pub(crate) fn close(self) -> Self {
        Self { settings: self.bare().settings, ..self }.whole()
    }

    /// The whole distance until the command acts: where bodies move, and where a prediction rests on a doubtful scanner or
    /// calibration.
    pub(crate) fn whole(self) -> Self {
        Self { settings: MarginSettings { latency_share: 1.0, ..self.settings }, ..self }
    }

    /// No margin at all: for a robot that would be struck if it stopped.
    pub(crate) fn none(self) -> Self {
        Self { base_m: 0.0, ..self.bare() }
    }

    /// Age of the data when the command acts [s].
    pub(crate) fn age_s(&self) -> f64 {
        self.age_s
    }

    /// The part that is kept at any speed and time [m].
    pub(crate) fn base(&self) -> f64 {
        self.base_m
    }

    /// The parts of the margin `t` seconds after the start of the plan at `speed`.
    pub(crate) fn at(&self, t: f64, speed: f64) -> Margin {
        let MarginSettings { pose_sigmas, pose_growth_m, latency_share, model_m, perception_m } =
            self.settings;
        Margin {
            base_m: self.base_m,
            pose_m: pose_sigmas
                * (self.variance_m2 + pose_growth_m * pose_growth_m * t.min(MAX_GROWTH_S)).sqrt(),
            latency_m: latency_share * speed * self.age_s,
            model_m,
            perception_m,
        }
    }

    /// The margin [m].
    pub(crate) fn sum(&self, t: f64, speed: f64) -> f64 {
        self.at(t, speed).sum()
    }

    /// How far the ellipses, which contain the base, are enlarged [m].
    pub(crate) fn growth(&self, t: f64, speed: f64) -> f64 {
        self.sum(t, speed) - self.base_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_margin_is_the_sum_of_its_parts() {
        let mut pose = Pose { predicted_ns: 150_000_000, ..Pose::default() };
        // Standard deviations 0.03 and 0.01 m along axes that are turned by 45 degrees.
        (pose.local_covariance[4], pose.local_covariance[8]) = (5e-4, 5e-4);
        (pose.local_covariance[5], pose.local_covariance[7]) = (4e-4, 4e-4);
        let model = MarginModel::of(&ControllerConfig::default(), &pose);
        let margin = model.at(0.0, 0.5);
        assert!((margin.pose_m - 2.0 * 0.03).abs() < 1e-12);
        // A quarter of the distance in 150 ms.
        assert!((margin.latency_m - 0.25 * 0.075).abs() < 1e-12);
        assert!((margin.sum() - (0.05 + 0.06 + 0.01875 + 0.015 + 0.015)).abs() < 1e-12);
        assert!((model.close().at(0.0, 0.5).latency_m - 0.075).abs() < 1e-12);
        // Variances add up: 0.03^2 + 2 s * 0.006^2.
        let later = model.at(2.0, 0.5).pose_m;
        assert!((later - 2.0 * (9e-4 + 2.0 * 3.6e-5_f64).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_larger_eigenvalue_counts_and_parts_are_left_out() {
        let mut pose = Pose { predicted_ns: 150_000_000, ..Pose::default() };
        // Along x 0.03 m, across 0.01 m.
        (pose.local_covariance[4], pose.local_covariance[8]) = (9e-4, 1e-4);
        let model = MarginModel::of(&ControllerConfig::default(), &pose);
        assert!((model.at(0.0, 0.5).pose_m - 2.0 * 0.03).abs() < 1e-12);
        assert!((model.age_s() - 0.15).abs() < 1e-12);
        assert!((model.growth(0.0, 0.5) - (0.06 + 0.01875 + 0.015 + 0.015)).abs() < 1e-12);
        // After the longest time that counts it does not grow any more.
        assert!(model.sum(2.0, 0.5) < model.sum(2.7, 0.5));
        assert_eq!(model.sum(2.7, 0.5), model.sum(9.0, 0.5));
        let used_up = model.used_up();
        assert!((used_up.sum(0.0, 0.5) - (0.05 + 0.06 + 0.01875)).abs() < 1e-12);
        assert!(used_up.at(2.0, 0.5).pose_m > used_up.at(0.0, 0.5).pose_m, "errors of the pose stay");
        let bare = model.bare();
        assert_eq!((bare.sum(0.0, 0.5), bare.sum(2.0, 1.0), bare.age_s()), (0.05, 0.05, 0.0));
        assert_eq!((model.none().sum(0.0, 0.5), model.none().sum(2.0, 1.0)), (0.0, 0.0));
    }
}
