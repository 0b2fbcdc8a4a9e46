//! The layouts of all samples as a table that crosses process borders, and the first difference between two.
//!
//! The bus compares only name, size and alignment of a type, so it would accept two exchanged fields. Therefore the
//! orchestrator writes its table into the directory of the system. Each process compares it with the table of its own
//! compiler before it joins.
//!
//! One row is one field. A struct comes before its fields, and the first element of an array stands for all. A change
//! of meaning alone, with the same name, place and type, is not detected.

use std::fmt;
use std::str::FromStr;

use crate::describe::{Field, Kind};
use crate::{Role, TOPICS, Topic};

/// First line of the table as text; the number changes with the form of the lines.
const TITLE: &str = "scanloop layouts 1";
/// Stands for the sample itself where a field is named.
const WHOLE: &str = ".";

/// One field of one sample, or a sample as a whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LayoutRow {
    /// Name of the topic.
    pub topic: String,
    /// The field with the structs around it, `header.chain.woken_ns`; `.` for the sample as a whole.
    pub field: String,
    /// `u8`, `u16`, `u32`, `u64`, `i32`, `f64`, or the name of a struct.
    pub kind: String,
    /// Number of elements, 1 for no array.
    pub count: usize,
    /// Size of one element [bytes].
    pub size: usize,
    /// Offset from the start of the sample [bytes].
    pub offset: usize,
}

/// Layouts of samples.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layouts {
    /// The rows in the order of the fields, topic by topic.
    pub rows: Vec<LayoutRow>,
}

/// The first field in which two layouts differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Name of the topic.
    pub topic: String,
    /// The field, `.` for the sample as a whole.
    pub field: String,
    /// What differs.
    pub what: Deviation,
}

/// What differs; "mine" is the table of the process, "theirs" that of the system.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deviation {
    /// The system has the field, the process has not.
    Missing,
    /// The process has the field, the system has not.
    Extra,
    /// The process has another name in its place.
    Renamed {
        /// Its name in the process.
        mine: String,
    },
    /// It begins elsewhere [bytes].
    Offset(Both<usize>),
    /// It is of another type.
    Type(Both<String>),
    /// It has more or fewer elements.
    Count(Both<usize>),
    /// An element has another size [bytes].
    Size(Both<usize>),
}

/// Two values that should be the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Both<T> {
    /// In the process.
    pub mine: T,
    /// In the system.
    pub theirs: T,
}

impl Layouts {
    /// The layouts that this program was built with.
    pub fn built_in() -> Self {
        let rows = |topic: Topic| rows_of(topic.name(), topic.type_name(), topic.size(), topic.fields());
        Self { rows: TOPICS.into_iter().flat_map(rows).collect() }
    }

    fn of<'a>(&'a self, topic: &'a str) -> Vec<&'a LayoutRow> {
        self.rows.iter().filter(|row| row.topic == topic).collect()
    }
}

/// The topics whose samples a process of `role` may read or write.
pub fn topics_of(role: Role) -> impl Iterator<Item = Topic> {
    let shared = [Topic::Heartbeat, Topic::Directive, Topic::Checkpoint, Topic::Journal];
    role.reads().iter().chain(role.writes()).copied().chain(shared)
}

/// The first field of `topics` in which the layouts of a process differ from those of the system.
pub fn difference(
    mine: &Layouts,
    theirs: &Layouts,
    topics: impl IntoIterator<Item = Topic>,
) -> Option<Difference> {
    topics.into_iter().find_map(|topic| difference_in(mine, theirs, topic.name()))
}

/// [`difference`] of one topic, also one that a system file added.
pub fn difference_in(mine: &Layouts, theirs: &Layouts, topic: &str) -> Option<Difference> {
    let (field, what) = deviation(&mine.of(topic), &theirs.of(topic))?;
    Some(Difference { topic: topic.to_owned(), field, what })
}

