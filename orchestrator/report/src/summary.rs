//! The summary at the end of a run, as text with aligned columns.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use audit::ledger::DeliveryFaultKind;
use figures::Figures;

use crate::latency::STAGES;
use crate::report::{
    DelayRow, DriverChange, Landing, LatencyReport, LedgerReport, LedgerRow, NO_OBSTACLE_M, PerStage, Report,
    ScanReport, ScannerReport, SelfCheckReport, TrueDrive,
};

/// Changes of who drives in a summary.
const MAX_DRIVERS: usize = 6;

/// The summary of a run; `folder` is where its files are, if any were written.
pub fn text(report: &Report, folder: Option<&Path>) -> String {
    let mut rows = vec![("outcome", outcome(report))];
    rows.push(("driven", format!("{:.1} s, {:.2} m", report.duration_s, report.drive.path_length_m)));
    rows.push(("to the goal", format!("{:.3} m", report.drive.final_distance_m)));
    if !report.driver_changes.is_empty() {
        rows.push(("driven by", drivers(&report.driver_changes)));
    }
    if report.goals.len() > 1 || report.goals.iter().any(|goal| goal.yaw_error_rad.is_some()) {
        rows.extend(report.goals.iter().map(|goal| ("goal", landing(goal))));
    }
    match &report.drive.truth {
        Some(truth) => rows.push(("clearance", clearance(truth))),
        None => rows.push((
            "judged by",
            "the estimate: no truth, so collisions and clearance are not known".to_owned(),
        )),
    }
    if report.margin_m.sum() > 0.0 {
        rows.push(("margin", report.margin_m.to_string()));
    }
    let ScannerReport { valid_share, .. } = report.scanner;
    if report.scanner != (ScannerReport { valid_share, ..ScannerReport::default() }) {
        rows.push(("scanner", report.scanner.to_string()));
    }
    rows.extend(report.drive.truth.iter().map(|truth| ("estimate error", estimate_error(truth))));
    rows.push(("scans", scans(&report.scans)));
    rows.push(("samples", samples(&report.ledger)));
    rows.extend(report.ledger.companions.iter().map(|row| ("beside the loop", beside(row))));
    rows.extend(report.ledger.refused.iter().map(|row| ("dropped", row.to_string())));
    rows.extend(report.recording.iter().map(|recording| ("recording", recording.to_string())));
    rows.extend(report.incidents.iter().map(|file| ("incident", file.display().to_string())));
    if !report.controller.status.is_empty() {
        rows.push(("solver", counts(report.controller.status.iter())));
    }
    if !report.stop_reasons.is_empty() {
        rows.push(("stops", stops(&report.stop_reasons)));
    }
    let blocking = report.blocking.map(|blocking| blocking.to_string());
    rows.extend(blocking.filter(|name| !report.reason.contains(name)).map(|name| ("blocked by", name)));
    let SelfCheckReport { alarms, suspect, alarm, first_scan, .. } = &report.self_check;
    if *alarms > 0 {
        let suspect = suspect.replace('_', " ");
        rows.push(("self-check", format!("suspects {suspect} since scan {first_scan}: {alarm}")));
    }
    let restarts: u32 = report.processes.iter().map(|process| process.restarts).sum();
    if restarts > 0 {
        rows.push(("restarts", restarts.to_string()));
    }
    let mut text = String::new();
    for (name, value) in rows {
        line(&mut text, format_args!("{name:<15} {value}"));
    }
    line(&mut text, format_args!(""));
    text += &latency_table(&report.latency_us);
    if let Some(folder) = folder {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        line(&mut text, format_args!("\n{:<15} {}", "files", folder.display()));
    }
    text
}

/// Who drove since when.
fn drivers(changes: &[DriverChange]) -> String {
    let since = |change: &DriverChange| format!("{} from {:.1} s", change.driven_by, change.from_s);
    let shown = changes.iter().take(MAX_DRIVERS).map(since);
    let more = changes.len().saturating_sub(MAX_DRIVERS);
    let more = (more > 0).then(|| format!("{more} changes more"));
    std::iter::once("controller".to_owned()).chain(shown).chain(more).collect::<Vec<_>>().join(", ")
}

