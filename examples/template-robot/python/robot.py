"""A driver of your own robot in Python, ready to be copied and changed.

It publishes a scan and the odometry at its front beam once per sweep, and writes velocity and steering angle to the
wheels. Replace the three functions of device.py; this file is what every driver must do: stamps on CLOCK_MONOTONIC,
whole scans only, and wheels that stop by themselves.

In a copy, take scanloop.py and scanloop_types.py of examples/python with you.
"""

import collections
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "python"))

from device import Device, Pose  # noqa: E402
from scanloop import DeviceClock, Process, Role, Wheels  # noqa: E402
from scanloop_types import (  # noqa: E402
    BEAMS,
    FIRST_BEAM_YAW_RAD,
    PITCH_RAD,
    Actuation,
    ActuationKind,
    DeviceState,
    Odometry,
    Phase,
    Scan,
)

POLL_NS = 5_000_000  # the device is polled this often, also when no actuation comes
END_NS = 800_000_000  # a process that is asked to end is killed after one second
VELOCITY_MAX_MPS, STEERING_MAX_RAD, SLACK = 2.0, 0.12, 1e-9  # what the actuator may send; else it is not obeyed
REST_MPS = 1e-3  # below this speed the wheels rest
MAX_MISSING = 3  # periods without data, or broken sweeps in a row, that are a fault
MAX_STATES = 256  # states of the base, more than it sends in two scan periods


def wrap(angle):
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - angle) % math.tau


def moved(origin, pose):
    """A pose that is given from `origin`, in the frame of `origin`."""
    cos, sin = math.cos(origin.yaw_rad), math.sin(origin.yaw_rad)
    x, y = origin.x_m + cos * pose.x_m - sin * pose.y_m, origin.y_m + sin * pose.x_m + cos * pose.y_m
    return Pose(x, y, wrap(origin.yaw_rad + pose.yaw_rad), pose.speed_mps)


class History:
    """The newest states of the base, without a jump when it starts again at zero."""

    def __init__(self):
        self._states, self._origin = collections.deque(maxlen=MAX_STATES), Pose()
        self._behind_ns = 0  # from the stamp of the newest one to its time

    def add(self, at_ns, time_ns, reported, restarted):
        """Adds a state, by its stamp where base and scanner have one clock, else by its time.

        After a restart the base counts from zero again; the robot has not moved by that."""
        last = self._states[-1] if self._states else None
        if restarted and last:
            turn = Pose(yaw_rad=last[1].yaw_rad - reported.yaw_rad)
            at = moved(turn, reported)
            self._origin = turn._replace(x_m=last[1].x_m - at.x_m, y_m=last[1].y_m - at.y_m)
            # A clock that began again has another stamp for the states before.
            shift_ns = self._behind_ns - (time_ns - at_ns)
            self._states = collections.deque(((ns + shift_ns, pose) for ns, pose in self._states), MAX_STATES)
            last = self._states[-1]
        self._behind_ns = time_ns - at_ns
        if last is None or at_ns > last[0]:
            self._states.append((at_ns, moved(self._origin, reported)))

    def at(self, time_ns, gap_ns):
        """The pose at a time between two states; None when there are none, or when they are too far apart."""
        states = list(self._states)
        for (early_ns, early), (late_ns, late) in zip(states, states[1:]):
            if early_ns < time_ns <= late_ns and late_ns - early_ns <= gap_ns:
                share = (time_ns - early_ns) / (late_ns - early_ns)
                x, y, _, speed = (one + share * (other - one) for one, other in zip(early, late))
                return Pose(x, y, wrap(early.yaw_rad + share * wrap(late.yaw_rad - early.yaw_rad)), speed)
        return None


