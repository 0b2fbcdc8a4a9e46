//! A closed loop without processes: the model as the plant, ellipses from the true boxes by (7.35).
//!
//! The loop has the timing of lock-step: the command for the scan at t acts at t + T/3. Bodies are described
//! perfectly once seen, and remembered until they are 2 m behind; nothing is known of the others.

mod independent;

use independent::Judge;
use nmpc::{Budget, Controller, ControllerConfig};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shared_types::{Command, CommandKind, Obstacle, Obstacles, Pose, ScannerHealth, StopReason};
use vehicle::geometry::Rectangle;
use vehicle::integrate::integrate;
use vehicle::{Control, Parameters, State};

/// Period of the scans [s].
pub(crate) const PERIOD_S: f64 = 0.1;
const PLANT_STEPS: usize = 10;
const RANGE_M: f64 = 5.4;
const HALF_VIEW_RAD: f64 = std::f64::consts::FRAC_PI_3;
const DECELERATION_MPS2: f64 = 5.0;

/// A box in the scene.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) length: f64,
    pub(crate) width: f64,
    pub(crate) velocity: [f64; 2],
    /// Time from which it is there [s].
    pub(crate) appears_s: f64,
    /// Time until which it is there [s].
    pub(crate) disappears_s: f64,
    /// Distance of the robot's front to its surface at which it appears [m].
    pub(crate) appears_ahead_m: f64,
}

/// A standing box that is always there.
pub(crate) fn body(x: f64, y: f64, length: f64, width: f64) -> Body {
    Body {
        x,
        y,
        length,
        width,
        velocity: [0.0, 0.0],
        appears_s: 0.0,
        disappears_s: f64::INFINITY,
        appears_ahead_m: f64::INFINITY,
    }
}

/// What happened in a run.
#[derive(Debug, Clone)]
pub(crate) struct Outcome {
    pub(crate) landed: bool,
    pub(crate) stopped: Option<StopReason>,
    pub(crate) contact: bool,
    pub(crate) final_distance: f64,
    pub(crate) min_clearance: f64,
    pub(crate) largest_y: f64,
    pub(crate) scans: usize,
    pub(crate) seconds: f64,
    pub(crate) levels: [usize; 4],
    pub(crate) iterations: u32,
    pub(crate) stops: usize,
    pub(crate) commands: Vec<Command>,
    pub(crate) trajectory: Vec<State>,
    pub(crate) step_us: Vec<f64>,
}

impl Outcome {
    /// Landed within the tolerance without contact.
    pub(crate) fn reached(&self, config: &ControllerConfig) -> bool {
        self.landed && self.final_distance <= config.goal.tolerance_m && !self.contact
    }
}

/// Noise of the loop, as standard deviations.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Noise {
    pub(crate) position_m: f64,
    pub(crate) yaw_rad: f64,
    pub(crate) obstacle_m: f64,
    pub(crate) seed: u64,
}

/// A judge of the commands of a controller with this configuration.
pub(crate) fn judge(config: &ControllerConfig) -> Judge {
    let ControllerConfig { vehicle, mut track, mut goal, clearance_m, period_s, .. } = *config;
    let mut y_range = config.y_range();
    if !config.course.is_line() {
        // It knows no course, but the bodies, and how a robot drives.
        (track.x_m, track.y_m, y_range) = ([-1e4, 1e4], [-1e4, 1e4], [-1e4, 1e4]);
        goal.x_m = 1e4;
    }
    Judge { vehicle, track, goal, y_range, clearance_m, period_s, ellipses: false }
}

