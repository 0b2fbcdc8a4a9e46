//! What the demo promises, what it has measured, and whether that holds. Pure.

use shared_types::did_you_mean;
use std::fmt::Write as _;

use console::exit::Failure;
use serde::Serialize;

/// Columns of the text of a claim in the table.
const TEXT_COLUMNS: usize = 45;

/// How a measured value is compared with the promised one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Bound {
    /// It is not larger.
    AtMost,
    /// It is not smaller.
    AtLeast,
}

/// A promise of the product.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Promise {
    name: &'static str,
    text: &'static str,
    bound: Bound,
    value: f64,
    unit: &'static str,
}

const fn at_most(name: &'static str, value: f64, unit: &'static str, text: &'static str) -> Promise {
    Promise { name, text, bound: Bound::AtMost, value, unit }
}

const fn at_least(name: &'static str, value: f64, unit: &'static str, text: &'static str) -> Promise {
    Promise { name, text, bound: Bound::AtLeast, value, unit }
}

/// All promises, in the order of the demo. Times are those of a scan period T of 100 ms: an answer comes within T, wheels
/// turn at most 3 T without one, and a process is back before a person would have noticed.
const PROMISES: &[Promise] = &[
    at_least("answered_scans", 20.0, "scans", "scans answered in the undisturbed drive"),
    at_most("unanswered_scans", 0.0, "scans", "scans without an answer in this time"),
    at_most("scan_to_actuation_ms", 100.0, "ms", "from scan to actuation, longest"),
    at_most("killed_estimator_blind_ms", 300.0, "ms", "estimator killed: wheels without command"),
    at_most("killed_estimator_back_s", 3.0, "s", "estimator killed: drives again after"),
    at_most("killed_obstacles_blind_ms", 300.0, "ms", "obstacles killed: wheels without command"),
    at_most("killed_obstacles_back_s", 3.0, "s", "obstacles killed: drives again after"),
    at_most("killed_controller_blind_ms", 300.0, "ms", "controller killed: wheels without command"),
    at_most("killed_controller_back_s", 3.0, "s", "controller killed: drives again after"),
    at_most("killed_actuator_blind_ms", 300.0, "ms", "actuator killed: wheels without command"),
    at_most("killed_actuator_back_s", 3.0, "s", "actuator killed: drives again after"),
    at_most("killed_orchestrator_unanswered", 0.0, "scans", "orchestrator killed: scans without an answer"),
    at_most("killed_orchestrator_blocks", 0.0, "scans", "orchestrator killed: scans of blocked wheels"),
    at_most("swapped_controller_missed", 0.0, "scans", "controller swapped: scans missed"),
    at_most("swapped_controller_twice", 0.0, "scans", "controller swapped: scans answered twice"),
    at_most("swapped_robot_missed", 0.0, "scans", "robot swapped: scans missed"),
    at_most("swapped_robot_twice", 0.0, "scans", "robot swapped: scans answered twice"),
    at_most("planted_delay_error_ms", 2.0, "ms", "5 ms planted: error of what is found there"),
    at_most("planted_delay_elsewhere_ms", 2.5, "ms", "5 ms planted: found in any other stage"),
    at_most("blind_scanner_stop_s", 1.5, "s", "scanner blinded: robot stands after"),
    at_least("clearance_m", 0.0, "m", "whole drive: smallest distance to any body"),
    at_most("unaccounted_scans", 0.0, "scans", "whole drive: scans that are unaccounted for"),
    at_least("lockstep_topics", 5.0, "topics", "same seed twice: topics with a digest"),
    at_most("lockstep_differences", 0.0, "topics", "same seed twice: topics that differ"),
    at_most("left_behind", 0.0, "items", "processes and shared memory left behind"),
];

/// A promise with what was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Claim {
    /// Its name.
    pub(super) name: &'static str,
    /// What is promised, in words.
    pub(super) text: &'static str,
    /// How the two values are compared.
    pub(super) bound: Bound,
    /// The promised value.
    pub(super) promised: f64,
    /// The measured value; null when it could not be measured.
    pub(super) measured: Option<f64>,
    /// The unit of both.
    pub(super) unit: &'static str,
    /// Whether the measured value keeps the promise.
    pub(super) held: bool,
}

/// The result of a demo.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Claims {
    pub(super) claims: Vec<Claim>,
    /// Whether all held.
    pub(super) held: bool,
}

impl Claims {
    /// The claims that `is_chosen`, with nothing measured yet. `changes` are other promises, `NAME=NUMBER` each.
    ///
    /// # Errors
    /// A name that is unknown, and what is no number; exit code 2.
    pub(super) fn new(is_chosen: impl Fn(&str) -> bool, changes: &[String]) -> anyhow::Result<Self> {
        let of = |promise: &Promise| {
            let Promise { name, text, bound, value, unit } = *promise;
            Claim { name, text, bound, promised: value, measured: None, unit, held: false }
        };
        let mut claims: Vec<Claim> = PROMISES.iter().map(of).collect();
        for change in changes {
            let refuse = |reason: &str| Failure::bad_input(format!("--promise {change}: {reason}"));
            let (name, value) = change.split_once('=').ok_or_else(|| refuse("expected NAME=NUMBER"))?;
            let names = || PROMISES.iter().map(|promise| promise.name).collect::<Vec<_>>().join(", ");
            let claim = claims.iter_mut().find(|claim| claim.name == name);
            let claim = claim.ok_or_else(|| {
                let meant = did_you_mean(name, PROMISES.iter().map(|promise| promise.name));
                let unknown =
                    if meant.is_empty() { ": expected".to_owned() } else { format!(".{meant} Expected") };
                refuse(&format!("{name} is unknown{unknown} one of {}", names()))
            })?;
            let value = value.parse().ok().filter(|value: &f64| value.is_finite());
            claim.promised = value.ok_or_else(|| refuse("expected a number"))?;
        }
        claims.retain(|claim| is_chosen(claim.name));
        Ok(Self { claims, held: false })
    }

