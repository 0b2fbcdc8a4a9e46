//! The emulated robot with a fault, for tests of swaps.
//!
//! `faulty-robot none | nan | jump | hang-after N | exit-after N`

use emulator::service::run_with;
use shared_types::{Odometry, Scan, Truth};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let fault: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let mut count = 0;
    match fault[..] {
        ["none"] => run_with(|_, _, _| {}),
        ["nan"] => run_with(|_, odometry: &mut Odometry, _| odometry.x_m = f64::NAN),
        // It measures itself 0.1 m beside its true position.
        ["jump"] => run_with(|_, odometry: &mut Odometry, truth: &mut Truth| {
            odometry.y_m += 0.1;
            truth.y_m += 0.1;
        }),
        ["hang-after", limit] => {
            let limit: u64 = limit.parse()?;
            run_with(move |_, _, _| {
                count += 1;
                if count > limit {
                    loop {
                        runtime::wait_for(&[], 100_000_000);
                    }
                }
            })
        }
        ["exit-after", limit] => {
            let limit: u64 = limit.parse()?;
            run_with(move |scan: &mut Scan, _, _| {
                count += 1;
                if count > limit {
                    eprintln!("gone at scan {}", scan.header.scan_id);
                    std::process::exit(1);
                }
            })
        }
        _ => return Err("usage: faulty-robot none|nan|jump|hang-after N|exit-after N".into()),
    }?;
    Ok(())
}
