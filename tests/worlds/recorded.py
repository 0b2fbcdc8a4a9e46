"""A real scanner on a real rover: its log through estimator and obstacle detector, against a scan matching of our own.

usage: recorded.py SCANLOOP LOG

LOG is that of the CoreSLAM paper, with 682 ranges of an URG-04LX in each line and the ticks of two wheels. The matching
knows the ranges only. Exit code 1 if a scan is unaccounted for, or what is measured is beyond LIMITS.
"""

import csv
import json
import math
import pathlib
import subprocess
import sys
import tempfile

import numpy
import scipy.spatial

TICK_M, HALF_AXLE_M = math.pi / 2000 * 0.077, 0.165  # as published
SCANNER_M = 0.145  # ahead of the axle
FIRST_RAD, PITCH_RAD, REACH_MM = -math.radians(119.53), math.radians(0.3516), 5600
WINDOW = 10  # scans, a second
SHIFTS = 60  # beams, 0.37 rad: no rover turns further between two scans
DIGITS = "-0123456789"
SIDE = 3  # beams beside the one to the middle of a body
NEAR_M = 0.1  # from a return to a body that it belongs to
CONTRADICTED = 0.02  # share of scans that may contradict the wheels: these slip
LIMITS = {"healthy": (0.4, 1.0), "way_m": (0.0, 0.12), "turn_rad": (0.0, 0.07), "bodies": (0.95, 1.0)}


def points(ranges_mm):
    """The returns of a scan from the scanner [m], one a row."""
    kept = (ranges_mm >= 20) & (ranges_mm < REACH_MM)
    angles = FIRST_RAD + PITCH_RAD * numpy.arange(len(ranges_mm))[kept]
    return numpy.stack([numpy.cos(angles), numpy.sin(angles)], 1) * ranges_mm[kept, None] * 1e-3


def turn_of(before_mm, now_mm):
    """The turn between two scans whose ranges look most alike, to a beam."""
    found = []
    for shift in range(-SHIFTS, SHIFTS + 1):
        old, new = before_mm[SHIFTS + shift : len(before_mm) - SHIFTS + shift], now_mm[SHIFTS:-SHIFTS]
        both = (old >= 20) & (new >= 20)
        found.append(numpy.minimum(abs(old[both] - new[both]), 300).mean() if both.sum() > 50 else math.inf)
    return (int(numpy.argmin(found)) - SHIFTS) * PITCH_RAD


def match(before, now, yaw):
    """Motion (x, y, yaw) of the scanner between two scans: each return onto the line through two neighbours before it."""
    tree, x, y = scipy.spatial.cKDTree(before), 0.0, 0.0
    for step in range(20):
        cos, sin = math.cos(yaw), math.sin(yaw)
        placed = now @ numpy.array([[cos, sin], [-sin, cos]]) + (x, y)
        far, first = tree.query(placed)
        second = numpy.where(first > 0, first - 1, 1)
        line = before[second] - before[first]
        length = numpy.hypot(line[:, 0], line[:, 1])
        kept = (far < max(0.4 / (step + 1), 0.08)) & (length > 1e-3) & (length < 0.15)
        if kept.sum() < 20:
            return None
        normal = numpy.stack([-line[kept, 1], line[kept, 0]], 1) / length[kept, None]
        off = ((placed[kept] - before[first[kept]]) * normal).sum(1)
        lever = placed[kept] - (x, y)
        rows = numpy.column_stack([normal, normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]])
        # It stays where nothing shows a direction, as along a corridor.
        change = numpy.linalg.solve(rows.T @ rows + 0.01 * numpy.eye(3), -rows.T @ off)
        x, y, yaw = x + change[0], y + change[1], yaw + change[2]
    return x, y, yaw


def after(first, second):
    """Motion `second` after motion `first`."""
    cos, sin = math.cos(first[2]), math.sin(first[2])
    x, y, yaw = second
    return first[0] + cos * x - sin * y, first[1] + sin * x + cos * y, first[2] + yaw


def between(before, now):
    """Motion from one pose to another."""
    cos, sin = math.cos(before[2]), math.sin(before[2])
    dx, dy = now[0] - before[0], now[1] - before[1]
    return cos * dx + sin * dy, cos * dy - sin * dx, math.remainder(now[2] - before[2], math.tau)


def of_scanner(pose):
    """The pose of the scanner on a robot."""
    return after(pose, (SCANNER_M, 0.0, 0.0))


def read(path):
    """Rows of a table as dictionaries of numbers, in the order of their scans."""
    with open(path, encoding="utf-8") as file:
        table = csv.DictReader(file)
        rows = [{key: float(value) for key, value in row.items() if value and value[0] in DIGITS} for row in table]
    return sorted(rows, key=lambda row: row["header.scan_id"])


def imported(scanloop, log, folder):
    """What an import says, its poses and its descriptions."""
    recording, tables = folder / "rover.mcap", folder / "tables"
    command = [scanloop, "recording", "import", log, "--out", recording, "--json"]
    said = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    subprocess.run([scanloop, "recording", "export", recording, "--csv", tables], check=True, capture_output=True)
    return said, read(tables / "pose.csv"), read(tables / "obstacles.csv")


