//! The judgement of a trial: a sentence for each fault. Pure.

use emulator::Outcome;

use super::evidence::{DriveEvidence, OrchestratorOutage, TrialEvidence};
use super::plan::{StderrTarget, TrialPlan};
use super::program::Ended;
use super::wheels::{WheelsState, state_at};

/// Additional time for the start and the end of a command on a busy machine [ns].
const BUSY_NS: u64 = 1_000_000_000;
/// Wheels that were blocked at 2 m/s rest after v / a [ns].
const SLIDE_NS: u64 = 400_000_000;
/// A process that is awake gets a processor within this time [ns].
const SCHEDULED_NS: u64 = 500_000_000;
/// Wheels never turn for longer than this many scan periods without an actuation.
const BLIND_PERIODS: f64 = 3.0;
/// Exit codes that an orchestrator may end with: all but those of a collision and of an internal error.
const CODES: [i32; 4] = [0, 1, 2, 4];
/// Exit codes and signals of a panic, of a fault of the processor and of an abort.
const CRASHES: [i32; 4] = [4, 6, 7, 11];
/// SIGKILL.
const KILL: i32 = 9;
/// Signals of the processor, with the name that the last line of an orchestrator has.
const LAST_LINES: [(i32, &str); 3] = [(4, "SIGILL"), (7, "SIGBUS"), (11, "SIGSEGV")];

/// The limit for `scanloop stop` [ns].
pub fn stop_limit_ns(period_ns: u64) -> u64 {
    1_000_000_000.max(300_000_000 + 2 * period_ns)
}

/// After how many milliseconds wheels were blocked, as `stop` printed.
pub fn blocked_after_ms(printed: &str) -> Option<f64> {
    printed.split_once("wheels blocked after ")?.1.split_once(" ms")?.0.parse().ok()
}

/// All that was wrong in a trial.
pub fn problems(plan: &TrialPlan, seen: &TrialEvidence) -> Vec<String> {
    let mut found = Vec::new();
    if !seen.drove && plan.descriptors.is_none() {
        found.push("the run did not drive".to_owned());
    }
    if seen.drove && seen.drives.first().is_none_or(|drive| drive.changes.is_empty()) {
        found.push("the log of the emulator says nothing of the wheels".to_owned());
    }
    seen.stops().for_each(|stop| judge_stop(plan, seen, stop, &mut found));
    seen.drives.iter().for_each(|drive| judge_drive(plan, seen, drive, &mut found));
    judge_truth(plan, seen, &mut found);
    seen.programs.iter().for_each(|program| judge_end(plan, seen, program, &mut found));
    found.extend(seen.left.iter().map(|left| format!("left: {left}")));
    if !plan.damages() {
        found.extend(seen.panics.iter().map(|panic| format!("panic: {panic}")));
    }
    found
}

/// `stop` returned in time, and its exit code and message are true.
fn judge_stop(plan: &TrialPlan, seen: &TrialEvidence, stop: &Ended, found: &mut Vec<String>) {
    let limit_s = (stop_limit_ns(plan.period_ns()) + BUSY_NS) as f64 * 1e-9;
    match stop.took_s() {
        None => found.push("stop did not return".to_owned()),
        Some(took_s) if took_s > limit_s => {
            found.push(format!("stop took {took_s:.3} s, limit {limit_s:.3} s"))
        }
        Some(_) => {}
    }
    let printed = stop.printed.trim();
    let is_true = match stop.code {
        Some(0) => printed.contains("is stopped: wheels blocked after"),
        Some(2) => printed.contains("is not running") && !drives_later(plan, seen, stop),
        // Without a processor nothing is acknowledged.
        Some(4) => seen.fifo && printed.contains("alive: "),
        _ => false,
    };
    if !is_true {
        found.push(format!("stop ended with {:?}: {printed}", stop.code));
    }
}

/// Whether wheels turn after a `stop` that found no system.
fn drives_later(plan: &TrialPlan, seen: &TrialEvidence, stop: &Ended) -> bool {
    let later = |drive: &DriveEvidence| {
        drive
            .changes
            .iter()
            .any(|change| change.wheels == WheelsState::Turning && change.at_ns > stop.ended_ns)
    };
    !plan.runs_again() && seen.drives.iter().any(later)
}

