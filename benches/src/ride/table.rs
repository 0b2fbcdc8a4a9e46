//! The figures as text.

use std::fmt::Write as _;

use figures::{Align, Table};
use report::ride::RideFigures;

use super::results::{Results, Row, Spread, Summary};

/// Random courses are listed up to this number; JSON has all.
const MAX_LISTED: usize = 30;

pub(super) fn text(results: &Results) -> String {
    let mut text = String::new();
    if !results.is_random || results.rows.len() <= MAX_LISTED {
        let _ = write!(text, "{}", table(&results.rows));
        text += "driven / optimum; lengths in cm, angles in rad, accelerations in m/s^2, jerk in m/s^3, times in s\n";
    }
    let listed = |row: &&Row| row.regret.is_none() && (row.optimum.is_none() || !results.is_random);
    for row in results.rows.iter().filter(listed) {
        let driven = row.driven.map_or(String::new(), |driven| format!(", J {:.3}", driven.objective));
        let _ = writeln!(text, "no regret       {}: {}, {}{driven}", row.name, row.outcome, row.note);
    }
    if let Some(summary) = &results.summary {
        text += &summary_text(summary, results.is_random);
    }
    for name in &results.faults {
        let _ = writeln!(
            text,
            "fault           {name}: the optimum is worse than the drive, so this bench is wrong"
        );
    }
    text
}

fn table(rows: &[Row]) -> Table {
    let headings = [
        "regret",
        "J",
        "second differences",
        "largest step",
        "variation",
        "acceleration",
        "jerk",
        "clearance",
        "time",
    ];
    let numbers = headings.map(|heading| (heading, Align::Right));
    let mut table = Table::new(&[&[("course", Align::Left)], &numbers[..]].concat());
    for row in rows {
        let (Some(driven), Some(optimum), Some(regret)) = (&row.driven, &row.optimum, row.regret) else {
            continue;
        };
        let pair = |figure: fn(&RideFigures) -> f64, decimals: usize| {
            format!("{:.decimals$} / {:.decimals$}", figure(driven), figure(optimum))
        };
        table.row([
            row.name.clone(),
            format!("{regret:.3}"),
            pair(|figures| figures.objective, 2),
            pair(|figures| figures.steering_second_difference_rad, 2),
            pair(|figures| figures.steering_step_max_rad, 3),
            pair(|figures| figures.steering_total_variation_rad, 2),
            pair(|figures| figures.lateral_acceleration_max_mps2, 2),
            pair(|figures| figures.lateral_jerk_max_mps3, 2),
            pair(|figures| 100.0 * figures.min_clearance_m, 1),
            pair(|figures| figures.time_s, 1),
        ]);
    }
    table
}

fn summary_text(summary: &Summary, is_random: bool) -> String {
    let Summary { courses, regret, second_difference_ratio, steering_step_max_rad, .. } = summary;
    let mut text = format!("courses         {courses}: mean, 95 %, largest\n");
    let mut line = |name: &str, spread: Option<Spread>, decimals: usize| {
        let Some(Spread { mean, p95, max }) = spread else { return };
        let _ = writeln!(text, "{name:<16}{mean:.decimals$}  {p95:.decimals$}  {max:.decimals$}");
    };
    line("regret", Some(*regret), 3);
    summary.families.iter().for_each(|(family, regret)| line(&format!("  {family}"), Some(*regret), 3));
    line("differences", *second_difference_ratio, 2);
    line("largest step", *steering_step_max_rad, 4);
    line("clearance lost", summary.clearance_loss_m, 4);
    line("time lost", summary.time_loss_s, 2);
    if let Some(objective) = summary.clear_objective_max {
        let _ = writeln!(text, "clear lines     J {objective:.3} at most");
    }
    if is_random {
        let worst = summary.worst.join(", ");
        let _ = writeln!(text, "worst           {worst}; alone: `--random 1 --seed NUMBER`");
    }
    text
}