/// All fields of a topic that were added, removed or changed; where only places differ, the first.
pub fn differences(mine: &Layouts, theirs: &Layouts, topic: &str) -> Vec<Difference> {
    let (my, their) = (mine.of(topic), theirs.of(topic));
    let named = |rows: &[&LayoutRow], row: &LayoutRow| rows.iter().position(|other| other.field == row.field);
    let mut found = Vec::new();
    for row in &their {
        let what = match named(&my, row).map(|index| my[index]) {
            None => Deviation::Missing,
            Some(own) if own.kind != row.kind && !is_struct(own) => {
                Deviation::Type(Both { mine: own.kind.clone(), theirs: row.kind.clone() })
            }
            Some(own) if own.count != row.count => {
                Deviation::Count(Both { mine: own.count, theirs: row.count })
            }
            Some(_) => continue,
        };
        found.push((row.field.clone(), what));
    }
    let extra = my.iter().filter(|row| named(&their, row).is_none());
    found.extend(extra.map(|row| (row.field.clone(), Deviation::Extra)));
    if found.is_empty() {
        found.extend(deviation(&my, &their));
    }
    found.into_iter().map(|(field, what)| Difference { topic: topic.to_owned(), field, what }).collect()
}

fn is_struct(row: &LayoutRow) -> bool {
    !SCALARS.contains(&row.kind.as_str())
}

fn deviation(mine: &[&LayoutRow], theirs: &[&LayoutRow]) -> Option<(String, Deviation)> {
    // A struct as a whole is reported only where none of its fields differs.
    let mut whole: Option<(&str, Deviation)> = None;
    let found = |(field, what): (&str, Deviation)| Some((field.to_owned(), what));
    for index in 0..mine.len().max(theirs.len()) {
        let (my, their) = (mine.get(index), theirs.get(index));
        let inside = |field: &str| [my, their].into_iter().flatten().any(|row| within(&row.field, field));
        if let Some(earlier) = whole.take_if(|(field, _)| !inside(field)) {
            return found(earlier);
        }
        let (my, their) = match (my, their) {
            (Some(my), Some(their)) => (my, their),
            (None, Some(their)) => return found((&their.field, Deviation::Missing)),
            (Some(my), None) => return found((&my.field, Deviation::Extra)),
            (None, None) => break,
        };
        if my.field != their.field {
            return found(misplaced(my, their, mine, theirs));
        }
        let field = my.field.as_str();
        let kinds = Deviation::Type(Both { mine: my.kind.clone(), theirs: their.kind.clone() });
        let both = is_struct(my) && is_struct(their);
        if my.kind != their.kind && !both {
            return found((field, kinds));
        }
        if my.count != their.count {
            return found((field, Deviation::Count(Both { mine: my.count, theirs: their.count })));
        }
        if my.offset != their.offset {
            return found((field, Deviation::Offset(Both { mine: my.offset, theirs: their.offset })));
        }
        let sizes = Deviation::Size(Both { mine: my.size, theirs: their.size });
        match (my.kind != their.kind, my.size != their.size) {
            (true, _) => whole = Some((field, kinds)),
            (_, true) if both => whole = Some((field, sizes)),
            (_, true) => return found((field, sizes)),
            _ => {}
        }
    }
    whole.and_then(found)
}

/// Why two rows in one place have different names.
fn misplaced<'a>(
    my: &'a LayoutRow,
    their: &'a LayoutRow,
    mine: &[&LayoutRow],
    theirs: &[&LayoutRow],
) -> (&'a str, Deviation) {
    let find = |rows: &[&LayoutRow], row: &LayoutRow| {
        rows.iter().find(|other| other.field == row.field).map(|other| other.offset)
    };
    match (find(mine, their), find(theirs, my)) {
        // Both tables have both fields: the fields were exchanged.
        (Some(offset), Some(_)) => {
            (&their.field, Deviation::Offset(Both { mine: offset, theirs: their.offset }))
        }
        (Some(_), None) => (&my.field, Deviation::Extra),
        (None, Some(_)) => (&their.field, Deviation::Missing),
        (None, None) => (&their.field, Deviation::Renamed { mine: my.field.clone() }),
    }
}

const SCALARS: [&str; 6] = ["u8", "u16", "u32", "u64", "i32", "f64"];

