//! Messages between processes and orchestrator: heartbeats and directives.

use crate::named::wire_enum;
use crate::sample::sample;
use crate::{
    Authority, Device, DeviceState, DrivenBy, Fault, GivenControl, GivenGoal, Header, InputAccount,
    MAX_NUMBER, MAX_STAMP_NS, PORTS, Refusal, Role, SLOTS, Topic,
};

wire_enum! {
    /// What the whole system is doing.
    pub enum Phase {
        /// Processes are starting and open their ports.
        Starting = 0 "starting",
        /// All ports exist: each process makes its ends of the connections.
        Connecting = 1 "connecting",
        /// The loop runs.
        Driving = 2 "driving",
        /// Wheels are blocked and processes end.
        Stopping = 3 "stopping",
    }
}

wire_enum! {
    /// The state that a process reports.
    pub enum ProcessState {
        /// It has opened its ports.
        Attached = 0 "attached",
        /// Its connections are made, samples will arrive.
        Connected = 1 "connected",
        /// It has published its first output.
        Ready = 2 "ready",
        /// It is about to end.
        Ending = 3 "ending",
    }
}

sample! {
    /// What the orchestrator tells all processes.
    pub struct Directive(552, Directive, 0xaed0_4d98, "scanloop.Directive.v4", check) {
        /// Identity; the chain is unused
        pub header: Header,
        /// What the system is doing, `Phase`
        pub phase: u32,
        /// 1 when the wheels are to be blocked now, whatever the controller commands
        pub stop: u32,
        /// In lock-step: the last scan that the robot may publish
        pub granted_scan: u64,
        /// When it was published [ns of CLOCK_MONOTONIC]
        pub issued_ns: u64,
        /// Process id of the orchestrator
        pub orchestrator_pid: u64,
        /// Whose samples count, by slot
        pub authority: [Authority; SLOTS],
        /// The goal that was given last while the system drives
        pub goal: GivenGoal,
        /// Who drives, `DrivenBy`
        pub driven_by: u32,
        /// Unused, zero
        pub reserved: u32,
        /// What a person who drives asks for
        pub person: GivenControl,
    }
}

impl Directive {
    /// What stages follow: the first scan of the goal, who drives, and the number of what a person asks for.
    pub fn orders(&self) -> (u64, u32, u64) {
        (self.goal.from_scan, self.driven_by, self.person.number)
    }

    /// Whose samples count on a topic; `None` for a topic that several processes write, where all do.
    pub fn authority_over(&self, topic: Topic) -> Option<&Authority> {
        topic.writer().map(|role| &self.authority[role.index()])
    }

    /// Whether a sample of `topic` counts for its scan.
    pub fn counts(&self, topic: Topic, header: &Header) -> bool {
        let authority = self.authority_over(topic);
        authority.is_none_or(|authority| authority.accepts(header.incarnation, header.scan_id))
    }
}

sample! {
    /// State and counters of one process.
    pub struct Heartbeat(2008, Heartbeat, 0x6a10_b069, "scanloop.Heartbeat.v5", check_heartbeat) {
        /// Identity; scan id is the last one worked on, the chain is unused
        pub header: Header,
        /// Slot of the process; the first five are those of a `Role`
        pub role: u32,
        /// State that the process reports, `ProcessState`
        pub state: u32,
        /// Process id
        pub pid: u64,
        /// 1 when it sees the stop word of its run, and so obeys `scanloop stop` by itself
        pub obeys_stop: u32,
        /// Unused, zero
        pub reserved: u32,
        /// When it was published [ns of CLOCK_MONOTONIC]
        pub issued_ns: u64,
        /// Passes through the loop of the process; they stop when it hangs
        pub activations: u64,
        /// Outputs published on the first topic of the role
        pub published: u64,
        /// Inputs used
        pub used: u64,
        /// Inputs replaced by newer ones before they were used
        pub replaced: u64,
        /// Inputs dropped because of their content
        pub invalid: u64,
        /// Inputs dropped because they were too old
        pub stale: u64,
        /// Inputs dropped because their sequence number had been seen
        pub duplicate: u64,
        /// Inputs dropped because a later one had been seen
        pub reordered: u64,
        /// Inputs dropped because their producer has no authority
        pub foreign: u64,
        /// Sequence numbers that never arrived
        pub missing: u64,
        /// Outputs that did not reach all of their readers
        pub undelivered: u64,
        /// Wake-ups by timeout
        pub timeouts: u64,
        /// When samples were last taken from the bus [ns of CLOCK_MONOTONIC]
        pub looked_ns: u64,
        /// Samples taken of the topic that the role answers
        pub taken: u64,
        /// Sum of their scan ids
        pub taken_scans: u64,
        /// Answers to them
        pub answered: u64,
        /// Sum of the scan ids of the answers
        pub answered_scans: u64,
        /// Sequence number of the newest sample per topic that the process writes, in the order of its writes
        pub written: [u64; PORTS],
        /// What became of the samples per topic that the process reads, in the order of its reads
        pub inputs: [InputAccount; PORTS],
        /// Samples dropped or refused because of their content, per topic that the process reads
        pub refused: [Refusal; PORTS],
        /// What the devices behind the process do
        pub device: Device,
    }
}

fn check(directive: &Directive) -> Result<(), Fault> {
    directive.header.check::<Directive>()?;
    Phase::try_from(directive.phase)?;
    DrivenBy::try_from(directive.driven_by)?;
    directive.goal.check()?;
    directive.person.check()
}

fn check_heartbeat(heartbeat: &Heartbeat) -> Result<(), Fault> {
    heartbeat.header.check::<Heartbeat>()?;
    Role::try_from(heartbeat.role)?;
    ProcessState::try_from(heartbeat.state)?;
    // The orchestrator adds them up and takes differences.
    heartbeat.inputs.iter().try_for_each(InputAccount::check)?;
    for (field, number, highest) in [
        ("issued_ns", heartbeat.issued_ns, MAX_STAMP_NS),
        ("looked_ns", heartbeat.looked_ns, MAX_STAMP_NS),
        ("published", heartbeat.published, MAX_NUMBER),
        ("taken", heartbeat.taken, MAX_NUMBER),
        ("answered", heartbeat.answered, MAX_NUMBER),
        ("written", heartbeat.written.into_iter().max().unwrap_or(0), MAX_NUMBER),
        // The scan of a refused sample is what the sample said, right or wrong.
        ("refused", heartbeat.refused.iter().map(|row| row.count).max().unwrap_or(0), MAX_NUMBER),
    ] {
        crate::numbering::require(field, number, highest)?;
    }
    DeviceState::try_from(heartbeat.device.state).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn a_heartbeat_may_report_any_number_as_refused_but_no_count_that_can_not_be() {
        let mut heartbeat = Heartbeat::default();
        heartbeat.header.layout = Heartbeat::LAYOUT;
        let header = Header { scan_id: u64::MAX, ..Header::default() };
        let fault = Fault::ImpossibleNumber { field: "header.scan_id", value: u64::MAX, highest: 9 };
        heartbeat.refused[0].note(&header, &fault);
        assert_eq!(heartbeat.check(), Ok(()));
        heartbeat.written[1] = 1 << 63;
        assert!(matches!(heartbeat.check(), Err(Fault::ImpossibleNumber { field: "written", .. })));
        heartbeat.written[1] = 0;
        heartbeat.inputs[0].missing = u64::MAX;
        assert_eq!(heartbeat.check().map_err(|fault| fault.finding().0), Err("missing"));
    }
}
