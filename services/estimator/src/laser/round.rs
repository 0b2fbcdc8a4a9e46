//! A round body in a scan: the circle through its returns.
//!
//! The radius that one scan shows is a poor one, and an error of it moves the middle along the line of sight by even more.
//! So a body keeps the mean of the first radii, and what is seen later is moved to where it is with that one.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Steps of Gauss-Newton at most.
const STEPS: usize = 12;
/// A step that moves the circle by less is the last [m].
const FOUND_M: f64 = 1e-6;
/// Radii that are believed [m].
const RADIUS_M: std::ops::RangeInclusive<f64> = 0.03..=0.6;
/// Share of its width that is seen at least.
const SEEN: f64 = 0.75;
/// Fewer returns show no circle.
const MIN_COUNT: f64 = 5.0;

/// A circle that was seen from one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// Its middle [m].
    pub middle: Vector2<f64>,
    /// Its radius [m].
    pub radius_m: f64,
    /// How far the middle is further away for each metre that the radius is larger.
    pub per_radius: f64,
    /// As many returns on a line as show its distance as well, where the radius is known.
    pub count: f64,
    /// Standard deviation of the middle to the side, by that of a return.
    pub aside: f64,
}

impl Round {
    /// The circle through places seen from `scanner`, by least squares of their distances from it; `None` where they are on none
    /// within a standard deviation of `flat_m`, or show too little of it.
    pub fn fit(
        places: impl Iterator<Item = Vector2<f64>> + Clone,
        scanner: Vector2<f64>,
        flat_m: f64,
    ) -> Option<Self> {
        let count = places.clone().count() as f64;
        if count < MIN_COUNT {
            return None;
        }
        let mean = places.clone().sum::<Vector2<f64>>() / count;
        let (first, last) = (places.clone().next()?, places.clone().last()?);
        let width_m = (last - first).norm();
        let away = (mean - scanner).normalize();
        let (mut middle, mut radius_m) = (mean + away * (0.3 * width_m), width_m / 2.0);
        let (mut squares, mut normal) = (0.0, Matrix3::zeros());
        for _ in 0..STEPS {
            let mut pull = Vector3::zeros();
            (squares, normal) = (0.0, Matrix3::zeros());
            for place in places.clone() {
                let from = place - middle;
                let far_m = from.norm().max(1e-9);
                let slope = Vector3::new(from.x / far_m, from.y / far_m, 1.0);
                let off_m = far_m - radius_m;
                normal += slope * slope.transpose();
                pull += slope * off_m;
                squares += off_m * off_m;
            }
            let step = normal.cholesky()?.solve(&pull);
            middle += step.xy();
            radius_m += step.z;
            if !step.iter().all(|value| value.is_finite()) || !RADIUS_M.contains(&radius_m.max(0.02)) {
                return None;
            }
            if step.amax() < FOUND_M {
                break;
            }
        }
        let is_seen = RADIUS_M.contains(&radius_m) && width_m >= SEEN * 2.0 * radius_m;
        if !is_seen || (squares / count).sqrt() > flat_m {
            return None;
        }
        let aside = Vector2::new(-away.y, away.x);
        let of_middle: Matrix2<f64> = normal.fixed_view::<2, 2>(0, 0).into();
        let inverse = of_middle.try_inverse()?;
        // A larger radius moves the middle away from the places.
        let by_radius = inverse * Vector2::new(normal[(0, 2)], normal[(1, 2)]);
        Some(Self {
            middle,
            radius_m,
            per_radius: -away.dot(&by_radius),
            count: 1.0 / away.dot(&(inverse * away)),
            aside: aside.dot(&(inverse * aside)).sqrt(),
        })
    }
}
