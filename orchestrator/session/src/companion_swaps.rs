//! Swaps of companions: requested, watched on the bus, and certified.

use handover::companion::{CompanionStep, CompanionSwap, FieldBound};
use handover::swap::{Certificate, Party};
use runtime::{Bus, Domain, OwnObserver, OwnTopics, RuntimeError, TopicRow, monotonic_ns};
use shared_types::Header;
use supervision::fleet::companions::{CompanionEvent, Companions};

use crate::control::Reply;
use crate::session::swaps::require_scans;

/// Numbers of these swaps begin behind this one; those of roles are smaller.
const FIRST_NUMBER: u64 = 1 << 32;
/// A new process takes over within this time, and so many scan periods for each scan in shadow [ns].
const LIMIT_NS: u64 = 15_000_000_000;
/// See [`LIMIT_NS`].
const PERIODS: u64 = 4;

/// The swaps of companions in one run.
#[derive(Default)]
pub(crate) struct CompanionSwaps {
    ended: Vec<Certificate>,
    current: Option<Current>,
}

struct Current {
    name: String,
    judge: CompanionSwap,
    watched: Vec<Watched>,
    /// When the new process must have taken over [ns].
    end_ns: u64,
    takes_over_at: Option<u64>,
    _bus: Bus,
}

/// A topic that the companion writes.
struct Watched {
    topic: String,
    fields: Vec<String>,
    observer: OwnObserver,
}

impl CompanionSwaps {
    /// Starts a swap of the companion `name` and returns its number.
    ///
    /// # Errors
    /// Why it can't be swapped.
    pub(crate) fn begin(
        &mut self,
        companions: &mut Companions,
        domain: &Domain,
        table: &OwnTopics,
        name: &str,
        command: Option<&[String]>,
        shadow_scans: u64,
    ) -> Result<Option<u64>, String> {
        if let Some(current) = &self.current {
            return Err(format!("companion {} is being replaced: wait for the certificate", current.name));
        }
        // A restart is compared with none.
        require_scans("shadow-scans", shadow_scans.max(1))?;
        let old = companions.command(name)?;
        let new = command.unwrap_or(&old);
        // A restart has the same program, so nothing is compared.
        let writes = |row: &&TopicRow| row.writer == name;
        let bound = |row: &TopicRow, (field, bound): &(String, f64)| FieldBound {
            topic: row.name.clone(),
            field: field.clone(),
            bound: *bound,
        };
        let bounds: Vec<FieldBound> = match command {
            Some(_) => table
                .topic
                .iter()
                .filter(writes)
                .flat_map(|row| row.agree.iter().map(move |agree| bound(row, agree)))
                .collect(),
            None => Vec::new(),
        };
        let judge = CompanionSwap::new(name, &old.join(" "), &new.join(" "), bounds, shadow_scans);
        let error = |error: RuntimeError| error.to_string();
        let bus = Bus::open(domain, "observer").map_err(error)?;
        let mut watched = Vec::new();
        for row in table.topic.iter().filter(writes) {
            let observer = OwnObserver::new(&bus, table, &row.name).map_err(error)?;
            observer.connect();
            let fields = row.agree.iter().map(|(field, _)| field.clone()).collect();
            watched.push(Watched { topic: row.name.clone(), fields, observer });
        }
        if !companions.swap(name, new)? {
            return Ok(None);
        }
        let limit_ns = LIMIT_NS + PERIODS * shadow_scans * table.run.period_ns;
        let end_ns = monotonic_ns() + limit_ns;
        self.current =
            Some(Current { name: name.to_owned(), judge, watched, end_ns, takes_over_at: None, _bus: bus });
        Ok(Some(FIRST_NUMBER + self.ended.len() as u64))
    }

    /// Compares the samples that have come, and lets the new process take over or ends it.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn advance(&mut self, companions: &mut Companions) -> Result<(), RuntimeError> {
        let Some(current) = &mut self.current else { return Ok(()) };
        current.watch(companions)?;
        if current.takes_over_at.is_some() {
            return Ok(());
        }
        let reason = match current.judge.step() {
            CompanionStep::TakeOver => {
                companions.approve(&current.name);
                None
            }
            CompanionStep::Refuse(reason) => Some(reason),
            CompanionStep::Wait => None,
        };
        let is_late = monotonic_ns() > current.end_ns;
        let late = || format!("it has agreed on {} scans in time", current.judge.agreed());
        if let Some(reason) = reason.or_else(|| is_late.then(late)) {
            companions.refuse(&current.name);
            self.end(|judge| judge.refused(&reason));
        }
        Ok(())
    }

    /// Notes what has happened to a companion; returns the certificate of a swap that has ended by it.
    pub(crate) fn note(&mut self, event: &CompanionEvent) -> Option<&Certificate> {
        let current = self.current.as_mut()?;
        match event {
            CompanionEvent::TakesOver(name, scan) if *name == current.name => {
                current.takes_over_at = Some(*scan);
                None
            }
            CompanionEvent::Replaced(name, scan) if *name == current.name => {
                let scan = *scan;
                self.end(|judge| judge.taken_over(scan))
            }
            CompanionEvent::SuccessorEnded(name, how, _) if *name == current.name => {
                let reason = format!("the new process ended: {how}");
                self.end(|judge| judge.refused(&reason))
            }
            _ => None,
        }
    }

    fn end(&mut self, certify: impl FnOnce(CompanionSwap) -> Certificate) -> Option<&Certificate> {
        self.ended.push(certify(self.current.take()?.judge));
        self.ended.last()
    }

    /// Whether a number is that of a swap of a companion.
    pub(crate) fn is_of_companion(number: u64) -> bool {
        number >= FIRST_NUMBER
    }

    /// The certificate of a swap, or that it is in progress.
    pub(crate) fn result(&self, number: u64) -> Reply {
        let index = usize::try_from(number.wrapping_sub(FIRST_NUMBER)).unwrap_or(usize::MAX);
        match self.ended.get(index) {
            Some(certificate) => Reply::Certificate(Box::new(certificate.clone())),
            None if self.current.is_some() && index == self.ended.len() => Reply::Pending,
            None => Reply::Refused(format!("there is no swap of number {number}")),
        }
    }

    /// The certificates of all swaps that have ended.
    pub(crate) fn certificates(&self) -> &[Certificate] {
        &self.ended
    }
}

impl Current {
    fn watch(&mut self, companions: &Companions) -> Result<(), RuntimeError> {
        let Self { name, judge, watched, .. } = self;
        let incarnations = companions.incarnations(name);
        let is_compared = !judge.bounds().is_empty();
        for (index, Watched { topic, fields, observer }) in watched.iter().enumerate() {
            let layout = observer.own_type().fields();
            while let Some(sample) = observer.next()? {
                let header: Header = bytemuck::pod_read_unaligned(&sample[..size_of::<Header>()]);
                let side = match incarnations {
                    Some((old, _)) if header.incarnation == old => Some(Party::Old),
                    Some((_, new)) if header.incarnation == new => Some(Party::New),
                    _ => None,
                };
                if let Some(side) = side.filter(|_| is_compared && !fields.is_empty()) {
                    let numbers = fields.iter().map(|field| TopicRow::numbers(layout, field, &sample));
                    judge.see(topic, side, header.scan_id, numbers.collect());
                }
                if index == 0 && companions.counts(name, &header) {
                    judge.count(header.scan_id);
                }
            }
        }
        Ok(())
    }
}
