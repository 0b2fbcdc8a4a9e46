"""A controller that follows the nearest of 25 lines along the track on which no ellipse is in the way.

For each line it computes the path of its steering rule over 4 m, in steady turns. A path is verified when it stays on
the track and outside of all ellipses. The first verified path is driven. It assumes that obstacles do not move.

While a person drives, `scanloop teleop`, the path of what the person asks for is driven instead, if it is verified.
"""

import math
import struct
import sys

from scanloop import Handover, Process, Role, answer, current_goal
from scanloop_types import (
    Alarm, Command, CommandKind, DrivenBy, Level, Obstacles, PlanNode, Pose, ScannerState, StopReason,
)

AHEAD_M, STEPS, STEP_M, LINES_M = 1.2, 40, 0.1, 0.15
CURVATURE = 5.405  # of the path per steering angle in a steady turn [1/(m rad)]
SLOWER = 1.0, 0.6, 0.3, 0.1  # shares of the velocity that a person asks for: it gets slower before an obstacle
INSIDE = 0.05  # of (7.34): an ellipse whose middle is where the robot is contradicts the pose
DRIVEN = (ScannerState.HEALTHY, ScannerState.DEGRADED)  # in all other states the scanner shows no obstacle reliably
STATE_KIND = 0x11E50001  # number of this kind of state: the line that is followed


def pursue(y, yaw, line, most):
    """The steering angle of the arc to the point of a line that lies AHEAD_M ahead."""
    lateral = line - y - AHEAD_M * math.sin(yaw)
    return max(-most, min(most, 2 * lateral / AHEAD_M**2 / CURVATURE))


def depth(x, y, e):
    """(7.34): below 1 inside of an ellipse."""
    return ((x - e.x_m) / e.a_m) ** 2 + ((y - e.y_m) / e.b_m) ** 2


def path_of(pose, steer, steps, goal_m, track, ellipses):
    """The path of a steering rule, (x, y, yaw, steering) per step; None when it leaves the track or enters an ellipse.

    Nothing is checked behind the goal, where the robot lands."""
    x, y, yaw, path = pose.predicted_x_m, pose.predicted_y_m, pose.predicted_yaw_rad, []
    allowed = [min(1.0, depth(x, y, e)) for e in ellipses]
    for _ in range(steps):
        steering = steer(y, yaw)
        path.append((x, y, yaw, steering))
        yaw += CURVATURE * steering * STEP_M
        x, y = x + STEP_M * math.cos(yaw), y + STEP_M * math.sin(yaw)
        is_inside = any(depth(x, y, e) < limit for e, limit in zip(ellipses, allowed))
        if x <= goal_m and (is_inside or not track[0] <= y <= track[1]):
            return None
    return path


def stop(reason):
    return Command(kind=CommandKind.LAND if reason == StopReason.LANDED else CommandKind.STOP, reason=reason)


def drive(pose, path, speed, level):
    """The command to drive a verified path."""
    command = Command(kind=CommandKind.DRIVE, level=level, verified=1, velocity_mps=speed)
    command.steering_rad, command.plan_start_ns = path[0][3], pose.predicted_ns
    command.plan_interval_s, command.plan_length = 2 * STEP_M / speed, len(path[::2])
    for index, (x, y, yaw, steering) in enumerate(path[::2]):
        command.plan[index] = PlanNode(x, y, yaw, 0.0, CURVATURE * steering * speed, speed, steering)
    return command


def follow(pose, person, settings, fastest, track, ellipses):
    """What a person asks for, held until the robot could stand behind it; slower where that is not verified."""
    vehicle, period_s = settings["vehicle"], settings["period_s"]
    bounds = vehicle["bounds"]
    age_s = (pose.header.acquired_ns - person.given_ns) * 1e-9
    if not person.number or age_s > max(1.5 * period_s, 0.025) or person.velocity_mps < bounds["velocity_min_mps"]:
        return stop(StopReason.RELEASED)
    steering = max(-bounds["steering_max_rad"], min(bounds["steering_max_rad"], person.steering_rad))
    for share in SLOWER:
        speed = max(bounds["velocity_min_mps"], share * min(person.velocity_mps, fastest))
        way_m = 2 * period_s * speed + speed**2 / (2 * vehicle["blocked_deceleration_mps2"])
        path = path_of(pose, lambda y, yaw: steering, 3 + math.ceil(way_m / STEP_M), math.inf, track, ellipses)
        if path:
            return drive(pose, path, speed, Level.PERSON)
    return stop(StopReason.BLOCKED)


