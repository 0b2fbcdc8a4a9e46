#!/usr/bin/env python3
"""Computes the drive with the least J along a course with CasADi and IPOPT, and the regret of finished drives.

    scanloop run s-curve --lockstep --record --out out/s-curve
    scanloop recording export out/s-curve/recording.mcap --csv out/s-curve/csv
    benches/peers/.venv/bin/python benches/peers/course_optimum.py out/s-curve

J is described in `course_drive.py`. The model is that of `casadi_reference.py`, in the plane. A node is on the course by the
closed form of one line or arc, which is exact. Which one it is comes from the solution before; the problem is solved again
until that stays. At each node, every point of the robot's outline is at least as far from each obstacle as in the drive at
its smallest clearance. Obstacles are circles at rest. Of a drive along a line only J is computed, and compared with
`report.json`. Exit code 1 if a regret is below 0.99, a J is another one than in the report, or IPOPT finds no solution; 2
if a folder has no such drive.
"""

import math
import sys
from pathlib import Path

from ride_optimum import ca, interval, minimise
from casadi_reference import Program
from course_drive import INTERVAL_S, Drive, mixed, objective

# Nodes of the guess that are farther from an obstacle than this are not kept away from it [m].
REACH_M = 2.0
# Largest number of solves.
ROUNDS = 6
LEAST_REGRET, LARGEST_DIFFERENCE = 0.99, 1e-6


def resampled(rows, count):
    """So many rows, at equal shares of the way through `rows`."""
    places = [index * (len(rows) - 1) / max(count - 1, 1) for index in range(count)]
    pairs = [(rows[int(place)], rows[min(int(place) + 1, len(rows) - 1)], place % 1) for place in places]
    return [[mixed(*pair, share) for pair in zip(before, after)] for before, after, share in pairs]


def bodies(scenario):
    """Centre and radius of each obstacle."""
    for obstacle in scenario.get("obstacle", []):
        moves = obstacle["velocity_x_mps"] or obstacle["velocity_y_mps"] or obstacle["appears_s"]
        if obstacle["shape"] != "circle" or moves:
            raise ValueError(f"an obstacle at ({obstacle['x_m']}, {obstacle['y_m']}) is no circle at rest")
    return [(obstacle["x_m"], obstacle["y_m"], obstacle["radius_m"]) for obstacle in scenario.get("obstacle", [])]


def beside(robot, state, body):
    """Square of the distance from the outline of the robot to the centre of a body."""
    cosine, sine = ca.cos(state[1]), ca.sin(state[1])
    x, y = body[0] - state[3], body[1] - state[4]
    ahead = ca.fmax(ca.fabs(cosine * x + sine * y) - robot["length_m"] / 2, 0)
    left = ca.fmax(ca.fabs(cosine * y - sine * x) - robot["width_m"] / 2, 0)
    return ahead**2 + left**2


