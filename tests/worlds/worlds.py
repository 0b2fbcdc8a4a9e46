"""Drives the worlds of others with Scanloop's driver for Python, and prints what their own simulators saw."""

import argparse
import concurrent.futures
import json
import math
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from planner import is_passable, shape_of
from surroundings import around

HERE = pathlib.Path(__file__).resolve().parent
SIZES = {"irsim": (0.56, 0.40), "acker": (0.56, 0.40), "pybullet": (0.50, 0.30)}
TOLERANCE_M = 0.1
FAST = [("irsim", "slalom"), ("pybullet", "slalom")]
SYSTEM = """
[[process]]
role = "robot"
command = {command}

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

[vehicle]
length_m = {length}
width_m = {width}
# An open place looks like a blind scanner: there the robot is careful.
surroundings = "{surroundings}"
"""


def drive(scanloop, project, keep, settings, simulator, world, errors, seed):
    """One drive: what Scanloop says of it, and what truly happened."""
    with tempfile.TemporaryDirectory(prefix="world-") as folder:
        folder = pathlib.Path(folder)
        if keep:
            folder = pathlib.Path(keep).resolve() / f"{simulator}-{world['name']}-{errors}-{seed}"
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
        kind = "open" if world["around"] == "open" else "hall"
        system = SYSTEM.format(command=json.dumps(command), length=length, width=width, surroundings=kind)
        (folder / "system.toml").write_text(system, encoding="utf-8")
        x_m, y_m = world["goal"]
        scenario = f'name = "world"\n[track]\ny_m = [-2.0, 2.0]\n[goal]\nx_m = {x_m}\ny_m = {y_m}\n'
        (folder / "world.toml").write_text(scenario, encoding="utf-8")
        name = f"w{os.getpid() % 100000}{abs(hash((simulator, world['name'], errors, seed))) % 10000}"
        arguments = ["--system-id", name, "run", folder / "world.toml", "--system", folder / "system.toml"]
        run = [scanloop, *arguments, "--out", folder / "out", "--quiet", "--force"]
        run += [f"--set={setting}" for setting in settings]
        run += ["--record"] if keep else []
        done = subprocess.run(run, capture_output=True, text=True, timeout=180, check=False)
        report, truth = folder / "out" / "report.json", folder / "truth.jsonl"
        if not report.exists() or not truth.exists():
            logs = "".join(log.read_text(encoding="utf-8")[-600:] for log in folder.glob("out/logs/robot*"))
            return {"outcome": "failed", "reason": done.stderr[-300:] + logs}
        said = json.loads(report.read_text(encoding="utf-8"))
        lines = [json.loads(line) for line in truth.read_text(encoding="utf-8").splitlines()]
        at = lines[-1]["at"] if lines else [0.0, 0.0, 0.0]
        return {
            "outcome": said["outcome"],
            "reason": said["reason"],
            "suspect": said.get("estimate", {}).get("suspect"),
            "distance_m": round(math.dist(at[:2], world["goal"]), 3),
            "touched": any(line["touched"] and line["driving"] for line in lines),
            "struck": any(line["touched"] and not line["driving"] for line in lines),
            "unaccounted": said["scans"]["unaccounted"],
            "scans": said["scans"]["published"],
            "way": [line["at"][:2] for line in lines],
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scanloop", help="the executable")
    parser.add_argument("--fast", action="store_true", help="one world of each simulator, without errors")
    parser.add_argument("--seeds", type=int, default=1, help="drives of each world")
    parser.add_argument("--only", action="append", help="this world only; may be repeated")
    kinds = {"action": "append", "choices": ["none", "real"]}
    parser.add_argument("--errors", help="of odometer and scanner; default both", **kinds)
    parser.add_argument("--jobs", type=int, default=2, help="drives at a time")
    parser.add_argument("--json", help="file for all drives")
    parser.add_argument("--pictures", help="folder for a picture of each world")
    parser.add_argument("--keep", help="folder for what each drive leaves")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE for `scanloop run`; may be repeated")
    options = parser.parse_args()
    scanloop = shutil.which(options.scanloop) or sys.exit(f"error: no executable {options.scanloop}")
    worlds = json.loads((HERE / "worlds.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(prefix="worlds-") as folder:
        project = pathlib.Path(folder) / "robot"
        new = [scanloop, "new", project.name, "--lang", "python", "--role", "robot"]
        subprocess.run(new, cwd=folder, check=True, capture_output=True)
        for name in ("device.py", "surroundings.py", "world_irsim.py", "world_pybullet.py"):
            shutil.copy(HERE / name, project / name)
        cases = [
            (simulator, world, errors, seed)
            for simulator in SIZES
            for world in worlds
            for errors in options.errors or ["none", "real"]
            for seed in range(1, options.seeds + 1)
            if not options.only or world["name"] in options.only
        ]
        if options.fast:
            cases = [case for case in cases if (case[0], case[1]["name"]) in FAST and case[2:] == ("none", 1)]
        passable = {
            (simulator, world["name"]): is_passable(world, *SIZES[simulator]) for simulator, world, *_ in cases
        }
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            ends = list(pool.map(lambda case: drive(scanloop, project, options.keep, options.set, *case), cases))
    rows = [
        dict(end, simulator=case[0], world=case[1]["name"], around=case[1]["around"], errors=case[2], seed=case[3])
        | {"passable": passable[case[0], case[1]["name"]]}
        for case, end in zip(cases, ends)
    ]
    if options.json:
        text = json.dumps([without_way(row) for row in rows], indent=1)
        pathlib.Path(options.json).write_text(text + "\n", encoding="utf-8")
    if options.pictures:
        for world in worlds:
            draw(world, [row for row in rows if row["world"] == world["name"] and row.get("way")], options.pictures)
    sys.exit(print_table(rows, options.fast))


def without_way(row):
    """A drive without the places that it came by."""
    return {key: value for key, value in row.items() if key != "way"}


def draw(world, rows, folder):
    """Draws the ways of all drives in a world, as the simulators saw them."""
    if not rows:
        return
    goal_x, goal_y = world["goal"]
    shapes = [shape_of(body) for body in world["bodies"] + around(world) if "velocity" not in body]
    parts = [f'<polygon points="{points(shape.exterior.coords)}" fill="#444"/>' for shape in shapes]
    for body in world["bodies"]:
        if "velocity" in body:
            (x, y), (vx, vy) = body["at"], body["velocity"]
            ends = points([(x, y), (x + 12 * vx, y + 12 * vy)])
            line = f'points="{ends}" fill="none" stroke="#999" stroke-dasharray="0.1" stroke-width="0.04"'
            parts.append(f"<polyline {line}/>")
            parts.append(f'<circle cx="{x}" cy="{-y}" r="{body["radius"]}" fill="#999"/>')
    colours = {"irsim": "#0060a0", "acker": "#2a8a2a", "pybullet": "#c05000"}
    for row in rows:
        dash = "" if row["errors"] == "none" else ' stroke-dasharray="0.15 0.1"'
        line = f'points="{points(row["way"])}" fill="none" stroke="{colours[row["simulator"]]}" stroke-width="0.04"'
        parts.append(f"<polyline {line}{dash}/>")
    place = f'cx="{goal_x}" cy="{-goal_y}" r="{TOLERANCE_M}"'
    parts.append(f'<circle {place} fill="none" stroke="#080" stroke-width="0.04"/>')
    for index, (name, colour) in enumerate(colours.items()):
        parts.append(f'<text x="{3 * index}" y="-2.1" font-size="0.35" fill="{colour}">{name}</text>')
    parts.append('<text x="9" y="-2.1" font-size="0.35">dashed: with errors of odometer and scanner</text>')
    view = f"-1 -2.6 {goal_x + 5} 5.2"
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view}" font-family="sans-serif"><rect x="-1" y="-2.6" '
    svg += f'width="{goal_x + 5}" height="5.2" fill="#fff"/>' + "".join(parts) + "</svg>\n"
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{world['name']}.svg").write_text(svg, encoding="utf-8")


def points(places):
    """Places as the points of a line in a picture, whose y is downwards."""
    return " ".join(f"{x:.2f},{-y:.2f}" for x, y in places)


def kind_of(row):
    """The simulator of a drive, whether something stands around its world, and its errors."""
    return row["simulator"], "open" if row["around"] == "open" else "walls", row["errors"]


def print_table(rows, must_reach):
    """Prints a row for each simulator and kind of errors; returns the exit code."""
    print("| simulator | surroundings | errors | drives | passable | at the goal | elsewhere | stopped | contacts | struck at rest |")
    print("|---|---|---|---:|---:|---:|---:|---:|---:|---:|")
    kinds = {kind_of(row): [] for row in rows}
    for row in rows:
        kinds[kind_of(row)].append(row)
    for kind, of in kinds.items():
        reached = [row for row in of if row["outcome"] == "reached"]
        there = [row for row in reached if row["distance_m"] <= TOLERANCE_M and not row["touched"]]
        stopped = sum(row["outcome"] == "stopped" for row in of)
        struck, touched = (sum(bool(row.get(key)) for row in of) for key in ("struck", "touched"))
        passable = sum(row["passable"] for row in of)
        counts = [len(of), passable, len(there), len(reached) - len(there), stopped, touched, struck]
        print(f"| {' | '.join(kind)} | " + " | ".join(map(str, counts)) + " |")
    bad = [row for row in rows if row.get("touched") or row["outcome"] not in ("reached", "stopped", "missed")]
    bad += [row for row in rows if row.get("unaccounted")]
    bad += [row for row in rows if must_reach and row["passable"] and row["outcome"] != "reached"]
    for row in bad:
        print(json.dumps(without_way(row)), file=sys.stderr)
    return 1 if bad else 0


if __name__ == "__main__":
    main()
