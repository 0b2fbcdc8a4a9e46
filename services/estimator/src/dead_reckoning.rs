//! Dead reckoning: the pose that follows from the reported motion, what is learned of its errors, and how far it may
//! have drifted.
//!
//! Encoders that slip give an error along the way, and a gyro with noise and a bias that walks at random gives one in
//! yaw, which turns the way behind it. The errors of (yaw, x, y, and of the turn rate, the fraction of the distance and that of the
//! turn that are not reported) are propagated through the Jacobian of the motion. Without a laser nothing sees them, and the covariance only grows;
//! a match of a scan ([`crate::laser`]) corrects all six by their covariance.
//!
//! Two errors are kept apart, because repeated sightings of the same surfaces make only the first smaller: that of the
//! pose against the surfaces around (`covariance`), and that of these surfaces on the track (`map_covariance`).
//!
//! Assumptions: slip is independent from metre to metre; what is learned changes at random and slowly.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};
use shared_types::plain_state;
use vehicle::frame::{to_track, wrap_angle};

/// What makes dead reckoning drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriftSources {
    /// Standard deviation of the measured distance after one metre [m].
    pub slip_m: f64,
    /// Standard deviation of the integrated yaw after one second [rad].
    pub yaw_rad: f64,
    /// Standard deviation of the gyro's bias after one second [rad/s].
    pub bias_radps: f64,
    /// Standard deviation of the fraction of the distance that is not reported after one metre.
    pub scale: f64,
    /// Standard deviation at the start of the bias [rad/s], of the fraction of the distance and of that of the turn.
    pub unknown: [f64; 3],
}

plain_state! {
    /// The accumulated error of dead reckoning, and the pose that it makes.
    pub struct DeadReckoning {
        /// Yaw, x and y [rad, m, m]
        pub pose: [f64; 3],
        /// Turn rate [rad/s], fraction of the distance and fraction of the turn that are not reported
        pub unreported: [f64; 3],
        /// Covariance of these six against the surfaces around, column by column
        pub covariance: [f64; 36],
        /// Covariance of the place of these surfaces, as one of (yaw, x, y), column by column
        pub map_covariance: [f64; 9],
    }
}

/// A step of the way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OdometryStep {
    /// Duration [s].
    pub seconds: f64,
    /// Distance driven [m].
    pub distance_m: f64,
    /// Standard deviation of the distance that blocked wheels may have slid [m].
    pub slid_m: f64,
    /// Standard deviation of what it may have slipped to the side without being noticed [m].
    pub beside_m: f64,
    /// Turn to the left [rad].
    pub turn_rad: f64,
    /// Displacement along the track [m].
    pub dx_m: f64,
    /// Lateral displacement [m].
    pub dy_m: f64,
    /// Direction of travel [rad].
    pub yaw_rad: f64,
}

/// What a match of a scan with surfaces says of the pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sighting {
    /// Its weight as information about (yaw, x, y), zero in directions that nothing shows.
    pub information: Matrix3<f64>,
    /// That information times the difference of the pose that was seen from the one expected.
    pub pull: Vector3<f64>,
    /// What the noise of the scan adds to the covariance of `pull`.
    pub noise: Matrix3<f64>,
    /// Covariance of the place of the surfaces around after it.
    pub map: Matrix3<f64>,
    /// Covariance of what the pose seen may be beside the one expected because surfaces that are known better show it.
    pub beside: Matrix3<f64>,
}

impl DeadReckoning {
    /// Begins at a pose of this covariance.
    pub fn begin(pose: [f64; 3], covariance: &Matrix3<f64>, sources: &DriftSources) -> Self {
        let [bias, share, turn] = sources.unknown.map(|unknown| unknown * unknown);
        let variances = Vector6::new(0.0, 0.0, 0.0, bias, share, turn);
        let mut matrix = Matrix6::from_diagonal(&variances);
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(covariance);
        let mut state = Self { pose, ..Self::default() };
        state.keep(&matrix);
        state
    }

    /// Follows a reported motion of `seconds`, in the frame of the robot before it; returns what dead reckoning makes of it.
    pub fn advance(&mut self, turn_rad: f64, ahead_m: f64, left_m: f64, seconds: f64) -> [f64; 2] {
        let [yaw, x, y] = self.pose;
        let [rate, share, turn] = self.unreported;
        let missed_rad = rate * seconds + turn * turn_rad;
        let step = to_track(yaw + missed_rad / 2.0, ahead_m, left_m) * (1.0 + share);
        self.pose = [wrap_angle(yaw + turn_rad + missed_rad), x + step.x, y + step.y];
        [step.x, step.y]
    }

