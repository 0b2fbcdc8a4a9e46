//! The five processes of the pure transport chain: the topics and the topology of the pipeline, nothing computed.
//!
//! Each stage waits for the same inputs as the real one and answers at once with an empty sample. So the time from
//! scan to actuation consists of the bus, the wake-ups and the scheduler. With a payload, so many bytes travel with
//! the samples of the four hops of the critical path: the sender copies them into shared memory, the receiver reads
//! them in place. Both count as compute of the stage, and as part of scan to actuation. Work of the real stages
//! outside of the critical path, checkpoints after each scan, is left out.

use commands::bench::latency::echo::PREFIX;
use emulator::service::next_due;
use runtime::{Process, join};
use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Header, Obstacles, Odometry, Phase, Pose, Role, Sample,
    Scan, ScanGeometry, Topic, Truth,
};

use crate::payload::{Received, Sent};

/// Runs the stage that `name` names until it is told to end; `None` when it names none.
///
/// # Errors
/// Errors of the bus, and of a process that was started by hand.
pub(crate) fn run(name: &str) -> Option<anyhow::Result<()>> {
    let asked = name.strip_prefix(PREFIX)?;
    let (role, payload) = match asked.split_once(':') {
        Some((role, bytes)) => (role, Some(bytes.parse::<usize>().ok()?)),
        None => (asked, None),
    };
    Some(match role.parse().ok()? {
        Role::Robot => robot(payload),
        Role::Estimator => estimator(payload),
        Role::Obstacles => obstacles(payload),
        Role::Controller => controller(payload),
        Role::Actuator => actuator(payload),
    })
}

/// Publishes scans by the schedule of the emulated robot: the sweep ends a third of a period after the front beam.
fn robot(payload: Option<usize>) -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Robot)?;
    let actuations = process.input::<Actuation>()?;
    let scans = process.output::<Scan>()?;
    let odometries = process.output::<Odometry>()?;
    let truths = process.output::<Truth>()?;
    let sent = Sent::open(&mut process, Topic::Odometry, payload)?;
    if !process.start()? {
        return Ok(());
    }
    let period_ns = process.period_ns();
    let origin_ns = process.clock().now_ns();
    let due_ns = |scan_id: u64| origin_ns + scan_id * period_ns + period_ns / 3;
    let mut scan_id = 1;
    let mut stopping = false;
    loop {
        let continues =
            if stopping { process.wait(None)? } else { process.wait_for_time(due_ns(scan_id))? };
        if !continues {
            return Ok(());
        }
        while actuations.take().is_some() {}
        let now_ns = process.clock().now_ns();
        stopping = process.directive().phase == Phase::Stopping.wire();
        if now_ns < due_ns(scan_id) || stopping {
            continue;
        }
        let newest = scan_id + (now_ns - due_ns(scan_id)) / period_ns;
        let max_age_ns = process.max_age_ns() - period_ns;
        scan_id = next_due(scan_id, newest, |scan_id| now_ns - origin_ns - scan_id * period_ns < max_age_ns);
        process.begin();
        let acquired_ns = scan_id * period_ns;
        let mut truth = Truth {
            time_s: acquired_ns as f64 * 1e-9,
            goal_distance_m: 1e3,
            // It rests at any time, so that the run ends without a wait.
            blocked: process.directive().stop,
            ..Truth::default()
        };
        let mut scan = Scan { period_ns, sweep_ns: period_ns / 3 * 2, ..Scan::of(ScanGeometry::URG_04LX) };
        let mut odometry = Odometry::default();
        for header in [&mut truth.header, &mut scan.header, &mut odometry.header] {
            header.scan_id = scan_id;
            header.acquired_ns = origin_ns + acquired_ns;
        }
        sent.publish(scan_id)?;
        truths.publish_silently(&mut truth)?;
        scans.publish(&mut scan)?;
        odometries.publish(&mut odometry)?;
        scan_id += 1;
    }
}

