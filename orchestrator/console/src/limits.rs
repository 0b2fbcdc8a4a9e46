//! Limits of the kernel, and a umask, that may be too small for a system: what must hold before one is started, and the
//! limit behind an error.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use runtime::RuntimeError;
use rustix::fs::Mode;
use rustix::io::Errno;
use rustix::process::{Resource, Rlimit, Signal, geteuid, getrlimit, setrlimit, umask};

use crate::control_group;
use crate::exit::Failure;

/// Twice the measured use of the deepest computation [bytes].
const MIN_STACK_BYTES: u64 = 1 << 20;

/// A port of the bus opens up to so many files at once.
pub const SPARE_FILES: usize = 8;

/// An orchestrator has 150 files open while it drives, and more during a swap; a recorder has 70.
const MIN_FILES: u64 = 256;

/// The limit of open files that is requested where it is allowed.
const WANTED_FILES: u64 = 1024;

/// A system has files as large as this [bytes].
const MIN_FILE_BYTES: u64 = 256 << 20;

/// What a system needs of a limit that each process has.
struct Need {
    resource: Resource,
    /// Its name in `/proc/PID/limits`.
    name: &'static str,
    minimum: u64,
    /// The limit that is requested where it is allowed; as far as possible without one.
    wanted: Option<u64>,
    /// The limit is told and set in so many of the kernel's units.
    unit: u64,
    /// The sentence, with `{}` in the place of the limit.
    what: &'static str,
    /// The option of `ulimit`.
    option: &'static str,
}

const NEEDS: [Need; 5] = [
    Need {
        resource: Resource::Nofile,
        name: "Max open files",
        minimum: MIN_FILES,
        wanted: Some(WANTED_FILES),
        unit: 1,
        what: "at most {} files may be open",
        option: "-n",
    },
    Need {
        resource: Resource::Fsize,
        name: "Max file size",
        // The reserve of shared memory for one more process is a file, and the largest one; recordings may grow beyond it.
        minimum: MIN_FILE_BYTES,
        wanted: None,
        unit: 1024,
        what: "files are limited to {} KiB",
        option: "-f",
    },
    Need {
        resource: Resource::As,
        name: "Max address space",
        // An orchestrator with a recorder and a swap maps less than half of it.
        minimum: 512 << 20,
        wanted: None,
        unit: 1024,
        what: "the addresses of a process are limited to {} KiB",
        option: "-v",
    },
    Need {
        resource: Resource::Data,
        name: "Max data size",
        // The last seconds of a drive take 64 MiB at most.
        minimum: 256 << 20,
        wanted: None,
        unit: 1024,
        what: "the data of a process are limited to {} KiB",
        option: "-d",
    },
    Need {
        resource: Resource::Cpu,
        name: "Max cpu time",
        // A process uses 1 % of a processor: less than this would end it within a day.
        minimum: 900,
        wanted: None,
        unit: 1,
        what: "the processor time of a process is limited to {} s",
        option: "-t",
    },
];

const STACK: Need = Need {
    resource: Resource::Stack,
    name: "Max stack size",
    minimum: MIN_STACK_BYTES,
    wanted: Some(MIN_STACK_BYTES),
    unit: 1024,
    what: "the stack is limited to {} KiB",
    option: "-s",
};

/// Clears the owner's bits of the umask: with them, only root could enter the directories that the bus makes. The
/// rest of the umask stays as the user wants it.
pub fn keep_own_rights() {
    let mask = umask(Mode::RWXG | Mode::RWXO);
    umask(mask & (Mode::RWXG | Mode::RWXO));
}

/// Passes when the stack suffices; raises its limit when that is allowed. The kernel checks the limit whenever the
/// stack of a process grows, so this holds at once, and for all processes started from now on.
///
/// # Errors
/// The limit, what is needed, and the command that sets it; exit code 4.
pub fn require_stack() -> anyhow::Result<()> {
    STACK.require().map_err(Failure::process)
}

/// Passes when the limits of this process, which those that it starts inherit, suffice for a system; raises them when that is
/// allowed.
///
/// # Errors
/// As [`require_stack`], for the first limit that is too small; a machine without `/proc`.
pub fn require_room_for_a_system() -> anyhow::Result<()> {
    require_proc()?;
    NEEDS.iter().try_for_each(Need::require).map_err(Failure::process)
}

/// Passes when the kernel shows processes in files, by which systems are found and reached.
///
/// # Errors
/// A machine without `/proc`; exit code 4.
pub fn require_proc() -> anyhow::Result<()> {
    match Path::new("/proc/self").exists() {
        true => Ok(()),
        false => Err(Failure::process("/proc is not mounted: `mount -t proc proc /proc` as root")),
    }
}

/// A limit that a system needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExaminedLimit {
    /// Its name in `/proc/PID/limits`.
    pub name: &'static str,
    /// The hard limit, because a soft one is raised; `u64::MAX` without one.
    pub hard: u64,
    /// What is too small, and the command that sets it.
    pub fault: Option<String>,
}

