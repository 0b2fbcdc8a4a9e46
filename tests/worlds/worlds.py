"""Drives the worlds of others with Scanloop's driver for Python, and prints what their own simulators saw."""

import argparse
import concurrent.futures
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

import page
from drive import LATE_MS, SIZES, drive
from planner import is_passable

HERE = pathlib.Path(__file__).resolve().parent
LIMITS = "= 2.0, 0.12, 1e-9"  # of the driver, for a slower robot than the racecar
FAST = [("irsim", "slalom"), ("pybullet", "slalom")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scanloop", help="the executable")
    parser.add_argument("--fast", action="store_true", help="one world of each simulator, without errors")
    parser.add_argument("--page", action="store_true", help="write table and pictures of docs/worlds.md")
    parser.add_argument("--seeds", type=int, default=1, help="drives of each world")
    parser.add_argument("--only", action="append", help="this world only; may be repeated")
    parser.add_argument("--robot", action="append", choices=SIZES, help="this robot only; may be repeated")
    kinds = {"action": "append", "choices": ["none", "real"]}
    parser.add_argument("--errors", help="of odometer and scanner; default both", **kinds)
    parser.add_argument("--jobs", type=int, default=2, help="drives at a time")
    parser.add_argument("--json", help="file for all drives")
    parser.add_argument("--keep", help="folder for what each drive leaves")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE for `scanloop run`; may be repeated")
    options = parser.parse_args()
    scanloop = shutil.which(options.scanloop) or sys.exit(f"error: no executable {options.scanloop}")
    worlds = json.loads((HERE / "worlds.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(prefix="worlds-") as folder:
        folder = pathlib.Path(folder)
        project = new_project(scanloop, folder)
        run = Run(scanloop, project, worlds, pathlib.Path(options.keep or folder / "drives"), options)
        cases = run.cases()
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(run.row, cases))
    if options.json:
        text = json.dumps([without_way(row) for row in rows], indent=1)
        pathlib.Path(options.json).write_text(text + "\n", encoding="utf-8")
    if options.page:
        page.write(rows, worlds)
    print(page.table(rows), end="")
    bad = [row for row in rows if is_bad(row, options.fast)]
    for row in bad:
        print(json.dumps(without_way(row)), file=sys.stderr)
    sys.exit(1 if bad else 0)


def new_project(scanloop, folder):
    """A project with the driver that users get, for the robots of these worlds."""
    project = folder / "robot"
    new = [scanloop, "new", project.name, "--lang", "python", "--role", "robot"]
    subprocess.run(new, cwd=folder, check=True, capture_output=True)
    for name in ("device.py", "surroundings.py", "world_irsim.py", "world_pybullet.py", "plan.json", "loop.json"):
        shutil.copy(HERE / name, project / name)
    driver = project / "robot.py"
    text = driver.read_text(encoding="utf-8")
    driver.write_text(text.replace(LIMITS, "= 4.3, 0.3, 1e-9"), encoding="utf-8")
    return project


class Run:
    """What all drives of a call share."""

    def __init__(self, scanloop, project, worlds, keep, options):
        self._scanloop, self._project, self._keep, self._options = scanloop, project, keep, options
        self._worlds = worlds

    def cases(self):
        """Robot, world, errors and seed of each drive."""
        options = self._options
        cases = [
            (robot, world, errors, seed)
            for robot in options.robot or SIZES
            for world in self._worlds
            for errors in options.errors or ["none", "real"]
            for seed in range(1, options.seeds + 1)
            if robot in world.get("robots", SIZES) and (not options.only or world["name"] in options.only)
        ]
        if options.fast:
            cases = [case for case in cases if (case[0], case[1]["name"]) in FAST and case[2:] == ("none", 1)]
        return cases

    def row(self, case):
        """Drives a case, once more if it is bad and the machine was late: by how long the driver paused, or did not start."""
        robot, world, errors, seed = case
        passable = is_passable(world, *SIZES[robot])
        row = self._drive(case) | {"passable": passable}
        if is_bad(row, self._options.fast) and row.get("pause_ms", LATE_MS) >= LATE_MS:
            print(f"again, the driver paused for {row.get('pause_ms', '?')} ms: {row['reason']}", file=sys.stderr)
            row = self._drive(case) | {"passable": passable}
        return row

    def _drive(self, case):
        robot, world, errors, seed = case
        folder = self._keep / f"{robot}-{world['name']}-{errors}-{seed}"
        settings, row = list(self._options.set), None
        if "map_of" in world:
            settings.append(f"estimator.map={folder / 'map.yaml'}")
            row = self._draw(robot, world["map_of"], folder)
        row = row or drive(self._scanloop, self._project, folder, settings, case)
        if not self._options.keep:
            shutil.rmtree(folder, ignore_errors=True)
        return row | {"simulator": robot, "world": world["name"], "around": world["around"], "errors": errors, "seed": seed}


    def _draw(self, robot, name, folder):
        """Draws the map of a drive without errors in the world of this name; the row of a failure."""
        world = next(world for world in self._worlds if world["name"] == name)
        before = folder / "before"
        drive(self._scanloop, self._project, before, self._options.set, (robot, world, "none", 1))
        draw = [self._scanloop, "map", before / "out" / "recording.mcap", "--out", folder / "map", "--force"]
        done = subprocess.run(draw, capture_output=True, text=True, check=False)
        return {"outcome": "failed", "reason": done.stderr[-300:]} if done.returncode else None


def is_bad(row, must_reach):
    """Whether a drive touched something, or lost a scan; with `must_reach` also whether it is not at the goal."""
    is_whole = row["outcome"] in ("reached", "stopped", "missed") and not row["unaccounted"]
    return not is_whole or row["touched"] or (must_reach and row["passable"] and not row["there"])


def without_way(row):
    """A drive without the places that it came by."""
    return {key: value for key, value in row.items() if key != "way"}


if __name__ == "__main__":
    main()
