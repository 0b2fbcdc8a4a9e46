//! The process of the role `robot`: actuation in; scan, odometry and, unless the scenario hides it, truth out.
//!
//! In real time a scan is published when it is due. In lock-step it is published when the previous scan was answered
//! and the orchestrator has granted it.
//!
//! An actuation acts from the time of its publication, so the drive does not depend on how busy the machine is. Two
//! emulators that receive the same actuations stay at the same place. A swap of the robot uses that: the candidate
//! takes the state of the process in charge, follows it in shadow, and continues with the next scan.
//!
//! When the run is stopped, or its orchestrator has been silent for too long, this process blocks the wheels itself. A
//! robot that is asked to end comes to rest first. It reports what its wheels do each time it wakes, and logs changes.

use std::rc::Rc;

use runtime::{Handover, Input, Output, Process, Taken, Wheels, monotonic_ns};
use shared_types::{
    Actuation, Directive, Header, JournalKind, MAX_LATE, Odometry, Phase, QUEUE_DEPTH, Role, Scan, Truth,
    plain_state,
};

use crate::{Emulator, EmulatorState, Scenario};

/// While the wheels are blocked for a stop, the robot checks this often whether it rests [ns].
const REST_CHECK_NS: u64 = 10_000_000;
/// A robot that was asked to end comes to rest within this time and two scan periods [ns].
const REST_NS: u64 = 1_500_000_000;
/// How many overdue scans are published before the newest one: as many as a subscriber's queue holds.
const HANDED_OVER_LATE: u64 = QUEUE_DEPTH as u64 - 1;

plain_state! {
    /// State that the process of a robot hands over to its successor.
    pub struct RobotState {
        /// When the run started, on the clock of the loop [ns]
        pub origin_ns: u64,
        /// The next scan
        pub next_scan: u64,
        /// The scan answered last
        pub answered: u64,
        /// Sequence number of the last actuation received
        pub received_sequence: u64,
        /// Incarnation that it came from
        pub received_incarnation: u32,
        /// Unused, zero
        pub reserved: u32,
        /// The robot and its surroundings
        pub emulator: EmulatorState,
    }
}

/// Runs until asked to end.
///
/// # Errors
/// A scenario that is not allowed, no state to continue from, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    run_with(|_, _, _| {})
}

/// [`run`] with a fault: `change` is applied to the samples of each scan before they are published.
///
/// # Errors
/// As [`run`].
pub fn run_with(change: impl FnMut(&mut Scan, &mut Odometry, &mut Truth) + 'static) -> anyhow::Result<()> {
    run_robot(Box::new(change), Box::new(|| None))
}

/// [`run`] with faults that begin and end under way: `faults` is asked after each scan for tables of the scenario whose
/// values hold from then on; an empty table stands for the robot without a fault.
///
/// # Errors
/// As [`run`].
pub fn run_with_faults(faults: impl FnMut() -> Option<toml::Table> + 'static) -> anyhow::Result<()> {
    run_robot(Box::new(|_, _, _| {}), Box::new(faults))
}

fn run_robot(change: Box<Change>, faults: Box<Faults>) -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Robot)?;
    let scenario = process.settings::<Scenario>("scenario")?;
    let mut robot = Robot {
        emulator: Emulator::new(&scenario, process.period_ns()),
        actuations: process.input()?,
        scans: process.output()?,
        odometries: process.output()?,
        truths: if scenario.robot.publish_truth { Some(process.output()?) } else { None },
        change,
        faults,
        fault: None,
        scenario,
        goal_from: 0,
        pending: None,
        state: RobotState { next_scan: 1, ..RobotState::default() },
        stopped: false,
        rest_published: false,
        logged: Wheels::Unknown,
    };
    process.report_wheels(Wheels::Resting);
    let handed = process.resume::<RobotState>()?;
    if !process.start()? {
        return Ok(());
    }
    robot.begin(&mut process, handed)?;
    while robot.wait(&mut process)? {
        robot.turn(&mut process, false)?;
    }
    robot.come_to_rest(&mut process)
}

