//! What a proxy tells an agent, and what the agent answers.

use runtime::{Domain, HandoverData, Realtime, RuntimeError};
use serde::{Deserialize, Serialize};
use shared_types::{Role, TOPICS, Topic};
use supervision::entry::role_name;
use supervision::realtime;

/// What is to become of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RemoteOrder {
    /// It is to run, and is started if it does not.
    Start,
    /// It is to run; one that is not known is not started again.
    Run,
    /// It is asked to end.
    Terminate,
}

/// A message to an agent, about one process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Down {
    /// Version of the orchestrator's program and samples.
    pub version: String,
    /// Id of the system at the orchestrator.
    pub system_id: String,
    /// Id of the run.
    pub run_id: String,
    /// Number of the process.
    pub incarnation: u32,
    /// Its role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// What is to become of it.
    pub order: RemoteOrder,
    /// Whether the run was stopped: the wheels are to be blocked for good.
    #[serde(default)]
    pub stopped: bool,
    /// How it is started; only with [`RemoteOrder::Start`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<RemoteStart>,
}

/// How a process is started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteStart {
    /// Name of the implementation; the agent knows what it means there.
    pub implementation: String,
    /// Whether it replaces another process.
    pub restart: bool,
    /// The incarnation that it runs in shadow of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub candidate: Option<u32>,
    /// Scan period [ns].
    pub period_ns: u64,
    /// Processors and priority that it gets.
    pub realtime: Realtime,
    /// Its settings file.
    pub settings: String,
    /// Topics that cross to the host of the agent.
    pub receives: Vec<String>,
    /// Topics that cross from there.
    pub sends: Vec<String>,
    /// State that it resumes from, with times of the orchestrator's clock, as hexadecimal digits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handover: Option<String>,
}

/// Scan periods that a system may have [ns].
const PERIODS_NS: std::ops::RangeInclusive<u64> = 1_000_000..=2_000_000_000;
/// Longest settings file, and longest state of a process as digits [bytes].
const MAX_TEXT: usize = 1 << 20;

impl Down {
    /// Passes when each name and number has a value that an orchestrator sends: another one would end the bridge or a
    /// process here again and again.
    ///
    /// # Errors
    /// The key with its value and what is allowed.
    pub(crate) fn check(&self) -> Result<(), String> {
        let refuse = |key: &str, value: &dyn std::fmt::Debug, allowed: &str| {
            let mut value = format!("{value:?}");
            value.truncate(value.floor_char_boundary(80));
            Err(format!("{key} = {value} is not allowed: {allowed}"))
        };
        if !Domain::is_run_id(&self.run_id) {
            return refuse("run_id", &self.run_id, "ten small letters and digits");
        }
        if !Domain::is_system_id(&self.system_id) {
            return refuse("system_id", &self.system_id, "1 to 16 letters, digits and -");
        }
        if self.incarnation == 0 {
            return refuse("incarnation", &self.incarnation, "at least 1");
        }
        let Some(start) = &self.start else {
            let needed = "what is to be started";
            return if self.order == RemoteOrder::Start {
                refuse("start", &"(missing)", needed)
            } else {
                Ok(())
            };
        };
        if !PERIODS_NS.contains(&start.period_ns) {
            return refuse("period_ns", &start.period_ns, "1000000 to 2000000000");
        }
        for (key, topics) in [("receives", &start.receives), ("sends", &start.sends)] {
            if topics.len() > TOPICS.len() {
                return refuse(key, &topics.len(), "each topic once");
            }
            if let Some(unknown) = topics.iter().find(|topic| topic.parse::<Topic>().is_err()) {
                return refuse(key, unknown, "topics of this version");
            }
        }
        if start.candidate == Some(0) {
            return refuse("candidate", &0, "at least 1");
        }
        for (key, text) in [("settings", Some(&start.settings)), ("handover", start.handover.as_ref())] {
            if let Some(text) = text.filter(|text| text.len() > MAX_TEXT) {
                return refuse(key, &text.len(), "at most 1048576 bytes");
            }
        }
        if let Some(state) = start.handover.as_ref().filter(|text| of_hex(text, 0).is_none()) {
            return refuse("handover", state, "a state as hexadecimal digits");
        }
        let realtime = realtime::validate(&start.realtime);
        realtime.map_err(|invalid| invalid.within("realtime").to_string())
    }
}

