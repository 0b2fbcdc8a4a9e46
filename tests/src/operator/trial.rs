//! One trial: a live drive, the actions of its plan, a last `stop`, and what was seen.

use std::fs::{File, OpenOptions};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use runtime::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use shared_types::Role;

use super::evidence::{DriveEvidence, OrchestratorOutage, TrialEvidence};
use super::place::{Ballast, SHARED_MEMORY};
use super::plan::{ActionTarget, OperatorAction, Rival, StderrTarget, TrialPlan, TrialSuccessor};
use super::program::Program;
use super::{socket, wheels};
use crate::{TestSystem, fill, pause};

/// A run drives within this time on a busy machine, if it starts [ns].
const START_NS: u64 = 20_000_000_000;
/// After a stop all processes and files are gone within this time [ns].
const GONE_NS: u64 = 45_000_000_000;
/// Processes that live after damage to the bus clean up within this time, if they can [ns].
const CRASHED_NS: u64 = 12_000_000_000;
/// A run that began while another was stopped is waited for this long before it is stopped too [ns].
const LATE_NS: u64 = 16_000_000_000;
/// Calls of `stop` at the end when a run may begin between them; one is enough otherwise.
const ROUNDS: usize = 3;
/// A process that a signal stops is stopped within this time [ns].
const STOPPED_NS: u64 = 200_000_000;
/// Time between two polls of the files of the run [ns].
const POLL_NS: u64 = 20_000_000;
/// Signals that end a process at once.
const SUDDEN: [Signal; 5] = [Signal::KILL, Signal::ABORT, Signal::SEGV, Signal::BUS, Signal::ILL];
/// Signals after which an orchestrator stops its run.
const STOPPING: [Signal; 6] =
    [Signal::TERM, Signal::INT, Signal::HUP, Signal::SEGV, Signal::BUS, Signal::ILL];
/// Signals after which an orchestrator is silent and its robot drives on.
const SILENCING: [Signal; 4] = [Signal::KILL, Signal::ABORT, Signal::STOP, Signal::TSTP];

/// Performs a plan; returns the system, with all files of the trial, and what was seen.
pub fn drive(executable: &str, plan: &TrialPlan) -> (TestSystem, TrialEvidence) {
    let mut trial = Trial::new(TestSystem::new(executable), plan);
    trial.start(plan);
    let began_ns = monotonic_ns();
    for (ms, action) in &plan.steps {
        trial.wait_until_ns(began_ns + ms * 1_000_000);
        trial.perform(action);
    }
    trial.wait_until_ns(began_ns + plan.stop_ms * 1_000_000);
    trial.end(plan);
    trial.evidence()
}

struct Trial {
    system: TestSystem,
    /// The choice of scenario, as arguments.
    choice: Vec<String>,
    programs: Vec<Program>,
    observer: Option<Program>,
    /// Ends of pipes that are not read.
    unread: Vec<OwnedFd>,
    ballasts: Vec<Ballast>,
    polled_ns: u64,
    /// Something was done to an orchestrator that may keep it from its work.
    touched: bool,
    seen: TrialEvidence,
}

impl Trial {
    fn new(system: TestSystem, plan: &TrialPlan) -> Self {
        let [rate, silence] =
            [format!("rate_hz={}", plan.rate_hz), format!("orphan_stop_s={:?}", plan.orphan_stop_s)];
        let seed = plan.seed.to_string();
        let choice = [plan.scenario, "--seed", &seed, "--set", &rate, "--set", &silence];
        Self {
            system,
            choice: choice.map(str::to_owned).to_vec(),
            programs: Vec::new(),
            observer: None,
            unread: Vec::new(),
            ballasts: Vec::new(),
            polled_ns: 0,
            touched: false,
            seen: TrialEvidence::default(),
        }
    }