/// The emulator with its ports and its place in the run.
struct Robot {
    emulator: Emulator,
    actuations: Input<Actuation>,
    scans: Rc<Output<Scan>>,
    odometries: Rc<Output<Odometry>>,
    /// Only where the scenario asks for the truth: a robot that opens this topic promises to publish on it.
    truths: Option<Rc<Output<Truth>>>,
    /// Applied to the samples of each scan.
    change: Box<Change>,
    /// Asked for faults after each scan.
    faults: Box<Faults>,
    /// A fault that begins with the next scan, as soon as there is a state to continue from.
    fault: Option<toml::Table>,
    /// The robot without a fault.
    scenario: Scenario,
    /// The first scan of the goal that was set last; 0 before.
    goal_from: u64,
    /// The next actuation, which does not act yet.
    pending: Option<Taken<Actuation>>,
    /// Place in the run; [`Self::save`] adds the state of the emulator.
    state: RobotState,
    /// Whether this process blocked the wheels for a stop.
    stopped: bool,
    /// Whether a scan at rest was published since then.
    rest_published: bool,
    /// What the last line of the log states about the wheels.
    logged: Wheels,
}

type Change = dyn FnMut(&mut Scan, &mut Odometry, &mut Truth);
type Faults = dyn FnMut() -> Option<toml::Table>;

impl Robot {
    /// Does all that is due, and blocks the wheels when they must not turn.
    fn turn(&mut self, process: &mut Process, ends: bool) -> anyhow::Result<()> {
        while self.step(process)? {}
        self.obey(process, ends || process.must_stop());
        process.report_wheels(self.wheels());
        self.log_wheels(process);
        Ok(())
    }

    /// Logs when the wheels begin to turn, are blocked, or rest, with the time of the robot on the clock of the loop.
    fn log_wheels(&mut self, process: &Process) {
        let wheels = self.wheels();
        if wheels == self.logged || !process.is_in_charge() || process.clock().is_simulated() {
            return;
        }
        self.logged = wheels;
        let speed_mps = self.emulator.plant().speed();
        let at_ns = self.state.origin_ns + self.emulator.now_ns();
        match wheels {
            Wheels::Turning => tracing::info!(speed_mps, at_ns, "wheels may turn"),
            Wheels::Blocked => tracing::info!(speed_mps, at_ns, "wheels are blocked"),
            _ => tracing::info!(speed_mps, at_ns, "wheels rest"),
        }
    }

    /// Blocks the wheels for a stop, whatever the actuator commands.
    fn obey(&mut self, process: &Process, must_stop: bool) {
        if !must_stop {
            self.stopped = false;
            return;
        }
        if !process.clock().is_simulated() {
            self.emulator.advance_to(process.clock().now_ns().saturating_sub(self.state.origin_ns));
        }
        if !self.stopped {
            (self.stopped, self.rest_published) = (true, false);
            tracing::info!(speed_mps = self.emulator.plant().speed(), "the robot blocks its wheels");
            process.note(JournalKind::Stopped, self.emulator.now_ns());
            self.emulator.block_at_once();
        }
    }

    /// What the wheels do.
    fn wheels(&self) -> Wheels {
        let plant = self.emulator.plant();
        match (plant.is_blocked(), plant.speed() != 0.0) {
            (false, _) => Wheels::Turning,
            (true, true) => Wheels::Blocked,
            (true, false) => Wheels::Resting,
        }
    }

    /// Before this process ends: waits until the robot rests and a scan that shows it is published.
    fn come_to_rest(&mut self, process: &mut Process) -> anyhow::Result<()> {
        // Another process is in charge, or simulated time has stopped.
        if !process.is_in_charge() || process.clock().is_simulated() {
            return Ok(());
        }
        let until_ns = monotonic_ns() + REST_NS + 2 * process.period_ns();
        loop {
            self.turn(process, true)?;
            let is_published = self.rest_published || !may_publish(process);
            if self.wheels() == Wheels::Resting && is_published {
                tracing::info!("the robot rests");
                return Ok(());
            }
            if monotonic_ns() >= until_ns {
                tracing::error!(speed_mps = self.emulator.plant().speed(), "the robot does not come to rest");
                return Ok(());
            }
            self.wait(process)?;
        }
    }

    /// Sleeps until the next scan is due or an actuation has come; false when asked to end.
    fn wait(&self, process: &mut Process) -> anyhow::Result<bool> {
        // A scan that was due when the run ended must not keep the process awake.
        let due_ns = self.due_ns(process);
        if self.stopped && self.wheels() != Wheels::Resting && !process.clock().is_simulated() {
            let check_ns = process.clock().now_ns() + REST_CHECK_NS;
            return Ok(process.wait(Some(due_ns.map_or(check_ns, |due_ns| due_ns.min(check_ns))))?);
        }
        Ok(match due_ns {
            Some(due_ns) => process.wait_for_time(due_ns)?,
            None => process.wait(None)?,
        })
    }

