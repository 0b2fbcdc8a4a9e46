#!/usr/bin/env python3
"""A robot of ir-sim behind a ROS 2 node, in a world of tests/worlds: its motion, scans and contacts are those of ir-sim.

usage: irsim_robot.py WORLD REPORT

/odom, /scan and /cmd_vel, as the node of a differential robot has them. What ir-sim has seen is written to REPORT at the
end, as JSON: the pose, and whether the robot touched anything.
"""

import json
import math
import random
import signal
import sys
import threading
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

WORLDS = Path(__file__).resolve().parents[1] / "worlds"
sys.path.insert(0, str(WORLDS))

from world_irsim import BEAMS, FAN_RAD, World  # noqa: E402

STEP_S, SCAN_STEPS = 0.05, 2
TIMEOUT_S = 0.5
SPEED_MPS, ACCELERATION_MPS2 = 0.8, 3.0
RANGE_M, NOISE_M = 6.0, 0.01
ANGLES_RAD = [FAN_RAD * (beam / (BEAMS - 1) - 0.5) for beam in range(BEAMS)]


class Robot(Node):
    """The robot of a world."""

    def __init__(self, name):
        super().__init__("irsim")
        worlds = json.loads((WORLDS / "worlds.json").read_text(encoding="utf-8"))
        self.world = World(next(world for world in worlds if world["name"] == name), STEP_S)
        self.random = random.Random(1)
        self.scans = self.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
        self.states = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Twist, "cmd_vel", self.obey, 10)
        self.create_timer(STEP_S, self.advance)
        self.wanted, self.commanded = [0.0, 0.0], -math.inf
        self.began, self.steps = time.monotonic(), 0
        self.at, self.turn, self.touched = (0.0, 0.0, 0.0, 0.0), 0.0, False

    def obey(self, message):
        """A command."""
        self.wanted, self.commanded = [message.linear.x, message.angular.z], time.monotonic()

    def advance(self):
        """Steps the world up to the present, and publishes what is due."""
        while self.steps * STEP_S < time.monotonic() - self.began:
            is_fresh = time.monotonic() - self.commanded < TIMEOUT_S
            wanted, turn = self.wanted if is_fresh else (0.0, 0.0)
            most, before = ACCELERATION_MPS2 * STEP_S, self.at[3]
            speed = before + max(-most, min(most, max(-SPEED_MPS, min(SPEED_MPS, wanted)) - before))
            # As it is told, it turns only while it drives.
            self.turn = turn * speed / wanted if wanted else 0.0
            self.at, touched = self.world.step(speed, turn / wanted if wanted else 0.0, not is_fresh)
            self.steps += 1
            self.touched |= touched
            self.states.publish(self.state())
            if self.steps % SCAN_STEPS == 0:
                self.scans.publish(self.scan())

    def header(self, message, frame):
        """Fills the header of a message."""
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = frame
        return message

    def state(self):
        """The odometry."""
        message = self.header(Odometry(), "odom")
        message.child_frame_id = "base_link"
        x, y, yaw, speed = self.at
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = speed, self.turn
        return message

    def scan(self):
        """The sweep of the scanner."""
        message = self.header(LaserScan(), "laser")
        message.angle_min, message.angle_max = ANGLES_RAD[0], ANGLES_RAD[-1]
        message.angle_increment = ANGLES_RAD[1] - ANGLES_RAD[0]
        message.range_min, message.range_max = 0.06, RANGE_M
        ranges = self.world.ranges(ANGLES_RAD)
        message.ranges = [far if far >= RANGE_M else far + self.random.gauss(0.0, NOISE_M) for far in ranges]
        return message

    def report(self):
        """What ir-sim has seen."""
        x, y, yaw, _ = self.at
        return {"x_m": x, "y_m": y, "yaw_rad": yaw, "touched": self.touched, "steps": self.steps}


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
