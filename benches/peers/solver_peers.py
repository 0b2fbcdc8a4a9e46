#!/usr/bin/env python3
"""CasADi with IPOPT and with its own sqpmethod, and acados (`acados_peer.py`), as peers of `scanloop bench solver --peer`.

The benchmark starts this process and sends one line of JSON for the setting and then one per case; each gets one line back.
Equations and tableau come from `casadi_reference.py`; the transcription is leaner than the one there, in favour of the
peers: Radau collocation whose last stage is the node, bounds of the states as plain bounds of the variables (they are
soft in Scanloop, and the same where no bound is exceeded), one slack per node for the ellipse. Both solvers evaluate C
code that CasADi generated and gcc -O2 compiled, kept in `.venv/cache`; without a compiler, CasADi's virtual machine.

Both start from the same trajectory as Scanloop, with the stage values that belong to it, which Scanloop has to find out by
itself. Times are CasADi's own of the solve call alone: no Python, no conversion of arrays. IPOPT has the exact Hessian, once
with its default options (that is what published ratios are about) and once with the fastest set tried; sqpmethod the Gauss-Newton Hessian, which is exact for everything but the constraints, and the QP solver qrqp. Both stop at
the tolerance that Scanloop has. Solutions are compared after a second, untimed solve by IPOPT to 1e-10 from the first
one's answer, because an interior point stopped at 1e-6 is farther from the optimum than that in the controls.
"""

import contextlib
import hashlib
import importlib.util
import io
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
# What the reference script does without CasADi, installing it, is not for a process that is being waited for.
os.environ["SCANLOOP_IN_VENV"] = "1"
sys.path.insert(0, str(HERE))
import casadi as ca  # noqa: E402
from casadi_reference import MATRIX, slopes  # noqa: E402

CACHE = HERE / ".venv" / "cache"
# CasADi is compared with the published number of intervals only.
CASADI_INTERVALS = 6
IPOPT = {"print_level": 0, "sb": "yes", "max_iter": 300}
# The fastest of seven sets of options: a start that is trusted, and a small barrier from the beginning. On the shipped cases
# `mu_init` alone or the adaptive barrier gained at most a tenth of the median; sets with smaller pushes from the bounds were
# tried on six states only.
WARM = {
    "mu_init": 1e-4, "warm_start_init_point": "yes", "warm_start_bound_push": 1e-6,
    "warm_start_slack_bound_push": 1e-6, "warm_start_mult_bound_push": 1e-6,
}


