//! The limits of a run in real time by the clock of this computer.
//!
//! The referee counts the stamps of scans. A robot that sends none, or whose stamps stand still or run backwards, would
//! never end its run. So the same limits hold for the time that has passed here, a little later: where stamps count on,
//! they decide. Time in which this process itself stood still does not count, as nothing could be received in it.

use emulator::Scenario;
use report::Outcome;

/// The referee, which counts stamps, is given this much more time, and two periods [ns].
const GRACE_NS: u64 = 1_000_000_000;
/// A turn of the loop that takes longer is one in which this process stood still [ns].
const MAX_TURN_NS: u64 = 200_000_000;
/// A pause that is told as the cause of a stop [s].
const STOOD_STILL_S: f64 = 1.0;

/// Time since a run drives, and since its wheels have been blocked.
#[derive(Debug, Clone)]
pub(super) struct RunLimits {
    timeout_s: f64,
    stop_final_s: f64,
    duration_s: Option<f64>,
    grace_ns: u64,
    /// When the time was counted last [ns].
    counted_ns: Option<u64>,
    /// Time that the run has driven [ns].
    driven_ns: u64,
    /// That time when a scan was judged last, and when the wheels turned last; `None` before the first scan.
    judged_ns: Option<u64>,
    turned_ns: u64,
    /// The longest time for which this process stood still since then [ns].
    stood_still_ns: u64,
}

impl RunLimits {
    pub(super) fn new(scenario: &Scenario, duration_s: Option<f64>, period_ns: u64) -> Self {
        Self {
            timeout_s: scenario.timeout_s,
            stop_final_s: scenario.stop_final_s,
            duration_s,
            grace_ns: GRACE_NS + 2 * period_ns,
            counted_ns: None,
            driven_ns: 0,
            judged_ns: None,
            turned_ns: 0,
            stood_still_ns: 0,
        }
    }

    /// A scan was judged: whether the wheels have been blocked since the one before.
    pub(super) fn judged(&mut self, is_blocked: bool) {
        // The way of blocked wheels begins with the first scan.
        if self.judged_ns.is_none() || !is_blocked {
            (self.turned_ns, self.stood_still_ns) = (self.driven_ns, 0);
        }
        self.judged_ns = Some(self.driven_ns);
    }

    /// For how long this process stood still since the wheels turned, if that is why they are blocked [s].
    pub(super) fn stood_still_s(&self, now_ns: u64) -> Option<f64> {
        let pause_ns = self.counted_ns.map_or(0, |counted_ns| now_ns.saturating_sub(counted_ns));
        Some(self.stood_still_ns.max(pause_ns) as f64 * 1e-9).filter(|pause_s| *pause_s >= STOOD_STILL_S)
    }

    /// In this turn of the loop the controller does not drive: no limit counts.
    pub(super) fn hold(&mut self, now_ns: u64) {
        self.counted_ns = Some(now_ns);
        self.turned_ns = self.driven_ns;
        self.judged_ns = self.judged_ns.map(|_| self.driven_ns);
    }

    /// How the run ends and why, if a limit is over; call it in each turn of the loop while the system drives.
    pub(super) fn count(&mut self, now_ns: u64) -> Option<(Outcome, String)> {
        let passed_ns = self.counted_ns.map_or(0, |counted_ns| now_ns.saturating_sub(counted_ns));
        self.counted_ns = Some(now_ns);
        self.stood_still_ns = self.stood_still_ns.max(passed_ns);
        self.driven_ns += passed_ns.min(MAX_TURN_NS);
        let is_over = |since_ns: u64, limit_s: f64| {
            (self.driven_ns - since_ns).saturating_sub(self.grace_ns) as f64 * 1e-9 >= limit_s
        };
        if self.duration_s.is_some_and(|duration_s| is_over(0, duration_s)) {
            return Some((Outcome::Timeout, "the duration asked for is over".to_owned()));
        }
        let stop_final_s = self.stop_final_s;
        if let Some(judged_ns) = self.judged_ns.filter(|_| is_over(self.turned_ns, stop_final_s)) {
            let what = match is_over(judged_ns, stop_final_s) {
                true => "no scan comes",
                false => "the stamps of its scans do not count on",
            };
            return Some((Outcome::Stopped, format!("wheels blocked for {stop_final_s} s: {what}")));
        }
        is_over(0, self.timeout_s).then(|| {
            let what = match self.judged_ns {
                None => "no scan has come",
                Some(_) => "the stamps of the scans have counted less",
            };
            (Outcome::Timeout, format!("{} s are over, and {what}", self.timeout_s))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;

    fn limits(duration_s: Option<f64>) -> RunLimits {
        let scenario: Scenario = toml::from_str("timeout_s = 20.0\nstop_final_s = 5.0").unwrap();
        RunLimits::new(&scenario, duration_s, PERIOD_NS)
    }

    /// Turns of the loop, each of 0.1 s; `scan` tells whether one is judged and whether its wheels are blocked. The
    /// tenth of a second in which the run ends, and how.
    fn end(mut limits: RunLimits, scan: impl Fn(u64) -> Option<bool>) -> (u64, Outcome, String) {
        (0..1000)
            .find_map(|turn| {
                scan(turn).into_iter().for_each(|is_blocked| limits.judged(is_blocked));
                let (outcome, reason) = limits.count(turn * PERIOD_NS)?;
                Some((turn, outcome, reason))
            })
            .unwrap()
    }

    #[test]
    fn a_robot_that_sends_no_scan_times_out_and_one_that_falls_silent_is_stopped() {
        let (turn, outcome, reason) = end(limits(None), |_| None);
        assert_eq!(
            (turn, outcome, reason.as_str()),
            (212, Outcome::Timeout, "20 s are over, and no scan has come")
        );
        let (turn, outcome, reason) = end(limits(None), |turn| (turn <= 30).then_some(false));
        let expected = (30 - 1 + 62, Outcome::Stopped, "wheels blocked for 5 s: no scan comes");
        assert_eq!((turn, outcome, reason.as_str()), expected);
    }

    #[test]
    fn scans_whose_stamps_do_not_count_on_end_a_run() {
        let (turn, outcome, reason) = end(limits(None), |turn| Some(turn > 30));
        let expected = (
            30 - 1 + 62,
            Outcome::Stopped,
            "wheels blocked for 5 s: the stamps of its scans do not count on",
        );
        assert_eq!((turn, outcome, reason.as_str()), expected);
        // The wheels turn now and then.
        let (turn, outcome, _) = end(limits(None), |turn| Some(!turn.is_multiple_of(20)));
        assert_eq!((turn, outcome), (212, Outcome::Timeout));
        let (turn, outcome, _) = end(limits(Some(3.0)), |_| Some(false));
        assert_eq!((turn, outcome), (42, Outcome::Timeout));
    }

    #[test]
    fn time_in_which_this_process_stood_still_does_not_count() {
        let mut limits = limits(None);
        limits.judged(false);
        assert_eq!(limits.count(0), None);
        assert_eq!(limits.count(45_000_000_000), None);
        assert_eq!(limits.count(90_000_000_000), None);
        limits.judged(true);
        assert_eq!(limits.stood_still_s(90_000_000_000), Some(45.0));
        limits.judged(false);
        assert_eq!(limits.stood_still_s(90_000_000_000), None, "the wheels turn again");
        assert_eq!(limits.stood_still_s(92_000_000_000), Some(2.0));
    }
}
