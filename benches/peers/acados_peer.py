"""acados as a peer of `solver_peers.py`: the same optimal control problem, written once more for its templates.

Its Radau IIA integrator with three stages and one step per interval is the collocation of the other peers; cost, bounds
and the penalised slack of the ellipse are theirs. Hessian of Gauss and Newton, full steps, HPIPM in its fast mode for the
quadratic programs, blocks of four intervals condensed, one factorisation of the integrator per interval: the fastest at
every N of twelve sets of options (N = 6 and 24 tried; condensing fully is as fast at 6). The C code that acados renders is
compiled by gcc -O2, its libraries are those of the wheel on PyPI, built for processors with AVX2 and FMA.

Times are acados' own of the solve call: no Python, no setting of the start. The solver is reset before each.
"""

import contextlib
import ctypes
import importlib.metadata
import io
import os
import statistics
from pathlib import Path

import acados
import casadi as ca
import numpy as np
from casadi_reference import slopes

INSTALLED = Path(acados.__file__).parent / "install"
os.environ["ACADOS_SOURCE_DIR"] = str(INSTALLED)
os.environ["ACADOS_PYTHON_INTERFACE_PATH"] = str(INSTALLED.parent / "acados_template")
os.environ["TERA_PATH"] = str(INSTALLED / "bin" / "t_renderer")
# libacados finds these only where they are loaded already.
for library in ("blasfeo", "hpipm", "qpOASES_e"):
    ctypes.CDLL(str(INSTALLED / "lib" / f"lib{library}.so"), mode=ctypes.RTLD_GLOBAL)
from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver  # noqa: E402

VERSION = importlib.metadata.version("comma-deps-acados")
# A value that the row of the ellipse does not reach: larger ones cost HPIPM digits.
NONE = 1e4
# Values of an interval in the start: controls, stages, slack.
INTERVAL = 18
PREPARATION, FEEDBACK = 1, 2
SOLVED, READY = 0, 5


def model(name):
    """The vehicle, and the ellipse, a parameter, as a row that is negative inside."""
    state, control, slope = ca.SX.sym("x", 5), ca.SX.sym("u", 2), ca.SX.sym("xdot", 5)
    ellipse = ca.SX.sym("ellipse", 4)
    x, y, a, b = (ellipse[i] for i in range(4))
    found = AcadosModel()
    found.name, found.x, found.u, found.xdot, found.p = name, state, control, slope, ellipse
    rate = ca.vertcat(*slopes([state[c] for c in range(5)], [control[0], control[1]]))
    found.f_expl_expr, found.f_impl_expr = rate, slope - rate
    found.con_h_expr = found.con_h_expr_e = ((state[3] - x) / a) ** 2 + ((state[4] - y) / b) ** 2 - 1
    return found


