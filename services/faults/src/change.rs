//! What a fault makes of one sample, on its bytes: so it works for each topic, and for samples from the bus.

use std::mem::size_of;

use shared_types::{Field, Header, Kind, SampleType};

use crate::sample_fault::{SampleAction, SampleFault};

/// Copies of a sample that a flood adds.
const FLOOD: u64 = 99;

/// A field that the samples of a topic do not have, or that holds no number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{topic} has no number `{field}`")]
pub struct UnknownField {
    /// The topic.
    pub topic: String,
    /// The field.
    pub field: String,
}

/// What arrives in place of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Changed {
    /// Nothing.
    Nothing,
    /// The sample, this much later [ns].
    Once(u64),
    /// The sample twice.
    Twice,
    /// The sample, after the next one.
    AfterNext,
    /// The sample and so many more, each under a new number.
    Flood(u64),
}

/// A place of a number in a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Number {
    offset: usize,
    scalar: &'static str,
}

/// Applies a [`SampleFault`] to the samples of its topic, one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    action: SampleAction,
    value: f64,
    delay_ns: u64,
    numbers: Vec<Number>,
    of: &'static str,
    /// The last good sample.
    last: Vec<u8>,
    /// Whether the next sample is to be held back.
    holds: bool,
}

impl Change {
    /// The change that a fault makes.
    ///
    /// # Errors
    /// A field that the topic does not have.
    pub fn new(fault: &SampleFault) -> Result<Self, UnknownField> {
        let of = fault.topic.sample_type();
        let mut numbers = Vec::new();
        for field in &fault.fields {
            let unknown = || UnknownField { topic: fault.topic.name().to_owned(), field: field.clone() };
            collect(&find(of.fields, field).ok_or_else(unknown)?, &mut numbers);
        }
        let delay_ns = fault.delay_ms * 1_000_000;
        let (action, value) = (fault.action, fault.value);
        Ok(Self { action, value, delay_ns, numbers, of: of.name, last: Vec::new(), holds: false })
    }

    /// Keeps a sample from before the fault; [`SampleAction::Freeze`] and [`SampleAction::Stale`] repeat it.
    pub fn keep(&mut self, bytes: &[u8]) {
        if matches!(self.action, SampleAction::Freeze | SampleAction::Stale) {
            self.last.clear();
            self.last.extend_from_slice(bytes);
        }
    }

    /// How much later samples arrive, if that is all that happens to them [ns].
    pub fn delay_ns(&self) -> Option<u64> {
        (self.action == SampleAction::Delay).then_some(self.delay_ns)
    }

    /// Whether it repeats a good sample and has none yet.
    pub fn needs_sample(&self) -> bool {
        matches!(self.action, SampleAction::Freeze | SampleAction::Stale) && self.last.is_empty()
    }

    /// Changes a complete sample of type `of` in place, and returns what arrives instead of it.
    ///
    /// A fault that repeats the last good sample loses samples as long as there was none.
    pub fn apply(&mut self, of: &SampleType, bytes: &mut [u8]) -> Changed {
        debug_assert_eq!(of.name, self.of, "the topic of the fault");
        match self.action {
            SampleAction::Drop => return Changed::Nothing,
            SampleAction::Delay => return Changed::Once(self.delay_ns),
            SampleAction::Duplicate => return Changed::Twice,
            SampleAction::Flood => return Changed::Flood(FLOOD),
            SampleAction::Reorder => {
                self.holds = !self.holds;
                return if self.holds { Changed::AfterNext } else { Changed::Once(0) };
            }
            SampleAction::Freeze | SampleAction::Stale if self.last.len() != bytes.len() => {
                return Changed::Nothing;
            }
            SampleAction::Freeze if !self.numbers.is_empty() => {
                self.numbers.iter().for_each(|number| number.copy(&self.last, bytes));
            }
            SampleAction::Freeze => {
                bytes[size_of::<Header>()..].copy_from_slice(&self.last[size_of::<Header>()..])
            }
            SampleAction::Stale => {
                let sequence = (of.header)(bytes).sequence;
                bytes.copy_from_slice(&self.last);
                (of.header_mut)(bytes).sequence = sequence;
            }
            SampleAction::Set => self.numbers.iter().for_each(|number| number.change(bytes, |_| self.value)),
            SampleAction::Add => {
                self.numbers.iter().for_each(|number| number.change(bytes, |was| self.moved(was, number)))
            }
            SampleAction::Scale => {
                self.numbers.iter().for_each(|number| number.change(bytes, |was| was * self.value));
            }
        }
        Changed::Once(0)
    }
}

