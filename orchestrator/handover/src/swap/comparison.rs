//! The outputs of both processes of a swap, compared scan by scan.

use std::collections::BTreeMap;

use super::{
    FIRST_OUTPUT_NS, FORGIVEN_LATE, FORGIVEN_SHARE, HANG_NS, LATE_NS, LOCKSTEP_TIMEOUT_NS, MAX_TOLERANCE,
    Party, RecordedScan, SwapOutput, SwapPlan, WARM_UP, WARM_UP_NS, agreement,
};

/// This many outputs for scans that were answered before are invalid.
const MAX_REPEATS: u32 = 3;
/// Scans whose outputs are kept for comparison.
const PAIRS: usize = 32;

/// The outputs of both processes, and the verdicts so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Comparison {
    pairs: BTreeMap<u64, Pair>,
    /// What is wrong with the first invalid output of the new one.
    pub(super) invalid: Option<String>,
    pub(super) first_new: Option<u64>,
    first_output_ns: u64,
    last_output_ns: u64,
    repeats: u32,
    judged: u32,
    late: u32,
    /// Good scans in a row before the new one is in charge, and the last of them.
    pub(super) good_in_a_row: u64,
    last_good: u64,
    pub(super) good_in_charge: u64,
    last_fault: String,
}

/// The outputs of both for one scan.
#[derive(Debug, Clone, Default)]
struct Pair {
    old: Option<SwapOutput>,
    new: Option<SwapOutput>,
    seen_ns: u64,
    judged: bool,
}

/// The verdict on one scan.
#[derive(Debug, Clone, PartialEq)]
enum Verdict {
    /// It cannot be judged yet.
    Open,
    /// There is nothing to compare with.
    Nothing,
    /// Both agree, in time.
    Good,
    /// Not in time.
    Late(String),
    /// In time, and different.
    Apart(String),
    /// No output that can be used.
    Bad(String),
}

impl Comparison {
    /// Whether both have answered a scan.
    pub(super) fn has_both(&self, scan: u64) -> bool {
        self.pairs.get(&scan).is_some_and(|pair| pair.old.is_some() && pair.new.is_some())
    }

    /// Whether the old one has answered any scan.
    pub(super) fn has_old(&self) -> bool {
        self.pairs.values().any(|pair| pair.old.is_some())
    }

    /// Takes an output in; `newest` is the newest scan that is known to exist.
    pub(super) fn keep(&mut self, now_ns: u64, newest: u64, party: Party, output: SwapOutput) {
        let scan = output.scan;
        if party == Party::New {
            let fault = match &output.content {
                Err(fault) => Some(fault.clone()),
                Ok(_) if scan > newest + PAIRS as u64 => Some("there is no such scan".to_owned()),
                Ok(_) => None,
            };
            if let Some(fault) = fault {
                return self.refuse(scan, &fault);
            }
            self.last_output_ns = self.last_output_ns.max(output.published_ns.min(now_ns));
            if self.first_new.is_none() {
                self.first_new = Some(scan);
                self.first_output_ns = now_ns;
            }
        }
        let pair = self.pairs.entry(scan).or_insert(Pair { seen_ns: now_ns, ..Pair::default() });
        let place = if party == Party::Old { &mut pair.old } else { &mut pair.new };
        if place.is_some() && party == Party::New {
            self.repeats += 1;
            if self.repeats >= MAX_REPEATS {
                return self.refuse(scan, "not the first for that scan");
            }
        }
        place.get_or_insert(output);
        while self.pairs.len() > PAIRS {
            self.pairs.pop_first();
        }
    }

    fn refuse(&mut self, scan: u64, fault: &str) {
        self.invalid.get_or_insert(format!("invalid output for scan {scan}: {fault}"));
    }

    /// Judges all scans that can be judged by now, the oldest first; the new one has to answer those from `from_scan` on,
    /// or none when that is `u64::MAX`.
    ///
    /// # Errors
    /// Why the new one must not take over, or not stay in charge.
    pub(super) fn judge(&mut self, now_ns: u64, plan: &SwapPlan, from_scan: u64) -> Result<(), String> {
        let first_new = self.first_new.unwrap_or(u64::MAX);
        let open = self.pairs.range(first_new..).filter(|(_, pair)| !pair.judged);
        for scan in open.map(|(scan, _)| *scan).collect::<Vec<_>>() {
            let in_charge = (from_scan..u64::MAX).contains(&scan);
            let verdict = self.verdict(now_ns, plan, scan, in_charge);
            let Some(pair) = self.pairs.get_mut(&scan) else { continue };
            pair.judged = verdict != Verdict::Open;
            self.judged += u32::from(pair.judged);
            let has_run_long = plan.lockstep || now_ns.saturating_sub(self.first_output_ns) > WARM_UP_NS;
            let is_warm = in_charge || self.judged > WARM_UP && has_run_long;
            match verdict {
                Verdict::Open | Verdict::Nothing => {}
                Verdict::Good if in_charge => self.good_in_charge += 1,
                Verdict::Good => {
                    self.good_in_a_row = if self.last_good + 1 == scan { self.good_in_a_row + 1 } else { 1 };
                    self.last_good = scan;
                }
                Verdict::Late(reason) | Verdict::Apart(reason) if !is_warm => {
                    self.good_in_a_row = 0;
                    self.last_fault = reason;
                }
                Verdict::Late(reason) => {
                    self.late += 1;
                    self.good_in_a_row = 0;
                    if self.late > FORGIVEN_LATE + self.judged / FORGIVEN_SHARE {
                        return Err(reason);
                    }
                    self.last_fault = reason;
                }
                Verdict::Apart(reason) | Verdict::Bad(reason) => return Err(reason),
            }
        }
        Ok(())
    }

