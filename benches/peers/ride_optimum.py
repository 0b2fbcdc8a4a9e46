#!/usr/bin/env python3
"""Solves the problems of `scanloop bench ride --problems DIR` with CasADi and IPOPT and compares the objectives.

    scanloop bench ride --problems out/ride
    benches/peers/.venv/bin/python benches/peers/ride_optimum.py out/ride/*.json

`benches/peers/setup.sh` makes that environment. Equations and tableau come from `casadi_reference.py`. All limits are hard
here: an accepted optimum has no slack. IPOPT starts beside the solution to be checked, with its positions, straight yaw and
no steering, so that it passes on the same sides. Exit code 1 if an objective differs by more than 1e-4, or if IPOPT finds no
solution.
"""

import json
import math
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
os.environ["SCANLOOP_IN_VENV"] = "1"
sys.path.insert(0, str(HERE))
try:
    import casadi as ca
except ImportError:
    sys.exit("CasADi is missing: run benches/peers/setup.sh, then use benches/peers/.venv/bin/python")
from casadi_reference import MATRIX, Program, slopes  # noqa: E402

LARGEST_DIFFERENCE = 1e-4
# Objectives below this are rounding errors of an empty track.
SMALLEST = 1e-6
OPTIONS = {
    "print_time": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 1000},
}


def solve(plan):
    """The least objective of a plan, and the message of IPOPT."""
    lengths, count = plan["intervals_s"], len(plan["intervals_s"])
    weights, ellipses = plan["weights"], plan["ellipses"]
    program = Program()
    state = [ca.DM(value) for value in plan["initial"]]
    bounds = [plan["sideslip_max_rad"], plan["yaw_max_rad"], plan["yaw_rate_max_radps"]]
    lower = [-bound for bound in bounds] + [plan["x_m"][0], plan["y_m"][0]]
    upper = bounds + [plan["x_m"][1], plan["y_m"][1]]
    before, objective = plan["previous"], 0
    for index, length in enumerate(lengths):
        control = [
            program.variable("velocity", 1.0, *plan["velocity_mps"]),
            program.variable("steering", 0.0, -plan["steering_max_rad"], plan["steering_max_rad"]),
        ]
        for component in range(2):
            about = control[component] - plan["control_reference"][component]
            objective += weights["control"][component] * about**2
            if before is not None:
                objective += weights["change"][component] * (control[component] - before[component]) ** 2
        before = control
        guess = [0.0, 0.0, 0.0, *plan["states"][index + 1][3:]]
        state = interval(program, state, control, length, guess, lower, upper)
        node = weights["terminal"] if index + 1 == count else weights["node"]
        for component in range(5):
            objective += node[component] * (state[component] - plan["references"][index][component]) ** 2
        for ellipse in ellipses:
            x, y = ellipse["centres_m"][index + 1]
            value = ((state[3] - x) / ellipse["a_m"]) ** 2 + ((state[4] - y) / ellipse["b_m"]) ** 2
            program.constrain(value - 1, 0, math.inf)
    return minimise(program, objective)[:2]


def interval(program, start, control, length, guess, lower, upper, slopes=slopes):
    """The state at the end of an interval: Radau collocation with three stages, the last of which is the end."""
    inner = [[program.variable("stage", value) for value in guess] for _ in range(2)]
    end = [program.variable("node", *limits) for limits in zip(guess, lower, upper)]
    stages = [*inner, end]
    rates = [slopes(stage, control) for stage in stages]
    for row, stage in zip(MATRIX, stages):
        for component in range(len(start)):
            change = sum(factor * rate[component] for factor, rate in zip(row, rates))
            program.constrain(start[component] + length * change - stage[component], 0, 0)
    return end


def minimise(program, objective):
    """The least objective of a program, the message of IPOPT, and the values of the variables."""
    nlp = {"x": ca.vertcat(*program.variables), "f": objective, "g": ca.vertcat(*program.constraints)}
    solver = ca.nlpsol("solver", "ipopt", nlp, OPTIONS)
    solution = solver(x0=program.start, lbx=program.low, ubx=program.high, lbg=program.least, ubg=program.most)
    return float(solution["f"]), solver.stats()["return_status"], solution["x"]


def main(files):
    if not files:
        sys.exit("usage: ride_optimum.py FILE.json...; `scanloop bench ride --problems DIR` writes the files")
    largest, failed = 0.0, 0
    for file in files:
        for number, plan in enumerate(json.loads(Path(file).read_text())["plans"]):
            objective, message = solve(plan)
            difference = abs(plan["objective"] - objective) / max(abs(objective), SMALLEST)
            if max(objective, plan["objective"]) < SMALLEST:
                difference = 0.0
            failed += message != "Solve_Succeeded"
            largest = max(largest, difference)
            name = f"{Path(file).stem} {number}"
            print(f"{name:<20} N {len(plan['intervals_s']):>3}  {plan['objective']:.7f}  {objective:.7f}  {difference:.1e}  {message}")
    print(f"largest relative difference {largest:.1e}, {failed} not solved")
    return 1 if failed or largest > LARGEST_DIFFERENCE else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
