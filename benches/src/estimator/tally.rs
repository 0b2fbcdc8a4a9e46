//! Errors of a pose against the truth, summed up over scans and drives.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use shared_types::{Pose, Truth};
use vehicle::frame::wrap_angle;

/// 95 % quantile of the chi-squared distribution with three degrees of freedom: the size of the ellipsoid.
const ELLIPSOID_95: f64 = 7.814_728;
/// 97.5 % quantile of the normal distribution.
const NORMAL: f64 = 1.959_964;
/// Number of components of a pose, and of a measurement.
pub(super) const COMPONENTS: f64 = 3.0;

/// Sums of one figure.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sum {
    pub(super) sum: f64,
    pub(super) count: u64,
}

/// What is summed up over scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Tally {
    pub(super) squares_m2: Sum,
    pub(super) yaw_squares_rad2: Sum,
    pub(super) max_m: f64,
    /// Scans whose error is inside the 95 % ellipsoid, of those with a covariance.
    pub(super) inside: Sum,
    pub(super) nis: Sum,
    /// The same by seconds of driven time.
    pub(super) seconds: Vec<Second>,
}

/// One second of driven time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Second {
    pub(super) squares_m2: Sum,
    /// Variance that the estimator states for the position.
    pub(super) variance_m2: Sum,
    pub(super) nees: Sum,
}

/// Some time of all drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Moment {
    /// Middle of the time since the start of the drive.
    pub(super) time_s: f64,
    pub(super) rms_m: f64,
    /// Root of the mean variance that the estimator states.
    pub(super) sigma_m: Option<f64>,
    pub(super) nees: Option<f64>,
}

impl Sum {
    pub(super) fn add(&mut self, value: f64) {
        *self = self.with(Self { sum: value, count: 1 });
    }

