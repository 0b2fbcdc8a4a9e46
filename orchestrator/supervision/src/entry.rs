//! One process of a system, as the system file describes it and as a run records it.

use runtime::Identity;
use serde::{Deserialize, Serialize};
use shared_types::{Role, did_you_mean};
use vehicle::{Documented, Invalid, of_text, settings};

use crate::keeper::KeeperPolicy;
use crate::supervisor::{ProcessPolicy, Restart};

/// What the key `role` may be.
const ROLES: &str = "one of robot, estimator, obstacles, controller, actuator, companion";
const ROLE_NAMES: &str = "enum = ['robot', 'estimator', 'obstacles', 'controller', 'actuator', 'companion']";
/// The key `role` of a process that fills none.
const COMPANION: &str = "companion";
/// What the name of a companion or a topic may be.
pub const NAME_RULE: &str = "a small letter, then small letters, digits, `-` or `_`; at most 24";
/// The same for the key of a file.
pub const NAME: Documented = Documented { text: NAME_RULE, schema: "pattern = '^[a-z][a-z0-9_-]{0,23}$'" };

settings! {
    /// A topic that a process of the loop reads in addition to those of its role.
    pub struct AlsoRead {
        /// Name of the topic.
        pub topic: String = String::new(), "a topic of the system file";
        /// Older samples are dropped; in lock-step none is [ms].
        pub max_age_ms: f64 = 200.0, 1.0..=3_600_000.0;
    }
}

settings! {
    /// One process of the system.
    pub struct ProcessEntry {
        /// Role that the process fills, or `companion` for a process beside the loop.
        pub role: String = String::new(), (Documented { text: ROLES, schema: ROLE_NAMES }, "must be given");
        /// Built-in implementation that fills the role; it needs this or `command`.
        pub implementation: Option<String> = None, Documented {
            text: "emulator, player or ros2, ekf, ellipses, nmpc or actuation, in the order of the roles",
            schema: "enum = ['emulator', 'player', 'ros2', 'ekf', 'ellipses', 'nmpc', 'actuation']",
        };
        /// Name of a companion; a role has none.
        pub name: Option<String> = None, NAME;
        /// Program of your own with its arguments, which fills the role instead.
        pub command: Option<Vec<String>> = None, "a list of texts, instead of `implementation`";
        /// Name of the `[[host]]` that the process runs on; without the key the one where `scanloop run` is typed.
        pub host: Option<String> = None, "a name of a `[[host]]`, the same for robot and actuator; a companion has none";
        /// When a process that ended is started again. With `on-failure` an end with exit code 0 ends the run; the robot is
        /// never started again.
        pub restart: Restart = Restart::OnFailure;
        /// The run ends when the process ends this often before its first output.
        pub start_limit: u32 = 3, 1.0..=100.0;
        /// Restarts within `restart_window_s` of a process that had been ready; one more ends the run.
        pub restart_limit: u32 = 5, 1.0..=1e6;
        /// Time window in which restarts are counted [s].
        pub restart_window_s: f64 = 60.0, 0.1..=86_400.0;
        /// Limit for each start step: attach, connect, first output. The last counts only while all inputs arrive [s].
        pub start_timeout_s: f64 = 10.0, 0.1..=3600.0;
        /// Time between the request to end and the kill [ms].
        pub grace_ms: u64 = 1000, 1.0..=3_600_000.0;
        /// Topics that a companion reads. In lock-step it answers each sample of the first.
        pub reads: Option<Vec<String>> = None, "names of topics";
        /// Topics that a companion writes.
        pub writes: Option<Vec<String>> = None, "names of topics of the system file";
        /// Whether the run ends when the companion has failed; without the key, false.
        pub needed: Option<bool> = None, "true, false";
        /// Whether lock-step waits for the companion; without the key, true.
        pub lockstep: Option<bool> = None, "true, false";
        /// Whether a companion may read the topic `truth`; without the key, false.
        pub reads_truth: Option<bool> = None, "true, false";
        /// Topics that a command of your own reads in addition to those of its role; `actuation` reads emergency stops,
        /// `ekf` one gyro.
        pub also_reads: Vec<AlsoRead> = Vec::new();
    }
}

