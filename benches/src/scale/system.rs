//! One system of the bench: its files, its run, and what is measured of it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use console::exit::Failure;
use figures::Figures;
use serde::Serialize;
use serde_json::Value;

/// The system file without companions.
const BUILT_IN: &str = include_str!("../../../orchestrator/systems/default.toml");
/// Topics of the loop that companions read in turns, so that none has more than its readers.
const SOURCES: [&str; 6] = ["odometry", "scan", "pose", "obstacles", "command", "actuation"];
/// A system that does not drive within this time has failed.
const START_LIMIT: Duration = Duration::from_secs(60);
/// Time between two polls during the start.
const POLL: Duration = Duration::from_millis(20);

/// What is beside the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    /// Companions that read a topic of the loop.
    pub writers: usize,
    /// Topics that they write, in turns.
    pub topics: usize,
    /// Companions that read the first of these topics.
    pub readers: usize,
    /// Bytes of a sample between header and stamps.
    pub bytes: usize,
}

/// What was measured of one system.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Measured {
    /// Of the loop.
    pub scan_to_actuation_us: Figures,
    /// Scans without a command.
    pub lost: u64,
    /// Samples that companions have published.
    pub samples: u64,
    /// Samples that companions have missed.
    pub missed: u64,
    /// What `scanloop check` prints.
    pub shared_memory_kib: u64,
    /// Resident memory of all processes while the system drives.
    pub memory_kib: u64,
    /// From the start of the orchestrator until the system drives.
    pub start_ms: f64,
}

/// The executable next to this one.
pub(super) fn program() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("the path of this program")?;
    let name = own.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix("-bench").unwrap_or(&name).to_owned();
    let program = own.with_file_name(name);
    if program == own || !program.is_file() {
        let reason = format!("{} is missing: name the executable with --program", program.display());
        return Err(Failure::process(reason));
    }
    Ok(program)
}

/// A folder that is removed when dropped.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Runs a system of that shape for so long.
pub(super) fn measure(program: &Path, shape: &Shape, duration_s: f64) -> anyhow::Result<Measured> {
    let id = format!("scale{}", std::process::id());
    // A new one: what is removed at the end is nobody else's.
    let folder = std::env::temp_dir().join(format!("scanloop-{id}"));
    runtime::Folder::make(&folder)?;
    let folder = Folder(folder);
    let (system, out) = (folder.0.join("system.toml"), folder.0.join("out"));
    let own = std::env::current_exe().context("the path of this program")?;
    let layout = format!("name = \"Bytes\"\n[[field]]\nname = \"content\"\ntype = \"u8[{}]\"\n", shape.bytes);
    std::fs::write(folder.0.join("bytes.toml"), layout)?;
    std::fs::write(&system, text(shape, &own))?;
    let call = |arguments: &[&str]| {
        let mut command = Command::new(program);
        command.args(["--system-id", &id]).args(arguments).stdin(Stdio::null());
        command
    };
    let file = system.to_str().context("a readable path")?;
    let checked = call(&["check", file]).output()?;
    if !checked.status.success() {
        bail!("{}", String::from_utf8_lossy(&checked.stderr));
    }
    let shared_memory_kib = shared_memory_kib(&String::from_utf8_lossy(&checked.stdout))
        .context("`check` does not print the shared memory")?;
    let (duration, folder_of_report) = (duration_s.to_string(), out.to_str().context("a readable path")?);
    let started = Instant::now();
    let run =
        ["run", "endless", "--quiet", "--system", file, "--duration", &duration, "--out", folder_of_report];
    let mut running = call(&run).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()?;
    let status = || -> Option<Value> {
        let output = call(&["status", "--json"]).output().ok()?;
        serde_json::from_slice(&output.stdout).ok()
    };
    let start_ms = loop {
        if status().is_some_and(|status| status["state"] == "driving") {
            break started.elapsed().as_secs_f64() * 1e3;
        }
        if running.try_wait()?.is_some() || started.elapsed() > START_LIMIT {
            let _ = running.kill();
            let said = running.wait_with_output()?;
            return Err(Failure::process(format!(
                "the system does not drive: {}",
                String::from_utf8_lossy(&said.stderr).trim()
            )));
        }
        std::thread::sleep(POLL);
    };
    std::thread::sleep(Duration::from_secs_f64(duration_s / 2.0));
    let memory_kib = status().map_or(0, |status| memory_kib(&status));
    running.wait()?;
    let report: Value = serde_json::from_slice(&std::fs::read(out.join("report.json"))?)?;
    let sum = |key: &str| {
        let rows = report["companions"].as_array().into_iter().flatten();
        rows.map(|row| row[key].as_u64().unwrap_or(0)).sum()
    };
    Ok(Measured {
        scan_to_actuation_us: serde_json::from_value(report["latency_us"]["scan_to_actuation"].clone())?,
        lost: report["scans"]["lost"].as_u64().unwrap_or(0),
        samples: sum("published"),
        missed: sum("missed"),
        shared_memory_kib,
        memory_kib,
        start_ms,
    })
}