class Transcription:
    """The nonlinear program with the initial state, the references and the ellipse as parameters."""

    def __init__(self, setting):
        count = self.count = setting["intervals"]
        step = setting["horizon_s"] / count
        weights = setting["weights"]
        initial = ca.SX.sym("initial", 5)
        references = ca.SX.sym("references", 5, count)
        ellipse = ca.SX.sym("ellipse", 4)
        self.parameter = ca.vertcat(initial, ca.vec(references), ellipse)
        variables, low, high, rows, least, most = [], [], [], [], [], []
        objective = 0
        state = [initial[c] for c in range(5)]
        nodes, controls, slacks = [], [], []
        for k in range(count):
            control = ca.SX.sym(f"u{k}", 2)
            stages = ca.SX.sym(f"z{k}", 5, 3)
            slack = ca.SX.sym(f"s{k}")
            variables += [control, ca.vec(stages), slack]
            low += [*setting["control_low"], *[-math.inf] * 10, *setting["state_low"], 0.0]
            high += [*setting["control_high"], *[math.inf] * 10, *setting["state_high"], math.inf]
            rates = [slopes([stages[c, i] for c in range(5)], [control[0], control[1]]) for i in range(3)]
            for i in range(3):
                for c in range(5):
                    rows.append(stages[c, i] - state[c] - step * sum(MATRIX[i][j] * rates[j][c] for j in range(3)))
                    least.append(0.0)
                    most.append(0.0)
            state = [stages[c, 2] for c in range(5)]
            x, y, a, b = (ellipse[i] for i in range(4))
            rows.append(1 - ((state[3] - x) / a) ** 2 - ((state[4] - y) / b) ** 2 - slack)
            least.append(-math.inf)
            most.append(0.0)
            row = weights["terminal"] if k + 1 == count else weights["node"]
            objective += sum(row[c] * (state[c] - references[c, k]) ** 2 for c in range(5))
            objective += sum(
                weights["control"][j] * (control[j] - setting["control_reference"][j]) ** 2 for j in range(2)
            )
            objective += weights["slack_linear"] * slack + weights["slack_quadratic"] * slack**2
            nodes.append(ca.vertcat(*state))
            controls.append(control)
            slacks.append(slack)
        self.variables, self.objective, self.rows = ca.vertcat(*variables), objective, ca.vertcat(*rows)
        self.bounds = {"lbx": low, "ubx": high, "lbg": least, "ubg": most}
        self.nlp = {"x": self.variables, "p": self.parameter, "f": self.objective, "g": self.rows}
        self.read_controls = ca.Function("controls", [self.variables], [ca.vertcat(*controls)])
        self.read_slack = ca.Function("slack", [self.variables], [ca.mmax(ca.vertcat(*slacks))])
        self.settle = self.stage_solver(step)

    @staticmethod
    def stage_solver(step):
        """Stage values of one interval under a control from a start state, to rounding."""
        stages, start, control = ca.SX.sym("z", 15), ca.SX.sym("start", 5), ca.SX.sym("u", 2)
        rates = [slopes([stages[5 * i + c] for c in range(5)], [control[0], control[1]]) for i in range(3)]
        residual = ca.vertcat(*[
            stages[5 * i + c] - start[c] - step * sum(MATRIX[i][j] * rates[j][c] for j in range(3))
            for i in range(3) for c in range(5)
        ])
        return ca.rootfinder("settle", "newton", {"x": stages, "p": ca.vertcat(start, control), "g": residual})

    def start(self, case):
        """The trajectory of the guess's controls with its stages and slacks."""
        x, y, a, b = case["ellipse"]
        state, values = list(case["initial"]), []
        for control in case["controls"]:
            stages = self.settle([*state] * 3, [*state, *control]).full().ravel().tolist()
            state = stages[10:]
            excess = 1 - ((state[3] - x) / a) ** 2 - ((state[4] - y) / b) ** 2
            values += [*control, *stages, max(excess, 0.0)]
        return values

    def parameters(self, case):
        return [*case["initial"], *[v for state in case["references"] for v in state], *case["ellipse"]]


