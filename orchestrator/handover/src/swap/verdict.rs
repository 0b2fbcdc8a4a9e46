//! What is to be said of one scan of an exchange, now that both outputs are there, or one of them, or none.

use super::{HANG_NS, LATE_NS, LOCKSTEP_TIMEOUT_NS, MAX_TOLERANCE, Output, Pair, Swap, agreement};

/// What is to be said of one scan.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// It cannot be judged yet.
    Open,
    /// There is nothing to compare with.
    Nothing,
    /// All is as it should be.
    Good,
    /// Not in time.
    Late(String),
    /// In time, and different.
    Apart(String),
    /// Not to be used.
    Bad(String),
}

impl Swap {
    /// What is to be said of a scan; `in_charge` when the new one has to answer it.
    pub(super) fn verdict(&self, now_ns: u64, scan: u64, in_charge: bool) -> Verdict {
        let Some(Pair { old, new, seen_ns, .. }) = self.pairs.get(&scan) else { return Verdict::Open };
        let period_ns = self.plan.period_ns;
        let passed = |since_ns: u64, span_ns: u64| now_ns.saturating_sub(since_ns) >= span_ns;
        let grace_ns = (period_ns / 5).max(HANG_NS);
        match (old, new) {
            (None, None) => Verdict::Open,
            (Some(_), None) if self.plan.lockstep => {
                if now_ns.saturating_sub(*seen_ns) < LOCKSTEP_TIMEOUT_NS {
                    return Verdict::Open;
                }
                let timeout_s = LOCKSTEP_TIMEOUT_NS as f64 * 1e-9;
                Verdict::Bad(format!("hangs: no output for scan {scan} within {timeout_s} s"))
            }
            (Some(old), None) => {
                let since_ns = if old.scan_published_ns == 0 { *seen_ns } else { old.scan_published_ns };
                if in_charge
                    && passed(self.last_output_ns, period_ns + grace_ns)
                    && passed(since_ns, grace_ns)
                {
                    let periods = (period_ns + grace_ns) as f64 / period_ns as f64;
                    Verdict::Bad(format!(
                        "hangs: no output for scan {scan}, {periods:.1} periods after the last one"
                    ))
                } else if !in_charge && passed(since_ns, period_ns.max(2 * LATE_NS)) {
                    Verdict::Late(format!("late: no output for scan {scan} within a period"))
                } else {
                    Verdict::Open
                }
            }
            // An old one that has stopped to answer is no reason to keep it.
            (None, Some(_)) => {
                let timeout_ns = if self.plan.lockstep { LOCKSTEP_TIMEOUT_NS } else { 2 * period_ns };
                match now_ns.saturating_sub(*seen_ns) >= timeout_ns {
                    true if in_charge => Verdict::Good,
                    true => Verdict::Nothing,
                    false => Verdict::Open,
                }
            }
            (Some(old), Some(new)) => self.compare(scan, old, new, in_charge),
        }
    }

    fn compare(&self, scan: u64, old: &Output, new: &Output, in_charge: bool) -> Verdict {
        let (Ok(expected), Ok(found)) = (&old.content, &new.content) else {
            // Only the old one's output is invalid: nothing to compare with.
            return if in_charge { Verdict::Good } else { Verdict::Nothing };
        };
        let limit_ns = (self.plan.period_ns / 2).max(LATE_NS);
        let taken_ns = |output: &Output| output.published_ns.saturating_sub(output.scan_published_ns);
        let judges_time = !self.plan.lockstep && !in_charge && new.scan_published_ns > 0;
        if judges_time && taken_ns(new) > limit_ns && taken_ns(old) <= limit_ns {
            let [taken_ms, limit_ms] = [taken_ns(new), limit_ns].map(|time| time as f64 * 1e-6);
            return Verdict::Late(format!(
                "late: output for scan {scan} {taken_ms:.1} ms after the scan, allowed are {limit_ms:.1} ms"
            ));
        }
        if self.plan.tolerance >= MAX_TOLERANCE {
            return Verdict::Good;
        }
        match agreement::disagreement(expected, found, self.plan.tolerance) {
            None => Verdict::Good,
            Some(found) => Verdict::Apart(format!("disagreement at scan {scan}: {found}")),
        }
    }
}
