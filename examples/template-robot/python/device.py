"""The robot. Replace the three functions read_odometry, read_scan and write_wheels by those of yours.

None of them may wait. As shipped they belong to a simulation with the faults of real devices: base and scanner have
one clock of their own, which restarts every 2 s, data arrive up to 3 ms late, and one sweep in 23 breaks off half-way.
"""

import math
import random
from typing import NamedTuple

from scanloop_types import BEAMS, FIRST_BEAM_YAW_RAD, PITCH_RAD

STEP_NS = 2_000_000  # of the simulation
BASE_NS = 20_000_000  # the base sends a state this often
RESTART_NS = 2_000_000_000  # base and scanner restart this often
LATE_NS = 3_000_000  # data arrive this much late at most
BROKEN = 23  # one sweep in this many breaks off
VELOCITY_FACTOR = 1.4  # the robot drives this much slower than it is told
CURVATURE = 5.405  # of the path per steering angle [1/(m rad)]


class Pose(NamedTuple):
    """Pose from where the base started, left and counter-clockwise positive, and speed over ground."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0


class Device:
    """A robot in a hall; `period_ns` is the time between two sweeps."""

    one_clock = True  # base and scanner stamp with the same clock; False where the scanner has one of its own
    base_delay_ns = 0  # shortest time from the stamp of a state of the base to its arrival

    def __init__(self, now_ns, period_ns):
        self._period_ns, self._now_ns, self._started_ns, self._sweeps = period_ns, now_ns, now_ns, 0
        # Shortest time from the front beam to the arrival of a sweep: half of the sweep, plus its way.
        self.scan_delay_ns = period_ns // 3
        self._drive, self._pose, self._origin = None, Pose(), Pose()
        self._base = self._scan = None  # with time of arrival
        self._random = random.Random(1)

    def read_odometry(self, now_ns):
        """The newest state of the base not read before: its stamp [ns] and Pose, or None."""
        self._advance_to(now_ns)
        if self._base is None or self._base[0] > now_ns:
            return None
        (_, *state), self._base = self._base, None
        return state

    def read_scan(self, now_ns):
        """The newest sweep not read before: stamp of its front beam [ns] and ranges [mm].

        None when there is none. A sweep that broke off has less than BEAMS ranges."""
        self._advance_to(now_ns)
        if self._scan is None or self._scan[0] > now_ns:
            return None
        (_, *sweep), self._scan = self._scan, None
        return sweep

    def write_wheels(self, now_ns, drive):
        """Drives with (velocity [m/s], steering angle [rad]), or blocks the wheels for None."""
        self._advance_to(now_ns)
        self._drive = drive

    def _advance_to(self, now_ns):
        while self._now_ns + STEP_NS <= now_ns:
            self._now_ns += STEP_NS
            self._step()

    def _step(self):
        self._roll(STEP_NS * 1e-9)
        run_ns, late_ns = self._now_ns - self._started_ns, self._random.randrange(LATE_NS)
        stamp_ns = run_ns % RESTART_NS * 10001 // 10000  # a clock of its own, 100 ppm fast, that begins again at zero
        if run_ns % RESTART_NS == 0:
            self._origin = self._pose
        if run_ns % BASE_NS == 0:
            self._base = self._now_ns + late_ns, stamp_ns, self._seen()
        if run_ns // self._period_ns > self._sweeps:
            self._sweeps = run_ns // self._period_ns
            ranges = self._measure(BEAMS // 2 if self._sweeps % BROKEN == 0 else BEAMS)
            self._scan = self._now_ns + self._period_ns // 3 + late_ns, stamp_ns, ranges

    def _roll(self, dt_s):
        """Moves the robot. Blocked wheels decelerate at 5 m/s^2, the drive changes speed by 2 m/s^2."""
        x, y, yaw, speed = self._pose
        velocity, steering = self._drive or (0.0, 0.0)
        most = dt_s * (2.0 if self._drive else 5.0)
        speed += max(-most, min(most, velocity / VELOCITY_FACTOR - speed))
        yaw += CURVATURE * steering * speed * dt_s
        self._pose = Pose(x + speed * math.cos(yaw) * dt_s, y + speed * math.sin(yaw) * dt_s, yaw, speed)

    def _seen(self):
        """The pose as a base reports it that started at the origin."""
        pose, origin = self._pose, self._origin
        dx, dy = pose.x_m - origin.x_m, pose.y_m - origin.y_m
        cos, sin = math.cos(origin.yaw_rad), math.sin(origin.yaw_rad)
        return Pose(cos * dx + sin * dy, cos * dy - sin * dx, pose.yaw_rad - origin.yaw_rad, pose.speed_mps)

    def _measure(self, beams):
        """Distances to the walls, with an error of up to a centimetre."""
        pose, ranges = self._pose, []
        for beam in range(beams):
            yaw = pose.yaw_rad + FIRST_BEAM_YAW_RAD + beam * PITCH_RAD
            cos, sin = math.cos(yaw), math.sin(yaw)
            along = (40.0 - pose.x_m) / cos if cos > 0 else (3.0 + pose.x_m) / -cos
            across = (3.5 - pose.y_m) / sin if sin > 0 else (3.5 + pose.y_m) / max(-sin, 1e-9)
            range_m = min(along, across)
            ranges.append(int(range_m * 1e3 + self._random.random() * 20 - 10) if range_m < 5.6 else 0)
        return ranges
