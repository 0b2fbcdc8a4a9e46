//! The figures as text.

use figures::{Align, Table};

use super::results::{Results, Row};

/// The table, and what its numbers should be.
pub(super) fn text(results: &Results) -> String {
    let headings =
        ["runs", "reached", "stopped", "missed", "rms", "max", "yaw", "in 95 %", "NEES", "NIS", "sigma"];
    let names = ["scenario", "robot", "laser"].map(|name| (name, Align::Left));
    let mut table = Table::new(&[&names[..], &headings.map(|heading| (heading, Align::Right))].concat());
    let rows = results.rows.iter().map(|row| (row, row.laser));
    let mut rows: Vec<(&Row, &str)> =
        results.odometer.iter().map(|row| (row, "no filter")).chain(rows).collect();
    rows.sort_by_key(|(row, _)| (row.scenario, row.robot));
    for (row, laser) in rows {
        table.row(cells(row, laser));
    }
    let learned: String = results.rows.iter().filter(|row| row.laser != "off").map(learned).collect();
    let bounds = results.rows.first().and_then(|row| row.nees_bounds_95).unwrap_or_default();
    format!(
        "{table}rms and max of the position in m, yaw in mrad; in 95 %: share of scans inside the ellipsoid; sigma: stated over \
         measured, the median over time\nconsistent      NEES {:.2} to {:.2} with {} runs, NIS 3, sigma 1\n{learned}",
        bounds[0], bounds[1], results.seeds
    )
}

/// What of a robot was learned until the end, at its worst.
fn learned(row: &Row) -> String {
    let [offset_rad, velocity, distance] = row.unlearned;
    format!(
        "learned         {} {}: steering offset to {:.2} mrad, velocity to {:.2} %, distance to {:.2} %\n",
        row.scenario,
        row.robot,
        1e3 * offset_rad,
        1e2 * velocity,
        1e2 * distance
    )
}

fn cells(row: &Row, laser: &str) -> Vec<String> {
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    vec![
        row.scenario.to_owned(),
        row.robot.to_owned(),
        laser.to_owned(),
        row.runs.to_string(),
        row.reached.to_string(),
        row.stopped.to_string(),
        row.missed.to_string(),
        format!("{:.4}", row.rms_m),
        format!("{:.3}", row.max_m),
        format!("{:.2}", 1e3 * row.yaw_rms_rad),
        number(row.coverage_95),
        number(row.nees_mean),
        number(row.nis_mean),
        number(row.sigma_over_error),
    ]
}
