//! The table of `price` in centimetres, and what each step costs, as sentences.

use std::fmt::Write as _;

use super::condition::Varied;
use super::costs::Cost;
use super::{Price, Row};

/// Shown where there is no figure.
const NONE: &str = "-";

/// The table, the notes below it, and the costs.
pub(super) fn text(price: &Price) -> String {
    let mut text = format!(
        "{:<18}{:>14}{:>17}{:>19}{:>12}\n",
        "condition", "smallest gap", "beyond the body", "stopping distance", "speed"
    );
    for row in &price.rows {
        let beyond_m = row.smallest_gap_m.map(|gap_m| gap_m - price.body_width_m);
        let _ = writeln!(
            text,
            "{:<18}{:>14}{:>17}{:>19}{:>12}",
            name(row),
            centimetres(row.smallest_gap_m, 0),
            centimetres(beyond_m, 0),
            centimetres(row.stopping_distance_m, 1),
            row.speed_mps.map_or(NONE.to_owned(), |speed_mps| format!("{speed_mps:.2} m/s")),
        );
    }
    for (row, note) in price.rows.iter().flat_map(|row| row.notes.iter().map(move |note| (row, note))) {
        let _ = writeln!(text, "{}: {note}", name(row));
    }
    text.push('\n');
    text + &costs(price)
}

fn costs(price: &Price) -> String {
    let costs = &price.costs;
    let steps = [
        ("10 ms of latency cost", costs.latency_10_ms),
        ("Half the scan rate costs", costs.half_rate),
        ("1 cm of pose sigma costs", costs.pose_sigma_1_cm),
    ];
    let sentences = steps.map(|(step, cost)| format!("{step} {}.", of(&cost)));
    format!("{}\nEach cost is the slope of the least-squares line through its rows.\n", sentences.join("\n"))
}

fn of(cost: &Cost) -> String {
    let shown = |cost_m: Option<f64>| match cost_m {
        // The sum with zero takes the sign of a zero away.
        Some(cost_m) => format!("{:.1} cm", (cost_m * 1000.0).round() / 10.0 + 0.0),
        None => "an unknown amount".to_owned(),
    };
    format!("{} of gap and {} of stopping distance", shown(cost.gap_m), shown(cost.stopping_distance_m))
}

/// What differs in a row.
pub(super) fn name(row: &Row) -> String {
    match row.varied {
        Varied::Latency => format!("latency +{} ms", row.latency_ms),
        Varied::Rate => format!("rate {} Hz", row.rate_hz),
        Varied::PoseSigma => format!("pose sigma {:.0} cm", row.pose_sigma_m * 100.0),
        Varied::Bend => format!("bend of {} m", row.abscissa()),
    }
}

fn centimetres(metres: Option<f64>, decimals: usize) -> String {
    metres.map_or(NONE.to_owned(), |metres| format!("{:.decimals$} cm", metres * 100.0))
}
