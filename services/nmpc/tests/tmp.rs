mod common;
use common::*;
use nmpc::*;
#[test]
fn profile() {
    let config = Config::default();
    let o = run(&config, Default::default(), &[], Noise::default());
    for (c, s) in o.commands.iter().zip(&o.trajectory) { println!("{:.3} v {:.3} st {} it {} kkt {:.1e} | {:?}", s.x, c.velocity_mps, c.status, c.iterations, c.kkt_residual, c.nodes().iter().map(|n| (n.velocity_mps*1e3).round()/1e3).collect::<Vec<_>>()); }
}
#[test]
fn timing() {
    let config = Config { goal: Goal { x_m: 20.0, ..Goal::default() }, ..Config::default() };
    let bodies = [body(5.0, 0.25, 0.1, 0.4), body(10.5, -0.25, 0.1, 0.4), body(16.0, 0.25, 0.1, 0.4)];
    let o = run(&config, Default::default(), &bodies, Noise::default());
    print("slalom", &config, &o);
}