/// The limits in a text of `/proc/PID/limits` that [`require_stack`] and [`require_room_for_a_system`] are about.
pub fn examine(text: &str) -> Vec<ExaminedLimit> {
    let examined = NEEDS.iter().chain([&STACK]).filter_map(|need| {
        let hard = hard_limit(text, need.name)?;
        let fault = (hard < need.minimum).then(|| need.fault(hard));
        Some(ExaminedLimit { name: need.name, hard, fault })
    });
    examined.collect()
}

/// A hard limit in a text of `/proc/PID/limits`; `u64::MAX` for `unlimited`.
pub fn hard_limit(text: &str, name: &str) -> Option<u64> {
    let values = text.lines().find_map(|line| line.strip_prefix(name))?;
    match values.split_whitespace().nth(1)? {
        "unlimited" => Some(u64::MAX),
        number => number.parse().ok(),
    }
}

impl Need {
    /// Passes when the limit of this process suffices; raises it when that is allowed.
    fn require(&self) -> Result<(), String> {
        let limit = raise(self.resource, self.wanted.unwrap_or(u64::MAX));
        if limit < self.minimum { Err(self.fault(limit)) } else { Ok(()) }
    }

    fn fault(&self, limit: u64) -> String {
        let (limit, needed) = (limit / self.unit, self.minimum / self.unit);
        let what = self.what.replace("{}", &limit.to_string());
        format!("{what}, {needed} are needed: `ulimit {} {needed}`", self.option)
    }
}

/// Lets a write beyond the limit of the size of files fail with an error, where the signal of the kernel would end this
/// process without a word.
pub fn keep_from_large_files() {
    // A signal that is handled does not end the process; what it has set is not read.
    let seen = Arc::new(AtomicBool::new(false));
    if let Err(error) = signal_hook::flag::register(Signal::XFSZ.as_raw(), seen) {
        tracing::debug!(%error, "a file that becomes too large ends this process");
    }
}

/// Passes when `count` files more can be opened; raises the limit when that is allowed. What a command finds without them, for
/// example that no system is running, would be wrong.
///
/// # Errors
/// The limit; exit code 4.
pub fn require_files(count: usize) -> anyhow::Result<()> {
    raise(Resource::Nofile, WANTED_FILES);
    let Some(errno) = lacking_descriptors(count) else { return Ok(()) };
    Err(Failure::process(limit_behind(errno).unwrap_or_else(|| errno.to_string())))
}

/// The limit that an error is about when the kernel has refused something for one.
pub fn limit_of(error: &anyhow::Error) -> Option<String> {
    let mut causes = error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>());
    let limit = causes.find_map(|cause| limit_behind(Errno::from_io_error(cause)?));
    let limit = limit.or_else(|| limit_behind(lacking_descriptors(SPARE_FILES)?));
    // Errors of the bus do not tell their causes, and what was open is closed again.
    let is_of_bus = error.chain().any(|cause| matches!(cause.downcast_ref(), Some(RuntimeError::Bus { .. })));
    let too_small =
        [(Resource::Nofile, MIN_FILES, Errno::MFILE), (Resource::Fsize, MIN_FILE_BYTES, Errno::FBIG)]
            .into_iter()
            .find(|(resource, least, _)| {
                is_of_bus && getrlimit(*resource).current.is_some_and(|most| most < *least)
            });
    limit.or_else(|| limit_behind(too_small?.2))
}

/// The text of an error, with the limit that it is about when the kernel has refused something for a limit.
pub fn text_of(error: &anyhow::Error) -> String {
    let limit = limit_of(error);
    let mut text = String::new();
    // Some errors name their cause themselves.
    for part in error.chain().map(ToString::to_string).chain(limit).filter(|part| !part.is_empty()) {
        if !text.contains(&part) {
            text += if text.is_empty() { "" } else { ": " };
            text += &part;
        }
    }
    text
}

/// Why this process can't open `count` files more, if that is so. Errors of the bus do not tell it.
fn lacking_descriptors(count: usize) -> Option<Errno> {
    let opened: Vec<io::Result<File>> = (0..count).map(|_| File::open("/dev/null")).collect();
    let errors = opened.iter().filter_map(|opened| Errno::from_io_error(opened.as_ref().err()?));
    errors.into_iter().find(|errno| [Errno::MFILE, Errno::NFILE].contains(errno))
}

/// The limit that the kernel refers to with an error; `None` when there is none, or it is not known which.
fn limit_behind(errno: Errno) -> Option<String> {
    let of = |resource| getrlimit(resource).current;
    match errno {
        Errno::AGAIN => processes_limit(),
        Errno::MFILE => of(Resource::Nofile)
            .map(|most| format!("at most {most} files may be open in a process: raise `ulimit -n`")),
        Errno::NFILE => Some("the machine allows no more open files: raise `sysctl fs.file-max`".to_owned()),
        Errno::FBIG => of(Resource::Fsize)
            .map(|bytes| format!("a file may have {} KiB at most: raise `ulimit -f`", bytes / 1024)),
        Errno::NOMEM => memory_limit().or_else(|| {
            let control_group::Reached { group, limit } = control_group::memory_limit()?;
            Some(format!("its control group {group} allows {} KiB of memory", limit / 1024))
        }),
        _ => None,
    }
}