/// Drives `config` among `bodies` until it landed, stood for 5 s, or 60 s passed.
pub(crate) fn run(config: &ControllerConfig, start: State, bodies: &[Body], noise: Noise) -> Outcome {
    let parameters = Parameters::default();
    let mut random = Pcg64Mcg::seed_from_u64(noise.seed);
    let mut config = config.clone();
    // The plant here drives forwards only.
    config.vehicle.bounds.reverse_max_mps = 0.0;
    let config = &config;
    let mut controller = Controller::new(config.clone()).expect("a valid configuration");
    let mut outcome = Outcome {
        landed: false,
        stopped: None,
        contact: false,
        final_distance: f64::INFINITY,
        min_clearance: f64::INFINITY,
        largest_y: 0.0,
        scans: 0,
        seconds: 0.0,
        levels: [0; 4],
        iterations: 0,
        stops: 0,
        commands: Vec::new(),
        trajectory: Vec::new(),
        step_us: Vec::new(),
    };
    let mut state = start;
    let mut speed: f64 = 0.0;
    let mut control: Option<Control> = None;
    let mut seen = vec![false; bodies.len()];
    let mut there = vec![false; bodies.len()];
    let mut standing_since: Option<f64> = None;
    let mut was_driving = false;
    let mut along = config.course.find(&start);
    for scan in 1..=600_u64 {
        let t = (scan - 1) as f64 * PERIOD_S;
        outcome.trajectory.push(state);
        // The scan at t.
        let at = |body: &Body, t: f64| Rectangle {
            centre: nalgebra::Vector2::new(body.x + body.velocity[0] * t, body.y + body.velocity[1] * t),
            yaw: 0.0,
            length: body.length,
            width: body.width,
        };
        let mut obstacles = Obstacles { scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
        obstacles.header.scan_id = scan;
        obstacles.header.acquired_ns = (t * 1e9) as u64 + 1_000_000_000;
        for (index, body) in bodies.iter().enumerate() {
            let rectangle = at(body, t);
            let ahead = rectangle.centre.x - body.length / 2.0 - (state.x + config.vehicle.length_m / 2.0);
            there[index] |= ahead <= body.appears_ahead_m;
            let exists = there[index] && t >= body.appears_s && t < body.disappears_s;
            let offset = [rectangle.centre.x - state.x, rectangle.centre.y - state.y];
            let bearing = vehicle::frame::wrap_angle(offset[1].atan2(offset[0]) - state.yaw);
            let distance = rectangle.distance_to_point(nalgebra::Vector2::new(state.x, state.y));
            seen[index] |= exists && distance < RANGE_M && bearing.abs() < HALF_VIEW_RAD;
            let ahead = match config.course.is_line() {
                true => offset[0],
                false => vehicle::frame::to_robot(state.yaw, offset[0], offset[1]).x,
            };
            seen[index] &= exists && ahead > -2.0;
            if seen[index] && (obstacles.count as usize) < shared_types::MAX_OBSTACLES {
                let mut jitter = || noise.obstacle_m * normal(&mut random);
                let (x, y) = (rectangle.centre.x + jitter(), rectangle.centre.y + jitter());
                let b = body.width + jitter().abs() + 2.0 * config.theta_m;
                obstacles.items[obstacles.count as usize] = Obstacle {
                    id: index as u32 + 1,
                    body: index as u32 + 1,
                    x_m: x,
                    y_m: y,
                    a_m: if b < 1.2 { 1.2 } else { 1.15 * b },
                    b_m: b,
                    velocity_x_mps: body.velocity[0],
                    velocity_y_mps: body.velocity[1],
                    velocity_covariance: [1e-4, 0.0, 1e-4],
                    box_x_m: x,
                    box_y_m: y,
                    box_length_m: body.length,
                    box_width_m: body.width,
                    sightings: scan,
                    ..Obstacle::default()
                };
                obstacles.count += 1;
            }
        }
        let predicted = drive(&parameters, state, speed, control, PERIOD_S / 3.0, |_, _| ());
        let mut pose = Pose { header: obstacles.header, ..Pose::default() };
        let noisy = [noise.position_m * normal(&mut random), noise.position_m * normal(&mut random)];
        let noisy_yaw = noise.yaw_rad * normal(&mut random);
        (pose.x_m, pose.y_m, pose.yaw_rad) = (state.x + noisy[0], state.y + noisy[1], state.yaw + noisy_yaw);
        pose.speed_mps = speed;
        pose.predicted_ns = pose.header.acquired_ns + 33_333_333;
        pose.predicted_x_m = predicted.0.x + noisy[0];
        pose.predicted_y_m = predicted.0.y + noisy[1];
        pose.predicted_yaw_rad = predicted.0.yaw + noisy_yaw;
        pose.predicted_yaw_rate_radps = predicted.0.yaw_rate;
        pose.predicted_sideslip_rad = predicted.0.sideslip;
        pose.predicted_speed_mps = predicted.1;

        let begin = std::time::Instant::now();
        let command = controller.step(&pose, &obstacles, &Budget::Iterations(config.budget_iterations));
        outcome.step_us.push(begin.elapsed().as_secs_f64() * 1e6);

        assert_eq!(command.header.scan_id, scan);
        let kind = CommandKind::try_from(command.kind).expect("a known kind");
        outcome.levels[command.level as usize] += 1;
        outcome.iterations = outcome.iterations.max(command.iterations);
        outcome.commands.push(command);
        outcome.scans = scan as usize;

        // The old command acts until t + T/3, the new one then.
        let mut watch = |elapsed: f64, state: &State| {
            let robot = Rectangle {
                centre: nalgebra::Vector2::new(state.x, state.y),
                yaw: state.yaw,
                length: config.vehicle.length_m,
                width: config.vehicle.width_m,
            };
            for (index, body) in bodies.iter().enumerate() {
                let now = t + elapsed;
                if there[index] && now >= body.appears_s && now < body.disappears_s {
                    outcome.min_clearance =
                        outcome.min_clearance.min(robot.distance_to_rectangle(&at(body, now)));
                }
            }
            if config.track.walls {
                for wall in config.track.y_m {
                    outcome.min_clearance = outcome.min_clearance.min(robot.distance_to_wall(wall, 0.0));
                }
            }
            let place = config.course.on_course(state, along);
            along = place.x;
            outcome.largest_y = outcome.largest_y.max(place.y.abs());
        };
        (state, speed) = drive(&parameters, state, speed, control, PERIOD_S / 3.0, &mut watch);
        control = (kind == CommandKind::Drive)
            .then_some(Control { velocity: command.velocity_mps, steering: command.steering_rad });
        if kind == CommandKind::Drive {
            assert!(
                control.is_some_and(|control| config.vehicle.bounds.contains(control, 0.0)),
                "outside of the hard bounds: {control:?}"
            );
        }
        // The judge takes longer than the controller; neighbouring scans differ little.
        if scan % 3 == 0 {
            assert_eq!(judge(config).objection(&command, &pose, &obstacles), None, "scan {scan}");
        }
        if was_driving && kind == CommandKind::Stop {
            outcome.stops += 1;
        }
        was_driving = kind == CommandKind::Drive;
        (state, speed) = drive(&parameters, state, speed, control, PERIOD_S * 2.0 / 3.0, |elapsed, state| {
            watch(elapsed + PERIOD_S / 3.0, state);
        });

        outcome.seconds = t + PERIOD_S;
        let standing = kind != CommandKind::Drive;
        standing_since = if standing { standing_since.or(Some(t)) } else { None };
        outcome.landed = kind == CommandKind::Land;
        if (outcome.landed && speed == 0.0) || standing_since.is_some_and(|since| t - since > 5.0) {
            outcome.stopped =
                (!outcome.landed).then(|| StopReason::try_from(command.reason).expect("a known reason"));
            break;
        }
    }
    outcome.contact = outcome.min_clearance <= 0.0;
    let goal = config.course.in_plane(&State { x: config.goal.x_m, y: config.goal.y_m, ..State::default() });
    outcome.final_distance = (state.x - goal.x).hypot(state.y - goal.y);
    outcome
}

/// The plant for `duration`: the model under a control, or blocked wheels.
fn drive(
    parameters: &Parameters,
    mut state: State,
    mut speed: f64,
    control: Option<Control>,
    duration: f64,
    mut watch: impl FnMut(f64, &State),
) -> (State, f64) {
    let step = duration / PLANT_STEPS as f64;
    for part in 1..=PLANT_STEPS {
        if let Some(control) = control {
            state = integrate(parameters, &state, &control, step);
            speed = control.velocity;
        } else {
            let after = (speed - DECELERATION_MPS2 * step).max(0.0);
            let distance = (speed * speed - after * after) / (2.0 * DECELERATION_MPS2);
            let course = state.yaw + state.sideslip;
            state.x += distance * course.cos();
            state.y += distance * course.sin();
            (state.sideslip, state.yaw_rate) = (0.0, 0.0);
            speed = after;
        }
        watch(part as f64 * step, &state);
    }
    (state, speed)
}

fn normal(random: &mut Pcg64Mcg) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// The figures of a run on one line.
pub(crate) fn print(name: &str, config: &ControllerConfig, outcome: &Outcome) {
    let mut step = outcome.step_us.clone();
    step.sort_by(f64::total_cmp);
    let [stop, converged, best, last] = outcome.levels;
    println!(
        "{name:<18} {:<22} {:>6.3} {:>7.3} {:>6.2} {:>6.1} | {stop:>3} {converged:>4} {best:>3} {last:>3} | {:>3} {:>2} | {:>7.0} {:>7.0}",
        if outcome.contact {
            "CONTACT".to_owned()
        } else if outcome.reached(config) {
            "reached".to_owned()
        } else if outcome.landed {
            "missed".to_owned()
        } else {
            outcome.stopped.map_or("timeout".to_owned(), |reason| format!("stopped {}", reason.name()))
        },
        outcome.final_distance,
        outcome.min_clearance,
        outcome.largest_y,
        outcome.seconds,
        outcome.iterations,
        outcome.stops,
        step[step.len() / 2],
        step[step.len() - 1],
    );
}

/// The head of the table.
pub(crate) fn print_head() {
    println!(
        "{:<18} {:<22} {:>6} {:>7} {:>6} {:>6} | stp conv bst lst |  it st | step us p50, max",
        "course", "outcome", "final", "clear", "|y|", "time"
    );
}
