//! A hundred random courses: whatever stands where, nothing is touched.
//!
//! Up to three boxes 0.1 to 0.5 m wide, 5.5 m apart, anywhere across the track, with noise on position, yaw
//! and description. One of the sides of a single box is always open by (7.35), so all courses are passable.

mod common;

use common::{Body, Noise, body, print, print_head, run};
use nmpc::{Config, Goal};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::State;

fn course(seed: u64) -> Vec<Body> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let count = uniform(1.0, 3.999) as usize;
    let first = uniform(4.0, 5.0);
    (0..count)
        .map(|index| {
            let (length, width) = (uniform(0.1, 0.5), uniform(0.1, 0.5));
            body(first + 5.5 * index as f64, uniform(-1.3, 1.3), length, width)
        })
        .collect()
}

#[test]
fn a_hundred_random_courses_are_driven_without_contact() {
    let config = Config { goal: Goal { x_m: 20.6, ..Goal::default() }, ..Config::default() };
    let runs: u64 = std::env::var("RUNS").ok().and_then(|text| text.parse().ok()).unwrap_or(100);
    let (mut reached, mut stops, mut nearest) = (0, 0, f64::INFINITY);
    print_head();
    for seed in 0..runs {
        let noise = Noise { position_m: 0.01, yaw_rad: 0.005, obstacle_m: 0.01, seed };
        let bodies = course(seed);
        let outcome = run(&config, State::default(), &bodies, noise);
        assert!(outcome.min_clearance >= 0.05, "course {seed}: {} m", outcome.min_clearance);
        nearest = outcome.min_clearance.min(nearest);
        stops += outcome.stops;
        reached += u64::from(outcome.reached(&config));
        if !outcome.reached(&config) || outcome.stops > 0 {
            print(&format!("course {seed}"), &config, &outcome);
            println!("{bodies:?}");
        }
    }
    println!("reached {reached} of {runs}, {stops} stops on the way, smallest clearance {nearest:.3} m");
    assert!(reached * 100 >= runs * 97, "reached {reached} of {runs}");
}
