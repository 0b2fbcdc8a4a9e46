"""One drive of a ROS 2 robot: its robot, its run, and what both have seen."""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DEADLINE_S = 30.0
PERIOD_S = 0.1
ENVIRONMENT = {
    # The transport over shared memory lost the first messages now and then.
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
SYSTEM = """{top}
[ros2]
domain = {domain}
interface = "127.0.0.1"
{more}
[[process]]
role = "robot"
implementation = "ros2"
"""
SCENARIO = """
name = "ros2"
timeout_s = 120.0

[track]
x_m = [0.0, {track}]

[goal]
x_m = {goal}
"""


class Failed(Exception):
    """What a case has found."""


def require(holds, what):
    """Fails the case unless something holds."""
    if not holds:
        raise Failed(what)


class Drive:
    """One robot and one run, in a folder and a domain of their own."""

    def __init__(self, options, domain, goal_m, robot=(), more="", top="", boxes=()):
        self.options, self.domain, self.goal_m, self.boxes = options, domain, goal_m, list(boxes)
        self.stack = contextlib.ExitStack()
        self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="scanloop-ros2-")))
        self.system = self.folder / "system.toml"
        self.system.write_text(SYSTEM.format(domain=domain, more=more, top=top))
        (self.folder / "ros2.toml").write_text(SCENARIO.format(track=goal_m + 12.0, goal=goal_m))
        self.environment = {**os.environ, **ENVIRONMENT, "ROS_DOMAIN_ID": str(domain)}
        self.environment["SCANLOOP_SYSTEM_ID"] = f"ros2-{os.getpid()}"
        self.environment["PATH"] = f"{options.ros2.parent}:{options.scanloop.parent}:{os.environ['PATH']}"
        self.robots = 0
        self.arguments = list(robot)
        self.run = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.run and self.run.poll() is None:
            self.run.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.run.wait(10)
            self.run.kill()
        self.stack.close()

    def start_robot(self, more=()):
        """Starts the robot, and waits until it is ready."""
        self.robots += 1
        report = self.folder / f"robot-{self.robots}.json"
        boxes = self.boxes or [f"--box={10 * n},{0.3 if n % 2 else -0.3},0.2,0.4" for n in range(1, int(self.goal_m / 10))]
        arguments = [f"--length={self.goal_m + 15}", f"--report={report}", *boxes, *self.arguments, *more]
        robot = self.start_program("robot.py", *arguments)
        require(robot.stdout.readline() == "ready\n", "the robot does not start")
        return robot, report

    def start_frames(self, *links):
        """Publishes a tree of frames."""
        frames = self.start_program("frames.py", str(self.domain), *links)
        require(frames.stdout.readline() == "ready\n", "the frames are not published")

    def start_program(self, name, *arguments):
        """Starts a program of this folder, which is ended with the drive."""
        command = [sys.executable, ROOT / "tests/ros2" / name, *arguments]
        program = subprocess.Popen(command, env=self.environment, stdout=subprocess.PIPE, text=True)
        self.stack.callback(end, program)
        return program

    def scanloop(self, *arguments, seconds=DEADLINE_S):
        """Runs a command."""
        command = [self.options.scanloop, *arguments]
        try:
            return subprocess.run(command, cwd=self.folder, env=self.environment, capture_output=True, text=True, timeout=seconds)
        except subprocess.TimeoutExpired:
            raise Failed(f"{arguments} does not end within {seconds} s: {self.output()}") from None

    def start(self, *arguments, scenario="ros2.toml"):
        """Starts the drive."""
        with open(self.folder / "err", "w") as errors:
            command = [self.options.scanloop, "run", scenario, "--system", self.system, "--out", "out", "--quiet", *arguments]
            self.run = subprocess.Popen(command, cwd=self.folder, env=self.environment, stdout=errors, stderr=errors)

    def status(self):
        """The state of the running system; nothing while there is none."""
        found = self.scanloop("status", "--json")
        return json.loads(found.stdout) if found.returncode == 0 and found.stdout else None

    def device(self):
        """State and reason of the robot's devices."""
        status = self.status() or {}
        for process in status.get("processes", []):
            if process["role"] == "robot":
                return process.get("device"), process.get("device_reason") or ""
        return None, ""

    def wait(self, what, holds):
        """Waits until something holds."""
        end_at = time.monotonic() + DEADLINE_S
        while not holds():
            ended = self.run.poll()
            require(ended is None, f"{what}: the run has ended with {ended}: {self.output()}")
            require(time.monotonic() < end_at, f"{what}: not within {DEADLINE_S} s: {self.device()} {self.output()}")
            time.sleep(0.02)

    def finish(self, seconds=DEADLINE_S):
        """The exit code."""
        try:
            return self.run.wait(seconds)
        except subprocess.TimeoutExpired:
            raise Failed(f"the run does not end: {self.device()} {self.output()}") from None

    def output(self):
        """What the run has printed."""
        return (self.folder / "err").read_text().strip()

    def log(self):
        """The log of the driver."""
        return (self.folder / "out/logs/robot.log").read_text()

    def report(self):
        """The report of the run."""
        return json.loads((self.folder / "out/report.json").read_text())


