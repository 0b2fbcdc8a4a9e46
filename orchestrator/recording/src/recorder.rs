//! The recorder: a process of its own that copies every sample of a system into a recording.
//!
//! It only observes. One thread copies samples from the bus, another compresses and writes them. In real time a disk
//! that stands still costs samples of the recording, never one of the drive; what is lost is counted. As the companion
//! of a run it also reports the newest scan that it has copied, and lock-step waits for that.

mod companion;
mod logs;
mod losses;
mod queue;

use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use console::exit::Failure;
use runtime::{
    Bus, Domain, LAYOUTS_FILE, PROCESSES_FILE, Shutdown, TopicObserver, monotonic_ns, settings_file, wait_for,
};
use serde::{Deserialize, Serialize};
use shared_types::{Role, TOPICS, Topic};

use self::companion::{Companion, Order};
use self::logs::Logs;
use self::losses::Losses;
use self::queue::Queue;
use crate::read::{LAYOUTS, RUN};
use crate::tape::{LIBRARY, Tape};

/// Time between two checks whether the system still runs, and between two looks at the logs [ns].
const CHECK_NS: u64 = 200_000_000;
/// Time between two polls in lock-step, where samples come as fast as the machine allows [ns].
const LOCKSTEP_POLL_NS: u64 = 500_000;
/// Limits of the time between two polls in real time [ns]: a queue of 16 samples lasts longer at every scan rate.
const POLL_NS: [u64; 2] = [1_000_000, 10_000_000];
/// Added to the priority: the recorder comes after all processes of the loop.
const NICE: i32 = 10;

/// Options of the recorder.
#[derive(Debug, Clone)]
pub struct Options {
    /// The recording.
    pub file: PathBuf,
    /// Replace a file of that name.
    pub force: bool,
    /// End after this time.
    pub duration: Option<Duration>,
    /// Take orders from standard input and report to standard output.
    pub companion: bool,
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// The recording.
    pub file: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// Samples that are missing in it.
    pub lost: u64,
    /// Why it ended before the drive; empty if it did not.
    #[serde(default)]
    pub error: String,
}

/// Records a running system until it ends, `shutdown` is requested or the time is over.
///
/// # Errors
/// A file that exists or can't be made (exit code 2), and errors of the bus.
pub fn record(domain: &Domain, options: &Options, shutdown: &Shutdown) -> anyhow::Result<Summary> {
    let _ = rustix::process::nice(NICE);
    let run = RunText::read(domain)?;
    let file = create(&options.file, options.force)?;
    let bus = Bus::open(domain, "recorder")?;
    let observers: Vec<TopicObserver> =
        TOPICS.iter().map(|topic| TopicObserver::new(&bus, *topic)).collect::<Result<_, _>>()?;
    bus.allocate()?;
    observers.iter().for_each(TopicObserver::connect);
    let mut tape = Tape::new(BufWriter::new(file), run.lockstep)?;
    attach(&mut tape, domain, &run)?;
    let mut queue = Queue::start(tape, run.lockstep && options.companion)?;
    let mut companion = options.companion.then(Companion::new).transpose()?;
    let mut logs = Logs::new(&run.out.join("logs"), options.companion);
    let mut losses = Losses::default();
    let started_ns = monotonic_ns();
    let limit_ns = options.duration.map_or(u64::MAX, |duration| duration.as_nanos() as u64);
    let poll_ns =
        if run.lockstep { LOCKSTEP_POLL_NS } else { (run.period_ns / 4).clamp(POLL_NS[0], POLL_NS[1]) };
    let (mut next_check_ns, mut ends, mut last_scan) = (0, false, 0);
    loop {
        let mut newest = 0;
        for observer in &observers {
            let topic = observer.topic();
            observer.poll(&mut |bytes| {
                let incarnation = (topic.sample_type().header)(bytes).incarnation;
                if losses.is_first(topic, incarnation)
                    && let Ok(processes) = domain.folder().read(PROCESSES_FILE)
                {
                    // It names the process, as the orchestrator writes it before it announces one.
                    queue.attach(format!("processes-{incarnation}.toml"), processes);
                }
                losses.note(topic, bytes);
                if topic == Topic::Actuation {
                    newest = newest.max((topic.sample_type().header)(bytes).scan_id);
                }
                queue.add(topic, bytes);
            })?;
        }
        let now_ns = monotonic_ns();
        if now_ns >= next_check_ns || ends {
            next_check_ns = now_ns + CHECK_NS;
            logs.read(|role, line| queue.log(role, line));
            ends |= !domain.is_current() || now_ns - started_ns >= limit_ns || queue.has_failed();
        }
        queue.pass_on();
        if ends {
            break;
        }
        if let Some(companion) = &mut companion {
            companion.report_scan(newest);
            while let Some(order) = companion.next_order() {
                match order {
                    Order::Connect => {
                        observers.iter().for_each(TopicObserver::connect);
                        companion.say("connected");
                    }
                    Order::End(scan_id) => (last_scan, ends) = (scan_id, true),
                    Order::Note(text) => queue.log("orchestrator", &text),
                }
            }
        }
        ends |= shutdown.requested();
        if !ends {
            wait_for(&[shutdown.descriptor()], poll_ns);
        }
    }
    let mut summary = queue.finish(losses.lost(), last_scan);
    summary.file.clone_from(&options.file);
    if let Some(companion) = &mut companion {
        companion.say(&format!("done {}", serde_json::to_string(&summary)?));
    }
    Ok(summary)
}