    fn with(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count }
    }

    /// The mean; nothing of nothing.
    pub(super) fn mean(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

impl Tally {
    /// Adds the estimate of a scan.
    pub(super) fn add_pose(&mut self, pose: &Pose, truth: &Truth) {
        let error = error([pose.yaw_rad, pose.x_m, pose.y_m], truth);
        self.add(error, truth.time_s);
        let covariance = Matrix3::from_row_slice(&pose.covariance);
        let nees = covariance.cholesky().map(|root| error.dot(&root.solve(&error)));
        // A covariance that is none contains nothing.
        self.inside.add(f64::from(nees.is_some_and(|nees| nees <= ELLIPSOID_95)));
        let second = self.second(truth.time_s);
        second.variance_m2.add(covariance[(1, 1)] + covariance[(2, 2)]);
        nees.into_iter().for_each(|nees| second.nees.add(nees));
        // A pose without a comparison, as the first one, has none.
        if pose.nis != 0.0 {
            self.nis.add(pose.nis);
        }
    }

    /// Adds a yaw, x and y of a scan that have no covariance.
    pub(super) fn add_place(&mut self, place: [f64; 3], truth: &Truth) {
        self.add(error(place, truth), truth.time_s);
    }

    fn add(&mut self, error: Vector3<f64>, time_s: f64) {
        let square_m2 = error[1] * error[1] + error[2] * error[2];
        self.squares_m2.add(square_m2);
        self.yaw_squares_rad2.add(error[0] * error[0]);
        self.max_m = self.max_m.max(square_m2.sqrt());
        self.second(time_s).squares_m2.add(square_m2);
    }

    fn second(&mut self, time_s: f64) -> &mut Second {
        let index = time_s.max(0.0) as usize;
        if self.seconds.len() <= index {
            self.seconds.resize(index + 1, Second::default());
        }
        &mut self.seconds[index]
    }

    /// Adds another drive.
    pub(super) fn merge(&mut self, other: &Self) {
        self.squares_m2 = self.squares_m2.with(other.squares_m2);
        self.yaw_squares_rad2 = self.yaw_squares_rad2.with(other.yaw_squares_rad2);
        self.max_m = self.max_m.max(other.max_m);
        self.inside = self.inside.with(other.inside);
        self.nis = self.nis.with(other.nis);
        for (index, second) in other.seconds.iter().enumerate() {
            let own = self.second(index as f64);
            *own = own.with(second);
        }
    }

    /// NEES over all scans.
    pub(super) fn nees(&self) -> Sum {
        self.seconds.iter().fold(Sum::default(), |sum, second| sum.with(second.nees))
    }

    /// The drives over time, in at most `count` parts.
    pub(super) fn over_time(&self, count: usize) -> Vec<Moment> {
        let length = self.seconds.len().div_ceil(count.max(1)).max(1);
        let parts = self.seconds.chunks(length).enumerate();
        let moment = |(index, part): (usize, &[Second])| {
            let sum = part.iter().fold(Second::default(), |sum, second| sum.with(second));
            Some(Moment {
                time_s: (index * length) as f64 + part.len() as f64 / 2.0,
                rms_m: sum.squares_m2.mean()?.sqrt(),
                sigma_m: sum.variance_m2.mean().map(f64::sqrt),
                nees: sum.nees.mean(),
            })
        };
        parts.filter_map(moment).collect()
    }

    /// Median over the time of the sigma that the estimator states, over the error that it has.
    pub(super) fn sigma_over_error(&self) -> Option<f64> {
        let moments = self.over_time(self.seconds.len());
        let ratio = |moment: &Moment| Some(moment.sigma_m? / moment.rms_m);
        let mut ratios: Vec<f64> =
            moments.iter().filter_map(ratio).filter(|ratio| ratio.is_finite()).collect();
        (!ratios.is_empty()).then(|| figures::bootstrap::quantile_of(&mut ratios, 0.5))
    }
}

impl Second {
    fn with(self, other: &Self) -> Self {
        Self {
            squares_m2: self.squares_m2.with(other.squares_m2),
            variance_m2: self.variance_m2.with(other.variance_m2),
            nees: self.nees.with(other.nees),
        }
    }
}

/// Bounds that contain the mean of `count` independent NEES or NIS of a consistent filter with 95 %, by Wilson and Hilferty
/// (doi:10.1073/pnas.17.12.684); none without any.
pub(super) fn bounds_95(count: u64) -> Option<[f64; 2]> {
    let freedom = COMPONENTS * count as f64;
    let spread = 2.0 / (9.0 * freedom);
    let bound = |sign: f64| COMPONENTS * (1.0 - spread + sign * NORMAL * spread.sqrt()).powi(3);
    (count > 0).then(|| [bound(-1.0), bound(1.0)])
}

/// Estimated minus true yaw, x and y.
fn error([yaw, x, y]: [f64; 3], truth: &Truth) -> Vector3<f64> {
    Vector3::new(wrap_angle(yaw - truth.yaw_rad), x - truth.x_m, y - truth.y_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pose whose sigmas are 0.1 rad, 0.2 m and 0.3 m, off by these.
    fn pose(errors: [f64; 3]) -> Pose {
        let mut covariance = [0.0; 9];
        (covariance[0], covariance[4], covariance[8]) = (0.01, 0.04, 0.09);
        Pose { yaw_rad: errors[0], x_m: errors[1], y_m: errors[2], covariance, nis: 2.0, ..Pose::default() }
    }

    fn at(time_s: f64) -> Truth {
        Truth { time_s, ..Truth::default() }
    }

    #[test]
    fn nees_coverage_and_errors_are_those_of_the_definition() {
        let mut tally = Tally::default();
        tally.add_pose(&pose([0.1, 0.2, 0.3]), &at(0.5));
        tally.add_pose(&pose([0.0, 0.6, 0.0]), &at(1.5));
        // One sigma in each of three, and three sigma in one.
        assert!((tally.nees().sum - (3.0 + 9.0)).abs() < 1e-12 && tally.nees().count == 2);
        assert_eq!((tally.inside.mean(), tally.nis.mean()), (Some(0.5), Some(2.0)));
        assert!((tally.squares_m2.mean().unwrap() - (0.13 + 0.36) / 2.0).abs() < 1e-12);
        assert!((tally.max_m - 0.6).abs() < 1e-12 && (tally.yaw_squares_rad2.sum - 0.01).abs() < 1e-12);
        // Sigma of the position is sqrt(0.13): as large as the error of the first second, and 0.6 of the second one.
        assert!((tally.sigma_over_error().unwrap() - 0.13_f64.sqrt() / 0.6).abs() < 1e-12);
        let over_time = tally.over_time(60);
        assert_eq!(over_time.iter().map(|moment| moment.time_s).collect::<Vec<_>>(), [0.5, 1.5]);
        assert_eq!(tally.over_time(1).len(), 1);
    }

    #[test]
    fn drives_add_up_and_a_covariance_that_is_none_contains_nothing() {
        let mut none = Tally::default();
        none.add_pose(&Pose::default(), &at(2.2));
        assert_eq!((none.inside.mean(), none.nees().mean(), none.nis.mean()), (Some(0.0), None, None));
        let mut tally = Tally::default();
        tally.add_place([std::f64::consts::TAU, 3.0, 4.0], &at(0.1));
        tally.merge(&none);
        assert_eq!((tally.squares_m2, tally.max_m), (Sum { sum: 25.0, count: 2 }, 5.0));
        assert!(tally.yaw_squares_rad2.sum < 1e-20, "a full turn is none");
        assert_eq!((tally.seconds.len(), tally.over_time(60).len()), (3, 2));
    }

    #[test]
    fn the_bounds_of_a_mean_are_those_of_the_chi_squared_distribution() {
        // Tables: chi-squared with 60 degrees of freedom has 40.482 and 83.298 at 2.5 and 97.5 %.
        let [low, high] = bounds_95(20).unwrap();
        assert!((low - 40.482 / 20.0).abs() < 2e-3 && (high - 83.298 / 20.0).abs() < 2e-3, "{low} {high}");
        assert_eq!(bounds_95(0), None);
    }
}
