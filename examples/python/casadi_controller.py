"""A controller that solves the optimal control problem of each scan with CasADi and IPOPT.

It solves the problem of the built-in controller, from the same settings: the model (7.27)-(7.31), multiple shooting,
hard bounds of the controls, ellipses (7.34) and lateral bounds with slacks, the same weights and the same moving
reference. Two things differ. Each interval takes small steps with an implicit lateral motion, which is stiff; the
built-in controller uses collocation. And there is no path search: the problem is solved for each passing side of the
first obstacle in the way, with a reference past it on that side, and the plan with the lower cost is taken.

Each plan is verified: it is driven through the model in finer steps, and must keep its distance to all bodies. While a
person drives it stops: it does not follow what a person asks for.
"""

import math
import os
import struct
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")  # the matrices are small, so threads would only slow it down

import casadi as ca  # noqa: E402

from scanloop import Handover, Process, Role, answer, current_goal
from scanloop_types import (
    Alarm, Command, CommandKind, DrivenBy, Level, Obstacles, PlanNode, Pose, ScannerState, SolveStatus, StopReason,
)

MAX_ELLIPSES = 4  # ellipses in the problem: the nearest that are not behind
FAR = (-1e3, 0.0, 0.0, 0.0, 1.0, 1.0)  # an ellipse that constrains nothing
DRIVEN = (ScannerState.HEALTHY, ScannerState.DEGRADED)  # in all other states the scanner shows no obstacle reliably
STATE_KIND = 0xCA5AD001  # number of this kind of state: the passing side and the controls of the plan
COARSE, FINE = 6, 90  # steps of an interval in the problem, and in the verification
BUDGET = 0.15  # share of the period for one solve; two of them end before half a period, the limit in a swap
CHANGE_SIDE = 0.7  # the side is changed when the other one costs less than this share
BEFORE_M, BEHIND_M = 1.0, 0.5  # the reference passes an ellipse from this far before it to this far behind its middle,
CLEAR_M = 0.05  # at this distance from it
AHEAD_M = 1.2  # the initial guess steers to the point of the reference that is this far ahead
OUTSIDE_M = 0.05  # how far a verified plan may be outside of its lateral bounds
MOVING_MPS = 0.1
OVERLAP_M = 0.03  # a deeper overlap of the robot and a body contradicts the pose
ASTRAY_M = 1.0  # a robot that is further outside of its lateral bounds contradicts them


def advance(robot, state, control, step, steps, lib, each=None):
    """The state after an interval, (7.27)-(7.31) in small steps; `lib` is math, or casadi for expressions.

    Implicit Euler for sideslip and yaw rate: they are stiff, and linear while the cosine of the sideslip is 1.
    """
    sideslip, yaw, rate, x, y = state
    velocity, steering = control
    rear, front, h = robot["rear_m"], robot["front_m"], step / steps
    force = robot["stiffness_n_per_rad"] * lib.cos(steering)
    moment = h * force / robot["inertia_kgm2"]
    a11 = 1 + h * 2 * force / (robot["mass_kg"] * velocity)
    a12 = h - h * force * (rear - front) / (robot["mass_kg"] * velocity**2)
    a21 = -moment * (rear - front)
    a22 = 1 + moment * (rear**2 + front**2) / velocity
    determinant = a11 * a22 - a12 * a21
    for _ in range(steps):
        right = rate + moment * steering * (rear + front)
        sideslip, rate = (a22 * sideslip - a12 * right) / determinant, (a11 * right - a21 * sideslip) / determinant
        yaw = yaw + h * rate
        x = x + h * velocity * lib.cos(yaw + sideslip)
        y = y + h * velocity * lib.sin(yaw + sideslip)
        if each is not None:
            each.append((sideslip, yaw, rate, x, y))
    return sideslip, yaw, rate, x, y