    /// Starts at the start pose, or as a candidate at the place of the robot in charge.
    fn begin(&mut self, process: &mut Process, handed: Handover<RobotState>) -> anyhow::Result<()> {
        self.state.origin_ns = process.clock().now_ns();
        self.state = match (process.join::<RobotState>()?, handed) {
            (Some((_, state)), _) => state,
            (None, Handover::FirstStart) => {
                process.note(JournalKind::Begun, self.state.origin_ns);
                return Ok(());
            }
            (None, Handover::State(state)) if process.clock().is_simulated() => state,
            // What the robot has done since would be missing.
            (None, _) => anyhow::bail!("there is no fresh state of a robot to continue from"),
        };
        Ok(self.emulator.resume(&self.state.emulator)?)
    }

    /// When the next scan is due, on the clock of the loop [ns]; `None` when the run is over.
    fn due_ns(&self, process: &Process) -> Option<u64> {
        may_publish(process).then(|| self.state.origin_ns + self.emulator.scan_ready_ns(self.state.next_scan))
    }

    /// Does what comes next in the time of the robot: a scan or an actuation; false when neither is there yet.
    fn step(&mut self, process: &mut Process) -> anyhow::Result<bool> {
        let simulated = process.clock().is_simulated();
        let now_ns = process.clock().now_ns().saturating_sub(self.state.origin_ns);
        if self.pending.is_none() {
            self.pending = self.next_actuation();
        }
        let (scan_id, acts_ns) = if simulated {
            let granted = self.state.answered + 1 == self.state.next_scan
                && self.state.next_scan <= process.directive().granted_scan;
            // The answer to a scan that is yet to be published here waits for it.
            let waits = |actuation: &Taken<Actuation>| actuation.header.scan_id >= self.state.next_scan;
            let acts = self.pending.as_ref().filter(|actuation| !waits(actuation));
            (granted.then_some(self.state.next_scan), acts.map(|_| 0))
        } else {
            // One period is left for the stages between scanner and wheels.
            let max_age_ns = process.max_age_ns() - process.period_ns();
            let sweep_ns = self.emulator.after_front_ns();
            // A scan that the scanner itself has delayed is not skipped: its readers refuse it.
            let is_young =
                |scan_id| now_ns.saturating_sub(self.emulator.scan_ready_ns(scan_id)) + sweep_ns < max_age_ns;
            let due = (self.state.next_scan..)
                .take_while(|scan_id| self.emulator.scan_ready_ns(*scan_id) <= now_ns);
            let scan_id = due.last().map(|newest| next_due(self.state.next_scan, newest, is_young));
            (scan_id, self.pending.as_ref().map(|actuation| self.acts_ns(actuation, now_ns)))
        };
        let scan_id = scan_id.filter(|_| may_publish(process));
        let is_before = |scan_id: u64| {
            acts_ns.is_none_or(|acts_ns| !simulated && self.emulator.scan_ready_ns(scan_id) <= acts_ns)
        };
        match scan_id {
            Some(scan_id) if is_before(scan_id) => self.publish(process, scan_id)?,
            _ => {
                let Some(acts_ns) = acts_ns else { return Ok(false) };
                let Some(actuation) = self.pending.take() else { return Ok(false) };
                self.emulator.advance_to(acts_ns);
                self.actuate(process, &actuation)?;
            }
        }
        Ok(true)
    }

    /// The next actuation that the state does not contain yet.
    fn next_actuation(&self) -> Option<Taken<Actuation>> {
        let RobotState { received_incarnation, received_sequence, .. } = self.state;
        let is_new = |Header { incarnation, sequence, .. }: &Header| {
            // One far below shows that the last number was wrong: the reader has dropped what is only late.
            let is_late = *sequence <= received_sequence && received_sequence - *sequence <= MAX_LATE;
            *incarnation != received_incarnation || !is_late
        };
        std::iter::from_fn(|| self.actuations.take()).find(|actuation| is_new(&actuation.header))
    }

    /// When an actuation acts: at its publication, but not before the time that the robot has reached, nor after now.
    fn acts_ns(&self, actuation: &Actuation, now_ns: u64) -> u64 {
        let published_ns = actuation.header.stage(Role::Actuator).published_ns;
        published_ns.saturating_sub(self.state.origin_ns).min(now_ns).max(self.emulator.now_ns())
    }

