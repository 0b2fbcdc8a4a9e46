//! The actuator as a stage of the loop: command in, actuation out, and the stop that always wins.

use shared_types::{
    Actuation, AnySample, Command, Directive, Fault, Role, Sample, SampleType, Stage, StageEvent, Stopwatch,
};
use vehicle::Invalid;

use crate::{Actuator, ActuatorConfig, ActuatorState};

/// The stage.
#[derive(Debug, Clone)]
pub struct ActuatorStage {
    actuator: Actuator,
    period_ns: u64,
    last: Option<Command>,
    output: Option<Actuation>,
}

impl Stage for ActuatorStage {
    type Settings = ActuatorConfig;
    type Invalid = Invalid;
    type Output = Actuation;
    type State = ActuatorState;

    const ROLE: Role = Role::Actuator;
    const ANSWERS: &'static [&'static SampleType] = &[Command::TYPE];
    const TAKES_ORDERS: bool = true;
    const HOLDS_WHEELS: bool = true;

    fn begin(settings: ActuatorConfig, period_ns: u64) -> Result<Self, Invalid> {
        let actuator = Actuator::new(settings, period_ns)?;
        Ok(Self { actuator, period_ns, last: None, output: None })
    }

    fn resume(&mut self, state: &ActuatorState) -> bool {
        self.actuator.resume(state).is_ok()
    }

    fn state(&self) -> Option<ActuatorState> {
        Some(self.actuator.state())
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        if let Some(command) = sample.get() {
            self.output = Some(self.actuator.answer(command, now_ns));
        } else if let Some(Directive { driven_by, person, .. }) = sample.get() {
            self.actuator.obey(*driven_by, person);
        }
    }

    fn output(&mut self, _: u64, _: &Stopwatch<'_>) -> Option<Actuation> {
        self.output.take()
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        match event {
            StageEvent::Timer(now_ns) => {
                let was_awake = self.actuator.is_awake();
                self.output = self.actuator.tick(now_ns);
                return self.output.is_some() || !was_awake;
            }
            StageEvent::Stopped(now_ns) => self.output = Some(self.actuator.stop(now_ns, false)),
            StageEvent::EmergencyStop(now_ns) => self.output = Some(self.actuator.stop(now_ns, true)),
            StageEvent::Released => self.actuator.release(),
            StageEvent::Dropped => self.actuator.note_dropped(),
            // It was stopped for it.
            _ => return false,
        }
        true
    }

    fn keep(&mut self, sample: AnySample<'_>) {
        self.last = sample.get().copied();
    }

    fn rehearse(&mut self, due_ns: u64, _: &dyn Fn() -> u64) {
        if let Some(last) = &self.last {
            self.actuator.rehearse(last, self.period_ns, due_ns);
        }
    }

    fn refusal(&self) -> Option<&Fault> {
        self.actuator.refusal()
    }

    fn is_stopped(&self) -> bool {
        self.actuator.is_stopped()
    }
}
