//! Checks of what was observed with the robot at rest: scanner and odometry.

use plan::System;
use shared_types::{ScannerHealth, ScannerState};
use vehicle::Surroundings;

use super::feed::{Observed, Sweep};
use super::finding::Finding;

/// A scanner may differ by this share from `rate_hz`, as drivers of Hokuyo scanners demand.
const RATE_SHARE: f64 = 0.05;
/// More than every tenth scan without ranges is no working scanner.
const MISSING_SHARE: f64 = 0.1;
/// A scanner that is covered, or reports in another unit, has almost no valid return. In a hall most beams have one.
const MIN_RETURNS: f64 = 0.1;

/// The findings in the order in which they are shown.
pub(super) fn findings(observed: &Observed, system: &System) -> Vec<Finding> {
    let Observed { sweeps, health, .. } = observed;
    let period_s = 1.0 / system.rate_hz;
    let mut all = vec![scanner(observed)];
    if sweeps.len() < 2 {
        all.extend(["rate", "jitter", "stamps", "returns"].map(|name| Finding::skipped(name, "no scans")));
    } else {
        all.extend([rate(sweeps, system.rate_hz), jitter(sweeps, period_s), stamps(sweeps, period_s)]);
        all.push(returns(sweeps, system.vehicle.surroundings));
    }
    all.push(health.map_or_else(|| Finding::skipped("health", "no obstacles sample came"), of_health));
    all.push(odometry(observed));
    all
}

fn scanner(observed: &Observed) -> Finding {
    let (all, invalid) = (observed.sweeps.len(), observed.invalid);
    let missing = observed.sweeps.iter().filter(|sweep| sweep.returns.is_none()).count();
    Finding::of(
        "scanner",
        all > 0 && invalid == 0 && missing as f64 <= MISSING_SHARE * all as f64,
        format!("{all} scans, {missing} without ranges, {invalid} invalid samples"),
        format!("at least 1 scan, up to {:.0} % without ranges, no invalid sample", 100.0 * MISSING_SHARE),
    )
}

/// The mean rate by the stamps of first and last scan.
fn rate(sweeps: &[Sweep], rate_hz: f64) -> Finding {
    let span_s = seconds(sweeps[0].acquired_ns, sweeps[sweeps.len() - 1].acquired_ns);
    let measured_hz = (sweeps.len() - 1) as f64 / span_s;
    let [low_hz, high_hz] = [1.0 - RATE_SHARE, 1.0 + RATE_SHARE].map(|share| share * rate_hz);
    Finding::of(
        "rate",
        (low_hz..=high_hz).contains(&measured_hz),
        format!("{measured_hz:.2} Hz"),
        format!("{low_hz:.2} to {high_hz:.2} Hz"),
    )
}

/// The largest difference of an interval between stamps from the period: longer than 1.5 periods is a gap, which blocks
/// the wheels.
fn jitter(sweeps: &[Sweep], period_s: f64) -> Finding {
    let intervals = sweeps.windows(2).map(|pair| seconds(pair[0].acquired_ns, pair[1].acquired_ns));
    let errors: Vec<f64> = intervals.map(|interval_s| (interval_s - period_s).abs()).collect();
    let gaps = errors.iter().filter(|error_s| **error_s > period_s / 2.0).count();
    let largest_s = errors.iter().copied().fold(0.0, f64::max);
    Finding::of(
        "jitter",
        gaps == 0,
        format!("intervals differ by up to {:.1} ms from the period", 1e3 * largest_s),
        format!("0 to {:.0} ms", 500.0 * period_s),
    )
}

/// The age of scans when they are published: outside of two periods the stamps are of another clock or time.
fn stamps(sweeps: &[Sweep], period_s: f64) -> Finding {
    let ages = sweeps.iter().map(|sweep| seconds(sweep.acquired_ns, sweep.published_ns));
    let (low_s, high_s) =
        ages.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), age_s| (low.min(age_s), high.max(age_s)));
    Finding::of(
        "stamps",
        low_s >= 0.0 && high_s <= 2.0 * period_s,
        format!("scans are {:.1} to {:.1} ms old when they are published", 1e3 * low_s, 1e3 * high_s),
        format!("0 to {:.0} ms", 2e3 * period_s),
    )
}

