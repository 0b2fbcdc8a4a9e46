"""A finished drive along a course, with its J, for `course_optimum.py`.

J is that of docs/ride.md in the coordinates of the course: x is the length along it, y the offset to the left, yaw the
direction relative to it; sideslip, yaw rate and steering angle are those of the robot. A drive along a line has the same J
as in its report. Limits: a course has one goal and is not closed, and none of its arcs turns by half a turn.
"""

import csv
import json
import math
import struct
import tomllib

from body_distance import Body
from ride_optimum import ca

# The weights of J, as in docs/ride.md.
STATE, TERMINAL = [0.1, 0.5, 0.1, 1.0, 8.0], [0.1, 0.5, 0.1, 5.0, 8.0]
CONTROL, CHANGE = [0.1, 10.0], [0.2, 50.0]
CRUISE, INTERVAL_S, BEFORE_GOAL_M = [1.0, 0.0], 0.1, 1.75
# How far from the length along the course a moment ago a position is looked for [m].
NEAR_M = [2.0, 3.0]


class Piece:
    """A line or an arc: length of the course before it, own length, first point, direction there, curvature to the left."""

    def __init__(self, begin, point, yaw, end):
        way = [end[0] - point[0], end[1] - point[1]]
        ahead, left = turned(way, -yaw)
        chord, half = math.hypot(*way), math.atan2(left, ahead)
        straight = abs(half) < 1e-9 or chord < 1e-9
        self.begin, self.point, self.yaw = begin, point, yaw
        self.curvature = 0.0 if straight else 2 * math.sin(half) / chord
        self.length = chord if straight else chord * half / math.sin(half)

    def on_course(self, state):
        """A state in the plane on the course, as if this piece never ended."""
        sideslip, yaw, yaw_rate, x, y = state[:5]
        ahead, left = turned([x - self.point[0], y - self.point[1]], -self.yaw)
        if self.curvature == 0.0:
            return [sideslip, yaw - self.yaw, yaw_rate, self.begin + ahead, left]
        bend = abs(self.curvature)
        across, to_centre = bend * ahead, 1 - self.curvature * left
        along = ca.atan2(across, to_centre) / bend
        offset = (1 - ca.sqrt(across**2 + to_centre**2)) / self.curvature
        return [sideslip, yaw - self.yaw - self.curvature * along, yaw_rate, self.begin + along, offset]


class Course:
    """Two arcs from each waypoint to the next, by Bolton, as services/vehicle/src/course/biarc.rs describes them."""

    def __init__(self, waypoints):
        points = [[waypoint["x_m"], waypoint["y_m"]] for waypoint in waypoints]
        yaws = directions(points, [waypoint.get("yaw_rad") for waypoint in waypoints])
        self.pieces, begin, yaw = [], 0.0, yaws[0]
        for index in range(len(points) - 1):
            joint = biarc_joint(*points[index:index + 2], *yaws[index:index + 2])
            for ends in ([points[index], joint], [joint, points[index + 1]]):
                piece = Piece(begin, ends[0], yaw, ends[1])
                self.pieces.append(piece)
                begin, yaw = begin + piece.length, yaw + piece.curvature * piece.length
        self.length = begin

    def find(self, state, near):
        """The piece that a state in the plane is beside, and the state on the course."""
        best = None
        for piece in self.pieces:
            last = piece is self.pieces[-1]
            if not last and piece.begin + piece.length < near - NEAR_M[0] or piece.begin > near + NEAR_M[1]:
                continue
            found = [float(value) for value in piece.on_course(state)]
            low = -math.inf if piece is self.pieces[0] else piece.begin
            high = math.inf if last else piece.begin + piece.length
            beyond = max(low - found[3], found[3] - high, 0.0)
            distance = math.hypot(beyond, found[4])
            if best is None or distance < best[0] - 1e-9:
                found[1] = math.remainder(found[1], math.tau)
                best = (distance, piece, found)
        return best[1:]


def turned(way, angle):
    cosine, sine = math.cos(angle), math.sin(angle)
    return [cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1]]


