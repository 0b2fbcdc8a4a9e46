//! What the ports of one process on topics of its own share.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use shared_types::{
    Described, Difference, Header, LayoutRow, Layouts, OwnType, Phase, Role, StageStamps, difference_in,
};

use super::page::{CompanionPage, CompanionSelfReport, MAX_COMPANIONS};
use super::ports::{Port, PortTable};
use super::table::{OPERATOR, OwnTopics, TopicRow};
use crate::{Clock, Domain, RuntimeError, Silence, monotonic_ns};

/// Who the process is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Place {
    /// A process of the loop.
    Role(Role),
    /// The companion of that number, with that report.
    Companion { index: usize, report: usize },
}

/// One process as a user of topics of its own.
pub(crate) struct Member {
    pub(super) place: Place,
    pub(super) name: String,
    pub(super) incarnation: u32,
    pub(super) table: OwnTopics,
    pub(super) page: CompanionPage,
    ports: PortTable,
    pub(super) clock: Clock,
    pub(super) stamps: Cell<StageStamps>,
    pub(super) report: RefCell<CompanionSelfReport>,
    /// The sample of the first topic that is being answered: its scan, 0 for none.
    open_scan: Cell<u64>,
    silence: Cell<Silence>,
}

/// Who writes a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    /// The companion of that number.
    Companion(usize),
    /// Commands of an operator.
    Operator,
}

impl Member {
    pub(crate) fn new(
        domain: &Domain,
        place: Place,
        name: &str,
        incarnation: u32,
    ) -> Result<Rc<Self>, RuntimeError> {
        let none = || RuntimeError::NoOwnTopic { process: name.to_owned(), topic: "any".to_owned() };
        let table = OwnTopics::of(domain)?.ok_or_else(none)?;
        let report = CompanionSelfReport {
            incarnation,
            pid: u64::from(std::process::id()),
            ..CompanionSelfReport::default()
        };
        Ok(Rc::new(Self {
            place,
            name: name.to_owned(),
            incarnation,
            page: CompanionPage::open(domain)?,
            ports: PortTable::open(domain)?,
            clock: table.run.clock.clock(),
            stamps: Cell::default(),
            report: RefCell::new(report),
            open_scan: Cell::new(0),
            silence: Cell::default(),
            table,
        }))
    }

    /// Counts for a port that reads or writes a topic.
    pub(super) fn port(&self, topic: &str, writes: bool) -> RefCell<Port> {
        let process = match self.place {
            Place::Role(role) => MAX_COMPANIONS + role.index(),
            Place::Companion { index, .. } => index,
        };
        let topic = self.table.number_of(topic);
        RefCell::new(Port::open(&self.ports, self.incarnation, process as u32, topic, writes))
    }

    /// The row of a topic that this process reads (true) or writes (false).
    pub(super) fn use_of(&self, topic: &str) -> Result<(TopicRow, bool), RuntimeError> {
        let unknown = || RuntimeError::NoOwnTopic { process: self.name.clone(), topic: topic.to_owned() };
        let row = self.table.find(topic).ok_or_else(unknown)?;
        let reads = match self.place {
            Place::Role(role) => self.table.of_role(role, topic).is_some(),
            Place::Companion { index, .. } => {
                self.table.companion[index].reads.iter().any(|name| name == topic)
            }
        };
        match reads {
            true => Ok((row.clone(), true)),
            false if row.writer == self.name => Ok((row.clone(), false)),
            false => Err(unknown()),
        }
    }

    /// Passes when the samples of a topic have the fields of `S`.
    pub(super) fn verify<S: Described>(&self, row: &TopicRow) -> Result<OwnType, RuntimeError> {
        let mine = OwnType::of::<S>()
            .map_err(|fault| RuntimeError::settings(format!("topic {}", row.name).into(), fault))?;
        self.verify_rows(row, mine.rows(&row.name))?;
        Ok(mine)
    }

    /// [`Member::verify`] of rows that another language has made.
    pub(super) fn verify_rows(&self, row: &TopicRow, mine: Vec<LayoutRow>) -> Result<(), RuntimeError> {
        let (theirs, _) = row.shape()?;
        let [mine, theirs] = [mine, theirs.rows(&row.name)].map(|rows| Layouts { rows });
        let found: Option<Difference> = difference_in(&mine, &theirs, &row.name);
        found.map_or(Ok(()), |found| Err(RuntimeError::Layout(found)))
    }

    /// Who writes a topic.
    pub(super) fn source(&self, row: &TopicRow) -> Source {
        match self.table.index_of(&row.writer) {
            Some(index) if row.writer != OPERATOR => Source::Companion(index),
            _ => Source::Operator,
        }
    }

    /// Age above which samples of a topic are dropped, in real time [ns].
    pub(super) fn max_age_ns(&self, topic: &str) -> Option<u64> {
        let Place::Role(role) = self.place else { return None };
        if self.clock.is_simulated() {
            return None;
        }
        self.table.of_role(role, topic).map(|also| (also.max_age_ms * 1e6) as u64)
    }

    /// Whether a topic is the first that this companion reads.
    pub(super) fn is_first(&self, topic: &str) -> bool {
        let Place::Companion { index, .. } = self.place else { return false };
        self.table.companion[index].reads.first().is_some_and(|first| first == topic)
    }

    /// Whether lock-step waits for this process.
    pub(super) fn is_waited_for(&self) -> bool {
        match self.place {
            Place::Role(_) => true,
            Place::Companion { index, .. } => self.page.progress(index).0,
        }
    }

    /// Whether nothing is worth waiting for any more: the system ends, or its orchestrator is gone.
    pub(super) fn is_over(&self) -> bool {
        self.page.phase() == Phase::Stopping || self.silent_ns() > self.table.run.orphan_timeout_ns
    }

    /// How long the orchestrator has been silent while this process ran [ns].
    pub(super) fn silent_ns(&self) -> u64 {
        let mut silence = self.silence.get();
        let silent_ns = silence.since(self.page.beat_ns(), monotonic_ns());
        self.silence.set(silence);
        silent_ns
    }

    /// Notes that a sample was taken; one of the first topic is being answered from now on.
    pub(super) fn take(&self, header: &Header, is_first: bool) {
        self.clock.advance_to(header.scan_published_ns());
        let now = self.clock.now_ns();
        let woken_ns = if self.clock.is_simulated() { now } else { self.stamps.get().woken_ns };
        self.stamps.set(StageStamps { woken_ns, taken_ns: now, ..StageStamps::default() });
        if is_first {
            self.finish();
            self.open_scan.set(header.scan_id);
            self.report.borrow_mut().taken += 1;
        }
    }

    /// The process is done with the sample that it has taken last.
    pub(super) fn finish(&self) {
        let scan = self.open_scan.replace(0);
        let report = &mut *self.report.borrow_mut();
        if scan > 0 {
            report.answered += 1;
            report.answered_scan = report.answered_scan.max(scan);
        }
        self.write(report);
    }

    /// Writes the report of a companion.
    pub(super) fn write(&self, content: &CompanionSelfReport) {
        if let Place::Companion { report, .. } = self.place {
            self.page.write_report(report, content);
        }
    }
}