/// What a stop demands: when it was asked for, from when on wheels are blocked, and when they rest [ns].
fn demands(plan: &TrialPlan, seen: &TrialEvidence) -> Vec<(u64, u64, u64)> {
    let slide_ns = SLIDE_NS + 3 * plan.period_ns() + SCHEDULED_NS;
    let limit_ns = stop_limit_ns(plan.period_ns());
    let stops = seen.stops().filter(|stop| matches!(stop.code, Some(0 | 4)) && stop.ended_ns > 0);
    let stops = stops.map(|stop| {
        let by_ns = stop.ended_ns + slide_ns;
        // Without an acknowledgement the dead man blocks.
        (stop.began_ns, if stop.code == Some(0) { stop.ended_ns } else { by_ns }, by_ns)
    });
    let ends = seen.ends_ns.iter().map(|at_ns| (*at_ns, at_ns + limit_ns, at_ns + limit_ns + slide_ns));
    stops.chain(ends).collect()
}

/// The log of the emulator: rest in time after each stop, no start after it, and rest in each long silence.
fn judge_drive(plan: &TrialPlan, seen: &TrialEvidence, drive: &DriveEvidence, found: &mut Vec<String>) {
    let name = drive.folder.file_name().unwrap_or_default().to_string_lossy();
    for (asked_ns, from_ns, by_ns) in demands(plan, seen) {
        // A run that began later was not meant.
        if drive.changes.first().is_none_or(|first| first.at_ns > asked_ns) {
            continue;
        }
        let meant = drive.changes.iter().filter(|change| change.at_ns > from_ns);
        if let Some(change) = meant.into_iter().find(|change| change.wheels == WheelsState::Turning) {
            let after_ms = (change.at_ns - from_ns) / 1_000_000;
            found.push(format!("{name}: wheels turn {after_ms} ms after a stop, by the log of the emulator"));
        }
        let is_gone = seen.robot_killed || plan.damages();
        if !is_gone && state_at(&drive.changes, from_ns) == Some(WheelsState::Turning) {
            found.push(format!("{name}: wheels are not blocked after a stop, by the log of the emulator"));
        }
        let state = state_at(&drive.changes, by_ns);
        if !is_gone && state != Some(WheelsState::Resting) {
            found.push(format!("{name}: {state:?} instead of rest after a stop, by the log of the emulator"));
        }
    }
    for (from_ns, to_ns) in long_silences(plan, seen) {
        let turned = drive
            .changes
            .iter()
            .any(|change| change.wheels == WheelsState::Turning && (from_ns..to_ns).contains(&change.at_ns));
        let turns = state_at(&drive.changes, from_ns) == Some(WheelsState::Turning);
        if turned || (turns && !seen.robot_killed && !plan.damages()) {
            found.push(format!(
                "{name}: wheels turn in a silence of the orchestrator, by the log of the emulator"
            ));
        }
    }
    if let Some(report) = &drive.report {
        if report.drive.truth.is_none_or(|truth| truth.collided) {
            found.push(format!("{name}: the report says that the robot has collided"));
        }
        if report.scans.unaccounted > 0 && !plan.damages() {
            found.push(format!("{name}: {} scans are unaccounted for", report.scans.unaccounted));
        }
    }
}

/// Times in which the wheels must not turn because of a long time without directives [ns].
fn long_silences(plan: &TrialPlan, seen: &TrialEvidence) -> Vec<(u64, u64)> {
    let rest_ns = (plan.orphan_stop_s * 1e9) as u64 + SLIDE_NS + 3 * plan.period_ns() + SCHEDULED_NS;
    let end_ns = |silence: &OrchestratorOutage| if silence.to_ns == 0 { seen.over_ns } else { silence.to_ns };
    let silences = seen.silences.iter().map(|silence| (silence.from_ns + rest_ns, end_ns(silence)));
    silences.filter(|(from_ns, to_ns)| from_ns < to_ns && !plan.runs_again()).collect()
}