/// A living process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProcessRow {
    /// Its role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Distinguishes it from an unrelated process with the same number.
    pub identity: Identity,
    /// How it was started.
    pub entry: ProcessEntry,
}

/// The processes in a file that the orchestrator has written, `processes-*.toml` of a recording.
///
/// # Errors
/// What is wrong with a damaged file.
pub fn recorded_processes(file: &[u8]) -> Result<Vec<ProcessRow>, String> {
    #[derive(Deserialize)]
    struct Processes {
        #[serde(default)]
        process: Vec<ProcessRow>,
    }
    let text = str::from_utf8(file).map_err(|error| error.to_string())?;
    of_text(text).map(|file: Processes| file.process).map_err(|error| error.to_string())
}

/// Built-in implementations: name, and the role that each fills.
pub const IMPLEMENTATIONS: [(&str, Role); 7] = [
    ("emulator", Role::Robot),
    ("player", Role::Robot),
    // The program `scanloop-ros2`, which is built apart.
    ("ros2", Role::Robot),
    ("ekf", Role::Estimator),
    ("ellipses", Role::Obstacles),
    ("nmpc", Role::Controller),
    ("actuation", Role::Actuator),
];

impl ProcessEntry {
    /// The role that the process fills.
    ///
    /// # Panics
    /// When the entry has not passed [`ProcessEntry::validate`].
    #[must_use]
    pub fn role(&self) -> Role {
        self.role.parse().expect("an entry is validated when it is read")
    }

    /// Whether the process fills no role.
    pub fn is_companion(&self) -> bool {
        self.role == COMPANION
    }