def seen_again(body, pose, motion, ranges_mm):
    """Whether a return of another scan is in the box of a body; None where its middle is hidden, or nothing returns."""
    scanner = after(of_scanner(pose), motion)
    x, y, _ = between(scanner, (body["box_x_m"], body["box_y_m"], 0.0))
    far, beam = math.hypot(x, y), round((math.atan2(y, x) - FIRST_RAD) / PITCH_RAD)
    half = numpy.array([body["box_length_m"], body["box_width_m"]]) / 2 + NEAR_M
    if not SIDE <= beam < len(ranges_mm) - SIDE or far > REACH_MM * 1e-3:
        return None
    seen = ranges_mm[beam - SIDE : beam + SIDE + 1]
    seen = seen[(seen >= 20) & (seen < REACH_MM)] * 1e-3
    if len(seen) < SIDE or seen.min() < far - math.hypot(*half):
        return None
    (x, y, yaw), cloud = between((body["box_x_m"], body["box_y_m"], body["box_yaw_rad"]), scanner), points(ranges_mm)
    cos, sin = math.cos(yaw), math.sin(yaw)
    in_box = cloud @ numpy.array([[cos, sin], [-sin, cos]]) + (x, y)
    return bool((abs(in_box) <= half).all(1).any())


def main():
    scanloop, log = sys.argv[1:]
    table = numpy.loadtxt(log)
    ticks, ranges = table[:, 2:4], table[:, 24:706]
    pairs = list(zip(ranges, ranges[1:]))
    motions = [match(points(before), points(now), turn_of(before, now)) for before, now in pairs]
    # The published way of the wheels is too short: what the scans say.
    wheels = numpy.diff(ticks, axis=0) * TICK_M
    known = numpy.array([motion is not None for motion in motions])
    seen = numpy.array([motion or (0.0, 0.0, 0.0) for motion in motions])
    told = numpy.stack([wheels.mean(1), (wheels[:, 1] - wheels[:, 0]) / (2 * HALF_AXLE_M)], 1)
    # Sums over a second, because ticks and ranges of a line are not of one time.
    sums = [at for at in range(0, len(motions) - WINDOW) if known[at : at + WINDOW].all()]
    factors = []
    for tick, axis in ((0, 0), (1, 2)):
        by_wheels, by_scans = (
            numpy.array([row[at : at + WINDOW, of].sum() for at in sums]) for row, of in ((told, tick), (seen, axis))
        )
        factors.append(by_wheels @ by_scans / (by_wheels @ by_wheels))
    with tempfile.TemporaryDirectory(prefix="rover-") as folder:
        said, poses, described = imported(scanloop, log, pathlib.Path(folder))
    computed = said["computed"]
    off, again = [], []
    for at in range(len(poses) - WINDOW):
        if not known[at : at + WINDOW].all():
            continue
        own = (0.0, 0.0, 0.0)
        for motion in motions[at : at + WINDOW]:
            own = after(own, motion)
        pose, later = [(row["x_m"], row["y_m"], row["yaw_rad"]) for row in (poses[at], poses[at + WINDOW])]
        estimated = between(of_scanner(pose), of_scanner(later))
        off.append((math.dist(own[:2], estimated[:2]), abs(own[2] - estimated[2])))
        for index in range(int(described[at]["count"])):
            start = f"items.{index}."
            body = {key.removeprefix(start): value for key, value in described[at].items() if key.startswith(start)}
            if body["unseen_s"] == 0:
                again.append(seen_again(body, pose, own, ranges[at + WINDOW]))
    shown = [is_seen for is_seen in again if is_seen is not None]
    median = numpy.median(off, 0)
    found = {
        "healthy": computed["healthy"] / said["scans"],
        "way_m": float(median[0]),
        "turn_rad": float(median[1]),
        "bodies": sum(shown) / len(shown),
    }
    print(f"scans {said['scans']}, taken {said['taken']}, answered {computed['poses']} and {computed['obstacles']}")
    print(f"wheels by the scans: {factors[0]:.2f} of the published way, {factors[1]:.2f} of the turn, {known.mean():.0%} matched")
    degraded, stopping = computed["degraded"] / said["scans"], computed["stopping"]
    print(f"scanner healthy in {found['healthy']:.0%}, degraded in {degraded:.0%}, stop in {stopping}")
    print(f"pose after a second: {1e3 * median[0]:.0f} mm and {1e3 * median[1]:.0f} mrad from the matching in the median")
    print(f"bodies: {sum(shown)} of {len(shown)} are where the matching sees returns a second later")
    is_whole = said["taken"] == said["scans"] == computed["poses"] == computed["obstacles"] == len(table)
    bad = [name for name, (low, high) in LIMITS.items() if not low <= found[name] <= high]
    sys.exit(0 if is_whole and not bad and stopping <= CONTRADICTED * len(table) else f"beyond its limits: {bad or 'scans'}")


if __name__ == "__main__":
    main()
