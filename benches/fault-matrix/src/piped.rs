//! A stage in a program of its own, which is driven through a pipe.

use std::io::{BufReader, Write};
use std::os::fd::AsFd;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use runtime::stage::pipe::{Ask, PIPE_VARIABLE, StageOutline, read_message, verify_greeting, write_message};
use runtime::wait_for;
use shared_types::{
    AnySample, AnyStage, Checkpoint, Fault, Role, Rule, SampleType, StageEvent, StageShape, Stopwatch, TOPICS,
};

/// A program that has not answered after this time does not answer [ns].
const ANSWER_NS: u64 = 30_000_000_000;

/// The program of a stage, and how it is begun.
#[derive(Debug)]
struct Program {
    command: Vec<String>,
    settings: String,
    period_ns: u64,
    /// Why one of its processes has failed, if one has.
    failure: Mutex<Option<String>>,
}

/// A stage in a process of its own.
pub struct PipedStage {
    program: Arc<Program>,
    shape: StageShape,
    /// None when it could not be started.
    pipe: Mutex<Option<Pipe>>,
    refusal: Option<Fault>,
}

/// A process and the ends of its pipes.
struct Pipe {
    child: Child,
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
    place: Vec<u64>,
}

impl PipedStage {
    /// Starts a program with the settings of its role in TOML.
    ///
    /// # Errors
    /// Why it can't be started, is no program of a stage of this role, or refuses the settings.
    pub fn start(command: &[String], role: Role, settings: String, period_ns: u64) -> Result<Self, String> {
        let program = Program { command: command.to_vec(), settings, period_ns, failure: Mutex::new(None) };
        let stage = Self::begin(&Arc::new(program))?;
        match stage.shape.role == role {
            true => Ok(stage),
            false => Err(format!("it is a stage of the role {}", stage.shape.role)),
        }
    }

    /// Why one of the processes of the program has failed, if one has: what came after it is not of the stage.
    pub fn failure(&self) -> Option<String> {
        held(&self.program.failure).clone()
    }

    fn begin(program: &Arc<Program>) -> Result<Self, String> {
        let mut pipe = Pipe::open(&program.command)?;
        let begun = pipe.ask(Ask::Begin, &[&program.period_ns.to_ne_bytes(), program.settings.as_bytes()])?;
        let outline = match begun.split_first() {
            Some((1, outline)) => StageOutline::read(outline).ok_or("its outline can't be read")?,
            Some((_, reason)) => return Err(String::from_utf8_lossy(reason).into_owned()),
            None => return Err("it did not begin".to_owned()),
        };
        let (program, shape) = (Arc::clone(program), shape(&outline)?);
        Ok(Self { program, shape, pipe: Mutex::new(Some(pipe)), refusal: None })
    }

    /// The answer to a message; empty after a failure, which is kept.
    fn ask(&self, ask: Ask, parts: &[&[u8]]) -> Vec<u8> {
        self.with_pipe(|pipe| pipe.ask(ask, parts)).unwrap_or_default()
    }

    fn with_pipe<T>(&self, work: impl FnOnce(&mut Pipe) -> Result<T, String>) -> Option<T> {
        let worked = held(&self.pipe).as_mut().map(work)?;
        worked.map_err(|reason| self.keep_failure(reason)).ok()
    }

    fn keep_failure(&self, reason: String) {
        held(&self.program.failure).get_or_insert(reason);
    }
}

