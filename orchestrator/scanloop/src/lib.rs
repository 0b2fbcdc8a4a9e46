//! The commands of the executable `scanloop`: each reads its arguments, calls the crates below, and prints the result.

pub mod bench;
pub mod calibrate;
mod check;
pub mod cli;
pub mod completions;
pub mod demo;
pub mod doctor;
pub mod inject;
pub mod laboratory;
pub mod live_check;
mod live_latency;
pub mod man;
pub mod map;
pub mod new;
mod record;
pub mod reference;
pub mod replay;
mod service;
pub mod shadow;
mod status;
mod stop;
pub mod successor;
pub mod swap;
pub mod teleop;
pub mod top;
mod topic;
mod types;
pub mod urg;
mod why;

use std::process::ExitCode;
use std::time::Duration;

use clap::CommandFactory;
use console::exit::{Exit, Failure, exit_of};
use console::limits;
use console::output::{arguments, data};
use runtime::RuntimeError;
use serde::Serialize;
use session::{adopt, run};
use view::{Verb, ViewOfRun};

use cli::{AgentCommand, Cli, CliCommand, TopicCommand};

/// Limit for the last output at exit. A terminal usually takes it within microseconds.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(300);

/// So many files suffice to find a system, to stop it and to ask it.
const FILES_OF_STOP: usize = 3;

/// Runs the command line and returns its exit code.
pub fn main() -> ExitCode {
    program(parse_and_run)
}

/// Runs the command of an executable, prints its error, and returns its exit code.
pub fn program(command: fn() -> anyhow::Result<Exit>) -> ExitCode {
    limits::keep_own_rights();
    limits::keep_from_large_files();
    let exit = limits::require_stack().and_then(|()| command()).unwrap_or_else(|error| {
        runtime::print(runtime::Priority::Error, &format!("error: {}", limits::text_of(&error)));
        match exit_of(&error) {
            // The bus does not tell why it refuses something.
            Exit::Internal if limits::limit_of(&error).is_some() => Exit::ProcessFailed,
            exit => exit,
        }
    });
    runtime::flush_terminal(FLUSH_TIMEOUT);
    ExitCode::from(exit as u8)
}

/// Not inlined: its large frame comes after the check of the stack.
#[inline(never)]
fn parse_and_run() -> anyhow::Result<Exit> {
    let cli: Cli = arguments();
    runtime::check_log_filter()?;
    if matches!(
        cli.command,
        CliCommand::Run(_)
            | CliCommand::Adopt(_)
            | CliCommand::Bench(_)
            | CliCommand::Conformance(_)
            | CliCommand::Demo(_)
            | CliCommand::Agent { command: None, .. }
    ) {
        limits::require_room_for_a_system().map_err(point_to_doctor)?;
    }
    match cli.command {
        CliCommand::Service { .. } => {}
        CliCommand::Status { .. } | CliCommand::Stop(_) => limits::require_files(FILES_OF_STOP)?,
        _ => limits::require_files(limits::SPARE_FILES)?,
    }
    if matches!(cli.command, CliCommand::Run(_) | CliCommand::Adopt(_) | CliCommand::Bench(_)) {
        runtime::start_terminal();
    }
    let starts = matches!(cli.command, CliCommand::Run(_) | CliCommand::Adopt(_));
    let exit = dispatch(&cli).map_err(|error| match error.downcast_ref() {
        // Without the files of the kernel none can be seen.
        Some(RuntimeError::NotRunning(_)) => limits::require_proc().err().unwrap_or(error),
        _ if starts => point_to_doctor(error),
        _ => error,
    })?;
    if starts && exit == Exit::ProcessFailed {
        let hint = "If this machine lacks something, `scanloop doctor` tells what.";
        runtime::print(runtime::Priority::Warning, hint);
    }
    Ok(exit)
}

/// The error of a system that could not be started, with the command that tells what the machine lacks.
fn point_to_doctor(error: anyhow::Error) -> anyhow::Error {
    let is_of_limit = limits::limit_of(&error).is_some();
    match exit_of(&error) {
        Exit::ProcessFailed => {}
        Exit::Internal if is_of_limit => {}
        _ => return error,
    }
    Failure::process(format!("{} (`scanloop doctor` tells what this machine lacks)", limits::text_of(&error)))
}

/// Prints a value as JSON to standard output, if `--json` asks for it.
///
/// # Errors
/// Values without JSON, and an output that can't be written.
pub fn print_json(asked: bool, value: &impl Serialize) -> anyhow::Result<()> {
    if asked {
        data(&serde_json::to_string_pretty(value)?)?;
    }
    Ok(())
}

