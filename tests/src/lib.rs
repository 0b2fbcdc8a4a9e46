//! What process tests share: a system of their own, conditions with a deadline, and a check that nothing is left.

pub mod audit;
mod delays;
pub mod long_drive;
pub mod machine;
pub mod namespace;
pub mod operator;
pub mod page_hours;
pub mod pages;
pub mod player_server;
pub mod recordings;
pub mod relay;
pub mod soak;
pub mod stranger;
pub mod swaps;
pub mod terminal;
mod turns;
mod watch;
mod watched;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use report::Report;
use runtime::Domain;
use rustix::fs::{Mode, OFlags, open};
use session::control::{Reply, Request, SystemStatus, ask};
use shared_types::Role;
use turns::Turn;

pub use delays::{DELAYS_NS, DelayPlace, PLACES, STAGES, plan, planted};
/// The Cargo profile of the tests and of the executables under test.
pub use figures::PROFILE;
pub use watch::TruthWatch;

/// How long a condition may take before a test fails: far beyond what a loaded machine needs.
pub const DEADLINE: Duration = Duration::from_secs(60);

/// Time between two checks of a condition of a system: each asks several processes, and many tests wait at the same time.
const CHECK_INTERVAL: Duration = Duration::from_millis(40);

/// The corridor with its box and its goal nearer, for tests that wait for the goal: 91 scans instead of 129.
///
/// The box stands to the left, so that the robot is back near the line at the goal.
pub const SHORT_CORRIDOR: [&str; 7] =
    ["corridor", "--set", "obstacle.0.x_m=4", "--set", "obstacle.0.y_m=0.5", "--set", "goal.x_m=7"];

/// The long course up to its second obstacle: 170 scans instead of 242.
pub const SHORTENED_LONG: [&str; 3] = ["long", "--set", "goal.x_m=14"];

/// A track without obstacles and a near goal: 67 scans instead of 127.
pub const SHORT_FREE: [&str; 3] = ["free", "--set", "goal.x_m=4"];

static NEXT: AtomicU32 = AtomicU32::new(0);

/// A system under test with an id and a folder of its own; dropping it ends what is left of it.
#[derive(Debug)]
pub struct TestSystem {
    id: String,
    /// Run ids that were seen.
    runs: RefCell<BTreeSet<String>>,
    folder: PathBuf,
    executable: PathBuf,
    running: Option<Child>,
    // Dropped last.
    _turn: Turn,
}

impl TestSystem {
    /// A system that has not been started; `executable` is `env!("CARGO_BIN_EXE_scanloop-under-test")`.
    pub fn new(executable: &str) -> Self {
        let turn = Turn::begin();
        let id = format!("t{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let folder = std::env::temp_dir().join(format!("scanloop-test-{id}"));
        std::fs::create_dir_all(&folder).expect("a folder for the test");
        Self {
            id,
            runs: RefCell::default(),
            folder,
            executable: executable.into(),
            running: None,
            _turn: turn,
        }
    }

    /// The executable in a folder of its own, under this name.
    pub fn executable_alone(&self, name: &str) -> PathBuf {
        let folder = self.folder.join("alone");
        std::fs::create_dir_all(&folder).expect("a folder for the executable");
        let path = folder.join(name);
        // Another file system has no second name of a file.
        std::fs::hard_link(&self.executable, &path)
            .or_else(|_| std::fs::copy(&self.executable, &path).map(|_| ()))
            .expect("a copy of the executable");
        path
    }

    /// A command of the executable for this system.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.executable);
        command.arg("--system-id").arg(&self.id).args(arguments).current_dir(&self.folder);
        command.stdin(Stdio::null());
        command
    }

