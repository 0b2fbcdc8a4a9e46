#!/usr/bin/env python3
"""Drives robots of ROS 2 with Scanloop, and checks what the robot saw.

usage: tests/ros2/run [CASE...]

Without a case: `minute`. With `all`: every case. Exit code 1 if one fails.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
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
base_frame = "base_link"
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

    def __init__(self, options, domain, goal_m, robot=(), more="", top=""):
        self.options, self.goal_m = options, goal_m
        self.stack = contextlib.ExitStack()
        self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="scanloop-ros2-")))
        self.system = self.folder / "system.toml"
        self.system.write_text(SYSTEM.format(domain=domain, more=more, top=top))
        (self.folder / "ros2.toml").write_text(SCENARIO.format(track=goal_m + 12.0, goal=goal_m))
        self.environment = {**os.environ, **ENVIRONMENT, "ROS_DOMAIN_ID": str(domain)}
        self.environment["SCANLOOP_SYSTEM_ID"] = f"ros2-{os.getpid()}"
        self.environment["PATH"] = f"{options.ros2.parent}:{os.environ['PATH']}"
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
        boxes = [f"--box={10 * n},{0.3 if n % 2 else -0.3},0.2,0.4" for n in range(1, int(self.goal_m / 10))]
        command = [sys.executable, ROOT / "tests/ros2/robot.py", f"--length={self.goal_m + 15}", f"--report={report}"]
        command += [*boxes, *self.arguments, *more]
        robot = subprocess.Popen(command, env=self.environment, stdout=subprocess.PIPE, text=True)
        self.stack.callback(end, robot)
        require(robot.stdout.readline() == "ready\n", "the robot does not start")
        return robot, report

    def scanloop(self, *arguments):
        """Runs a command."""
        command = [self.options.scanloop, *arguments]
        return subprocess.run(command, cwd=self.folder, env=self.environment, capture_output=True, text=True)

    def start(self, *arguments):
        """Starts the drive."""
        with open(self.folder / "err", "w") as errors:
            command = [self.options.scanloop, "run", "ros2.toml", "--system", self.system, "--out", "out", "--quiet", *arguments]
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


def reached(drive, found, code):
    """Requires a drive to the goal without a contact."""
    require(code == 0, f"exit code {code}: {drive.output()} {drive.log()[-2000:]}")
    away = abs(found["x_m"] - drive.goal_m)
    require(away < 0.25, f"the robot stands {away:.3f} m from the goal")
    require(found["clearance_m"] is None or found["clearance_m"] > 0.03, f"clearance {found['clearance_m']}")
    require(abs(found["speed_mps"]) < 1e-6, "it is not at rest")


def minute(options):
    """A drive of a minute: every scan arrives here, and a command for each arrives at the robot."""
    with Drive(options, 71, 60.0) as drive:
        robot, report = drive.start_robot()
        drive.start()
        code = drive.finish(120)
        found = seen(robot, report)
        reached(drive, found, code)
        times = answers(found)
        answered = sorted(seconds for seconds in times if seconds is not None)
        places = [place for place, event in enumerate(found["events"]) if event[0] == "command" and event[2] > 0.0]
        window = found["events"][places[0] : places[-1] + 1]
        commands = sum(event[0] == "command" for event in window)
        scans = 1 + sum(event[0] == "scan" for event in window)
        account, inside = drive.report()["scans"], drive.report()["latency_us"]["scan_to_actuation"]
        require(scans >= 600, f"only {scans} scans")
        require(account["published"] >= scans and account["lost"] == 0, f"{scans} scans were sent: {account}")
        # The last command may come after one more scan.
        require(commands >= scans - 1, f"{commands} commands came for {scans} scans: {account}")
        at = lambda share: 1e3 * answered[min(int(share * len(answered)), len(answered) - 1)]
        return (
            f"{scans} scans, {commands} commands; {len(answered)} came before the next scan: {at(0.5):.2f} ms after the scan at the "
            f"median, {at(0.9):.2f} at 90 %, {at(0.99):.2f} at 99 %, of which inside {1e-3 * inside['p50']:.2f} at the median; "
            f"{found['x_m']:.3f} m of {drive.goal_m} m, clearance {found['clearance_m']:.3f} m"
        )


def short(options, domain, robot, more="", top=""):
    """A drive of a few metres with a robot of other properties."""
    with Drive(options, domain, 5.0, robot, more, top) as drive:
        robot, report = drive.start_robot()
        drive.start()
        code = drive.finish()
        found = seen(robot, report)
        reached(drive, found, code)
        times = answers(found)
        lost = times.count(None)
        lags = [event[4] for event in found["events"] if event[0] == "command" and event[4] is not None]
        # One command may be under way while the clock jumps.
        require(sum(abs(lag) > 0.1 for lag in lags) <= 1, f"stamps of commands are off by {sorted(lags)[:1]} to {sorted(lags)[-2:]} s")
        return f"{len(times) - lost} of {len(times)} scans answered, {abs(found['x_m'] - 5.0):.3f} m from the goal"


def beams(options):
    """1081 rays to 135 degrees on both sides."""
    return short(options, 72, ["--rays=1081"])


def around(options):
    """360 rays from 0 to 2 pi, clockwise; commands with a stamp, taken as they come."""
    robot = ["--rays=360", "--half-angle=180", "--from-zero", "--clockwise", "--stamped", "--best-effort"]
    return short(options, 73, robot, 'command = "twist-stamped"')


def twist(options):
    """The twist of the odometry alone, and 40 scans a second."""
    return short(options, 74, ["--rate=40"], 'odometry = "twist"', "rate_hz = 40.0")


def jump(options):
    """The clock of the robot jumps by a day while it drives."""
    return short(options, 75, ["--jump=5,86400", "--stamped"], 'command = "twist-stamped"')


def stall(options):
    """The robot hangs for 2 s: the fault is shown, and the drive continues."""
    with Drive(options, 76, 8.0, ["--stall=8,2"]) as drive:
        robot, report = drive.start_robot()
        drive.start()
        drive.wait("a fault is shown", lambda: drive.device()[0] == "fault" and "no message for" in drive.device()[1])
        reason = drive.device()[1]
        drive.wait("it runs again", lambda: drive.device()[0] == "running")
        code = drive.finish()
        found = seen(robot, report)
        reached(drive, found, code)
        return reason


def restart(options):
    """The robot's node ends and another one starts, with its odometry at zero and another quality of service."""
    with Drive(options, 77, 8.0) as drive:
        robot, report = drive.start_robot()
        drive.start()
        driving_pid(drive)
        first = seen(robot, report)
        drive.start_robot(["--best-effort"])
        code = drive.finish()
        require(code == 0, f"exit code {code}: {drive.output()}")
        require("the odometry has jumped" in drive.log(), "the jump of the odometry was not noticed")
        return f"the first one drove to {first['x_m']:.2f} m"


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