def plan(pose, described, settings, last_line, directive):
    """The command, and the line that it follows."""
    if directive.driven_by == DrivenBy.NOBODY:
        return stop(StopReason.PAUSED), last_line
    by_person = directive.driven_by == DrivenBy.PERSON
    goal, bounds, walls = settings["goal"], settings["vehicle"]["bounds"], settings["track"]["walls"]
    speed, left_m = pose.predicted_speed_mps, goal["x_m"] - pose.predicted_x_m
    stop_m = left_m - speed**2 / (2 * settings["vehicle"]["blocked_deceleration_mps2"])
    if not by_person and stop_m <= max(speed, bounds["velocity_min_mps"]) * settings["period_s"] / 2:  # one scan later it is further away
        landed = math.hypot(stop_m, goal["y_m"] - pose.predicted_y_m) <= goal["tolerance_m"]
        return stop(StopReason.LANDED if landed else StopReason.GOAL_PASSED), last_line
    ellipses = described.items[: described.count]
    if pose.alarm == Alarm.STOP:
        return stop(StopReason.SELF_CHECK), last_line
    scanner = described.scanner
    if scanner.state not in DRIVEN or scanner.seen_ahead_m <= settings["vehicle"]["length_m"] / 2 + left_m - stop_m:
        return stop(StopReason.SCANNER), last_line
    if any(depth(pose.predicted_x_m, pose.predicted_y_m, e) < INSIDE for e in ellipses):
        return stop(StopReason.BAD_INPUT), last_line
    room = settings["vehicle"]["width_m"] / 2 + settings["theta_m"] if walls else 0.0
    track = settings["track"]["y_m"][0] + room, settings["track"]["y_m"][1] - room
    careful = pose.alarm != Alarm.NONE or scanner.state != ScannerState.HEALTHY
    fastest = settings["careful_mps"] if careful else settings["cruise_mps"]
    if by_person:
        return follow(pose, directive.person, settings, fastest, track, ellipses), last_line
    most = bounds["steering_max_rad"]
    lines = [goal["y_m"] + LINES_M * index for index in range(-12, 13)]
    lines.sort(key=lambda line: abs(line - goal["y_m"]) + 0.5 * abs(line - last_line))  # keeps the chosen side
    steer = lambda line: lambda y, yaw: pursue(y, yaw, line, most)
    paths = ((line, path_of(pose, steer(line), STEPS, goal["x_m"], track, ellipses)) for line in lines)
    line, path = next(((line, path) for line, path in paths if path), (last_line, None))
    if path is None:
        return stop(StopReason.BLOCKED), line
    speed = max(bounds["velocity_min_mps"], min(fastest, left_m / settings["landing_time_s"]))
    return drive(pose, path, speed, Level.BEST_ITERATE), line


def main():
    process = Process(Role.CONTROLLER)
    poses, obstacles, commands = process.input(Pose), process.input(Obstacles), process.output(Command)
    settings = process.settings() | {"period_s": process.period_ns * 1e-9}
    if settings["course"]["waypoints"]:
        print("error: this controller follows the line along x only, no [course]", file=sys.stderr)
        sys.exit(2)
    handover, state = process.resume(STATE_KIND)
    line = struct.unpack("d", state)[0] if handover == Handover.STATE else settings["goal"]["y_m"]
    command = Command()
    if process.start():
        while process.wait():
            for pose, described in process.join(poses, obstacles):
                goal = current_goal(process.directive, pose.header.scan_id, settings["goal"])
                if goal != settings["goal"]:  # another was set: the robot drives on, also from where it has landed
                    settings["goal"], line, command = goal, goal["y_m"], Command()
                by_person = process.directive.driven_by == DrivenBy.PERSON
                if by_person or command.kind != CommandKind.LAND:  # a landed robot stays landed
                    command, line = plan(pose, described, settings, line, process.directive)
                command.header = answer(described, pose)
                commands.publish(command)
                process.save(command.header, STATE_KIND, struct.pack("d", line))


if __name__ == "__main__":
    main()
