//! Records the initial states of `scanloop bench solver`: three laps of a closed loop with the problem of the benchmark.
//!
//! ```sh
//! cargo run -p scanloop-lab --example record_solver_cases > benches/cases/solver.csv
//! ```
//!
//! The plant is the model itself; the first control of the converged solution acts for a period. The first lap is clean;
//! in the others the measured state has normal noise with a fixed seed, and is the case. A lap ends at the goal. Where
//! this fails as a set of cases: all three laps pass the ellipse on the right, and nothing is ever seen late; use a file
//! of your own for those.

use laboratory::solver::problem::{Case, PERIOD_S, guess, problem};
use ocp::{Budget, Collocation, Solver, SolverSettings, Trajectory};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::integrate::integrate;
use vehicle::{Parameters, State};

/// Standard deviations of what is measured.
const POSITION_M: f64 = 0.01;
const YAW_RAD: f64 = 0.005;
const SIDESLIP_RAD: f64 = 0.001;
const YAW_RATE_RADPS: f64 = 0.01;
/// Nearer than this a run has landed.
const LANDED_M: f64 = 0.1;
/// Three times what a lap takes.
const MAX_SCANS: usize = 400;

fn main() {
    println!("lap,x1,x2,x3,x4,x5");
    for lap in 1..=3 {
        for state in drive(lap) {
            let State { sideslip, yaw, yaw_rate, x, y } = state;
            println!("{lap},{sideslip:.9},{yaw:.9},{yaw_rate:.9},{x:.9},{y:.9}");
        }
    }
}

/// Measured states of a lap.
fn drive(lap: u64) -> Vec<State> {
    let settings = SolverSettings::default();
    let (collocation, mut solver) = (Collocation::new(settings.scheme), Solver::new(settings));
    let mut random = Pcg64Mcg::seed_from_u64(lap);
    let mut truth = State::default();
    let mut before: Option<Trajectory> = None;
    let mut states = Vec::new();
    while states.len() < MAX_SCANS {
        let measured = if lap == 1 { truth } else { blurred(&truth, &mut random) };
        let case = Case { state: measured, ..Case::default() };
        if case.goal[0] - measured.x < LANDED_M {
            break;
        }
        states.push(measured);
        let problem = problem(&case, 6);
        let guess = guess(&problem, &collocation, before.as_ref());
        let solution = solver.solve(&problem, &guess, &Budget::Iterations(60));
        truth = integrate(&Parameters::default(), &truth, &solution.trajectory.controls[0], PERIOD_S);
        before = Some(solution.trajectory);
    }
    states
}

fn blurred(truth: &State, random: &mut Pcg64Mcg) -> State {
    let mut noise = |deviation: f64| deviation * normal(random);
    State {
        sideslip: truth.sideslip + noise(SIDESLIP_RAD),
        yaw: truth.yaw + noise(YAW_RAD),
        yaw_rate: truth.yaw_rate + noise(YAW_RATE_RADPS),
        x: truth.x + noise(POSITION_M),
        y: truth.y + noise(POSITION_M),
    }
}

/// A normally distributed number, by Box and Muller.
fn normal(random: &mut Pcg64Mcg) -> f64 {
    let (radius, angle): (f64, f64) = (random.random(), random.random());
    // 1 - u is in (0, 1], where the logarithm is finite.
    (-2.0 * (1.0 - radius).ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}
