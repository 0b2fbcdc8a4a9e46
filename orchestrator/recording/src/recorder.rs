//! The recorder: a process of its own that copies every sample of a system into a recording.
//!
//! It only observes. One thread copies samples from the bus, another compresses and writes them, or keeps the last
//! seconds in memory. In real time a disk that stands still costs samples of the recording, never one of the drive; what
//! is lost is counted. For the orchestrator of a run it also reports the newest scan that it has copied, and lock-step waits
//! for that.

mod logs;
mod losses;
mod opening;
mod orchestrator;
mod queue;
mod ring;

use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use console::exit::Failure;
use console::new_file::{Existing, NewFile, make_folder};
use runtime::{
    Bus, Domain, OwnObserver, OwnTopics, PROCESSES_FILE, Priority, Shutdown, TopicObserver, monotonic_ns,
    print, wait_for,
};
use serde::{Deserialize, Serialize};
use shared_types::{Header, Heartbeat, Role, TOPICS, Topic};
use supervision::lock::Standstill;

use self::logs::Logs;
use self::losses::Losses;
use self::opening::Opening;
use self::orchestrator::{Orchestrator, Order};
use self::queue::{Queue, Sink};
use self::ring::Ring;
use crate::running;

/// Time between two checks whether the system still runs, and between two looks at the logs [ns].
const CHECK_NS: u64 = 200_000_000;
/// Time between two polls in lock-step, where samples come as fast as the machine allows [ns].
const LOCKSTEP_POLL_NS: u64 = 500_000;
/// Limits of the time between two polls in real time [ns]: a queue of 16 samples lasts longer at every scan rate.
const POLL_NS: [u64; 2] = [1_000_000, 10_000_000];
/// Of a topic of the system, one poll takes so many samples at most: a companion that floods it can't hold up the recorder.
const MAX_OWN: usize = 1024;
/// Added to the priority: the recorder comes after all processes of the loop.
const NICE: i32 = 10;
/// A ring is kept for so long after the death of the orchestrator: the wheels are blocked 5 s after it [ns].
const ORPHAN_NS: u64 = 10_000_000_000;