/// A stage that answers: what it takes a payload with, and what it sends one with.
struct EmptyStage {
    process: Process,
    taken: Received,
    sent: Sent,
}

impl EmptyStage {
    fn attach(role: Role, from: Topic, to: Topic, payload: Option<usize>) -> anyhow::Result<Self> {
        let mut process = Process::attach(role)?;
        let taken = Received::open(&mut process, from, payload)?;
        // No process waits for what an actuation carries.
        let sent = Sent::open(&mut process, to, payload.filter(|_| to != Topic::Actuation))?;
        Ok(Self { process, taken, sent })
    }

    /// Answers each header that is `next` by a sample, until it is told to end; polled so often [ns], if at all.
    fn run<S: Sample>(
        mut self,
        poll_ns: Option<u64>,
        next: impl Fn() -> Option<Header>,
        answer: impl Fn(Header) -> S,
    ) -> anyhow::Result<()> {
        let output = self.process.output::<S>()?;
        if !self.process.start()? {
            return Ok(());
        }
        while self.process.wait(poll_ns.map(|poll_ns| self.process.clock().now_ns() + poll_ns))? {
            while let Some(header) = next() {
                if self.taken.take(header.scan_id)? {
                    self.sent.publish(header.scan_id)?;
                    output.publish(&mut answer(header))?;
                }
            }
        }
        Ok(())
    }
}

fn estimator(payload: Option<usize>) -> anyhow::Result<()> {
    let mut stage = EmptyStage::attach(Role::Estimator, Topic::Odometry, Topic::Pose, payload)?;
    let odometry = stage.process.input::<Odometry>()?;
    let actuation = stage.process.input::<Actuation>()?;
    let next = || {
        while actuation.take().is_some() {}
        odometry.take().map(|measured| measured.header.answer())
    };
    stage.run(None, next, |header| Pose { header, ..Pose::default() })
}

fn obstacles(payload: Option<usize>) -> anyhow::Result<()> {
    let mut stage = EmptyStage::attach(Role::Obstacles, Topic::Pose, Topic::Obstacles, payload)?;
    let (scans, poses) = (stage.process.input::<Scan>()?, stage.process.input::<Pose>()?);
    let next = || join(&scans, &poses).map(|(scan, pose)| scan.header.answer_both(&pose.header));
    stage.run(None, next, |header| Obstacles { header, ..Obstacles::default() })
}

fn controller(payload: Option<usize>) -> anyhow::Result<()> {
    let mut stage = EmptyStage::attach(Role::Controller, Topic::Obstacles, Topic::Command, payload)?;
    let (poses, obstacles) = (stage.process.input::<Pose>()?, stage.process.input::<Obstacles>()?);
    let next =
        || join(&poses, &obstacles).map(|(pose, described)| described.header.answer_both(&pose.header));
    let kind = CommandKind::Drive.wire();
    stage.run(None, next, |header| Command { header, kind, verified: 1, ..Command::default() })
}

fn actuator(payload: Option<usize>) -> anyhow::Result<()> {
    let mut stage = EmptyStage::attach(Role::Actuator, Topic::Command, Topic::Actuation, payload)?;
    let commands = stage.process.input::<Command>()?;
    // As the real one, which checks the time ten times a period.
    let poll_ns = stage.process.period_ns() / 10;
    let next = || commands.take().map(|command| command.header.answer());
    let kind = ActuationKind::Drive.wire();
    stage.run(Some(poll_ns), next, |header| Actuation { header, kind, answers: 1, ..Actuation::default() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use commands::bench::latency::echo::arguments;

    #[test]
    fn only_names_of_a_role_are_run() {
        assert_eq!(arguments(Role::Robot, None), ["service", "echo-robot"]);
        assert_eq!(arguments(Role::Actuator, Some(4096)), ["service", "echo-actuator:4096"]);
        for name in ["ekf", "echo-", "echo-pilot", "echo-robot:", "echo-robot:many"] {
            assert!(run(name).is_none(), "{name}");
        }
    }
}
