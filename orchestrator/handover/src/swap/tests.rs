//! Swaps with hand-made events, at 10 Hz: scan k is published at k * 100 ms.

use shared_types::{Authority, Command, CommandKind, Role};

use super::{
    Certificate, FIRST_OUTPUT_NS, Meant, OutputSummary, Party, RUN_ENDS, RecordedScan, Swap, SwapAction,
    SwapEvent, SwapOutcome, SwapOutput, SwapPlan, SwapStage,
};

const PERIOD_NS: u64 = 100_000_000;
const OLD: u32 = 4;
const NEW: u32 = 9;
/// No swap of these tests takes so many scans.
const MANY: u64 = 100;

/// A swap of the controller; both processes behave well unless the test changes that.
struct Trial {
    swap: Swap,
    now_ns: u64,
    scan: u64,
    actions: Vec<SwapAction>,
}

impl Trial {
    /// A trial of five good scans before the change and five after, that begins after scan 10.
    fn new() -> Self {
        Self::with(|_| {})
    }

    fn with(change: impl FnOnce(&mut SwapPlan)) -> Self {
        let mut plan = SwapPlan {
            role: Role::Controller,
            from: "nmpc".to_owned(),
            to: "other".to_owned(),
            old: OLD,
            new: NEW,
            shadow_scans: 5,
            standby_scans: 5,
            tolerance: 1.0,
            meant: Meant::default(),
            period_ns: PERIOD_NS,
            lockstep: false,
            is_acknowledged: true,
        };
        change(&mut plan);
        let now_ns = 10 * PERIOD_NS;
        Self { swap: Swap::new(now_ns, plan), now_ns, scan: 10, actions: Vec::new() }
    }

    fn send(&mut self, event: SwapEvent) {
        let now_ns = self.now_ns;
        self.actions.extend(self.swap.handle(now_ns, event));
    }

    /// The next scan is published; nothing is answered yet.
    fn publish(&mut self) {
        self.scan += 1;
        self.now_ns = self.scan * PERIOD_NS;
        self.send(SwapEvent::Scans { newest: self.scan, answered: self.scan - 1 });
    }

    /// An output for the newest scan, so long after it.
    fn output(&mut self, party: Party, after_ms: u64, content: Result<OutputSummary, String>) {
        self.now_ns = self.now_ns.max(self.scan * PERIOD_NS + after_ms * 1_000_000);
        let output = SwapOutput {
            scan: self.scan,
            sequence: 0,
            scan_published_ns: self.scan * PERIOD_NS,
            published_ns: self.scan * PERIOD_NS + after_ms * 1_000_000,
            compute_ns: 0,
            stamps_ns: [0; 2],
            content,
        };
        self.send(SwapEvent::Output(party, output));
    }

    fn tick_at(&mut self, after_ms: u64) {
        self.now_ns = self.scan * PERIOD_NS + after_ms * 1_000_000;
        self.send(SwapEvent::Tick);
    }

    /// The newest scan is answered and recorded.
    fn record(&mut self) {
        let scan = self.scan;
        self.send(SwapEvent::Scans { newest: scan, answered: scan });
        self.send(SwapEvent::Recorded(RecordedScan { scan, answers: 1, desired: [0.04, 1.0], stamp_ns: 0 }));
    }

    /// A scan on which both agree, in time.
    fn good_scan(&mut self) {
        self.scan_with(command(0.04));
    }

    /// A scan with this output of the new one.
    fn scan_with(&mut self, summary: OutputSummary) {
        self.publish();
        self.output(Party::Old, 2, Ok(command(0.04)));
        self.output(Party::New, 3, Ok(summary));
        self.tick_at(5);
        self.record();
    }

    /// A scan that the new one answers so long after it, as the old one did in time.
    fn late_scan(&mut self, after_ms: u64) {
        self.publish();
        self.output(Party::Old, 2, Ok(command(0.04)));
        self.output(Party::New, after_ms, Ok(command(0.04)));
        self.tick_at(52);
    }

    fn good_scans(&mut self, count: u64) {
        (0..count).for_each(|_| self.good_scan());
    }

