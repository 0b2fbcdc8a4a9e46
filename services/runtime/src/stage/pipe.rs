//! A stage that a simulation drives through the standard input of its program, so that any program with a stage can be
//! simulated. Both ends are programs of one machine, built against the same samples; the first answer shows that.

use std::io::{self, Read, Write};

use bytemuck::{cast_slice, cast_slice_mut};
use serde::de::DeserializeOwned;
use shared_types::{
    AnySample, AnyStage, Checkpoint, JournalKind, Layouts, Stage, StageEvent, Stopwatch, TOPICS, difference,
};

use crate::RuntimeError;

/// Is `1` for a stage that is driven through its standard input.
pub const PIPE_VARIABLE: &str = "SCANLOOP_STAGE_PIPE";
/// No message is larger [bytes].
pub const MAX_MESSAGE: usize = 1 << 24;

/// What a simulation asks of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Ask {
    /// Begin: the scan period [ns], 8 bytes, then the table of settings as TOML. The answer is what is wrong with it, or
    /// the [`StageOutline`].
    Begin = 1,
    /// Take a sample: number of its topic and time [ns], 8 bytes each, then the sample. No answer.
    Take = 2,
    /// Follow an event: kind, value, and whether the process is in charge, 8 bytes each. The answer is one byte.
    Follow = 3,
    /// The output, by the scan, 8 bytes. The answer is the sample, or empty.
    Publish = 4,
    /// The state. The answer is a checkpoint, or empty.
    Save = 5,
    /// Continue from a checkpoint. The answer is what is wrong with it, or empty.
    Resume = 6,
    /// Why the last sample was refused. The answer is the number of the rule, 4 bytes, or empty.
    Refusal = 7,
    /// Whether it holds the wheels for a stop. The answer is one byte.
    IsStopped = 8,
}

impl Ask {
    const ALL: [Self; 8] = [
        Self::Begin,
        Self::Take,
        Self::Follow,
        Self::Publish,
        Self::Save,
        Self::Resume,
        Self::Refusal,
        Self::IsStopped,
    ];
}

/// What the program of a stage tells of it at its beginning: numbers of 4 bytes each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StageOutline {
    /// Number of its role.
    pub role: u32,
    /// Number of the topic of its output.
    pub output: u32,
    /// Whether it holds the wheels.
    pub holds_wheels: bool,
    /// Whether it takes orders.
    pub takes_orders: bool,
    /// Numbers of the topics of [`Stage::ANSWERS`].
    pub answers: Vec<u32>,
    /// Numbers of the topics of [`Stage::NOTES`].
    pub notes: Vec<u32>,
    /// Numbers of the topics of [`Stage::later`].
    pub later: Vec<u32>,
}

impl StageOutline {
    fn of(stage: &dyn AnyStage) -> Self {
        let shape = stage.shape();
        let topics = |of: &[&shared_types::SampleType]| of.iter().map(|of| of.topic as u32).collect();
        Self {
            role: shape.role.wire(),
            output: shape.output.topic as u32,
            holds_wheels: shape.holds_wheels,
            takes_orders: shape.takes_orders,
            answers: topics(shape.answers),
            notes: topics(shape.notes),
            later: topics(shape.later),
        }
    }

    fn to_numbers(&self) -> Vec<u32> {
        let flags = [self.holds_wheels, self.takes_orders].map(u32::from);
        let [answers, notes] = [&self.answers, &self.notes].map(|topics| topics.len() as u32);
        let mut numbers = vec![self.role, self.output, flags[0], flags[1], answers, notes];
        numbers.extend(self.answers.iter().chain(&self.notes).chain(&self.later));
        numbers
    }

    /// Reads it back; `None` when it is none.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let numbers: Vec<u32> = bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect();
        let (&[role, output, holds_wheels, takes_orders, answers, notes], topics) =
            numbers.split_first_chunk()?;
        let (answers, others) = topics.split_at_checked(answers as usize)?;
        let (notes, later) = others.split_at_checked(notes as usize)?;
        let is_known = topics.iter().chain([&output]).all(|topic| (*topic as usize) < TOPICS.len());
        is_known.then(|| Self {
            role,
            output,
            holds_wheels: holds_wheels == 1,
            takes_orders: takes_orders == 1,
            answers: answers.to_vec(),
            notes: notes.to_vec(),
            later: later.to_vec(),
        })
    }
}