    /// Starts the run and waits until it drives or has ended.
    fn start(&mut self, plan: &TrialPlan) {
        let mut command = self.run_command();
        if let Some(count) = plan.descriptors {
            command = limited(&command, count);
        }
        if plan.output == StderrTarget::Closed {
            command = wrapped(&command, &["sh", "-c", "exec \"$0\" \"$@\" 2>&-"]);
        }
        match plan.output {
            StderrTarget::File | StderrTarget::Closed => self.launch("run", command, None),
            StderrTarget::Stalled | StderrTarget::Gone => {
                let (reader, writer) = std::io::pipe().expect("a pipe");
                let writer = OwnedFd::from(writer);
                if plan.output == StderrTarget::Stalled {
                    fill(&writer);
                    self.unread.push(reader.into());
                }
                self.launch("run", command, Some(writer.into()));
            }
        }
        let deadline_ns = monotonic_ns() + START_NS;
        while self.programs[0].runs() && !self.seen.drove && monotonic_ns() < deadline_ns {
            self.seen.drove = self.drives();
            self.poll();
        }
        let truth = File::create(self.truth_file()).expect("a file for the truth");
        let mut observer = self.system.command(&["topic", "echo", "truth", "--short"]);
        observer.stdout(truth).stderr(Stdio::null());
        let began_ns = monotonic_ns();
        let child = observer.spawn().expect("the executable runs");
        self.observer = Some(Program::new("topic", child, Path::new(""), began_ns));
    }

    fn truth_file(&self) -> PathBuf {
        self.system.folder().join("truth.jsonl")
    }

    fn drives(&self) -> bool {
        self.system.status().is_some_and(|status| status.state == "driving" && status.scan > 3)
    }

    /// `run`, with a folder of its own for its results.
    fn run_command(&self) -> Command {
        let out = format!("out{}", self.programs.len());
        let mut arguments = vec!["run", "--out", &out, "--set", "recording.ring_s=0"];
        arguments.extend(self.choice.iter().map(String::as_str));
        self.system.command(&arguments)
    }

    /// Starts a program; its standard error goes to a file if it has no other.
    fn launch(&mut self, name: &str, mut command: Command, stderr: Option<Stdio>) {
        let number = self.programs.len();
        let path = self.system.folder().join(format!("{number:02}-{name}.txt"));
        let stderr = stderr.unwrap_or_else(|| {
            let file = File::options().append(true).create(true).open(&path);
            file.expect("a file for what is said").into()
        });
        // What it was asked for and what else it says go to one file.
        let stdout = File::options().append(true).create(true).open(&path).expect("a file for what is said");
        command.stdin(Stdio::null()).stdout(stdout).stderr(stderr);
        let began_ns = monotonic_ns();
        let mut program = Program::new(name, command.spawn().expect("the executable runs"), &path, began_ns);
        match name {
            "run" => program.out = Some(self.system.folder().join(format!("out{number}"))),
            // Where the run was to write its results.
            "adopt" => program.out = self.orchestrator().and_then(|index| self.programs[index].out.clone()),
            _ => {}
        }
        self.programs.push(program);
    }

    fn launch_command(&mut self, arguments: &[&str]) {
        let command = self.system.command(arguments);
        self.launch(arguments[0], command, None);
    }

    /// The orchestrator that was started last.
    fn orchestrator(&self) -> Option<usize> {
        self.programs.iter().rposition(|program| program.out.is_some())
    }

    /// Notes which programs have ended and which runs there are.
    fn poll(&mut self) {
        for program in &mut self.programs {
            program.runs();
        }
        if monotonic_ns() > self.polled_ns + POLL_NS {
            let _ = self.system.find();
            self.polled_ns = monotonic_ns();
        }
        pause();
    }

    fn wait_until_ns(&mut self, at_ns: u64) {
        while monotonic_ns() < at_ns {
            self.poll();
        }
    }

    fn perform(&mut self, action: &OperatorAction) {
        match *action {
            OperatorAction::Signal(target, _, signal) => self.signal(target, signal),
            OperatorAction::Pause(target, ms) => {
                self.signal(target, Signal::STOP);
                self.wait_until_ns(monotonic_ns() + ms * 1_000_000);
                self.signal(target, Signal::CONT);
            }
            OperatorAction::Restart(role) => self.launch_command(&["restart", role.name()]),
            OperatorAction::Swap(role, successor) => self.swap(role, successor),
            OperatorAction::Adopt(ms) => {
                self.signal(ActionTarget::Orchestrator, Signal::KILL);
                self.wait_until_ns(monotonic_ns() + ms * 1_000_000);
                self.launch_command(&["adopt"]);
                self.speaks_again();
            }
            OperatorAction::Run => self.run_again(),
            OperatorAction::Race(rival, first) => self.race(rival, first),
            OperatorAction::Socket(traffic) => match self.system.find() {
                Some(domain) => socket::send(domain.directory().join("control.sock"), traffic),
                None => self.seen.skipped.push("traffic: no system".to_owned()),
            },
            OperatorAction::Damage(number, cut) => self.damage(number, cut),
            OperatorAction::Load(fifo) => self.load(fifo),
            OperatorAction::Fill(shared, left) => match Ballast::leave(shared, left) {
                Ok(ballast) => self.ballasts.push(ballast),
                Err(reason) => self.seen.skipped.push(format!("{action}: {reason}")),
            },
            OperatorAction::Descriptors(target, count) => self.limit(target, count),
        }
    }