    /// Runs a command to its end.
    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the executable runs")
    }

    /// Drives in lock-step and returns the report; panics with the output when there is none.
    pub fn lockstep(&self, arguments: &[&str]) -> Report {
        let out = self.folder.join("out");
        let mut all = vec!["run", "--lockstep", "--quiet", "--out", out.to_str().expect("a readable path")];
        all.extend(arguments);
        let output = self.run(&all);
        let report = Report::read(&out.join("report.json"))
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
        self.runs.borrow_mut().insert(report.run_id.clone());
        report
    }

    /// Starts a run in real time and waits until it drives.
    pub fn start(&mut self, arguments: &[&str]) {
        self.launch(&[&["run", "--quiet", "--out", "out"], arguments].concat(), &[]);
        self.wait_until_driving();
    }

    /// Takes over a run whose orchestrator was killed and waits until it drives.
    pub fn adopt(&mut self, arguments: &[&str]) {
        self.launch(&[&["adopt", "--quiet"], arguments].concat(), &[]);
        self.wait_until_driving();
        // Until it has received the state of all processes.
        let scan = self.status().map_or(0, |status| status.scan);
        self.wait_until("it watches", |system| system.status().is_some_and(|status| status.scan > scan + 2));
    }

    /// Starts an orchestrator with these variables and waits for nothing.
    pub fn launch(&mut self, arguments: &[&str], environment: &[(&str, &str)]) {
        let log = std::fs::OpenOptions::new().create(true).append(true).open(self.folder.join("stderr.txt"));
        self.launch_into(&log.expect("a log file").into(), arguments, environment);
    }

    /// [`TestSystem::launch`] with an output of one's own. Without a key for it, no last seconds are kept.
    pub fn launch_into(&mut self, output: &OwnedFd, arguments: &[&str], environment: &[(&str, &str)]) {
        let mut command = self.command(arguments);
        if arguments.first() == Some(&"run") && !arguments.iter().any(|key| key.contains("recording.ring_s"))
        {
            command.args(["--set", "recording.ring_s=0"]);
        }
        let copy = || output.try_clone().expect("a descriptor");
        command.envs(environment.iter().copied()).stdout(copy()).stderr(copy());
        self.running = Some(command.spawn().expect("the executable runs"));
    }

    /// Waits until the robot drives.
    pub fn wait_until_driving(&self) {
        self.wait_until("the system drives", |system| {
            system.status().is_some_and(|status| status.state == "driving" && status.scan > 3)
        });
    }

    /// Kills the orchestrator (SIGKILL) and waits until it is gone.
    pub fn kill_orchestrator(&mut self) {
        self.signal(self.orchestrator(), rustix::process::Signal::KILL);
        self.wait();
    }

    /// The state of the running system, if it answers.
    pub fn status(&self) -> Option<SystemStatus> {
        match ask(&self.find()?, &Request::Status) {
            Ok(Reply::Status(status)) => Some(*status),
            _ => None,
        }
    }

    /// Process id of a role.
    pub fn pid(&self, role: Role) -> i32 {
        let status = self.status().expect("a running system");
        status.processes.iter().find(|process| process.role == role).expect("the role").pid
    }

    /// Process id of the orchestrator.
    pub fn orchestrator(&self) -> i32 {
        self.running.as_ref().expect("a running system").id().cast_signed()
    }

    /// Sends a signal to a process that this system started.
    pub fn signal(&self, pid: i32, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(pid).expect("a process id");
        rustix::process::kill_process(pid, signal).expect("the process exists");
    }

    /// Waits for the end of the run.
    pub fn wait(&mut self) -> ExitStatus {
        self.wait_at_most(DEADLINE).unwrap_or_else(|| panic!("the run does not end: {}", self.stderr()))
    }

    /// Waits for the end of the run; `None` when it takes longer than that.
    pub fn wait_at_most(&mut self, limit: Duration) -> Option<ExitStatus> {
        let started = Instant::now();
        while started.elapsed() < limit {
            let child = self.running.as_mut().expect("a running system");
            if let Some(status) = child.try_wait().expect("a child of ours") {
                self.running = None;
                return Some(status);
            }
            std::thread::park_timeout(CHECK_INTERVAL);
        }
        None
    }

    /// The report of the run that has ended.
    pub fn report(&self) -> Report {
        let report = Report::read(&self.folder.join("out/report.json"))
            .unwrap_or_else(|error| panic!("{error}: {}", self.stderr()));
        self.runs.borrow_mut().insert(report.run_id.clone());
        report
    }

    /// What the run wrote to standard error, and its summary.
    pub fn stderr(&self) -> String {
        std::fs::read_to_string(self.folder.join("stderr.txt")).unwrap_or_default()
    }

    /// Folder of the test.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Id of the system.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The domain of the system, which must have a directory.
    pub fn domain(&self) -> Domain {
        self.find().unwrap_or_else(|| panic!("system {} has no directory: {}", self.id, self.stderr()))
    }

    /// The domain of the system, if it has a directory.
    pub fn find(&self) -> Option<Domain> {
        let domain = Domain::find(&self.id).ok().flatten()?;
        self.runs.borrow_mut().insert(domain.run_id().to_owned());
        Some(domain)
    }

    /// Process ids that were started for the system and live.
    pub fn processes(&self) -> Vec<i32> {
        processes_of(&self.id)
    }

    /// Waits until a condition holds, with a deadline.
    pub fn wait_until(&self, what: &str, condition: impl Fn(&Self) -> bool) {
        let started = Instant::now();
        while !condition(self) {
            assert!(started.elapsed() < DEADLINE, "{what}: not within {DEADLINE:?}: {}", self.stderr());
            std::thread::park_timeout(CHECK_INTERVAL);
        }
    }

    /// Panics when the system has left files in shared memory, its directory, or processes.
    ///
    /// What `stop` leaves to a process in the background is waited for.
    pub fn assert_nothing_left(&self) {
        let started = Instant::now();
        while self.left().is_some() && started.elapsed() < DEADLINE {
            std::thread::park_timeout(CHECK_INTERVAL);
        }
        assert_eq!(self.left(), None, "{}", self.stderr());
    }

    /// Describes what there is of the system: its directory, processes, and files in shared memory.
    fn left(&self) -> Option<String> {
        if let Some(domain) = self.find() {
            return Some(format!("directory {}", domain.directory().display()));
        }
        let processes = self.processes();
        if !processes.is_empty() {
            return Some(format!("processes {processes:?}"));
        }
        let runs = self.runs.borrow();
        let names = std::fs::read_dir("/dev/shm").expect("shared memory").flatten();
        let mut names = names.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let is_ours = |name: &String| runs.iter().any(|run| !run.is_empty() && name.contains(run));
        names.find(is_ours).map(|name| format!("shared memory {name}"))
    }
}

