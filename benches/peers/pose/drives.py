"""Scans with odometry, as `scanloop-lab estimator` writes and follows them, and what poses along them are worth."""

import math
from dataclasses import dataclass

import numpy as np

# Cells of the drawing that says how well scans fit each other [m].
CELL_M = 0.05
# A path that is longer or shorter than that of the wheels by this share is none.
LENGTH = 0.03
# Standard deviations by which the motion of ten scans may be beside that of the wheels, and one of them: the rover slips
# when it begins to turn [m, rad].
SIGMA = 3.0
WHEELS_M, WHEELS_RAD = 0.09, 0.11


def wrap(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


def between(poses):
    """Motions from each (x, y, yaw) to the next one, in the frame of the first of the two."""
    step = np.diff(poses[:, :2], axis=0)
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    return np.column_stack([cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0],
                            wrap(np.diff(poses[:, 2]))])


def moved(pose, motion):
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y, yaw = motion
    return np.array([pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y, wrap(pose[2] + yaw)])


@dataclass
class Drive:
    """One file: `motions` of the odometer from scan to scan, `points` of each scan in the frame of the robot."""

    name: str
    odometry: np.ndarray
    truth: np.ndarray
    motions: np.ndarray
    points: list

    @classmethod
    def read(cls, path, scanner_x_m=0.0, unreported=0.0, farthest_m=5.6):
        """The returns are where they were at the time of the front beam, by the motion that the odometer reports."""
        with open(path) as file:
            count, first, increment, sweep_ns, period_ns = (float(word) for word in file.readline().split())
            rows = np.array([[float(word) for word in line.split()] for line in file])
        odometry = rows[:, 2:5]
        motions = between(odometry) * [1 + unreported, 1 + unreported, 1]
        beams = np.arange(int(count))
        angles = first + beams * increment
        since = (beams - (-first / increment)) * sweep_ns / count
        times = rows[:, 0]
        points = []
        for index, row in enumerate(rows):
            # The motion around the scan, per nanosecond.
            low, high = max(index - 1, 0), min(index + 1, len(rows) - 1)
            motion = motions[low:high].sum(axis=0) / (times[high] - times[low])
            metres = row[12:] * 1e-3
            seen = (row[12:] >= 20) & (metres < farthest_m)
            x, y = scanner_x_m + metres * np.cos(angles), metres * np.sin(angles)
            turn = motion[2] * since
            x, y = (np.cos(turn) * x - np.sin(turn) * y + motion[0] * since,
                    np.sin(turn) * x + np.cos(turn) * y)
            points.append(np.column_stack([x, y, np.zeros_like(x)])[seen])
        return cls(str(path), odometry, rows[:, 9:12], motions, points)

    def errors(self, poses):
        """Root of the mean square of the error of the position, and the largest error; both begin at the true pose."""
        off = np.hypot(*(aligned(poses, self.truth[0])[:, :2] - self.truth[:, :2]).T)
        return math.sqrt(np.mean(off**2)), off.max()

    def cells(self, poses):
        """Cells with points, when all scans are drawn from these poses."""
        drawn = []
        for (x, y, yaw), points in zip(poses, self.points):
            cos, sin = math.cos(yaw), math.sin(yaw)
            px, py = points[:, 0], points[:, 1]
            drawn.append(np.column_stack([x + cos * px - sin * py, y + sin * px + cos * py]))
        return len(np.unique(np.floor(np.vstack(drawn) / CELL_M).astype(np.int64), axis=0))

    def refusal(self, poses):
        """Why these poses are none, or nothing: the guards against a pose that never moves, and a shrunk way."""
        own, wheels = (sums(motions) for motions in (between(poses), self.motions))
        share = np.hypot(*own[:, :2].T).sum() / np.hypot(*wheels[:, :2].T).sum()
        if not abs(share - 1) <= LENGTH:
            return f"its path is {share:.3f} times that of the wheels"
        off = own - wheels
        worst = max(np.hypot(*off[:, :2].T).max() / WHEELS_M, np.abs(wrap(off[:, 2])).max() / WHEELS_RAD)
        return f"a motion is {worst:.1f} sigma beside that of the wheels" if worst > SIGMA else ""


def sums(motions, count=10):
    """Motions over `count` scans each: what shakes is no way."""
    return between(integrated(motions)[::count])


def aligned(poses, start):
    """Poses moved so that the first one is `start`."""
    turn = start[2] - poses[0, 2]
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = (poses[:, :2] - poses[0, :2]).T
    return np.column_stack([start[0] + cos * x - sin * y, start[1] + sin * x + cos * y, wrap(poses[:, 2] + turn)])


def integrated(motions):
    poses = [np.zeros(3)]
    for motion in motions:
        poses.append(moved(poses[-1], motion))
    return np.array(poses)