def program(name, setting, kind):
    """The optimal control problem of a setting, for the solver SQP or SQP_RTI."""
    count = setting["intervals"]
    step = setting["horizon_s"] / count
    weights = setting["weights"]
    ocp = AcadosOcp()
    ocp.model, ocp.dims.N, ocp.parameter_values = model(name), count, np.ones(4)
    cost, limits, options = ocp.cost, ocp.constraints, ocp.solver_options
    # acados takes half of the squares, and all nodes but the last times the length of the interval.
    cost.cost_type = cost.cost_type_e = "LINEAR_LS"
    cost.W = np.diag([*weights["node"], *weights["control"]]) * 2.0 / step
    cost.W_e = np.diag(weights["terminal"]) * 2.0
    cost.Vx, cost.Vu, cost.Vx_e = np.eye(7)[:, :5], np.eye(7)[:, 5:], np.eye(5)
    cost.yref, cost.yref_e = np.zeros(7), np.zeros(5)
    linear, quadratic = np.array([weights["slack_linear"]]), np.array([2.0 * weights["slack_quadratic"]])
    cost.zl = cost.zu = linear / step
    cost.Zl = cost.Zu = quadratic / step
    cost.zl_e = cost.zu_e = linear
    cost.Zl_e = cost.Zu_e = quadratic
    limits.x0 = np.zeros(5)
    limits.idxbu, limits.idxbx, limits.idxbx_e = np.arange(2), np.arange(5), np.arange(5)
    limits.lbu, limits.ubu = np.array(setting["control_low"]), np.array(setting["control_high"])
    limits.lbx = limits.lbx_e = np.array(setting["state_low"])
    limits.ubx = limits.ubx_e = np.array(setting["state_high"])
    limits.lh = limits.lh_e = np.zeros(1)
    limits.uh = limits.uh_e = np.array([NONE])
    limits.idxsh = limits.idxsh_e = np.zeros(1, dtype=int)
    options.tf, options.nlp_solver_type, options.nlp_solver_max_iter = setting["horizon_s"], kind, 200
    options.integrator_type, options.collocation_type = "IRK", "GAUSS_RADAU_IIA"
    options.sim_method_num_stages, options.sim_method_num_steps, options.sim_method_jac_reuse = 3, 1, 1
    options.qp_solver, options.hpipm_mode = "PARTIAL_CONDENSING_HPIPM", "SPEED"
    options.qp_solver_cond_N = max(1, count // 4)
    for what in ("stat", "eq", "ineq", "comp"):
        setattr(options, f"nlp_solver_tol_{what}", setting["tolerance"])
        setattr(options, f"qp_solver_tol_{what}", setting["tolerance"])
    return ocp


class Acados:
    """One solver with its compiled code, which is kept in a folder of `cache`."""

    compiled = True

    def __init__(self, name, transcription, setting, cache):
        self.name, self.transcription, self.count = name, transcription, setting["intervals"]
        self.cruise, self.is_rti = setting["control_reference"], name == "acados-rti"
        folder = cache / f"{name}-{self.count}"
        folder.mkdir(parents=True, exist_ok=True)
        kind = "SQP_RTI" if self.is_rti else "SQP"
        ocp = program(f"{name}_{self.count}".replace("-", "_"), setting, kind)
        ocp.code_export_directory = str(folder / "code")
        with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
            self.solver = AcadosOcpSolver(ocp, json_file="ocp.json", verbose=False)
        # Nothing can move the first node: it has no reference and no ellipse.
        first = np.array(ocp.cost.W)
        first[:5] = 0.0
        self.solver.cost_set(0, "W", first)
        self.solver.constraints_set(0, "lh", np.array([-NONE]))

    def place(self, initial):
        """Sets the measured state."""
        for bound in ("lbx", "ubx"):
            self.solver.set(0, bound, np.array(initial))

    def pose(self, case, start):
        """Sets references, ellipse and start, and forgets the solve before."""
        solver, count = self.solver, self.count
        solver.reset()
        self.place(case["initial"])
        solver.set(0, "x", np.array(case["initial"]))
        references = [case["initial"], *case["references"]]
        for node in range(count + 1):
            solver.set(node, "p", np.array(case["ellipse"]))
            solver.set(node, "yref", np.array(references[node] + (self.cruise if node < count else [])))
        for node in range(count):
            values = np.array(start[INTERVAL * node:INTERVAL * (node + 1)])
            solver.set(node, "u", values[:2])
            solver.set(node + 1, "x", values[12:17])
            solver.set(node + 1, "sl", values[17:])

    def solve(self):
        """Whether it found a solution, and the time in microseconds."""
        return self.solver.solve() in (SOLVED, READY), 1e6 * float(np.ravel(self.solver.get_stats("time_tot"))[0])

    def once(self, case, start):
        """One timed solve: whether it converged, the times of its parts."""
        if not self.is_rti:
            self.pose(case, start)
            return self.solve()
        # Prepared at a state that was predicted a millimetre off, as Scanloop is.
        predicted = [*case["initial"][:4], case["initial"][4] + 1e-3]
        self.pose({**case, "initial": predicted}, start)
        self.solver.options_set("rti_phase", PREPARATION)
        prepared, preparation = self.solve()
        self.place(case["initial"])
        self.solver.options_set("rti_phase", FEEDBACK)
        fed, feedback = self.solve()
        return prepared and fed, (preparation + feedback, feedback)

    def answer(self, case, start, repeats):
        """Times (median of `repeats` after one that does not count), iterations, controls, and the point reached."""
        converged = self.once(case, start)[0]
        times = [self.once(case, start)[1] for _ in range(repeats)]
        controls = [self.solver.get(node, "u").tolist() for node in range(self.count)]
        answer = {"converged": converged, "controls": [value for pair in controls for value in pair]}
        if self.is_rti:
            step, feedback = (statistics.median(column) for column in zip(*times))
            return {**answer, "step_us": step, "feedback_us": feedback, "iterations": 1}, None
        iterations = int(np.ravel(self.solver.get_stats("sqp_iter"))[0])
        point = {"x": self.transcription.start({**case, "controls": controls})}
        return {**answer, "us": statistics.median(times), "iterations": iterations}, point