/// What an agent answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Up {
    /// Id of the run.
    pub run_id: String,
    /// Number of the process.
    pub incarnation: u32,
    /// Its state.
    pub state: RemoteState,
    /// Whether its host knows that the run was stopped.
    #[serde(default)]
    pub stopped: bool,
    /// What the wheels do by the report of the process, if it controls them; after a stop, by a report since then.
    #[serde(default)]
    pub wheels: Option<u64>,
    /// The last lines of its log, once it has ended.
    #[serde(default)]
    pub last_lines: Vec<String>,
}

/// The state of a process on another host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RemoteState {
    /// It runs.
    Running {
        /// Its process id there.
        pid: u32,
    },
    /// It ended with this exit code.
    Exited {
        /// The code.
        code: i32,
    },
    /// A signal ended it.
    Killed {
        /// The number of the signal.
        signal: i32,
    },
    /// The agent does not know it: the agent was started anew.
    Unknown,
    /// The agent does not start it.
    Refused {
        /// Why.
        reason: String,
    },
}

/// A state as text for a message.
pub(crate) fn to_hex(data: &HandoverData) -> String {
    data.to_bytes().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The state of a message, with its times moved by `by_ns`; `None` when it is damaged.
pub(crate) fn of_hex(text: &str, by_ns: i64) -> Option<HandoverData> {
    let digits = text.as_bytes().chunks(2);
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    let bytes = digits.map(byte).collect::<Option<Vec<u8>>>()?;
    HandoverData::from_bytes(&bytes).map(|data| data.shifted(by_ns))
}

/// The state that the file for a starting process holds.
pub(crate) fn handover_of(domain: &runtime::Domain, role: Role) -> Result<Option<String>, RuntimeError> {
    Ok(runtime::read_handover(domain, role)?.as_ref().map(to_hex))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Actuation, Checkpoint, Sample};

    #[test]
    fn a_state_crosses_with_its_times_on_the_clock_of_the_other_host() {
        let mut actuation = Actuation::default();
        actuation.header.layout = Actuation::LAYOUT;
        actuation.header.acquired_ns = 90_000;
        let checkpoint = Checkpoint { issued_ns: 100_000, ..Checkpoint::default() };
        let data = HandoverData { checkpoint, ended_ns: 120_000, actuations: vec![actuation], moved_ns: 0 };
        let there = of_hex(&to_hex(&data), -50_000).unwrap();
        assert_eq!((there.checkpoint.issued_ns, there.ended_ns, there.moved_ns), (50_000, 70_000, -50_000));
        assert_eq!(there.actuations[0].header.acquired_ns, 40_000);
        let running = of_hex(&to_hex(&HandoverData { ended_ns: 0, ..data }), 7).unwrap();
        assert_eq!(running.ended_ns, 0, "it still runs");
        assert_eq!((of_hex("zz", 0), of_hex("00", 0)), (None, None));
    }

    #[test]
    fn messages_are_read_back_as_they_were_written() {
        let up = Up {
            run_id: "abcdefghij".to_owned(),
            incarnation: 7,
            state: RemoteState::Killed { signal: 9 },
            stopped: true,
            wheels: Some(2),
            last_lines: vec!["a\nb".to_owned()],
        };
        let text = serde_json::to_string(&up).unwrap();
        assert!(!text.contains('\n'), "one line");
        assert_eq!(serde_json::from_str::<Up>(&text).unwrap(), up);
    }
}
