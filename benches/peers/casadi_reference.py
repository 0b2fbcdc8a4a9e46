#!/usr/bin/env python3
"""Solves instances of the optimal control problem with CasADi and IPOPT and stores the solutions.

The transcription is written down here a second time, from the equations (7.27)-(7.31) and not from the Rust code: Radau
collocation with three stages on each interval, all stage values and node states as variables, one slack per soft limit
with the penalty L1 s + L2 s^2, hard bounds of the controls, exact Hessian. The Rust test `casadi_reference` solves the
same instances from the same guesses and compares the controls.

    python3 benches/peers/casadi_reference.py            writes services/ocp/tests/data/casadi_reference.json

CasADi comes from PyPI into a virtual environment next to this file, which is made on the first run.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
OUTPUT = HERE.parents[1] / "services" / "ocp" / "tests" / "data" / "casadi_reference.json"
VERSION = "3.8.2"

try:
    import casadi as ca
except ImportError:
    environment = HERE / ".venv"
    python = environment / "bin" / "python"
    if os.environ.get("SCANLOOP_IN_VENV"):
        sys.exit("casadi could not be installed")
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    subprocess.run([str(python), "-m", "pip", "install", "-q", f"casadi=={VERSION}"], check=True)
    os.environ["SCANLOOP_IN_VENV"] = "1"
    os.execv(str(python), [str(python), *sys.argv])

MASS, REAR, FRONT, STIFFNESS, INERTIA = 14.695, 0.1924, 0.1776, 250.0, 0.5024
INTERVALS, HORIZON = 6, 2.72
STEP = HORIZON / INTERVALS
LOWER_CONTROL, UPPER_CONTROL = [0.1, -0.06], [1.0, 0.06]
ROOT = math.sqrt(6.0)
POINTS = [(4 - ROOT) / 10, (4 + ROOT) / 10, 1.0]
MATRIX = [
    [(88 - 7 * ROOT) / 360, (296 - 169 * ROOT) / 1800, (-2 + 3 * ROOT) / 225],
    [(296 + 169 * ROOT) / 1800, (88 + 7 * ROOT) / 360, (-2 - 3 * ROOT) / 225],
    [(16 - ROOT) / 36, (16 + ROOT) / 36, 1 / 9],
]


def slopes(state, control):
    """The model (7.27)-(7.31) with the sum in (7.27)."""
    x1, x2, x3, _, _ = state
    u1, u2 = control
    force = STIFFNESS * ca.cos(u2)
    return [
        force * (-2 * x1 + (x3 / u1) * (REAR - FRONT)) / (MASS * u1 * ca.cos(x1)) - x3,
        x3,
        force * (u2 * (REAR + FRONT) + x1 * (REAR - FRONT) - (x3 / u1) * (REAR**2 + FRONT**2)) / INERTIA,
        u1 * ca.cos(x1 + x2),
        u1 * ca.sin(x1 + x2),
    ]


class Program:
    """Collects variables, constraints and the objective of one instance."""

    def __init__(self):
        self.variables, self.start, self.low, self.high = [], [], [], []
        self.constraints, self.least, self.most = [], [], []
        self.objective = 0

    def variable(self, name, start, low=-math.inf, high=math.inf):
        symbol = ca.SX.sym(name)
        self.variables.append(symbol)
        self.start.append(start)
        self.low.append(low)
        self.high.append(high)
        return symbol

    def constrain(self, expression, least, most):
        self.constraints.append(expression)
        self.least.append(least)
        self.most.append(most)

    def soften(self, excess, start, weights):
        """excess <= slack, slack >= 0, with its penalty."""
        slack = self.variable("slack", max(start, 0.0) + 1e-3, 0.0)
        self.constrain(excess - slack, -math.inf, 0.0)
        self.objective += weights["slack_linear"] * slack + weights["slack_quadratic"] * slack**2
        return slack


def roll_out(initial, controls):
    """End states of the intervals by implicit Euler with small steps: good enough for a start."""
    states, state = [initial], list(initial)
    for control in controls:
        for _ in range(200):
            # (sideslip, yaw rate) are stiff: two linear solves of the frozen system are one Newton step.
            h = STEP / 200
            z = ca.SX.sym("z", 5)
            if not hasattr(roll_out, "solver"):
                p = ca.SX.sym("p", 8)
                residual = z - p[:5] - p[7] * ca.vertcat(*slopes([z[i] for i in range(5)], [p[5], p[6]]))
                roll_out.solver = ca.rootfinder("euler", "newton", {"x": z, "p": p, "g": residual})
            state = [float(v) for v in roll_out.solver(state, [*state, *control, h]).full().ravel()]
        states.append(state)
    return states


def solve(instance):
    weights, initial = instance["weights"], instance["initial"]
    guess = roll_out(initial, instance["guess_controls"])
    program = Program()
    state, before = list(initial), instance["previous"]
    bounds_low = [-0.15, -math.pi, -0.8, instance["x_range_m"][0], instance["y_range_m"][0]]
    bounds_high = [0.15, math.pi, 0.8, instance["x_range_m"][1], instance["y_range_m"][1]]
    controls, nodes, slacks = [], [], []
    for k in range(INTERVALS):
        control = [
            program.variable(f"u{k}_{j}", instance["guess_controls"][k][j], LOWER_CONTROL[j], UPPER_CONTROL[j])
            for j in range(2)
        ]
        controls.append(control)
        stages = [[program.variable(f"z{k}_{i}_{c}", guess[k + 1][c]) for c in range(5)] for i in range(3)]
        rates = [slopes(stage, control) for stage in stages]
        for i in range(3):
            for c in range(5):
                change = sum(MATRIX[i][j] * rates[j][c] for j in range(3))
                program.constrain(stages[i][c] - state[c] - STEP * change, 0.0, 0.0)
        node = [program.variable(f"s{k + 1}_{c}", guess[k + 1][c]) for c in range(5)]
        for c in range(5):
            program.constrain(node[c] - stages[2][c], 0.0, 0.0)
        nodes.append(node)
        row = weights["terminal"] if k + 1 == INTERVALS else weights["node"]
        for c in range(5):
            program.objective += row[c] * (node[c] - instance["references"][k][c]) ** 2
            program.soften(node[c] - bounds_high[c], guess[k + 1][c] - bounds_high[c], weights)
            program.soften(bounds_low[c] - node[c], bounds_low[c] - guess[k + 1][c], weights)
        for ellipse in instance["ellipses"]:
            def excess(x, y):
                dx, dy = (x - ellipse["x_m"]) / ellipse["a_m"], (y - ellipse["y_m"]) / ellipse["b_m"]
                return 1 - dx**2 - dy**2
            slacks.append(program.soften(excess(node[3], node[4]), excess(guess[k + 1][3], guess[k + 1][4]), weights))
        for j in range(2):
            program.objective += weights["control"][j] * (control[j] - instance["control_reference"][j]) ** 2
            if before is not None:
                program.objective += weights["change"][j] * (control[j] - before[j]) ** 2
        before, state = control, node

    nlp = {"x": ca.vertcat(*program.variables), "f": program.objective, "g": ca.vertcat(*program.constraints)}
    options = {
        "print_time": False,
        "ipopt": {
            "print_level": 0, "sb": "yes", "tol": 1e-11, "compl_inf_tol": 1e-11, "dual_inf_tol": 1e-9,
            "constr_viol_tol": 1e-11, "bound_relax_factor": 0.0, "mu_target": 0.0, "max_iter": 2000,
            "acceptable_iter": 0, "mu_init": 1e-3,
        },
    }
    solver = ca.nlpsol("solver", "ipopt", nlp, options)
    result = solver(x0=program.start, lbx=program.low, ubx=program.high, lbg=program.least, ubg=program.most)
    status = solver.stats()["return_status"]
    value = ca.Function("read", [nlp["x"]], [
        ca.vertcat(*[u for control in controls for u in control]),
        ca.vertcat(*[s for node in nodes for s in node]),
        ca.vertcat(*slacks) if slacks else ca.SX(0),
    ])
    flat_controls, flat_states, flat_slacks = [v.full().ravel().tolist() for v in value(result["x"])]
    return {
        "status": status,
        "iterations": int(solver.stats()["iter_count"]),
        "objective": float(result["f"]),
        "controls": [flat_controls[2 * k:2 * k + 2] for k in range(INTERVALS)],
        "states": [flat_states[5 * k:5 * k + 5] for k in range(INTERVALS)],
        "slack": max(flat_slacks),
    }


BENCH = {
    "node": [0.1, 0.2, 0.1, 1.0, 1.0], "terminal": [0.1, 0.2, 0.1, 5.0, 5.0], "control": [0.5, 5.0],
    "change": [0.0, 0.0], "slack_linear": 100.0, "slack_quadratic": 100.0,
}
LOOP = {
    "node": [0.0, 0.5 * STEP, 0.0, STEP, 2.0 * STEP], "terminal": [0.0, 0.5 * STEP, 0.0, 5.0, 5.0],
    "control": [0.0, 10.0 * STEP], "change": [0.5, 50.0], "slack_linear": 500.0, "slack_quadratic": 500.0,
}
STRAIGHT = [[0.9, 0.0]] * INTERVALS
LEFT = [[0.9, 0.05]] * 2 + [[0.9, -0.02]] * 4
RIGHT = [[0.9, -0.05]] * 2 + [[0.9, 0.02]] * 4


def instance(name, initial, goal, weights, guess, ellipses=(), previous=None, y_range=(-1.5, 1.5)):
    """Initial state (sideslip, yaw, yaw rate, x, y); the reference is clipped to what the horizon can reach."""
    return {
        "name": name,
        "initial": list(initial),
        "previous": previous,
        "references": [[0.0, 0.0, 0.0, min(goal, initial[3] + STEP * (k + 1)), 0.0] for k in range(INTERVALS)],
        "control_reference": [0.9, 0.0],
        "weights": weights,
        "x_range_m": [0.0, 22.0],
        "y_range_m": list(y_range),
        "ellipses": [dict(zip(("x_m", "y_m", "a_m", "b_m"), ellipse)) for ellipse in ellipses],
        "guess_controls": guess,
    }


BOX = (5.0, 0.1, 1.2, 0.8)
INSTANCES = [
    instance("free road", (0, 0, 0, 0.5, 0), 10, BENCH, STRAIGHT),
    instance("free road, off the line", (0, 0, 0, 2, 0.6), 12, BENCH, STRAIGHT),
    instance("free road, turned away", (0.003, 0.3, 0.2, 2, 0.3), 12, LOOP, STRAIGHT, previous=[0.8, 0.02]),
    instance("goal within the horizon", (0, 0, 0, 8.5, 0.1), 10, BENCH, STRAIGHT),
    instance("goal close", (0, 0.1, 0, 9.4, 0.05), 10, LOOP, [[0.3, 0.0]] * 6, previous=[0.6, 0.0]),
    instance("goal passed", (0, 0, 0, 10.1, 0.0), 10, LOOP, [[0.2, 0.0]] * 6, previous=[0.5, 0.0]),
    instance("obstacle enters, right", (0, 0, 0, 1.6, 0), 10, BENCH, RIGHT, [BOX]),
    instance("obstacle ahead, right", (0, 0, 0, 2.2, -0.05), 10, BENCH, RIGHT, [BOX]),
    instance("obstacle ahead, left", (0, 0, 0, 2.0, 0.3), 10, BENCH, LEFT, [BOX]),
    instance("obstacle ahead, loop weights", (0, 0, 0, 2.0, -0.1), 10, LOOP, RIGHT, [BOX], [0.9, 0.0]),
    instance("obstacle beside, right", (0.002, -0.1, -0.1, 4.2, -0.75), 10, BENCH, RIGHT, [BOX]),
    instance("obstacle beside, left", (-0.002, 0.1, 0.1, 4.4, 0.95), 10, LOOP, STRAIGHT, [BOX], [0.8, 0.02]),
    instance("obstacle behind", (0, 0.15, -0.2, 6.0, -0.6), 12, LOOP, STRAIGHT, [BOX], [1.0, -0.03]),
    instance("a little inside", (0.0, -0.2, 0.0, 4.0, -0.40), 10, BENCH, RIGHT, [BOX]),
    instance("two obstacles, slalom", (0, 0, 0, 2.0, -0.3), 14, BENCH, RIGHT, [BOX, (6.6, -0.9, 1.2, 0.6)]),
    instance("two obstacles, between", (0, 0, 0, 1.8, 0.0), 12, LOOP, STRAIGHT, [(4.2, 0.95, 1.2, 0.7),
             (4.2, -0.95, 1.2, 0.7)], [0.9, 0.0]),
    instance("wall, along it", (0, 0.05, 0, 3, 1.05), 12, BENCH, STRAIGHT, y_range=(-1.1, 1.1)),
    instance("wall, beyond it", (0, 0.1, 0, 3, 1.15), 12, LOOP, STRAIGHT, previous=[0.8, 0.0], y_range=(-1.1, 1.1)),
    instance("wall and obstacle", (0, -0.15, 0, 2.4, -0.4), 12, LOOP, RIGHT, [(5.0, 0.0, 1.2, 0.9)], [0.9, -0.02],
             (-1.1, 1.1)),
    instance("start of the track", (0, 0, 0, -0.02, 0.02), 10, LOOP, [[0.5, 0.0]] * 6, previous=[0.1, 0.0]),
    instance("slow with full lock", (0.0, 0.1, 0.03, 2.5, 0.2), 12, LOOP, LEFT, [(4.8, -0.3, 1.2, 0.8)], [0.2, 0.06]),
    instance("two ellipses overlap", (0, 0, 0, 2.1, -0.2), 12, BENCH, RIGHT, [(4.9, 0.15, 1.2, 0.8), (5.4, 0.25, 1.2,
             0.8)]),
]


def main():
    solved = []
    for problem in INSTANCES:
        answer = solve(problem)
        print(f"{problem['name']:32} {answer['status']:24} {answer['iterations']:4} "
              f"J {answer['objective']:12.6f} slack {answer['slack']:.4f}", file=sys.stderr)
        if answer["status"] != "Solve_Succeeded":
            sys.exit(f"{problem['name']}: {answer['status']}")
        solved.append({**problem, "solution": answer})
    document = {"solver": f"CasADi {ca.__version__}, IPOPT", "interval_s": STEP, "instances": solved}
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