    /// Until the new one is in charge of the newest scan.
    fn in_charge(&mut self) {
        self.good_scans(7);
        assert_eq!(self.swap.stage(), SwapStage::Standby);
        assert_eq!(self.actions, [SwapAction::Authorise(authority(NEW, OLD, 17))]);
        assert_eq!((self.scan, self.swap.candidate()), (17, OLD));
        self.actions.clear();
    }

    fn certificate(&self) -> &Certificate {
        match self.actions.last() {
            Some(SwapAction::Finish(certificate)) => certificate,
            other => panic!("no certificate: {other:?}"),
        }
    }

    fn refused(&self) -> &str {
        assert_eq!(self.actions[0], SwapAction::KillNew);
        let certificate = self.certificate();
        assert_eq!((certificate.outcome, self.swap.stage()), (SwapOutcome::Refused, SwapStage::Over));
        assert_eq!((certificate.last_scan_old, certificate.first_scan_new), (None, None));
        &certificate.reason
    }

    /// That authority went back from `from_scan` on, at once.
    fn rolled_back(&mut self, from_scan: u64) -> Certificate {
        assert_eq!(
            self.actions,
            [SwapAction::Authorise(authority(OLD, NEW, from_scan)), SwapAction::KillNew]
        );
        assert_eq!(self.swap.candidate(), NEW);
        // It was killed, which is not another failure.
        self.send(SwapEvent::Exited(Party::New, "killed by signal 9 (SIGKILL)".to_owned()));
        assert_eq!(self.actions.len(), 2);
        while self.swap.stage() == SwapStage::Settling {
            assert!(self.scan < MANY, "it settles");
            self.publish();
            self.output(Party::Old, 2, Ok(command(0.04)));
            self.record();
            self.send(SwapEvent::Tick);
        }
        assert_eq!(self.actions[2], SwapAction::Authorise(authority(OLD, 0, 0)));
        let certificate = self.certificate().clone();
        assert_eq!(certificate.outcome, SwapOutcome::RolledBack);
        certificate
    }
}

fn command(steering_rad: f64) -> OutputSummary {
    let kind = CommandKind::Drive.wire();
    OutputSummary::from(&Command { kind, velocity_mps: 1.0, steering_rad, ..Command::default() })
}

fn authority(incarnation: u32, previous: u32, from_scan: u64) -> Authority {
    Authority { incarnation, previous, from_scan }
}

#[test]
fn a_good_process_takes_over_and_the_old_one_ends_after_its_standby() {
    let mut trial = Trial::new();
    trial.good_scan();
    assert_eq!((trial.swap.stage(), trial.swap.candidate()), (SwapStage::Shadowing, NEW));
    trial.good_scans(4);
    // Five good scans from 11 to 15, so 17 is the first scan that is not published soon.
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, 17))]);
    trial.good_scans(6);
    assert_eq!(trial.actions[1..], [SwapAction::Authorise(authority(NEW, 0, 0)), SwapAction::Commit]);
    trial.good_scan();
    let expected = Certificate {
        role: "controller".to_owned(),
        from: "nmpc".to_owned(),
        to: "other".to_owned(),
        shadow_scans: 5,
        last_scan_old: Some(16),
        first_scan_new: Some(17),
        outcome: SwapOutcome::Swapped,
        ..Certificate::default()
    };
    assert_eq!(trial.certificate(), &expected);
    let text = expected.to_string();
    assert_eq!(
        text,
        "controller: other has taken over from nmpc at scan 17; 0 scans missed, 0 answered twice"
    );
}

#[test]
fn a_default_swap_has_its_certificate_within_three_seconds() {
    let mut trial = Trial::with(|plan| (plan.shadow_scans, plan.standby_scans) = (10, 10));
    // Half a second for the start of the process.
    for _ in 0..5 {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        trial.record();
    }
    while trial.swap.stage() != SwapStage::Over && trial.scan < MANY {
        trial.good_scan();
    }
    assert!(trial.scan - 10 <= 28, "{} scans", trial.scan - 10);
}

