"""One drive in a world: Scanloop with its driver for Python, and what the simulator of others saw of it."""

import itertools
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile

SIZES = {"irsim": (0.56, 0.40), "acker": (0.56, 0.40), "pybullet": (0.50, 0.30)}
TOLERANCE_M = 0.1
NUMBERS = itertools.count()  # of systems at the same time
LATE_MS = 100  # a pause of the driver, which is asked to step every 5 ms: that long, the machine was late
# What the data sheet of the odometer with errors says: standard deviations of the turn rate and of the fraction of the way.
DATA_SHEET = ["gyro_bias_radps = 0.01", "odometry_scale = 0.02"]
SYSTEM = """
[[process]]
role = "robot"
command = {command}
start_timeout_s = 60.0  # for the simulator

[[process]]
role = "estimator"
implementation = "ekf"

[[process]]
role = "obstacles"
implementation = "ellipses"

[[process]]
role = "controller"
implementation = "nmpc"

[[process]]
role = "actuator"
implementation = "actuation"

# The odometer of these robots counts the whole way, unless it is made wrong.
[estimator]
odometry_longitudinal = 0.0
{estimator}
[vehicle]
length_m = {length}
width_m = {width}
# An open place looks like a blind scanner: there the robot is careful.
surroundings = "{surroundings}"
{vehicle}
"""


def scenario_of(world):
    """The scenario of a world: its goal on a track, or its course."""
    x_m, y_m = world["goal"]
    if "course" not in world:
        return f'name = "world"\n[track]\ny_m = [-2.0, 2.0]\n[goal]\nx_m = {x_m}\ny_m = {y_m}\n'
    points = [f"{{ x_m = {x}, y_m = {y}, yaw_rad = {yaw} }}" for x, y, yaw in world["course"]]
    laps = f"laps = {world['laps']}\n" if "laps" in world else ""
    course = f"[course]\nwidth_m = {world['width']}\n{laps}waypoints = [{', '.join(points)}]\n"
    return f'name = "world"\ntimeout_s = 170.0\n{course}'


def drive(scanloop, project, folder, settings, case):
    """Drives a case: what Scanloop says of it, and what truly happened. `folder` is for files, None for one that goes."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="world-") as folder:
            return drive(scanloop, project, folder, settings, case)
    simulator, world, errors, seed = case
    folder = pathlib.Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    file = dict(world, wheelbase_m=0.4) if simulator == "acker" else world
    (folder / "world.json").write_text(json.dumps(file), encoding="utf-8")
    length, width = SIZES[simulator]
    values = {
        "WORLD_FILE": folder / "world.json",
        "WORLD_LOG": folder / "truth.jsonl",
        "WORLD_SIMULATOR": "pybullet" if simulator == "pybullet" else "irsim",
        "WORLD_ERRORS": errors,
        "WORLD_SEED": seed,
    }
    variables = [f"{key}={value}" for key, value in values.items()]
    command = ["env", *variables, sys.executable, str(project / "robot.py")]
    parts = {key: "\n".join(world.get(key, [])) for key in ("estimator", "vehicle")}
    parts["estimator"] += "\n".join(DATA_SHEET if errors == "real" else [])
    parts |= {"length": length, "width": width, "command": json.dumps(command)}
    parts["surroundings"] = "open" if world["around"] == "open" else "hall"
    (folder / "system.toml").write_text(SYSTEM.format(**parts), encoding="utf-8")
    (folder / "world.toml").write_text(scenario_of(world), encoding="utf-8")
    name = f"w{os.getpid()}-{next(NUMBERS)}"
    arguments = ["--system-id", name, "run", folder / "world.toml", "--system", folder / "system.toml"]
    run = [scanloop, *arguments, "--out", folder / "out", "--quiet", "--force", "--record"]
    run += [f"--set={setting}" for setting in settings]
    done = subprocess.run(run, capture_output=True, text=True, timeout=240, check=False)
    report, truth = folder / "out" / "report.json", folder / "truth.jsonl"
    if not report.exists() or not truth.exists():
        logs = "".join(log.read_text(encoding="utf-8")[-600:] for log in folder.glob("out/logs/robot*"))
        return {"outcome": "failed", "reason": done.stderr[-300:] + logs}
    said = json.loads(report.read_text(encoding="utf-8"))
    lines = [json.loads(line) for line in truth.read_text(encoding="utf-8").splitlines()]
    at = lines[-1]["at"] if lines else [0.0, 0.0, 0.0]
    distance_m = math.dist(at[:2], world["goal"])
    touched = any(line["touched"] and line["driving"] for line in lines)
    return {
        "outcome": said["outcome"],
        "reason": said["reason"],
        "distance_m": round(distance_m, 3),
        "there": distance_m <= world.get("tolerance_m", TOLERANCE_M) and not touched,
        "touched": touched,
        "struck": any(line["touched"] and not line["driving"] for line in lines),
        "unaccounted": said["scans"]["unaccounted"],
        "scans": said["scans"]["published"],
        "pause_ms": max([line["pause_ms"] for line in lines], default=0),
        "speed_mps": max([line["speed_mps"] for line in lines], default=0.0),
        "way": [line["at"][:2] for line in lines],
    }
