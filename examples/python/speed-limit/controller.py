"""The controller of `pure_pursuit.py` with the speed limit of an advisor.

It never waits for the advisor. While no limit has come it drives at the smallest speed.
"""

import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))

from limit import Limit  # noqa: E402
from own_topics import open_topic  # noqa: E402
from pure_pursuit import plan  # noqa: E402
from scanloop import Process, Role, answer, current_goal  # noqa: E402
from scanloop_types import Command, CommandKind, DrivenBy, Obstacles, Pose  # noqa: E402

process = Process(Role.CONTROLLER)
poses, obstacles, commands = process.input(Pose), process.input(Obstacles), process.output(Command)
limits = open_topic(process, "limit", Limit)
settings = process.settings() | {"period_s": process.period_ns * 1e-9}
cruise_mps, line, limit_mps = settings["cruise_mps"], settings["goal"]["y_m"], 0.0
command = Command()
if process.start():
    while process.wait():
        for pose, described in process.join(poses, obstacles):
            goal = current_goal(process.directive, pose.header.scan_id, settings["goal"])
            if goal != settings["goal"]:
                settings["goal"], line, command = goal, goal["y_m"], Command()
            if (newest := limits.newest(pose.header.scan_id)) is not None:
                limit_mps = newest.speed_mps
            settings["cruise_mps"] = min(cruise_mps, max(limit_mps, settings["vehicle"]["bounds"]["velocity_min_mps"]))
            if process.directive.driven_by == DrivenBy.PERSON or command.kind != CommandKind.LAND:
                command, line = plan(pose, described, settings, line, process.directive)
            command.header = answer(described, pose)
            commands.publish(command)
