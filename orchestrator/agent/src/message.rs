//! What a proxy tells an agent, and what the agent answers.

use runtime::{HandoverData, Realtime, RuntimeError};
use serde::{Deserialize, Serialize};
use shared_types::Role;
use supervision::entry::role_name;

/// What is to become of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
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
    pub order: Order,
    /// Whether the run was stopped: the wheels are to be blocked for good.
    #[serde(default)]
    pub stopped: bool,
    /// How it is started; only with [`Order::Start`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<Start>,
}

/// How a process is started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Start {
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

/// What an agent answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Up {
    /// Id of the run.
    pub run_id: String,
    /// Number of the process.
    pub incarnation: u32,
    /// Its state.
    pub state: State,
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
pub enum State {
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
            state: State::Killed { signal: 9 },
            stopped: true,
            wheels: Some(2),
            last_lines: vec!["a\nb".to_owned()],
        };
        let text = serde_json::to_string(&up).unwrap();
        assert!(!text.contains('\n'), "one line");
        assert_eq!(serde_json::from_str::<Up>(&text).unwrap(), up);
    }
}
