mod common;
use common::*;
use nmpc::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::State;
fn campaign(name: &str, runs: u64, noise: Noise, walls: bool, ymax: f64, dense: f64, start: bool, moving: bool) {
    let mut config = Config { goal: Goal { x_m: 20.6, ..Goal::default() }, ..Config::default() };
    if walls { config.track = Track { y_m: [-1.9, 1.9], walls: true, ..Track::default() }; }
    let (mut reached, mut stops, mut nearest, mut stopped, mut missed, mut contact) = (0, 0, f64::INFINITY, 0, 0, 0);
    let mut times = vec![];
    for seed in 0..runs {
        let mut random = Pcg64Mcg::seed_from_u64(seed + 1000);
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let count = uniform(1.0, 3.999) as usize;
        let first = uniform(4.0, 5.0);
        let bodies: Vec<Body> = (0..count).map(|i| { let mut b = body(first + dense * i as f64, uniform(-ymax, ymax), uniform(0.1, 0.5), uniform(0.1, 0.5)); if moving { b.velocity = [uniform(-0.3,0.3), uniform(-0.3, 0.3)]; } b }).collect();
        let s = if start { State { y: uniform(-1.2, 1.2), yaw: uniform(-0.5, 0.5), ..State::default() } } else { State::default() };
        let o = run(&config, s, &bodies, Noise { seed, ..noise });
        times.extend(o.step_us.iter().copied());
        nearest = o.min_clearance.min(nearest); stops += o.stops;
        let r = o.reached(&config);
        reached += r as u32; contact += o.contact as u32; stopped += o.stopped.is_some() as u32; missed += (o.landed && !r) as u32;
        if (!r || o.stops > 0 || o.min_clearance < 0.05) && std::env::var_os("SHOW").is_some() { print(&format!("{name} {seed}"), &config, &o); println!("{s:?} {}", bodies.iter().map(|b| format!("({:.2} {:.2} {:.2}x{:.2} v {:?})", b.x, b.y, b.length, b.width, b.velocity)).collect::<String>()); }
    }
    times.sort_by(f64::total_cmp);
    println!("{name:<20} reached {reached}/{runs} stopped {stopped} missed {missed} contact {contact} stops {stops} nearest {nearest:.3} us p50 {:.0} p99 {:.0} max {:.0}", times[times.len()/2], times[times.len()*99/100], times[times.len()-1]);
}
#[test]
fn campaigns() {
    let n = |p: f64, y: f64| Noise { position_m: p, yaw_rad: y, obstacle_m: p, seed: 0 };
    let r = 300;
    campaign("noise 1cm", r, n(0.01, 0.005), false, 1.3, 5.5, false, false);
    campaign("noise 2cm", r, n(0.02, 0.01), false, 1.3, 5.5, false, false);
    campaign("noise 3cm", r, n(0.03, 0.02), false, 1.3, 5.5, false, false);
    campaign("walls", r, n(0.01, 0.005), true, 1.3, 5.5, false, false);
    campaign("dense 4m", r, n(0.01, 0.005), false, 1.3, 4.0, false, false);
    campaign("dense 1.5m", r, n(0.01, 0.005), false, 1.3, 1.5, false, false);
    campaign("start", r, n(0.01, 0.005), false, 1.3, 5.5, true, false);
    campaign("start walls", r, n(0.01, 0.005), true, 1.3, 5.5, true, false);
    campaign("moving", r, n(0.01, 0.005), false, 1.3, 5.5, false, true);
    campaign("moving walls", r, n(0.01, 0.005), true, 1.3, 5.5, false, true);
}
