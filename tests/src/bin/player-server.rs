//! An emulated robot behind a Player 3 server, to try the implementation `player` without a robot.
//!
//! `player-server [SCENARIO] [PORT]`: a shipped scenario, by default `corridor`; by default port 6665. It runs until it
//! is interrupted, and prints what the wheels do.

use emulator::Scenario;
use runtime::{Shutdown, wait_for};
use scanloop_tests::player_server::PlayerServer;

/// Ten scans per second [ns].
const PERIOD_NS: u64 = 100_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let name = arguments.first().map_or("corridor", String::as_str);
    let port = arguments.get(1).map_or(Ok(6665), |port| port.parse())?;
    let text = Scenario::shipped(name).ok_or_else(|| format!("`{name}` is no shipped scenario"))?;
    let scenario = Scenario::parse(text, name)?;
    let (shutdown, server) = (Shutdown::on_signals()?, PlayerServer::start(&scenario, PERIOD_NS, port)?);
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