def directions(points, given):
    """Directions at the waypoints: as given, else of the circle through the waypoint and those beside it."""
    ways = [[b[0] - a[0], b[1] - a[1]] for a, b in zip(points, points[1:])]
    yaws = []
    for index, yaw in enumerate(given):
        before, after = ways[max(index, 1) - 1], ways[min(index, len(ways) - 1)]
        lengths = [before[0]**2 + before[1]**2, after[0]**2 + after[1]**2]
        sums = [before[axis] / lengths[0] + after[axis] / lengths[1] for axis in range(2)]
        yaws.append(math.atan2(sums[1], sums[0]) if yaw is None else yaw)
    for end, beside, way in ((0, 1, ways[0]), (-1, -2, ways[-1])):
        if given[end] is None:
            chord = math.atan2(way[1], way[0])
            yaws[end] = chord - math.remainder(yaws[beside] - chord, math.tau)
    return yaws


def biarc_joint(begin, end, first, last):
    """Where the arcs meet that leave `begin` and reach `end` in these directions, equally far from both along them."""
    first, last = [[math.cos(yaw), math.sin(yaw)] for yaw in (first, last)]
    way = [end[0] - begin[0], end[1] - begin[1]]
    ahead = way[0] * (first[0] + last[0]) + way[1] * (first[1] + last[1])
    bend = 2 * (1 - first[0] * last[0] - first[1] * last[1])
    square = way[0]**2 + way[1]**2
    length = square / (ahead + math.sqrt(ahead**2 + bend * square))
    return [(begin[axis] + first[axis] * length + end[axis] - last[axis] * length) / 2 for axis in range(2)]


class Drive:
    """The measured part of a finished drive: times, true states in the plane and on the course, commands."""

    def __init__(self, folder):
        self.report = json.loads((folder / "report.json").read_text())
        run = attachment(folder / "recording.mcap", "run.toml")
        self.scenario, self.bounds = run["scenario"], run["system"]["vehicle"]["bounds"]
        waypoints = self.scenario.get("course", {}).get("waypoints", [])
        goal, start = self.scenario["goal"], self.scenario["start"]
        self.is_line = not waypoints
        if self.is_line:
            begin = {"x_m": 0.0, "y_m": goal["y_m"], "yaw_rad": 0.0}
            waypoints = [begin, {**begin, "x_m": goal["x_m"]}]
        ends = [[point["x_m"], point["y_m"]] for point in (waypoints[0], waypoints[-1])]
        if ends[0] == ends[1] or isinstance(goal, list):
            raise ValueError("the course is closed or has several goals: one that is open, with one goal, is expected")
        self.course = Course(waypoints)
        _, on_course = self.course.find([0, 0, 0, goal["x_m"], goal["y_m"]], self.course.length)
        self.end_m = on_course[3] - BEFORE_GOAL_M
        self.near = self.course.find([0, start["yaw_rad"], 0, start["x_m"], start["y_m"]], 0.0)[1][3]
        self.bodies = [Body(obstacle) for obstacle in self.scenario.get("obstacle", [])]
        self.measure(*samples(folder / "csv"))
        scans = described(folder / "csv")
        self.sights = {body: self.first_sight(body, scans) for body in self.bodies}

    def first_sight(self, body, scans):
        """When the command for the first scan acts in which an ellipse covers the centre of a body."""
        for scan, seen_s, ellipses in scans:
            x, y = body.centre(seen_s)
            if scan in self.acts_s and any(math.hypot((x - e[0]) / e[2], (y - e[1]) / e[3]) < 1 for e in ellipses):
                return self.acts_s[scan]
        return math.inf

    def measure(self, truths, answers):
        moments, issued, last, self.acts_s = [], [], 0, {}
        for row in truths:
            state = [row[key] for key in ("sideslip_rad", "yaw_rad", "yaw_rate_radps", "x_m", "y_m")]
            moments.append((row["time_s"], state, row["speed_mps"], row["clearance_m"], row["steering_rad"]))
            scan = int(row["actuation_scan"])
            if scan in answers and scan != last:
                last = scan
                sweep_s = (row["header.chain.0.published_ns"] - row["header.acquired_ns"]) * 1e-9
                steering = issued[-1][1][1] if issued else 0.0
                issued.append((row["time_s"] + sweep_s - row["actuation_age_s"], answers[scan] or [0.0, steering]))
                self.acts_s[scan] = issued[-1][0]
        start_s = next(time_s for time_s, control in issued if control[0] > 0)
        time_s, state, speed, clearance, steering = [moment for moment in moments if moment[0] <= start_s][-1]
        self.speed, self.steering = speed, steering
        way = turned([speed * (start_s - time_s), 0.0], state[0] + state[1])
        yaw = state[1] + state[2] * (start_s - time_s)
        start = (start_s, [state[0], yaw, state[2], state[3] + way[0], state[4] + way[1]], speed, clearance)
        self.times, self.states, self.on_course, self.clearance = [], [], [], math.inf
        for time_s, state, _, clearance in [start, *(moment[:4] for moment in moments if moment[0] > start_s)]:
            piece, found = self.course.find(state, self.near)
            # Without wraps: the direction of the course and the direction relative to it.
            state[1] = piece.yaw + piece.curvature * (found[3] - piece.begin) + found[1]
            share = 1.0
            if found[3] >= self.end_m - 1e-5:
                share = (self.end_m - self.near) / (found[3] - self.near)
            self.times.append(time_s if share == 1.0 else mixed(self.times[-1], time_s, share))
            for kept, value in ((self.states, state), (self.on_course, found)):
                kept.append(value if share == 1.0 else [mixed(*pair, share) for pair in zip(kept[-1], value)])
            self.near, self.clearance = found[3], min(self.clearance, clearance)
            if found[3] >= self.end_m - 1e-5:
                break
        else:
            raise ValueError("the drive does not reach its goal")
        self.commands = [entry for entry in issued if start_s <= entry[0] < self.times[-1]]
        begins = [entry[0] for entry in self.commands]
        lengths = [after - before for before, after in zip(begins, [*begins[1:], self.times[-1]])]
        self.objective = float(objective(self.times, self.on_course, [entry[1] for entry in self.commands], lengths))


