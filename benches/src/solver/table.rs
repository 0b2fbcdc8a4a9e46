//! The results of the benchmark as text.

use std::fmt::Write as _;

use figures::{Align, Figures, Table};

use super::SolverResults;
use super::fit::Fit;
use super::versus::{OtherOptimum, PeerRow, SAME_OPTIMUM};

/// Maximum number of listed cases with another optimum; JSON has all.
const MAX_LISTED: usize = 10;

pub(super) fn text(results: &SolverResults) -> String {
    let mut text = format!("profile    {}\ncases      {}", results.profile, results.cases);
    let _ = match results.start {
        "warm" => writeln!(
            text,
            " in {} laps; start: the solution of the scan before, shifted by 0.1 s (first of a lap: straight on)",
            results.laps
        ),
        _ => writeln!(text, ", no column `lap`; start: straight on at 0.9 m/s for every case"),
    };
    text += "times      microseconds, median / 99 % / largest; per case the median of 3 after one that does not count\n\n";
    let mut table = Table::new(&[
        ("QP solver, Hessian", Align::Left),
        ("N", Align::Right),
        ("converged", Align::Right),
        ("SQP step", Align::Left),
        ("feedback", Align::Left),
        ("converged solve", Align::Left),
        ("iterations", Align::Left),
        ("allocations", Align::Right),
    ]);
    for row in &results.solvers {
        let layout = if row.layout == "stages" { " +" } else { "" };
        let refined = if row.refine { "" } else { " *" };
        table.row([
            format!("{}, {}{layout}{refined}", row.name, row.hessian),
            row.n.to_string(),
            format!("{}/{}", row.converged, row.cases),
            times(&row.step_us),
            times(&row.feedback_us),
            times(&row.solve_us),
            format!("{} / {} / {}", row.iterations.p50, row.iterations.p99, row.iterations.max),
            row.allocations.to_string(),
        ]);
    }
    let _ = write!(text, "{table}");
    if results.solvers.iter().any(|row| !row.refine) {
        text += "* without refinement by Newton's method on the active set (`refine = false`)\n";
    }
    if results.solvers.iter().any(|row| row.layout == "stages") {
        text += "+ stage by stage, not condensed\n";
    }
    if results.solvers.iter().any(|row| row.cases < results.cases as u64) {
        text += "fewer cases where all of them would take too long, spread evenly\n";
    }
    if !results.growth.is_empty() {
        text += "\ngrowth with N from N = 24 on, of the medians and of the 99 % of a solve: us = a + b N, and us ~ N^e\n";
    }
    for growth in &results.growth {
        for (what, fit) in [("step", growth.step), ("solve", growth.solve), ("99 %", growth.solve_p99)] {
            let Some(Fit { intercept_us, slope_us, r_squared, exponent }) = fit else { continue };
            let name = format!("{}, {}", growth.name, growth.hessian);
            let _ = writeln!(
                text,
                "{name:<26} {what:<6} a = {intercept_us:.1}, b = {slope_us:.2}, share explained {r_squared:.4}, \
                 e = {exponent:.2}"
            );
        }
    }
    if let Some(about) = &results.about_peers {
        let evaluation = if about.compiled { "compiled C" } else { "not compiled: no C compiler" };
        let acados = about.acados.as_deref().map_or(String::new(), |version| format!(", acados {version}"));
        let _ = writeln!(text, "\npeers      CasADi {}{acados}, {evaluation}", about.version);
    }
    for row in &results.peers {
        let PeerRow { name, n, same, others, .. } = row;
        let converged = format!("{}/{}", row.converged, row.converged + row.failed);
        let _ = write!(text, "{name:<26} {n:>3} {converged:>9}  ");
        let parts = [("", &row.solve_us), (" step", &row.step_us), (" feedback", &row.feedback_us)];
        for ((what, figures), [p50, p99]) in parts.into_iter().zip(row.ratios) {
            if figures.count > 0 {
                let _ = write!(
                    text,
                    "{what} {}: {p50:.1} times ours at the median, {p99:.1} at 99 %;",
                    times(figures)
                );
            }
        }
        if row.solve_us.count == 0 {
            text += "\n";
            continue;
        }
        let _ = writeln!(
            text,
            " {} / {} / {} iterations",
            row.iterations.p50, row.iterations.p99, row.iterations.max
        );
        let _ = writeln!(
            text,
            "{:<26} same optimum in {same}, controls within {:.1e} (as stopped {:.1e}); another one (over \
             {SAME_OPTIMUM:.0e} per 6 intervals) in {}",
            "",
            row.largest_difference,
            row.largest_difference_as_stopped,
            others.len()
        );
        for OtherOptimum { line, difference, objective, peer_objective } in others.iter().take(MAX_LISTED) {
            let _ = writeln!(
                text,
                "{:<26}   line {line}: controls differ by {difference:.1e}, objective {objective:.6} ours, \
                 {peer_objective:.6} its",
                ""
            );
        }
        if others.len() > MAX_LISTED {
            let _ = writeln!(text, "{:<26}   and {} more, see --json", "", others.len() - MAX_LISTED);
        }
    }
    for skipped in &results.skipped {
        let _ = writeln!(text, "\nskipped    {}: {}", skipped.name, skipped.reason);
    }
    text
}

fn times(figures: &Figures) -> String {
    if figures.count == 0 {
        return "-".to_owned();
    }
    format!("{} / {} / {}", short(figures.p50), short(figures.p99), short(figures.max))
}

/// One digit behind the point below a hundred, none above.
fn short(value: f64) -> String {
    if value < 100.0 { format!("{value:.1}") } else { format!("{value:.0}") }
}