    fn pid_of(&mut self, target: ActionTarget) -> Option<i32> {
        match target {
            ActionTarget::Orchestrator => {
                let index = self.orchestrator()?;
                self.programs[index].runs().then(|| self.programs[index].pid())
            }
            ActionTarget::Of(role) => self.system.processes().into_iter().rev().find(|pid| {
                let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
                let wanted = format!("{}={role}", runtime::ROLE_VARIABLE);
                environment.split(|byte| *byte == 0).any(|text| text == wanted.as_bytes())
            }),
        }
    }

    fn signal(&mut self, target: ActionTarget, signal: Signal) {
        let Some(pid) = self.pid_of(target) else {
            return self.seen.skipped.push(format!("signal {}: no {target}", signal.as_raw()));
        };
        match target {
            ActionTarget::Orchestrator => self.signal_orchestrator(signal),
            ActionTarget::Of(role) => {
                self.seen.robot_killed |= role == Role::Robot && SUDDEN.contains(&signal);
                let _ = Pid::from_raw(pid).map(|pid| kill_process(pid, signal));
            }
        }
    }

    fn signal_orchestrator(&mut self, signal: Signal) {
        let Some(index) = self.orchestrator() else { return };
        let sent_ns = monotonic_ns();
        if !self.programs[index].signal(signal) {
            return;
        }
        let is_ignored = signal == Signal::HUP && ignores_hangup();
        if STOPPING.contains(&signal) && !self.touched && !is_ignored {
            self.seen.ends_ns.push(sent_ns);
        }
        let pid = self.programs[index].pid();
        if SILENCING.contains(&signal) && (signal != Signal::TSTP || self.is_stopped(pid)) {
            self.seen.silences.push(OrchestratorOutage { from_ns: sent_ns, to_ns: 0 });
        }
        self.touched |= signal != Signal::CONT;
        if signal == Signal::CONT {
            self.speaks_again();
        }
    }

    /// Whether a process was stopped: SIGTSTP has no effect on one without a terminal.
    fn is_stopped(&mut self, pid: i32) -> bool {
        let deadline_ns = monotonic_ns() + STOPPED_NS;
        let state = || std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        while !state().contains("(stopped)") {
            if monotonic_ns() > deadline_ns {
                return false;
            }
            self.poll();
        }
        true
    }

    /// An orchestrator may publish directives from now on.
    fn speaks_again(&mut self) {
        let now_ns = monotonic_ns();
        self.seen.silences.iter_mut().filter(|silence| silence.to_ns == 0).for_each(|silence| {
            silence.to_ns = now_ns;
        });
    }

    fn swap(&mut self, role: Role, successor: TrialSuccessor) {
        let built_in = match role {
            Role::Robot => "emulator",
            Role::Estimator => "ekf",
            Role::Obstacles => "ellipses",
            Role::Controller => "nmpc",
            Role::Actuator => "actuation",
        };
        let command: &[&str] = match successor {
            TrialSuccessor::BuiltIn => &["--to", built_in, "--shadow-scans", "3"],
            TrialSuccessor::Fails => &["--", "false"],
            TrialSuccessor::Sleeps => &["--", "sleep", "30"],
        };
        self.launch_command(&[&["swap", role.name()], command].concat());
    }

    fn run_again(&mut self) {
        let command = self.run_command();
        self.launch("run", command, None);
        self.speaks_again();
    }

    fn race(&mut self, rival: Rival, first: bool) {
        if rival == Rival::Adopt {
            self.signal(ActionTarget::Orchestrator, Signal::KILL);
        }
        if !first {
            self.launch_command(&["stop"]);
        }
        match rival {
            Rival::Adopt => self.launch_command(&["adopt"]),
            Rival::Swap(role) => self.swap(role, TrialSuccessor::BuiltIn),
            Rival::Run => self.run_again(),
            Rival::Stop => self.launch_command(&["stop"]),
        }
        if first {
            self.launch_command(&["stop"]);
        }
    }

