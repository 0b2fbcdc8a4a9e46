//! Samples of recordings by version 0.1, read into the layouts of today by the names of their fields.
//!
//! The table of layouts of that version is `earlier/layouts-0.1.txt`. A field that is in both layouts keeps its value; one
//! that is new is zero, and the beams of a scan are those of the one scanner that there was.

use std::collections::BTreeMap;

use bytemuck::{bytes_of_mut, from_bytes_mut};
use shared_types::{Header, LayoutRow, Layouts, Scan, ScanGeometry, StageStamps, Topic, differences};

/// The layouts of version 0.1.
const EARLIER: &str = include_str!("earlier/layouts-0.1.txt");
/// How many stages its header had stamps of.
const STAGES: usize = 5;

/// How samples of one topic become those of today.
#[derive(Debug)]
pub(crate) struct EarlierLayout {
    topic: Topic,
    /// Size of a recorded sample [bytes].
    pub(crate) size: usize,
    moves: Vec<Move>,
}

/// Numbers that follow each other, before and now.
#[derive(Debug)]
struct Move {
    from: Place,
    to: Place,
}

/// Numbers of one kind that follow each other.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Place {
    offset: usize,
    size: usize,
    count: usize,
}

/// The recorded layouts, if they are those of version 0.1.
pub(crate) fn is_earlier(recorded: &Layouts) -> bool {
    EARLIER.parse::<Layouts>().is_ok_and(|earlier| {
        let same = |topic: &Topic| differences(&earlier, recorded, topic.name()).is_empty();
        !recorded.rows.is_empty() && Topic::ALL.iter().filter(|topic| has(recorded, **topic)).all(same)
    })
}

/// Whether a table has a topic.
pub(crate) fn has(layouts: &Layouts, topic: Topic) -> bool {
    layouts.rows.iter().any(|row| row.topic == topic.name())
}

impl EarlierLayout {
    /// How samples of a topic in `recorded` become those of today.
    pub(crate) fn new(recorded: &Layouts, topic: Topic) -> Self {
        let [before, now] = [recorded, &Layouts::built_in()].map(|layouts| places(layouts, topic));
        let size = recorded.rows.iter().find(|row| row.topic == topic.name()).map_or(0, |row| row.size);
        let moved =
            |(path, from): (&String, &Place)| Some(Move { from: from.clone(), to: now.get(path)?.clone() });
        Self { topic, size, moves: before.iter().filter_map(moved).collect() }
    }

    /// Writes the sample of today with what `earlier` holds to `sample`.
    pub(crate) fn convert(&self, earlier: &[u8], sample: &mut [u8]) {
        sample.fill(0);
        for Move { from, to } in &self.moves {
            for index in 0..from.count.min(to.count) {
                // Whole numbers have become wider at most; the rest of a wider one is zero.
                let (from_at, to_at) = (from.offset + index * from.size, to.offset + index * to.size);
                let bytes = from.size.min(to.size);
                sample[to_at..to_at + bytes].copy_from_slice(&earlier[from_at..from_at + bytes]);
            }
        }
        if self.topic == Topic::Scan {
            from_bytes_mut::<Scan>(sample).set_geometry(ScanGeometry::URG_04LX);
        }
        (self.topic.sample_type().header_mut)(sample).layout = self.topic.layout();
    }
}

/// Where the numbers of a sample are, by their names with the indices of the structs around them.
fn places(layouts: &Layouts, topic: Topic) -> BTreeMap<String, Place> {
    let rows: Vec<&LayoutRow> = layouts.rows.iter().filter(|row| row.topic == topic.name()).collect();
    let mut found = BTreeMap::new();
    add(&rows, "", "", 0, &mut found);
    found
}

/// Adds the numbers directly in the struct `around`, and in those within it.
fn add(rows: &[&LayoutRow], around: &str, path: &str, shift: usize, found: &mut BTreeMap<String, Place>) {
    for row in rows {
        let Some(name) = row.field.strip_prefix(around).filter(|name| !name.contains('.')) else { continue };
        let inner = format!("{}.", row.field);
        if !rows.iter().any(|row| row.field.starts_with(&inner)) {
            let place = Place { offset: shift + row.offset, size: row.size, count: row.count };
            found.insert(format!("{path}{name}"), place);
            continue;
        }
        for index in 0..row.count {
            add(rows, &inner, &format!("{path}{name}[{index}]."), shift + index * row.size, found);
        }
    }
}

/// Makes room in a sample of a topic that a system added for the stamps that its header has today.
pub(crate) fn widen_header(sample: &mut Vec<u8>) {
    let mut header = Header::default();
    let added = header.chain.len().saturating_sub(STAGES) * size_of::<StageStamps>();
    let end = bytes_of_mut(&mut header).len() - added;
    if let Some(start) = sample.get(..end) {
        let mut wider = start.to_vec();
        wider.resize(end + added, 0);
        sample.splice(..end, wider);
    }
}