/// Writes one message: its kind, its length, its bytes.
///
/// # Errors
/// Errors of the pipe.
pub fn write_message(to: &mut dyn Write, kind: u8, parts: &[&[u8]]) -> io::Result<()> {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    to.write_all(&[kind])?;
    to.write_all(&(length as u32).to_ne_bytes())?;
    parts.iter().try_for_each(|part| to.write_all(part))
}

/// Reads one message into `place`, whose bytes lie where a sample may lie; returns its kind and its length.
///
/// # Errors
/// Errors of the pipe, and a message that is too long.
pub fn read_message(from: &mut dyn Read, place: &mut Vec<u64>) -> io::Result<(u8, usize)> {
    let (mut kind, mut length) = ([0; 1], [0; 4]);
    from.read_exact(&mut kind)?;
    from.read_exact(&mut length)?;
    let length = u32::from_ne_bytes(length) as usize;
    if length > MAX_MESSAGE {
        return Err(io::Error::other(format!("a message of {length} bytes")));
    }
    place.resize(length.div_ceil(8), 0);
    from.read_exact(&mut cast_slice_mut(place)[..length])?;
    Ok((kind[0], length))
}

/// The first message of a program: the layouts that it was built with. Says which field differs.
///
/// # Errors
/// The difference as text.
pub fn verify_greeting(bytes: &[u8]) -> Result<(), String> {
    let text = std::str::from_utf8(bytes).map_err(|error| error.to_string())?;
    let theirs: Layouts =
        text.parse().map_err(|_| "it does not answer as the program of a stage does".to_owned())?;
    match difference(&theirs, &Layouts::built_in(), TOPICS) {
        Some(found) => Err(RuntimeError::Layout(found).to_string()),
        None => Ok(()),
    }
}

/// Whether the program was started for a simulation.
pub(super) fn is_wanted() -> bool {
    std::env::var(PIPE_VARIABLE).is_ok_and(|value| value == "1")
}

/// A stage with settings in TOML.
pub(super) fn begin<T: Stage>(period_ns: u64, settings: &str) -> Result<Box<dyn AnyStage>, String>
where
    T::Settings: DeserializeOwned,
{
    let settings: T::Settings = toml::from_str(settings).map_err(|error| error.to_string())?;
    let stage = T::begin(settings, period_ns).map_err(|invalid| invalid.to_string())?;
    Ok(Box::new(stage))
}

/// Makes a stage.
type Begin<'b> = dyn FnMut(u64, &str) -> Result<Box<dyn AnyStage>, String> + 'b;

/// Does what a simulation asks until it closes the pipe.
pub(super) fn serve(begin: &mut Begin<'_>) -> Result<(), RuntimeError> {
    let error = |error: io::Error| RuntimeError::bus("talk to the simulation", error);
    let (mut from, mut to) = (io::BufReader::new(io::stdin().lock()), io::stdout().lock());
    write_message(&mut to, 0, &[Layouts::built_in().to_string().as_bytes()]).map_err(error)?;
    to.flush().map_err(error)?;
    let (mut stage, mut place) = (None, Vec::new());
    loop {
        let (kind, length) = match read_message(&mut from, &mut place) {
            Ok(message) => message,
            Err(end) if end.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            Err(other) => return Err(error(other)),
        };
        let Some(ask) = Ask::ALL.into_iter().find(|ask| *ask as u8 == kind) else {
            return Err(error(io::Error::other(format!("message {kind} is not known"))));
        };
        let message = &cast_slice::<u64, u8>(&place)[..length];
        let Some(answer) = answer(&mut stage, begin, ask, message) else { continue };
        write_message(&mut to, 0, &[&answer]).map_err(error)?;
        to.flush().map_err(error)?;
    }
}

