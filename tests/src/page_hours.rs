//! Hours of driving in real time with the live page open in a browser: the memory of server and page stays flat.

use std::fmt;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use supervision::child::usage_of;

use crate::TestSystem;
use crate::long_drive::{MAX_DRIVE_S, growth_of};

/// Growth of memory that is allowed from the second to the last quarter.
const GROWTH_MAX: f64 = 1.05;
/// The drive ends after the page was closed [s].
const SPARE_S: f64 = 60.0;

/// What the page used at one time, as the script in the browser prints it.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct PageUse {
    heap_kib: f64,
    renderer_kib: f64,
    nodes: f64,
    scan: u64,
    paint_ms: f64,
}

/// What was used: medians of the second and of the last quarter of the time.
#[derive(Debug, Clone)]
pub struct PageHours {
    /// Time with the page open [s].
    pub duration_s: f64,
    /// Scans that the page showed.
    pub scans: u64,
    /// Memory of the server [KiB].
    pub server_kib: [f64; 2],
    /// Objects of the page after a collection of garbage [KiB].
    pub heap_kib: [f64; 2],
    /// Memory of the processes that draw the page [KiB].
    pub renderer_kib: [f64; 2],
    /// Elements of the page.
    pub nodes: [f64; 2],
    /// Share of one core that the server took.
    pub server_share: f64,
    /// Largest of the times in which the page drew 95 % of its frames [ms].
    pub paint_ms: f64,
    /// What must not happen.
    pub problems: Vec<String>,
}

impl fmt::Display for PageHours {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { duration_s, scans, server_kib, heap_kib, renderer_kib, nodes, .. } = self;
        write!(
            out,
            "{duration_s:.0} s, {scans} scans; second and last quarter: server {server_kib:.0?} KiB, objects of the page \
             {heap_kib:.0?} KiB, its processes {renderer_kib:.0?} KiB, elements {nodes:.0?}; server {:.2} % of a core; 95 % \
             of the frames within {:.1} ms; {} problems",
            100.0 * self.server_share,
            self.paint_ms,
            self.problems.len()
        )
    }
}

/// Ends a process when it is dropped.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = kill_process(Pid::from_child(&self.0), Signal::TERM);
        let _ = self.0.wait();
    }
}

/// Drives with the page open.
///
/// # Panics
/// When there is no browser, or the system can't be started.
pub fn watch(executable: &str, duration_s: f64) -> PageHours {
    let mut system = TestSystem::new(executable);
    let drive_s = (duration_s + SPARE_S).min(MAX_DRIVE_S);
    system.start(&["endless", "--duration", &format!("{drive_s:.0}")]);
    let mut view = system.command(&["view", "--port", "0"]);
    let mut view = Ended(view.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("a page"));
    let mut link = String::new();
    BufReader::new(view.0.stdout.take().expect("piped")).read_line(&mut link).expect("a link");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("browser/hour.py");
    let mut browser = Command::new("python3");
    browser.arg(script).arg(link.trim()).arg(duration_s.to_string()).stdout(Stdio::piped());
    let mut browser = Ended(browser.spawn().expect("python3"));
    let (mut uses, mut first_cpu_s) = (Vec::new(), None);
    let (mut scans, mut paint_ms, mut cpu_s) = ([0, 0], 0.0_f64, 0.0);
    let mut problems = Vec::new();
    for line in BufReader::new(browser.0.stdout.take().expect("piped")).lines() {
        let line = line.expect("a line");
        let page: PageUse = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{line}: {error}"));
        let Some(server) = usage_of(view.0.id()) else {
            problems.push("the server has ended".to_owned());
            break;
        };
        eprintln!("server {} KiB, {line}", server.memory_kib);
        if uses.is_empty() {
            (first_cpu_s, scans[0]) = (Some(server.cpu_s), page.scan);
        } else if page.scan <= scans[1] {
            problems.push(format!("the page still shows scan {}", page.scan));
        }
        (scans[1], paint_ms, cpu_s) = (page.scan, paint_ms.max(page.paint_ms), server.cpu_s);
        uses.push([server.memory_kib as f64, page.heap_kib, page.renderer_kib, page.nodes]);
    }
    if !browser.0.wait().is_ok_and(|status| status.success()) {
        problems.push("the browser has ended with an error".to_owned());
    }
    drop(view);
    system.signal(system.orchestrator(), Signal::INT);
    system.wait();
    if system.report().scans.unaccounted != 0 {
        problems.push("scans are unaccounted".to_owned());
    }
    system.assert_nothing_left();
    let of = |index: usize| growth_of(&uses, index).unwrap_or([f64::NAN; 2]);
    let [server_kib, heap_kib, renderer_kib, nodes] = std::array::from_fn(of);
    for (what, [early, late]) in [
        ("the server", server_kib),
        ("the objects of the page", heap_kib),
        ("the elements of the page", nodes),
    ] {
        if late > GROWTH_MAX * early {
            problems.push(format!("{what} grew from {early} to {late}"));
        }
    }
    let driven_s = (scans[1] - scans[0]) as f64 * 0.1;
    let server_share = (cpu_s - first_cpu_s.unwrap_or(cpu_s)) / driven_s.max(1.0);
    PageHours {
        duration_s,
        scans: scans[1] - scans[0],
        server_kib,
        heap_kib,
        renderer_kib,
        nodes,
        server_share,
        paint_ms,
        problems,
    }
}