    fn actuate(&mut self, process: &mut Process, actuation: &Actuation) -> anyhow::Result<()> {
        // An actuation that was received before the stop may be due after it.
        if !actuation.drives() || !(self.stopped || process.must_stop()) {
            process.note(JournalKind::Used, self.emulator.now_ns());
            self.emulator.actuate(actuation);
        }
        let Header { incarnation, sequence, scan_id, .. } = actuation.header;
        (self.state.received_incarnation, self.state.received_sequence) = (incarnation, sequence);
        self.state.answered = if actuation.answers == 1 { scan_id } else { self.state.answered };
        self.save(process, &actuation.header)
    }

    fn publish(&mut self, process: &mut Process, scan_id: u64) -> anyhow::Result<()> {
        let ready_ns = self.emulator.scan_ready_ns(scan_id);
        process.clock().advance_to(self.state.origin_ns + ready_ns);
        process.begin();
        self.emulator.advance_to(ready_ns);
        let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
        self.heed_goal(process, scan_id);
        self.emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
        for header in [&mut scan.header, &mut odometry.header, &mut truth.header] {
            header.scan_id = scan_id;
            header.acquired_ns = self.state.origin_ns + self.emulator.stamp_ns(scan_id);
        }
        (self.change)(&mut scan, &mut odometry, &mut truth);
        self.rest_published |= self.stopped && truth.speed_mps == 0.0;
        if let Some(truths) = &self.truths {
            truths.publish_silently(&mut truth)?;
        }
        self.scans.publish(&mut scan)?;
        self.odometries.publish(&mut odometry)?;
        // After the samples of the loop: only companions sleep until a truth comes.
        self.truths.iter().for_each(|truths| truths.wake());
        self.state.next_scan = scan_id + 1;
        self.change_robot(process);
        self.save(process, &odometry.header)
    }

    /// Takes note of a goal that was set, which the truth of its scans shows.
    fn heed_goal(&mut self, process: &Process, scan_id: u64) {
        let Directive { header, goal, .. } = process.directive();
        if goal.from_scan != self.goal_from {
            self.goal_from = goal.from_scan;
            process.note_taken(&header);
            process.note(JournalKind::Used, self.emulator.now_ns());
        }
        self.emulator.give(&goal, scan_id);
    }

    /// Continues as the robot of another scenario, if a fault begins or ends.
    fn change_robot(&mut self, process: &Process) {
        self.fault = (self.faults)().or(self.fault.take());
        let Some(fault) = &self.fault else { return };
        let Some(state) = self.emulator.state(self.state.next_scan - 1) else { return };
        let changed = self.scenario.with(fault).map_err(anyhow::Error::from).and_then(|scenario| {
            let mut emulator = Emulator::new(&scenario, process.period_ns());
            emulator.resume(&state)?;
            Ok(emulator)
        });
        match changed {
            Ok(emulator) => {
                process.note(JournalKind::Altered, u64::from(!fault.is_empty()));
                self.emulator = emulator;
            }
            Err(error) => tracing::warn!(%error, "the fault can't be injected"),
        }
        self.fault = None;
    }

    /// Publishes the state, unless the next sweep has begun.
    fn save(&self, process: &mut Process, header: &Header) -> anyhow::Result<()> {
        let Some(emulator) = self.emulator.state(self.state.next_scan - 1) else { return Ok(()) };
        Ok(process.save(header, &RobotState { emulator, ..self.state })?)
    }
}

/// Whether scans are still published.
fn may_publish(process: &Process) -> bool {
    process.directive().phase != Phase::Stopping.wire()
}

/// The scan that a robot publishes next when those from `next_scan` to `newest` are due.
///
/// A scanner continues while the computer is delayed, and its driver then delivers the scans that were buffered
/// meanwhile; scans that are too old are skipped.
pub fn next_due(next_scan: u64, newest: u64, is_young: impl Fn(u64) -> bool) -> u64 {
    let oldest = next_scan.max(newest.saturating_sub(HANDED_OVER_LATE));
    (oldest..newest).find(|scan_id| is_young(*scan_id)).unwrap_or(newest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_was_held_up_hands_over_young_scans_and_skips_the_rest() {
        let next = |next_scan, young_from| next_due(next_scan, 20, |scan_id| scan_id >= young_from);
        assert_eq!(next(20, 0), 20);
        assert_eq!(next(19, 0), 19);
        // Readers keep twelve.
        assert_eq!((next(9, 0), next(3, 0)), (9, 9));
        assert_eq!((next(3, 19), next(20, 19)), (19, 20));
        assert_eq!(next(3, 21), 20, "the newest is published whatever its age");
    }
}
