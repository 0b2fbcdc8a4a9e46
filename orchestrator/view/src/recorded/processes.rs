//! The processes of a recorded drive at one time, in the form of a status.

use std::collections::BTreeMap;

use recording::mcap::Contents;
use serde_json::{Value, json};
use shared_types::{Directive, Phase, Role, Topic};
use supervision::entry::recorded_processes;

use super::samples::{Key, OwnedSample};

/// Outputs of this time make the rate, and a process that published in it is shown [ns].
const RATE_NS: u64 = 1_000_000_000;

/// The programs by incarnation, as the recorder has found them.
pub(super) struct Processes(BTreeMap<u32, (String, u32)>);

impl Processes {
    pub(super) fn new(contents: &Contents) -> Self {
        let files = contents.attachments.iter().filter(|attached| attached.name.starts_with("processes-"));
        let rows = files.filter_map(|attached| recorded_processes(&attached.data).ok()).flatten();
        Self(rows.map(|row| (row.identity.incarnation, (row.entry.label(), row.identity.pid))).collect())
    }

    /// The status after these directives: a process in charge per role, and the others that published.
    pub(super) fn status(&self, directives: &[(Key, Directive)], outputs: &Outputs, now_ns: u64) -> Value {
        let Some((_, newest)) = directives.last() else { return Value::Null };
        let mut rows = Vec::new();
        for role in Role::ALL {
            let authority = &newest.authority[role.index()];
            let row = |incarnation: u32, state: &str| {
                let (implementation, pid) =
                    self.0.get(&incarnation).map_or(("unknown", 0), |(label, pid)| (label.as_str(), *pid));
                let times = outputs.recent(*role, incarnation, now_ns);
                json!({
                    "role": role.name(), "implementation": implementation, "pid": pid, "state": state,
                    "restarts": restarts(directives, *role), "rate_hz": rate_hz(&times),
                    "last_sample_age_ms": outputs.age_ms(*role, incarnation, now_ns), "last_words": [],
                })
            };
            let has_published = outputs.age_ms(*role, authority.incarnation, now_ns).is_some();
            rows.push(row(authority.incarnation, if has_published { "ready" } else { "starting" }));
            for incarnation in outputs.incarnations(*role) {
                let is_other = incarnation != authority.incarnation;
                if is_other && !outputs.recent(*role, incarnation, now_ns).is_empty() {
                    let is_standby = incarnation == authority.previous;
                    rows.push(row(incarnation, if is_standby { "standby" } else { "shadow" }));
                }
            }
        }
        let state = Phase::try_from(newest.phase).map_or("unknown", Phase::name);
        json!({ "state": state, "processes": rows })
    }
}

/// Starts of a role after the first: a swap names the scan from which its process counts, a restart does not.
fn restarts(directives: &[(Key, Directive)], role: Role) -> usize {
    let is_restart = |two: &&[(Key, Directive)]| {
        let [before, after] = [&two[0].1, &two[1].1].map(|directive| &directive.authority[role.index()]);
        before.incarnation != after.incarnation && before.incarnation != 0 && after.from_scan == 0
    };
    directives.windows(2).filter(is_restart).count()
}

/// Outputs per second; 0 for a single one.
fn rate_hz(times_ns: &[u64]) -> f64 {
    match (times_ns.iter().min(), times_ns.iter().max()) {
        (Some(first), Some(last)) if last > first => {
            (times_ns.len() - 1) as f64 / ((last - first) as f64 * 1e-9)
        }
        _ => 0.0,
    }
}

/// When each process published its answers to scans in the chunks around a frame [ns].
#[derive(Default)]
pub(super) struct Outputs(BTreeMap<(Role, u32), Vec<u64>>);

impl Outputs {
    pub(super) fn note(&mut self, sample: &OwnedSample) {
        use Topic::{Actuation, Command, Obstacles, Pose, Scan};
        let is_answer = matches!(sample.topic, Scan | Pose | Obstacles | Command | Actuation);
        if let Some(role) = sample.topic.writer().filter(|_| is_answer) {
            self.0.entry((role, sample.header().incarnation)).or_default().push(sample.key.0);
        }
    }

    fn incarnations(&self, role: Role) -> impl Iterator<Item = u32> {
        self.0.keys().filter(move |(of, _)| *of == role).map(|(_, incarnation)| *incarnation)
    }

    /// Those of the last second.
    fn recent(&self, role: Role, incarnation: u32, now_ns: u64) -> Vec<u64> {
        let times = self.0.get(&(role, incarnation)).map_or(&[][..], Vec::as_slice);
        times.iter().copied().filter(|time_ns| time_ns.saturating_add(RATE_NS) >= now_ns).collect()
    }

    fn age_ms(&self, role: Role, incarnation: u32, now_ns: u64) -> Option<f64> {
        let newest = self.0.get(&(role, incarnation))?.iter().max()?;
        Some(now_ns.saturating_sub(*newest) as f64 * 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_counts_the_steps_between_outputs() {
        assert_eq!(rate_hz(&[0, 250_000_000, 500_000_000]), 4.0);
        assert_eq!((rate_hz(&[5]), rate_hz(&[])), (0.0, 0.0));
    }
}