impl Change {
    /// A number with the value added. A whole number that is not zero does not become zero by its limit, because zero often
    /// means that there is none.
    fn moved(&self, was: f64, number: &Number) -> f64 {
        let is = was + self.value;
        if number.scalar != "f64" && was > 0.0 { is.max(1.0) } else { is }
    }
}

impl Number {
    fn copy(self, from: &[u8], to: &mut [u8]) {
        let size = Kind::Scalar(self.scalar).size();
        to[self.offset..self.offset + size].copy_from_slice(&from[self.offset..self.offset + size]);
    }

    fn change(self, bytes: &mut [u8], change: impl Fn(f64) -> f64) {
        macro_rules! integer {
            ($type:ty) => {{
                let place = &mut bytes[self.offset..self.offset + size_of::<$type>()];
                let was = bytemuck::pod_read_unaligned::<$type>(place);
                // The difference, so that large numbers keep their last digits. Casts saturate.
                let difference = (change(was as f64) - was as f64).round() as i128;
                let is =
                    (was as i128 + difference).clamp(<$type>::MIN as i128, <$type>::MAX as i128) as $type;
                place.copy_from_slice(bytemuck::bytes_of(&is));
            }};
        }
        match self.scalar {
            "u8" => integer!(u8),
            "u16" => integer!(u16),
            "u32" => integer!(u32),
            "i32" => integer!(i32),
            "u64" => integer!(u64),
            _ => {
                let place = &mut bytes[self.offset..self.offset + size_of::<f64>()];
                let was = bytemuck::pod_read_unaligned::<f64>(place);
                place.copy_from_slice(bytemuck::bytes_of(&change(was)));
            }
        }
    }
}

/// A part of a sample: its place and its kind.
struct Part {
    offset: usize,
    kind: Kind,
}

/// The part with a path like `items.0.x_m`.
fn find(fields: &'static [Field], path: &str) -> Option<Part> {
    let mut names = path.split('.');
    let first = fields.iter().find(|field| Some(field.name) == names.clone().next())?;
    names.next();
    let mut part = Part { offset: first.offset, kind: first.kind };
    for name in names {
        part = match part.kind {
            Kind::Struct(_, fields) => {
                let field = fields.iter().find(|field| field.name == name)?;
                Part { offset: part.offset + field.offset, kind: field.kind }
            }
            Kind::Array(element, length) => {
                let index: usize = name.parse().ok().filter(|index| *index < length)?;
                Part { offset: part.offset + index * element.size(), kind: *element }
            }
            Kind::Scalar(_) => return None,
        };
    }
    Some(part)
}

/// All numbers of a part.
fn collect(part: &Part, numbers: &mut Vec<Number>) {
    match part.kind {
        Kind::Scalar(scalar) => numbers.push(Number { offset: part.offset, scalar }),
        Kind::Array(element, length) => (0..length).for_each(|index| {
            collect(&Part { offset: part.offset + index * element.size(), kind: *element }, numbers);
        }),
        Kind::Struct(_, fields) => fields.iter().for_each(|field| {
            collect(&Part { offset: part.offset + field.offset, kind: field.kind }, numbers);
        }),
    }
}
