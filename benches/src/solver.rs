//! `scanloop-lab solver`: the time of a solve on recorded initial states, compared with other solvers.
//!
//! Each case is solved from the same start by every configuration in turn, and then by the peers, so that a slow phase
//! of the machine affects all of them. The start of a case is the solution of the case before, shifted by a period,
//! where both are scans of the same lap, else driving straight on. Times are wall time of the calling thread around
//! the call. They include the roll-out of the start, which peers get ready-made. Caches are warm: times of a
//! controller that slept for most of a period are in the table of a run.

mod cases;
mod contender;
mod fit;
mod peers;
pub mod problem;
mod table;
mod versus;

use std::path::{Path, PathBuf};

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use console::progress::Steps;
use console::user_file;
use figures::PROFILE;
use ocp::{Budget, Collocation, Problem, Solution, Solver, SolverSettings, Status, Trajectory};
use serde::Serialize;

use self::cases::SHIPPED;
use self::contender::{Contender, ContenderRow};
use self::fit::{Fit, fit};
use self::peers::{About, Peers};
use self::problem::{Case, guess, problem};
use self::versus::{PeerRow, Versus};
use commands::bench::warn_of_profile;
use commands::print_json;

/// The numbers of intervals that acados is compared with; CasADi only with the first.
const PEER_INTERVALS: [usize; 4] = [6, 12, 24, 48];
/// The growth of the cost is fitted from this many intervals on: below, constant costs dominate.
const FIT_FROM: usize = 24;

/// Arguments of `solver`.
#[derive(Debug, Args)]
pub(crate) struct SolverArguments {
    /// Initial states, a CSV file with a header; without it the shipped ones.
    ///
    /// Columns are found by name: `x1` to `x5` are sideslip, yaw, yaw rate, x and y. The columns `goal_x_m`, `goal_y_m`,
    /// `obstacle_x_m`, `obstacle_y_m`, `obstacle_a_m` and `obstacle_b_m` are optional (default: goal (10, 0), ellipse at
    /// (5, 0.1) with semi-axes 1.2 and 0.8); others are ignored. Consecutive rows with the same `lap` are 0.1 s apart and
    /// start from the previous solution; rows without `lap` start straight ahead.
    #[arg(long, value_name = "CSV")]
    pub(crate) cases: Option<PathBuf>,
    /// Solve the same cases also with CasADi (N = 6) and acados (N = 6, 12, 24 and 48), in turns, and print ratios.
    ///
    /// `benches/peers/setup.sh` installs CasADi, `benches/peers/setup.sh acados` both.
    #[arg(long)]
    pub(crate) peer: bool,
    /// Numbers of intervals N.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [6, 12, 24, 48, 96],
          value_parser = clap::value_parser!(u8).range(1..=200))]
    pub(crate) intervals: Vec<u8>,
    /// Print JSON to standard output.
    #[arg(long)]
    pub(crate) json: bool,
}

/// What is printed as JSON.
#[derive(Debug, Default, Serialize)]
struct SolverResults {
    profile: &'static str,
    cases: usize,
    laps: usize,
    start: &'static str,
    solvers: Vec<ContenderRow>,
    growth: Vec<Growth>,
    about_peers: Option<About>,
    peers: Vec<PeerRow>,
    skipped: Vec<Skipped>,
}

impl SolverResults {
    /// Notes once why there are no peers.
    fn skip(&mut self, reason: String) {
        if self.skipped.is_empty() {
            self.skipped.push(Skipped { name: "peers", reason });
        }
    }
}

/// How the cost grows with the number of intervals.
#[derive(Debug, Clone, Serialize)]
struct Growth {
    name: String,
    hessian: String,
    step: Option<Fit>,
    solve: Option<Fit>,
    solve_p99: Option<Fit>,
}

/// A peer that was not run.
#[derive(Debug, Clone, Serialize)]
struct Skipped {
    name: &'static str,
    reason: String,
}

/// Measures all configurations and prints the results.
///
/// # Errors
/// A bad file of cases, or peers that have stopped answering.
pub(crate) fn solver(arguments: &SolverArguments) -> anyhow::Result<Exit> {
    warn_of_profile();
    let cases = read(arguments.cases.as_deref())?;
    let mut lists: Vec<usize> = arguments.intervals.iter().map(|&count| usize::from(count)).collect();
    lists.sort_unstable();
    lists.dedup();
    let has_laps = cases.iter().any(|case| case.lap.is_some());
    let mut results = SolverResults {
        profile: PROFILE,
        cases: cases.len(),
        laps: laps(&cases),
        start: if has_laps { "warm" } else { "cold" },
        ..SolverResults::default()
    };
    let mut steps = Steps::new((cases.len() * lists.len()) as u64, "cases");
    for intervals in lists {
        let mut peers = None;
        if arguments.peer && PEER_INTERVALS.contains(&intervals) {
            match peers::find() {
                Ok(folder) => peers = Some(Peers::start(&folder, &problem(&cases[0], intervals))?),
                Err(reason) => results.skip(reason),
            }
        }
        measure(&cases, Contender::all(intervals), peers.as_mut(), &mut steps, &mut results)?;
    }
    drop(steps);
    if arguments.peer && results.peers.is_empty() && results.skipped.is_empty() {
        results
            .skip(format!("peers are compared with N of {PEER_INTERVALS:?}, which --intervals leaves out"));
    }
    results.growth = growth(&results.solvers);
    answer!(arguments.json, "{}", table::text(&results))?;
    print_json(arguments.json, &results)?;
    Ok(Exit::Done)
}