def solve(drive, states, controls, is_even):
    """The solution from a guess: objective, message, states, controls, lengths. Either all intervals have one length, which
    is free, or those of docs/ride.md and the last one is free."""
    program, bounds, count = Program(), drive.bounds, len(controls)
    free = program.variable("length", INTERVAL_S, INTERVAL_S / 2, INTERVAL_S * (2 if is_even else 1.5))
    lengths = [free] * count if is_even else [INTERVAL_S] * (count - 1) + [free]
    upper = [bounds["sideslip_max_rad"], math.inf, bounds["yaw_rate_max_radps"], math.inf, math.inf]
    width = drive.scenario.get("course", {}).get("width_m", 3.0)
    low = [bounds["velocity_min_mps"], -bounds["steering_max_rad"]]
    high = [bounds["velocity_max_mps"], bounds["steering_max_rad"]]
    nodes, found, chosen, times, near = [[ca.DM(value) for value in states[0]]], [drive.on_course[0]], [], [0.0], 0.0
    for index, (control, length) in enumerate(zip(controls, lengths)):
        guess = states[index + 1]
        chosen.append([program.variable("u", *values) for values in zip(control, low, high)])
        node = interval(program, nodes[-1], chosen[-1], length, guess, [-value for value in upper], upper)
        piece, place = drive.course.find(guess, near)
        near = place[3]
        nodes.append(node)
        found.append(piece.on_course(node))
        times.append(times[-1] + length)
        # Each way from a waypoint to the next has two pieces.
        half_width = (width[drive.course.pieces.index(piece) // 2] if isinstance(width, list) else width) / 2
        program.constrain(found[-1][4], -half_width, half_width)
        program.constrain(found[-1][1], -bounds["yaw_max_rad"], bounds["yaw_max_rad"])
        for body in bodies(drive.scenario):
            if math.dist(guess[3:], body[:2]) < REACH_M:
                program.constrain(beside(drive.scenario["robot"], node, body), (drive.clearance + body[2]) ** 2, math.inf)
    program.constrain(found[-1][3], drive.end_m, drive.end_m)
    _, message, values = minimise(program, objective(times, found, chosen, lengths))
    parts = [ca.vertcat(*(ca.horzcat(*row) for row in rows)) for rows in (nodes[1:], chosen, [[free]])]
    solved = ca.Function("parts", [ca.vertcat(*program.variables)], parts)(values)
    ends, chosen, free = [part.full().tolist() for part in solved]
    lengths = [free[0][0]] * count if is_even else [INTERVAL_S] * (count - 1) + free[0]
    return message, [states[0], *ends], chosen, lengths


def placed(drive, states):
    """The pieces that nodes are on, and the nodes on the course."""
    pieces, found, near = [], [drive.on_course[0]], 0.0
    for state in states[1:]:
        piece, place = drive.course.find(state, near)
        pieces.append(piece)
        found.append(place)
        near = place[3]
    return pieces, found


def optimum(drive):
    """The drive with the least J: its J, message of IPOPT, states, controls and lengths of the intervals."""
    count = round((drive.times[-1] - drive.times[0]) / INTERVAL_S)
    states = resampled(drive.states, count + 1)
    controls = resampled([control for _, control in drive.commands], count)
    message, states, controls, lengths = solve(drive, states, controls, True)
    count = round(sum(lengths) / INTERVAL_S)
    for _ in range(ROUNDS):
        states, controls = resampled(states, count + 1), resampled(controls, count)
        before, _ = placed(drive, states)
        message, states, controls, lengths = solve(drive, states, controls, False)
        pieces, found = placed(drive, states)
        longer = (lengths[-1] > 1.499 * INTERVAL_S) - (lengths[-1] < 0.501 * INTERVAL_S)
        count += longer
        if longer == 0 and pieces == before:
            break
    else:
        message = "no duration found"
    times = [sum(lengths[:index]) for index in range(len(states))]
    return float(objective(times, found, controls, lengths)), message, states, controls, lengths


def main(folders):
    if not folders:
        sys.exit("usage: course_optimum.py FOLDER...; see the first lines of the script")
    failed = 0
    print(f"{'drive':<22} {'J drive':>9} {'least J':>9} {'regret':>7} {'time':>6} {'least':>6}  clearance")
    for folder in map(Path, folders):
        try:
            drive = Drive(folder)
            bodies(drive.scenario) if not drive.is_line else None
        except (OSError, KeyError, ValueError) as error:
            print(f"{folder}: {error}", file=sys.stderr)
            return 2
        name, spent = folder.name, drive.times[-1] - drive.times[0]
        if drive.is_line:
            difference = abs(drive.objective / drive.report["ride"]["objective"] - 1)
            failed += difference > LARGEST_DIFFERENCE
            print(f"{name:<22} {drive.objective:9.4f}  differs from the report by {difference:.1e}")
            continue
        least, message, _, _, lengths = optimum(drive)
        regret = drive.objective / least
        failed += message != "Solve_Succeeded" or regret < LEAST_REGRET
        print(f"{name:<22} {drive.objective:9.4f} {least:9.4f} {regret:7.4f} {spent:6.2f} {sum(lengths):6.2f}  "
              f"{drive.clearance:.3f}  {message}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
