//! d
mod scene;
use scene::*;
#[test]
fn dbg_noise() {
    let mut scene = Scene::of(&[block(6.0, 0.05, 2.0, 0.3, 0.8)]);
    let mut robot = Robot { speed: 1.0, ..Robot::default() };
    let mut d = describer();
    for _ in 0..60 {
        let (s, p) = scene.scan(&robot);
        let o = d.step(&s, &p);
        robot = robot.after(0.1);
        robot.y = 0.6 * robot.x.min(2.0);
        println!("pose {:.3} {:.3} {:.3}", p.x_m, p.y_m, p.yaw_rad);
        for i in o.list() {
            println!(
                "  {} {} x{:.3} y{:.3} a{:.3} b{:.3} box {:.3} {:.3} {:.3}x{:.3}@{:.2} {}",
                i.id,
                i.sightings,
                i.x_m,
                i.y_m,
                i.a_m,
                i.b_m,
                i.box_x_m,
                i.box_y_m,
                i.box_length_m,
                i.box_width_m,
                i.box_yaw_rad,
                i.unseen_s
            );
        }
    }
}
