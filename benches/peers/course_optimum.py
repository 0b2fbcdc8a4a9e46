#!/usr/bin/env python3
"""Computes the drive with the least J along a course with CasADi and IPOPT, and the regret of finished drives.

    scanloop run s-curve --lockstep --record --out out/s-curve
    scanloop recording export out/s-curve/recording.mcap --csv out/s-curve/csv
    benches/peers/.venv/bin/python benches/peers/course_optimum.py out/s-curve

J is described in `course_drive.py`. The model is that of `casadi_reference.py`, in the plane. A node is on the course by the
closed form of one line or arc, which is exact. Which one it is comes from the solution before; the problem is solved again
until that stays. At each node, every point of the robot's outline is at least as far from each obstacle as in the drive at
its smallest clearance. Of a drive along a line only J is computed, and compared with `report.json`; `ride_split.py` has its
optimum. Exit code 1 if a regret is below 0.99, a J is another one than in the report, or IPOPT finds no solution; 2
if a folder has no such drive.
"""

import math
import sys
from pathlib import Path

from ride_optimum import ca, interval, minimise
from casadi_reference import Program, slopes
from course_drive import INTERVAL_S, Drive, mixed, objective

# Nodes of the guess that are farther from an obstacle than this are not kept away from it [m].
REACH_M = 2.0
# The last interval, in intervals: the ranges of two numbers of intervals overlap.
LAST = [0.4, 1.6]
# Largest number of solves.
ROUNDS = 6
LEAST_REGRET, LARGEST_DIFFERENCE = 0.99, 1e-6


def resampled(rows, count):
    """So many rows, at equal shares of the way through `rows`."""
    places = [index * (len(rows) - 1) / max(count - 1, 1) for index in range(count)]
    pairs = [(rows[int(place)], rows[min(int(place) + 1, len(rows) - 1)], place % 1) for place in places]
    return [[mixed(*pair, share) for pair in zip(before, after)] for before, after, share in pairs]


class Setting:
    """What an optimum has: the lags of the drive or none, its smallest clearance, and bodies from their first sight on or
    from the start."""

    def __init__(self, lags, clearance, late=False):
        self.lags, self.clearance, self.late = lags, clearance, late


def lagging(robot):
    """The model with speed and steering angle that follow the commands as those of the robot do."""
    def slopes_of(state, command):
        _, yaw, _, _, _, speed, steering = state
        sideslip_rate, _, yaw_acceleration, _, _ = slopes(state[:5], [ca.fmax(speed, 0.05), steering])
        way = state[0] + yaw
        limits = (-robot["deceleration_max_mps2"], robot["acceleration_max_mps2"])
        turn = robot["steering_rate_max_radps"]
        return [
            sideslip_rate, state[2], yaw_acceleration, speed * ca.cos(way), speed * ca.sin(way),
            clipped((command[0] - speed) / robot["velocity_lag_s"], *limits),
            clipped((command[1] - steering) / robot["steering_lag_s"], -turn, turn),
        ]
    return slopes_of


def clipped(value, low, high):
    return ca.fmin(ca.fmax(value, low), high)