    /// The reason to refuse a process that has not had enough good scans in a row for too long.
    pub(super) fn timed_out(&self, now_ns: u64, plan: &SwapPlan) -> Option<String> {
        let timeout_ns =
            FIRST_OUTPUT_NS.saturating_add(plan.shadow_scans.saturating_mul(10 * plan.period_ns));
        let is_over = !plan.lockstep && now_ns.saturating_sub(self.first_output_ns) > timeout_ns;
        let (scans, timeout_s) = (plan.shadow_scans, timeout_ns / 1_000_000_000);
        is_over.then(|| format!("not {scans} good scans in a row in {timeout_s} s; {}", self.last_fault))
    }

    /// The process whose output a recorded answer is based on, as far as stamps show it.
    pub(super) fn source_of(&self, recorded: &RecordedScan) -> Option<Party> {
        let has_stamp = |output: &Option<SwapOutput>| {
            output.as_ref().is_some_and(|output| output.stamps_ns.contains(&recorded.stamp_ns))
        };
        let pair = self.pairs.get(&recorded.scan).filter(|_| recorded.stamp_ns > 0)?;
        match (has_stamp(&pair.old), has_stamp(&pair.new)) {
            (true, false) => Some(Party::Old),
            (false, true) => Some(Party::New),
            _ => None,
        }
    }

    /// The verdict on a scan; `in_charge` when the new one has to answer it.
    fn verdict(&self, now_ns: u64, plan: &SwapPlan, scan: u64, in_charge: bool) -> Verdict {
        let Some(Pair { old, new, seen_ns, .. }) = self.pairs.get(&scan) else { return Verdict::Open };
        let period_ns = plan.period_ns;
        let passed = |since_ns: u64, span_ns: u64| now_ns.saturating_sub(since_ns) >= span_ns;
        let grace_ns = (period_ns / 5).max(HANG_NS);
        match (old, new) {
            (None, None) => Verdict::Open,
            (Some(_), None) if plan.lockstep => {
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
            // An old one that has stopped answering is no reason to go back to it.
            (None, Some(_)) => {
                let timeout_ns = if plan.lockstep { LOCKSTEP_TIMEOUT_NS } else { 2 * period_ns };
                match now_ns.saturating_sub(*seen_ns) >= timeout_ns {
                    true if in_charge => Verdict::Good,
                    true => Verdict::Nothing,
                    false => Verdict::Open,
                }
            }
            (Some(old), Some(new)) => compare(plan, scan, old, new, in_charge),
        }
    }
}

/// The verdict on two outputs for one scan.
fn compare(plan: &SwapPlan, scan: u64, old: &SwapOutput, new: &SwapOutput, in_charge: bool) -> Verdict {
    let (Ok(expected), Ok(found)) = (&old.content, &new.content) else {
        // Only the old one's output is invalid: nothing to compare with.
        return if in_charge { Verdict::Good } else { Verdict::Nothing };
    };
    let limit_ns = (plan.period_ns / 2).max(LATE_NS);
    let taken_ns = |output: &SwapOutput| output.published_ns.saturating_sub(output.scan_published_ns);
    let judges_time = !plan.lockstep && !in_charge && new.scan_published_ns > 0;
    if judges_time && taken_ns(new) > limit_ns && taken_ns(old) <= limit_ns {
        let [taken_ms, limit_ms] = [taken_ns(new), limit_ns].map(|time| time as f64 * 1e-6);
        return Verdict::Late(format!(
            "late: output for scan {scan} {taken_ms:.1} ms after the scan, allowed are {limit_ms:.1} ms"
        ));
    }
    if plan.tolerance >= MAX_TOLERANCE {
        return Verdict::Good;
    }
    match agreement::disagreement(expected, found, plan.tolerance, &plan.meant) {
        None => Verdict::Good,
        Some(found) => Verdict::Apart(format!("disagreement at scan {scan}: {found}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_based_on_the_output_that_has_its_stamp() {
        let output = |stamps_ns| SwapOutput {
            scan: 7,
            sequence: 1,
            scan_published_ns: 1,
            published_ns: 5,
            compute_ns: 1,
            stamps_ns,
            content: Err(String::new()),
        };
        let pair = Pair { old: Some(output([3, 0])), new: Some(output([4, 0])), ..Pair::default() };
        let comparison = Comparison { pairs: [(7, pair)].into(), ..Comparison::default() };
        let source = |scan, stamp_ns| {
            comparison.source_of(&RecordedScan { scan, answers: 1, desired: [0.0; 2], stamp_ns })
        };
        assert_eq!([source(7, 3), source(7, 4)], [Some(Party::Old), Some(Party::New)]);
        assert_eq!([source(7, 5), source(8, 3), source(7, 0)], [None; 3], "no stamp is none of either");
    }
}
