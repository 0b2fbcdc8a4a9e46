//! Control from the page: each action is one command of this program, so it has the same checks, certificates and
//! refusals as in a terminal.

use std::process::{Command, Stdio};
use std::sync::Mutex;

use serde::Deserialize;
use serde_json::{Value, json};
use shared_types::{Role, named_enum};
use supervision::child::this_program;

use crate::hand::{Hand, Held};
use crate::http::{Response, Status};

/// Longest argument [bytes].
const MAX_ARGUMENT: usize = 200;

named_enum! {
    /// What the page can do.
    pub enum Verb {
        /// Block the wheels and end the run.
        Stop "stop",
        /// Block the wheels until `resume`.
        Pause "pause",
        /// Let the controller drive again.
        Resume "resume",
        /// Drive by hand, while buttons are held.
        Teleop "teleop",
        /// Restart one process.
        Restart "restart",
        /// Replace one process by a built-in implementation.
        Swap "swap",
        /// Change a setting of one role.
        Set "set",
        /// Move the goal that is next.
        Goal "goal",
        /// Inject a fault.
        Inject "inject",
    }
}

impl Verb {
    /// The command of this program that does it.
    pub fn command(self) -> &'static str {
        match self {
            Self::Goal => Self::Set.name(),
            verb => verb.name(),
        }
    }
}

/// The body of a request.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Asked {
    action: String,
    /// Of `restart` and `swap`.
    role: String,
    /// The implementation of `swap`.
    to: String,
    /// Of `set`.
    key: String,
    value: String,
    /// Of `goal`: its place in the plane.
    x_m: Option<f64>,
    y_m: Option<f64>,
    /// Of `teleop`: what is held [m/s], [rad]; without a velocity nothing is.
    velocity: Option<f64>,
    steering: f64,
    /// Of `inject`.
    fault: String,
}

/// Executes actions, one at a time.
#[derive(Debug)]
pub(crate) struct Actions {
    system_id: String,
    verbs: Vec<Verb>,
    turn: Mutex<()>,
    hand: Hand,
}

impl Actions {
    /// Actions on a system; without `verbs` all are refused.
    pub(crate) fn new(system_id: &str, verbs: Vec<Verb>) -> Self {
        Self { system_id: system_id.to_owned(), verbs, turn: Mutex::new(()), hand: Hand::default() }
    }

    /// Carries out what the body of a request asks for.
    pub(crate) fn answer(&self, body: &[u8]) -> Response {
        let arguments = match arguments(&self.verbs, body) {
            Ok(Asking::Hold(held)) => return self.hand.hold(&self.system_id, held),
            Ok(Asking::Run(arguments)) => arguments,
            Err(reason) => return Response::text(Status::BadRequest, &reason),
        };
        // What blocks the wheels never waits for another action.
        let blocks = [Verb::Stop.name(), Verb::Pause.name()];
        let is_stop = arguments.first().is_some_and(|verb| blocks.contains(&verb.as_str()));
        let turn = if is_stop { None } else { Some(self.turn.try_lock()) };
        if matches!(turn, Some(Err(_))) {
            return Response::text(Status::Conflict, "another action is not finished yet");
        }
        match run(&self.system_id, &arguments) {
            Ok(result) => Response::json(Status::Ok, result.to_string()),
            Err(error) => {
                Response::text(Status::Unavailable, &format!("the action could not be started: {error:#}"))
            }
        }
    }
}

/// What an action asks for.
enum Asking {
    /// A command line; nothing in it can be an option.
    Run(Vec<String>),
    /// To drive by hand.
    Hold(Held),
}