impl Drop for TestSystem {
    fn drop(&mut self) {
        if let Some(mut child) = self.running.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
        for pid in self.processes() {
            if let Some(pid) = rustix::process::Pid::from_raw(pid) {
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL);
            }
        }
        if let Some(domain) = self.find() {
            let _ = domain.remove();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// What a command wrote, to standard output first.
pub fn printed(output: &Output) -> String {
    (String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr)).into_owned()
}

/// Processes that were started for a system, by their environment.
pub fn processes_of(system_id: &str) -> Vec<i32> {
    let wanted = format!("{}={system_id}", runtime::SYSTEM_ID_VARIABLE);
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    entries
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok())
        .filter(|pid| {
            std::fs::read(format!("/proc/{pid}/environ"))
                .is_ok_and(|bytes| bytes.split(|byte| *byte == 0).any(|text| text == wanted.as_bytes()))
        })
        .collect()
}

/// Writes into a pipe or terminal until not a byte more goes in.
///
/// # Panics
/// When it can't be opened.
pub fn fill(output: &OwnedFd) {
    // Another description of the same file, so that writes to `output` itself block as usual.
    let path = format!("/proc/self/fd/{}", output.as_raw_fd());
    let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let output = open(&path, flags, Mode::empty()).expect("a pipe or a terminal");
    for size in [1024, 1] {
        while rustix::io::write(&output, &[b'x'; 1024][..size]).is_ok() {}
    }
}

/// A system file in which a program of the tests fills some roles, with these arguments after the role.
pub fn system_file(rate_hz: u32, faulty: &[Role], program: &str, arguments: &[&str]) -> String {
    let mut text = format!("rate_hz = {rate_hz}.0\n");
    for (role, implementation) in [
        (Role::Robot, "emulator"),
        (Role::Estimator, "ekf"),
        (Role::Obstacles, "ellipses"),
        (Role::Controller, "nmpc"),
        (Role::Actuator, "actuation"),
    ] {
        text += &format!("[[process]]\nrole = \"{role}\"\nrestart = \"never\"\n");
        text += &if faulty.contains(&role) {
            let command = [&[program, role.name()], arguments].concat();
            format!("command = {command:?}\n")
        } else {
            format!("implementation = \"{implementation}\"\n")
        };
    }
    text
}

/// Whether this process, and so each process that it starts, ignores a signal.
pub fn is_ignored(signal: rustix::process::Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & (1 << (signal.as_raw() - 1)) != 0
}

/// Yields the processor between two checks of a condition.
pub fn pause() {
    std::thread::park_timeout(Duration::from_millis(2));
}