def mixed(before, after, share):
    return before + share * (after - before)


def attachment(path, wanted):
    """A TOML file that is attached to a recording (MCAP: records with an operation, a length and a content)."""
    data, at = path.read_bytes(), 8
    while at + 9 <= len(data) - 8:
        operation, length = struct.unpack_from("<BQ", data, at)
        if operation == 9:
            name_at = at + 9 + 16
            (size,) = struct.unpack_from("<I", data, name_at)
            name, kind_at = data[name_at + 4:name_at + 4 + size].decode(), name_at + 4 + size
            text_at = kind_at + 4 + struct.unpack_from("<I", data, kind_at)[0]
            if name == wanted:
                (size,) = struct.unpack_from("<Q", data, text_at)
                return tomllib.loads(data[text_at + 8:text_at + 8 + size].decode())
        at += 9 + length
    raise ValueError(f"{path} has no {wanted}")


def rows(folder, topic):
    with open(folder / f"{topic}.csv", newline="") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def described(folder):
    """For each scan its number, when it was taken, and the ellipses (x, y, a, b) that were described."""
    def ellipses(row):
        keys = ("x_m", "y_m", "a_m", "b_m")
        return [[row[f"items.{index}.{key}"] for key in keys] for index in range(int(row["count"]))]
    scans = [(int(row["header.scan_id"]), row["header.acquired_ns"] * 1e-9, ellipses(row)) for row in rows(folder, "obstacles")]
    return sorted(scans, key=lambda scan: scan[0])


def samples(folder):
    """Samples of the truth, and by scan what was desired: velocity and steering, or None for blocked wheels."""
    answers = {}
    for row in rows(folder, "actuation"):
        if row["answers"] == 1:
            desired = [row["desired_velocity_mps"], row["desired_steering_rad"]]
            answers[int(row["header.scan_id"])] = desired if row["kind"] == 1 else None
    return sorted(rows(folder, "truth"), key=lambda row: row["header.scan_id"]), answers


def objective(times, states, controls, lengths):
    """J of states on the course at these times, and of controls that hold for these lengths."""
    def weighted(weights, values, about):
        return sum(weight * (value - other) ** 2 for weight, value, other in zip(weights, values, about))
    references = [[0, 0, 0, states[0][3] + time - times[0], 0] for time in times]
    costs = [weighted(STATE, state, reference) for state, reference in zip(states, references)]
    total = weighted(TERMINAL, states[-1], references[-1])
    for index, cost in enumerate(costs[1:]):
        total += (times[index + 1] - times[index]) * (costs[index] + cost) / 2
    for index, (control, length) in enumerate(zip(controls, lengths)):
        total += length * weighted(CONTROL, control, CRUISE)
        if index > 0:
            total += weighted(CHANGE, control, controls[index - 1]) * INTERVAL_S / lengths[index - 1]
    return total


def second_differences(controls):
    """Sum of the changes of the changes of the steering angle [rad]."""
    angles = [control[1] for control in controls]
    changes = [after - before for before, after in zip(angles, angles[1:])]
    return sum(abs(after - before) for before, after in zip(changes, changes[1:]))
