//! The summary of a campaign as text.

use std::fmt::Write as _;

use figures::Table;
use report::NO_OBSTACLE_M;

use super::failures::BadCourse;
use super::summary::{FamilySummary, Summary};

/// Files that are named per cause; the folder has all.
const NAMED: usize = 3;

/// The counts, the table of the families, and the bad courses by cause.
pub(super) fn text(summary: &Summary, set: &str) -> String {
    let Summary { runs, reached, missed, stopped, timeout, collision, .. } = summary;
    let mut text = format!(
        "courses         {runs}: {reached} reached, {stopped} stopped, {missed} missed, {timeout} timeout, {collision} collision, \
         {} excused\n",
        summary.collision_excused
    );
    let _ = writeln!(text, "passable        {} of {} reached", summary.passable_reached, summary.passable);
    let _ = writeln!(text, "closed          {} of {} stopped", summary.blocked_stopped, summary.blocked);
    let _ = writeln!(text, "clearance       smallest {}", metres(summary.min_clearance_m));
    let _ = writeln!(
        text,
        "way to rest     smallest clearance {:.3} m, {} scans without one",
        summary.min_rest_clearance_m, summary.without_rest
    );
    let _ = write!(text, "\n{}", table(&summary.families));
    for (cause, count) in &summary.causes {
        let _ = writeln!(text, "\n{cause}: {count} courses");
        for BadCourse { seed, family, reason, scenario, .. } in
            summary.bad.iter().filter(|bad| bad.cause == *cause).take(NAMED)
        {
            let file = scenario.display();
            let _ = writeln!(text, "  {family} {seed}: {reason}; scanloop run --lockstep {file}{set}");
        }
    }
    text
}

/// A clearance, where there was something to keep clear of.
fn metres(clearance_m: f64) -> String {
    if clearance_m < NO_OBSTACLE_M { format!("{clearance_m:.3} m") } else { "-".to_owned() }
}

fn table(families: &[FamilySummary]) -> Table {
    let headings = [
        "runs",
        "reached",
        "stopped rightly",
        "wrongly",
        "missed",
        "by estimate",
        "impassable",
        "collision",
        "struck",
        "excused",
        "bound 95 %",
        "clearance",
    ];
    let mut table = Table::of_numbers("family", &headings);
    for family in families {
        let share = |count: u64| format!("{:.1} %", 100.0 * count as f64 / family.runs.max(1) as f64);
        table.row([
            family.name.clone(),
            family.runs.to_string(),
            share(family.reached),
            share(family.stopped_rightly),
            share(family.stopped_wrongly),
            share(family.missed),
            share(family.missed_by_estimate),
            share(family.impassable),
            family.collision.to_string(),
            family.struck.to_string(),
            share(family.collision_excused),
            format!("{:.2} %", 100.0 * family.collision_bound_95),
            metres(family.min_clearance_m),
        ]);
    }
    table
}
