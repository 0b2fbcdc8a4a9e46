//! Samples that their readers dropped or refused because of their content: by writer, reader and rule.
//!
//! A heartbeat names the newest such sample of each input and says how many there were. Where samples fail several
//! rules between two heartbeats, all of them count for the rule of the newest.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared_types::{Heartbeat, Refusal, Role, Rule, Topic};

/// How many rows are kept; later ones are not.
const KEPT: usize = 100;

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
    /// What is told.
    pub row: RefusedRow,
}

/// All rows of a run.
#[derive(Debug, Clone, Default)]
pub(super) struct Refused {
    rows: Vec<RefusedRow>,
    news: Vec<NewRefusal>,
    /// What was told before, by incarnation of the reader and topic.
    told: BTreeMap<(u32, Topic), u64>,
}

impl Refused {
    /// A process said what it dropped and refused. With `midway` it may have said so to another orchestrator before.
    pub(super) fn add_heartbeat(&mut self, role: Role, heartbeat: &Heartbeat, midway: bool) {
        let incarnation = heartbeat.header.incarnation;
        for (topic, refusal) in role.reads().iter().zip(&heartbeat.refused) {
            let first = if midway { refusal.count } else { 0 };
            let told = self.told.entry((incarnation, *topic)).or_insert(first);
            let count = refusal.count.saturating_sub(*told);
            *told = refusal.count.max(*told);
            if count > 0
                && let Some(writer) = topic.writer()
            {
                self.add(
                    RefusedRow { count, ..row(*topic, writer, role, refusal) },
                    writer,
                    role,
                    refusal.failed(),
                );
            }
        }
    }

    /// The rows, in the order of their first samples.
    pub(super) fn rows(&self) -> &[RefusedRow] {
        &self.rows
    }

    /// What was dropped and refused since the last time.
    pub(super) fn take_news(&mut self) -> Vec<NewRefusal> {
        std::mem::take(&mut self.news)
    }

    fn add(&mut self, row: RefusedRow, writer: Role, reader: Role, rule: Rule) {
        let known = self.rows.iter_mut().find(|known| known.is_same(&row));
        self.news.push(NewRefusal { is_first: known.is_none(), writer, reader, rule, row: row.clone() });
        if let Some(known) = known {
            known.count += row.count;
            (known.value, known.newest_scan) = (row.value, row.newest_scan);
        } else if self.rows.len() < KEPT {
            self.rows.push(row);
        }
    }
}

impl RefusedRow {
    /// What is wrong with the samples, as `not verified (verified = 0)`.
    pub fn fault(&self) -> String {
        let words = self.rule.replace('_', " ");
        match (self.field.as_str(), self.rule == Rule::NotFinite.name()) {
            ("", _) => words,
            (field, true) => format!("{words} ({field})"),
            (field, false) => format!("{words} ({field} = {})", self.value),
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        let key = |row: &Self| {
            (row.topic.clone(), row.incarnation, row.reader.clone(), row.rule.clone(), row.field.clone())
        };
        key(self) == key(other)
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
    fn refused_samples_are_added_up_by_writer_and_rule_and_told_once() {
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
        let told: Vec<String> = refused.rows().iter().map(ToString::to_string).collect();
        assert_eq!(
            told,
            [
                "2 command of controller (incarnation 4) dropped by actuator: not verified (verified = 0)",
                "1 command of controller (incarnation 4) dropped by actuator: not finite (steering_rad)",
                "1 command of controller (incarnation 6) dropped by actuator: not verified (verified = 0)",
            ]
        );
        assert_eq!((refused.rows()[0].first_scan, refused.rows()[0].newest_scan), (1, 2));
        let news = refused.take_news();
        let first: Vec<bool> = news.iter().map(|refusal| refusal.is_first).collect();
        assert_eq!(first, [true, false, true, true]);
        assert_eq!((news[0].writer, news[0].rule), (Role::Controller, Rule::NotVerified));
        assert_eq!(refused.take_news(), []);
    }

    #[test]
    fn what_another_orchestrator_was_told_is_not_told_again() {
        let mut refused = Refused::default();
        let mut heartbeat = Heartbeat::default();
        heartbeat.refused[0].note(&Header::default(), &Fault::NotVerified { value: 0 });
        refused.add_heartbeat(Role::Actuator, &heartbeat, true);
        assert_eq!(refused.rows(), []);
    }
}
