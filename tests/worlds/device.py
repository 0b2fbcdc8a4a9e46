"""The robot of a world that is simulated by ir-sim or pybullet, for the driver of `scanloop new`.

The simulator moves the robot, measures ranges and sees collisions; nothing of it is ours. Here are only its drive with
lags, a sweep whose beams are taken one after the other, and, if asked for, what a real odometer and scanner do wrong.
What truly happened goes to the file WORLD_LOG, a line of JSON every 100 ms, for the judge.
"""

import json
import math
import os
import random
from typing import NamedTuple

from scanloop_types import BEAMS, FIRST_BEAM_YAW_RAD, PITCH_RAD

STEP_MS = 10  # of the simulation, unless the world says otherwise
VELOCITY_FACTOR = 1.4  # the robot drives this much slower than it is told
CURVATURE = 5.405  # of the path per steering angle [1/(m rad)]
ACCELERATION, DECELERATION = 2.0, 5.0  # of the drive and of blocked wheels [m/s^2]
STEERING_LAG_S = 0.1
RANGE_M = 5.6
MAX_STEPS = 10  # at once, for a driver that is late continues with what is due in between
STOOD_NS = 1_000_000_000  # after a longer pause of the process the world has stood still, too
REST_MPS = 0.02


class Pose(NamedTuple):
    """Pose from where the base started, left and counter-clockwise positive, and speed over ground."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0


class Errors(NamedTuple):
    """What is wrong with odometer and scanner."""

    scale: float = 0.0  # of the way
    drift_radps: float = 0.0  # of the yaw while the robot moves
    slip_m: float = 0.0  # standard deviation after a metre
    late_ns: tuple = (0, 1_000_000)
    noise_m: float = 0.003  # of a range


ERRORS = {
    "none": Errors(),
    "real": Errors(0.01, math.radians(0.5), 0.01, (20_000_000, 60_000_000), 0.03),
}


class Device:
    """The robot; `period_ns` is the time between two sweeps."""

    one_clock, base_delay_ns = True, 0

    def __init__(self, now_ns, period_ns):
        with open(os.environ["WORLD_FILE"], encoding="utf-8") as file:
            world = json.load(file)
        self._curvature, self._factor = world.get("curvature", CURVATURE), world.get("factor", VELOCITY_FACTOR)
        self._step_ns = world.get("step_ms", STEP_MS) * 1_000_000
        self._errors = ERRORS[os.environ.get("WORLD_ERRORS", "none")]
        self._random = random.Random(int(os.environ.get("WORLD_SEED", "1")))
        if os.environ["WORLD_SIMULATOR"] == "pybullet":
            from world_pybullet import World
        else:
            from world_irsim import World
        self._world = World(world, self._step_ns * 1e-9)
        self._log = open(os.environ["WORLD_LOG"], "w", encoding="utf-8")  # noqa: SIM115
        self._period_ns, self._now_ns, self._run_ns = period_ns, now_ns, 0
        self._sweep_ns = period_ns * 2 // 3
        # From the front beam to the end of the sweep; the least delay is taken for none, as by every driver.
        self.scan_delay_ns = self._sweep_ns // 2 + self._errors.late_ns[0]
        self.base_delay_ns = self._errors.late_ns[0]
        self._drive, self._steering, self._speed = None, 0.0, 0.0
        self._truth, self._seen = Pose(), Pose()
        self._ranges, self._taken, self._began_ns = [0] * BEAMS, 0, 0
        self._asked_ns, self._pause_ns = None, 0  # when the driver asked last, and its longest pause since the last line
        self._states, self._sweeps = [], []  # on their way

    def read_odometry(self, now_ns):
        """The newest state of the base not read before: stamp [ns] and Pose, or None."""
        self._advance_to(now_ns)
        return self._arrived(self._states, now_ns)

    def read_scan(self, now_ns):
        """The newest sweep not read before: stamp [ns] and ranges [mm], or None."""
        self._advance_to(now_ns)
        return self._arrived(self._sweeps, now_ns)

    def write_wheels(self, now_ns, drive):
        """Drives with (velocity [m/s], steering angle [rad]), or blocks the wheels for None."""
        self._advance_to(now_ns)
        self._drive = drive

    @staticmethod
    def _arrived(waiting, now_ns):
        newest = None
        while waiting and waiting[0][0] <= now_ns:
            newest = waiting.pop(0)[1:]
        return newest

    def _late(self):
        return self._random.randrange(*self._errors.late_ns) if self._errors.late_ns[1] else 0

    def _advance_to(self, now_ns):
        self._pause_ns, self._asked_ns = max(self._pause_ns, now_ns - (self._asked_ns or now_ns)), now_ns
        if now_ns - self._now_ns > STOOD_NS:  # the process stood still: so did the world
            self._now_ns = now_ns - self._step_ns
        for _ in range(min(MAX_STEPS, (now_ns - self._now_ns) // self._step_ns)):
            self._now_ns += self._step_ns
            self._run_ns += self._step_ns
            self._step()

    def _step(self):
        dt_s = self._step_ns * 1e-9
        velocity, steering = self._drive or (0.0, self._steering)
        most = dt_s * (ACCELERATION if self._drive else DECELERATION)
        self._speed += max(-most, min(most, velocity / self._factor - self._speed))
        self._steering += (steering - self._steering) * dt_s / (STEERING_LAG_S + dt_s)
        at, touched = self._world.step(self._speed, self._curvature * self._steering, not self._drive)
        self._measure_odometry(Pose(*at))
        self._measure_ranges()
        if self._run_ns % 100_000_000 == 0 or touched:
            speed_mps = self._truth.speed_mps
            line = {"t": self._run_ns * 1e-9, "at": self._truth[:3], "speed_mps": round(speed_mps, 3)}
            line |= {"driving": abs(speed_mps) > REST_MPS, "touched": bool(touched), "pause_ms": self._pause_ns // 1_000_000}
            print(json.dumps(line), file=self._log, flush=True)
            self._pause_ns = 0

    def _measure_odometry(self, truth):
        before, self._truth = self._truth, truth
        way = math.hypot(truth.x_m - before.x_m, truth.y_m - before.y_m)
        cos, sin = math.cos(before.yaw_rad), math.sin(before.yaw_rad)
        dx, dy = truth.x_m - before.x_m, truth.y_m - before.y_m
        ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
        slip = self._random.gauss(0.0, self._errors.slip_m * math.sqrt(way)) if way else 0.0
        ahead = ahead * (1.0 + self._errors.scale) + slip
        turn = math.remainder(truth.yaw_rad - before.yaw_rad, math.tau)
        turn += self._errors.drift_radps * self._step_ns * 1e-9 * (way > 1e-5)
        seen = self._seen
        cos, sin = math.cos(seen.yaw_rad), math.sin(seen.yaw_rad)
        x, y = seen.x_m + cos * ahead - sin * left, seen.y_m + sin * ahead + cos * left
        self._seen = Pose(x, y, seen.yaw_rad + turn, truth.speed_mps * (1.0 + self._errors.scale))
        if self._run_ns % 20_000_000 == 0:
            self._states.append((self._now_ns + self._late(), self._run_ns, self._seen))

    def _measure_ranges(self):
        into_ns = self._run_ns % self._period_ns
        if into_ns < self._step_ns:
            self._taken, self._began_ns = 0, self._run_ns
        until = min(BEAMS, BEAMS * (into_ns + self._step_ns) // self._sweep_ns)
        if until <= self._taken:
            return
        angles = [FIRST_BEAM_YAW_RAD + beam * PITCH_RAD for beam in range(self._taken, until)]
        for beam, range_m in enumerate(self._world.ranges(angles), self._taken):
            range_m += self._random.gauss(0.0, self._errors.noise_m)
            self._ranges[beam] = int(range_m * 1e3) if 0.02 < range_m < RANGE_M else 0
        self._taken = until
        if until == BEAMS:
            arrives_ns = self._now_ns + self._late()
            self._sweeps.append((arrives_ns, self._began_ns + (self._sweep_ns - self._step_ns) // 2, list(self._ranges)))