#[test]
fn a_process_without_output_is_refused_after_three_seconds() {
    for old_answers in [true, false] {
        let mut trial = Trial::new();
        let started_ns = trial.now_ns;
        if old_answers {
            trial.publish();
            trial.output(Party::Old, 2, Ok(command(0.04)));
        }
        trial.now_ns = started_ns + FIRST_OUTPUT_NS - 1;
        trial.send(SwapEvent::Tick);
        assert!(trial.actions.is_empty());
        trial.now_ns += 1;
        trial.send(SwapEvent::Tick);
        let cause =
            if old_answers { "" } else { "; the old process had none either: valid inputs do not come" };
        assert_eq!(trial.refused(), format!("no output within 3 s{cause}"));
    }
}

#[test]
fn a_process_that_ends_is_refused_with_the_reason() {
    let mut trial = Trial::new();
    trial.good_scans(2);
    trial.send(SwapEvent::Exited(Party::New, "exit code 101: panicked".to_owned()));
    assert_eq!(trial.refused(), "the new process ended: exit code 101: panicked");
    let mut trial = Trial::new();
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    assert_eq!(trial.refused(), "the old process ended: exit code 1");
}

#[test]
fn an_invalid_output_is_refused_at_once() {
    let mut trial = Trial::new();
    trial.publish();
    trial.output(Party::New, 3, Err("command is not finite".to_owned()));
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.refused(), "invalid output for scan 11: command is not finite");
    let mut trial = Trial::new();
    trial.publish();
    trial.scan = u64::MAX;
    let output = SwapOutput {
        scan: u64::MAX,
        sequence: 0,
        scan_published_ns: 0,
        published_ns: 0,
        compute_ns: 0,
        stamps_ns: [0; 2],
        content: Ok(command(0.04)),
    };
    trial.send(SwapEvent::Output(Party::New, output));
    trial.send(SwapEvent::Tick);
    assert!(trial.refused().ends_with("there is no such scan"), "{}", trial.refused());
}

#[test]
fn a_disagreement_is_forgiven_while_the_process_warms_up_and_not_later() {
    let mut trial = Trial::new();
    for _ in 0..5 {
        trial.scan_with(command(0.048));
    }
    trial.good_scans(4);
    assert_eq!(trial.swap.stage(), SwapStage::Shadowing, "the good scans count from the last bad one on");
    assert!(trial.actions.is_empty());
    trial.scan_with(command(0.048));
    assert_eq!(
        trial.refused(),
        "disagreement at scan 20: steering angle differs by 0.0080 rad, allowed are 0.0060 rad"
    );
    let mut trial = Trial::with(|plan| plan.tolerance = 2.0);
    (0..7).for_each(|_| trial.scan_with(command(0.048)));
    assert_eq!(trial.swap.stage(), SwapStage::Standby, "twice the bounds");
}

#[test]
fn two_late_outputs_are_forgiven_and_the_third_is_not() {
    let warm = || {
        let mut trial = Trial::with(|plan| plan.shadow_scans = 10);
        trial.good_scans(5);
        trial
    };
    let mut trial = warm();
    for _ in 0..3 {
        assert!(trial.actions.is_empty());
        trial.late_scan(51);
    }
    assert_eq!(trial.refused(), "late: output for scan 18 51.0 ms after the scan, allowed are 50.0 ms");
    let mut trial = warm();
    for _ in 0..3 {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        trial.tick_at(99);
        assert!(trial.actions.is_empty());
        trial.tick_at(100);
    }
    assert_eq!(trial.refused(), "late: no output for scan 18 within a period");
}

#[test]
fn one_more_late_output_is_forgiven_per_ten_scans() {
    let mut trial = Trial::with(|plan| plan.shadow_scans = 60);
    trial.good_scans(25);
    for late in 1..=5 {
        assert!(trial.actions.is_empty(), "{late}");
        // At the limit it is in time.
        trial.late_scan(if late == 1 { 50 } else { 51 });
    }
    // Four late ones of thirty scans: two and one per ten.
    assert!(trial.actions.is_empty());
    trial.good_scans(5);
    for _ in 0..2 {
        trial.late_scan(51);
    }
    assert!(trial.refused().starts_with("late: output for scan 47"), "{}", trial.refused());
}

