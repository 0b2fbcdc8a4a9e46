#!/usr/bin/env python3
"""A ROS 2 robot with rclpy: a kinematic simulation in a hall with boxes. Another implementation of ROS 2 than Scanloop's.

It publishes /scan and /odom, follows /cmd_vel, and stops by itself when no command has come for half a second. When it is
asked to end, it writes what it has seen, as JSON, to the file of --report.
"""

import argparse
import json
import math
import signal
import sys
import threading
import time

import numpy
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Imu, LaserScan, Range

STEP_S = 0.01
ODOMETRY_STEPS = 2
TIMEOUT_S = 0.5
HALF_BODY_M = (0.28, 0.20)
# Distances of the walls: behind, and to either side, with a pillar on them now and then [m].
BEHIND_M, SIDE_M, PILLARS_M, PILLAR_M = 3.0, 3.5, 2.5, 0.3
RANGE_M = 8.0
ACCELERATION_MPS2, DECELERATION_MPS2, TURN_RADPS2 = 1.5, 3.0, 6.0


def parse():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--length", type=float, default=30.0, help="length of the hall ahead of the start [m]")
    parser.add_argument("--box", action="append", default=[], metavar="X,Y,LENGTH,WIDTH", help="a box in the way [m]")
    parser.add_argument("--rate", type=float, default=10.0, help="scans per second [Hz]")
    parser.add_argument("--rays", type=int, default=720, help="rays per scan")
    parser.add_argument("--half-angle", type=float, default=135.0, help="the scanner sees so far to each side; 180 is all around [deg]")
    parser.add_argument("--from-zero", action="store_true", help="angles from 0 to 2 pi instead of -pi to pi")
    parser.add_argument("--clockwise", action="store_true", help="rays from left to right, with a negative increment")
    parser.add_argument("--mounting", default="0,0,1", metavar="X,YAW,SIGN", help="the scanner on the robot; -1 is upside down [m, deg]")
    parser.add_argument("--open", action="store_true", help="no walls")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation of the ranges [m]")
    parser.add_argument("--imu", action="store_true", help="publishes /imu, a hundred times per second")
    parser.add_argument("--scan-type", choices=["scan", "range"], default="scan", help="another message on the topic of the scans")
    parser.add_argument("--latched", action="store_true", help="publishes scans reliably, and the newest to those that come later")
    parser.add_argument("--stamped", action="store_true", help="takes TwistStamped instead of Twist")
    parser.add_argument("--best-effort", action="store_true", help="takes commands as they come")
    parser.add_argument("--stall", metavar="AT,FOR", help="hangs after AT seconds for FOR seconds; its wheels obey their timeout")
    parser.add_argument("--jump", metavar="AT,BY", help="after AT seconds its clock jumps by BY seconds")
    parser.add_argument("--mute", metavar="AT", type=float, help="publishes no scan after so many seconds [s]")
    parser.add_argument("--report", help="file of the report")
    return parser.parse_args()


