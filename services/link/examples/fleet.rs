//! A fleet over Zenoh: many robots, a router and a dashboard on this machine, and what each of them costs.
//!
//! ```text
//! cargo run --manifest-path services/link/Cargo.toml --example fleet -- 10 100 400
//! ```
//!
//! Each robot is a session of its own. It publishes its pose ten times a second and a status once a second. The dashboard
//! receives all. Robots, router and dashboard are three processes, whose processor time is read from `/proc`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use runtime::monotonic_ns;
use shared_types::Topic;
use zenoh::qos::CongestionControl;
use zenoh::{Config, Session, Wait};

/// Where the router listens.
const ROUTER: &str = "tcp/127.0.0.1:7447";
/// Time between two poses of a robot.
const POSE: Duration = Duration::from_millis(100);
/// After so many poses comes a status.
const POSES_PER_STATUS: u64 = 10;
/// What `scanloop status --json` prints of a system on one host, rounded up [bytes].
const STATUS_BYTES: usize = 4096;
/// How long a fleet is measured.
const MEASURED: Duration = Duration::from_secs(10);
/// Ticks of `/proc/PID/stat` in a second.
const TICKS_PER_SECOND: f64 = 100.0;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["router"] => {
            let _session = open("router", &[ROUTER], &[])?;
            ready();
            wait_for_end()
        }
        ["robots", count] => robots(count.parse()?),
        ["dashboard"] => dashboard(),
        [] => bail!("name the sizes of fleets, as: fleet 10 100 400"),
        sizes => {
            println!(
                "robots, samples/s, arrived, age p50/p99 [ms], bytes/s and CPU [%] per robot: robot, router, dashboard"
            );
            sizes.iter().try_for_each(|size| measure(size.parse()?))
        }
    }
}

/// A session without scouting.
fn open(mode: &str, listen: &[&str], connect: &[&str]) -> anyhow::Result<Session> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        ("listen/endpoints", format!("{listen:?}")),
        ("connect/endpoints", format!("{connect:?}")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).map_err(|error| anyhow!("{key} = {value}: {error}"))?;
    }
    zenoh::open(config).wait().map_err(|error| anyhow!("{error}"))
}

/// Tells the process that has started this one that it works.
fn ready() {
    println!("ready");
}

fn wait_for_end() -> anyhow::Result<()> {
    std::io::stdin().lock().read_line(&mut String::new())?;
    Ok(())
}

/// `count` robots, each with a session, until the input ends. Their samples are spread over the period.
fn robots(count: usize) -> anyhow::Result<()> {
    let mut publishers = Vec::new();
    for number in 0..count {
        let session = open("client", &[], &[ROUTER])?;
        let publisher = |topic: &str| {
            let key = format!("fleet/robot{number}/{topic}");
            let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
            publisher.wait().map_err(|error| anyhow!("{error}"))
        };
        publishers.push((publisher("pose")?, publisher("status")?, session.clone()));
    }
    ready();
    std::thread::spawn(move || {
        let begun = Instant::now();
        for scan in 0_u64.. {
            for (index, (pose, status, _session)) in publishers.iter().enumerate() {
                let share = (scan as f64 + index as f64 / count as f64) * POSE.as_secs_f64();
                std::thread::sleep(Duration::from_secs_f64(share).saturating_sub(begun.elapsed()));
                let _ = pose.put(sample(Topic::Pose.size())).wait();
                if (scan + index as u64).is_multiple_of(POSES_PER_STATUS) {
                    let _ = status.put(sample(STATUS_BYTES)).wait();
                }
            }
        }
    });
    wait_for_end()
}

/// A sample of that size: the time, and zeros.
fn sample(size: usize) -> Vec<u8> {
    let mut bytes = vec![0; size];
    bytes[..8].copy_from_slice(&monotonic_ns().to_le_bytes());
    bytes
}

