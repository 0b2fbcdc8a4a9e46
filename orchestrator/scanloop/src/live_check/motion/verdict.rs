//! The verdict on all stops, and the deceleration that they show.

use vehicle::Description;
use vehicle::tyre::GRAVITY_MPS2;

use super::super::finding::Finding;
use super::body::Stop;
use super::deceleration::{self, Deceleration};
use super::halt::Halt;

/// Ways that the scans and the odometry show differ, if by more standard errors than this, and by this way per stop [m].
const SLIDE: (f64, f64) = (3.0, 0.002);

/// Judges the stops by their sum: one alone may be delayed by a busy computer.
///
/// Encoders of locked wheels do not count what the body slides, so the scans decide where they show the way.
pub(super) fn judge(stops: &[Stop], vehicle: &Description) -> (Finding, Option<Deceleration>) {
    let described_mps2 = vehicle.blocked_deceleration_mps2;
    let judged = Judged::of(stops);
    let halts = &judged.halts;
    let sum = |of: &dyn Fn(&Halt) -> f64| halts.iter().map(of).sum::<f64>();
    let (covered_m, allowed_m) = (sum(&|halt| halt.distance_m), sum(&|halt| halt.allowed_m(described_mps2)));
    let found = deceleration::fit(halts);
    let friction_mps2 = vehicle.tyre_friction * GRAVITY_MPS2;
    let (count, fastest) = (halts.len(), halts.iter().map(|halt| halt.speed_mps).fold(0.0, f64::max));
    let plural = if count == 1 { "stop" } else { "stops" };
    let way = format!("{covered_m:.3} m in {count} {plural} from up to {fastest:.2} m/s{}", judged.by);
    let tyres = format!("{friction_mps2:.1} m/s^2 by vehicle.tyre_friction = {}", vehicle.tyre_friction);
    if covered_m <= 0.0 || found.entered_mps2 > friction_mps2 {
        let measured = format!("{way}: shorter than friction allows, so this is not the way of the body");
        let allowed = format!("up to {tyres}");
        return (Finding::of("stop", false, measured, allowed), None);
    }
    let found = found.at_most(friction_mps2);
    let Deceleration { estimate_mps2, entered_mps2 } = found;
    let limit =
        if estimate_mps2 >= friction_mps2 { format!(", no more than {tyres}") } else { String::new() };
    let finding = Finding::of(
        "stop",
        covered_m <= allowed_m,
        format!("{way}: {estimate_mps2:.2} m/s^2, with the error at least {entered_mps2}{limit}"),
        format!("up to {allowed_m:.3} m by vehicle.blocked_deceleration_mps2 = {described_mps2}"),
    );
    (finding, Some(found))
}

/// The stops that count, and by what they were measured.
struct Judged {
    halts: Vec<Halt>,
    by: String,
}

impl Judged {
    /// The stops as the scans show them; those of the odometry only if the scans show none.
    fn of(stops: &[Stop]) -> Self {
        let seen: Vec<(Halt, f64, Halt)> = stops
            .iter()
            .filter_map(|stop| stop.seen.map(|(halt, error_m)| (halt, error_m, stop.counted)))
            .collect();
        if seen.is_empty() {
            let by = " by the odometry alone, as the scans do not show the way".to_owned();
            return Self { halts: stops.iter().map(|stop| stop.counted).collect(), by };
        }
        let sum = |of: &dyn Fn(&(Halt, f64, Halt)) -> f64| seen.iter().map(of).sum::<f64>();
        let [seen_m, counted_m] =
            [sum(&|(halt, ..)| halt.distance_m), sum(&|(.., counted)| counted.distance_m)];
        let error_m =
            SLIDE.0 * sum(&|(_, error_m, _)| error_m * error_m).sqrt() + SLIDE.1 * seen.len() as f64;
        let by = if (seen_m - counted_m).abs() > error_m {
            format!(
                " by the scans, of which the odometry counted {counted_m:.3} m: it does not show what wheels slide"
            )
        } else {
            " by the scans".to_owned()
        };
        Self { halts: seen.into_iter().map(|(halt, ..)| halt).collect(), by }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::finding::Outcome;
    use super::*;

    /// Stops from 0.6 and 0.3 m/s: the way that the odometry counts, as share of that at 5 m/s^2, and that of the scans.
    fn stops(counted: f64, seen: Option<f64>) -> Vec<Stop> {
        let halt =
            |speed_mps: f64, share: f64| Halt { speed_mps, distance_m: share * speed_mps.powi(2) / 10.0 };
        let stop = |speed_mps: f64| Stop {
            counted: halt(speed_mps, counted),
            seen: seen.map(|share| (halt(speed_mps, share), 0.002)),
        };
        [0.6, 0.3, 0.6, 0.3].map(stop).to_vec()
    }

    fn judged(counted: f64, seen: Option<f64>) -> (Outcome, Option<f64>, String) {
        let (finding, found) = judge(&stops(counted, seen), &Description::default());
        (finding.outcome, found.map(|found| found.estimate_mps2), finding.measured)
    }

    #[test]
    fn the_scans_decide_where_they_show_the_way() {
        let (outcome, estimate, text) = judged(0.0, Some(1.0));
        assert!((estimate.unwrap() - 5.0).abs() < 1e-6, "{text}");
        assert!(outcome == Outcome::Ok && text.contains("the odometry counted 0.000 m"), "{text}");
        let (_, estimate, text) = judged(1.05, Some(1.0));
        assert!((estimate.unwrap() - 5.0).abs() < 1e-6 && !text.contains("odometry"), "{text}");
        assert_eq!(judged(1.0, Some(4.0)).0, Outcome::Failed, "it slides four times as far as described");
    }

    #[test]
    fn without_the_scans_a_way_that_friction_forbids_gives_no_value() {
        for counted in [-0.05, 0.0, 0.02] {
            let (outcome, estimate, text) = judged(counted, None);
            assert_eq!((outcome, estimate), (Outcome::Failed, None), "{text}");
            assert!(text.contains("shorter than friction allows"), "{text}");
        }
        let (outcome, estimate, text) = judged(1.0, None);
        assert!(outcome == Outcome::Ok && (estimate.unwrap() - 5.0).abs() < 1e-6, "{text}");
    }

    #[test]
    fn no_more_is_recommended_than_friction_allows() {
        // 7.9 m/s^2, within the error of 0.8 g.
        let (finding, found) = judge(&stops(0.63, Some(0.63)), &Description::default());
        let found = found.unwrap();
        assert!((found.estimate_mps2 - 7.848).abs() < 1e-9 && found.entered_mps2 <= 7.8, "{finding}");
        assert!(
            finding.measured.contains("no more than 7.8 m/s^2 by vehicle.tyre_friction = 0.8"),
            "{finding}"
        );
    }
}
