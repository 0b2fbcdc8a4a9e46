"""How long the bridge takes, one way: from a publication in rclpy to our bus, and from our bus to the robot."""

import bisect
import contextlib
import json
import subprocess

from drive import Drive, end, reached, require, seen

# A sample that took longer belongs to another message [s].
PAIRED_S = 0.09


def paired(before, after):
    """The times from each of `after` back to the newest of `before` [s]."""
    times = []
    for moment in after:
        place = bisect.bisect_right(before, moment)
        if place and moment - before[place - 1] < PAIRED_S:
            times.append(moment - before[place - 1])
    return sorted(times)


def spread(times):
    """Percentiles of times, as text."""
    at = lambda share: 1e3 * times[min(int(share * len(times)), len(times) - 1)]
    return f"p10 {at(0.1):.2f}, p50 {at(0.5):.2f}, p90 {at(0.9):.2f}, p99 {at(0.99):.2f} ms of {len(times)}"


def latency(options):
    """Each part of a drive of 30 s: the figures of docs/ros2.md."""
    with Drive(options, 95, 30.0) as drive:
        robot, report = drive.start_robot()
        peer = drive.start_program("peer.py")
        require(peer.stdout.readline() == "ready\n", "the peer does not start")
        drive.start()
        drive.wait("its devices run", lambda: drive.device()[0] == "running")
        with open(drive.folder / "actuations", "w") as file:
            command = [options.scanloop, "topic", "echo", "actuation", "--short"]
            echo = subprocess.Popen(command, env=drive.environment, stdout=file, stderr=subprocess.DEVNULL)
            code = drive.finish(90)
            with contextlib.suppress(subprocess.TimeoutExpired):
                echo.wait(5)
            echo.kill()
            echo.wait()
        found = seen(robot, report)
        reached(drive, found, code)
        peer.terminate()
        heard = json.loads(peer.stdout.readline())
        end(peer)
        lines = (drive.folder / "actuations").read_text().splitlines()
        chains = [json.loads(line)["header"]["chain"] for line in lines]
        scans = [event[1] for event in found["events"] if event[0] == "scan"]
        commands = [event for event in found["events"] if event[0] == "command"]
        stages = {name: [1e-9 * chain[role]["published_ns"] for chain in chains] for name, role in (("scan", 0), ("actuation", 4))}
        ways = {
            "rclpy publishes a scan -> sample on our bus": paired(scans, stages["scan"]),
            "the same scan -> Fast DDS of another rclpy node": paired(scans, heard),
            "of both: inside `publish` of rclpy": sorted(found["published_s"]),
            "actuation on our bus -> Fast DDS of the robot": paired(stages["actuation"], [event[6] for event in commands]),
            "actuation on our bus -> callback in rclpy": paired(stages["actuation"], [event[1] for event in commands]),
        }
        for name, times in ways.items():
            require(len(times) > 200, f"{name}: only {len(times)} times")
        return "".join(f"\n  {name}: {spread(times)}" for name, times in ways.items())