def killed_driver(options):
    """The driver is killed while it drives: its guard stops the wheels at once."""
    with Drive(options, 78, 20.0) as drive:
        robot, report = drive.start_robot()
        drive.start()
        pid = driving_pid(drive)
        killed = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        code = drive.finish()
        found = seen(robot, report)
        seconds = first_zero_s(found, killed)
        require(seconds < 0.15, f"the zero command came after {seconds:.3f} s")
        require(code != 0 and found["speed_mps"] == 0.0, f"exit code {code}, {found['speed_mps']} m/s")
        return f"a zero command after {1e3 * seconds:.1f} ms, exit code {code}"


def killed_run(options):
    """`scanloop run` is killed while it drives: the wheels are blocked after `orphan_stop_s`."""
    top = "orphan_stop_s = 0.5\norphan_timeout_s = 1.5"
    with Drive(options, 79, 20.0, top=top) as drive:
        robot, report = drive.start_robot()
        drive.start()
        pid = driving_pid(drive)
        killed = time.monotonic()
        drive.run.kill()
        drive.run.wait()
        while Path(f"/proc/{pid}").exists():
            require(time.monotonic() - killed < DEADLINE_S, "the driver does not end")
            time.sleep(0.02)
        found = seen(robot, report)
        seconds = first_zero_s(found, killed)
        require(seconds < 1.0, f"the zero command came after {seconds:.3f} s")
        require(found["speed_mps"] == 0.0, "it is not at rest")
        drive.scanloop("stop")
        return f"a zero command after {1e3 * seconds:.0f} ms"


def refused(options, domain, text, robot=None, more=""):
    """A run that can't start: exit code 4, and a text that names why."""
    with Drive(options, domain, 5.0, robot or (), more) as drive:
        if robot is not None:
            drive.start_robot()
        drive.start()
        code = drive.finish()
        told = drive.output() + drive.log()
        require(code == 4, f"exit code {code}: {told}")
        require(text in told, f"`{text}` is not in: {told}")
        return text