#[test]
fn at_high_rates_an_output_is_missed_after_twice_the_time_of_a_late_one() {
    let mut trial = Trial::with(|plan| (plan.period_ns, plan.shadow_scans) = (4_000_000, 40));
    trial.good_scans(5);
    for _ in 0..3 {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        trial.tick_at(5);
        assert!(trial.actions.is_empty());
        trial.tick_at(6);
    }
    assert_eq!(trial.refused(), "late: no output for scan 18 within a period");
}

#[test]
fn an_output_that_names_no_time_of_its_scan_is_not_late() {
    let mut trial = Trial::with(|plan| plan.shadow_scans = 20);
    trial.good_scans(5);
    for _ in 0..10 {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        let (scan, published_ns) = (trial.scan, trial.now_ns + 60_000_000);
        let output = SwapOutput { scan, published_ns, ..untimed() };
        trial.send(SwapEvent::Output(Party::New, output));
        trial.tick_at(65);
    }
    assert!(trial.actions.is_empty(), "{:?}", trial.actions);
}

/// An output that tells nothing of time.
fn untimed() -> SwapOutput {
    SwapOutput {
        scan: 0,
        sequence: 0,
        scan_published_ns: 0,
        published_ns: 0,
        compute_ns: 0,
        stamps_ns: [0; 2],
        content: Ok(command(0.04)),
    }
}

#[test]
fn a_process_that_answers_scans_that_the_old_one_does_not_has_no_good_scan() {
    let mut trial = Trial::new();
    // Within the warm-up, and the last fault that is known.
    trial.scan_with(command(0.048));
    let began_ns = trial.now_ns;
    while trial.now_ns + PERIOD_NS < began_ns + 8_000_000_000 {
        trial.publish();
        trial.output(Party::New, 1, Ok(command(0.04)));
        trial.send(SwapEvent::Tick);
        assert_eq!((trial.swap.stage(), trial.actions.len()), (SwapStage::Shadowing, 0));
    }
    // Three seconds and ten times the five scans, after its first output 3 ms after scan 11.
    trial.now_ns = 11 * PERIOD_NS + 3_000_000 + 8_000_000_000;
    trial.send(SwapEvent::Tick);
    assert!(trial.actions.is_empty());
    trial.now_ns += 1;
    trial.send(SwapEvent::Tick);
    let reason = trial.refused();
    assert!(reason.starts_with("not 5 good scans in a row in 8 s; disagreement at scan 11"), "{reason}");
    // In lock-step the clock of the machine says nothing.
    let mut trial = Trial::with(|plan| plan.lockstep = true);
    trial.publish();
    trial.output(Party::New, 3, Ok(command(0.04)));
    trial.now_ns += 100_000_000_000;
    trial.send(SwapEvent::Tick);
    assert!(trial.actions.is_empty());
}

#[test]
fn an_old_one_that_stops_answering_does_not_hold_up_the_end_of_its_standby() {
    let mut trial = Trial::new();
    trial.in_charge();
    for _ in 0..5 {
        trial.publish();
        trial.output(Party::New, 3, Ok(command(0.04)));
        trial.tick_at(3);
        trial.record();
    }
    // The fifth, scan 21, is good two periods after its output.
    trial.now_ns = 23 * PERIOD_NS + 2_000_000;
    trial.send(SwapEvent::Tick);
    assert!(trial.actions.is_empty());
    trial.now_ns += 1_000_000;
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.actions[1], SwapAction::Commit);
}

#[test]
fn the_third_repeated_output_is_invalid() {
    let mut trial = Trial::new();
    trial.publish();
    for _ in 0..4 {
        trial.output(Party::Old, 2, Ok(command(0.04)));
    }
    for _ in 0..3 {
        trial.output(Party::New, 3, Ok(command(0.04)));
    }
    trial.send(SwapEvent::Tick);
    assert!(trial.actions.is_empty());
    trial.output(Party::New, 3, Ok(command(0.04)));
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.refused(), "invalid output for scan 11: not the first for that scan");
}

