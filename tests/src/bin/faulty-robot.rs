//! The emulated robot with a fault, for tests of swaps and of `check --live`.
//!
//! `faulty-robot none | nan | jump | backwards | rolled SIGN | locked | spinning | slow | hang-after N | exit-after N`

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
        // Its encoders do not count what blocked wheels slide, at 5 m/s^2.
        ["locked"] => {
            let (mut before_mps, mut slid_m) = (0.0_f64, 0.0);
            run_with(move |_, odometry: &mut Odometry, truth: &mut Truth| {
                let slides_m = (before_mps.powi(2) - truth.speed_mps.powi(2)) / 10.0;
                before_mps = truth.speed_mps;
                if truth.blocked == 1 && slides_m > 0.0 {
                    slid_m += slides_m;
                    (odometry.dx_m, odometry.speed_mps) = (odometry.dx_m - slides_m, 0.0);
                }
                odometry.x_m -= slid_m;
            })
        }
        // Its wheels turn three times as fast as it drives.
        ["spinning"] => run_with(|_, odometry: &mut Odometry, _| {
            (odometry.x_m, odometry.dx_m) = (3.0 * odometry.x_m, 3.0 * odometry.dx_m);
            odometry.speed_mps *= 3.0;
        }),
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
                "usage: faulty-robot none|nan|jump|backwards|rolled SIGN|locked|spinning|slow|hang-after N|exit-after N"
                    .into(),
            );
        }
    }?;
    Ok(())
}
