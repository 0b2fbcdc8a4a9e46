//! The page of the faults for the documentation.

use std::fmt::Write as _;

use faults::{DrivePhase, InjectedFault};

/// `docs/faults.md`: what is injected and what must happen.
pub(super) fn faults_page(all: &[InjectedFault]) -> String {
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
fn within(fault: &InjectedFault) -> String {
    let expected = &fault.expect;
    match expected.detectable_ms {
        _ if expected.from_effect => format!("{:.0} ms after 5 cm", expected.within_ms),
        0.0 => format!("{:.0} ms", expected.within_ms),
        from_ms => format!("{:.0} ms after {from_ms:.0} ms", expected.within_ms),
    }
}

fn differences(fault: &InjectedFault, phase: DrivePhase) -> String {
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
