//! The inertial sensor without noise, which after thirty scans behaves as its argument says: `dies`, `late`, `nan`,
//! `backwards`, `fast`, `stuck`, `mirrored` or `biased`; with `never` it stays as it is.

use std::process::ExitCode;

use runtime::{Companion, RuntimeError};
use shared_types::{Header, Truth};

#[path = "../../../examples/rust/imu/src/imu.rs"]
mod imu;

use imu::Imu;

/// Scans before it misbehaves.
const GOOD_SCANS: u64 = 30;
/// Scans by which it is late.
const LATE_SCANS: usize = 12;

fn main() -> ExitCode {
    runtime::start_logging();
    match run(&std::env::args().nth(1).unwrap_or_default()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(mode: &str) -> Result<ExitCode, RuntimeError> {
    let mut companion = Companion::attach()?;
    let truths = companion.input::<Truth>()?;
    let topic = companion.open::<Imu>("imu")?;
    if !companion.start()? {
        return Ok(ExitCode::SUCCESS);
    }
    let (mut last, mut held) = (None, 0.0);
    let mut waiting = std::collections::VecDeque::new();
    while companion.wait(None)? {
        while let Some(truth) = truths.take()? {
            let mut sample = measured(&truth, last.replace((truth.time_s, truth.yaw_rad)));
            let is_faulty = truth.header.scan_id > GOOD_SCANS;
            match mode {
                "dies" if is_faulty => return Ok(ExitCode::FAILURE),
                "nan" if is_faulty => sample.yaw_rate_radps = f64::NAN,
                "backwards" if is_faulty => sample.dt_s = -sample.dt_s,
                "fast" if is_faulty => sample.yaw_rate_radps = 50.0,
                "stuck" if is_faulty => sample.yaw_rate_radps = held,
                "mirrored" if is_faulty => sample.yaw_rate_radps = -sample.yaw_rate_radps,
                "biased" if is_faulty => sample.yaw_rate_radps += 0.09,
                _ => {}
            }
            held = sample.yaw_rate_radps;
            waiting.push_back(sample);
            if mode != "late" || waiting.len() > LATE_SCANS || !is_faulty {
                waiting.drain(..1).try_for_each(|mut sample| topic.publish(&mut sample))?;
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The mean yaw rate since the time [s] and the yaw [rad] before.
fn measured(truth: &Truth, last: Option<(f64, f64)>) -> Imu {
    let header: Header = truth.header.answer();
    let (time_s, yaw_rad) = last.unwrap_or((truth.time_s, truth.yaw_rad));
    let dt_s = truth.time_s - time_s;
    let turned_rad = (truth.yaw_rad - yaw_rad).sin().asin();
    Imu { header, yaw_rate_radps: if dt_s > 0.0 { turned_rad / dt_s } else { 0.0 }, dt_s, ..Imu::default() }
}