class Driver:
    """A robot with its place in the run."""

    def __init__(self, process):
        self._process = process
        self._actuations = process.input(Actuation)
        self._scans, self._odometries = process.output(Scan), process.output(Odometry)
        self._device = Device(process.now_ns(), process.period_ns)
        self._base_clock = DeviceClock(self._device.base_delay_ns)
        self._scanner_clock = DeviceClock(self._device.scan_delay_ns)
        self._history = History()
        self._waiting = None  # a sweep with stamp and time of its front beam; it waits for the odometry after it
        self._arrived_ns = [None, None]  # when base and scanner sent data last
        self._broken = 0  # sweeps that broke off since the last whole one
        self._last = Odometry()
        self._told_ns, self._speed_mps = None, 0.0  # when the wheels were told to drive; None while blocked
        process.report_wheels(Wheels.RESTING)

    def turn(self):
        """All that is due: wheels first, then what was measured."""
        self._obey()
        self._read()
        self._report()
        self._publish()

    def end(self):
        """Blocks the wheels, and waits for as long as an end may take until the robot rests."""
        until_ns = self._process.now_ns() + END_NS
        while True:
            now_ns = self._process.now_ns()
            self._block(now_ns)
            self._read()
            self._report()
            if abs(self._speed_mps) <= REST_MPS or now_ns > until_ns:
                return
            self._process.wait(now_ns + POLL_NS)

    def _obey(self):
        """Writes what the actuator commands. The dead man: without it for two periods the wheels are blocked."""
        now_ns = self._process.now_ns()
        while (actuation := self._actuations.take()) is not None:
            velocity, steering = actuation.sent_velocity_mps, actuation.sent_steering_rad
            is_possible = abs(velocity) <= VELOCITY_MAX_MPS + SLACK and abs(steering) <= STEERING_MAX_RAD + SLACK
            if actuation.kind == ActuationKind.BLOCK:
                self._block(now_ns)
            elif actuation.kind == ActuationKind.DRIVE and is_possible:
                self._device.write_wheels(now_ns, (velocity, steering))
                self._told_ns = now_ns
        silent = self._told_ns is not None and now_ns - self._told_ns >= 2 * self._process.period_ns
        if silent or self._process.must_stop():
            self._block(now_ns)

    def _block(self, now_ns):
        self._device.write_wheels(now_ns, None)
        self._told_ns = None

    def _report(self):
        """Reports to `scanloop stop` what the wheels do, and to `scanloop status` what base and scanner do."""
        standing = Wheels.BLOCKED if abs(self._speed_mps) > REST_MPS else Wheels.RESTING
        self._process.report_wheels(standing if self._told_ns is None else Wheels.TURNING)
        self._process.report_device(*self._devices())

    def _devices(self):
        """What base and scanner do, and why."""
        limit_ns = self._process.now_ns() - MAX_MISSING * self._process.period_ns
        base_ns, scanner_ns = self._arrived_ns
        if base_ns is None or scanner_ns is None:
            return DeviceState.CONNECTING, "base: no data yet" if base_ns is None else "scanner: no sweep yet"
        if base_ns < limit_ns:
            return DeviceState.FAULT, "base: sends no data"
        if scanner_ns < limit_ns:
            return DeviceState.FAULT, "scanner: sends no sweeps"
        if self._broken >= MAX_MISSING:
            return DeviceState.FAULT, "scanner: all sweeps break off"
        overtaken = self._base_clock.overtaken + self._scanner_clock.overtaken
        return DeviceState.RUNNING, f"{overtaken} messages were overtaken by others" if overtaken else ""

    def _read(self):
        """Reads what base and scanner have measured, and maps their stamps to CLOCK_MONOTONIC."""
        now_ns = self._process.now_ns()
        if state := self._device.read_odometry(now_ns):
            stamp_ns, pose = state
            restarts = self._base_clock.restarts
            time_ns = self._base_clock.map(stamp_ns, now_ns)
            if time_ns is not None:
                at_ns = stamp_ns if self._device.one_clock else time_ns
                self._history.add(at_ns, time_ns, pose, self._base_clock.restarts > restarts)
                self._speed_mps = pose.speed_mps
            self._arrived_ns[0] = now_ns
        if sweep := self._device.read_scan(now_ns):
            stamp_ns, ranges = sweep
            self._arrived_ns[1] = now_ns
            self._broken = 0 if len(ranges) == BEAMS else self._broken + 1
            one_clock = self._device.one_clock
            front_ns = self._scanner_clock.map(stamp_ns, now_ns, self._base_clock if one_clock else None)
            if front_ns is not None:
                at_ns = stamp_ns if one_clock else front_ns
                self._waiting = (at_ns, front_ns, ranges) if self._is_next(front_ns) else None

    def _is_next(self, front_ns):
        """Whether a front beam is after the one before; logs a gap."""
        last_ns, period_ns = self._last.header.acquired_ns, self._process.period_ns
        if last_ns and front_ns - last_ns > period_ns * 3 // 2:
            print(f"a gap of {(front_ns - last_ns) // 1_000_000} ms between two sweeps", file=sys.stderr, flush=True)
        return not last_ns or front_ns - last_ns >= period_ns // 4

    def _publish(self):
        """Publishes the sweep that waits, when the odometry at its front beam is known."""
        if self._waiting is None:
            return
        process, (at_ns, front_ns, ranges) = self._process, self._waiting
        if process.now_ns() - front_ns > 2 * process.period_ns or process.directive.phase == Phase.STOPPING:
            self._waiting = None
            return
        pose = self._history.at(at_ns, process.period_ns * 3 // 2)
        if pose is None:
            return
        self._waiting = None
        scan = Scan(sweep_ns=process.period_ns * 2 // 3, period_ns=process.period_ns)
        scan.beams, scan.first_rad, scan.increment_rad = BEAMS, FIRST_BEAM_YAW_RAD, PITCH_RAD
        if len(ranges) == BEAMS:
            scan.ranges_mm[:BEAMS] = ranges
        else:
            scan.missing = 1  # a sweep that broke off: zeros only
        now = Odometry(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad, speed_mps=pose.speed_mps)
        before = self._last
        for sample in (scan, now):
            sample.header.scan_id, sample.header.acquired_ns = before.header.scan_id + 1, front_ns
        if before.header.scan_id:
            now.dx_m, now.dy_m = now.x_m - before.x_m, now.y_m - before.y_m
            now.dyaw_rad = wrap(now.yaw_rad - before.yaw_rad)
            now.dt_s = (front_ns - before.header.acquired_ns) * 1e-9
        self._scans.publish(scan)
        self._odometries.publish(now)
        self._last = now


if __name__ == "__main__":
    process = Process(Role.ROBOT)
    driver = Driver(process)
    if process.start():
        while process.wait(process.now_ns() + POLL_NS):
            driver.turn()
    driver.end()
