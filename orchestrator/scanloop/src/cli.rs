//! The command line.

use std::path::PathBuf;

use clap::builder::{StyledStr, Styles};
use clap::{Args, Parser, Subcommand};
use conformance::ConformanceArguments;
use plan::Choice;
use session::arguments::{CommonArguments, RunArguments};

use crate::bench::BenchCommand;
use crate::calibrate::CalibrateArguments;
use crate::completions::{CompleteArguments, Shell};
use crate::demo::DemoArguments;
use crate::doctor::DoctorArguments;
use crate::inject::InjectArguments;
use crate::laboratory::StudyArguments;
use crate::live_check::LiveArguments;
use crate::man::ManArguments;
use crate::map::MapArguments;
use crate::new::NewArguments;
use crate::record::{RecordArguments, RecordingCommand};
use crate::reference::ReferenceArguments;
use crate::replay::ReplayArguments;
use crate::shadow::ShadowArguments;
use crate::swap::{SetArguments, SwapArguments};
use crate::teleop::TeleopArguments;
use crate::top::TopArguments;
use crate::types::TypesArguments;
use crate::urg::UrgCommand;
use crate::why::WhyArguments;
use view::{ReportArguments, ViewArguments};

/// The system of commands that name none.
pub(crate) const DEFAULT_SYSTEM_ID: &str = "default";

/// Exit codes, below the help of the program and on the page of the commands.
const EXIT_CODES: &str = include_str!("exit-codes.txt");

/// The help of the program: its commands by what one wants to do.
const HELP: &str = include_str!("help.txt");

/// The help of the program, its heads as those in the help of a command.
fn help() -> StyledStr {
    let look = *Styles::default().get_header();
    let lines = HELP.split_inclusive('\n').map(|line| {
        let head = line.split(' ').next().unwrap_or_default();
        let rest = &line[head.len()..];
        let is_head = !head.is_empty() && (head.ends_with(':') || rest.starts_with("  "));
        if is_head { format!("{look}{head}{look:#}{rest}") } else { line.to_owned() }
    });
    lines.collect::<String>().into()
}

