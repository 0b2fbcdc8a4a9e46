"""A robot that others wrote, driven as docs/ros2.md says: from an empty folder, with the shipped system file."""

import shutil

from drive import ROOT, Drive, require, seen

WORLD, GOAL_M = "slalom", 14.0  # of tests/worlds


def foreign(options):
    """A robot of ir-sim through the slalom of tests/worlds; ir-sim says where it is and whether it touched anything."""
    with Drive(options, 0, GOAL_M) as drive:
        for file in ("system.toml", "ros2.toml"):
            (drive.folder / file).unlink()
        shutil.copy(ROOT / "examples/ros2/system.toml", drive.system)
        robot = drive.start_program("irsim_robot.py", WORLD, drive.folder / "robot.json")
        require(robot.stdout.readline() == "ready\n", "ir-sim does not start")
        found = drive.scanloop("check", "--system", drive.system, "free", "--set", f"goal.x_m={GOAL_M}")
        require(found.returncode == 0, f"check: {found.stderr}")
        drive.start("--set", f"goal.x_m={GOAL_M}", scenario="free")
        code = drive.finish(120)
        found = seen(robot, drive.folder / "robot.json")
        require(code == 0, f"exit code {code}: {drive.output()}")
        require(not found["touched"], f"ir-sim counts a contact: {found}")
        # `free` ends on the track, wherever beside it the robot is.
        away = abs(found["x_m"] - GOAL_M)
        require(away < 0.2, f"{away:.3f} m from the goal: {found}")
        account = drive.report()["scans"]
        require(account["lost"] == 0, f"{account}")
        return f"{away:.3f} m from the goal, {found['y_m']:.3f} m beside the track"