/// The answer to one message; `None` for one that gets none. Before its beginning a stage answers nothing.
fn answer(
    stage: &mut Option<Box<dyn AnyStage>>,
    begin: &mut Begin<'_>,
    ask: Ask,
    message: &[u8],
) -> Option<Vec<u8>> {
    let number = |index: usize| -> u64 {
        message.get(8 * index..8 * index + 8).map_or(0, bytemuck::pod_read_unaligned)
    };
    if ask == Ask::Begin {
        let settings = std::str::from_utf8(message.get(8..)?).unwrap_or_default();
        return Some(match begin(number(0), settings) {
            Ok(begun) => {
                let outline = StageOutline::of(&*begun);
                *stage = Some(begun);
                [&[1], cast_slice::<u32, u8>(&outline.to_numbers())].concat()
            }
            Err(invalid) => [&[0], invalid.as_bytes()].concat(),
        });
    }
    let Some(stage) = stage else { return (ask != Ask::Take).then(Vec::new) };
    match ask {
        Ask::Begin => None,
        Ask::Take => {
            let of = TOPICS.get(number(0) as usize)?.sample_type();
            let sample = message.get(16..).filter(|sample| sample.len() == of.size)?;
            stage.take(AnySample::new(of, sample), number(1));
            None
        }
        Ask::Follow => {
            let kind = JournalKind::try_from(number(0) as u32).ok();
            let event = match kind.and_then(|kind| StageEvent::of(kind, number(1))) {
                Some(StageEvent::StateLost { .. }) => StageEvent::StateLost { in_charge: number(2) == 1 },
                event => event?,
            };
            Some(vec![u8::from(stage.follow(event))])
        }
        Ask::Publish => {
            let mut output = Vec::new();
            stage.publish(number(0), &Stopwatch::standing(), &mut |bytes| output = bytes.to_vec());
            Some(output)
        }
        Ask::Save => {
            Some(stage.checkpoint().map_or_else(Vec::new, |state| bytemuck::bytes_of(&state).to_vec()))
        }
        Ask::Resume => Some(match bytemuck::try_pod_read_unaligned::<Checkpoint>(message) {
            Ok(checkpoint) => stage.resume(&checkpoint).err().unwrap_or_default().into_bytes(),
            Err(error) => error.to_string().into_bytes(),
        }),
        Ask::Refusal => {
            let rule = stage.refusal().map(|fault| fault.rule().wire());
            Some(rule.map_or_else(Vec::new, |rule| rule.to_ne_bytes().to_vec()))
        }
        Ask::IsStopped => Some(vec![u8::from(stage.is_stopped())]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_back_and_one_that_is_too_long_is_refused() {
        let (mut pipe, mut place) = (Vec::new(), Vec::new());
        write_message(&mut pipe, 7, &[b"abc", b"defghi"]).unwrap();
        assert_eq!(read_message(&mut pipe.as_slice(), &mut place).unwrap(), (7, 9));
        assert_eq!(&cast_slice::<u64, u8>(&place)[..9], b"abcdefghi");
        pipe[1..5].copy_from_slice(&u32::MAX.to_ne_bytes());
        assert!(read_message(&mut pipe.as_slice(), &mut place).unwrap_err().to_string().contains("bytes"));
    }

    #[test]
    fn an_outline_is_read_back_and_an_unknown_topic_is_none() {
        let outline = StageOutline {
            role: 2,
            output: 3,
            holds_wheels: true,
            takes_orders: false,
            answers: vec![0, 2],
            notes: vec![5],
            later: vec![0],
        };
        let mut numbers = outline.to_numbers();
        assert_eq!(StageOutline::read(cast_slice(&numbers)), Some(outline));
        numbers[1] = 99;
        assert_eq!(StageOutline::read(cast_slice(&numbers)), None);
        assert_eq!(StageOutline::read(&[1, 2, 3]), None);
    }

    #[test]
    fn a_program_of_other_layouts_is_named_by_the_field() {
        assert_eq!(verify_greeting(Layouts::built_in().to_string().as_bytes()), Ok(()));
        let mut other = Layouts::built_in();
        other.rows.iter_mut().find(|row| row.topic == "pose" && row.field == "nis").unwrap().offset += 8;
        let wrong = verify_greeting(other.to_string().as_bytes()).unwrap_err();
        assert!(wrong.contains("topic pose: field nis"), "{wrong}");
        assert!(verify_greeting(b"Hello").is_err());
    }
}
