"""Exact distances of the robot's rectangle to circles and boxes, as constraints of a program, for `course_optimum.py`.

A box is kept away by one vector of multipliers per node, which is a separating direction (optimisation-based collision
avoidance, DOI 10.1109/TCST.2019.2949540): smooth, and as exact as the distance itself.
"""

import math

from ride_optimum import ca


class Body:
    """An obstacle of a scenario: where it is at a time, and its shape."""

    def __init__(self, obstacle):
        self.is_circle = obstacle["shape"] == "circle"
        self.radius = obstacle["radius_m"] if self.is_circle else 0.0
        self.half = [0.0, 0.0] if self.is_circle else [obstacle["length_m"] / 2, obstacle["width_m"] / 2]
        self.yaw = 0.0 if self.is_circle else obstacle["yaw_rad"]
        self.place = [obstacle["x_m"], obstacle["y_m"]]
        self.velocity = [obstacle["velocity_x_mps"], obstacle["velocity_y_mps"]]
        self.since_s = obstacle["appears_s"]
        self.reach = self.radius + math.hypot(*self.half)
        if obstacle.get("appears_ahead_m") is not None or obstacle.get("disappears_s") is not None:
            raise ValueError(f"the obstacle at {self.place} is not there all the time")

    def centre(self, time_s):
        """Where its centre is at a time since the start of the run, a number or a symbol."""
        return [place + velocity * (time_s - self.since_s) for place, velocity in zip(self.place, self.velocity)]

    def keep(self, program, robot, state, time_s, guess, guess_s, clearance):
        """Keeps the rectangle of the robot at `state` at least `clearance` away. The solver begins from a state and time
        near `guess` and `guess_s`."""
        centre, cosine, sine = self.centre(time_s), ca.cos(state[1]), ca.sin(state[1])
        half = [robot["length_m"] / 2, robot["width_m"] / 2]
        ahead = robot.get("body_x_m", 0.0)
        x, y = centre[0] - state[3] - ahead * cosine, centre[1] - state[4] - ahead * sine
        if self.is_circle:
            outside = [ca.fmax(ca.fabs(value) - side, 0)
                       for value, side in zip((cosine * x + sine * y, cosine * y - sine * x), half)]
            program.constrain(outside[0] ** 2 + outside[1] ** 2, (clearance + self.radius) ** 2, math.inf)
            return
        # The direction from the robot to the box, as the difference of two sums of outward normals with multipliers.
        begin = self.separating(robot, guess, self.centre(guess_s))
        ours = self.multipliers(program, begin, guess[1], 1)
        theirs = self.multipliers(program, begin, self.yaw, -1)
        from_robot = turned(difference(ours), cosine, sine)
        from_box = turned(difference(theirs), math.cos(self.yaw), math.sin(self.yaw))
        for one, other in zip(from_robot, from_box):
            program.constrain(one + other, 0, 0)
        program.constrain(from_robot[0] ** 2 + from_robot[1] ** 2, -math.inf, 1)
        support = sum(side * (ours[2 * axis] + ours[2 * axis + 1]) for axis, side in enumerate(half))
        support += sum(side * (theirs[2 * axis] + theirs[2 * axis + 1]) for axis, side in enumerate(self.half))
        program.constrain(from_robot[0] * x + from_robot[1] * y - support, clearance, math.inf)

    def separating(self, robot, guess, centre):
        """The direction from the robot to the box in which they are farthest apart, of some."""
        def apart(angle):
            x, y = math.cos(angle), math.sin(angle)
            sides = [(robot["length_m"] / 2, robot["width_m"] / 2, guess[1]), (*self.half, self.yaw)]
            support = sum(a * abs(math.cos(angle - yaw)) + b * abs(math.sin(angle - yaw)) for a, b, yaw in sides)
            return x * (centre[0] - guess[3]) + y * (centre[1] - guess[4]) - support
        return max((index * math.tau / 72 for index in range(72)), key=apart)

    @staticmethod
    def multipliers(program, angle, yaw, sign):
        along = [sign * math.cos(angle - yaw), sign * math.sin(angle - yaw)]
        return [program.variable("multiplier", max(side * value, 0.0) + 1e-3, 0.0) for value in along for side in (1, -1)]


def difference(multipliers):
    return [multipliers[0] - multipliers[1], multipliers[2] - multipliers[3]]


def turned(vector, cosine, sine):
    return [cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]]
