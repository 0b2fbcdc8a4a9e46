"""What fails or is missing, at the start and while a robot drives."""

import os
import signal
import time
from pathlib import Path

from drive import DEADLINE_S, PERIOD_S, Drive, driving_pid, end, first_zero_s, reached, require, seen


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
        drive.start_robot(["--best-effort", "--latched"])
        code = drive.finish()
        require(code == 0, f"exit code {code}: {drive.output()}")
        require("the odometry has jumped" in drive.log(), "the jump of the odometry was not noticed")
        return f"the first one drove to {first['x_m']:.2f} m"


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
        require(seconds < 2 * PERIOD_S, f"the zero command came after {seconds:.3f} s")
        require(code != 0 and found["speed_mps"] == 0.0, f"exit code {code}, {found['speed_mps']} m/s")
        return f"a zero command after {1e3 * seconds:.1f} ms, exit code {code}"


def killed_guard(options):
    """The guard is killed while it drives: the driver stops the wheels, starts another one, and the drive continues."""
    with Drive(options, 88, 8.0) as drive:
        robot, report = drive.start_robot()
        drive.start()
        pid = driving_pid(drive)
        guards = [int(found) for task in Path(f"/proc/{pid}/task").iterdir() for found in (task / "children").read_text().split()]
        require(len(guards) == 1, f"guards: {guards}")
        killed = time.monotonic()
        os.kill(guards[0], signal.SIGKILL)
        code = drive.finish()
        found = seen(robot, report)
        reached(drive, found, code)
        stops = [event for event in found["events"] if event[0] == "command" and event[1] >= killed and event[2] == 0.0]
        seconds = stops[0][1] - killed
        require(seconds < 2 * PERIOD_S, f"the zero command came after {seconds:.3f} s")
        return f"a zero command after {1e3 * seconds:.1f} ms, and the goal was reached"


def killed_run(options):
    """`scanloop run` is killed while it drives: the zero command comes two periods after `orphan_stop_s` at the latest."""
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
        require(seconds < 0.5 + 2 * PERIOD_S, f"the zero command came after {seconds:.3f} s")
        require(found["speed_mps"] == 0.0, "it is not at rest")
        drive.scanloop("stop")
        return f"a zero command after {1e3 * seconds:.0f} ms"


def refused(options, domain, text, robot, more, links=()):
    """A run that can't start: exit code 4, and a text that names why."""
    with Drive(options, domain, 5.0, robot or (), more) as drive:
        if robot is not None:
            drive.start_robot()
        if links:
            drive.start_frames(*links)
        drive.start()
        code = drive.finish()
        told = drive.output() + drive.log()
        require(code == 4, f"exit code {code}: {told}")
        require(text in told, f"`{text}` is not in: {told}")


def missing(options):
    """What is missing or wrong at the start is named."""
    cases = [
        (80, "/odom has no publisher; there is none of any topic", None, ""),
        (81, "/front/scan has no publisher; there is /cmd_vel, /odom, /scan", [], 'remap = ["scan:=/front/scan"]'),
        (82, "covers -45.0 to 45.0 degrees, but at least -60 to 60 are needed", ["--half-angle=45"], ""),
        (83, "/cmd_vel is geometry_msgs/TwistStamped, but geometry_msgs/Twist is needed", ["--stamped"], ""),
        (84, "/odom: child_frame_id is `base_link`, but the settings have `base_footprint`", [], 'base_frame = "base_footprint"'),
        (85, "/tf_static does not connect `laser`", [], 'scanner_pose = "tf"'),
        (89, "/scan is sensor_msgs/Range, but sensor_msgs/LaserScan is needed", ["--scan-type=range"], ""),
        (90, "/scan: frame_id is `laser`, but the settings have `lidar`", [], 'scan_frame = "lidar"'),
        (91, "x 0.100 m, y 0.000 m by /tf_static, but at x 0.000 m", [], 'scanner_pose = "tf"', ["base_link,laser,0.1,0,0"]),
        (92, "tilted by 30.0 degrees", [], 'scanner_pose = "tf"', ["base_link,laser,0,0,30"]),
    ]
    for case in cases:
        refused(options, *case)
    with Drive(options, 233, 5.0) as drive:
        drive.start()
        code = drive.finish()
        require(code == 2 and "ros2.domain = 233 is not allowed" in drive.output(), f"exit code {code}: {drive.output()}")
    return f"{len(cases) + 1} reasons were named"


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