/// The system file; `own` is the program of its companions.
fn text(shape: &Shape, own: &Path) -> String {
    let mut text = BUILT_IN.to_owned();
    // Large samples are not queued: what waits is a multiple of the readers.
    let queue = if shape.bytes > 100_000 { 1 } else { 4 };
    let readers = shape.readers.max(1);
    for topic in 0..shape.topics {
        let _ = write!(
            text,
            "\n[[topic]]\nname = \"t{topic}\"\nlayout = \"bytes.toml\"\nqueue = {queue}\nreaders = {readers}\n"
        );
    }
    let mut companion = |name: String, reads: &str, writes: Vec<String>| {
        let _ = write!(
            text,
            "\n[[process]]\nrole = \"companion\"\nname = \"{name}\"\ncommand = [{:?}, \"service\", \"{}\"]\nneeded = \
             true\nreads = [{reads:?}]\nwrites = {writes:?}\n",
            own.display().to_string(),
            super::companion::SERVICE,
        );
    };
    for writer in 0..shape.writers {
        let writes = (writer..shape.topics).step_by(shape.writers).map(|topic| format!("t{topic}")).collect();
        companion(format!("writer{writer}"), SOURCES[writer % SOURCES.len()], writes);
    }
    (0..shape.readers).for_each(|reader| companion(format!("reader{reader}"), "t0", Vec::new()));
    text
}

/// The sum in the output of `scanloop check`.
fn shared_memory_kib(text: &str) -> Option<u64> {
    let rest = text.split_once("shared memory: ")?.1;
    rest.split_whitespace().next()?.parse().ok()
}

/// Resident memory of all processes in the status of a system.
fn memory_kib(status: &Value) -> u64 {
    let rows = ["processes", "companions"].map(|key| status[key].as_array().cloned().unwrap_or_default());
    rows.iter().flatten().map(|row| row["memory_kib"].as_u64().unwrap_or(0)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_topic_has_one_writer_and_every_reader_its_topic() {
        let shape = Shape { writers: 2, topics: 5, readers: 3, bytes: 64 };
        let table: toml::Table = text(&shape, Path::new("/bench")).parse().unwrap();
        let rows = table["process"].as_array().unwrap().iter();
        let companions: Vec<_> = rows.filter(|row| row["role"].as_str() == Some("companion")).collect();
        assert_eq!(companions.len(), 5);
        let mut written: Vec<&str> = companions
            .iter()
            .flat_map(|row| row["writes"].as_array().unwrap())
            .map(|name| name.as_str().unwrap())
            .collect();
        written.sort_unstable();
        assert_eq!(written, ["t0", "t1", "t2", "t3", "t4"]);
        assert_eq!(table["topic"].as_array().unwrap().len(), 5);
    }

    #[test]
    fn the_sum_is_read_from_the_output_of_check() {
        let text = "  ...\n  shared memory: 1234 KiB, of these 5 KiB for 1 topics and 2 companions\n";
        assert_eq!(shared_memory_kib(text), Some(1234));
    }
}