class Problem:
    """The nonlinear program. It is built once; what changes from scan to scan is a parameter."""

    def __init__(self, settings, budget_s):
        self.settings, self.count = settings, settings["intervals"]
        self.step, self.fastest = settings["horizon_s"] / self.count, settings["cruise_mps"]
        bounds, weights = settings["vehicle"]["bounds"], settings["weights"]
        walls = settings["vehicle"]["width_m"] / 2 + settings["theta_m"] if settings["track"]["walls"] else 0.0
        self.track = settings["track"]["y_m"][0] + walls, settings["track"]["y_m"][1] - walls
        initial, before, pace = ca.SX.sym("initial", 5), ca.SX.sym("before", 3), ca.SX.sym("pace")
        reference = ca.SX.sym("reference", 2, self.count)
        centres, axes = ca.SX.sym("centres", 2 * MAX_ELLIPSES, self.count), ca.SX.sym("axes", 2, MAX_ELLIPSES)
        variables, low, high, constraints, least, most, cost = [], [], [], [], [], [], 0
        state, last = initial, before[:2]
        for k in range(self.count):
            control, node, slack = ca.SX.sym(f"u{k}", 2), ca.SX.sym(f"x{k}", 5), ca.SX.sym(f"s{k}", 1 + MAX_ELLIPSES)
            variables += [control, node, slack]
            low += [bounds["velocity_min_mps"], -bounds["steering_max_rad"]] + [-math.inf] * 5
            low += [0.0] * (1 + MAX_ELLIPSES)
            high += [bounds["velocity_max_mps"], bounds["steering_max_rad"]] + [math.inf] * (6 + MAX_ELLIPSES)
            reached = advance(settings["vehicle"], ca.vertsplit(state), ca.vertsplit(control), self.step, COARSE, ca)
            constraints += [node - ca.vertcat(*reached), node[4] - slack[0], -node[4] - slack[0]]
            least += [0.0] * 5 + [-math.inf] * 2
            most += [0.0] * 5 + [self.track[1], -self.track[0]]
            for m in range(MAX_ELLIPSES):
                away = (node[3:] - centres[2 * m : 2 * m + 2, k]) / axes[:, m]
                constraints.append(ca.dot(away, away) + slack[1 + m])
                least, most = least + [1.0], most + [math.inf]
            row = weights["terminal"] if k + 1 == self.count else [self.step * w for w in weights["state"]]
            error = node - ca.vertcat(0, 0, 0, reference[:, k])
            cost += ca.dot(ca.DM(row), error**2)
            cost += weights["slack_linear"] * ca.sum1(slack) + weights["slack_quadratic"] * ca.dot(slack, slack)
            cost += self.step * ca.dot(ca.DM(weights["control"]), (control - ca.vertcat(pace, 0)) ** 2)
            cost += (before[2] if k == 0 else 1) * ca.dot(ca.DM(weights["change"]), (control - last) ** 2)
            state, last = node, control
        parameters = [initial, before, pace, ca.vec(reference), ca.vec(centres), ca.vec(axes)]
        program = {"x": ca.vertcat(*variables), "p": ca.vertcat(*parameters), "f": cost, "g": ca.vertcat(*constraints)}
        options = {"print_time": False, "error_on_fail": False}
        options["ipopt"] = {"print_level": 0, "sb": "yes", "tol": 1e-6, "max_wall_time": budget_s, "max_iter": 30,
                            "mu_init": 1e-2}
        self.solver = ca.nlpsol("controller", "ipopt", program, options)
        self.bounds = {"lbx": low, "ubx": high, "lbg": least, "ubg": most}

    def pace(self, x):
        """Velocity of the reference at x: cruising, and slower near the goal."""
        settings = self.settings
        wanted = (settings["goal"]["x_m"] - x) / settings["landing_time_s"]
        return max(settings["vehicle"]["bounds"]["velocity_min_mps"], min(self.fastest, wanted))

    def solve(self, initial, before, ellipses, reference_at, controls):
        """The controls of all intervals, their cost, and the statistics of the solver."""
        x, reference = initial[3], []
        for _ in range(self.count):
            for _ in range(4):
                x += self.pace(x) * self.step / 4
            reference += [x, reference_at(x)]
        ahead = [e for e in ellipses if e[0] + e[4] > initial[3]]
        ahead.sort(key=lambda e: math.hypot(e[0] - initial[3], e[1] - initial[4]))
        ahead = (ahead + [FAR] * MAX_ELLIPSES)[:MAX_ELLIPSES]
        times = [(k + 1) * self.step for k in range(self.count)]
        centres = [number for t in times for e in ahead for number in (e[0] + e[2] * t, e[1] + e[3] * t)]
        axes = [number for e in ahead for number in e[4:6]]
        known = [*initial, *(before or (0.0, 0.0)), 1.0 if before else 0.0, self.pace(initial[3])]
        start, state = [], initial
        for control in controls:
            state = advance(self.settings["vehicle"], state, control, self.step, COARSE, math)
            start += [*control, *state, *[0.01] * (1 + MAX_ELLIPSES)]
        width, limits = 8 + MAX_ELLIPSES, self.settings["vehicle"]["bounds"]
        most_mps = limits["velocity_max_mps"]
        if self.fastest < self.settings["cruise_mps"]:  # drive carefully
            most_mps = max(limits["velocity_min_mps"], min(most_mps, self.fastest))
        self.bounds["ubx"][::width] = [most_mps] * self.count
        result = self.solver(x0=start, p=[*known, *reference, *centres, *axes], **self.bounds)
        found = result["x"].full().ravel().tolist()
        plan = [
            (
                min(max(found[k * width], limits["velocity_min_mps"]), most_mps),
                min(max(found[k * width + 1], -limits["steering_max_rad"]), limits["steering_max_rad"]),
            )
            for k in range(self.count)
        ]
        return plan, float(result["f"]), self.solver.stats()

    def drive(self, initial, controls):
        """The states along the controls, in fine steps."""
        states, state = [], initial
        for control in controls:
            state = advance(self.settings["vehicle"], state, control, self.step, FINE, math, states)
        return states

    def verify(self, initial, controls, ellipses, bodies):
        """Whether the plan stays on the track, enters no ellipse deeper than now, and keeps clear of all bodies."""
        settings = self.settings

        def depth(state, e, t):
            along, across = (state[3] - e[0] - e[2] * t) / e[4], (state[4] - e[1] - e[3] * t) / e[5]
            return 1 - along**2 - across**2

        def outside(state):
            return max(state[4] - self.track[1], self.track[0] - state[4])

        size = settings["vehicle"]["length_m"], settings["vehicle"]["width_m"]
        allowed = [max(0.0, depth(initial, e, 0.0)) + 0.01 for e in ellipses]
        for index, state in enumerate(self.drive(initial, controls)):
            t = (index + 1) * self.step / FINE
            if not all(map(math.isfinite, state)) or outside(state) > max(OUTSIDE_M, outside(initial)):
                return False
            if index % 5 == 4:
                robot = (state[3], state[4], *size, state[1])
                if any(depth(state, e, t) > limit for e, limit in zip(ellipses, allowed)):
                    return False
                for body in bodies:
                    there = (body[0] + body[5] * t, body[1] + body[6] * t, *body[2:5])
                    if distance(robot, there) < settings["clearance_m"]:
                        return False
        return True