/// What an action asks for.
fn arguments(verbs: &[Verb], body: &[u8]) -> Result<Asking, String> {
    let asked: Asked = serde_json::from_slice(body).map_err(|error| format!("not an action: {error}"))?;
    let names = || verbs.iter().map(|verb| verb.name()).collect::<Vec<_>>().join(", ");
    let verb = verbs.iter().find(|verb| verb.name() == asked.action);
    let verb =
        *verb.ok_or_else(|| format!("action {:?} is not allowed; allowed: {}", asked.action, names()))?;
    let plain = |what: &str, text: &str| {
        let allowed = |c: char| c.is_ascii_alphanumeric() || " ._-+:,[]\"".contains(c);
        let is_plain = text.starts_with(|c: char| c.is_ascii_alphanumeric() || "[\"-".contains(c))
            && !text.starts_with("--")
            && text.len() <= MAX_ARGUMENT
            && text.chars().all(allowed);
        let refused =
            || format!("{what} {text:?} is not allowed: letters, digits and . _ - + : , [ ] \" only");
        if is_plain { Ok(text.to_owned()) } else { Err(refused()) }
    };
    let name = |what: &str, text: &str| {
        plain(what, text).and_then(|text| {
            if text.starts_with('-') { Err(format!("{what} {text:?} is not allowed")) } else { Ok(text) }
        })
    };
    let role =
        || asked.role.parse::<Role>().map(|role| role.name().to_owned()).map_err(|error| error.to_string());
    let rest = match verb {
        Verb::Goal => {
            let place = |key: &str, metres: Option<f64>| {
                let metres = metres.ok_or_else(|| format!("{key} is missing"))?;
                Ok::<_, String>(format!("goal.{key}={metres:?}"))
            };
            vec![place("x_m", asked.x_m)?, place("y_m", asked.y_m)?, "--json".to_owned()]
        }
        Verb::Teleop => {
            let is_finite = asked.steering.is_finite() && asked.velocity.is_none_or(f64::is_finite);
            let held = asked.velocity.map(|velocity| [velocity, asked.steering]);
            return if is_finite { Ok(Asking::Hold(held)) } else { Err("no numbers".to_owned()) };
        }
        Verb::Stop | Verb::Pause | Verb::Resume => vec![],
        Verb::Restart => vec![role()?],
        Verb::Swap => vec![role()?, "--to".to_owned(), name("to", &asked.to)?, "--json".to_owned()],
        Verb::Set => {
            let pair = format!("{}={}", name("key", &asked.key)?, plain("value", &asked.value)?);
            vec![pair, "--json".to_owned()]
        }
        Verb::Inject => vec![name("fault", &asked.fault)?],
    };
    Ok(Asking::Run(std::iter::once(verb.command().to_owned()).chain(rest).collect()))
}

/// Runs a command of this program to its end.
fn run(system_id: &str, arguments: &[String]) -> anyhow::Result<Value> {
    let output = Command::new(this_program())
        .args(["--system-id", system_id])
        .args(arguments)
        .stdin(Stdio::null())
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let certificate: Value = serde_json::from_str(&text).unwrap_or_else(|_| json!(text.trim()));
    let messages = String::from_utf8_lossy(&output.stderr);
    Ok(json!({
        "action": arguments.join(" "),
        "exit_code": output.status.code(),
        "certificate": certificate,
        "messages": messages.trim(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(body: &str) -> Result<String, String> {
        let verbs = [Verb::Stop, Verb::Restart, Verb::Swap, Verb::Set, Verb::Goal, Verb::Teleop];
        arguments(&verbs, body.as_bytes()).map(|asking| match asking {
            Asking::Run(parts) => parts.join(" "),
            Asking::Hold(held) => format!("{held:?}"),
        })
    }

    #[test]
    fn actions_become_commands() {
        assert_eq!(of(r#"{"action":"stop"}"#).unwrap(), "stop");
        assert_eq!(of(r#"{"action":"restart","role":"controller"}"#).unwrap(), "restart controller");
        let swap = of(r#"{"action":"swap","role":"estimator","to":"ekf"}"#).unwrap();
        assert_eq!(swap, "swap estimator --to ekf --json");
        let set = of(r#"{"action":"set","key":"controller.theta_m","value":"-0.25"}"#).unwrap();
        assert_eq!(set, "set controller.theta_m=-0.25 --json");
        let goal = of(r#"{"action":"goal","x_m":8,"y_m":-0.3}"#).unwrap();
        assert_eq!(goal, "set goal.x_m=8.0 goal.y_m=-0.3 --json");
    }

    #[test]
    fn what_is_held_is_two_numbers_or_nothing() {
        let held = of(r#"{"action":"teleop","velocity":0.3,"steering":-0.05}"#);
        assert_eq!(held.unwrap(), "Some([0.3, -0.05])");
        assert_eq!(of(r#"{"action":"teleop"}"#).unwrap(), "None");
        assert!(of(r#"{"action":"teleop","velocity":"fast"}"#).is_err());
        assert!(of(r#"{"action":"teleop","velocity":1e999}"#).is_err());
    }

    #[test]
    fn nothing_else_becomes_a_command() {
        for body in [
            "",
            "{}",
            r#"{"action":"run"}"#,
            r#"{"action":"inject","fault":"blind"}"#,
            r#"{"action":"stop","more":1}"#,
            r#"{"action":"restart","role":"--all"}"#,
            r#"{"action":"swap","role":"controller","to":"--help"}"#,
            r#"{"action":"swap","role":"controller","to":"a/../../bin/sh"}"#,
            r#"{"action":"swap","role":"controller","to":""}"#,
            r#"{"action":"set","key":"-x","value":"1"}"#,
            r#"{"action":"goal","x_m":8}"#,
            r#"{"action":"goal","x_m":"8","y_m":0}"#,
            r#"{"action":"set","key":"x","value":"$(reboot)"}"#,
        ] {
            assert!(of(body).is_err(), "{body}");
        }
        assert!(arguments(&[], br#"{"action":"stop"}"#).is_err(), "without --control");
    }
}