#[test]
fn an_output_may_be_newer_than_the_newest_scan_that_is_known_by_as_many_as_are_kept() {
    for (scan, is_known) in [(11 + 32, true), (11 + 33, false)] {
        let mut trial = Trial::new();
        trial.publish();
        trial.send(SwapEvent::Output(Party::New, SwapOutput { scan, ..untimed() }));
        trial.send(SwapEvent::Tick);
        assert_eq!(trial.actions.is_empty(), is_known, "{scan}");
    }
}

#[test]
fn stamps_show_which_process_a_scan_was_answered_with() {
    let mut trial = Trial::new();
    trial.in_charge();
    // The change was planned at 17; the record of 18 and 19 says something else.
    for (old, new, recorded) in [(181, 182, 181), (191, 192, 192)] {
        trial.publish();
        for (party, stamp_ns) in [(Party::Old, old), (Party::New, new)] {
            let times = (trial.now_ns, trial.now_ns + 1);
            let output = SwapOutput {
                scan: trial.scan,
                scan_published_ns: times.0,
                published_ns: times.1,
                stamps_ns: [7, stamp_ns],
                ..untimed()
            };
            trial.send(SwapEvent::Output(party, output));
        }
        trial.send(SwapEvent::Tick);
        let record = RecordedScan { scan: trial.scan, answers: 1, desired: [0.04, 1.0], stamp_ns: recorded };
        trial.send(SwapEvent::Scans { newest: trial.scan, answered: trial.scan });
        trial.send(SwapEvent::Recorded(record));
    }
    trial.good_scans(6);
    let certificate = trial.certificate();
    assert_eq!((certificate.first_scan_new, certificate.first_scan_back), (Some(17), Some(18)));
    assert_eq!(certificate.outcome, SwapOutcome::Swapped);
}

#[test]
fn a_scan_is_not_judged_when_the_cause_lies_in_an_earlier_stage() {
    let mut trial = Trial::new();
    trial.good_scan();
    for _ in 0..5 {
        // Both late, or none of them there: the estimator is slow or gone.
        trial.publish();
        trial.output(Party::Old, 60, Ok(command(0.04)));
        trial.output(Party::New, 61, Ok(command(0.04)));
        trial.tick_at(62);
        trial.publish();
        trial.tick_at(99);
    }
    assert!(trial.actions.is_empty());
    assert_eq!(trial.swap.stage(), SwapStage::Shadowing);
}

#[test]
fn a_death_in_charge_is_rolled_back_from_the_first_open_scan_on() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.publish();
    trial.send(SwapEvent::Exited(Party::New, "killed by signal 9 (SIGKILL)".to_owned()));
    // Scan 17 was answered, 18 was just published.
    let certificate = trial.rolled_back(18);
    assert_eq!(certificate.reason, "the new process ended: killed by signal 9 (SIGKILL)");
    assert_eq!((certificate.missed_scans, certificate.first_scan_new), (0, Some(17)));
    // Its first scan is the newest one.
    let mut trial = Trial::new();
    trial.in_charge();
    trial.send(SwapEvent::Exited(Party::New, "exit code 1".to_owned()));
    assert_eq!(trial.rolled_back(18).first_scan_new, Some(17));
}

#[test]
fn a_process_that_hangs_in_charge_is_rolled_back_before_the_actuator_blocks() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.publish();
    trial.output(Party::Old, 2, Ok(command(0.04)));
    // The last output was 3 ms after the scan before.
    trial.tick_at(22);
    assert!(trial.actions.is_empty());
    trial.tick_at(23);
    let certificate = trial.rolled_back(18);
    assert_eq!(certificate.reason, "hangs: no output for scan 18, 1.2 periods after the last one");
}

#[test]
fn a_scanner_that_pauses_while_the_new_one_is_in_charge_is_no_hang_of_it() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.scan += 4;
    trial.publish();
    // Five periods after the last output; the time to answer this scan has just begun.
    trial.output(Party::Old, 2, Ok(command(0.04)));
    trial.tick_at(19);
    assert!(trial.actions.is_empty(), "{:?}", trial.actions);
    trial.tick_at(20);
    assert!(trial.rolled_back(22).reason.starts_with("hangs: no output for scan 22"));
}

