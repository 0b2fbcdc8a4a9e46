//! How a fault gets into the loop.

use faults::{Change, Injection, SampleFault, ScenarioFault};
use pipeline::{ActiveChange, first_incarnation};
use shared_types::{Role, Topic};

use super::{LEAD_NS, Rig};

impl Rig {
    /// Injects a fault that begins with the next scan, and forgets earlier findings. Returns when it begins [ns].
    ///
    /// `None` for a fault of a process, and for one that makes the scenario invalid.
    pub fn inject(&mut self, injection: &Injection) -> Option<u64> {
        let from_ns = self.simulation.scan_ready_ns(self.simulation.next_scan()) - LEAD_NS;
        self.judge.findings.restart(from_ns);
        let is_injected = match injection {
            Injection::Sample(fault) => self.inject_into_samples(fault, from_ns),
            Injection::Scenario(fault) => self.inject_into_robot(fault),
            Injection::Process(_) => false,
            Injection::Person(fault) => {
                self.person.as_mut().map(|person| person.fault = Some(*fault)).is_some()
            }
        };
        is_injected.then_some(from_ns)
    }

    fn inject_into_samples(&mut self, fault: &SampleFault, from_ns: u64) -> bool {
        let is_of_the_loop = fault.topic.writer().is_some() && fault.topic != Topic::Truth;
        let Some(change) = Change::new(fault).ok().filter(|_| is_of_the_loop) else { return false };
        let lasts_ns = fault.scans.map_or(u64::MAX, |scans| scans * self.period_ns);
        // Of two processes in a swap, the one in charge is faulty.
        let of = (fault.topic == Topic::Command).then(|| first_incarnation(Role::Controller));
        let wire = match fault.topic == Topic::Actuation && fault.at_robot {
            true => self.simulation.wire_to_robot(),
            false => self.simulation.wire(fault.topic),
        };
        wire.break_with(ActiveChange { change, from_ns, until_ns: from_ns.saturating_add(lasts_ns), of });
        true
    }

    fn inject_into_robot(&mut self, fault: &ScenarioFault) -> bool {
        let Ok(faulty) = self.scenario.with(&fault.set) else { return false };
        if let Some(scans) = fault.scans {
            self.repaired = Some((self.simulation.next_scan() + scans, self.scenario.clone()));
        }
        self.simulation.replace_robot(&faulty)
    }
}
