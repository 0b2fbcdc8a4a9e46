//! Samples that their readers dropped or refused because of their content: by writer, reader and rule.
//!
//! A heartbeat has the newest such sample of each input and their number. Where samples fail several rules between two
//! heartbeats, all of them count for the rule of the newest.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared_types::{Heartbeat, Refusal, Role, Rule, Topic};

/// Maximum number of rows; later ones are not stored.
const MAX_ROWS: usize = 100;

/// Samples of one writer that failed one rule at one reader.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RefusedRow {
    /// Name of the topic.
    pub topic: String,
    /// Role of the process that wrote them.
    pub writer: String,
    /// Its incarnation.
    pub incarnation: u32,
    /// Role of the process that dropped or refused them.
    pub reader: String,
    /// The rule that they failed.
    pub rule: String,
    /// The field at fault.
    pub field: String,
    /// The value of the newest; 0 where it was not finite.
    pub value: f64,
    /// How many.
    pub count: u64,
    /// Scan of the first.
    pub first_scan: u64,
    /// Scan of the newest.
    pub newest_scan: u64,
}

/// Samples of a row that were dropped or refused since the last heartbeat.
#[derive(Debug, Clone, PartialEq)]
pub struct NewRefusal {
    /// Whether they are the first of the row.
    pub is_first: bool,
    /// Role of the process that wrote the sample.
    pub writer: Role,
    /// Role of the process that dropped or refused it.
    pub reader: Role,
    /// The rule that it failed.
    pub rule: Rule,
    /// The row with the new samples only.
    pub row: RefusedRow,
}

/// All rows of a run.
#[derive(Debug, Clone, Default)]
pub(super) struct Refused {
    rows: Vec<RefusedRow>,
    new: Vec<NewRefusal>,
    /// Counts of the heartbeat before, by incarnation of the reader and topic.
    counted: BTreeMap<(u32, Topic), u64>,
}

impl Refused {
    /// Adds what a process dropped and refused since its last heartbeat. With `midway` the counts of its first
    /// heartbeat belong to another orchestrator.
    pub(super) fn add_heartbeat(&mut self, role: Role, heartbeat: &Heartbeat, midway: bool) {
        let incarnation = heartbeat.header.incarnation;
        for (topic, refusal) in role.reads().iter().zip(&heartbeat.refused) {
            let first = if midway { refusal.count } else { 0 };
            let counted = self.counted.entry((incarnation, *topic)).or_insert(first);
            let count = refusal.count.saturating_sub(*counted);
            *counted = refusal.count.max(*counted);
            if count > 0
                && let Some(writer) = topic.writer()
            {
                let row = RefusedRow { count, ..row(*topic, writer, role, refusal) };
                self.add(row, writer, role, refusal.failed());
            }
        }
    }

    /// Forgets a process that is not followed any longer.
    pub(super) fn forget(&mut self, incarnation: u32) {
        self.counted.retain(|(of, _), _| *of != incarnation);
    }

    /// How many processes are followed.
    #[cfg(test)]
    pub(super) fn readers(&self) -> usize {
        self.counted.len()
    }

    /// The rows, in the order of their first samples.
    pub(super) fn rows(&self) -> &[RefusedRow] {
        &self.rows
    }

    /// What was dropped and refused since the last call.
    pub(super) fn take_new(&mut self) -> Vec<NewRefusal> {
        std::mem::take(&mut self.new)
    }

    fn add(&mut self, row: RefusedRow, writer: Role, reader: Role, rule: Rule) {
        let known = self.rows.iter_mut().find(|known| known.is_same(&row));
        if self.new.len() >= MAX_ROWS {
            self.new.remove(0);
        }
        self.new.push(NewRefusal { is_first: known.is_none(), writer, reader, rule, row: row.clone() });
        if let Some(known) = known {
            known.count += row.count;
            (known.value, known.newest_scan) = (row.value, row.newest_scan);
        } else if self.rows.len() < MAX_ROWS {
            self.rows.push(row);
        }
    }
}

impl RefusedRow {
    /// The rule, field and value as text, like `not verified (verified = 0)`.
    pub fn fault(&self) -> String {
        let rule = self.rule.replace('_', " ");
        match (self.field.as_str(), self.rule == Rule::NotFinite.name()) {
            ("", _) => rule,
            (field, true) => format!("{rule} ({field})"),
            (field, false) => format!("{rule} ({field} = {})", self.value),
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        (&self.topic, self.incarnation, &self.reader) == (&other.topic, other.incarnation, &other.reader)
            && (&self.rule, &self.field) == (&other.rule, &other.field)
    }
}

impl std::fmt::Display for RefusedRow {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { topic, writer, incarnation, reader, count, .. } = self;
        write!(
            formatter,
            "{count} {topic} of {writer} (incarnation {incarnation}) dropped by {reader}: {}",
            self.fault()
        )
    }
}

fn row(topic: Topic, writer: Role, reader: Role, refusal: &Refusal) -> RefusedRow {
    RefusedRow {
        topic: topic.name().to_owned(),
        writer: writer.name().to_owned(),
        incarnation: refusal.incarnation,
        reader: reader.name().to_owned(),
        rule: refusal.failed().name().to_owned(),
        field: refusal.field_name().to_owned(),
        value: if refusal.value.is_finite() { refusal.value } else { 0.0 },
        count: refusal.count,
        first_scan: refusal.scan_id,
        newest_scan: refusal.scan_id,
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{Fault, Header};

    use super::*;

    #[test]
    fn refused_samples_are_added_up_by_writer_and_rule_and_counted_once() {
        let mut refused = Refused::default();
        let mut heartbeat = Heartbeat::default();
        heartbeat.header.incarnation = 5;
        let unverified = Fault::NotVerified { value: 0 };
        for (scan_id, incarnation, fault) in [
            (1, 4, unverified),
            (2, 4, unverified),
            (3, 4, Fault::NotFinite { field: "steering_rad" }),
            (4, 6, unverified),
        ] {
            let header = Header { scan_id, incarnation, ..Header::default() };
            heartbeat.refused[0].note(&header, &fault);
            refused.add_heartbeat(Role::Actuator, &heartbeat, false);
            refused.add_heartbeat(Role::Actuator, &heartbeat, false);
        }
        let rows: Vec<String> = refused.rows().iter().map(ToString::to_string).collect();
        assert_eq!(
            rows,
            [
                "2 command of controller (incarnation 4) dropped by actuator: not verified (verified = 0)",
                "1 command of controller (incarnation 4) dropped by actuator: not finite (steering_rad)",
                "1 command of controller (incarnation 6) dropped by actuator: not verified (verified = 0)",
            ]
        );
        assert_eq!((refused.rows()[0].first_scan, refused.rows()[0].newest_scan), (1, 2));
        let new = refused.take_new();
        let first: Vec<bool> = new.iter().map(|refusal| refusal.is_first).collect();
        assert_eq!(first, [true, false, true, true]);
        assert_eq!((new[0].writer, new[0].rule), (Role::Controller, Rule::NotVerified));
        assert_eq!(refused.take_new(), []);
    }

    #[test]
    fn what_another_orchestrator_has_counted_is_not_counted_again() {
        let mut refused = Refused::default();
        let mut heartbeat = Heartbeat::default();
        heartbeat.refused[0].note(&Header::default(), &Fault::NotVerified { value: 0 });
        refused.add_heartbeat(Role::Actuator, &heartbeat, true);
        assert_eq!(refused.rows(), []);
    }
}