def end(robot):
    """Ends a robot; its report is written then."""
    if robot.poll() is None:
        robot.terminate()
        robot.wait(10)
    robot.stdout.close()


def seen(robot, report):
    """What a robot saw, after its end."""
    end(robot)
    return json.loads(report.read_text())


def answers(found):
    """Times from each scan to the first command after it, for the scans between the first and the last driving command [s].

    A scan without a command before the next scan has None.
    """
    driving = [event[1] for event in found["events"] if event[0] == "command" and event[2] > 0.0]
    require(driving, "no command drove")
    scans = [event[1] for event in found["events"] if event[0] == "scan"]
    scans = [scan for scan in scans if driving[0] - PERIOD_S / 2 <= scan <= driving[-1]]
    commands = [event[1] for event in found["events"] if event[0] == "command"]
    times, place = [], 0
    for scan, following in zip(scans, scans[1:] + [scans[-1] + PERIOD_S]):
        while place < len(commands) and commands[place] < scan:
            place += 1
        is_answered = place < len(commands) and commands[place] < following
        times.append(commands[place] - scan if is_answered else None)
    return times


def reached(drive, found, code, goal=None):
    """Requires a drive to the goal without a contact."""
    require(code == 0, f"exit code {code}: {drive.output()} {drive.log()[-2000:]}")
    goal = goal or (drive.goal_m, found["y_m"])
    away = math.dist((found["x_m"], found["y_m"]), goal)
    require(away < 0.25, f"the robot stands {away:.3f} m from the goal")
    require(found["clearance_m"] is None or found["clearance_m"] > 0.03, f"clearance {found['clearance_m']}")
    require(abs(found["speed_mps"]) < 1e-6, "it is not at rest")


def first_zero_s(found, since):
    """Time from a moment to the first zero command after it, when no other follows [s]."""
    after = [event for event in found["events"] if event[0] == "command" and event[1] >= since]
    zeros = [event for event in after if event[2] == 0.0 and event[3] == 0.0]
    require(zeros, f"no zero command came: {after[-3:]}")
    driving = [event for event in after if event[1] > zeros[0][1] and event[2] != 0.0]
    require(not driving, f"a command drove after the zero: {driving[:3]}")
    return zeros[0][1] - since


def driving_pid(drive):
    """The pid of the driver, when the robot drives."""
    drive.wait("its devices run", lambda: drive.device()[0] == "running")
    began = time.monotonic()
    drive.wait("it has driven for two seconds", lambda: time.monotonic() - began > 2.0)
    return next(p["pid"] for p in drive.status()["processes"] if p["role"] == "robot")