    /// Writes into a file of the bus of this run, or cuts it.
    fn damage(&mut self, number: u64, cut: bool) {
        let Some(run_id) = self.system.find().map(|domain| domain.run_id().to_owned()) else {
            return self.seen.skipped.push("damage: no system".to_owned());
        };
        let mut files = files_of(&run_id);
        files.retain(|path| path.is_file());
        files.retain(|path| {
            let is = |extension: &str| path.extension().is_some_and(|found| found == extension);
            is("dynamic") || is("connection")
        });
        files.sort();
        let Some(path) = files.get(usize::try_from(number).unwrap_or(0) % files.len().max(1)) else {
            return self.seen.skipped.push("damage: no file".to_owned());
        };
        let Ok(file) = OpenOptions::new().write(true).open(path) else { return };
        let length = file.metadata().map_or(0, |data| data.len());
        if cut {
            let _ = file.set_len(0);
        } else {
            use std::os::unix::fs::FileExt;
            let garbage: Vec<u8> = (0..length.min(64 << 10))
                .map(|index| (number.rotate_left(index as u32 % 63) >> 5) as u8)
                .collect();
            let _ = file.write_all_at(&garbage, 0);
        }
        self.touched = true;
    }

    /// Busy processes that end by themselves, whatever becomes of this program.
    fn load(&mut self, fifo: bool) {
        let busy = "while :; do :; done";
        let processors = std::thread::available_parallelism().map_or(2, usize::from);
        let (count, line): (usize, &[&str]) = if fifo {
            // One processor is left to all others.
            (processors.saturating_sub(1).max(1), &["2", "chrt", "-f", "10", "sh", "-c", busy])
        } else {
            (2 * processors, &["5", "sh", "-c", busy])
        };
        for _ in 0..count {
            let mut command = Command::new("timeout");
            command.args(line).stdout(Stdio::null()).stderr(Stdio::null()).stdin(Stdio::null());
            match command.spawn() {
                Ok(child) => self.programs.push(Program::new("load", child, Path::new(""), monotonic_ns())),
                Err(error) => self.seen.skipped.push(format!("load: {error}")),
            }
        }
        self.seen.fifo |= fifo;
    }

    fn limit(&mut self, target: ActionTarget, count: u32) {
        let Some(pid) = self.pid_of(target) else {
            return self.seen.skipped.push(format!("limit: no {target}"));
        };
        let (pid, limit) = (pid.to_string(), format!("--nofile={count}:{count}"));
        let status = Command::new("prlimit").args(["--pid", &pid, &limit]).status();
        if !status.is_ok_and(|status| status.success()) {
            self.seen.skipped.push("limit: not permitted".to_owned());
        }
        self.touched |= target == ActionTarget::Orchestrator;
    }

    /// Stops the system and waits until it is gone.
    fn end(&mut self, plan: &TrialPlan) {
        let rounds = if plan.runs_again() { ROUNDS } else { 1 };
        for round in 1..=rounds {
            if !self.is_gone() {
                self.launch_command(&["stop"]);
            }
            let limit_ns = if round < rounds { LATE_NS } else { GONE_NS };
            let deadline_ns = monotonic_ns() + limit_ns;
            while !self.is_gone() && monotonic_ns() < deadline_ns {
                self.poll();
                self.wake();
                // A run that began while the one before was stopped.
                if round < rounds && self.stopped() && self.drives() {
                    break;
                }
            }
        }
        self.ballasts.clear();
        if let Some(mut observer) = self.observer.take() {
            observer.signal(Signal::INT);
            let deadline_ns = monotonic_ns() + 2_000_000_000;
            while observer.runs() && monotonic_ns() < deadline_ns {
                self.poll();
            }
        }
        self.programs.iter_mut().filter(|program| program.name == "load").for_each(|load| {
            load.signal(Signal::TERM);
        });
        // Processes that damage has ended leave their files to the next `stop` or `run`.
        if plan.damages() && !self.is_clean_within(CRASHED_NS) {
            self.launch_command(&["stop"]);
        }
        self.is_clean_within(GONE_NS);
        self.seen.left = self.left();
    }

