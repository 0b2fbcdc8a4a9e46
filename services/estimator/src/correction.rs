//! Correction of the odometry, (7.36)-(7.40): known errors are added back to the reported pose.
//!
//! Odometry measures how far the wheels turn. It does not report a constant share of the distance (the wheels slip),
//! nor a lateral drift that grows (the steering has an offset). Both were calibrated before and are added back:
//!
//! ```text
//! ds_k     = ds_(k-1) + dds dt                                                  (7.38)
//! (x, y)_k = (x, y)_(k-1) + (dx, dy) + dt v R(yaw) (df, ds)                     (7.39), (7.40)
//! ```
//!
//! The result is the reported pose plus the sum of all corrections so far, so that white noise of the reported pose
//! stays white. Speeds are those measured at the wheels.
//!
//! Where it fails: the printed drift grows with time, also at standstill and without limit, and fits a constant
//! steering offset for about 6 s only. [`CorrectionMode::Moving`] does not grow at standstill; [`CorrectionMode::Yaw`]
//! turns the increments instead of shifting them, which is the true effect of a steering offset.

use serde::{Deserialize, Serialize};
use shared_types::plain_state;
use vehicle::frame::{to_robot, to_track, wrap_angle};

/// How measured data are corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CorrectionMode {
    /// Measured data are used as reported.
    Off,
    /// As printed: the lateral drift grows with time.
    Time,
    /// The lateral drift grows while the robot moves.
    Moving,
    /// The drift turns the reported increments and yaw, in proportion to the distance driven.
    Yaw,
}

/// Coefficients of the correction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// How the drift acts.
    pub mode: CorrectionMode,
    /// Share of the distance that odometry does not report, df.
    pub longitudinal: f64,
    /// Growth of the lateral drift, dds [1/s]; in mode `yaw`, turn per time at 1 m/s [rad/s]. Positive to the left.
    pub lateral_rate: f64,
    /// Time after which the lateral drift restarts at zero; 0 for never [s].
    pub reset_s: f64,
}

/// Below this speed the robot stands [m/s].
pub(crate) const STANDSTILL_MPS: f64 = 0.01;

plain_state! {
    /// Sum of the corrections so far, and the report they were made from.
    pub struct CorrectionState {
        /// Yaw reported last [rad]
        pub reported_yaw_rad: f64,
        /// x reported last [m]
        pub reported_x_m: f64,
        /// y reported last [m]
        pub reported_y_m: f64,
        /// Speed reported last [m/s]
        pub speed_mps: f64,
        /// Sum of corrections of yaw [rad]
        pub yaw_rad: f64,
        /// Sum of corrections of x [m]
        pub x_m: f64,
        /// Sum of corrections of y [m]
        pub y_m: f64,
        /// Lateral drift ds, (7.38)
        pub lateral: f64,
        /// Time since the lateral drift began [s]
        pub elapsed_s: f64,
    }
}

/// A pose in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Planar {
    /// Yaw [rad].
    pub yaw: f64,
    /// Position along the track [m].
    pub x: f64,
    /// Lateral position [m].
    pub y: f64,
}

impl CorrectionState {
    /// Begins with a first report: nothing to correct yet.
    pub fn begin(reported: Planar, speed: f64) -> Self {
        Self {
            reported_yaw_rad: reported.yaw,
            reported_x_m: reported.x,
            reported_y_m: reported.y,
            speed_mps: speed,
            ..Self::default()
        }
    }

    /// Distance from the last report to the next one, negative backwards where the robot may reverse [m].
    pub fn way_m(&self, reported: Planar, reverses: bool) -> f64 {
        let (dx, dy) = (reported.x - self.reported_x_m, reported.y - self.reported_y_m);
        let is_behind = to_robot(self.reported_yaw_rad, dx, dy).x < 0.0;
        if reverses && is_behind { -dx.hypot(dy) } else { dx.hypot(dy) }
    }

    /// The corrected pose for the next report, `dt` seconds after the one before, at `speed` [m/s].
    ///
    /// The distance driven is `way_m`, negative backwards [m], or without it that of a speed which changed evenly.
    ///
    /// Source note: (7.39) and (7.40) take drift and yaw at the beginning of the interval. Here both, and the speed,
    /// are means of beginning and end: at 100 ms the printed form lags by dds dt / 2 of the distance, 0.1 m over 40 s.
    pub fn correct(
        &mut self,
        drift: &Drift,
        reported: Planar,
        speed: f64,
        dt: f64,
        way_m: Option<f64>,
    ) -> Planar {
        let (dx, dy) = (reported.x - self.reported_x_m, reported.y - self.reported_y_m);
        let turn = wrap_angle(reported.yaw - self.reported_yaw_rad);
        let distance = way_m.unwrap_or(dt * (self.speed_mps + speed) / 2.0);
        let middle_yaw = self.reported_yaw_rad + turn / 2.0;
        *self = Self {
            reported_yaw_rad: reported.yaw,
            reported_x_m: reported.x,
            reported_y_m: reported.y,
            speed_mps: speed,
            ..*self
        };

        match drift.mode {
            CorrectionMode::Off => {}
            CorrectionMode::Time | CorrectionMode::Moving => {
                let grows = drift.mode == CorrectionMode::Time || distance.abs() > STANDSTILL_MPS * dt;
                let growth = if grows { self.grow(drift, dt) } else { 0.0 };
                let missed = to_track(middle_yaw, drift.longitudinal, self.lateral - growth / 2.0) * distance;
                self.x_m += missed.x;
                self.y_m += missed.y;
            }
            CorrectionMode::Yaw => {
                let growth = drift.lateral_rate * distance;
                let rotation = self.yaw_rad + growth / 2.0;
                self.yaw_rad += growth;
                let turned = to_track(rotation, dx, dy);
                let missed = to_track(middle_yaw + rotation, drift.longitudinal, 0.0) * distance;
                self.x_m += turned.x - dx + missed.x;
                self.y_m += turned.y - dy + missed.y;
            }
        }
        Planar {
            yaw: wrap_angle(reported.yaw + self.yaw_rad),
            x: reported.x + self.x_m,
            y: reported.y + self.y_m,
        }
    }

