//! What is where in a file.

use super::contents::{Contents, Memory};
use super::named::NamedChunks;
use super::{Damage, ReadError};

/// A piece of a file that holds messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    /// Where it begins.
    pub(super) at: u64,
    pub(super) end: u64,
    /// Which of the joined files it belongs to.
    pub(super) file: usize,
    /// Whether it is a chunk, or messages one after the other.
    pub(super) is_chunk: bool,
}

/// A place at which something is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Which of the joined files it is in.
    pub(super) file: usize,
    pub(super) at: u64,
    pub(super) what: Damage,
    /// Whether it is in front of the end of the data: behind it, nothing but the summary is lost.
    pub(super) is_data: bool,
    /// The first part behind it.
    pub(super) part: usize,
    /// Up to when messages were there, as a damaged chunk says [ns].
    pub(super) until_ns: Option<u64>,
}

/// What is where in a file.
#[derive(Debug)]
pub(super) struct Index {
    /// The joined files; mostly one.
    pub(super) files: Vec<Contents>,
    pub(super) parts: Vec<Part>,
    /// In the order of their place; none unless it is a salvage.
    pub(super) places: Vec<Place>,
    /// The chunks that the summaries name; none unless it is a salvage.
    pub(super) named: NamedChunks,
    /// The first reason for which something could not be read although it may be whole.
    pub(super) refusal: Option<ReadError>,
    /// Memory of what was read beside messages.
    pub(super) memory: Memory,
}

impl Index {
    pub(super) fn new(is_salvage: bool) -> Self {
        Self {
            files: Vec::new(),
            parts: Vec::new(),
            places: Vec::new(),
            named: NamedChunks::default(),
            refusal: None,
            memory: Memory::new(is_salvage),
        }
    }
}
