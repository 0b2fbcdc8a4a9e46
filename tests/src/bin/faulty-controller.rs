//! The controller with a fault, for tests of swaps.
//!
//! `faulty-controller none | nan | steer | late | mute | flood | hang-after N | hang-preparing-after N | exit-after N`

use runtime::{Handover, Process, RuntimeError, join, wait_for};
use shared_types::{Command, Obstacles, Pose, Role};

/// Delay of the fault `late`: more than half a period of 100 ms, less than a whole one [ns].
const LATE_NS: u64 = 70_000_000;

/// Interval of the fault `flood`: ten thousand samples a second [ns].
const FLOOD_NS: u64 = 100_000;

/// What is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    NotANumber,
    SteersMore,
    Late,
    Mute,
    Floods,
    HangsAfter(u64),
    HangsPreparingAfter(u64),
    ExitsAfter(u64),
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let fault = fault(&arguments)
        .ok_or("usage: faulty-controller none|nan|steer|late|mute|flood|hang-after N|hang-preparing-after N|exit-after N")?;
    run(fault)
}

fn fault(arguments: &[String]) -> Option<Fault> {
    let number = || arguments.get(1)?.parse().ok();
    Some(match arguments.first()?.as_str() {
        "none" => Fault::None,
        "nan" => Fault::NotANumber,
        "steer" => Fault::SteersMore,
        "late" => Fault::Late,
        "mute" => Fault::Mute,
        "flood" => Fault::Floods,
        "hang-after" => Fault::HangsAfter(number()?),
        "hang-preparing-after" => Fault::HangsPreparingAfter(number()?),
        "exit-after" => Fault::ExitsAfter(number()?),
        _ => return None,
    })
}

fn run(fault: Fault) -> Result<(), Box<dyn std::error::Error>> {
    let mut process = Process::attach(Role::Controller)?;
    let config = process.settings::<nmpc::ControllerConfig>("controller")?;
    let budget = nmpc::Budget::Iterations(config.budget_iterations);
    let mut controller = nmpc::Controller::new(config)?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.input::<Obstacles>()?;
    let commands = process.output::<Command>()?;
    if let Handover::State(state) = process.resume()? {
        controller.resume(&state);
    }
    if !process.start()? {
        return Ok(());
    }
    let (mut count, mut last) = (0, None::<Command>);
    loop {
        let deadline_ns = (fault == Fault::Floods).then(|| process.clock().now_ns() + FLOOD_NS);
        let hangs = matches!(fault, Fault::HangsPreparingAfter(limit) if count > limit);
        let mut prepare = |_| {
            if hangs {
                hang()
            }
        };
        if !process.wait_preparing(deadline_ns, &mut prepare)? {
            return Ok(());
        }
        // A timer may be late by half of that, so each is published twice.
        for command in last.iter_mut().filter(|_| fault == Fault::Floods) {
            commands.publish(command)?;
            commands.publish(command)?;
        }
        while let Some((pose, obstacles)) = join(&poses, &obstacles) {
            let mut command = controller.step(&pose, &obstacles, &budget);
            count += 1;
            match fault {
                Fault::NotANumber => command.steering_rad = f64::NAN,
                Fault::SteersMore => command.steering_rad *= 1.2,
                Fault::Late => {
                    wait_for(&[], LATE_NS);
                }
                Fault::Mute => continue,
                Fault::HangsAfter(limit) if count > limit => hang(),
                Fault::ExitsAfter(limit) if count > limit => return Err(gone().into()),
                _ => {}
            }
            commands.publish(&mut command)?;
            last = Some(command);
        }
    }
}

/// Ignores everything but a kill.
fn hang() -> ! {
    loop {
        wait_for(&[], 100_000_000);
    }
}

fn gone() -> RuntimeError {
    RuntimeError::NotRunning("this one".to_owned())
}