    /// The pose that the last report was corrected to.
    pub fn corrected(&self) -> Planar {
        Planar {
            yaw: wrap_angle(self.reported_yaw_rad + self.yaw_rad),
            x: self.reported_x_m + self.x_m,
            y: self.reported_y_m + self.y_m,
        }
    }

    /// Growth of the lateral drift over `dt` seconds, (7.38), after a reset that is due.
    fn grow(&mut self, drift: &Drift, dt: f64) -> f64 {
        if drift.reset_s > 0.0 && self.elapsed_s >= drift.reset_s {
            self.elapsed_s = 0.0;
            self.lateral = 0.0;
        }
        self.elapsed_s += dt;
        let growth = drift.lateral_rate * dt;
        self.lateral += growth;
        growth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drift(mode: CorrectionMode, longitudinal: f64, lateral_rate: f64) -> Drift {
        Drift { mode, longitudinal, lateral_rate, reset_s: 0.0 }
    }

    /// Reports of a robot that drives straight along `yaw` at 1 m/s, all corrected; the last result.
    fn straight(drift: &Drift, yaw: f64, reported_speed: f64, seconds: usize) -> Planar {
        let at = |step: usize| {
            let place = to_track(yaw, reported_speed * 0.1 * step as f64, 0.0);
            Planar { yaw, x: place.x, y: place.y }
        };
        let mut state = CorrectionState::begin(at(0), 1.0);
        let mut corrected = at(0);
        for step in 1..=10 * seconds {
            corrected = state.correct(drift, at(step), 1.0, 0.1, None);
        }
        corrected
    }

    #[test]
    fn a_missed_share_of_the_way_is_added_along_the_heading() {
        // 9.9 m reported, 10 m driven at 1 m/s, to the left.
        let end = straight(&drift(CorrectionMode::Time, 0.01, 0.0), std::f64::consts::FRAC_PI_2, 0.99, 10);
        assert!(end.x.abs() < 1e-12 && (end.y - 10.0).abs() < 1e-12);
    }

    #[test]
    fn the_lateral_drift_is_the_integral_of_its_growth() {
        // 0.053 / 2 * 5^2 = 0.6625 m to the left of the heading.
        let end = straight(&drift(CorrectionMode::Time, 0.0, 0.053), 0.0, 1.0, 5);
        assert!((end.x - 5.0).abs() < 1e-12 && (end.y - 0.6625).abs() < 1e-12, "{end:?}");
        let other_way = straight(&drift(CorrectionMode::Time, 0.0, -0.053), 0.0, 1.0, 5);
        assert!((other_way.y + 0.6625).abs() < 1e-12);
    }

    #[test]
    fn the_turning_drift_drives_a_circle() {
        // 0.053 rad/m over 6 m: radius 18.87 m, angle 0.318 rad.
        let end = straight(&drift(CorrectionMode::Yaw, 0.0, 0.053), 0.0, 1.0, 6);
        let (radius, angle) = (1.0 / 0.053, 0.053 * 6.0_f64);
        assert!((end.yaw - angle).abs() < 1e-12);
        // Chords of 0.1 m instead of the arc: shorter by (0.0053)^2 / 24 of 6 m.
        assert!(
            (end.x - radius * angle.sin()).abs() < 1e-5
                && (end.y - radius * (1.0 - angle.cos())).abs() < 1e-5
        );
    }

    #[test]
    fn at_standstill_the_printed_drift_grows_and_the_moving_one_does_not() {
        for (mode, expected) in [(CorrectionMode::Time, 0.53), (CorrectionMode::Moving, 0.0)] {
            let mut state = CorrectionState::begin(Planar::default(), 0.0);
            for _ in 0..100 {
                assert_eq!(
                    state.correct(&drift(mode, 0.01, 0.053), Planar::default(), 0.0, 0.1, None),
                    Planar::default()
                );
            }
            assert!((state.lateral - expected).abs() < 1e-12, "{mode:?}");
        }
    }

    #[test]
    fn the_drift_begins_anew_after_its_reset() {
        let drift = Drift { reset_s: 2.0, ..drift(CorrectionMode::Time, 0.0, 0.1) };
        // Two seconds each: 0.1 / 2 * 2^2 = 0.2 m, three times.
        assert!((straight(&drift, 0.0, 1.0, 6).y - 0.6).abs() < 0.02);
    }

    #[test]
    fn white_noise_of_the_report_stays_white() {
        let mut state = CorrectionState::begin(Planar::default(), 1.0);
        let correction = drift(CorrectionMode::Time, 0.01, 0.0);
        for step in 1..=200 {
            let (exact, noise) = (0.099 * f64::from(step), if step % 2 == 0 { 0.05 } else { -0.05 });
            let corrected =
                state.correct(&correction, Planar { yaw: 0.0, x: exact + noise, y: noise }, 1.0, 0.1, None);
            assert!((corrected.x - 0.1 * f64::from(step) - noise).abs() < 1e-9);
            assert!((corrected.y - noise).abs() < 1e-9);
        }
    }

    #[test]
    fn off_passes_the_report_on() {
        let end = straight(&drift(CorrectionMode::Off, 0.01, 0.053), 0.0, 0.99, 5);
        assert!((end.x - 4.95).abs() < 1e-12 && end.y == 0.0);
    }
}