impl Pipe {
    fn open(command: &[String]) -> Result<Self, String> {
        let (name, arguments) = command.split_first().ok_or("the command is empty")?;
        let mut child = Command::new(name)
            .args(arguments)
            .env(PIPE_VARIABLE, "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| format!("{name}: {error}"))?;
        let (to, from) = (child.stdin.take(), child.stdout.take().ok_or("it has no standard output")?);
        let mut pipe = Self { child, to, from: BufReader::new(from), place: Vec::new() };
        let greeting = pipe.answer()?;
        verify_greeting(&greeting)?;
        Ok(pipe)
    }

    fn tell(&mut self, ask: Ask, parts: &[&[u8]]) -> Result<(), String> {
        let to = self.to.as_mut().ok_or("it has ended")?;
        let told = write_message(to, ask as u8, parts).and_then(|()| to.flush());
        told.map_err(|error| self.end(&error.to_string()))
    }

    fn ask(&mut self, ask: Ask, parts: &[&[u8]]) -> Result<Vec<u8>, String> {
        self.tell(ask, parts)?;
        self.answer()
    }

    fn answer(&mut self) -> Result<Vec<u8>, String> {
        if self.from.buffer().is_empty() && !wait_for(&[self.from.get_ref().as_fd()], ANSWER_NS) {
            return Err(self.end(&format!("no answer within {} s", ANSWER_NS / 1_000_000_000)));
        }
        match read_message(&mut self.from, &mut self.place) {
            Ok((_, length)) => Ok(bytemuck::cast_slice::<u64, u8>(&self.place)[..length].to_vec()),
            Err(error) => Err(self.end(&error.to_string())),
        }
    }

    /// Ends the process; why it failed.
    fn end(&mut self, reason: &str) -> String {
        self.to = None;
        let _ = self.child.kill();
        match self.child.wait() {
            Ok(status) if status.code().is_some() => format!("the program ended: {status}"),
            _ => format!("the program failed: {reason}"),
        }
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.to = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl AnyStage for PipedStage {
    fn shape(&self) -> StageShape {
        self.shape
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        let topic = sample.sample_type().topic as u64;
        let parts = [&topic.to_ne_bytes(), &now_ns.to_ne_bytes(), sample.bytes()];
        self.with_pipe(|pipe| pipe.tell(Ask::Take, &parts));
        if self.shape.holds_wheels {
            let rule: Option<[u8; 4]> = self.ask(Ask::Refusal, &[]).try_into().ok();
            let rule = rule.and_then(|rule| Rule::try_from(u32::from_ne_bytes(rule)).ok());
            self.refusal = rule.and_then(fault_of);
        }
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        let ((kind, value), in_charge) = (event.entry(), event == StageEvent::StateLost { in_charge: true });
        let numbers = [u64::from(kind.wire()), value, u64::from(in_charge)].map(u64::to_ne_bytes);
        self.ask(Ask::Follow, &[&numbers.concat()]) == [1]
    }

    fn rehearse(&mut self, _: u64, _: &dyn Fn() -> u64) {}

    fn refusal(&self) -> Option<&Fault> {
        self.refusal.as_ref()
    }

    fn contains(&self, _: AnySample<'_>) -> bool {
        false
    }

    fn is_stopped(&self) -> bool {
        self.ask(Ask::IsStopped, &[]) == [1]
    }

    fn resume(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        let wrong = self.ask(Ask::Resume, &[bytemuck::bytes_of(checkpoint)]);
        if wrong.is_empty() { Ok(()) } else { Err(String::from_utf8_lossy(&wrong).into_owned()) }
    }

    /// Another process of the program, with the same state. One that can't be started answers nothing.
    fn copy(&self) -> Box<dyn AnyStage> {
        let begun = Self::begin(&self.program).and_then(|mut copy| match self.checkpoint() {
            Some(state) => AnyStage::resume(&mut copy, &state).map(|()| copy),
            None => Ok(copy),
        });
        Box::new(begun.unwrap_or_else(|reason| {
            self.keep_failure(reason);
            let program = Arc::clone(&self.program);
            Self { program, shape: self.shape, pipe: Mutex::new(None), refusal: None }
        }))
    }

    fn checkpoint(&self) -> Option<Checkpoint> {
        bytemuck::try_pod_read_unaligned(&self.ask(Ask::Save, &[])).ok()
    }

    fn publish(&mut self, scan_id: u64, _: &Stopwatch<'_>, publish: &mut dyn FnMut(&mut [u8])) -> bool {
        let output = self.ask(Ask::Publish, &[&scan_id.to_ne_bytes()]);
        if output.len() != self.shape.output.size {
            return false;
        }
        let mut place = vec![0_u64; output.len() / 8];
        bytemuck::cast_slice_mut(&mut place).copy_from_slice(&output);
        publish(bytemuck::cast_slice_mut(&mut place));
        true
    }
}

/// The shape that an outline tells.
fn shape(outline: &StageOutline) -> Result<StageShape, String> {
    let of = |topics: &[u32]| -> &'static [&'static SampleType] {
        // Once per process of a program: a few bytes.
        Box::leak(topics.iter().map(|topic| TOPICS[*topic as usize].sample_type()).collect())
    };
    Ok(StageShape {
        role: Role::try_from(outline.role).map_err(|fault| fault.to_string())?,
        answers: of(&outline.answers),
        notes: of(&outline.notes),
        later: of(&outline.later),
        output: TOPICS[outline.output as usize].sample_type(),
        own_fields: &[],
        holds_wheels: outline.holds_wheels,
        takes_orders: outline.takes_orders,
    })
}

/// A fault by its rule alone; what was found is told by the log of the program.
fn fault_of(rule: Rule) -> Option<Fault> {
    Some(match rule {
        Rule::None => return None,
        Rule::Layout => Fault::Layout { expected: 0, found: 0 },
        Rule::NotFinite => Fault::NotFinite { field: "sample" },
        Rule::OutOfRange => Fault::OutOfRange { field: "sample", value: 0.0 },
        Rule::UnknownValue => Fault::UnknownValue { field: "sample", value: 0 },
        Rule::NotVerified => Fault::NotVerified { value: 0 },
        Rule::OutsideBounds => {
            Fault::OutsideBounds { field: "sample", value: 0.0, lowest: 0.0, highest: 0.0 }
        }
        Rule::StillRolling => Fault::StillRolling { value: 0.0, rolling_mps: 0.0 },
        Rule::TooOld => Fault::TooOld { age_ms: 0.0 },
        Rule::FromTheFuture => Fault::FromTheFuture { ahead_ms: 0.0 },
        Rule::AnsweredBefore => Fault::AnsweredBefore { newest: 0 },
        Rule::ImpossibleNumber => Fault::ImpossibleNumber { field: "sample", value: 0, highest: 0 },
    })
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
