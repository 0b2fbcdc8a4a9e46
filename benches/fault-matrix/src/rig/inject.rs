//! How a fault gets into the loop.

use emulator::{Emulator, Scenario};
use faults::{Change, Injection, SampleFault, ScenarioFault};
use shared_types::{Role, Topic};

use super::{LEAD_NS, Rig, incarnation};
use crate::wire::ActiveChange;

impl Rig {
    /// Injects a fault that begins with the next scan, and forgets earlier findings. Returns when it begins [ns].
    ///
    /// `None` for a fault of a process, and for one that makes the scenario invalid.
    pub fn inject(&mut self, injection: &Injection) -> Option<u64> {
        let from_ns = self.emulator.scan_ready_ns(self.next_scan) - LEAD_NS;
        self.findings.restart(from_ns);
        let is_injected = match injection {
            Injection::Sample(fault) => self.inject_into_samples(fault, from_ns),
            Injection::Scenario(fault) => self.inject_into_robot(fault),
            Injection::Process(_) => false,
        };
        is_injected.then_some(from_ns)
    }

    fn inject_into_samples(&mut self, fault: &SampleFault, from_ns: u64) -> bool {
        let Ok(change) = Change::new(fault) else { return false };
        let lasts_ns = fault.scans.map_or(u64::MAX, |scans| scans * self.period_ns);
        // Of two processes in a swap, the one in charge is faulty.
        let of = (fault.topic == Topic::Command).then(|| incarnation(Role::Controller));
        let fault_of = ActiveChange { change, from_ns, until_ns: from_ns.saturating_add(lasts_ns), of };
        match fault.topic {
            Topic::Scan => self.wires.scan.break_with(fault_of),
            Topic::Odometry => self.wires.odometry.break_with(fault_of),
            Topic::Pose => self.wires.pose.break_with(fault_of),
            Topic::Obstacles => self.wires.obstacles.break_with(fault_of),
            Topic::Command => self.wires.command.break_with(fault_of),
            Topic::Actuation if fault.at_robot => self.wires.to_robot.break_with(fault_of),
            Topic::Actuation => self.wires.actuation.break_with(fault_of),
            Topic::Heartbeat
            | Topic::Directive
            | Topic::Checkpoint
            | Topic::Truth
            | Topic::Journal
            | Topic::Clock => {
                return false;
            }
        }
        true
    }

    fn inject_into_robot(&mut self, fault: &ScenarioFault) -> bool {
        let Ok(faulty) = self.scenario.with(&fault.set) else { return false };
        if let Some(scans) = fault.scans {
            self.repaired = Some((self.next_scan + scans, self.scenario.clone()));
        }
        self.replace_robot(&faulty)
    }

    /// The robot continues as one of another scenario.
    pub(super) fn replace_robot(&mut self, scenario: &Scenario) -> bool {
        let Some(state) = self.emulator.state(self.next_scan - 1) else { return false };
        let mut emulator = Emulator::new(scenario, self.period_ns);
        let continues = emulator.resume(&state).is_ok();
        if continues {
            self.emulator = emulator;
        }
        continues
    }
}