#[test]
fn a_swap_whose_scans_are_not_recorded_is_over_two_seconds_after_its_decision() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    let decided_ns = trial.now_ns;
    trial.now_ns = decided_ns + 1_999_999_999;
    trial.send(SwapEvent::Tick);
    assert_eq!((trial.swap.stage(), trial.actions.len()), (SwapStage::Settling, 2));
    trial.now_ns += 1;
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Swapped);
}

#[test]
fn an_invalid_or_different_output_in_charge_is_rolled_back() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.publish();
    trial.output(Party::New, 3, Err("command is not finite".to_owned()));
    trial.tick_at(4);
    assert_eq!(trial.rolled_back(18).reason, "invalid output for scan 18: command is not finite");
    let mut trial = Trial::new();
    trial.in_charge();
    trial.publish();
    trial.output(Party::Old, 2, Ok(command(0.04)));
    trial.output(Party::New, 3, Ok(command(0.048)));
    trial.tick_at(5);
    assert!(trial.rolled_back(18).reason.starts_with("disagreement at scan 18"));
}

#[test]
fn a_process_that_fails_before_its_first_scan_is_refused() {
    let mut trial = Trial::new();
    trial.good_scans(5);
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, 17))]);
    trial.send(SwapEvent::Exited(Party::New, "exit code 1".to_owned()));
    assert_eq!(trial.actions[1..3], [SwapAction::Authorise(authority(OLD, 0, 0)), SwapAction::KillNew]);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Refused);
}

#[test]
fn the_new_one_stays_when_the_old_one_ends_during_its_standby() {
    let mut trial = Trial::new();
    trial.in_charge();
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, 17)), SwapAction::Commit]);
    trial.good_scans(3);
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.actions[2], SwapAction::Authorise(authority(NEW, 0, 0)));
    let certificate = trial.certificate();
    assert_eq!((certificate.outcome, certificate.first_scan_new), (SwapOutcome::Swapped, Some(17)));
    // All scans that the certificate covers are recorded already.
    let mut trial = Trial::new();
    trial.in_charge();
    trial.good_scans(3);
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Swapped);
}

#[test]
fn at_a_scan_a_second_scans_are_waited_for_five_periods() {
    let mut trial = Trial::with(|plan| plan.period_ns = 1_000_000_000);
    trial.in_charge();
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    trial.now_ns += 4_999_999_999;
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.swap.stage(), SwapStage::Settling);
    trial.now_ns += 1;
    trial.send(SwapEvent::Tick);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Swapped);
}

#[test]
fn the_new_one_answers_earlier_when_the_old_one_ends_before_the_change() {
    let mut trial = Trial::new();
    trial.good_scans(5);
    trial.actions.clear();
    trial.publish();
    trial.send(SwapEvent::Exited(Party::Old, "exit code 1".to_owned()));
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, 16)), SwapAction::Commit]);
    assert_eq!(trial.swap.candidate(), OLD);
    trial.record();
    // The certificate covers three scans after the change.
    trial.good_scans(3);
    assert_eq!((trial.scan, trial.swap.stage()), (19, SwapStage::Settling));
    trial.send(SwapEvent::Tick);
    let certificate = trial.certificate();
    assert_eq!((certificate.last_scan_old, certificate.first_scan_new), (Some(15), Some(16)));
    assert_eq!(certificate.outcome, SwapOutcome::Swapped);
}

#[test]
fn in_lock_step_stamps_do_not_matter_and_a_hang_is_one_of_the_machines_time() {
    let mut trial = Trial::with(|plan| plan.lockstep = true);
    for _ in 0..7 {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        trial.output(Party::New, 90, Ok(command(0.04)));
        assert!(trial.swap.both_answered(trial.scan));
        trial.tick_at(90);
        trial.record();
    }
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, 17))]);
    trial.actions.clear();
    trial.publish();
    trial.output(Party::Old, 2, Ok(command(0.04)));
    assert!(!trial.swap.both_answered(trial.scan));
    trial.tick_at(501);
    assert!(trial.actions.is_empty());
    trial.tick_at(502);
    assert_eq!(trial.rolled_back(18).reason, "hangs: no output for scan 18 within 0.5 s");
}

