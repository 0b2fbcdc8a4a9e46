#!/usr/bin/env python3
"""Measures the errors that the margin is for, over drives whose truth is known.

    cargo build --release && benches/peers/setup.sh
    benches/peers/.venv/bin/python benches/peers/margins.py target/release/scanloop

Drives of three seeds with each preset in lock-step, in the table of docs/ride.md. Each error is the distance by which the
body can be nearer to an obstacle than was planned:

* latency: what the prediction of the pose adds to its error until the command acts, along and across the body;
* model: how far the robot is across from the plan after one period and 0.4 s, with the error at its start taken out;
* perception: the distance to the nearest described box, from the estimated pose, minus the true one; below 0.6 m.
"""

import bisect
import math
import sys
import tempfile
from pathlib import Path

from course_drive import mixed, rows, turned
from ride_split import PRESETS, recorded

AT_REST = ["corridor", "two-obstacles", "slalom", "walls", "imperfect-robot", "stations"]
MOVING = ["crossing"]
SEEDS = [11, 12, 13]
MODEL_S = 0.4
NEAR_M, MOVES_MPS = 0.6, 0.1
QUANTILES = [0.5, 0.95, 0.99, 0.999, 1.0]


def between(before, after, length_s, share):
    """Position and direction between two states (x, y, yaw, speed, sideslip), by a cubic whose slopes are their velocities."""
    cubic = [2 * share**3 - 3 * share**2 + 1, share**3 - 2 * share**2 + share, -2 * share**3 + 3 * share**2, share**3 - share**2]
    slopes = [turned([state[3], 0.0], state[2] + state[4]) for state in (before, after)]
    place = [cubic[0] * before[axis] + cubic[2] * after[axis]
             + length_s * (cubic[1] * slopes[0][axis] + cubic[3] * slopes[1][axis]) for axis in range(2)]
    return [*place, mixed(before[2], after[2], share)]


class Truth:
    """Where the robot was at any time."""

    def __init__(self, table):
        self.times = [row["header.acquired_ns"] for row in table]
        self.states = [[row[key] for key in ("x_m", "y_m", "yaw_rad", "speed_mps", "sideslip_rad")] for row in table]

    def at(self, time_ns):
        index = bisect.bisect_right(self.times, time_ns) - 1
        if not 0 <= index < len(self.times) - 1:
            return None
        length_ns = self.times[index + 1] - self.times[index]
        return between(*self.states[index:index + 2], length_ns * 1e-9, (time_ns - self.times[index]) / length_ns)


def off(truth, place):
    """How far a place is from the true one, along and across the robot."""
    return turned([place[0] - truth[0], place[1] - truth[1]], -truth[2])


def latency(truth, poses):
    for row in poses:
        taken, acts = truth.at(row["header.acquired_ns"]), truth.at(row["predicted_ns"])
        if taken and acts and row["predicted_speed_mps"] > MOVES_MPS:
            before, after = off(taken, [row["x_m"], row["y_m"]]), off(acts, [row["predicted_x_m"], row["predicted_y_m"]])
            yield math.dist(before, after)


def model(truth, commands):
    for row in commands:
        nodes = [[row[f"plan.{node}.{key}"] for key in ("x_m", "y_m", "yaw_rad", "velocity_mps", "sideslip_rad")]
                 for node in range(2)]
        length_s, begin_ns = row["plan_interval_s"], row["plan_start_ns"]
        begin, end = truth.at(begin_ns), truth.at(begin_ns + MODEL_S * 1e9)
        # Where it is to land or to stop, the wheels are blocked before the plan ends.
        if row["kind"] != 1 or not begin or not end or length_s < MODEL_S or nodes[1][3] < MOVES_MPS:
            continue
        planned = between(*nodes, length_s, MODEL_S / length_s)
        way = turned([planned[axis] - nodes[0][axis] for axis in range(2)], begin[2] - nodes[0][2])
        yield abs(off(end, [begin[axis] + way[axis] for axis in range(2)])[1])


def corners(x, y, yaw, length, width):
    half = [[length / 2, width / 2], [-length / 2, width / 2], [-length / 2, -width / 2], [length / 2, -width / 2]]
    return [[x + way[0], y + way[1]] for way in (turned(corner, yaw) for corner in half)]


def apart(one, other):
    """The distance of two rectangles that do not overlap."""
    def to_side(point, begin, end):
        side = [end[axis] - begin[axis] for axis in range(2)]
        along = sum((point[axis] - begin[axis]) * side[axis] for axis in range(2)) / (sum(way**2 for way in side) or 1.0)
        return math.dist(point, [begin[axis] + min(max(along, 0.0), 1.0) * side[axis] for axis in range(2)])
    return min(to_side(point, to[index - 1], to[index]) for of, to in ((one, other), (other, one)) for point in of
               for index in range(4))


def perception(truths, poses, described, body):
    truths, poses = [{row["header.scan_id"]: row for row in table} for table in (truths, poses)]
    for row in described:
        truth, pose = [table.get(row["header.scan_id"]) for table in (truths, poses)]
        if not truth or not pose or truth["speed_mps"] < MOVES_MPS or truth["clearance_m"] > NEAR_M:
            continue
        own = corners(pose["x_m"], pose["y_m"], pose["yaw_rad"], *body)
        keys = ("box_x_m", "box_y_m", "box_yaw_rad", "box_length_m", "box_width_m")
        boxes = [corners(*(row[f"items.{index}.{key}"] for key in keys)) for index in range(int(row["count"]))]
        if boxes:
            yield min(apart(own, box) for box in boxes) - truth["clearance_m"]


def measured(program, scenario, preset, seed):
    """Errors of one drive by their part."""
    with tempfile.TemporaryDirectory() as folder:
        tables = recorded(program, scenario, preset, [f"seed={seed}"], Path(folder)) / "csv"
        truths, poses, commands, described = [rows(tables, topic) for topic in ("truth", "pose", "command", "obstacles")]
    truth = Truth(truths)
    # The body of the robot of all shipped scenarios.
    return {"latency": latency(truth, poses), "model": model(truth, commands),
            "perception": perception(truths, poses, described, (0.56, 0.40))}


def main():
    found = {}
    for preset in PRESETS + ["worn"]:
        for scenario, seed in ((scenario, seed) for scenario in AT_REST + MOVING for seed in SEEDS):
            for part, errors in measured(sys.argv[1], scenario, preset, seed).items():
                key = (part, "moves" if part == "perception" and scenario in MOVING else "")
                found.setdefault(key, []).extend(errors)
    print("| part | errors | " + " | ".join(f"{quantile:.1%}" for quantile in QUANTILES) + " |")
    print("|---|---:|" + "---:|" * len(QUANTILES))
    for (part, moves), errors in sorted(found.items()):
        errors.sort()
        cells = (f"{100 * errors[min(len(errors) - 1, int(quantile * len(errors)))]:.2f}" for quantile in QUANTILES)
        print(f"| {part}{', the body moves' if moves else ''} [cm] | {len(errors)} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
