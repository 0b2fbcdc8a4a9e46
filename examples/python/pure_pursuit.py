"""A controller that pursues the nearest of some lines along the track on which no ellipse is in the way.

For each line it follows its own steering rule 4 m ahead, and drives when that path keeps on the track and outside of all
ellipses: this is what it calls verified. Obstacles are taken to stand still, and it slows down for the goal only.
"""

import math

from scanloop import Process, Role, answer
from scanloop_types import Alarm, Command, CommandKind, Level, Obstacles, Pose, StopReason

AHEAD_M, PATH_M, STEP_M, LINES_M = 1.2, 4.0, 0.1, 0.15
CURVATURE = 5.405  # of the path per steering angle in a steady turn [1/(m rad)]


def pursue(y, yaw, line, most):
    """The steering angle of the arc to the point that lies AHEAD_M ahead on a line."""
    lateral = line - y - AHEAD_M * math.sin(yaw)
    return max(-most, min(most, 2 * lateral / AHEAD_M**2 / CURVATURE))


def is_free(pose, line, most, track, ellipses):
    """Whether the path to a line stays on the track and goes into no ellipse, or no deeper than the robot is."""
    x, y, yaw = pose.predicted_x_m, pose.predicted_y_m, pose.predicted_yaw_rad
    depth = [min(1.0, ((x - e.x_m) / e.a_m) ** 2 + ((y - e.y_m) / e.b_m) ** 2) for e in ellipses]
    for _ in range(round(PATH_M / STEP_M)):
        yaw += CURVATURE * pursue(y, yaw, line, most) * STEP_M
        x, y = x + STEP_M * math.cos(yaw), y + STEP_M * math.sin(yaw)
        entered = any(((x - e.x_m) / e.a_m) ** 2 + ((y - e.y_m) / e.b_m) ** 2 < d for e, d in zip(ellipses, depth))
        if entered or not track[0] <= y <= track[1]:
            return False
    return True


def plan(pose, described, settings, last_line):
    """The command, and the line that it pursues."""
    goal, bounds, walls = settings["goal"], settings["bounds"], settings["track"]["walls"]
    speed, left_m = pose.predicted_speed_mps, goal["x_m"] - pose.predicted_x_m
    stop_m = left_m - speed**2 / (2 * settings["deceleration_mps2"])
    if stop_m <= speed * settings["period_s"] / 2:  # stopping now ends nearer to the goal than a scan later
        if math.hypot(stop_m, goal["y_m"] - pose.predicted_y_m) <= goal["tolerance_m"]:
            return Command(kind=CommandKind.LAND, reason=StopReason.LANDED), last_line
        return Command(kind=CommandKind.STOP, reason=StopReason.GOAL_PASSED), last_line
    if pose.alarm == Alarm.STOP:
        return Command(kind=CommandKind.STOP, reason=StopReason.SELF_CHECK), last_line
    room = settings["body_width_m"] / 2 + settings["theta_m"] if walls else 0.0
    track = settings["track"]["y_m"][0] + room, settings["track"]["y_m"][1] - room
    lines = [goal["y_m"] + LINES_M * index for index in range(-12, 13)]
    lines.sort(key=lambda line: abs(line - goal["y_m"]) + 0.5 * abs(line - last_line))  # keeps a side once chosen
    most, ellipses = bounds["steering_max_rad"], described.items[: described.count]
    line = next((line for line in lines if is_free(pose, line, most, track, ellipses)), None)
    if line is None:
        return Command(kind=CommandKind.STOP, reason=StopReason.BLOCKED), last_line
    fastest = settings["cruise_mps"] if pose.alarm == Alarm.NONE else settings["careful_mps"]
    speed = max(bounds["velocity_min_mps"], min(fastest, left_m / settings["landing_time_s"]))
    steering = pursue(pose.predicted_y_m, pose.predicted_yaw_rad, line, most)
    drive = {"kind": CommandKind.DRIVE, "level": Level.BEST_ITERATE, "verified": 1}
    return Command(velocity_mps=speed, steering_rad=steering, **drive), line


process = Process(Role.CONTROLLER)
poses, obstacles, commands = process.input(Pose), process.input(Obstacles), process.output(Command)
settings = process.settings() | {"period_s": process.period_ns * 1e-9}
line = settings["goal"]["y_m"]
if process.start():
    while process.wait():
        for pose, described in process.join(poses, obstacles):
            command, line = plan(pose, described, settings, line)
            command.header = answer(described, pose)
            commands.publish(command)