/// Receives all robots until the input ends, and prints the ages of the samples of each second [us].
fn dashboard() -> anyhow::Result<()> {
    let session = open("client", &[], &[ROUTER])?;
    let ages: Arc<Mutex<Vec<u64>>> = Arc::default();
    let received = Arc::clone(&ages);
    let subscriber = session.declare_subscriber("fleet/**").callback(move |sample| {
        if let Some(sent_ns) = sample.payload().to_bytes().first_chunk::<8>()
            && let Ok(mut ages) = received.lock()
        {
            ages.push(monotonic_ns().saturating_sub(u64::from_le_bytes(*sent_ns)) / 1000);
        }
    });
    let _subscriber = subscriber.wait().map_err(|error| anyhow!("{error}"))?;
    ready();
    // A line asks for what has come since the line before.
    for _ in std::io::stdin().lock().lines() {
        let mut ages = std::mem::take(&mut *ages.lock().map_err(|_| anyhow!("a thread has panicked"))?);
        ages.sort_unstable();
        let quantile = |share: f64| ages.get((share * ages.len() as f64) as usize).copied().unwrap_or(0);
        println!("{} {} {}", ages.len(), quantile(0.5), quantile(0.99));
    }
    Ok(())
}

/// One of the three processes.
struct Part {
    child: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Part {
    fn start(arguments: &[&str]) -> anyhow::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        let mut child = command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let mut part = Self { output: BufReader::new(child.stdout.take().context("no output")?), child };
        part.line()?;
        Ok(part)
    }

    fn line(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        self.output.read_line(&mut line)?;
        if line.is_empty() {
            bail!("a process has ended: see its message")
        }
        Ok(line)
    }

    /// What has come since it was asked before: samples, median and 99th percentile of their age [us].
    fn ask(&mut self) -> anyhow::Result<[f64; 3]> {
        use std::io::Write as _;
        writeln!(self.child.stdin.as_mut().context("no input")?)?;
        let line = self.line()?;
        let mut numbers = line.split_whitespace().map(str::parse::<f64>);
        let mut next = || numbers.next().context("no number")?.map_err(anyhow::Error::from);
        Ok([next()?, next()?, next()?])
    }

    /// Processor time since its start [s].
    fn cpu_s(&self) -> anyhow::Result<f64> {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id()))?;
        let fields = stat.rsplit_once(')').context("no fields")?.1;
        let ticks = fields.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok());
        Ok(ticks.sum::<f64>() / TICKS_PER_SECOND)
    }

    fn memory_kib(&self) -> anyhow::Result<f64> {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("no memory")?;
        Ok(line.split_whitespace().next().context("no number")?.parse()?)
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Bytes that have gone through the loopback.
fn loopback_bytes() -> anyhow::Result<f64> {
    Ok(fs::read_to_string("/sys/class/net/lo/statistics/rx_bytes")?.trim().parse()?)
}

/// Prints what a fleet of that size costs.
fn measure(count: usize) -> anyhow::Result<()> {
    let router = Part::start(&["router"])?;
    let mut dashboard = Part::start(&["dashboard"])?;
    let robots = Part::start(&["robots", &count.to_string()])?;
    // What the start has cost and delayed does not count.
    std::thread::sleep(Duration::from_secs(2));
    dashboard.ask()?;
    let parts = [&robots, &router];
    let cpu_s = |dashboard: &Part| -> anyhow::Result<[f64; 3]> {
        Ok([parts[0].cpu_s()?, parts[1].cpu_s()?, dashboard.cpu_s()?])
    };
    let (begun, before_s, before_bytes) = (Instant::now(), cpu_s(&dashboard)?, loopback_bytes()?);
    std::thread::sleep(MEASURED);
    let [received, median_us, high_us] = dashboard.ask()?;
    let elapsed_s = begun.elapsed().as_secs_f64();
    let (after_s, bytes) = (cpu_s(&dashboard)?, loopback_bytes()? - before_bytes);
    let rate = count as f64 * (1.0 + 1.0 / POSES_PER_STATUS as f64) / POSE.as_secs_f64();
    let percent = |index: usize| 100.0 * (after_s[index] - before_s[index]) / elapsed_s / count as f64;
    println!(
        "{count:>5} {rate:>7.0} {:>7.3} {:>7.2} {:>8.2} {:>8.0} {:>7.3} {:>7.3} {:>7.3}   router {:.0} MiB, dashboard {:.0} MiB",
        received / elapsed_s / rate,
        median_us * 1e-3,
        high_us * 1e-3,
        // Each byte goes through the loopback twice: to the router, and to the dashboard.
        bytes / elapsed_s / count as f64 / 2.0,
        percent(0),
        percent(1),
        percent(2),
        router.memory_kib()? / 1024.0,
        dashboard.memory_kib()? / 1024.0,
    );
    Ok(())
}