/// Options of the recorder.
#[derive(Debug, Clone)]
pub struct RecorderOptions {
    /// The recording; with a ring, the folder for the files of incidents.
    pub file: PathBuf,
    /// Keep so many seconds in memory, and write them when something happens.
    pub ring_s: Option<f64>,
    /// Replace a file of that name.
    pub force: bool,
    /// End after this time.
    pub duration: Option<Duration>,
    /// Take orders from standard input and report to standard output.
    pub of_run: bool,
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
pub fn record(domain: &Domain, options: &RecorderOptions, shutdown: &Shutdown) -> anyhow::Result<Summary> {
    let _ = rustix::process::nice(NICE);
    let opening = Opening::of(domain)?;
    let file = if options.ring_s.is_none() { Some(create(&options.file, options.force)?) } else { None };
    let bus = Bus::open(domain, "recorder")?;
    let observers: Vec<TopicObserver> =
        TOPICS.iter().map(|topic| TopicObserver::new(&bus, *topic)).collect::<Result<_, _>>()?;
    bus.allocate()?;
    observers.iter().for_each(TopicObserver::connect);
    let table = OwnTopics::of(domain)?;
    let own = opening.own.iter().map(|topic| match &table {
        Some(table) => OwnObserver::new(&bus, table, topic.name()).map(Some),
        None => Ok(None),
    });
    let own: Vec<OwnObserver> = own.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
    own.iter().for_each(OwnObserver::connect);
    // It is read while it grows, so it has its name from the start; without a bus there is none.
    let file = file.map(NewFile::publish).transpose()?;
    if file.is_some()
        && let Err(error) = running::note(domain, &options.file)
    {
        print(Priority::Warning, &format!("`why` does not find this recording: {error}"));
    }
    let mut logs = Logs::new(&opening.out.join("logs"), options.of_run);
    let (lockstep, period_ns) = (opening.lockstep, opening.period_ns);
    let known_settings = opening.settings_at_start();
    let sink = match file {
        Some(file) => Sink::File(opening.begin(BufWriter::new(file))?),
        None => Sink::Ring(Ring::new(opening, &options.file, options.ring_s.unwrap_or_default())),
    };
    let mut queue = Queue::start(sink, lockstep, lockstep && options.of_run)?;
    let mut orchestrator = options.of_run.then(Orchestrator::new).transpose()?;
    let mut losses = Losses::default();
    let started_ns = monotonic_ns();
    let mut end_ns = options.duration.map_or(u64::MAX, |duration| started_ns + duration.as_nanos() as u64);
    let poll_ns = match lockstep {
        true => LOCKSTEP_POLL_NS,
        // Their rate is not known, and few of their samples may wait.
        false if !own.is_empty() => POLL_NS[0],
        false => (period_ns / 4).clamp(POLL_NS[0], POLL_NS[1]),
    };
    let (mut next_check_ns, mut ends, mut last_scan, mut newest) = (0, false, 0, 0);
    let (mut is_orphaned, mut known_processes) = (false, Vec::new());
    let mut standstill = Standstill::default();
    loop {
        for observer in &observers {
            let topic = observer.topic();
            observer.poll(&mut |bytes| {
                let incarnation = (topic.sample_type().header)(bytes).incarnation;
                if losses.is_first(topic, incarnation) {
                    if let Ok(processes) = domain.folder().read(PROCESSES_FILE)
                        && known_processes != processes
                    {
                        // It names the process, as the orchestrator writes it before it announces one.
                        known_processes.clone_from(&processes);
                        queue.attach(format!("processes-{incarnation}.toml"), processes);
                    }
                    let role = Role::try_from(bytemuck::from_bytes::<Heartbeat>(bytes).role);
                    let settings = role.ok().and_then(|role| Opening::settings(domain, role, incarnation));
                    if let Some((name, text)) = settings.filter(|(_, text)| !known_settings.contains(text)) {
                        queue.attach(name, text);
                    }
                }
                losses.note(topic, bytes);
                if topic == Topic::Actuation {
                    newest = newest.max((topic.sample_type().header)(bytes).scan_id);
                }
                queue.add(topic as usize, bytes);
            })?;
        }
        for (index, observer) in own.iter().enumerate() {
            for _ in 0..MAX_OWN {
                let Some(bytes) = observer.next()? else { break };
                let header: Header = bytemuck::pod_read_unaligned(&bytes[..size_of::<Header>()]);
                losses.note_own(index, &header);
                queue.add(TOPICS.len() + index, &bytes);
            }
        }
        let now_ns = monotonic_ns();
        if now_ns >= next_check_ns || ends {
            next_check_ns = now_ns + CHECK_NS;
            logs.read(|role, line| queue.log(role, line));
            if let Some(change) = standstill.change(domain) {
                queue.log("orchestrator", &change);
                print(Priority::Warning, &change);
            }
            ends |= !domain.is_current() || now_ns >= end_ns || queue.has_failed();
        }
        queue.pass_on(now_ns, losses.lost());
        if ends {
            break;
        }
        if let Some(orchestrator) = &mut orchestrator {
            orchestrator.report_scan(newest);
            while let Some(saved) = queue.saved() {
                orchestrator.report_saved(&saved);
            }
            while let Some(order) = orchestrator.next_order() {
                match order {
                    Order::Connect => {
                        observers.iter().for_each(TopicObserver::connect);
                        own.iter().for_each(OwnObserver::connect);
                        orchestrator.say("connected");
                    }
                    Order::End(scan_id) => (last_scan, ends) = (scan_id, true),
                    Order::Incident => queue.incident(newest),
                    Order::Keep => queue.keep(),
                    Order::Note(text) => queue.log("orchestrator", &text),
                }
            }
            if options.ring_s.is_some() && !ends && !orchestrator.is_open() && !is_orphaned {
                is_orphaned = true;
                end_ns = now_ns + ORPHAN_NS;
                queue.log("orchestrator", "the orchestrator has died");
                queue.incident(newest);
            }
        }
        ends |= shutdown.requested();
        if !ends {
            wait_for(&[shutdown.descriptor()], poll_ns);
        }
    }
    if is_orphaned {
        queue.incident(newest);
    }
    let (mut summary, saved) = queue.finish(losses.lost(), last_scan);
    summary.file.clone_from(&options.file);
    if let Some(orchestrator) = &mut orchestrator {
        saved.iter().for_each(|saved| orchestrator.report_saved(saved));
        orchestrator.say(&format!("done {}", serde_json::to_string(&summary)?));
    }
    Ok(summary)
}

/// Makes the file of a recording.
fn create(path: &Path, force: bool) -> anyhow::Result<NewFile> {
    let refuse = |reason: &dyn std::fmt::Display| Failure::bad_input(format!("{}: {reason}", path.display()));
    if let Some(folder) = path.parent() {
        make_folder(folder).map_err(|error| refuse(&error))?;
    }
    NewFile::create(path, Existing::forced(force), &[])
}