/// The truth: no contact, no drive without actuations, and rest after each stop and in each long silence.
fn judge_truth(plan: &TrialPlan, seen: &TrialEvidence, found: &mut Vec<String>) {
    if seen.truth.iter().any(|point| point.collided) {
        found.push("the robot has collided".to_owned());
    }
    let blind_s = seen.truth.iter().map(|point| point.longest_blind_s).fold(0.0, f64::max);
    if blind_s > BLIND_PERIODS / f64::from(plan.rate_hz) + 1e-6 {
        found.push(format!("wheels turned for {blind_s:.3} s without an actuation"));
    }
    for (_, _, by_ns) in demands(plan, seen) {
        if let Some(point) = seen.truth.iter().find(|point| point.at_ns > by_ns && point.speed_mps > 1e-6) {
            let after_ms = (point.at_ns - by_ns) / 1_000_000;
            found.push(format!("{} m/s {after_ms} ms after it should rest, by the truth", point.speed_mps));
        }
    }
    for (from_ns, to_ns) in long_silences(plan, seen) {
        let mut silent = seen.truth.iter().filter(|point| (from_ns..to_ns).contains(&point.at_ns));
        if let Some(point) = silent.find(|point| point.speed_mps > 1e-6) {
            found.push(format!("{} m/s in a silence of the orchestrator, by the truth", point.speed_mps));
        }
    }
}

/// Each program ended as it may, and printed the truth.
fn judge_end(plan: &TrialPlan, seen: &TrialEvidence, program: &Ended, found: &mut Vec<String>) {
    if program.name == "stop" {
        return;
    }
    let name = &program.name;
    let is_orchestrator = program.out.is_some();
    if let Some(signal) = program.signal {
        let was_silent = seen.silences.iter().any(|silence| silence.from_ns < program.ended_ns);
        let is_known = program.sent.contains(&signal)
            || (plan.damages() && CRASHES.contains(&signal))
            // `stop` ends one that does not respond.
            || (signal == KILL && (was_silent || plan.damages()));
        if !is_known {
            found.push(format!("{name} was ended by signal {signal}: {}", last_line(&program.printed)));
        }
        let is_file = plan.output == StderrTarget::File || program.began_ns > first_began(seen);
        let expected = LAST_LINES.iter().find(|(number, _)| *number == signal);
        let had_begun = program.ended_ns > program.began_ns + SCHEDULED_NS;
        if let Some((_, cause)) =
            expected.filter(|_| is_orchestrator && had_begun && is_file && !plan.damages())
            && !(program.printed.contains(cause) && program.printed.contains("wheels are blocked"))
        {
            found.push(format!(
                "{name} did not say that it was ended by {cause}: {}",
                last_line(&program.printed)
            ));
        }
        return;
    }
    let Some(code) = program.code else {
        return found.push(format!("{name} did not end"));
    };
    let is_crash = plan.damages() && [5, 101].contains(&code);
    if !CODES.contains(&code) && !is_crash {
        found.push(format!("{name} ended with exit code {code}: {}", last_line(&program.printed)));
    }
    if is_orchestrator && program.began_ns == first_began(seen) {
        judge_report(seen, program, code, found);
    }
}

fn first_began(seen: &TrialEvidence) -> u64 {
    seen.programs.first().map_or(0, |program| program.began_ns)
}

/// The report of the first orchestrator agrees with its exit code.
fn judge_report(seen: &TrialEvidence, program: &Ended, code: i32, found: &mut Vec<String>) {
    let drive = seen.drives.iter().find(|drive| Some(&drive.folder) == program.out.as_ref());
    let Some(report) = drive.and_then(|drive| drive.report.as_ref()) else {
        if code < 2 {
            found.push(format!("{} ended with exit code {code} and left no report", program.name));
        }
        return;
    };
    let expected = match report.outcome {
        Outcome::Reached => 0,
        Outcome::Collision => 3,
        Outcome::Failed => 4,
        _ => 1,
    };
    if code != expected {
        found.push(format!("exit code {code}, but the report says {:?}: {}", report.outcome, report.reason));
    }
}

fn last_line(printed: &str) -> &str {
    printed.trim().lines().last().unwrap_or("(nothing said)")
}