/// Autonomous driving that closes the loop within one laser scan.
#[derive(Debug, Parser)]
#[command(name = "scanloop", version, max_term_width = 100, override_help = help(), after_help = EXIT_CODES)]
pub struct Cli {
    /// Name of the system on this machine: 1 to 16 letters, digits or `-`.
    #[arg(long, global = true, value_name = "NAME", env = runtime::SYSTEM_ID_VARIABLE, default_value = DEFAULT_SYSTEM_ID)]
    pub system_id: String,
    /// What to do.
    #[command(subcommand)]
    pub command: CliCommand,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum CliCommand {
    /// Start all processes, drive a scenario, stop everything and print a summary.
    ///
    /// If processes of an earlier run of this system are orphaned and still drive, `run` blocks their wheels and ends
    /// them first. With `--adopt` it takes them over instead.
    Run(RunArguments),
    /// Drive, kill, swap, delay, blind and repeat in about a minute, then compare what is promised with what was
    /// measured.
    ///
    /// Starts a long course with the live page, in a system of its own, and tells what happens. It kills estimator,
    /// obstacles, controller, actuator and orchestrator in turn, swaps controller and robot, plants 5 ms in one stage
    /// and finds it, blinds the scanner, and drives one scenario twice in lock-step. Every figure is measured in this
    /// run. Exit code 0 if all promises held, else 1.
    Demo(DemoArguments),
    /// Take over orphaned processes while they drive: those of a run whose orchestrator died. Same as `run --adopt`.
    ///
    /// A process is identified by process id, start time, system and incarnation; no other process is touched. Exit
    /// code 2 if there is nothing to adopt.
    Adopt(CommonArguments),
    /// Validate scenario and system files and print the graph of processes and topics; with `--live`, check a robot.
    ///
    /// `--live` checks what robot and scanner really do: rate, jitter, stamps and returns of the scans, state of the
    /// scanner, odometry, its direction when the robot is moved, and the stop. A system that runs is only observed.
    /// Exit code 1 if a check failed, 4 if a process could not be started or ended.
    Check(CheckArguments),
    /// Show the processes of a running system: pid, state, restarts, rate, age of the newest sample, last log lines.
    ///
    /// If the wheels are blocked for an obstacle, it is named with its place, the gap past it and the gap that the
    /// robot needs. A scanner that is not healthy is shown with its state and the figures that explain it. A driver
    /// shows what its devices do, since when, and why.
    Status {
        /// Print JSON to standard output.
        #[arg(long)]
        json: bool,
    },
    /// Show a running system on one screen of a terminal, with keys for stop, restart and swap.
    ///
    /// Processes, motion, a map with scan, obstacles and plan, the time from scan to actuation, and the last events. `?`
    /// lists the keys. 72 columns and 20 rows are enough, also over ssh. The terminal is restored after any end.
    Top(TopArguments),
    /// Serve a live page of a running system to browsers: map, processes, latency, events and the last five minutes.
    /// With a file it plays a recording.
    ///
    /// The link is printed to standard output. The page may be opened before the run, and continues with the next one. Data
    /// is given to this user's browsers on this machine, and to those that have the token of the link; control needs the
    /// token in any case. Exit code 2 if the port is in use, or the file is damaged or no recording. The paths `/system`,
    /// `/history` and `/frame?number=N` give the data of the page as JSON, `/stream` as server-sent events; a recording has
    /// `/frame?at_ms=T`.
    View(ViewArguments),
    /// Block the wheels of a running system and end all its processes.
    ///
    /// The command returns within a second, also when the orchestrator hangs or is gone. Exit code 0: the block is
    /// acknowledged. Exit code 4: it is not confirmed, and the processes that still live are listed. After the block
    /// the robot needs its velocity divided by its deceleration to come to rest; the processes end meanwhile. A daemon
    /// that a process of the system has started is ended too, and waited for; exit code 4 if it lives after that. One that was started without its environment, as by
    /// `env -i`, is known to no command: it is neither named nor ended. A stop
    /// can't be taken back: `run` starts the system again. This does not replace a hardware emergency stop.
    Stop(StopArguments),
    /// Block the wheels of a running system until `resume`; all processes stay ready.
    ///
    /// Time limits of the run do not count meanwhile. The end of an orchestrator does not hand back to the controller: one
    /// that adopts the run keeps it paused. In lock-step time stands once the robot does.
    Pause,
    /// Let the controller drive again, after `pause` or `teleop`.
    Resume,
    /// Drive a running system by hand: with the keys of this terminal, or with `--for` for a time.
    ///
    /// What a person asks for has the limits, the verification and the stop of the controller's commands: the robot drives
    /// slower before an obstacle, and stands where no speed is verified. Keys drive only while they are held. Without a
    /// new control for 1.5 scan periods, or 25 ms, the wheels are blocked. Afterwards the drive is paused: only `resume`
    /// hands back to the controller. In lock-step each control is for one scan. Exit code 2 if another person drives.
    Teleop(TeleopArguments),
    /// Restart one process of a running system without losing a scan.
    ///
    /// If the process works, the new one takes over first and then the old one ends. Exit code 1 if the new one does not
    /// start; the old one then keeps driving. A process that does not work is ended before the new one starts.
    Restart {
        /// Role of the process: robot, estimator, obstacles, controller or actuator; or the name of a companion.
        role: String,
    },
    /// Replace one process of a running system by another one without losing a scan.
    ///
    /// The new process, the candidate, runs in shadow until its outputs have agreed with those of the old one for some
    /// scans. It takes over at the handover scan, which both know beforehand. The old process stays ready as standby,
    /// and takes over again if the new one fails. Exit code 1 if the swap was refused or rolled back.
    #[command(override_usage = "scanloop swap [OPTIONS] <ROLE> <--to IMPLEMENTATION | -- COMMAND...>")]
    Swap(SwapArguments),
    /// Change settings of one role of a running system.
    ///
    /// The process of the role is swapped for the same program with the new settings, without losing a scan. Processes
    /// that are started for the role later have them too. Exit codes and output are those of `swap`; exit code 2 also
    /// for keys that do not belong to one role, and for values that are not allowed.
    Set(SetArguments),
    /// Cause a fault in a running system with the emulated robot, which was started by `run --allow-inject`.
    ///
    /// A fault of samples or of the robot is carried out by the process whose samples change; it must be a built-in
    /// implementation. A process has one such fault at a time: a second one replaces the first. The event stands in
    /// `status`, in the recording and on the page. Exit code 2 for a fault that can't be injected while the robot drives,
    /// with those that can.
    Inject(InjectArguments),
    /// Test whether a program, in any language, can fill a role.
    ///
    /// The program is started alone; a test bench plays all other roles with a recorded drive and tries each
    /// requirement. Exit code 1 if a required case failed, 4 if the program could not be started.
    Conformance(ConformanceArguments),
    /// Run a process in shadow of the live one, which keeps driving, and compare both.
    ///
    /// Both receive the same samples. The report contains the fraction of answered scans, differences with confidence
    /// intervals, and times of both with intervals of their ratio. Ctrl-C ends the comparison early, with the report so
    /// far. Exit code 1 if the process ended by itself or stopped publishing.
    #[command(override_usage = "scanloop shadow [OPTIONS] <ROLE> <--to IMPLEMENTATION | -- COMMAND...>")]
    Shadow(ShadowArguments),
    /// Run one built-in implementation; `scanloop run` starts these.
    Service {
        /// Name of the implementation: emulator, player, ros2, ekf, ellipses, nmpc or actuation.
        name: String,
    },
    /// Run processes of this host for the orchestrator of another one.
    ///
    /// The file names this host, the address at which the agent listens, and the implementations that may be started here;
    /// only its owner may read it. Processes run in system `ID-HOST`. They are supervised by the orchestrator that wanted
    /// them, and end when it no longer does, or when the agent ends. Exit code 2 for a bad file, 4 for an address that can't
    /// be used (docs/hosts.md).
    #[command(args_conflicts_with_subcommands = true)]
    Agent {
        /// Make certificates instead.
        #[command(subcommand)]
        command: Option<AgentCommand>,
        /// The agent file.
        #[arg(value_name = "FILE", default_value = "agent.toml")]
        file: PathBuf,
        /// Folder for the logs of the processes.
        #[arg(long, value_name = "DIR", default_value = "out/agent", value_parser = console::output::folder())]
        out: PathBuf,
    },
    /// Stand for a process on another host; `scanloop run` starts these.
    Remote {
        /// Name of the host.
        host: String,
        /// Name of the implementation there.
        implementation: String,
    },
    /// Drive random courses through the in-process pipeline on all cores and judge how they end.
    #[command(disable_help_flag = true)]
    Campaign(StudyArguments),
    /// Inject each fault in each phase of a drive, and judge what the loop makes of it.
    #[command(disable_help_flag = true)]
    Faults(StudyArguments),
    /// Drive a recorded drive on from one of its scans, with something changed.
    #[command(disable_help_flag = true)]
    Fork(StudyArguments),
    /// Measure by driving what latency, scan rate and pose uncertainty cost in centimetres.
    #[command(disable_help_flag = true)]
    Price(StudyArguments),
    /// Compare two recorded drives, or two folders of them, along their way: where they part, and how they differ.
    #[command(disable_help_flag = true)]
    Compare(StudyArguments),
    /// Measure parts of the loop.
    #[command(subcommand)]
    Bench(BenchCommand),
    /// Show how the time from scan to actuation is spent, live from the samples of a running system.
    Latency {
        /// Stop after this many seconds.
        #[arg(long, value_name = "S", default_value_t = 5.0)]
        duration: f64,
        /// Print the figures of the whole time as JSON to standard output: `latency_us` as in `report.json`.
        #[arg(long)]
        json: bool,
    },
    /// Answer a design question: observability, correlation of the controls, number of intervals, odometry drift.
    #[command(disable_help_flag = true)]
    Analyse(StudyArguments),
    /// Calibrate a robot from recorded or driven runs; `run --calibration` uses the result.
    ///
    /// The result is merged into a calibration file with standard errors and 95 % intervals. A picture shows the
    /// residuals of the fit. Runs that are too few, out of range or implausible are refused with the reason.
    Calibrate(CalibrateArguments),
    /// Record every sample of a running system into a file that Foxglove, Lichtblick and ROS 2 read too.
    ///
    /// The recorder only observes: killed, stopped or on a full disk it does not delay a scan. A file that is cut off
    /// is readable up to its last whole second.
    Record(RecordArguments),
    /// Recompute a recorded drive stage by stage and compare every output with the recorded one.
    ///
    /// Exit code 0 if all compared outputs are identical, or with `--set` and `--with` within the bounds; else 1, and 2
    /// when nothing could be compared.
    Replay(ReplayArguments),
    /// Tell why the robot did what it did in one scan of a recorded drive, or of the running system.
    ///
    /// What the wheels did, the samples that it rests on with their times, the rung of the ladder, the margin by its parts,
    /// the limits that shaped the plan with their multipliers, the sides, the reason of a stop with its numbers, processes
    /// that were new or late, and what would have changed the decision. Each is computed from the recording, the limits and
    /// the other decisions by the controller itself. A running system is asked by what is recorded of it, or by the last seconds
    /// that it keeps in memory, written to `asked.mcap` in the folder of its results. Exit code 2 for a scan that is not there.
    Why(WhyArguments),
    /// Show, repair, cut, export or import a recording.
    #[command(subcommand)]
    Recording(RecordingCommand),
    /// Write a recorded drive as one page that opens in a browser without a server or network, to be sent or kept.
    ///
    /// It is the page of `view` with the recording in it, of at most 3 MB: speed, steering, clearance, margin and latency of
    /// each scan, all events, and map, plan and processes of each scan, in a long drive of as many as fit. Ranges of scans are
    /// rounded to 1 cm, places to 1 mm. `#t=12.5` after the name of the page opens it at that time. With `--compare` the
    /// page has two drives, or two sets of them, along their way, as `scanloop compare` has in text. Exit code 2 for a file that
    /// is no recording or has no scan of a drive, and for a page that exists.
    Report(ReportArguments),
    /// Draw a map from a recording, in which `estimator.map` finds the robot.
    ///
    /// It is an occupancy grid in the format of ROS `map_server`: NAME.yaml with its image NAME.pgm. The scans are drawn from the
    /// recorded estimates; bodies that move leave nothing where more beams passed than ended. Exit code 2 if the recording
    /// has no scan with an estimate.
    Map(MapArguments),
    /// Show the samples on the bus.
    #[command(subcommand)]
    Topic(TopicCommand),
    /// Try a Hokuyo laser scanner alone: print its parameters, draw or log its scans.
    #[command(subcommand)]
    Urg(UrgCommand),
    /// Print the samples of all topics: fields, units, offsets.
    Types(TypesArguments),
    /// List the keys of scenario and system files with default, allowed values and meaning.
    ///
    /// `scanloop reference steering` lists the keys with `steering` in their name or meaning, named as `--set` takes them.
    /// `0` is the first table of a list, as in `obstacle.0.x_m`.
    Reference(ReferenceArguments),
    /// Write a small project that builds, passes `scanloop conformance` and drives.
    ///
    /// It is a copy of an example, which you change. The folder must not exist. A language and role without a template are
    /// refused with those that have one.
    New(NewArguments),
    /// Check what this machine is missing for a drive, and name the fix of each.
    ///
    /// It checks shared memory, limits, control groups, processors, container, terminal and compilers, the other programs of
    /// Scanloop, running systems, and what dead ones have left. Exit code 1 if something would stop a drive.
    Doctor(DoctorArguments),
    /// Print what a shell reads to complete words of `scanloop` and `scanloop-lab`.
    ///
    /// Besides commands and options, the shell then offers running systems, roles, topics, scenarios, implementations,
    /// faults, and keys of `--set` with their values.
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// List what may be typed at a place of a command line; the scripts of `completions` start this.
    #[command(hide = true)]
    Complete(CompleteArguments),
    /// Write man pages of all commands into a folder.
    Man(ManArguments),
}

/// Arguments of `stop`.
#[derive(Debug, Args, Default)]
pub struct StopArguments {
    /// Stop all systems of this user.
    #[arg(long)]
    pub all: bool,
    /// Stop the systems of another user; needs root.
    #[arg(long, value_name = "UID")]
    pub uid: Option<u32>,
    /// End the processes of a run that was stopped; `stop` starts itself with this option.
    #[arg(long, value_name = "RUN", hide = true)]
    pub finish: Option<String>,
}

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArguments {
    /// Scenario or system files, or names of shipped scenarios.
    #[arg(value_name = "FILE")]
    pub files: Vec<String>,
    /// The choice of scenario and system.
    #[command(flatten)]
    pub choice: Choice,
    /// Print the names of the shipped scenarios to standard output.
    #[arg(long)]
    pub list: bool,
    /// First rewrite the files with the keys of this version; their comments stay.
    #[arg(long, requires = "files", conflicts_with_all = ["list", "live"])]
    pub migrate: bool,
    /// Options of `--live`.
    #[command(flatten)]
    pub live: LiveArguments,
}

/// What an agent needs before it is started.
#[derive(Debug, Subcommand)]
pub enum AgentCommand {
    /// Make certificates for the orchestrator and for a host, so that they can trust each other over `quic`.
    ///
    /// The folder gets an authority with the first host, which signs further ones. Copy the folder of the host to it over a
    /// way that you trust.
    Pair {
        /// Name of the host.
        host: String,
        /// IP address at which its agent listens.
        address: std::net::IpAddr,
        /// How long the certificates are valid [days].
        #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
        days: u32,
        /// Folder for certificates and keys.
        #[arg(long, value_name = "DIR", default_value = "hosts", value_parser = console::output::folder())]
        out: PathBuf,
        /// Replace the key and the certificate that the host has there, and those of the orchestrator.
        #[arg(long)]
        force: bool,
    },
}

/// What to show of the topics.
#[derive(Debug, Subcommand)]
pub enum TopicCommand {
    /// List all topics: size, writer, readers, type; of a running system also those that its file adds.
    List,
    /// Measure the rate of a topic.
    Hz {
        /// Name of the topic.
        topic: String,
        /// Stop after this many seconds.
        #[arg(long, value_name = "S", default_value_t = 5.0)]
        duration: f64,
    },
    /// Print the samples of a topic as JSON to standard output, one line each.
    ///
    /// Values of enumerations are printed by name; a number without a name stays a number.
    Echo {
        /// Name of the topic.
        topic: String,
        /// Stop after this many samples.
        #[arg(long, short = 'n', value_name = "N")]
        count: Option<u64>,
        /// Leave out arrays of more than 16 elements.
        #[arg(long)]
        short: bool,
    },
    /// Publish one sample by hand on a topic of your own whose writer is `operator`.
    ///
    /// Fields that the JSON object does not name are zero. Topics of the loop are refused.
    Pub {
        /// Name of the topic.
        topic: String,
        /// Values by the names of the fields, as `{"speed_mps": 0.5}`.
        json: String,
    },
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_help_names_every_command_on_a_screen_of_a_terminal() {
        assert!(HELP.lines().count() <= 25 && HELP.lines().all(|line| line.len() <= 80), "{HELP}");
        // Processes start these.
        let is_started = |name: &str| ["service", "remote", "complete"].contains(&name);
        for command in Cli::command().get_subcommands().filter(|command| !is_started(command.get_name())) {
            let name = command.get_name();
            let found = HELP.split_whitespace().filter(|word| *word == name).count();
            assert!(found >= 1, "{name} is missing");
        }
        let help = Cli::command().render_long_help().to_string();
        assert_eq!(help, HELP);
    }

    #[test]
    fn options_of_check_live_are_refused_without_it() {
        for given in ["--json", "--drive", "--speed=0.3", "--stops=4", "--observe=5", "--by-hand=30"] {
            for other in [&[][..], &["corridor"], &["--list"]] {
                let words = [&["scanloop", "check", given], other].concat();
                assert!(Cli::try_parse_from(&words).is_err(), "{words:?}");
            }
        }
        assert!(
            Cli::try_parse_from(["scanloop", "check", "--live", "--drive", "--speed=0.3", "--json"]).is_ok()
        );
    }
}