    /// Name of the companion, or of the role.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.role)
    }

    /// The topics that a companion reads.
    pub fn reads(&self) -> &[String] {
        self.reads.as_deref().unwrap_or_default()
    }

    /// The topics that a companion writes.
    pub fn writes(&self) -> &[String] {
        self.writes.as_deref().unwrap_or_default()
    }

    /// Whether the run ends when the companion has failed.
    pub fn is_needed(&self) -> bool {
        self.needed.unwrap_or(false)
    }

    /// Whether lock-step waits for the companion: it has to read something for that.
    pub fn is_in_lockstep(&self) -> bool {
        self.lockstep.unwrap_or(true) && !self.reads().is_empty()
    }

    /// The policy by which the companion is kept running.
    pub fn keeper_policy(&self, period_ns: u64) -> KeeperPolicy {
        KeeperPolicy {
            restarts: self.restart != Restart::Never,
            restart_limit: self.restart_limit as usize,
            window_ns: (self.restart_window_s * 1e9) as u64,
            hang_ns: KeeperPolicy::hang_ns(period_ns),
            start_ns: (self.start_timeout_s * 1e9) as u64,
        }
    }

    /// A command that fills a role, with the default policy.
    #[must_use]
    pub fn of(role: Role, command: &[String]) -> Self {
        Self { role: role.name().to_owned(), command: Some(command.to_vec()), ..Self::default() }
    }

    /// The policy by which the supervisor keeps the process alive.
    pub fn policy(&self, period_ns: u64) -> ProcessPolicy {
        let period_ms = period_ns.div_ceil(1_000_000);
        ProcessPolicy {
            restart: self.restart,
            start_limit: self.start_limit,
            restart_limit: self.restart_limit,
            restart_window_ms: (self.restart_window_s * 1e3) as u64,
            start_timeout_ms: (self.start_timeout_s * 1e3) as u64,
            grace_ms: self.grace_ms,
            ..ProcessPolicy::new(self.role(), period_ms)
        }
    }

    /// Name of the built-in implementation with its host, or the command.
    pub fn label(&self) -> String {
        if let (Some(host), Some(name)) = (&self.host, &self.implementation) {
            return format!("{name}@{host}");
        }
        match (&self.implementation, &self.command) {
            (Some(name), _) => name.clone(),
            (None, Some(command)) => command.join(" "),
            (None, None) => String::new(),
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed, with what is.
    pub fn validate(&self) -> Result<(), Invalid> {
        if self.is_companion() {
            return self.validate_companion();
        }
        let role: Role = self.role.parse().map_err(|_| {
            let given = if self.role.is_empty() { "(missing)" } else { &self.role };
            let roles = Role::ALL.iter().map(|role| role.name()).chain([COMPANION]);
            let meant = did_you_mean(&self.role, roles);
            Invalid::new(
                "role",
                given,
                if meant.is_empty() { ROLES.to_owned() } else { format!("{ROLES}.{meant}") },
            )
        })?;
        match (&self.implementation, &self.command) {
            (Some(name), None) => {
                if !IMPLEMENTATIONS.contains(&(name.as_str(), role)) {
                    let of_role: Vec<&str> =
                        IMPLEMENTATIONS.iter().filter(|(_, of)| *of == role).map(|(name, _)| *name).collect();
                    let meant = did_you_mean(name, of_role.iter().copied());
                    let allowed =
                        format!("one of {} for role {role}, or a `command`.{meant}", of_role.join(", "));
                    return Err(Invalid::new("implementation", name, allowed));
                }
            }
            (None, Some(command)) => {
                if command.first().is_none_or(String::is_empty) {
                    return Err(Invalid::new("command", "[]", "a program and its arguments"));
                }
            }
            _ => {
                let allowed = "one of `implementation` and `command`";
                return Err(Invalid::new("implementation", "both or none", allowed));
            }
        }
        let of_companions = [
            ("name", self.name.is_some()),
            ("reads", self.reads.is_some()),
            ("writes", self.writes.is_some()),
            ("needed", self.needed.is_some()),
            ("lockstep", self.lockstep.is_some()),
            ("reads_truth", self.reads_truth.is_some()),
        ];
        if let Some((key, _)) = of_companions.into_iter().find(|(_, is_set)| *is_set) {
            return Err(Invalid::new(key, format!("a key of role {role}"), "a key of role companion only"));
        }
        let reads_own = [Some("actuation"), Some("ekf")].contains(&self.implementation.as_deref());
        if self.command.is_none() && !reads_own && !self.also_reads.is_empty() {
            let allowed = "a key of a `command` of your own, of `actuation`, for emergency stops, and of `ekf`, for a gyro";
            return Err(Invalid::new("also_reads", format!("a key of {}", self.label()), allowed));
        }
        self.require_ranges()
    }

    fn validate_companion(&self) -> Result<(), Invalid> {
        let name = self.name.as_deref().unwrap_or_default();
        if name.parse::<Role>().is_ok() {
            return Err(Invalid::new("name", name, "no name of a role: a companion takes the place of none"));
        }
        if !is_name(name)
            || [COMPANION, runtime::OPERATOR, "orchestrator", "recorder", "link"].contains(&name)
        {
            return Err(Invalid::new("name", if name.is_empty() { "(missing)" } else { name }, NAME_RULE));
        }
        if let Some(implementation) = &self.implementation {
            return Err(Invalid::new(
                "implementation",
                implementation,
                "`command`: no companion is built in",
            ));
        }
        if self.command.as_ref().and_then(|command| command.first()).is_none_or(String::is_empty) {
            return Err(Invalid::new("command", "[]", "a program and its arguments"));
        }
        if let Some(host) = &self.host {
            return Err(Invalid::new(
                "host",
                host,
                "a key of a role: companions run on the machine of the orchestrator",
            ));
        }
        if !self.also_reads.is_empty() {
            return Err(Invalid::new("also_reads", "a key of role companion", "`reads` for companions"));
        }
        self.require_ranges()
    }
}

/// Whether a text may be the name of a companion or a topic.
pub fn is_name(text: &str) -> bool {
    let rest = text.strip_prefix(|first: char| first.is_ascii_lowercase());
    let allowed =
        |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || "-_".contains(letter);
    rest.is_some_and(|rest| rest.len() < 24 && rest.chars().all(allowed))
}

/// A role in files and messages, by its name.
pub mod role_name {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use shared_types::Role;

    /// Writes the name.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(role: &Role, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(role.name())
    }

    /// Reads the name.
    ///
    /// # Errors
    /// A text that is no role, with the names of all.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Role, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