class Hall:
    """Walls and boxes, all axis-parallel."""

    def __init__(self, length_m, boxes, is_open):
        # Walls that the scanner never reaches are none.
        far_m = 1e3 if is_open else 0.0
        sides = [(-BEHIND_M - far_m, -SIDE_M - far_m, length_m + far_m, SIDE_M + far_m)]
        for x, y, length, width in boxes:
            sides.append((x - length / 2, y - width / 2, x + length / 2, y + width / 2))
        self.boxes = sides[1:]
        for step in range(0 if is_open else int((length_m + BEHIND_M) / PILLARS_M)):
            at, half = step * PILLARS_M - BEHIND_M / 2, PILLAR_M / 2
            for y in (-SIDE_M + half, SIDE_M - half):
                sides.append((at - half, y - half, at + half, y + half))
        xs, ys = [], []
        for x0, y0, x1, y1 in sides:
            xs += [(x0, y0, y1), (x1, y0, y1)]
            ys += [(y0, x0, x1), (y1, x0, x1)]
        self.xs, self.ys = numpy.array(xs), numpy.array(ys)

    def ranges(self, x, y, angles):
        """Distance to the nearest side in each direction; infinite beyond the range of the scanner."""
        cos, sin = numpy.cos(angles)[:, None], numpy.sin(angles)[:, None]
        with numpy.errstate(divide="ignore", invalid="ignore"):
            along = (self.xs[:, 0] - x) / cos
            hit = y + along * sin
            along[~((along > 0) & (hit >= self.xs[:, 1]) & (hit <= self.xs[:, 2]))] = numpy.inf
            across = (self.ys[:, 0] - y) / sin
            hit = x + across * cos
            across[~((across > 0) & (hit >= self.ys[:, 1]) & (hit <= self.ys[:, 2]))] = numpy.inf
        nearest = numpy.minimum(along.min(axis=1), across.min(axis=1))
        nearest[nearest > RANGE_M] = numpy.inf
        return nearest

    def clearance(self, x, y, yaw):
        """Distance from the outline of the body to the nearest box [m]."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        steps = [i / 10 for i in range(-10, 11)]
        outline = [(HALF_BODY_M[0] * s, side * HALF_BODY_M[1]) for s in steps for side in (-1, 1)]
        outline += [(side * HALF_BODY_M[0], HALF_BODY_M[1] * s) for s in steps for side in (-1, 1)]
        found = math.inf
        for ahead, left in outline:
            px, py = x + cos * ahead - sin * left, y + sin * ahead + cos * left
            for x0, y0, x1, y1 in self.boxes:
                found = min(found, math.hypot(max(x0 - px, 0, px - x1), max(y0 - py, 0, py - y1)))
        return found


class Robot(Node):
    """The robot as a node."""

    def __init__(self, options):
        super().__init__("robot")
        self.options = options
        self.hall = Hall(options.length, [tuple(map(float, box.split(","))) for box in options.box], options.open)
        kind = LaserScan if options.scan_type == "scan" else Range
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.scans = self.create_publisher(kind, "scan", latched if options.latched else qos_profile_sensor_data)
        self.odometry = self.create_publisher(Odometry, "odom", 10)
        kind = TwistStamped if options.stamped else Twist
        reliability = ReliabilityPolicy.BEST_EFFORT if options.best_effort else ReliabilityPolicy.RELIABLE
        self.create_subscription(kind, "cmd_vel", self.obey, QoSProfile(depth=10, reliability=reliability))
        self.x = self.y = self.yaw = self.speed = self.turn = 0.0
        self.wanted = (0.0, 0.0)
        self.started = time.monotonic()
        self.steps = self.swept = 0
        self.commanded = None
        self.events = []
        self.published_s = []
        self.least_clearance = math.inf
        self.offset_s = 0.0
        self.random = numpy.random.default_rng(1)
        self.imu = self.create_publisher(Imu, "imu", qos_profile_sensor_data) if options.imu else None
        self.create_timer(STEP_S, self.advance)
        full = options.half_angle >= 180
        span = 2 * math.radians(options.half_angle)
        self.increment = span / (options.rays if full else options.rays - 1)
        self.first = 0.0 if options.from_zero else -span / 2
        if options.clockwise:
            self.first, self.increment = -self.first, -self.increment
        self.ahead, yaw, sign = map(float, options.mounting.split(","))
        # Where each ray points on the robot.
        self.angles = math.radians(yaw) + sign * (self.first + self.increment * numpy.arange(options.rays))
        # Stamps of DDS are of the wall clock, those of the events of the monotonic one.
        self.wall = time.time() - time.monotonic()

    def obey(self, message, info):
        """A command."""
        twist = message.twist if self.options.stamped else message
        now = time.monotonic()
        lag = None
        if self.options.stamped:
            stamp = message.header.stamp
            lag = self.now_s() - (stamp.sec + stamp.nanosec * 1e-9)
        self.commanded = now
        self.wanted = (twist.linear.x, twist.angular.z)
        sent, received = (1e-9 * info[key] - self.wall for key in ("source_timestamp", "received_timestamp"))
        self.events.append(("command", now, twist.linear.x, twist.angular.z, lag, sent, received))

    def now_s(self):
        """The clock of the robot [s]."""
        return time.time() + self.offset_s

    def stamp(self, header, frame):
        """Fills a header."""
        now = self.now_s()
        header.stamp.sec, header.stamp.nanosec = int(now), int((now % 1) * 1e9)
        header.frame_id = frame

    def advance(self):
        """Moves the robot to the present, and publishes what is due."""
        elapsed = time.monotonic() - self.started
        if self.options.stall:
            at, length = map(float, self.options.stall.split(","))
            if elapsed >= at:
                self.options.stall = None
                self.events.append(("stall", time.monotonic()))
                time.sleep(length)
        if self.options.jump:
            at, by = map(float, self.options.jump.split(","))
            if elapsed >= at:
                self.options.jump = None
                self.events.append(("jump", time.monotonic()))
                self.offset_s += by
        while self.steps * STEP_S < elapsed:
            self.steps += 1
            self.step()
            if self.steps % 10 == 0:
                self.least_clearance = min(self.least_clearance, self.hall.clearance(self.x, self.y, self.yaw))
        # What is due once, however long this node was held up.
        if self.steps // ODOMETRY_STEPS > getattr(self, "reported", -1):
            self.reported = self.steps // ODOMETRY_STEPS
            self.publish_odometry()
        if self.imu:
            message = Imu()
            self.stamp(message.header, "imu")
            # It is mounted upside down.
            message.angular_velocity.z = -self.turn
            self.imu.publish(message)
        due = int(elapsed * self.options.rate)
        if due > self.swept and not (self.options.mute and elapsed > self.options.mute):
            self.swept = due
            self.publish_scan()

    def step(self):
        """One step of the motion."""
        silent = self.commanded is None or time.monotonic() - self.commanded > TIMEOUT_S
        speed, turn = (0.0, 0.0) if silent else self.wanted
        up = STEP_S * (ACCELERATION_MPS2 if speed > self.speed else DECELERATION_MPS2)
        self.speed += max(-up, min(up, speed - self.speed))
        most = STEP_S * TURN_RADPS2
        self.turn += max(-most, min(most, turn - self.turn))
        self.yaw += self.turn * STEP_S
        self.x += self.speed * math.cos(self.yaw) * STEP_S
        self.y += self.speed * math.sin(self.yaw) * STEP_S

    def publish_odometry(self):
        """The pose as the base has it."""
        message = Odometry()
        self.stamp(message.header, "odom")
        message.child_frame_id = "base_link"
        message.pose.pose.position.x, message.pose.pose.position.y = self.x, self.y
        message.pose.pose.orientation.z = math.sin(self.yaw / 2)
        message.pose.pose.orientation.w = math.cos(self.yaw / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = self.speed, self.turn
        self.odometry.publish(message)

    def publish_scan(self):
        """A sweep that takes no time."""
        if self.options.scan_type != "scan":
            self.scans.publish(Range())
            return
        message = LaserScan()
        self.stamp(message.header, "laser")
        message.angle_min, message.angle_increment = self.first, self.increment
        message.angle_max = self.first + self.increment * (self.options.rays - 1)
        message.range_min, message.range_max = 0.05, RANGE_M
        message.scan_time = 1.0 / self.options.rate
        at = (self.x + self.ahead * math.cos(self.yaw), self.y + self.ahead * math.sin(self.yaw))
        ranges = self.hall.ranges(*at, self.angles + self.yaw)
        ranges += self.options.noise * self.random.standard_normal(ranges.size)
        message.ranges = ranges.astype(numpy.float32).tolist()
        # Before it goes out: the answer may come before `publish` returns.
        begun = time.monotonic()
        self.events.append(("scan", begun))
        self.scans.publish(message)
        self.published_s.append(time.monotonic() - begun)

    def report(self):
        """What it has seen."""
        return {
            "x_m": self.x,
            "y_m": self.y,
            "speed_mps": self.speed,
            "clearance_m": self.least_clearance if self.hall.boxes else None,
            "events": self.events,
            "published_s": self.published_s,
        }


def main():
    options = parse()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    robot = Robot(options)
    executor = SingleThreadedExecutor()
    executor.add_node(robot)
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    print("ready", flush=True)
    try:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.05)
        # What it was told last shows in where it comes to rest.
        until = time.monotonic() + 2.0
        while robot.speed != 0.0 and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
    except ExternalShutdownException:
        pass
    if options.report:
        with open(options.report, "w") as file:
            json.dump(robot.report(), file)
    executor.shutdown()
    robot.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
