//! What the parts of the loop noticed, and when.

use std::collections::BTreeMap;

/// What another drive finds so much later is something else [ns].
const SAME_NS: u64 = 500_000_000;

/// The first time of each finding, by the part that made it and what it is.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    first: BTreeMap<(&'static str, &'static str), FindingPlace>,
    /// Findings before this time are not kept [ns].
    from_ns: u64,
}

/// When something was found, and how far the wheels had driven by then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FindingPlace {
    /// Time since the start of the drive [ns].
    pub at_ns: u64,
    /// Way driven since the start of the drive [m].
    pub way_m: f64,
}

/// One finding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finding {
    /// The role, or `orchestrator`.
    pub by: &'static str,
    /// What was found, like `not_finite`.
    pub what: &'static str,
    /// When.
    pub place: FindingPlace,
}

impl Findings {
    /// Forgets everything, and keeps what is found from a time on.
    pub fn restart(&mut self, from_ns: u64) {
        self.first.clear();
        self.from_ns = from_ns;
    }

    /// Notes that something was found.
    pub fn note(&mut self, by: &'static str, what: &'static str, place: FindingPlace) {
        if place.at_ns >= self.from_ns {
            self.first.entry((by, what)).or_insert(place);
        }
    }

    /// Whether the same was found, not much later.
    pub fn has(&self, finding: &Finding) -> bool {
        let found = self.first.get(&(finding.by, finding.what));
        found.is_some_and(|place| place.at_ns <= finding.place.at_ns + SAME_NS)
    }

    /// All findings in the order of time.
    pub fn list(&self) -> Vec<Finding> {
        let of = |((by, what), place): (&(&'static str, &'static str), &FindingPlace)| Finding {
            by,
            what,
            place: *place,
        };
        let mut all: Vec<Finding> = self.first.iter().map(of).collect();
        all.sort_by_key(|finding| finding.place.at_ns);
        all
    }
}
