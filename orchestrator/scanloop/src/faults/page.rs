//! The page of the faults for the documentation, and the page of a result.

use std::fmt::Write as _;

use fault_matrix::{Cell, Verdict};
use faults::{Fault, Phase};

/// `docs/faults.md`: what is injected and what must happen.
pub(crate) fn faults_page(all: &[Fault]) -> String {
    let cells = all.iter().map(|fault| fault.phases().count()).sum::<usize>();
    let live: usize = all.iter().filter(|fault| fault.is_live()).map(|fault| fault.phases().count()).sum();
    let mut text = include_str!("faults.md").to_owned();
    let _ = writeln!(text, "{} faults in {cells} cells, {live} of them with real processes.\n", all.len());
    text.push_str(
        "| fault | what fails | by how much | detected by | within | the drive ends |\n|---|---|---|---|---:|---|\n",
    );
    for fault in all {
        let expected = &fault.expect;
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} | {} |",
            fault.name,
            fault.title.trim_end_matches('.'),
            fault.magnitude,
            or_dash(&expected.detected_by.join(", ")),
            within(fault),
            expected.outcomes.join(", ")
        );
    }
    text.push_str("\n## What differs in a phase\n\n| cell | what differs | why |\n|---|---|---|\n");
    for fault in all {
        for (phase, differs) in &fault.in_phase {
            let _ = writeln!(
                text,
                "| `{}/{phase}` | {} | {} |",
                fault.name,
                differences(fault, *phase),
                differs.because
            );
        }
    }
    text
}

fn or_dash(text: &str) -> &str {
    if text.is_empty() { "-" } else { text }
}

/// Time until the detection; where the fault has to grow, from when on.
fn within(fault: &Fault) -> String {
    let expected = &fault.expect;
    match expected.detectable_ms {
        _ if expected.from_effect => format!("{:.0} ms after 5 cm", expected.within_ms),
        0.0 => format!("{:.0} ms", expected.within_ms),
        from_ms => format!("{:.0} ms after {from_ms:.0} ms", expected.within_ms),
    }
}

fn differences(fault: &Fault, phase: Phase) -> String {
    let Some(differs) = fault.in_phase.get(&phase) else { return String::new() };
    if differs.skip {
        return "no cell".to_owned();
    }
    let outcomes = differs.outcomes.as_ref().map(|outcomes| format!("ends {}", outcomes.join(", ")));
    let by = differs.detected_by.as_ref().map(|by| format!("detected by {}", or_dash(&by.join(", "))));
    let within = differs.within_ms.map(|ms| format!("within {ms:.0} ms"));
    let from = differs.detectable_ms.map(|ms| format!("from {ms:.0} ms on"));
    [outcomes, by, within, from].into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// The page of a result: one row per cell, failed ones first.
pub(super) fn html(cells: &[Cell]) -> String {
    let failed = cells.iter().filter(|cell| cell.verdict == Verdict::Fail);
    let passed = cells.iter().filter(|cell| cell.verdict == Verdict::Pass);
    let mut text = include_str!("faults.html").to_owned();
    for cell in failed.chain(passed) {
        let Cell { fault, phase, detected_by, detection, outcome, reason, .. } = cell;
        let class = if cell.verdict == Verdict::Pass { "pass" } else { "fail" };
        let after = cell.detected_after_ms.map_or_else(String::new, |ms| format!("{ms:.0}"));
        let kind = if cell.live { "real processes" } else { "simulated" };
        let _ = writeln!(
            text,
            "<tr class=\"{class}\"><td>{fault}</td><td>{phase}</td><td>{class}</td><td>{detected_by}</td>\
             <td>{detection}</td><td>{after}</td><td>{:.3}</td><td>{:.3}</td><td>{:.3}</td><td>{:.3}</td>\
             <td>{outcome}</td><td>{kind}</td><td>{reason}</td></tr>",
            cell.blind_m, cell.blind_limit_m, cell.deviation_m, cell.min_clearance_m
        );
    }
    text.push_str("</tbody></table></body></html>\n");
    text
}