fn outcome(report: &Report) -> String {
    let simulated = if report.lockstep { " (simulated time)" } else { "" };
    let reason = if report.reason.is_empty() { String::new() } else { format!(": {}", report.reason) };
    format!("{}{reason}{simulated}", report.outcome)
}

/// What became of one goal of several, or of one with a direction.
fn landing(goal: &Landing) -> String {
    let Landing { reached_s, distance_m, yaw_error_rad } = goal;
    let reached = reached_s.map_or("not reached".to_owned(), |at_s| format!("reached after {at_s:.1} s"));
    let distance = distance_m.map_or_else(String::new, |distance_m| format!(", {distance_m:.3} m away"));
    let yaw = yaw_error_rad.map_or_else(String::new, |rad| format!(", {rad:.3} rad off"));
    reached + &distance + &yaw
}

/// For how many scans the wheels were blocked, for each reason.
fn stops(reasons: &BTreeMap<String, u64>) -> String {
    let row = |(reason, scans): (&String, &u64)| {
        let plural = if *scans == 1 { "" } else { "s" };
        format!("{} for {scans} scan{plural}", reason.replace('_', " "))
    };
    reasons.iter().map(row).collect::<Vec<_>>().join(", ")
}

fn clearance(drive: &TrueDrive) -> String {
    let touched = match (drive.collided, drive.struck) {
        (true, _) => ", touched while driving",
        (false, true) => ", struck while standing",
        (false, false) => "",
    };
    if drive.min_clearance_m >= NO_OBSTACLE_M {
        format!("no obstacle{touched}")
    } else {
        format!("smallest {:.3} m{touched}", drive.min_clearance_m)
    }
}

fn estimate_error(drive: &TrueDrive) -> String {
    let TrueDrive { estimate_error_max_m, estimate_error_rms_m, covariance_coverage, .. } = drive;
    let coverage = covariance_coverage.map_or_else(String::new, |share| {
        format!(", in its 95 % ellipse in {:.1} % of scans", 100.0 * share)
    });
    format!("at most {estimate_error_max_m:.3} m, rms {estimate_error_rms_m:.3} m{coverage}")
}

fn scans(scans: &ScanReport) -> String {
    let ScanReport { published, commanded, late, lost, unaccounted, duplicates, missing, ref lost_reasons } =
        *scans;
    let mut text = format!("{published} published, {commanded} commanded, {late} late, {lost} lost");
    if lost > 0 {
        text += &format!(" ({})", counts(lost_reasons.iter()));
    }
    if missing > 0 {
        text += &format!(", {missing} without ranges");
    }
    if unaccounted > 0 {
        text += &format!(", {unaccounted} UNACCOUNTED");
    }
    if duplicates > 0 {
        text += &format!(", {duplicates} answered twice");
    }
    text
}

/// Counts of all samples at all of their readers, and what is unexplained.
fn samples(ledger: &LedgerReport) -> String {
    let sum = |field: fn(&LedgerRow) -> u64| ledger.topics.iter().map(field).sum::<u64>();
    let mut text = format!(
        "{} published, {} used, {} replaced, {} lost, {} in flight",
        sum(|row| row.published),
        sum(|row| row.used),
        sum(|row| row.replaced),
        sum(|row| row.lost),
        sum(|row| row.in_flight)
    );
    use DeliveryFaultKind::{Duplicate, Impossible, Missing, Reordered, Vanished};
    for (count, what, kinds) in [
        (ledger.residual, "MISSING", [Missing, Vanished]),
        (ledger.duplicates, "CAME TWICE", [Duplicate; 2]),
        (ledger.reordered, "OUT OF ORDER", [Reordered; 2]),
        (ledger.impossible, "WITH AN IMPOSSIBLE NUMBER", [Impossible; 2]),
    ] {
        if count > 0 {
            text += &format!(", {count} {what}");
            let first = ledger.faults.iter().find(|fault| kinds.contains(&fault.kind));
            first.iter().for_each(|fault| text += &format!(": {fault}"));
        }
    }
    text
}

