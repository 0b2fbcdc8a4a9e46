//! The processes of a recorded drive at one time, in the form of a status.

use std::collections::BTreeMap;

use recording::mcap::Contents;
use serde::Deserialize;
use serde_json::{Value, json};
use shared_types::{Directive, Phase, Role, Topic};
use supervision::entry::ProcessRow;

use super::samples::{Key, OwnedSample};

/// Outputs of this time make the rate, and a process that published in it is shown [ns].
const RATE_NS: u64 = 1_000_000_000;

/// The programs by incarnation, as the recorder has found them.
pub(super) struct Processes(BTreeMap<u32, (String, u32)>);

impl Processes {
    pub(super) fn new(contents: &Contents) -> Self {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            process: Vec<ProcessRow>,
        }
        let files = contents.attachments.iter().filter(|attached| attached.name.starts_with("processes-"));
        let rows = files
            .filter_map(|attached| toml::from_slice(&attached.data).ok())
            .flat_map(|file: File| file.process);
        Self(rows.map(|row| (row.identity.incarnation, (row.entry.label(), row.identity.pid))).collect())
    }

    /// The status after these directives: a process in charge per role, and those that published beside it.
    pub(super) fn status(&self, directives: &[(Key, Directive)], outputs: &Outputs, now_ns: u64) -> Value {
        let Some((_, newest)) = directives.last() else { return Value::Null };
        let mut rows = Vec::new();
        for role in Role::ALL {
            let authority = &newest.authority[role.index()];
            // A swap names the scan from which its process counts, a restart does not.
            let restarts = directives.windows(2).filter(|two| {
                let [before, after] =
                    [&two[0].1, &two[1].1].map(|directive| &directive.authority[role.index()]);
                let is_other = before.incarnation != after.incarnation;
                is_other && after.from_scan == 0 && before.incarnation != 0
            });
            let restarts = restarts.count();
            let row = |incarnation: u32, state: &str| {
                let (implementation, pid) =
                    self.0.get(&incarnation).map_or(("unknown", 0), |(label, pid)| (label.as_str(), *pid));
                let times = outputs.0.get(&(*role, incarnation)).map_or(&[][..], Vec::as_slice);
                let recent = times.iter().filter(|time_ns| **time_ns + RATE_NS > now_ns).count();
                let age_ms = times.iter().max().map(|time_ns| now_ns.saturating_sub(*time_ns) as f64 * 1e-6);
                json!({
                    "role": role.name(), "implementation": implementation, "pid": pid, "state": state,
                    "restarts": restarts, "rate_hz": recent, "last_sample_age_ms": age_ms, "last_words": [],
                })
            };
            let is_known = outputs.0.contains_key(&(*role, authority.incarnation));
            rows.push(row(authority.incarnation, if is_known { "ready" } else { "starting" }));
            for (of, incarnation) in
                outputs.0.keys().filter(|(of, other)| of == role && *other != authority.incarnation)
            {
                let is_recent =
                    outputs.0[&(*of, *incarnation)].iter().any(|time_ns| time_ns + RATE_NS > now_ns);
                if is_recent {
                    let is_standby = *incarnation == authority.previous;
                    rows.push(row(*incarnation, if is_standby { "standby" } else { "shadow" }));
                }
            }
        }
        let state = Phase::try_from(newest.phase).map_or("unknown", Phase::name);
        json!({ "state": state, "processes": rows })
    }
}

/// When each process published its answer to a scan in the chunks around a frame [ns].
#[derive(Default)]
pub(super) struct Outputs(BTreeMap<(Role, u32), Vec<u64>>);

impl Outputs {
    pub(super) fn note(&mut self, sample: &OwnedSample) {
        use Topic::{Actuation, Command, Obstacles, Pose, Scan};
        if !matches!(sample.topic, Scan | Pose | Obstacles | Command | Actuation) {
            return;
        }
        let Some(role) = sample.topic.writer() else { return };
        self.0.entry((role, sample.header().incarnation)).or_default().push(sample.key.0);
    }
}