#[cfg(test)]
mod tests {
    use super::super::wheels::{Point, WheelsChange};
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn plan() -> TrialPlan {
        let mut plan = TrialPlan::of(1);
        (plan.rate_hz, plan.orphan_stop_s, plan.output) = (10, 1.0, StderrTarget::File);
        plan.steps.clear();
        plan
    }

    /// A run that was stopped ten seconds after its start and rested at once.
    fn good() -> TrialEvidence {
        let run = Ended {
            name: "run".to_owned(),
            began_ns: SECOND,
            ended_ns: 11 * SECOND,
            code: Some(1),
            ..Ended::default()
        };
        let stop = Ended {
            name: "stop".to_owned(),
            began_ns: 10 * SECOND,
            ended_ns: 10 * SECOND + SECOND / 2,
            code: Some(0),
            printed: "system `a` is stopped: wheels blocked after 4 ms, and it has ended".to_owned(),
            ..Ended::default()
        };
        let change = |at_ns, wheels| WheelsChange { at_ns, wheels };
        let changes = vec![
            change(2 * SECOND, WheelsState::Resting),
            change(3 * SECOND, WheelsState::Turning),
            change(10 * SECOND + 5, WheelsState::Blocked),
            change(10 * SECOND + SECOND / 4, WheelsState::Resting),
        ];
        TrialEvidence {
            drove: true,
            programs: vec![run, stop],
            drives: vec![DriveEvidence { changes, ..DriveEvidence::default() }],
            over_ns: 12 * SECOND,
            ..TrialEvidence::default()
        }
    }

    fn point(at_ns: u64, speed_mps: f64) -> Point {
        Point { at_ns, speed_mps, collided: false, longest_blind_s: 0.1 }
    }

    #[test]
    fn a_drive_that_rests_after_its_stop_is_good() {
        assert_eq!(problems(&plan(), &good()), Vec::<String>::new());
        assert_eq!(blocked_after_ms(&good().programs[1].printed), Some(4.0));
    }

    /// Makes evidence of a good trial that of a bad one.
    type Spoil = fn(&mut TrialEvidence);

    #[test]
    fn each_thing_that_may_be_wrong_is_found() {
        let spoil: [(&str, Spoil); 14] = [
            ("says nothing of the wheels", |seen| seen.drives[0].changes.clear()),
            ("did not drive", |seen| seen.drove = false),
            ("stop took 2.500 s", |seen| seen.programs[1].ended_ns = 12 * SECOND + SECOND / 2),
            ("stop did not return", |seen| seen.programs[1].ended_ns = 0),
            ("stop ended with Some(4)", |seen| seen.programs[1].code = Some(4)),
            ("instead of rest", |seen| seen.drives[0].changes.truncate(3)),
            ("wheels are not blocked after a stop", |seen| {
                seen.drives[0].changes[2..].iter_mut().for_each(|change| change.at_ns += SECOND);
            }),
            ("wheels turn 500 ms after a stop", |seen| {
                seen.drives[0]
                    .changes
                    .push(WheelsChange { at_ns: 11 * SECOND, wheels: WheelsState::Turning });
            }),
            ("wheels turn in a silence", |seen| {
                seen.silences.push(OrchestratorOutage { from_ns: 4 * SECOND, to_ns: 9 * SECOND });
            }),
            ("after it should rest, by the truth", |seen| seen.truth.push(point(12 * SECOND, 0.5))),
            ("without an actuation", |seen| {
                seen.truth.push(Point { longest_blind_s: 0.31, ..point(0, 0.0) });
            }),
            ("has collided", |seen| seen.truth.push(Point { collided: true, ..point(0, 0.0) })),
            ("run was ended by signal 11", |seen| {
                (seen.programs[0].code, seen.programs[0].signal) = (None, Some(11));
            }),
            ("left: directory", |seen| seen.left.push("directory".to_owned())),
        ];
        for (expected, change) in spoil {
            let mut seen = good();
            change(&mut seen);
            let found = problems(&plan(), &seen);
            assert!(found.iter().any(|problem| problem.contains(expected)), "{expected}: {found:?}");
        }
    }
}