fn read(file: Option<&Path>) -> anyhow::Result<Vec<Case>> {
    let Some(file) = file else { return cases::parse(SHIPPED).map_err(anyhow::Error::msg) };
    let text = user_file::read_table(file)
        .map_err(|error| Failure::bad_input(format!("--cases {}: {error}", file.display())))?;
    cases::parse(&text).map_err(|error| Failure::bad_input(format!("{}: {error}", file.display())))
}

fn laps(cases: &[Case]) -> usize {
    let mut laps: Vec<u64> = cases.iter().filter_map(|case| case.lap).collect();
    laps.dedup();
    laps.len()
}

/// All configurations with one number of intervals on all cases, and the peers between them.
fn measure(
    cases: &[Case],
    mut contenders: Vec<Contender>,
    mut peers: Option<&mut Peers>,
    steps: &mut Steps,
    results: &mut SolverResults,
) -> anyhow::Result<()> {
    let intervals = contenders.first().map_or(PEER_INTERVALS[0], Contender::intervals);
    let names = peers.as_ref().map(|peers| peers.about.peers.clone()).unwrap_or_default();
    let mut others: Vec<Versus> = names.iter().map(|name| Versus::new(name)).collect();
    for (index, (case, problem, guess)) in starts(cases, intervals).into_iter().enumerate() {
        steps.step("");
        let share = index as f64 / cases.len() as f64;
        let mut ours: Option<Solution> = None;
        for contender in &mut contenders {
            if contender.leaves_out(share) {
                continue;
            }
            let is_default = contender.is_default();
            let solution = contender.measure(&problem, &guess);
            if is_default {
                ours = solution.cloned();
            }
        }
        let Some(peers) = peers.as_mut() else { continue };
        for result in peers.measure(&problem, &guess)? {
            if let Some(other) = others.iter_mut().find(|other| other.name() == result.name) {
                other.add(case.line, &result, ours.as_ref());
            }
        }
    }
    if let Some(default) = contenders.iter().find(|contender| contender.is_default()) {
        let ours = default.row();
        results.peers.extend(others.iter().map(|other| other.row(&ours)));
    }
    results.about_peers = peers.map(|peers| peers.about.clone()).or(results.about_peers.take());
    results.solvers.extend(contenders.iter().map(Contender::row));
    Ok(())
}

/// Problem and start of every case; all configurations get the warm starts of the default settings.
fn starts(cases: &[Case], intervals: usize) -> Vec<(Case, Problem, Trajectory)> {
    let settings = SolverSettings::default();
    let collocation = Collocation::new(settings.scheme);
    let mut solver = Solver::new(settings);
    let mut before: Option<(u64, Trajectory)> = None;
    cases
        .iter()
        .map(|case| {
            let problem = problem(case, intervals);
            let warm = before.as_ref().filter(|(lap, _)| case.lap == Some(*lap));
            let guess = guess(&problem, &collocation, warm.map(|(_, solution)| solution));
            let solution = solver.solve(&problem, &guess, &Budget::Iterations(u32::MAX));
            let converged = solution.status == Status::Converged;
            before = case.lap.filter(|_| converged).map(|lap| (lap, solution.trajectory));
            (*case, problem, guess)
        })
        .collect()
}

/// Fits over the numbers of intervals, for each configuration with enough of them.
fn growth(rows: &[ContenderRow]) -> Vec<Growth> {
    let mut found: Vec<Growth> = Vec::new();
    for row in rows.iter().filter(|row| row.refine) {
        if found.iter().any(|growth| growth.name == row.name && growth.hessian == row.hessian) {
            continue;
        }
        let same: Vec<_> = rows
            .iter()
            .filter(|other| other.name == row.name && other.hessian == row.hessian)
            .filter(|other| other.refine && other.n >= FIT_FROM)
            .collect();
        let pairs = |cost: fn(&ContenderRow) -> f64| -> Vec<(f64, f64)> {
            same.iter().map(|row| (row.n as f64, cost(row))).collect()
        };
        let (step, solve) = (fit(&pairs(|row| row.step_us.p50)), fit(&pairs(|row| row.solve_us.p50)));
        let solve_p99 = fit(&pairs(|row| row.solve_us.p99));
        if step.is_some() || solve.is_some() {
            let (name, hessian) = (row.name.clone(), row.hessian.clone());
            found.push(Growth { name, hessian, step, solve, solve_p99 });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_of_a_lap_start_warm_and_others_straight_on() {
        let case = |x: f64, lap| {
            let mut case = Case { lap, ..Case::default() };
            (case.state.x, case.state.y) = (x, 0.4);
            case
        };
        let cases = [case(0.5, Some(1)), case(0.6, Some(1)), case(0.5, Some(2)), case(0.6, None)];
        let starts = starts(&cases, 6);
        let is_straight = |index: usize| {
            starts[index].2.controls.iter().all(|control| control.velocity == 0.9 && control.steering == 0.0)
        };
        assert_eq!([0, 1, 2, 3].map(is_straight), [true, false, true, true]);
        assert_eq!(starts[1].2.states.len(), 7);
        assert_eq!(laps(&cases), 2);
    }
}
