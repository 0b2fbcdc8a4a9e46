//! Results of a comparison, as text.

use std::fmt::Write;

use figures::{Align, Table};

use super::results::{Bytes, Results, Row};

/// The tables of one rate.
pub(super) fn text(results: &Results) -> String {
    let mut text = String::new();
    let bytes = match &results.payload_bytes {
        Bytes::Same(bytes) => bytes.to_string(),
        Bytes::Each(bytes) => bytes.map(|bytes| bytes.to_string()).join(", "),
    };
    let load = if results.load { ", every processor busy" } else { "" };
    let _ = writeln!(
        text,
        "{} hops at {} Hz, {bytes} bytes, scheduling {}, processors {:?}{load}, {} rounds, profile {}",
        results.hops, results.rate_hz, results.scheduling, results.cpus, results.rounds, results.profile
    );
    for rows in [&results.transports, &results.polling] {
        let Some(first) = rows.first() else { continue };
        let name = if first.policy == "poll" { "polling [us]" } else { "blocking [us]" };
        let ratio = format!("ratio to iceoryx2 with its {:.0} % interval", 100.0 * results.confidence);
        let numbers = ["p50", "p99", "max", "sent", "lost"].map(|heading| (heading, Align::Right));
        let columns = [&[(name, Align::Left)], &numbers[..], &[(ratio.as_str(), Align::Left)]].concat();
        let mut table = Table::new(&columns);
        for row in rows {
            let [p50, p99, max] =
                [row.latency_us.p50, row.latency_us.p99, row.latency_us.max].map(|us| format!("{us:.1}"));
            let of_p50 = said(row.verdict_p50, row.ratio_p50, row.ratio_p50_interval);
            let of_p99 = said(row.verdict_p99, row.ratio_p99, row.ratio_p99_interval);
            let [sent, lost] = [row.sent, row.lost].map(|count| count.to_string());
            table.row([
                row.name.to_owned(),
                p50,
                p99,
                max,
                sent,
                lost,
                format!("p50 {of_p50}, p99 {of_p99}"),
            ]);
        }
        let _ = write!(text, "\n{table}");
    }
    for skipped in &results.skipped {
        let _ = writeln!(text, "{:<18} skipped: {}", skipped.name, skipped.reason);
    }
    if let Some(floor) = results.transports.iter().find(|row: &&Row| row.name == "floor") {
        let _ = writeln!(text, "\n{}", beside_floor(floor));
    }
    text
}

/// The cost of this bus relative to the floor, as far as a difference was seen.
fn beside_floor(floor: &Row) -> String {
    let [low, high] = floor.ratio_p50_interval.map(f64::recip);
    match floor.verdict_p50 {
        "no difference seen" => {
            format!("iceoryx2 takes {high:.2} to {low:.2} times the floor in the median: no difference seen")
        }
        _ => format!(
            "iceoryx2 takes {:.2} times the floor in the median ({high:.2} to {low:.2})",
            floor.ratio_p50.recip()
        ),
    }
}

fn said(verdict: &str, ratio: f64, [low, high]: [f64; 2]) -> String {
    match verdict {
        "reference" => "1".to_owned(),
        "no difference seen" if low < 0.01 || high > 100.0 => {
            "no difference seen: too few rounds or too much noise".to_owned()
        }
        "no difference seen" => format!("no difference seen ({low:.2} to {high:.2})"),
        _ => format!("{ratio:.2} ({low:.2} to {high:.2})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_said_only_where_its_interval_leaves_out_one() {
        assert_eq!(said("slower", 3.0, [2.5, 3.5]), "3.00 (2.50 to 3.50)");
        assert_eq!(said("no difference seen", 1.1, [0.9, 1.3]), "no difference seen (0.90 to 1.30)");
        assert!(said("no difference seen", 1.1, [1e-9, 1e9]).contains("noise"));
    }
}
