//! An emulated robot behind a Player 3 server, to try the implementation `player` without a robot.
//!
//! It runs until it is interrupted, and prints what the wheels do.

use std::process::ExitCode;

use console::exit::{Exit, Failure, exit_of};
use emulator::Scenario;
use runtime::{Shutdown, wait_for};
use scanloop_tests::player_server::PlayerServer;
use shared_types::did_you_mean;

/// Ten scans per second [ns].
const PERIOD_NS: u64 = 100_000_000;

const HELP: &str = "An emulated robot behind a Player 3 server.\n\nUsage: player-server [SCENARIO] [PORT]\n\n\
    SCENARIO  a shipped scenario [default: corridor]\n\
    PORT      of 127.0.0.1, 0 for a free one [default: 6665]";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|argument| ["-h", "--help"].contains(&argument.as_str())) {
        println!("{HELP}");
        return ExitCode::SUCCESS;
    }
    match serve(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(exit_of(&error) as u8)
        }
    }
}

fn serve(arguments: &[String]) -> anyhow::Result<()> {
    let refuse = |message: String| {
        Failure::bad_input(format!("{message}; `player-server --help` explains the arguments"))
    };
    if let [_, _, more, ..] = arguments {
        return Err(refuse(format!("{more} is one argument too many")));
    }
    let name = arguments.first().map_or("corridor", String::as_str);
    let text = Scenario::shipped(name).ok_or_else(|| {
        let names: Vec<&str> = Scenario::names().collect();
        let meant = did_you_mean(name, names.iter().copied());
        refuse(format!("{name} is no shipped scenario: {}.{meant}", names.join(", ")))
    })?;
    let port = arguments.get(1).map_or("6665", String::as_str);
    let port: u16 = port.parse().map_err(|_| refuse(format!("PORT {port} is not allowed: 0 to 65535")))?;
    let scenario = Scenario::parse(text, name)?;
    let shutdown = Shutdown::on_signals()?;
    let server = PlayerServer::start(&scenario, PERIOD_NS, port).map_err(|error| Failure {
        exit: Exit::ProcessFailed,
        message: format!("port {port} of 127.0.0.1 can't be used: {error}; PORT 0 takes a free one"),
    })?;
    println!("scenario {name} at 127.0.0.1:{}", server.port());
    let mut shown = 0;
    while !shutdown.requested() {
        wait_for(&[], PERIOD_NS);
        let truth = server.truth();
        let way_m = truth.path_length_m;
        if (way_m - f64::from(shown)).abs() >= 1.0 {
            shown = way_m as u32;
            let (x_m, y_m, clearance_m) = (truth.x_m, truth.y_m, truth.min_clearance_m);
            println!("x {x_m:.2} m, y {y_m:.2} m, smallest clearance {clearance_m:.2} m");
        }
    }
    Ok(())
}
