//! Whether the measured states determine the state (yaw, x, y): the rank check (7.1)-(7.2).
//!
//! The matrix (H; H A; H A^2) of the linearised motion must have rank 3. The yaw is the direction of motion, so a
//! measured position determines it, but only while the robot moves; a position that is not measured cannot be
//! determined. The check is local: it shows that an estimate can converge, not how fast.

use nalgebra::{Matrix3, SMatrix};
use serde::{Deserialize, Serialize};
use shared_types::named_enum;
use vehicle::Invalid;

/// Number of states.
pub const STATES: usize = 3;

named_enum! {
    /// A state that is measured.
    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Measured {
        /// Yaw.
        Yaw "yaw",
        /// Position along the track.
        X "x",
        /// Lateral position.
        Y "y",
    }
}

impl Measured {
    /// Index in (yaw, x, y).
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// Rank of the observability matrix in the two situations that differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Observability {
    /// While the robot moves.
    pub moving: usize,
    /// While it stands.
    pub standing: usize,
}

/// The ranks for a set of measured states: 1 m/s, one scan period of 100 ms, and standstill.
pub fn analyse(measured: &[Measured]) -> Observability {
    let rank_after = |travel: f64| rank(&observability_matrix(measured, &motion_jacobian(travel, 0.0)));
    Observability { moving: rank_after(0.1), standing: rank_after(0.0) }
}

/// Jacobian A of (yaw, x, y) after a motion by (dx, dy) with respect to (yaw, x, y) before it.
///
/// The displacement turns rigidly with the yaw at its start, so this is exact for any motion.
pub fn motion_jacobian(dx: f64, dy: f64) -> Matrix3<f64> {
    Matrix3::new(1.0, 0.0, 0.0, -dy, 1.0, 0.0, dx, 0.0, 1.0)
}

/// The matrix (H; H A; H A^2), (7.2), whose rank (7.1) asks for; rows of states that are not measured are zero.
pub fn observability_matrix(measured: &[Measured], jacobian: &Matrix3<f64>) -> SMatrix<f64, 9, 3> {
    let mut output = Matrix3::zeros();
    for state in measured {
        output[(state.index(), state.index())] = 1.0;
    }
    let mut matrix = SMatrix::<f64, 9, 3>::zeros();
    for power in 0..STATES {
        matrix.fixed_view_mut::<3, 3>(3 * power, 0).copy_from(&output);
        output *= jacobian;
    }
    matrix
}

/// Number of singular values above 1e-9 of the largest.
pub fn rank(matrix: &SMatrix<f64, 9, 3>) -> usize {
    let values = matrix.singular_values();
    values.iter().filter(|value| **value > 1e-9 * values.max()).count()
}

/// Passes when the measured states determine all states at least while the robot moves.
///
/// # Errors
/// [`Invalid`] for the key `measure` with the rank and the states that stay undetermined.
pub fn require_observable(measured: &[Measured]) -> Result<(), Invalid> {
    let names = measured.iter().map(|state| format!("\"{}\"", state.name())).collect::<Vec<_>>().join(", ");
    let value = format!("[{names}]");
    if measured.iter().enumerate().any(|(index, state)| measured[..index].contains(state)) {
        return Err(Invalid::new("measure", value, "each of \"yaw\", \"x\", \"y\" at most once"));
    }
    let found = analyse(measured).moving;
    if found == STATES {
        return Ok(());
    }
    let hidden: Vec<_> = Measured::ALL
        .iter()
        .copied()
        .filter(|state| !measured.contains(state) && (*state != Measured::Yaw || measured.is_empty()))
        .map(Measured::name)
        .collect();
    let reason = format!(
        "a set that determines yaw, x and y; this one has rank {found} of {STATES} and leaves {} open",
        hidden.join(" and ")
    );
    Err(Invalid::new("measure", value, reason))
}

#[cfg(test)]
mod tests {
    use super::*;
    use Measured::{X, Y, Yaw};

    #[test]
    fn the_ranks_are_those_of_the_source() {
        assert_eq!(analyse(&[Yaw, X, Y]), Observability { moving: 3, standing: 3 });
        assert_eq!(analyse(&[X, Y]), Observability { moving: 3, standing: 2 });
        assert_eq!(analyse(&[Yaw]), Observability { moving: 1, standing: 1 });
        assert_eq!(analyse(&[Yaw, Y]).moving, 2);
        assert_eq!(analyse(&[]).moving, 0);
    }

    #[test]
    fn a_slow_robot_still_reveals_its_yaw() {
        // 0.1 m/s over 100 ms.
        assert_eq!(rank(&observability_matrix(&[X, Y], &motion_jacobian(0.01, 0.0))), 3);
    }

    #[test]
    fn yaw_alone_is_refused_with_the_reason() {
        let error = require_observable(&[Yaw]).unwrap_err().to_string();
        assert!(error.contains("measure = [\"yaw\"]") && error.contains("rank 1 of 3"), "{error}");
        assert!(error.contains("leaves x and y open"), "{error}");
        assert!(require_observable(&[]).unwrap_err().to_string().contains("yaw and x and y open"));
        assert!(require_observable(&[X, X, Y]).unwrap_err().to_string().contains("at most once"));
        assert_eq!(require_observable(&[Y, X]), Ok(()));
    }

    #[test]
    fn the_jacobian_of_the_motion_turns_the_way_with_the_yaw() {
        // A displacement of 0.3 ahead and 0.1 to the left at yaw 0.5, against a central difference.
        let end = |yaw: f64| vehicle::frame::to_track(yaw, 0.3, 0.1);
        let way = end(0.5);
        let difference = (end(0.5 + 1e-6) - end(0.5 - 1e-6)) / 2e-6;
        let jacobian = motion_jacobian(way.x, way.y);
        assert!(
            (jacobian[(1, 0)] - difference.x).abs() < 1e-9 && (jacobian[(2, 0)] - difference.y).abs() < 1e-9
        );
    }
}
