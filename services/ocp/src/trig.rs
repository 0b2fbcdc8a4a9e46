//! Sine and cosine without a call: an interval needs them at every stage, and the compiler can interleave these.
//!
//! The polynomials are those of fdlibm (`k_sin.c`, `k_cos.c`), exact to a rounding or two. The argument is reduced by multiples
//! of a quarter turn in two parts, so beyond a thousand turns digits are lost: no vehicle turns that often in a horizon.

/// Sine and cosine of `angle`; NaN where it is not finite.
#[inline]
pub(crate) fn sin_cos(angle: f64) -> (f64, f64) {
    /// A quarter turn in two parts, the first with 33 bits.
    const QUARTER: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];
    /// Added and subtracted, it rounds to an integer.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let turns = (angle * std::f64::consts::FRAC_2_PI + ROUND) - ROUND;
    let rest = (angle - turns * QUARTER[0]) - turns * QUARTER[1];
    let (sin, cos) = near_zero(rest);
    // As an integer a value that is not finite is 0, and the polynomials are NaN then.
    match turns as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Sine and cosine of an angle of at most an eighth turn.
#[inline]
fn near_zero(angle: f64) -> (f64, f64) {
    let square = angle * angle;
    let sin = 8.333_333_333_322_49e-3
        + square
            * (-1.984_126_982_985_795e-4
                + square
                    * (2.755_731_370_707_006_8e-6
                        + square * (-2.505_076_025_340_686_3e-8 + square * 1.589_690_995_211_55e-10)));
    let sin = angle + angle * square * (-1.666_666_666_666_663_2e-1 + square * sin);
    let cos = 4.166_666_666_666_66e-2
        + square
            * (-1.388_888_888_887_411e-3
                + square
                    * (2.480_158_728_947_673e-5
                        + square
                            * (-2.755_731_435_139_066_3e-7
                                + square
                                    * (2.087_572_321_298_175e-9 - square * 1.135_964_755_778_819_5e-11))));
    (sin, 1.0 - (0.5 * square - square * square * cos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_agrees_with_the_library() {
        for step in -40_000..=40_000 {
            let angle = f64::from(step) * 1e-3;
            let ((sin, cos), (other_sin, other_cos)) = (sin_cos(angle), angle.sin_cos());
            assert!((sin - other_sin).abs() < 4e-16 && (cos - other_cos).abs() < 4e-16, "{angle}");
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert!([f64::NAN, f64::INFINITY].into_iter().all(|angle| sin_cos(angle).0.is_nan()));
    }
}