def solve(drive, setting, states, controls, is_even, known, fixed=0):
    """The solution from a guess: objective, message, states, controls, lengths. Either all intervals have one length, which
    is free, or those of docs/ride.md and the last one is free. The first `fixed` controls are those of the guess."""
    program, bounds, count, robot = Program(), drive.bounds, len(controls), drive.scenario["robot"]
    free = program.variable("length", INTERVAL_S, LAST[0] * INTERVAL_S, INTERVAL_S * (2 if is_even else LAST[1]))
    lengths = [free] * count if is_even else [INTERVAL_S] * (count - 1) + [free]
    upper = [bounds["sideslip_max_rad"], math.inf, bounds["yaw_rate_max_radps"], math.inf, math.inf]
    upper += [math.inf] * (len(states[0]) - 5)
    width = drive.scenario.get("course", {}).get("width_m", 3.0)
    low = [bounds["velocity_min_mps"], -bounds["steering_max_rad"]]
    high = [bounds["velocity_max_mps"], bounds["steering_max_rad"]]
    model = lagging(robot) if setting.lags else slopes
    nodes, found, chosen, times, near = [[ca.DM(value) for value in states[0]]], [drive.on_course[0]], [], [0.0], 0.0
    for index, (control, length) in enumerate(zip(controls, lengths)):
        guess, moment_s = states[index + 1], drive.times[0] + INTERVAL_S * (index + 1)
        if index < fixed:
            chosen.append([ca.DM(value) for value in control])
        else:
            chosen.append([program.variable("u", *values) for values in zip(control, low, high)])
        node = interval(program, nodes[-1], chosen[-1], length, guess, [-value for value in upper], upper, model)
        piece, place = drive.course.find(guess, near)
        near = place[3]
        nodes.append(node)
        found.append(piece.on_course(node))
        times.append(times[-1] + length)
        # Each way from a waypoint to the next has two pieces.
        half_width = (width[drive.course.pieces.index(piece) // 2] if isinstance(width, list) else width) / 2
        program.constrain(found[-1][4], -half_width, half_width)
        program.constrain(found[-1][1], -bounds["yaw_max_rad"], bounds["yaw_max_rad"])
        for body in known:
            if index >= fixed and math.dist(guess[3:5], body.centre(moment_s)) < REACH_M + body.reach:
                keep = (program, robot, node, drive.times[0] + times[-1], guess, moment_s, setting.clearance)
                body.keep(*keep)
    program.constrain(found[-1][3], drive.end_m, drive.end_m)
    least, message, values = minimise(program, objective(times, found, chosen, lengths))
    parts = [ca.vertcat(*(ca.horzcat(*row) for row in rows)) for rows in (nodes[1:], chosen, [[free]])]
    solved = ca.Function("parts", [ca.vertcat(*program.variables)], parts)(values)
    ends, chosen, free = [part.full().tolist() for part in solved]
    lengths = [free[0][0]] * count if is_even else [INTERVAL_S] * (count - 1) + free[0]
    return least, message, [states[0], *ends], chosen, lengths


def placed(drive, states):
    """The pieces that nodes are on, and the nodes on the course."""
    pieces, found, near = [], [drive.on_course[0]], 0.0
    for state in states[1:]:
        piece, place = drive.course.find(state, near)
        pieces.append(piece)
        found.append(place)
        near = place[3]
    return pieces, found


def optimum(drive, setting, states=None, controls=None):
    """The drive with the least J from a guess, without one from the drive: its J, message of IPOPT, states, controls and
    lengths of the intervals."""
    is_drive = states is None
    if is_drive:
        states, controls = drive.states, [control for _, control in drive.commands]
    count = round((drive.times[-1] - drive.times[0]) / INTERVAL_S) if is_drive else len(controls)
    states, controls = resampled(states, count + 1), resampled(controls, count)
    if setting.lags:
        states = [[*states[0][:5], drive.speed, drive.steering]] + [
            [*state[:5], *control] for state, control in zip(states[1:], controls)]
    else:
        states = [state[:5] for state in states]
    known = [body for body in drive.bodies if not setting.late or drive.sights[body] <= drive.times[0]]
    if is_drive:
        _, _, states, controls, lengths = solve(drive, setting, states, controls, True, known)
        count = round(sum(lengths) / INTERVAL_S)
    fixed = 0
    while True:
        solution = fitted(drive, setting, states, controls, count, known, fixed)
        later = [drive.sights[body] for body in drive.bodies if body not in known]
        if not later or solution[1] != "Solve_Succeeded":
            return solution
        # The next first sight: what was driven until then stays.
        seen_s = min(later)
        known = [body for body in drive.bodies if drive.sights[body] <= seen_s]
        fixed = math.ceil((seen_s - drive.times[0]) / INTERVAL_S - 1e-9)
        _, _, states, controls, _ = solution
        count = len(controls)
        # Where a body is in the way, the drive knew a way round.
        ahead = resampled(drive.states, len(states))
        states = states[:fixed + 1] + [[*way[:5], *state[5:]] for way, state in zip(ahead, states)][fixed + 1:]


def fitted(drive, setting, states, controls, count, known, fixed):
    """The solution with intervals of docs/ride.md, with as many as it takes."""
    for _ in range(ROUNDS):
        if len(controls) != count:
            states = states[:fixed] + resampled(states[fixed:], count - fixed + 1)
            controls = controls[:fixed] + resampled(controls[fixed:], count - fixed)
        before, _ = placed(drive, states)
        _, message, states, controls, lengths = solve(drive, setting, states, controls, False, known, fixed)
        pieces, found = placed(drive, states)
        longer = (lengths[-1] > (LAST[1] - 1e-3) * INTERVAL_S) - (lengths[-1] < (LAST[0] + 1e-3) * INTERVAL_S)
        count += longer
        if longer == 0 and (pieces == before or drive.is_line):
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
        except (OSError, KeyError, ValueError) as error:
            print(f"{folder}: {error}", file=sys.stderr)
            return 2
        name, spent = folder.name, drive.times[-1] - drive.times[0]
        if drive.is_line:
            difference = abs(drive.objective / drive.report["ride"]["objective"] - 1)
            failed += difference > LARGEST_DIFFERENCE
            print(f"{name:<22} {drive.objective:9.4f}  differs from the report by {difference:.1e}")
            continue
        least, message, _, _, lengths = optimum(drive, Setting(False, drive.clearance))
        regret = drive.objective / least
        failed += message != "Solve_Succeeded" or regret < LEAST_REGRET
        print(f"{name:<22} {drive.objective:9.4f} {least:9.4f} {regret:7.4f} {spent:6.2f} {sum(lengths):6.2f}  "
              f"{drive.clearance:.3f}  {message}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
