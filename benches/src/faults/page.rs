//! The page of a result.

use std::fmt::Write as _;

use fault_matrix::{Cell, CellVerdict};

/// The page of a result: one row per cell, failed ones first.
pub(super) fn html(cells: &[Cell]) -> String {
    let failed = cells.iter().filter(|cell| cell.verdict == CellVerdict::Fail);
    let passed = cells.iter().filter(|cell| cell.verdict == CellVerdict::Pass);
    let mut text = include_str!("faults.html").to_owned();
    for cell in failed.chain(passed) {
        let Cell { fault, phase, detected_by, detection, outcome, reason, .. } = cell;
        let class = if cell.verdict == CellVerdict::Pass { "pass" } else { "fail" };
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