fn dispatch(cli: &Cli) -> anyhow::Result<Exit> {
    match &cli.command {
        CliCommand::Run(arguments) => {
            runtime::start_logging();
            let _page = arguments.view.map(|port| ViewOfRun::start(&cli.system_id, port)).transpose()?;
            run::run(&cli.system_id, arguments)
        }
        CliCommand::Demo(arguments) => {
            let is_named = cli.system_id != cli::DEFAULT_SYSTEM_ID;
            demo::demo(is_named.then_some(cli.system_id.as_str()), arguments)
        }
        CliCommand::Adopt(arguments) => {
            runtime::start_logging();
            adopt::adopt(&cli.system_id, arguments)
        }
        CliCommand::Calibrate(arguments) => calibrate::calibrate(arguments),
        CliCommand::Campaign(study) => Err(laboratory::hand_over(&cli.system_id, "campaign", study)),
        CliCommand::Faults(study) => Err(laboratory::hand_over(&cli.system_id, "faults", study)),
        CliCommand::Fork(study) => Err(laboratory::hand_over(&cli.system_id, "fork", study)),
        CliCommand::Price(study) => Err(laboratory::hand_over(&cli.system_id, "price", study)),
        CliCommand::Compare(study) => Err(laboratory::hand_over(&cli.system_id, "compare", study)),
        CliCommand::Analyse(study) => Err(laboratory::hand_over(&cli.system_id, "analyse", study)),
        CliCommand::Bench(command) => {
            runtime::start_logging();
            bench::bench(&cli.system_id, command)
        }
        CliCommand::Check(arguments) if arguments.live.live => {
            live_check::check(&cli.system_id, &arguments.live, &arguments.choice)
        }
        CliCommand::Check(arguments) => check::check(arguments),
        CliCommand::Status { json } => status::status(&cli.system_id, *json),
        CliCommand::Top(arguments) => top::top(&cli.system_id, arguments),
        CliCommand::View(arguments) => view::serve(&cli.system_id, arguments, &verbs()),
        CliCommand::Stop(arguments) => stop::stop(&cli.system_id, arguments),
        CliCommand::Pause => teleop::pause(&cli.system_id),
        CliCommand::Resume => teleop::resume(&cli.system_id),
        CliCommand::Teleop(arguments) => teleop::teleop(&cli.system_id, arguments),
        CliCommand::Latency { duration, json } => live_latency::watch(&cli.system_id, *duration, *json),
        CliCommand::Restart { role } => swap::restart(&cli.system_id, role),
        CliCommand::Swap(arguments) => swap::swap(&cli.system_id, arguments),
        CliCommand::Set(arguments) => swap::set(&cli.system_id, arguments),
        CliCommand::Inject(arguments) => inject::inject(&cli.system_id, arguments),
        CliCommand::Conformance(arguments) => conformance::conformance(arguments),
        CliCommand::Shadow(arguments) => shadow::shadow(&cli.system_id, arguments),
        CliCommand::Service { name } => service::run(name),
        CliCommand::Agent {
            command: Some(AgentCommand::Pair { host, address, days, out, force }), ..
        } => agent::link::pair(host, *address, *days, out, *force),
        CliCommand::Agent { command: None, file, out } => {
            runtime::start_logging();
            agent::agent::run(file, out)
        }
        CliCommand::Remote { host, implementation } => {
            runtime::start_logging();
            agent::proxy::run(host, implementation)
        }
        CliCommand::Topic(TopicCommand::List) => print(&topic::list(&cli.system_id)?),
        CliCommand::Topic(TopicCommand::Hz { topic, duration }) => {
            topic::hz(&cli.system_id, topic, *duration).map(|()| Exit::Done)
        }
        CliCommand::Topic(TopicCommand::Echo { topic, count, short }) => {
            topic::echo(&cli.system_id, topic, *count, *short)
        }
        CliCommand::Topic(TopicCommand::Pub { topic, json }) => {
            topic::publish(&cli.system_id, topic, json).map(|()| Exit::Done)
        }
        CliCommand::Record(arguments) => record::record(&cli.system_id, arguments),
        CliCommand::Recording(command) => record::recording(command),
        CliCommand::Map(arguments) => map::map(arguments),
        CliCommand::Replay(arguments) => replay::replay(arguments),
        CliCommand::Why(arguments) => why::why(&cli.system_id, arguments),
        CliCommand::Report(arguments) => view::report(arguments),
        CliCommand::Reference(arguments) => print(&reference::text(arguments, Cli::command())?),
        CliCommand::New(arguments) => new::new(arguments),
        CliCommand::Doctor(arguments) => doctor::doctor(&cli.system_id, arguments),
        CliCommand::Completions { shell } => print(shell.script()),
        CliCommand::Complete(arguments) => completions::print_candidates(Cli::command(), arguments),
        CliCommand::Man(arguments) => man::man(Cli::command(), arguments),
        CliCommand::Types(arguments) => print(&types::print(arguments)?),
        CliCommand::Urg(command) => urg::urg(command),
    }
}

/// The commands that a page with `--control` may run.
fn verbs() -> Vec<Verb> {
    let commands = Cli::command();
    Verb::ALL.iter().copied().filter(|verb| commands.find_subcommand(verb.command()).is_some()).collect()
}

/// Prints what a command was asked for.
fn print(text: &str) -> anyhow::Result<Exit> {
    data(text).map(|_| Exit::Done)
}
