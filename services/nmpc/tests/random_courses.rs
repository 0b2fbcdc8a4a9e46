//! Random courses: the robot never touches anything.
//!
//! Up to three boxes 0.1 to 0.5 m wide, anywhere across the track, with noise on position, yaw and description.
//! At 5.5 m apart one side of every box is open by (7.35), so all these courses are passable. Closer together,
//! or moving, some have no path outside of the ellipses: there a stop is right, and only contact is a failure.
//!
//! `RUNS=1000 cargo test --release -p nmpc --test random_courses -- --nocapture` prints the table of more courses.

mod common;

use common::{Body, Noise, body, print, print_head, run};
use nmpc::ControllerConfig;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::State;
use vehicle::{Goal, Track};

/// What a campaign varies.
#[derive(Debug, Clone, Copy)]
struct Campaign {
    name: &'static str,
    runs: u64,
    spacing: f64,
    walls: bool,
    /// Standard deviation of positions [m]; yaw has half of the number in radians.
    noise: f64,
    /// Largest velocity of the boxes along and across the track [m/s].
    speed: f64,
    /// Start anywhere across the track, looking up to 0.5 rad aside.
    anywhere: bool,
}

const PASSABLE: Campaign = Campaign {
    name: "passable",
    runs: 100,
    spacing: 5.5,
    walls: false,
    noise: 0.01,
    speed: 0.0,
    anywhere: false,
};

fn course(campaign: &Campaign, seed: u64) -> (State, Vec<Body>) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let count = uniform(1.0, 3.999) as usize;
    let first = uniform(4.0, 5.0);
    let bodies = (0..count)
        .map(|index| {
            let (x, y) = (first + campaign.spacing * index as f64, uniform(-1.3, 1.3));
            let (length, width) = (uniform(0.1, 0.5), uniform(0.1, 0.5));
            let velocity = [uniform(-1.0, 1.0) * campaign.speed, uniform(-1.0, 1.0) * campaign.speed];
            Body { velocity, ..body(x, y, length, width) }
        })
        .collect();
    let start = if campaign.anywhere {
        State { y: uniform(-1.2, 1.2), yaw: uniform(-0.5, 0.5), ..State::default() }
    } else {
        State::default()
    };
    (start, bodies)
}

/// Share of the courses whose goal was reached; nothing may be nearer than `clearance`.
fn drive(campaign: Campaign, clearance: f64) -> f64 {
    let mut config =
        ControllerConfig { goal: Goal { x_m: 20.6, ..Goal::default() }, ..ControllerConfig::default() };
    if campaign.walls {
        config.track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() };
    }
    let runs: u64 = std::env::var("RUNS").ok().and_then(|text| text.parse().ok()).unwrap_or(campaign.runs);
    let (mut reached, mut stops, mut nearest) = (0_u32, 0, f64::INFINITY);
    let mut times = Vec::new();
    print_head();
    for seed in 0..runs {
        let noise = Noise {
            position_m: campaign.noise,
            yaw_rad: campaign.noise / 2.0,
            obstacle_m: campaign.noise,
            seed,
        };
        let (start, bodies) = course(&campaign, seed);
        let outcome = run(&config, start, &bodies, noise);
        if !outcome.reached(&config) || outcome.stops > 0 {
            print(&format!("{} {seed}", campaign.name), &config, &outcome);
        }
        assert!(outcome.min_clearance >= clearance, "{} {seed}: {}", campaign.name, outcome.min_clearance);
        nearest = outcome.min_clearance.min(nearest);
        stops += outcome.stops;
        reached += u32::from(outcome.reached(&config));
        times.extend(outcome.step_us);
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{}: reached {reached} of {runs}, {stops} stops, smallest clearance {nearest:.3} m, step {:.0} us p50, {:.0} us p99",
        campaign.name,
        times[times.len() / 2],
        times[times.len() * 99 / 100],
    );
    f64::from(reached) / runs as f64
}

#[test]
fn a_hundred_passable_courses_are_all_driven_without_contact() {
    assert!(drive(PASSABLE, 0.2) > 0.99);
}

#[test]
fn passable_courses_between_walls_are_driven() {
    assert!(drive(Campaign { name: "walls", runs: 40, walls: true, ..PASSABLE }, 0.1) > 0.97);
}

#[test]
fn twice_the_noise_does_not_stop_the_robot_for_good() {
    assert!(drive(Campaign { name: "noise 2 cm", runs: 40, noise: 0.02, ..PASSABLE }, 0.15) > 0.97);
}

#[test]
fn the_robot_may_start_anywhere() {
    assert!(drive(Campaign { name: "anywhere", runs: 40, anywhere: true, ..PASSABLE }, 0.15) > 0.97);
}

#[test]
fn crowded_courses_are_driven_or_stopped_without_contact() {
    assert!(drive(Campaign { name: "crowded", runs: 60, spacing: 1.5, ..PASSABLE }, 0.1) > 0.85);
}

#[test]
fn moving_boxes_are_not_touched() {
    // A box may drive into the standing robot; these are slow enough, and seldom meet it.
    assert!(drive(Campaign { name: "moving", runs: 60, speed: 0.3, ..PASSABLE }, 0.05) > 0.9);
}