#[test]
fn the_end_of_the_run_ends_a_swap_in_favour_of_the_process_in_charge() {
    let mut trial = Trial::new();
    trial.good_scans(2);
    trial.send(SwapEvent::RunEnds);
    assert_eq!(trial.refused(), RUN_ENDS);
    // Authority goes to it from a scan on that is not there.
    let mut trial = Trial::new();
    trial.good_scans(5);
    trial.send(SwapEvent::RunEnds);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Refused);
    let mut trial = Trial::new();
    trial.in_charge();
    trial.send(SwapEvent::RunEnds);
    assert_eq!(trial.actions[..2], [SwapAction::Authorise(authority(NEW, 0, 0)), SwapAction::Commit]);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Swapped);
    trial.send(SwapEvent::RunEnds);
    assert_eq!(trial.actions.len(), 3, "once");
}

#[test]
fn the_certificate_counts_answers_and_measures_the_jump_around_the_change_only() {
    let mut trial = Trial::new();
    // Scans 11 to 15, the change at 17; then 0.01 rad and 0.2 m/s between 16 and 17, and 0.5 rad far from it.
    let desired = |scan: u64| match scan {
        11 => [0.5, 1.0],
        12..=16 => [0.0, 1.0],
        17..=21 => [0.01, 1.2],
        _ => [0.5, 1.2],
    };
    while trial.swap.stage() != SwapStage::Over && trial.scan < MANY {
        trial.publish();
        trial.output(Party::Old, 2, Ok(command(0.04)));
        trial.output(Party::New, 3, Ok(command(0.04)));
        trial.tick_at(5);
        let scan = trial.scan;
        let answers = [(13, 0), (19, 2)].iter().find(|(at, _)| *at == scan).map_or(1, |(_, count)| *count);
        trial.send(SwapEvent::Recorded(RecordedScan { scan, answers, desired: desired(scan), stamp_ns: 0 }));
    }
    let certificate = trial.certificate();
    assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (1, 1));
    assert!((certificate.command_jump_rad - 0.01).abs() < 1e-12);
    assert!((certificate.command_jump_mps - 0.2).abs() < 1e-12);
}

#[test]
fn across_hosts_the_new_one_is_announced_before_it_takes_over() {
    let mut trial = Trial::with(|plan| plan.is_acknowledged = false);
    trial.send(SwapEvent::Acknowledged);
    trial.good_scans(6);
    // An acknowledgement of something before does not count.
    assert_eq!(trial.actions, [SwapAction::Authorise(authority(NEW, OLD, u64::MAX))]);
    assert_eq!((trial.swap.stage(), trial.swap.candidate()), (SwapStage::Shadowing, NEW));
    trial.send(SwapEvent::Acknowledged);
    trial.good_scan();
    assert_eq!(trial.actions[1..], [SwapAction::Authorise(authority(NEW, OLD, 19))]);
    trial.good_scans(8);
    assert_eq!(trial.actions[3], SwapAction::Commit);
    // A long standby is not taken for a handover that was not acknowledged.
    let mut trial = Trial::with(|plan| (plan.is_acknowledged, plan.standby_scans) = (false, 40));
    trial.good_scans(5);
    trial.send(SwapEvent::Acknowledged);
    trial.good_scans(43);
    assert_eq!(trial.certificate().outcome, SwapOutcome::Swapped);
}

#[test]
fn without_an_acknowledgement_the_new_one_is_refused() {
    let mut trial = Trial::with(|plan| plan.is_acknowledged = false);
    trial.good_scans(5 + 29);
    assert_eq!(trial.actions.len(), 1, "{:?}", trial.actions);
    trial.good_scans(2);
    assert_eq!(trial.actions[1..3], [SwapAction::Authorise(authority(OLD, 0, 0)), SwapAction::KillNew]);
    let certificate = trial.certificate();
    assert_eq!(certificate.outcome, SwapOutcome::Refused);
    assert_eq!(certificate.reason, "a host has not acknowledged the handover within 3 s");
}