    /// Notes a measured value; a claim that was not chosen is left out.
    pub(super) fn measured(&mut self, name: &str, value: f64) {
        debug_assert!(PROMISES.iter().any(|promise| promise.name == name), "{name}");
        if let Some(claim) = self.claims.iter_mut().find(|claim| claim.name == name) {
            claim.measured = Some(value).filter(|value| value.is_finite());
            claim.held = claim.measured.is_some_and(|value| match claim.bound {
                Bound::AtMost => value <= claim.promised,
                Bound::AtLeast => value >= claim.promised,
            });
        }
        self.held = !self.claims.is_empty() && self.claims.iter().all(|claim| claim.held);
    }

    /// The table for a terminal of 80 columns.
    pub(super) fn table(&self) -> String {
        let mut text = format!("{:<TEXT_COLUMNS$} {:>13} {:>11}\n", "promised", "", "measured");
        for claim in &self.claims {
            let (held, bound) = (if claim.held { "held" } else { "NOT HELD" }, claim.promised_text());
            let _ = writeln!(
                text,
                "{:<TEXT_COLUMNS$} {bound:>13} {:>11} {held}",
                claim.text,
                claim.measured_text()
            );
        }
        text
    }
}

impl Claim {
    /// The bound with its unit, as `at most 3 s`.
    pub(super) fn promised_text(&self) -> String {
        let sign = match self.bound {
            Bound::AtMost => "<=",
            Bound::AtLeast => ">=",
        };
        format!("{sign} {}", with_unit(self.promised, self.unit))
    }

    /// Whether it was measured, does not hold, and other programs on the machine may be the reason: they delay answers.
    pub(super) fn may_fail_by_load(&self) -> bool {
        let is_of_time = matches!(self.unit, "ms" | "s" | "scans") && self.name != "unaccounted_scans";
        !self.held && self.measured.is_some() && is_of_time
    }

    /// The measured value with its unit, or a dash.
    pub(super) fn measured_text(&self) -> String {
        self.measured.map_or_else(|| "-".to_owned(), |value| with_unit(value, self.unit))
    }
}

/// Counts as whole numbers, times and distances with as many digits as they deserve.
fn with_unit(value: f64, unit: &str) -> String {
    match unit {
        "scans" | "topics" | "items" if value.fract() == 0.0 => format!("{value:.0} {unit}"),
        "ms" if value.abs() >= 100.0 => format!("{value:.0} {unit}"),
        "ms" => format!("{value:.1} {unit}"),
        _ => format!("{value:.2} {unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claims(changes: &[&str]) -> anyhow::Result<Claims> {
        let changes: Vec<String> = changes.iter().map(ToString::to_string).collect();
        Claims::new(|name| ["clearance_m", "left_behind"].contains(&name), &changes)
    }

    #[test]
    fn all_hold_only_when_each_was_measured_within_its_bound() {
        let mut claims = claims(&[]).unwrap();
        claims.measured("clearance_m", 0.2);
        assert!(!claims.held, "one was not measured");
        claims.measured("left_behind", 0.0);
        assert!(claims.held);
        claims.measured("left_behind", 1.0);
        assert!(!claims.held && !claims.claims[1].held);
        claims.measured("left_behind", f64::NAN);
        assert_eq!((claims.held, claims.claims[1].measured), (false, None));
    }

    #[test]
    fn a_tightened_bound_makes_a_claim_fail() {
        let mut claims = claims(&["clearance_m=0.3"]).unwrap();
        claims.measured("clearance_m", 0.2);
        claims.measured("left_behind", 0.0);
        assert!(!claims.held && !claims.claims[0].held && claims.claims[1].held);
        assert!(claims.table().contains(">= 0.30 m      0.20 m NOT HELD"), "{}", claims.table());
    }

    #[test]
    fn a_busy_machine_is_the_reason_for_late_answers_alone() {
        let mut all = Claims::new(|_| true, &[]).unwrap();
        assert!(!all.claims.iter().any(Claim::may_fail_by_load), "what was not measured has another reason");
        PROMISES.iter().for_each(|promise| {
            all.measured(promise.name, if promise.bound == Bound::AtMost { 1e9 } else { -1.0 })
        });
        let others =
            ["clearance_m", "unaccounted_scans", "lockstep_topics", "lockstep_differences", "left_behind"];
        let of_load = |claim: &&Claim| claim.may_fail_by_load();
        assert!(all.claims.iter().filter(|claim| !of_load(claim)).map(|claim| claim.name).eq(others));
    }

    #[test]
    fn promises_that_are_unknown_or_no_number_are_named() {
        let error = |change| claims(&[change]).unwrap_err().to_string();
        assert!(
            error("speed=1").contains("--promise speed=1: speed is unknown: expected one of answered_scans")
        );
        assert!(
            error("left_behnd=1").contains(
                "left_behnd is unknown. Did you mean `left_behind`? Expected one of answered_scans"
            )
        );
        assert!(error("left_behind=no").contains("expected a number"));
        assert!(error("left_behind").contains("expected NAME=NUMBER"));
    }

    #[test]
    fn no_line_of_the_table_is_wider_than_a_terminal() {
        let mut all = Claims::new(|_| true, &[]).unwrap();
        PROMISES.iter().for_each(|promise| all.measured(promise.name, 1234.0));
        for line in all.table().lines() {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }
}