def compiled(transcription, name, solver):
    """The path of the compiled C code of all functions that a solver evaluates, or none without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    CACHE.mkdir(parents=True, exist_ok=True)
    name = name.replace("-", "_")
    with contextlib.chdir(CACHE):
        solver.generate_dependencies(f"{name}.c")
        text = Path(f"{name}.c").read_bytes()
        library = CACHE / f"{name}-{hashlib.sha256(text).hexdigest()[:16]}.so"
        if not library.exists():
            part = library.with_suffix(f".{os.getpid()}")
            subprocess.run([compiler, "-O2", "-fPIC", "-shared", f"{name}.c", "-o", str(part), "-lm"], check=True)
            part.rename(library)
    return str(library)


class Peer:
    """One solver with the transcription it solves."""

    def __init__(self, name, transcription, plugin, options, compile=True):
        self.name, self.transcription = name, transcription
        options = {"print_time": False, "record_time": True, **options}
        solver = ca.nlpsol("solver", plugin, transcription.nlp, options)
        library = compiled(transcription, name, solver) if compile else None
        self.compiled = library is not None
        self.solver = ca.nlpsol("solver", plugin, library, options) if library else solver

    def solve(self, case, start):
        result = self.solver(
            x0=start, p=self.transcription.parameters(case), **self.transcription.bounds
        )
        return result, self.solver.stats()

    def answer(self, case, start, repeats):
        """Time in microseconds (median of `repeats` after one that does not count), iterations, controls."""
        try:
            result, stats = self.solve(case, start)
            times = []
            for _ in range(repeats):
                result, stats = self.solve(case, start)
                times.append(1e6 * stats["t_wall_total"])
        except RuntimeError as error:
            return {"converged": False, "us": None, "iterations": 0, "message": str(error).splitlines()[0]}, None
        controls = self.transcription.read_controls(result["x"]).full().ravel().tolist()
        return {
            "converged": bool(stats["success"]),
            "us": statistics.median(times),
            "iterations": int(stats["iter_count"]),
            "objective": float(result["f"]),
            "controls": controls,
        }, result


def acados_of(transcription, setting):
    """The solvers of acados, and its version: none where it is not installed, or nothing can compile its code."""
    if importlib.util.find_spec("acados") is None or not (shutil.which("make") and shutil.which("cc")):
        return [], None
    # Its interface prints while it is imported.
    with contextlib.redirect_stdout(io.StringIO()):
        import acados_peer
    names = ("acados-sqp", "acados-rti")
    return [acados_peer.Acados(name, transcription, setting, CACHE) for name in names], acados_peer.VERSION


def casadi_of(transcription, tolerance):
    """The solvers of CasADi."""
    ipopt = Peer("casadi-ipopt", transcription, "ipopt", {"ipopt": {**IPOPT, "tol": tolerance}})
    tuned = Peer("casadi-ipopt-tuned", transcription, "ipopt", {"ipopt": {**IPOPT, **WARM, "tol": tolerance}})
    # The objective is quadratic, so its own Hessian is the Gauss-Newton Hessian.
    x, p = transcription.variables, transcription.parameter
    factor, multipliers = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", transcription.rows.numel())
    hessian, _ = ca.hessian(factor * transcription.objective, x)
    gauss_newton = ca.Function(
        "nlp_hess_l", [x, p, factor, multipliers], [ca.triu(hessian)],
        ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
    )
    sqp = Peer("casadi-sqpmethod", transcription, "sqpmethod", {
        "hess_lag": gauss_newton, "qpsol": "qrqp", "tol_pr": tolerance, "tol_du": tolerance, "max_iter": 100,
        "print_iteration": False, "print_header": False, "print_status": False,
        "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    })
    return [ipopt, tuned, sqp]


def refined(exact, case, result):
    """The optimum that a peer's answer is near to, to 1e-10."""
    solved, stats = exact.solve(case, result["x"])
    if not stats["success"]:
        return None
    return {
        "controls": exact.transcription.read_controls(solved["x"]).full().ravel().tolist(),
        "objective": float(solved["f"]),
    }


def main():
    # Solvers print to the file descriptor of standard output; the answers keep it for themselves.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(answer):
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    setting = json.loads(sys.stdin.readline())
    transcription = Transcription(setting)
    is_published = setting["intervals"] == CASADI_INTERVALS
    peers = casadi_of(transcription, setting["tolerance"]) if is_published else []
    others, acados = acados_of(transcription, setting)
    peers += others
    exact = Peer("casadi-ipopt-exact", transcription, "ipopt", {
        "ipopt": {**IPOPT, "tol": 1e-10, "bound_relax_factor": 0.0, "mu_init": 1e-7, "acceptable_iter": 0},
    }, is_published)
    say({
        "version": ca.__version__,
        "acados": acados,
        "compiled": all(peer.compiled for peer in peers),
        "peers": [peer.name for peer in peers],
    })
    for line in sys.stdin:
        case = json.loads(line)
        start = transcription.start(case)
        reply = []
        for peer in peers:
            answer, result = peer.answer(case, start, setting["repeats"])
            if answer["converged"] and result is not None:
                answer["optimum"] = refined(exact, case, result)
            reply.append({"name": peer.name, **answer})
        say(reply)


if __name__ == "__main__":
    main()