/// Of the limits of memory of this process, the one that is nearest.
fn memory_limit() -> Option<String> {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let used_kib = |name: &str| -> Option<u64> {
        status.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
    };
    let limits = [(Resource::As, "VmSize:", "addresses", "-v"), (Resource::Data, "VmData:", "data", "-d")];
    let limits = limits.into_iter().filter_map(|(resource, used, what, option)| {
        let limit_kib = getrlimit(resource).current? / 1024;
        let left_kib = limit_kib.saturating_sub(used_kib(used).unwrap_or(0));
        Some((left_kib, format!("a process may have {limit_kib} KiB of {what}: raise `ulimit {option}`")))
    });
    limits.min().map(|(_, text)| text)
}

/// The limit of processes and threads that holds.
fn processes_limit() -> Option<String> {
    if let Some(control_group::Reached { group, limit }) = control_group::processes_reached() {
        return Some(format!(
            "its control group {group} allows {limit} processes and threads, and has as many: raise `pids.max`"
        ));
    }
    let of_user = getrlimit(Resource::Nproc).current;
    // The kernel does not limit the processes of root by user.
    let holding = of_user.filter(|_| !geteuid().is_root()).unwrap_or(u64::MAX);
    match control_group::processes_refused().filter(|refused| refused.limit <= holding) {
        Some(control_group::Reached { group, limit }) => {
            Some(format!("its control group {group} allows {limit} processes and threads: raise `pids.max`"))
        }
        None => {
            of_user.map(|most| format!("a user may have {most} processes and threads: raise `ulimit -u`"))
        }
    }
}

/// Raises a limit to `wanted`, or as far as is allowed; returns the new limit.
fn raise(resource: Resource, wanted: u64) -> u64 {
    let Rlimit { current, maximum } = getrlimit(resource);
    let limit = current.unwrap_or(u64::MAX);
    let allowed = wanted.min(maximum.unwrap_or(u64::MAX));
    if limit < allowed
        && setrlimit(resource, Rlimit { current: (allowed < u64::MAX).then_some(allowed), maximum }).is_ok()
    {
        allowed
    } else {
        limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_bus_names_the_size_of_files_only_where_it_is_limited() {
        let error =
            RuntimeError::Bus { action: "join the bus".to_owned(), reason: "InternalError".to_owned() };
        let is_limited = getrlimit(Resource::Fsize).current.is_some_and(|bytes| bytes < MIN_FILE_BYTES);
        assert_eq!(limit_of(&error.into()).is_some(), is_limited);
        assert!(require_files(SPARE_FILES).is_ok());
    }

    #[test]
    fn hard_limits_are_examined_as_the_kernel_lists_them() {
        let text = "Limit                     Soft Limit           Hard Limit           Units     \n\
                    Max open files            64                   128                  files     \n\
                    Max file size             unlimited            unlimited            bytes     \n";
        let examined = examine(text);
        assert_eq!(examined.len(), 2);
        let fault = "at most 128 files may be open, 256 are needed: `ulimit -n 256`";
        assert_eq!(examined[0].fault.as_deref(), Some(fault));
        assert_eq!((examined[1].hard, &examined[1].fault), (u64::MAX, &None));
        let own = std::fs::read_to_string("/proc/self/limits").unwrap();
        assert_eq!(examine(&own).len(), NEEDS.len() + 1, "the kernel has all of these names");
    }

    #[test]
    fn an_error_names_the_limit_behind_it() {
        let text = |errno: Errno| text_of(&anyhow::Error::from(io::Error::from(errno)).context("start"));
        let most = getrlimit(Resource::Nofile).current.unwrap();
        assert!(
            text(Errno::MFILE)
                .ends_with(&format!("at most {most} files may be open in a process: raise `ulimit -n`"))
        );
        assert!(text(Errno::NFILE).contains("fs.file-max"));
        assert_eq!(text(Errno::PERM), format!("start: {}", io::Error::from(Errno::PERM)));
        // Of two limits of memory the one that is nearer; both are out of reach here.
        let limits = [(Resource::Data, 1 << 44, "`ulimit -d`"), (Resource::As, 1 << 43, "`ulimit -v`")];
        let before = limits.map(|(resource, ..)| getrlimit(resource));
        for ((resource, far, option), before) in limits.iter().zip(&before) {
            setrlimit(*resource, Rlimit { current: Some(*far), maximum: before.maximum }).unwrap();
            assert!(text(Errno::NOMEM).contains(option), "{}", text(Errno::NOMEM));
        }
        limits.iter().zip(before).for_each(|((resource, ..), before)| setrlimit(*resource, before).unwrap());
    }
}
