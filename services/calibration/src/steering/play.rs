//! Play from angles that were approached from both sides.

use crate::Estimate;
use crate::record::{ApproachSide, CircleRun};

/// Fewest angles that were approached from both sides.
const MIN_PAIRS: usize = 5;

/// Half the play between shaft and wheels: half the difference of the realised angle between an approach from above
/// and one from below, on average over all angles.
///
/// `None` when fewer than [`MIN_PAIRS`] angles were approached from both sides. Without play the value may be a little
/// below zero.
pub(super) fn estimate(runs: &[CircleRun], realised: &[f64], small_angle: f64) -> Option<Estimate> {
    let from = |side: ApproachSide| {
        runs.iter().zip(realised).filter(move |(run, _)| run.approached_from == Some(side))
    };
    let mut above: Vec<(f64, f64)> =
        from(ApproachSide::Above).map(|(run, angle)| (run.sent_steering_rad, *angle)).collect();
    let (mut halves, mut squares) = (Vec::new(), 0.0);
    for (run, low) in from(ApproachSide::Below) {
        // The same text in two lines of a table gives the same number.
        if let Some(index) = above.iter().position(|(sent, _)| *sent == run.sent_steering_rad) {
            halves.push((above.swap_remove(index).1 - low) / 2.0);
            squares += low * low;
        }
    }
    if halves.len() < MIN_PAIRS {
        return None;
    }
    let count = halves.len() as f64;
    let mean = halves.iter().sum::<f64>() / count;
    let variance = halves.iter().map(|half| (half - mean).powi(2)).sum::<f64>() / (count - 1.0);
    // The small-angle form of the model (7.29) shrinks differences of angles by the square of the angle.
    let geometry = small_angle * mean * squares / count;
    Some(Estimate::new(mean, (variance / count).sqrt().hypot(geometry), halves.len() - 1))
}
