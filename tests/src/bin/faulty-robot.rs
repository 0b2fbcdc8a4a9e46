//! The emulated robot with a fault, for tests of swaps and of `check --live`.
//!
//! `faulty-robot none | nan | jump | backwards | rolled SIGN | slow | hang-after N | exit-after N`

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
        // Its encoders count the other way round.
        ["backwards"] => run_with(|_, odometry: &mut Odometry, _| {
            (odometry.x_m, odometry.dx_m) = (-odometry.x_m, -odometry.dx_m);
        }),
        // It is moved by hand while its wheels are blocked: ahead and to the left, or as its encoders count that.
        ["rolled", sign] => {
            let sign: f64 = sign.parse()?;
            run_with(move |_, odometry: &mut Odometry, _| {
                count += 1;
                let steps = sign * count as f64;
                (odometry.x_m, odometry.dx_m) = (0.03 * steps, 0.03 * sign);
                (odometry.yaw_rad, odometry.dyaw_rad) = (0.02 * steps, 0.02 * sign);
            })
        }
        // Its scanner has two thirds of the rate.
        ["slow"] => run_with(|_, _, _| _ = runtime::wait_for(&[], 150_000_000)),
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
        _ => {
            return Err(
                "usage: faulty-robot none|nan|jump|backwards|rolled SIGN|slow|hang-after N|exit-after N"
                    .into(),
            );
        }
    }?;
    Ok(())
}
