//! Round trips over the bus: two hops each, with both ends asleep between samples.
//!
//! The same program is also the other end of the second bench; an environment variable selects it.

use std::process::Command;
use std::time::{Duration, Instant};

use criterion::Criterion;
use laboratory::{EchoClient, Peer, echo_until_told};

/// Makes this program the answering end of the system it names.
const ECHO_VARIABLE: &str = "SCANLOOP_BENCH_ECHO";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if let Ok(system_id) = std::env::var(ECHO_VARIABLE) {
        return Ok(echo_until_told(&system_id)?);
    }
    let mut criterion = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args();
    let system_id = |end: char| format!("bench-{end}{}", std::process::id());
    let mut group = criterion.benchmark_group("bus_round_trip");
    for (name, end) in [("threads", 't'), ("processes", 'p')] {
        let system_id = system_id(end);
        group.bench_function(name, |bencher| {
            let peer = match end {
                't' => Peer::Thread,
                _ => Peer::Process(this_program(&system_id)),
            };
            let mut echo = EchoClient::start(&system_id, peer).expect("a bus of two ends");
            bencher.iter_custom(|iterations| {
                let started = Instant::now();
                for _ in 0..iterations {
                    echo.round_trip().expect("a round trip");
                }
                started.elapsed()
            });
        });
    }
    group.finish();
    criterion.final_summary();
    Ok(())
}

fn this_program(system_id: &str) -> Command {
    let mut program = Command::new(std::env::current_exe().expect("the path of this program"));
    program.env(ECHO_VARIABLE, system_id);
    program
}