    /// The robot is somewhere else, known to these standard deviations.
    pub fn put(&mut self, pose: Vector3<f64>, deviation_m: f64, deviation_rad: f64) {
        let deviations = Vector3::new(deviation_rad, deviation_m, deviation_m);
        let covariance = Matrix3::from_diagonal(&deviations.component_mul(&deviations));
        let mut matrix = self.matrix();
        for place in 0..3 {
            matrix.fixed_view_mut::<1, 6>(place, 0).fill(0.0);
            matrix.fixed_view_mut::<6, 1>(0, place).fill(0.0);
        }
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance);
        self.keep(&matrix);
        self.pose = pose.into();
    }

    /// What is known of the pose becomes where the surfaces around are; against them it begins anew.
    pub fn anchor(&mut self) {
        self.misplace(&self.against_surfaces());
        self.put(Vector3::from(self.pose), 0.0, 0.0);
    }

    /// The surfaces around are others, whose place is known: that of those before is what is known of the pose.
    pub fn weigh_anchor(&mut self) {
        self.shake(&self.map());
        self.map_covariance = [0.0; 9];
    }

    /// The pose has noise of this covariance, which is new in each report.
    pub fn shake(&mut self, noise: &Matrix3<f64>) {
        let mut covariance = self.matrix();
        let mut of_pose = covariance.fixed_view_mut::<3, 3>(0, 0);
        of_pose += noise;
        self.keep(&covariance);
    }

    /// Adds the errors of one step.
    pub fn grow(&mut self, sources: &DriftSources, step: &OdometryStep) {
        let OdometryStep { seconds, distance_m, slid_m, beside_m, turn_rad, dx_m, dy_m, yaw_rad } = *step;
        let mut transition = Matrix6::identity();
        (transition[(1, 0)], transition[(2, 0)]) = (-dy_m, dx_m);
        // What is not reported of a turn turns the way of this step by half of it.
        let turned = Vector6::new(1.0, -dy_m / 2.0, dx_m / 2.0, 0.0, 0.0, 0.0);
        transition.set_column(3, &(turned * seconds + Vector6::ith(3, 1.0)));
        (transition[(1, 4)], transition[(2, 4)]) = (dx_m, dy_m);
        transition.set_column(5, &(turned * turn_rad + Vector6::ith(5, 1.0)));
        let (sin, cos) = yaw_rad.sin_cos();
        let ahead = Vector6::new(0.0, cos, sin, 0.0, 0.0, 0.0);
        let (slip, slide) = (ahead * sources.slip_m, ahead * slid_m);
        let turn = turned * sources.yaw_rad;
        let mut covariance = transition * self.matrix() * transition.transpose();
        covariance += slip * slip.transpose() * distance_m + turn * turn.transpose() * seconds;
        covariance += slide * slide.transpose();
        let beside = Vector6::new(0.0, -sin, cos, 0.0, 0.0, 0.0) * beside_m;
        covariance += beside * beside.transpose();
        covariance[(3, 3)] += sources.bias_radps * sources.bias_radps * seconds;
        covariance[(4, 4)] += sources.scale * sources.scale * distance_m;
        self.keep(&covariance);
        let of_pose: Matrix3<f64> = transition.fixed_view::<3, 3>(0, 0).into();
        let map = of_pose * self.map() * of_pose.transpose();
        self.map_covariance.copy_from_slice(map.as_slice());
    }

    /// Corrects pose and what is learned by a match, (7.24)-(7.26) in terms of its information; false, and unchanged, when
    /// that is not possible.
    pub fn correct(&mut self, sighting: &Sighting) -> bool {
        let Sighting { information, pull, noise, map, beside } = sighting;
        let covariance = self.matrix();
        let mut with_pose: Matrix6x3<f64> = covariance.fixed_view::<6, 3>(0, 0).into();
        let mut of_pose = with_pose.fixed_view_mut::<3, 3>(0, 0);
        of_pose += beside;
        let of_pose: Matrix3<f64> = of_pose.into();
        let Some(inverse) = (Matrix3::identity() + information * of_pose).try_inverse() else { return false };
        let gain = with_pose * inverse;
        let correction = gain * pull;
        let mut rest = Matrix6::identity();
        let mut by_pose = rest.fixed_view_mut::<6, 3>(0, 0);
        by_pose -= gain * information;
        let left = rest * covariance * rest.transpose() + gain * noise * gain.transpose();
        if !correction.iter().chain(left.iter()).chain(map.iter()).all(|value| value.is_finite()) {
            return false;
        }
        let [yaw, x, y] = self.pose;
        self.pose = [wrap_angle(yaw + correction[0]), x + correction[1], y + correction[2]];
        self.unreported = std::array::from_fn(|error| self.unreported[error] + correction[3 + error]);
        self.keep(&left);
        self.map_covariance.copy_from_slice(map.as_slice());
        true
    }

    /// All of it, with the surfaces around, may be beside where it is said to be by this covariance.
    pub fn misplace(&mut self, place: &Matrix3<f64>) {
        let map = self.map() + place;
        self.map_covariance.copy_from_slice(map.as_slice());
    }

    /// Covariance of (yaw, x, y) against the surfaces around.
    pub fn against_surfaces(&self) -> Matrix3<f64> {
        self.matrix().fixed_view::<3, 3>(0, 0).into()
    }

    /// Covariance of (yaw, x, y) on the track.
    pub fn of_pose(&self) -> Matrix3<f64> {
        self.against_surfaces() + self.map()
    }

    /// Standard deviations of what is not reported.
    pub fn deviations(&self) -> [f64; 3] {
        [21, 28, 35].map(|place| self.covariance[place].max(0.0).sqrt())
    }

    fn keep(&mut self, covariance: &Matrix6<f64>) {
        // Rounding makes the two halves differ.
        let symmetric = (covariance + covariance.transpose()) / 2.0;
        self.covariance.copy_from_slice(symmetric.as_slice());
    }

    /// Covariance of the place of the surfaces around, as one of (yaw, x, y).
    pub fn map(&self) -> Matrix3<f64> {
        Matrix3::from_column_slice(&self.map_covariance)
    }

    fn matrix(&self) -> Matrix6<f64> {
        Matrix6::from_column_slice(&self.covariance)
    }
}
#[cfg(test)]
mod tests {
    use super::*;