    /// Continues orchestrators that were suspended while they ended, as `fg` does: no `stop` finds them any more.
    fn wake(&mut self) {
        if self.system.find().is_some() || !self.system.processes().is_empty() {
            return;
        }
        for program in self.programs.iter_mut().filter(|program| program.out.is_some()) {
            if matches!(program.signals.last(), Some(&(Signal::STOP | Signal::TSTP))) {
                program.signal(Signal::CONT);
            }
        }
    }

    /// Waits until nothing is left of the system; whether that is so in time.
    fn is_clean_within(&mut self, limit_ns: u64) -> bool {
        let deadline_ns = monotonic_ns() + limit_ns;
        while !self.left().is_empty() {
            if monotonic_ns() > deadline_ns {
                return false;
            }
            self.poll();
        }
        true
    }

    /// Whether no `stop` is under way.
    fn stopped(&mut self) -> bool {
        !self.programs.iter_mut().any(|program| program.name == "stop" && program.runs())
    }

    /// Whether no program of the trial runs, and no process of the system.
    fn is_gone(&mut self) -> bool {
        let runs = self.programs.iter_mut().any(|program| program.name != "load" && program.runs());
        !runs && self.system.processes().is_empty()
    }

    /// Describes what is left of the system.
    fn left(&mut self) -> Vec<String> {
        self.poll();
        let mut left: Vec<String> = Vec::new();
        for program in &mut self.programs {
            if program.runs() {
                left.push(format!("command {} {}", program.name, program.pid()));
            }
        }
        let mut pids = self.system.processes();
        pids.extend(named(self.system.id()));
        pids.retain(|pid| self.programs.iter().all(|program| program.pid() != *pid));
        left.extend(pids.iter().map(|pid| format!("process {pid}: {}", line_of(*pid))));
        left.extend(self.system.find().map(|domain| format!("directory {}", domain.directory().display())));
        let runs = self.system.runs.borrow();
        let files = runs.iter().filter(|run_id| !run_id.is_empty()).flat_map(|run_id| files_of(run_id));
        left.extend(files.map(|path| format!("file {}", path.display())));
        left
    }

    fn evidence(self) -> (TestSystem, TrialEvidence) {
        let Self { system, programs, mut seen, .. } = self;
        let truth = system.folder().join("truth.jsonl");
        seen.truth = wheels::points(&truth);
        let programs = programs.into_iter().filter(|program| program.name != "load");
        seen.programs = programs.map(Program::finish).collect();
        let mut folders: Vec<PathBuf> = seen.orchestrators().filter_map(|ended| ended.out.clone()).collect();
        folders.dedup();
        seen.drives = folders.iter().map(|folder| DriveEvidence::read(folder)).collect();
        seen.panics = panics(&folders, &seen);
        seen.over_ns = monotonic_ns();
        (system, seen)
    }
}

/// Whether this program, and all that it starts, ignores SIGHUP, as under `nohup`.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}

/// Lines of a panic, in what was printed and in all logs.
fn panics(folders: &[PathBuf], seen: &TrialEvidence) -> Vec<String> {
    let logs = folders.iter().filter_map(|folder| std::fs::read_dir(folder.join("logs")).ok());
    let logs = logs.flatten().flatten().map(|entry| std::fs::read(entry.path()).unwrap_or_default());
    let texts = logs.map(|text| String::from_utf8_lossy(&text).into_owned());
    let texts = texts.chain(seen.programs.iter().map(|program| program.printed.clone()));
    let lines = texts.flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>());
    lines.filter(|line| line.contains("panicked at")).collect()
}

/// Files of a run in shared memory.
fn files_of(run_id: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    let is_of_run = |path: &PathBuf| path.to_string_lossy().contains(run_id);
    entries.map(|entry| entry.path()).filter(is_of_run).collect()
}

fn line_of(pid: i32) -> String {
    let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    String::from_utf8_lossy(&line).replace('\0', " ")
}

/// Processes that name a system in their command line.
fn named(system_id: &str) -> Vec<i32> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|pid| line_of(*pid).split(' ').any(|argument| argument == system_id)).collect()
}

/// The command with a limit of open files.
fn limited(command: &Command, count: u32) -> Command {
    wrapped(command, &["prlimit", &format!("--nofile={count}:{count}")])
}

/// The command as the last arguments of another one.
fn wrapped(command: &Command, by: &[&str]) -> Command {
    let mut outer = Command::new(by[0]);
    outer.args(&by[1..]).arg(command.get_program()).args(command.get_args());
    command.get_current_dir().map(|folder| outer.current_dir(folder));
    outer
}