fn returns(sweeps: &[Sweep], surroundings: Surroundings) -> Finding {
    let shares: Vec<f64> = sweeps.iter().filter_map(|sweep| sweep.returns).collect();
    if surroundings == Surroundings::Open {
        return Finding::skipped("returns", "vehicle.surroundings = \"open\": nothing has to return");
    }
    if shares.is_empty() {
        return Finding::skipped("returns", "no scan has ranges");
    }
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    Finding::of(
        "returns",
        mean >= MIN_RETURNS,
        format!("{:.0} % of the beams ahead", 100.0 * mean),
        format!("{:.0} to 100 %", 100.0 * MIN_RETURNS),
    )
}

fn of_health(health: ScannerHealth) -> Finding {
    Finding::of("health", health.state() == ScannerState::Healthy, health.to_string(), "healthy")
}

/// One odometry per scan; the one of the last scan may still be on its way.
fn odometry(observed: &Observed) -> Finding {
    let (scans, odometries) = (observed.sweeps.len(), observed.odometries);
    Finding::of(
        "odometry",
        odometries > 0 && odometries.abs_diff(scans) <= 1,
        format!("{odometries} samples, {scans} scans"),
        "one for each scan",
    )
}

/// Time between two stamps, negative when the second is earlier [s].
fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::super::finding::Outcome;
    use super::*;

    fn system() -> System {
        plan::Plan::read(None, &plan::Choice::default()).unwrap().system
    }

    /// Scans at these times [ms], each published 30 ms later.
    fn observed(at_ms: &[u64]) -> Observed {
        let sweep = |at_ms: &u64| Sweep {
            acquired_ns: 1_000_000 * at_ms,
            published_ns: 1_000_000 * (at_ms + 30),
            returns: Some(0.8),
        };
        let sweeps: Vec<Sweep> = at_ms.iter().map(sweep).collect();
        let health = Some(ScannerHealth::healthy(4.0));
        Observed { odometries: sweeps.len(), sweeps, health, ..Observed::default() }
    }

    /// Names of the checks that failed.
    fn failed(observed: &Observed) -> Vec<&'static str> {
        let failed = findings(observed, &system()).into_iter();
        failed.filter(|finding| finding.outcome == Outcome::Failed).map(|finding| finding.name).collect()
    }

    #[test]
    fn a_scanner_that_works_passes_all_checks() {
        let regular: Vec<u64> = (1..=20).map(|scan| 100 * scan + scan % 3).collect();
        let found = findings(&observed(&regular), &system());
        assert!(found.iter().all(|finding| finding.outcome == Outcome::Ok), "{found:?}");
        assert_eq!(found[1].to_string(), "ok       rate      9.99 Hz (allowed: 9.50 to 10.50 Hz)");
    }

    #[test]
    fn each_fault_fails_its_check() {
        let regular: Vec<u64> = (1..=20).map(|scan| 100 * scan).collect();
        assert_eq!(failed(&Observed::default()), ["scanner", "odometry"]);
        let slow: Vec<u64> = (1..=20).map(|scan| 107 * scan).collect();
        assert_eq!(failed(&observed(&slow)), ["rate"]);
        let mut late = regular.clone();
        late[9] += 60;
        assert_eq!(failed(&observed(&late)), ["jitter"]);
        let of = |change: fn(&mut Observed)| {
            let mut observed = observed(&regular);
            change(&mut observed);
            failed(&observed)
        };
        assert_eq!(of(|it| it.sweeps[4].published_ns = 1), ["stamps"]);
        assert_eq!(of(|it| it.sweeps[4].published_ns += 180_000_000), ["stamps"]);
        assert_eq!(of(|it| it.sweeps.iter_mut().for_each(|sweep| sweep.returns = Some(0.05))), ["returns"]);
        assert_eq!(of(|it| it.sweeps[..3].iter_mut().for_each(|sweep| sweep.returns = None)), ["scanner"]);
        assert_eq!(of(|it| it.odometries -= 2), ["odometry"]);
        let blind = |it: &mut Observed| {
            it.health = Some(ScannerHealth { state: ScannerState::Blind.wire(), ..Default::default() });
        };
        assert_eq!(of(blind), ["health"]);
    }
}