def missing(options):
    """What is missing or wrong at the start is named."""
    cases = [
        (80, "/odom has no publisher; there is none of any topic", None, ""),
        (81, "/front/scan has no publisher; there is /cmd_vel, /odom, /scan", [], 'remap = ["scan:=/front/scan"]'),
        (82, "covers -45.0 to 45.0 degrees, but at least -60 to 60 are needed", ["--half-angle=45"], ""),
        (83, "/cmd_vel is geometry_msgs/TwistStamped, but geometry_msgs/Twist is needed", ["--stamped"], ""),
        (84, "/odom: child_frame_id is `base_link`, but the settings have `base_footprint`", [], "#"),
        (85, "/tf_static does not connect `laser`", [], 'scanner_pose = "tf"'),
    ]
    for domain, text, robot, more in cases:
        if more == "#":
            with Drive(options, domain, 5.0) as drive:
                text_of = drive.system.read_text().replace('"base_link"', '"base_footprint"')
                drive.system.write_text(text_of)
                drive.start_robot()
                drive.start()
                code = drive.finish()
                told = drive.output() + drive.log()
                require(code == 4 and text in told, f"exit code {code}, `{text}` is not in: {told}")
        else:
            refused(options, domain, text, robot, more)
    return f"{len(cases)} reasons were named"


def two(options):
    """A second robot publishes on the same topics: the wheels are blocked until it ends."""
    with Drive(options, 86, 12.0) as drive:
        robot, report = drive.start_robot()
        drive.start()
        driving_pid(drive)
        second, _ = drive.start_robot()
        drive.wait("both are noticed", lambda: "two publishers" in drive.device()[1])
        reason = drive.device()[1]
        end(second)
        drive.wait("it runs again", lambda: drive.device()[0] == "running")
        code = drive.finish()
        found = seen(robot, report)
        require(code == 0, f"exit code {code}: {drive.output()}")
        require(abs(found["x_m"] - 12.0) < 0.3, f"at {found['x_m']} m")
        return reason


VIEW = """
[[process]]
role = "companion"
name = "ros2-view"
command = ["{program}", "view", "domain={domain}", "interface=127.0.0.1"]
reads = ["scan", "odometry", "pose", "obstacles", "command", "actuation"]
"""


def view(options):
    """The companion shows an emulated drive to a listener with rclpy."""
    with Drive(options, 87, 5.0) as drive:
        drive.system.write_text(VIEW.format(program=options.ros2, domain=87))
        command = [sys.executable, ROOT / "tests/ros2/listen.py"]
        listener = subprocess.Popen(command, env=drive.environment, stdout=subprocess.PIPE, text=True)
        drive.stack.callback(end, listener)
        require(listener.stdout.readline() == "ready\n", "the listener does not start")
        with open(drive.folder / "err", "w") as errors:
            command = [options.scanloop, "run", "corridor", "--system", drive.system, "--out", "out", "--quiet"]
            drive.run = subprocess.Popen(command, cwd=drive.folder, env=drive.environment, stdout=errors, stderr=errors)
        code = drive.finish(60)
        require(code == 0, f"exit code {code}: {drive.output()}")
        listener.terminate()
        found = json.loads(listener.stdout.readline())
        listener.wait(10)
        published = drive.report()["scans"]["published"]
        least = min(found["counts"].values())
        require(least > published - 25, f"{found['counts']} of {published} scans")
        require(found["rays"] == 682 and found["returns"] > 300, f"{found}")
        require(abs(found["x_m"] - 10.0) < 0.2 and abs(found["path_m"] - 10.0) < 0.2, f"{found}")
        require(0.0 <= found["age_s"] < 30.0, f"{found}")
        states = {name: message for name, message, _ in found["states"]}
        require(len(states) == 5 and states["scanloop: controller"] == "works", f"{found['states']}")
        return f"{found['counts']} of {published} scans; {found['states'][3]}"


CASES = {
    "minute": minute,
    "beams": beams,
    "around": around,
    "twist": twist,
    "jump": jump,
    "stall": stall,
    "restart": restart,
    "killed-driver": killed_driver,
    "killed-run": killed_run,
    "missing": missing,
    "two": two,
    "view": view,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scanloop", type=Path, default=ROOT / "target/debug/scanloop")
    parser.add_argument("--ros2", type=Path, default=ROOT / "services/ros2/target/debug/scanloop-ros2")
    parser.add_argument("case", nargs="*", default=["minute"], choices=[*CASES, "all"])
    options = parser.parse_args()
    options.scanloop, options.ros2 = options.scanloop.resolve(), options.ros2.resolve()
    failed = False
    for name in CASES if "all" in options.case else options.case:
        begun = time.monotonic()
        try:
            told, word = CASES[name](options), "passed"
        except Failed as failure:
            told, word, failed = str(failure), "FAILED", True
        print(f"{name}: {word} after {time.monotonic() - begun:.0f} s: {told}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
