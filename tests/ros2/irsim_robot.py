#!/usr/bin/env python3
"""A robot of ir-sim behind a ROS 2 node: its motion, scans and contacts are those of ir-sim, which nobody here wrote.

usage: irsim_robot.py WORLD REPORT

/odom, /scan and /cmd_vel, as the node of a differential robot has them. What ir-sim has seen is written to REPORT at the
end, as JSON: the pose, whether the robot touched anything, and the distance to the nearest thing.
"""

import contextlib
import io
import json
import math
import signal
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

# It says on standard output which windows it can't open.
with contextlib.redirect_stdout(io.StringIO()):
    import irsim

STEP_S, SCAN_STEPS = 0.05, 2
TIMEOUT_S = 0.5


class Robot(Node):
    """The first robot of a world."""

    def __init__(self, world):
        super().__init__("irsim")
        self.world = irsim.make(world, headless=True, log_level="WARNING", seed=1)
        self.scans = self.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
        self.states = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Twist, "cmd_vel", self.obey, 10)
        self.create_timer(STEP_S, self.advance)
        self.wanted, self.commanded = [0.0, 0.0], -math.inf
        self.began, self.steps = time.monotonic(), 0
        self.touched, self.clearance_m = False, math.inf

    def obey(self, message):
        """A command."""
        self.wanted, self.commanded = [message.linear.x, message.angular.z], time.monotonic()

    def advance(self):
        """Steps the world up to the present, and publishes what is due."""
        robot = self.world.robot
        while self.steps * STEP_S < time.monotonic() - self.began:
            is_fresh = time.monotonic() - self.commanded < TIMEOUT_S
            self.world.step(self.wanted if is_fresh else [0.0, 0.0])
            self.steps += 1
            self.touched |= bool(robot.collision)
            self.states.publish(self.state(robot))
            if self.steps % SCAN_STEPS == 0:
                others = self.world.obstacle_list
                self.clearance_m = min([self.clearance_m, *(robot.geometry.distance(other.geometry) for other in others)])
                self.scans.publish(self.scan())

    def header(self, message, frame):
        """Fills the header of a message."""
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = frame
        return message

    def state(self, robot):
        """The odometry."""
        message = self.header(Odometry(), "odom")
        message.child_frame_id = "base_link"
        x, y, yaw = (float(value) for value in robot.state[:3, 0])
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = (float(value) for value in robot.velocity[:2, 0])
        return message

    def scan(self):
        """The sweep of the scanner."""
        sweep = self.world.get_lidar_scan()
        message = self.header(LaserScan(), "laser")
        for name in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max"):
            setattr(message, name, float(sweep[name]))
        message.ranges = [float(value) for value in sweep["ranges"]]
        return message

    def report(self):
        """What ir-sim has seen."""
        x, y, yaw = (float(value) for value in self.world.robot.state[:3, 0])
        return {"x_m": x, "y_m": y, "yaw_rad": yaw, "touched": self.touched, "clearance_m": self.clearance_m, "steps": self.steps}


def main():
    world, report = sys.argv[1:]
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    robot = Robot(world)
    executor = SingleThreadedExecutor()
    executor.add_node(robot)
    print("ready", flush=True)
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.05)
    with open(report, "w") as file:
        json.dump(robot.report(), file)
    executor.shutdown()
    robot.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