/// Whether `field` is `outer` or lies in it.
fn within(field: &str, outer: &str) -> bool {
    outer == WHOLE || field.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// The rows of one topic: the sample as a whole, then its fields.
pub(crate) fn rows_of(topic: &str, kind: &str, size: usize, fields: &'static [Field]) -> Vec<LayoutRow> {
    let (topic, kind) = (topic.to_owned(), kind.to_owned());
    let whole = LayoutRow { topic, field: WHOLE.to_owned(), kind, count: 1, size, offset: 0 };
    let mut rows = vec![whole.clone()];
    add(&mut rows, &whole.topic, "", 0, fields);
    rows
}

fn add(rows: &mut Vec<LayoutRow>, topic: &str, around: &str, start: usize, fields: &'static [Field]) {
    for Field { name, offset, kind, .. } in fields {
        let (element, count) = match kind {
            Kind::Array(element, count) => (*element, *count),
            single => (single, 1),
        };
        let (kind, inner): (_, &[Field]) = match element {
            Kind::Scalar(name) => (*name, &[]),
            Kind::Struct(name, fields) => (*name, fields),
            Kind::Array(..) => unreachable!("no sample has an array of arrays"),
        };
        let (field, offset) = (format!("{around}{name}"), start + offset);
        rows.push(LayoutRow {
            topic: topic.to_owned(),
            field: field.clone(),
            kind: kind.to_owned(),
            count,
            size: element.size(),
            offset,
        });
        add(rows, topic, &format!("{field}."), offset, inner);
    }
}

/// One line per row: topic, field, type, count, size, offset.
impl fmt::Display for Layouts {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "{TITLE}")?;
        for LayoutRow { topic, field, kind, count, size, offset } in &self.rows {
            writeln!(formatter, "{topic} {field} {kind} {count} {size} {offset}")?;
        }
        Ok(())
    }
}

/// A line that is no row of a table of layouts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotALayout {
    /// Number of the line, from 1.
    pub line: usize,
    /// Its content.
    pub text: String,
}

impl fmt::Display for NotALayout {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "line {}: `{}` is no row of a table of layouts", self.line, self.text)
    }
}

impl std::error::Error for NotALayout {}

impl FromStr for Layouts {
    type Err = NotALayout;

    fn from_str(text: &str) -> Result<Self, NotALayout> {
        let mut lines = text.lines().enumerate();
        let refuse = |index: usize, text: &str| NotALayout { line: index + 1, text: text.to_owned() };
        match lines.next() {
            Some((_, TITLE)) => {}
            other => return Err(refuse(0, other.map_or("", |(_, line)| line))),
        }
        lines
            .map(|(index, line)| row(line).ok_or_else(|| refuse(index, line)))
            .collect::<Result<_, _>>()
            .map(|rows| Self { rows })
    }
}

fn row(line: &str) -> Option<LayoutRow> {
    let mut columns = line.split(' ');
    let mut text = || columns.next().map(str::to_owned);
    let (topic, field, kind) = (text()?, text()?, text()?);
    let mut number = || text()?.parse().ok();
    let (count, size, offset) = (number()?, number()?, number()?);
    columns.next().is_none().then_some(LayoutRow { topic, field, kind, count, size, offset })
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, field, what } = self;
        match field.as_str() {
            WHOLE => write!(formatter, "topic {topic}: the sample ")?,
            _ => write!(formatter, "topic {topic}: field {field} ")?,
        }
        match what {
            Deviation::Missing => write!(formatter, "is missing in this process"),
            Deviation::Extra => write!(formatter, "is not in the samples of the system"),
            Deviation::Renamed { mine } => write!(formatter, "is called {mine} in this process"),
            Deviation::Offset(Both { mine, theirs }) => {
                write!(formatter, "begins at byte {mine} in this process, at {theirs} in the system")
            }
            Deviation::Type(Both { mine, theirs }) => {
                write!(formatter, "is of type {mine} in this process, {theirs} in the system")
            }
            Deviation::Count(Both { mine, theirs }) => {
                write!(formatter, "has {mine} elements in this process, {theirs} in the system")
            }
            Deviation::Size(Both { mine, theirs }) => {
                write!(formatter, "has {mine} bytes in this process, {theirs} in the system")
            }
        }
    }
}

#[cfg(test)]
mod tests;
