//! CasADi's solvers and acados in a Python process, one case at a time over its standard input and output.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context, bail};
use ocp::{Problem, SolverSettings, Trajectory};
use serde::{Deserialize, Serialize};

use super::contender::REPEATS;
use super::problem::HORIZON_S;

/// The command that installs the environment of the peers.
pub(super) const SETUP: &str = "benches/peers/setup.sh";
/// Timeout of the start: generating and compiling C takes seconds, on a loaded machine many.
const START_TIMEOUT: Duration = Duration::from_secs(300);
/// Timeout of a case, which takes some ten milliseconds.
const CASE_TIMEOUT: Duration = Duration::from_secs(60);

/// A running Python process with its solvers.
pub(super) struct Peers {
    child: Child,
    requests: ChildStdin,
    responses: Receiver<String>,
    /// Its description of itself.
    pub about: About,
}

/// The description that the process sends before its first case.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct About {
    /// Version of CasADi.
    pub version: String,
    /// Version of acados, where it is installed.
    pub acados: Option<String>,
    /// Whether derivatives are compiled C.
    pub compiled: bool,
    /// Names of the solvers.
    pub peers: Vec<String>,
}

/// The result of one solver for a case.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct PeerResult {
    /// Its name.
    pub name: String,
    /// Whether it found a solution.
    pub converged: bool,
    /// Time of a converged solve [us]; none of one that only makes a step.
    #[serde(default)]
    pub us: Option<f64>,
    /// Time of a single step, and the part of it after the initial state has arrived [us].
    #[serde(default)]
    pub step_us: Option<f64>,
    /// See `step_us`.
    #[serde(default)]
    pub feedback_us: Option<f64>,
    /// Its iterations.
    pub iterations: u64,
    /// (velocity, steering) of the intervals, one after the other.
    #[serde(default)]
    pub controls: Vec<f64>,
    /// The optimum near its result to 1e-10, from an untimed solve.
    #[serde(default)]
    pub optimum: Option<Optimum>,
}

/// An optimum.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Optimum {
    /// (velocity, steering) of the intervals, one after the other.
    pub controls: Vec<f64>,
    /// Value of the objective.
    pub objective: f64,
}

/// The folder of the peers, found upwards from the working directory or from the executable.
fn folder() -> Option<PathBuf> {
    let executable = std::env::current_exe().ok();
    let starts =
        [std::env::current_dir().ok(), executable.as_deref().and_then(Path::parent).map(Path::to_owned)];
    starts.into_iter().flatten().find_map(|start| {
        start
            .ancestors()
            .map(|folder| folder.join("benches/peers"))
            .find(|folder| folder.join("solver_peers.py").exists())
    })
}

/// The folder of the peers, or why they can't run and what to do.
pub(super) fn find() -> Result<PathBuf, String> {
    let missing = || "benches/peers is not found from here: run it in the source tree".to_owned();
    let folder = folder().ok_or_else(missing)?;
    if folder.join(".venv/bin/python").exists() {
        Ok(folder)
    } else {
        Err(format!("CasADi is not installed: {SETUP} installs it"))
    }
}

impl Peers {
    /// Starts the process and waits until its solvers are made.
    pub(super) fn start(folder: &Path, problem: &Problem) -> anyhow::Result<Self> {
        let mut child = Command::new(folder.join(".venv/bin/python"))
            .arg(folder.join("solver_peers.py"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("the peers' Python does not start")?;
        let requests = child.stdin.take().context("the peers have no standard input")?;
        let output = child.stdout.take().context("the peers have no standard output")?;
        let (sender, responses) = channel();
        std::thread::Builder::new().name("peers".to_owned()).spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        })?;
        let mut peers = Self { child, requests, responses, about: About::default() };
        peers.about = peers.ask(&setting(problem), START_TIMEOUT)?;
        Ok(peers)
    }

    /// The results of the solvers for a case that starts from `guess`.
    pub(super) fn measure(
        &mut self,
        problem: &Problem,
        guess: &Trajectory,
    ) -> anyhow::Result<Vec<PeerResult>> {
        let references: Vec<[f64; 5]> =
            problem.references.iter().map(|state| state.to_vector().into()).collect();
        let controls: Vec<[f64; 2]> =
            guess.controls.iter().map(|control| [control.velocity, control.steering]).collect();
        let ellipse = &problem.ellipses[0];
        let initial: [f64; 5] = problem.initial.to_vector().into();
        let case = serde_json::json!({
            "initial": initial,
            "references": references,
            "ellipse": [ellipse.centres[0][0], ellipse.centres[0][1], ellipse.a, ellipse.b],
            "controls": controls,
        });
        self.ask(&case, CASE_TIMEOUT)
    }

    fn ask<T: serde::de::DeserializeOwned>(
        &mut self,
        request: &serde_json::Value,
        timeout: Duration,
    ) -> anyhow::Result<T> {
        writeln!(self.requests, "{request}")
            .and_then(|()| self.requests.flush())
            .context("the peers have ended")?;
        let line = match self.responses.recv_timeout(timeout) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => bail!("the peers did not answer within {timeout:?}"),
            Err(RecvTimeoutError::Disconnected) => bail!("the peers have ended; their messages are above"),
        };
        serde_json::from_str(&line).with_context(|| format!("unexpected response of the peers: `{line}`"))
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The parameters of the optimal control problem that all cases share.
fn setting(problem: &Problem) -> serde_json::Value {
    let (bounds, weights) = (&problem.bounds, &problem.weights);
    let limits = [bounds.sideslip_max_rad, bounds.yaw_max_rad, bounds.yaw_rate_max_radps];
    let [x_low, x_high] = problem.x_range;
    let [y_low, y_high] = problem.y_range;
    let reference = problem.control_reference;
    serde_json::json!({
        "intervals": problem.intervals.len(),
        "horizon_s": HORIZON_S,
        "repeats": REPEATS,
        "tolerance": SolverSettings::default().tolerance,
        "weights": {
            "node": weights.node,
            "terminal": weights.terminal,
            "control": weights.control,
            "slack_linear": weights.slack_linear,
            "slack_quadratic": weights.slack_quadratic,
        },
        "control_reference": [reference.velocity, reference.steering],
        "control_low": [bounds.velocity_min_mps, -bounds.steering_max_rad],
        "control_high": [bounds.velocity_max_mps, bounds.steering_max_rad],
        "state_low": [-limits[0], -limits[1], -limits[2], x_low, y_low],
        "state_high": [limits[0], limits[1], limits[2], x_high, y_high],
    })
}
