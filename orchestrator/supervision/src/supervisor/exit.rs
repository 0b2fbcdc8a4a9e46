//! How a process ended, as `status` and messages show it.

use std::fmt;
use std::os::unix::process::ExitStatusExt;

/// Names of the signals 1 to 31 without `SIG`, as Linux numbers them on x86, Arm and RISC-V.
const SIGNALS: [&str; 31] = [
    "HUP", "INT", "QUIT", "ILL", "TRAP", "ABRT", "BUS", "FPE", "KILL", "USR1", "SEGV", "USR2", "PIPE",
    "ALRM", "TERM", "STKFLT", "CHLD", "CONT", "STOP", "TSTP", "TTIN", "TTOU", "URG", "XCPU", "XFSZ",
    "VTALRM", "PROF", "WINCH", "IO", "PWR", "SYS",
];

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProcessExit {
    /// It returned or called `exit` with this code.
    Code(i32),
    /// A signal of this number killed it.
    Signal(i32),
    /// The kernel reports it to the parent only, and this process was adopted.
    Unknown,
}

impl ProcessExit {
    /// Whether the process ended by itself without an error.
    pub const fn is_success(self) -> bool {
        matches!(self, Self::Code(0))
    }
}

impl From<std::process::ExitStatus> for ProcessExit {
    fn from(status: std::process::ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Self::Code(code),
            (None, Some(number)) => Self::Signal(number),
            // A status of a process that has ended is one of the two; keep the raw number of anything else.
            (None, None) => Self::Code(status.into_raw()),
        }
    }
}

impl fmt::Display for ProcessExit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Code(code) => write!(formatter, "exit code {code}"),
            Self::Unknown => formatter.write_str("exit code unknown, as it was adopted"),
            Self::Signal(number) => {
                write!(formatter, "killed by signal {number}")?;
                let name = usize::try_from(number - 1).ok().and_then(|index| SIGNALS.get(index));
                name.map_or(Ok(()), |name| write!(formatter, " (SIG{name})"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exit_names_its_code_or_signal() {
        assert_eq!(ProcessExit::Code(2).to_string(), "exit code 2");
        assert_eq!(ProcessExit::Signal(9).to_string(), "killed by signal 9 (SIGKILL)");
        assert_eq!(ProcessExit::Signal(15).to_string(), "killed by signal 15 (SIGTERM)");
        assert_eq!(ProcessExit::Signal(31).to_string(), "killed by signal 31 (SIGSYS)");
        assert_eq!(ProcessExit::Signal(40).to_string(), "killed by signal 40");
        assert_eq!(ProcessExit::Signal(0).to_string(), "killed by signal 0");
        assert_eq!(ProcessExit::Unknown.to_string(), "exit code unknown, as it was adopted");
    }

    #[test]
    fn only_code_zero_is_a_success() {
        assert!(ProcessExit::Code(0).is_success());
        assert!(
            !ProcessExit::Code(1).is_success()
                && !ProcessExit::Signal(15).is_success()
                && !ProcessExit::Unknown.is_success()
        );
    }
}