    const SOURCES: DriftSources =
        DriftSources { slip_m: 5e-3, yaw_rad: 2e-4, bias_radps: 2e-5, scale: 0.0, unknown: [0.0; 3] };

    /// Drives straight along `yaw_rad` at 1 m/s.
    fn straight(sources: DriftSources, yaw_rad: f64, seconds: u32) -> DeadReckoning {
        let mut state = DeadReckoning::default();
        let (dy_m, dx_m) = (0.1 * yaw_rad.sin(), 0.1 * yaw_rad.cos());
        for _ in 0..10 * seconds {
            state.grow(
                &sources,
                &OdometryStep {
                    seconds: 0.1,
                    distance_m: 0.1,
                    slid_m: 0.0,
                    beside_m: 0.0,
                    turn_rad: 0.0,
                    dx_m,
                    dy_m,
                    yaw_rad,
                },
            );
        }
        state
    }

    #[test]
    fn slip_grows_with_the_root_of_the_distance_along_the_way() {
        let pose = straight(DriftSources { slip_m: 5e-3, ..DriftSources::default() }, 0.0, 20).of_pose();
        assert!((pose[(1, 1)] - 25e-6 * 20.0).abs() < 1e-12 && pose[(2, 2)] == 0.0 && pose[(0, 0)] == 0.0);
    }

    #[test]
    fn white_noise_of_the_gyro_is_integrated_once_in_yaw_and_twice_across_the_way() {
        let pose = straight(DriftSources { yaw_rad: 2e-4, ..DriftSources::default() }, 0.0, 20).of_pose();
        // s^2 T, s^2 T^3 / 3 and s^2 T^2 / 2 for a speed of 1 m/s.
        assert!((pose[(0, 0)] - 4e-8 * 20.0).abs() < 1e-15);
        assert!(
            (pose[(2, 2)] / (4e-8 * 8000.0 / 3.0) - 1.0).abs() < 1e-4,
            "a sum of steps: dt^2 / 4 T^2 less"
        );
        assert!((pose[(0, 2)] / (4e-8 * 200.0) - 1.0).abs() < 1e-9 && pose[(1, 1)] == 0.0);
    }

    #[test]
    fn the_walk_of_the_bias_is_integrated_twice_in_yaw_and_three_times_across_the_way() {
        let pose = straight(DriftSources { bias_radps: 2e-5, ..DriftSources::default() }, 0.0, 20).of_pose();
        // b^2 T^3 / 3 and b^2 T^5 / 20; the bias of a step acts from the next step on: 3 dt / 2 T and 5 dt / 2 T less.
        assert!((pose[(0, 0)] / (4e-10 * 8000.0 / 3.0) - 1.0).abs() < 0.01);
        assert!((pose[(2, 2)] / (4e-10 * 3.2e6 / 20.0) - 1.0).abs() < 0.015);
    }