/// Makes the file of a recording.
fn create(path: &Path, force: bool) -> anyhow::Result<File> {
    let refuse = |reason: &dyn std::fmt::Display| Failure::bad_input(format!("{}: {reason}", path.display()));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| refuse(&error))?;
    }
    if !force && path.exists() {
        return Err(refuse(&"the file exists; name another one, or replace it with --force"));
    }
    OpenOptions::new().write(true).create(true).truncate(true).open(path).map_err(|error| refuse(&error))
}

/// The run as its files in the directory of the system describe it.
struct RunText {
    text: String,
    out: PathBuf,
    lockstep: bool,
    period_ns: u64,
}

impl RunText {
    fn read(domain: &Domain) -> anyhow::Result<Self> {
        #[derive(Deserialize)]
        struct Run {
            out: PathBuf,
            lockstep: bool,
        }
        #[derive(Deserialize)]
        struct Settings {
            run: runtime::RunSettings,
        }
        let text = domain.folder().read_text(RUN)?;
        let Run { out, lockstep } = toml::from_str(&text)?;
        let settings: Settings = toml::from_str(&domain.folder().read_text(&settings_file(Role::Robot))?)?;
        Ok(Self { text, out, lockstep, period_ns: settings.run.period_ns })
    }
}

/// Puts scenario, system, settings, layouts and the machine into the recording.
fn attach<W: std::io::Write>(tape: &mut Tape<W>, domain: &Domain, run: &RunText) -> anyhow::Result<()> {
    tape.attach(RUN, run.text.as_bytes())?;
    for role in Role::ALL {
        let name = settings_file(*role);
        tape.attach(&name, domain.folder().read_text(&name)?.as_bytes())?;
    }
    tape.attach(LAYOUTS, domain.folder().read_text(LAYOUTS_FILE)?.as_bytes())?;
    let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let machine = format!("{} {} {}", std::env::consts::OS, kernel.trim(), std::env::consts::ARCH);
    let executable = std::fs::read("/proc/self/exe").map_or(0, |bytes| crc32fast::hash(&bytes));
    let entries = [
        ("version", "1".to_owned()),
        ("program", LIBRARY.to_owned()),
        ("executable_crc32", format!("{executable:08x}")),
        ("machine", machine),
        ("run_id", domain.run_id().to_owned()),
        ("system_id", domain.system_id().to_owned()),
        ("lockstep", run.lockstep.to_string()),
        ("period_ns", run.period_ns.to_string()),
    ];
    Ok(tape.describe("recording", &entries.map(|(key, value)| (key.to_owned(), value)))?)
}
