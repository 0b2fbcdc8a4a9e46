//! Playing of scans: the inputs of the candidate when they are due, and its answers.

use anyhow::Context;
use runtime::monotonic_ns;
use shared_types::{Role, Sample, Topic};
use supervision::private_system::stamps_at;

use super::{ANSWER_NS, Message, TestBench, Tried, failed, incarnation_of, inputs_of};
use crate::case::require;

impl TestBench<'_> {
    /// Lets the drive continue now, with the next scan.
    pub(crate) fn begin(&mut self) {
        if !self.setup.lockstep {
            let lead_ns = self.suite.period_ns / 2;
            self.offset_ns = (monotonic_ns() + lead_ns).saturating_sub(self.drive.ready_ns(self.scan_id));
        }
    }

    /// Waits until the next scan is due; returns its id.
    pub(crate) fn wait_until_due(&mut self) -> Tried<u64> {
        if self.setup.lockstep {
            self.turn()?;
            return Ok(self.scan_id);
        }
        let due_ns = self.drive.ready_ns(self.scan_id) + self.offset_ns;
        self.until(due_ns.saturating_sub(monotonic_ns()), |_| monotonic_ns() >= due_ns)?;
        // The data of a scan that is published late are as fresh as those of one in time.
        let late_ns = monotonic_ns().saturating_sub(due_ns);
        if late_ns > self.suite.period_ns / 4 {
            self.offset_ns += late_ns;
        }
        Ok(self.scan_id)
    }

    /// The sample of a topic for a scan as its writer would publish it now.
    pub(crate) fn message(&self, topic: Topic, scan_id: u64) -> Tried<Message> {
        let recorded = self.drive.message(topic, scan_id);
        let mut message = recorded.with_context(|| format!("scan {scan_id} has no {topic}"))?;
        let writer = topic.writer().context("a topic of the loop")?;
        message.shift(self.offset_ns);
        let header = message.header_mut();
        (header.scan_id, header.incarnation) = (scan_id, incarnation_of(writer));
        if !self.setup.lockstep {
            *header.stage_mut(writer) = stamps_at(monotonic_ns());
        }
        Ok(message)
    }

    /// The samples that make the candidate answer a scan; each carries the stamps of those before it.
    pub(crate) fn inputs(&self, scan_id: u64) -> Tried<Vec<Message>> {
        let mut inputs: Vec<Message> = Vec::new();
        for topic in inputs_of(self.suite.role) {
            let mut message = self.message(*topic, scan_id)?;
            for before in &inputs {
                if let Some(writer) = before.topic().writer() {
                    *message.header_mut().stage_mut(writer) = *before.header().stage(writer);
                }
            }
            inputs.push(message);
        }
        Ok(inputs)
    }

    /// Publishes a sample; layout and sequence are filled and stay in the message.
    pub(crate) fn publish(&mut self, message: &mut Message) -> Tried {
        Ok(self.publishers.publish_on(message.topic(), message.bytes_mut(), false)?)
    }

    /// Publishes a sample exactly as it is.
    pub(crate) fn publish_exactly(&mut self, message: &Message) -> Tried {
        Ok(self.publishers.publish_on(message.topic(), message.clone().bytes_mut(), true)?)
    }

    /// Publishes what makes the candidate answer the next scan, when it is due; returns its id.
    pub(crate) fn ask(&mut self) -> Tried<u64> {
        self.ask_with(|_| {})?;
        Ok(self.scan_id - 1)
    }

    /// Publishes the inputs of the next scan, each changed, when it is due; returns them as published.
    pub(crate) fn ask_with(&mut self, change: impl Fn(&mut Message)) -> Tried<Vec<Message>> {
        let scan_id = self.wait_until_due()?;
        let mut inputs = self.inputs(scan_id)?;
        for message in &mut inputs {
            change(message);
            self.publish(message)?;
        }
        self.scan_id += 1;
        Ok(inputs)
    }

    /// One scan: the candidate is asked, and its first answer is returned.
    ///
    /// A robot publishes first, and is told its [`Order`](supervision::private_system::Order).
    pub(crate) fn round(&mut self) -> Tried<Message> {
        if self.suite.role == Role::Robot {
            return self.robot_round();
        }
        self.round_with(|_| {})
    }

    /// One scan whose inputs are changed, with its first answer.
    pub(crate) fn round_with(&mut self, change: impl Fn(&mut Message)) -> Tried<Message> {
        self.ask_with(change)?;
        self.finish()
    }

    /// Several rounds.
    pub(crate) fn rounds(&mut self, count: usize) -> Tried<Vec<Message>> {
        (0..count).map(|_| self.round()).collect()
    }

    /// What is published first in each of several rounds, as samples of this type.
    pub(crate) fn samples<S: Sample>(&mut self, count: usize) -> Tried<Vec<S>> {
        (0..count).map(|_| self.round()?.sample().copied()).collect()
    }

    /// Waits for the first answer to the newest scan and publishes what follows from it.
    pub(crate) fn finish(&mut self) -> Tried<Message> {
        let scan_id = self.scan_id - 1;
        let answer = self.answer(scan_id)?;
        self.conclude(scan_id)?;
        Ok(answer)
    }

    /// Waits for the first answer to a scan.
    pub(crate) fn answer(&mut self, scan_id: u64) -> Tried<Message> {
        let answer = self.find(ANSWER_NS, |bench| bench.answers(scan_id).next().cloned())?;
        answer.map_or_else(|| self.no_answer(&format!("answer to scan {scan_id}")), Ok)
    }

    /// Fails because something was not published in time.
    pub(super) fn no_answer<T>(&self, missing: &str) -> Tried<T> {
        failed(format!("no {missing} within {} s{}", ANSWER_NS / 1_000_000_000, self.log.last_lines_suffix()))
    }

    /// Publishes what follows from the answer: an estimator receives what was sent to the robot.
    pub(crate) fn conclude(&mut self, scan_id: u64) -> Tried {
        if self.suite.role == Role::Estimator {
            let mut actuation = self.message(Topic::Actuation, scan_id)?;
            self.publish(&mut actuation)?;
        }
        Ok(())
    }

    /// All answers to a scan so far.
    pub(crate) fn answers(&self, scan_id: u64) -> impl Iterator<Item = &Message> {
        let of_scan = self.received.iter().filter(move |received| received.scan_id() == scan_id);
        of_scan.filter(|received| received.is_answer())
    }

    /// Requires that nothing was published for a scan, except what is harmless.
    pub(crate) fn require_no_answer(&self, scan_id: u64, after: &str) -> Tried {
        let mut of_scan = self.received.iter().filter(|received| received.scan_id() == scan_id);
        let is_used = of_scan.any(|received| !received.is_harmless());
        let topic = self.suite.role.writes()[0];
        require(!is_used, || format!("it published {topic} of scan {scan_id} after {after}"))
    }
}