/// What became of the samples of a topic beside the loop at one reader.
fn beside(row: &LedgerRow) -> String {
    let LedgerRow { topic, reader, published, used, replaced, lost, in_flight, residual, reasons, .. } = row;
    let mut text = format!("{topic} at {reader}: {published} published, {used} used, {replaced} replaced");
    if !reasons.is_empty() {
        text += &format!(" ({})", counts(reasons.iter()));
    }
    text += &format!(", {lost} lost, {in_flight} in flight");
    if *residual > 0 {
        text += &format!(", {residual} MISSING");
    }
    text
}

/// Counts by name as text, like `12 converged, 1 out of time`.
pub fn counts<'a>(counts: impl Iterator<Item = (&'a String, &'a u64)>) -> String {
    counts.map(|(name, count)| format!("{count} {}", name.replace('_', " "))).collect::<Vec<_>>().join(", ")
}

/// The table of latencies.
pub fn latency_table(latency: &LatencyReport) -> String {
    if latency.simulated {
        return format!("{:<15} not measured: time was simulated\n", "latency");
    }
    let mut text = String::new();
    let stages = STAGES.iter().zip(latency.stages.compute.each());
    let rows = [("scan to actuation".to_owned(), &latency.scan_to_actuation)]
        .into_iter()
        .chain(stages.map(|(role, figures)| (format!("  {role}"), figures)))
        .chain([("  transport".to_owned(), &latency.stages.transport)])
        .chain([("age of the data".to_owned(), &latency.data_age)]);
    row(&mut text, "latency [ms]", ["p50", "p90", "p99", "max"].map(str::to_owned));
    for (name, Figures { count, p50, p90, p99, max, .. }) in rows {
        row(
            &mut text,
            &name,
            [p50, p90, p99, max].map(|us| if *count == 0 { "-".to_owned() } else { ms(*us) }),
        );
    }
    if latency.complete_chains > 0 {
        stages_table(&mut text, latency);
    }
    let incomplete = match latency.incomplete_chains {
        0 => String::new(),
        count => format!(", {count} INCOMPLETE"),
    };
    line(&mut text, format_args!("{:<20} {} complete{incomplete}", "chains", latency.complete_chains));
    if !latency.companions.is_empty() {
        line(&mut text, format_args!(""));
        row(&mut text, "beside the loop [ms]", ["mean", "max", "samples", ""].map(str::to_owned));
    }
    for DelayRow { topic, process, writes, count, mean_us, max_us } in &latency.companions {
        let name =
            if *writes { format!("  scan > {process} > {topic}") } else { format!("  {topic} > {process}") };
        row(&mut text, &name, [ms(*mean_us), ms(*max_us), count.to_string(), String::new()]);
    }
    text
}

/// Where each stage spends its time, medians.
fn stages_table(text: &mut String, latency: &LatencyReport) {
    line(text, format_args!(""));
    row(text, "p50 [ms]", ["wait", "hop", "compute", "publish"].map(str::to_owned));
    let LatencyReport { stages, hops, waits, publications, .. } = latency;
    let columns = [waits, hops, &stages.compute, publications].map(PerStage::each);
    for (index, role) in STAGES.iter().enumerate() {
        row(text, &format!("  {role}"), columns.map(|column| ms(column[index].p50)));
    }
}

fn row(text: &mut String, name: &str, [a, b, c, d]: [String; 4]) {
    line(text, format_args!("{name:<20} {a:>9} {b:>9} {c:>9} {d:>9}"));
}

/// Microseconds as milliseconds.
fn ms(us: f64) -> String {
    format!("{:.3}", us * 1e-3)
}

fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    // Writing to a text can't fail.
    let _ = writeln!(text, "{arguments}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{BlockingReport, MarginReport, Outcome};
    fn report() -> Report {
        let mut report = Report { outcome: Outcome::Reached, duration_s: 12.7, ..Report::default() };
        report.drive.path_length_m = 10.2;
        report.drive.final_distance_m = 0.0412;
        report.drive.truth = Some(TrueDrive {
            min_clearance_m: 0.3514,
            covariance_coverage: Some(0.9534),
            ..TrueDrive::default()
        });
        report.margin_m =
            MarginReport { base: 0.05, pose: 0.021, latency: 0.0304, model: 0.01, perception: 0.02 };
        report.scans = ScanReport { published: 127, commanded: 126, lost: 1, ..ScanReport::default() };
        report.scans.lost_reasons = BTreeMap::from([("run_ended".to_owned(), 1)]);
        report.controller.status = BTreeMap::from([("converged".to_owned(), 127)]);
        report.ledger.topics = vec![LedgerRow {
            published: 127,
            used: 120,
            replaced: 4,
            lost: 2,
            in_flight: 1,
            ..LedgerRow::default()
        }];
        report.latency_us.complete_chains = 126;
        report.latency_us.hops.obstacles.p50 = 60.0;
        report.latency_us.stages.compute.controller =
            Figures { count: 127, p50: 1234.5, p90: 2000.0, p99: 3000.0, p999: 4000.0, max: 12345.6 };
        report
    }

    #[test]
    fn goals_have_a_row_each_where_they_are_several_or_have_a_direction() {
        let landed = Landing { reached_s: Some(9.64), distance_m: Some(0.0123), yaw_error_rad: Some(0.05) };
        let rows = |goals: Vec<Landing>| {
            let text = text(&Report { goals, ..report() }, None);
            text.lines().filter(|line| line.starts_with("goal ")).map(str::to_owned).collect::<Vec<_>>()
        };
        assert_eq!(rows(vec![Landing { yaw_error_rad: None, ..landed }]), [""; 0]);
        let first = "goal            reached after 9.6 s, 0.012 m away, 0.050 rad off";
        assert_eq!(rows(vec![landed, Landing::default()]), [first, "goal            not reached"]);
    }

    #[test]
    fn the_summary_has_the_outcome_and_where_the_time_went() {
        let text = text(&report(), Some(Path::new("out/corridor")));
        assert_eq!(
            text,
            "\
outcome         reached
driven          12.7 s, 10.20 m
to the goal     0.041 m
clearance       smallest 0.351 m
margin          13.1 cm: base 5.0 + pose 2.1 + latency 3.0 + model 1.0 + perception 2.0
estimate error  at most 0.000 m, rms 0.000 m, in its 95 % ellipse in 95.3 % of scans
scans           127 published, 126 commanded, 0 late, 1 lost (1 run ended)
samples         127 published, 120 used, 4 replaced, 2 lost, 1 in flight
solver          127 converged

latency [ms]               p50       p90       p99       max
scan to actuation            -         -         -         -
  estimator                  -         -         -         -
  obstacles                  -         -         -         -
  controller             1.234     2.000     3.000    12.346
  actuator                   -         -         -         -
  transport                  -         -         -         -
age of the data              -         -         -         -

p50 [ms]                  wait       hop   compute   publish
  estimator              0.000     0.000     0.000     0.000
  obstacles              0.000     0.060     0.000     0.000
  controller             0.000     0.000     1.234     0.000
  actuator               0.000     0.000     0.000     0.000
chains               126 complete

files           out/corridor
"
        );
    }

    #[test]
    fn simulated_time_stops_and_restarts_are_in_the_summary() {
        let mut report = report();
        (report.outcome, report.reason, report.lockstep) =
            (Outcome::Stopped, "path blocked".to_owned(), true);
        report.latency_us.simulated = true;
        report.stop_reasons = BTreeMap::from([("no_command".to_owned(), 2)]);
        report.processes = vec![crate::report::ProcessReport { restarts: 3, ..Default::default() }];
        report.drive.truth = Some(TrueDrive::default());
        let text = text(&report, None);
        for expected in [
            "outcome         stopped: path blocked (simulated time)\n",
            "clearance       no obstacle\n",
            "stops           no command for 2 scans\n",
            "restarts        3\n",
            "latency         not measured: time was simulated\n",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
    }

    #[test]
    fn without_a_truth_the_summary_says_so_and_names_no_clearance() {
        let mut report = report();
        report.drive.truth = None;
        let text = text(&report, None);
        assert!(text.contains("judged by       the estimate: no truth, "), "{text}");
        assert!(!text.contains("clearance       ") && !text.contains("estimate error"), "{text}");
    }

    #[test]
    fn a_scanner_that_was_not_always_healthy_has_a_row() {
        let of = |scanner| text(&Report { scanner, ..report() }, None);
        let healthy = ScannerReport { valid_share: 0.88, ..ScannerReport::default() };
        assert!(!of(healthy).contains("scanner"));
        let text = of(ScannerReport { blind_scans: 12, ..healthy });
        assert!(text.contains("scanner         88.0 % of beams valid, 12 scans blind\n"), "{text}");
    }

    #[test]
    fn the_obstacle_of_a_stop_is_named_once() {
        let blocking = BlockingReport { id: 17, x_m: 6.0, y_m: 0.1, gap_m: -0.1, needed_m: 0.62 };
        let mut report = Report { blocking: Some(blocking), ..report() };
        let expected = "obstacle 17 at (6.0, 0.1): no gap, needs 0.62 m";
        assert!(text(&report, None).contains(&format!("blocked by      {expected}\n")));
        (report.outcome, report.reason) = (Outcome::Stopped, format!("wheels blocked: {expected}"));
        assert_eq!(text(&report, None).matches(expected).count(), 1);
    }

    #[test]
    fn dropped_samples_are_named_with_their_writer_and_rule() {
        let mut report = report();
        report.ledger.refused = vec![audit::ledger::RefusedRow {
            topic: "command".to_owned(),
            writer: "controller".to_owned(),
            incarnation: 2,
            reader: "actuator".to_owned(),
            rule: "outside_bounds".to_owned(),
            field: "velocity_mps".to_owned(),
            value: 1.5,
            count: 44,
            ..Default::default()
        }];
        let expected = "dropped         44 command of controller (incarnation 2) dropped by actuator: \
                        outside bounds (velocity_mps = 1.5)\n";
        let text = text(&report, None);
        assert!(text.contains(expected), "{text}");
    }

    #[test]
    fn unaccounted_scans_are_in_capitals() {
        let mut report = report();
        report.scans.unaccounted = 2;
        assert!(text(&report, None).contains("2 UNACCOUNTED"));
    }

    #[test]
    fn unexplained_samples_are_in_capitals_and_named() {
        let mut report = report();
        (report.ledger.residual, report.ledger.impossible) = (1, 4);
        let fault = |kind, sequence, scan_id| audit::ledger::DeliveryFault {
            topic: "pose".to_owned(),
            kind,
            count: 1,
            incarnation: 2,
            sequence,
            scan_id,
            noticed_by: "bus".to_owned(),
        };
        report.ledger.faults =
            vec![fault(DeliveryFaultKind::Missing, 17, 17), fault(DeliveryFaultKind::Impossible, 1 << 63, 0)];
        report.latency_us.incomplete_chains = 3;
        let text = text(&report, None);
        let expected = ", 1 MISSING: pose number 17 of incarnation 2, for scan 17, is missing, 4 WITH AN IMPOSSIBLE NUMBER: \
                        pose number 9223372036854775808 of incarnation 2 has a number that it can't have\n";
        assert!(text.contains(expected), "{text}");
        assert!(text.contains("126 complete, 3 INCOMPLETE"), "{text}");
    }
}
