"""Robots that work: each is driven to its goal."""

import contextlib
import json
import subprocess

from drive import Drive, answers, reached, require, seen
from person import NOISE, add

IMU = """
[[topic]]
name = "imu"
layout = "{root}/examples/rust/imu/imu.toml"
"""


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


def frames(options):
    """The scanner is turned and upside down, and only /tf_static says so: two links up to the base."""
    robot = ["--rays=720", "--half-angle=180", "--mounting=0.1,130,-1"]
    more = 'base_frame = "base_link"\nscanner_pose = "tf"\n[vehicle]\nscanner_x_m = 0.1'
    with Drive(options, 93, 20.0, robot, more) as drive:
        robot, report = drive.start_robot()
        drive.start_frames("base_link,mast,0.1,90,0", "mast,laser,0.0,40,180", "base_link,foot,0.5,0,0")
        drive.start()
        code = drive.finish(60)
        found = seen(robot, report)
        reached(drive, found, code)
        return f"{abs(found['x_m'] - 20.0):.3f} m from the goal, clearance {found['clearance_m']:.3f} m"


def hokuyo(options):
    """The robot has no scanner: the scans come from a Hokuyo at this computer, which is pulled out while it drives."""
    scanner = subprocess.Popen([options.scanloop, "urg", "emulate", "--tcp", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True)
    try:
        more = f'scan = "urg"\nurg = "{scanner.stdout.readline().strip()}"'
        with Drive(options, 95, 0.5, ["--mute=0.001", "--open"], more) as drive:
            robot, report = drive.start_robot()
            drive.start()
            drive.wait("base and scanner run", lambda: drive.device() == ("running", ""))
            # The emulated scanner stands still, so the robot soon stops for one that is stuck.
            drive.wait("scans come", lambda: drive.status()["scan"] > 5)
            scanner.kill()
            drive.wait("the scanner is named", lambda: drive.device()[0] == "fault" and "scanner" in drive.device()[1])
            reason = drive.device()[1]
            drive.finish(60)
            found = seen(robot, report)
            require(any(event[0] == "command" and event[2] > 0.0 for event in found["events"]), "no command drove")
            require(abs(found["speed_mps"]) < 1e-6, "it is not at rest")
            return f"it drove {found['x_m']:.3f} m by the Hokuyo and stopped: {reason}"
    finally:
        scanner.kill()
        scanner.wait()


def imu(options):
    """A gyro that is mounted upside down: its samples say how far the robot has turned from scan to scan, as the odometry does."""
    with Drive(options, 94, 12.0, [*NOISE, "--imu"], boxes=["--box=6,0.3,0.2,0.4"]) as drive:
        add(drive, "imu", 'reads = ["odometry"]\nwrites = ["imu"]', ["up=0,0,-1"], IMU)
        drive.start_robot()
        drive.start()
        drive.wait("its devices run", lambda: drive.device()[0] == "running")
        echoes = []
        for topic in ("imu", "odometry"):
            with open(drive.folder / topic, "w") as file:
                command = [options.scanloop, "topic", "echo", topic, "--short"]
                echoes.append(subprocess.Popen(command, env=drive.environment, stdout=file, stderr=subprocess.DEVNULL))
        code = drive.finish(60)
        require(code == 0, f"exit code {code}: {drive.output()}")
        for echo in echoes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                echo.wait(5)
            echo.kill()
            echo.wait()
        found = {}
        for topic in ("imu", "odometry"):
            samples = [json.loads(line) for line in (drive.folder / topic).read_text().splitlines() if line.endswith("}")]
            found[topic] = {sample["header"]["scan_id"]: sample for sample in samples}
        both = sorted(found["imu"].keys() & found["odometry"].keys())
        require(len(both) > 0.9 * len(found["odometry"]), f"{len(both)} samples for {len(found['odometry'])} scans")
        turned = {scan: sample["yaw_rate_radps"] * sample["dt_s"] for scan, sample in found["imu"].items()}
        require(max(map(abs, turned.values())) > 0.02, f"it has not turned: {max(turned.values())}")
        wrong = max(abs(turned[scan] - found["odometry"][scan]["dyaw_rad"]) for scan in both)
        # A message of the gyro is 10 ms old at most, in which the yaw rate changes by 0.06 rad/s.
        require(wrong < 5e-3, f"between two scans both differ by {wrong} rad")
        return f"{len(both)} of {len(found['odometry'])} scans, at most {1e3 * wrong:.2f} mrad from the odometry of the same scan"