def corners(box):
    """Corners of a rectangle (x, y, length, width, yaw)."""
    x, y, length, width, yaw = box
    cos, sin = math.cos(yaw), math.sin(yaw)
    for along, across in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        dx, dy = along * length / 2, across * width / 2
        yield x + dx * cos - dy * sin, y + dx * sin + dy * cos


def distance(one, other):
    """Distance of two rectangles that do not cross: the smallest one of a corner to the other rectangle."""
    nearest = math.inf
    for first, second in ((one, other), (other, one)):
        x, y, length, width, yaw = second
        if math.hypot(first[0] - x, first[1] - y) > 1.5 + length + width:
            return math.inf
        cos, sin = math.cos(yaw), math.sin(yaw)
        for at_x, at_y in corners(first):
            dx, dy = at_x - x, at_y - y
            out = [abs(dx * cos + dy * sin) - length / 2, abs(dy * cos - dx * sin) - width / 2]
            nearest = min(nearest, math.hypot(max(out[0], 0.0), max(out[1], 0.0)) + min(max(out), 0.0))
    return nearest


class Controller:
    """From pose and obstacles to a command."""

    def __init__(self, settings, budget_s):
        self.settings, self.problem = settings, Problem(settings, budget_s)
        self.plan, self.side, self.landed = None, 0, False
        self.solve((0.0,) * 5, [], 0)  # the first solve is slow

    def reference_at(self, initial, ellipses, side):
        """The reference y as a function of x: the line, or past the ellipses in the way, the first one on `side`."""
        line, past = self.settings["goal"]["y_m"], []
        for x, y, _, _, a, b in sorted(self.in_the_way(initial, ellipses)):
            left = side > 0 if not past else y < line
            past.append((x - a - BEFORE_M, x + BEHIND_M, y + (b + CLEAR_M if left else -b - CLEAR_M)))
        return lambda at: next((y for begin, end, y in past if begin < at < end), line)

    def in_the_way(self, initial, ellipses):
        line, reach = self.settings["goal"]["y_m"], initial[3] + 1.8 * self.settings["horizon_s"]
        return [e for e in ellipses if initial[3] < e[0] + BEHIND_M and e[0] < reach and abs(e[1] - line) < e[5]]

    def solve(self, initial, ellipses, side):
        """The plan past the first ellipse in the way on a side: controls, cost and statistics of the solver."""
        reference_at = self.reference_at(initial, ellipses, side)
        start = self.plan if side == self.side else None
        if not start:
            most, state, start = self.settings["vehicle"]["bounds"]["steering_max_rad"], initial, []
            for _ in range(self.problem.count):
                steering = 0.25 * (reference_at(state[3] + AHEAD_M) - state[4] - AHEAD_M * math.sin(state[1]))
                start.append((self.settings["cruise_mps"], max(-most, min(most, steering))))
                state = advance(self.settings["vehicle"], state, start[-1], self.problem.step, COARSE, math)
        return self.problem.solve(initial, self.plan and self.plan[0], ellipses, reference_at, start)

    def step(self, pose, described, driven_by):
        """The command for one scan."""
        settings, problem = self.settings, self.problem
        command = Command(header=answer(described, pose), plan_start_ns=pose.predicted_ns, plan_interval_s=problem.step)
        goal, speed = settings["goal"], pose.predicted_speed_mps
        stop_m = goal["x_m"] - pose.predicted_x_m - speed**2 / (2 * settings["vehicle"]["blocked_deceleration_mps2"])
        slowest = settings["vehicle"]["bounds"]["velocity_min_mps"]
        if self.landed or stop_m <= max(speed, slowest) * settings["period_s"] / 2:  # one scan later it is further away
            miss_m = math.hypot(stop_m, goal["y_m"] - pose.predicted_y_m)
            landed = self.landed = self.landed or miss_m <= goal["tolerance_m"]
            command.kind = CommandKind.LAND if landed else CommandKind.STOP
            command.reason = StopReason.LANDED if landed else StopReason.GOAL_PASSED
            return command
        if driven_by != DrivenBy.CONTROLLER:
            command.reason = StopReason.PAUSED
            return command
        if pose.alarm == Alarm.STOP:
            command.reason = StopReason.SELF_CHECK
            return command
        scanner, braking_m = described.scanner, goal["x_m"] - pose.predicted_x_m - stop_m
        if scanner.state not in DRIVEN or scanner.seen_ahead_m <= settings["vehicle"]["length_m"] / 2 + braking_m:
            command.reason = StopReason.SCANNER
            return command
        careful = pose.alarm != Alarm.NONE or scanner.state != ScannerState.HEALTHY
        problem.fastest = settings["careful_mps"] if careful else settings["cruise_mps"]
        initial = (pose.predicted_sideslip_rad, pose.predicted_yaw_rad, pose.predicted_yaw_rate_radps,
                   pose.predicted_x_m, pose.predicted_y_m)
        ellipses, bodies = self.read(pose, described)
        robot = (initial[3], initial[4], settings["vehicle"]["length_m"], settings["vehicle"]["width_m"], initial[1])
        astray = initial[4] > problem.track[1] + ASTRAY_M or initial[4] < problem.track[0] - ASTRAY_M
        if astray or any(distance(robot, body[:5]) < -OVERLAP_M for body in bodies):
            command.reason = StopReason.BAD_INPUT
            return command
        best, cheapest = None, math.inf
        for side in (1, -1) if self.in_the_way(initial, ellipses) else (0,):
            controls, cost, stats = self.solve(initial, ellipses, side)
            cost *= CHANGE_SIDE if side == self.side else 1.0
            if cost < cheapest and problem.verify(initial, controls, ellipses, bodies):
                best, cheapest = (controls, stats, side), cost
        if best is None:
            self.plan, command.reason = None, StopReason.UNVERIFIED
            return command
        self.plan, _, self.side = best
        return self.drive(command, initial, *best[:2])

    def state(self):
        """The state for the next process: the side, and the plan if there is one."""
        controls = [number for control in self.plan or [] for number in control]
        return struct.pack(f"{1 + len(controls)}d", self.side, *controls)

    def resume(self, state):
        """Resumes from the state of another process."""
        side, *controls = struct.unpack(f"{len(state) // 8}d", state)
        if len(controls) == 2 * self.problem.count:
            self.side, self.plan = int(side), list(zip(controls[::2], controls[1::2]))

    def read(self, pose, described):
        """Ellipses (x, y, vx, vy, a, b) and bodies (x, y, length, width, yaw, vx, vy) at the time the command acts."""
        lead_s = (pose.predicted_ns - pose.header.acquired_ns) * 1e-9
        margin, ellipses, bodies = self.settings["ellipse_margin_m"], [], []
        for item in described.items[: described.count]:
            moves = math.hypot(item.velocity_x_mps, item.velocity_y_mps) > MOVING_MPS
            vx, vy = (item.velocity_x_mps, item.velocity_y_mps) if moves else (0.0, 0.0)
            dx, dy = vx * lead_s, vy * lead_s
            ellipses.append((item.x_m + dx, item.y_m + dy, vx, vy, item.a_m + margin, item.b_m + margin))
            bodies.append((item.box_x_m + dx, item.box_y_m + dy, item.box_length_m, item.box_width_m, item.box_yaw_rad,
                           vx, vy))
        return ellipses, bodies

    def drive(self, command, initial, controls, stats):
        """Fills the command with a verified plan."""
        nodes = [initial, *self.problem.drive(initial, controls)[FINE - 1 :: FINE]]
        for index, (sideslip, yaw, rate, x, y) in enumerate(nodes):
            control = controls[min(index, len(controls) - 1)]
            command.plan[index] = PlanNode(x, y, yaw, sideslip, rate, *control)
        converged = stats["success"]
        command.kind, command.verified, command.plan_length = CommandKind.DRIVE, 1, len(nodes)
        command.level = Level.CONVERGED if converged else Level.BEST_ITERATE
        command.status = SolveStatus.CONVERGED if converged else SolveStatus.MAX_ITERATIONS
        command.side, command.iterations = self.side, stats["iter_count"]
        command.velocity_mps, command.steering_rad = controls[0]
        return command


process = Process(Role.CONTROLLER)
poses, obstacles, commands = process.input(Pose), process.input(Obstacles), process.output(Command)
settings = process.settings() | {"period_s": process.period_ns * 1e-9}
if settings["course"]["waypoints"]:
    print("error: this controller follows the line along x only, no [course]", file=sys.stderr)
    sys.exit(2)
# In simulated time a solve takes no time, so only the iterations are limited.
controller = Controller(settings, 10.0 if process.simulated else BUDGET * settings["period_s"])
handover, state = process.resume(STATE_KIND)
if handover == Handover.STATE:
    controller.resume(state)
if process.start():
    while process.wait():
        for pose, described in process.join(poses, obstacles):
            started_ns = time.monotonic_ns()
            goal = current_goal(process.directive, pose.header.scan_id, settings["goal"])
            if goal != settings["goal"]:  # another was set: the robot drives on, also from where it has landed
                settings["goal"], controller.landed = goal, False
            command = controller.step(pose, described, process.directive.driven_by)
            command.solve_ns = 0 if process.simulated else time.monotonic_ns() - started_ns
            commands.publish(command)
            process.save(command.header, STATE_KIND, controller.state())