    #[test]
    fn the_way_turns_the_covariance() {
        let (ahead, left) = (
            straight(SOURCES, 0.0, 10).of_pose(),
            straight(SOURCES, std::f64::consts::FRAC_PI_2, 10).of_pose(),
        );
        assert!((ahead[(1, 1)] - left[(2, 2)]).abs() < 1e-12 && (ahead[(2, 2)] - left[(1, 1)]).abs() < 1e-12);
    }

    #[test]
    fn a_robot_at_rest_drifts_in_yaw_only() {
        let mut state = DeadReckoning::default();
        state.grow(
            &SOURCES,
            &OdometryStep {
                seconds: 10.0,
                distance_m: 0.0,
                slid_m: 0.0,
                beside_m: 0.0,
                turn_rad: 0.0,
                dx_m: 0.0,
                dy_m: 0.0,
                yaw_rad: 0.3,
            },
        );
        let pose = state.of_pose();
        assert!(pose[(0, 0)] > 0.0 && pose[(1, 1)] == 0.0 && pose[(2, 2)] == 0.0);
    }

    #[test]
    fn a_match_corrects_by_the_weights_of_a_kalman_filter_and_what_the_errors_share() {
        let variance = |deviation: f64| deviation * deviation;
        let start = Matrix3::from_diagonal(&Vector3::new(variance(1e-3), variance(0.1), variance(0.2)));
        let mut state = DeadReckoning::begin([0.0, 1.0, 2.0], &start, &DriftSources::default());
        // x is seen 0.3 m further, with a deviation of 0.1 m: half of it, and half of the variance.
        let information = Matrix3::from_diagonal(&Vector3::new(0.0, 100.0, 0.0));
        let sighting = Sighting {
            information,
            pull: information * Vector3::new(0.0, 0.3, 0.0),
            noise: information,
            ..Sighting::default()
        };
        assert!(state.correct(&sighting));
        assert!((state.pose[1] - 1.15).abs() < 1e-12 && state.pose[0] == 0.0 && state.pose[2] == 2.0);
        let left = state.of_pose();
        assert!((left[(1, 1)] - 0.005).abs() < 1e-9 && (left[(2, 2)] - 0.04).abs() < 1e-9);

        // After 10 m the fraction of the distance that is not reported explains all of what is seen: 0.1 m are 1 %.
        let sources = DriftSources { unknown: [0.0, 0.01, 0.0], ..DriftSources::default() };
        let mut state = DeadReckoning::begin([0.0; 3], &Matrix3::zeros(), &sources);
        for _ in 0..100 {
            state.advance(0.0, 0.1, 0.0, 0.1);
            let step = OdometryStep { distance_m: 0.1, dx_m: 0.1, ..OdometryStep::default() };
            state.grow(&DriftSources::default(), &step);
        }
        let information = Matrix3::from_diagonal(&Vector3::new(0.0, 1e8, 0.0));
        let pull = information * Vector3::new(0.0, 0.1, 0.0);
        assert!(state.correct(&Sighting { information, pull, noise: information, ..Sighting::default() }));
        assert!((state.unreported[1] - 0.01).abs() < 1e-4, "{:?}", state.unreported);
    }

    #[test]
    fn the_fraction_of_a_turn_that_is_not_reported_is_learned_and_added() {
        let sources = DriftSources { unknown: [0.0, 0.0, 0.01], ..DriftSources::default() };
        let mut state = DeadReckoning::begin([0.0; 3], &Matrix3::zeros(), &sources);
        for _ in 0..100 {
            state.advance(0.01, 0.0, 0.0, 0.1);
            state.grow(&DriftSources::default(), &OdometryStep { turn_rad: 0.01, ..OdometryStep::default() });
        }
        // After a turn of 1 rad the robot is seen 5 mrad further: 0.5 % of it.
        let information = Matrix3::from_diagonal(&Vector3::new(1e8, 0.0, 0.0));
        let pull = information * Vector3::new(0.005, 0.0, 0.0);
        assert!(state.correct(&Sighting { information, pull, noise: information, ..Sighting::default() }));
        assert!((state.unreported[2] - 0.005).abs() < 1e-5, "{:?}", state.unreported);
        let before_rad = state.pose[0];
        state.advance(0.2, 0.0, 0.0, 0.1);
        assert!((state.pose[0] - before_rad - 0.2 * 1.005).abs() < 1e-5, "{:?}", state.pose);
    }
}
