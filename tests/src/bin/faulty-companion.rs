//! A companion that behaves as its argument says: `echo`, `read`, `shifted`, `other-layout`, `die`, `hang`, `flood`,
//! `garbage`, `command` or `leak`.
//!
//! It reads `odometry` and writes the topic `echo`; `read` reads `echo` and writes nothing. `shifted` publishes other
//! numbers, `other-layout` was built against another layout.

use std::process::ExitCode;

use runtime::{Bus, Companion, Domain, NamedTopic, Publisher, RuntimeError};
use shared_types::{Command, CommandKind, Header, Odometry, StageStamps};

shared_types::plain_state! {
    /// The scan of the sample that it answers.
    pub struct Echo {
        /// Identity and stamps of the sample that this one answers
        pub header: Header,
        /// Number of the scan
        pub value: f64,
        /// When the process that published it worked on it
        pub stage: StageStamps,
    }
}

shared_types::plain_state! {
    /// [`Echo`] with a field of another type.
    pub struct OtherEcho {
        /// Identity and stamps of the sample that this one answers
        pub header: Header,
        /// Number of the scan
        pub value: u64,
        /// When the process that published it worked on it
        pub stage: StageStamps,
    }
}

/// Samples that it answers before it misbehaves.
const GOOD_SAMPLES: u64 = 10;
/// Samples per input of one that floods its topic.
const FLOOD: u64 = 2000;
/// Bytes per input that are never freed, and how often.
const LEAK: (usize, usize) = (4 << 20, 32);

fn main() -> ExitCode {
    runtime::start_logging();
    let mode = std::env::args().nth(1).unwrap_or_default();
    let run = if mode == "read" { read() } else { write(&mode) };
    match run {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn read() -> Result<ExitCode, RuntimeError> {
    let mut companion = Companion::attach()?;
    let echo = companion.open::<Echo>("echo")?;
    if !companion.start()? {
        return Ok(ExitCode::SUCCESS);
    }
    while companion.wait(None)? {
        while let Some(sample) = echo.take()? {
            if sample.value.to_bits() != (sample.header.scan_id as f64).to_bits() {
                eprintln!("scan {} with value {}", sample.header.scan_id, sample.value);
                return Ok(ExitCode::from(3));
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn write(mode: &str) -> Result<ExitCode, RuntimeError> {
    let mut companion = Companion::attach()?;
    let odometry = companion.input::<Odometry>()?;
    if mode == "other-layout" {
        companion.open::<OtherEcho>("echo")?;
    }
    let shift = if mode == "shifted" { 0.5 } else { 0.0 };
    let echo = companion.open::<Echo>("echo")?;
    let mut commands = Vec::new();
    if mode == "command" {
        let bus = Bus::open(&Domain::of_this_process()?, "intruder")?;
        commands.push((Publisher::<Command>::new(&bus)?, bus));
    }
    if !companion.start()? {
        return Ok(ExitCode::SUCCESS);
    }
    let (mut answered, mut leaked) = (0, Vec::new());
    while companion.wait(None)? {
        while let Some(measured) = odometry.take()? {
            answered += 1;
            publish(&echo, &measured.header, measured.header.scan_id as f64 + shift)?;
            if answered <= GOOD_SAMPLES {
                continue;
            }
            match mode {
                "die" => return Ok(ExitCode::from(7)),
                "hang" => loop {
                    std::thread::park();
                },
                "flood" => {
                    for _ in 0..FLOOD {
                        publish(&echo, &measured.header, measured.header.scan_id as f64)?;
                    }
                }
                "garbage" => publish(&echo, &measured.header, f64::NAN)?,
                "command" => {
                    for (publisher, _) in &mut commands {
                        publisher.publish(&mut intrusion(&measured.header), true)?;
                    }
                }
                "leak" if leaked.len() < LEAK.1 => leaked.push(vec![1_u8; LEAK.0]),
                _ => {}
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn publish(echo: &NamedTopic<Echo>, to: &Header, value: f64) -> Result<(), RuntimeError> {
    echo.publish(&mut Echo { header: to.answer(), value, ..Echo::default() })
}

/// A command to drive at full speed, of a process that has no authority.
fn intrusion(to: &Header) -> Command {
    Command {
        header: Header { incarnation: 4_000_000, ..to.answer() },
        kind: CommandKind::Drive.wire(),
        velocity_mps: 2.0,
        verified: 1,
        ..Command::default()
    }
}
