#!/usr/bin/env python3
"""Listens to what Scanloop shows of a drive, with rclpy. When asked to end, it prints what has come, as JSON."""

import json
import signal
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import MarkerArray

ELLIPSE, ADD = 3, 0


class Listener(Node):
    """Counts messages, and keeps the newest of each topic."""

    def __init__(self):
        super().__init__("listener")
        self.newest, self.counts, self.states = {}, {}, []
        kinds = {"scan": LaserScan, "odom": Odometry, "path": Path, "plan": Path, "obstacles": MarkerArray}
        for name, kind in kinds.items():
            self.counts[name] = 0
            self.create_subscription(kind, f"/scanloop/{name}", lambda message, name=name: self.take(name, message), qos_profile_sensor_data)

        self.create_subscription(DiagnosticArray, "/diagnostics", self.take_states, 10)
        self.goals = self.create_publisher(PoseStamped, "/goal_pose", 10)
        self.goal, self.topics = None, {}

    def take_states(self, message):
        """States; after the first ones it sends a goal, and notes what there is."""
        self.states.append(message.status)
        self.goal = next((state.message for state in message.status if state.name == "scanloop: goal"), self.goal)
        self.topics.update({name: types[0] for name, types in self.get_topic_names_and_types()})
        if self.goal is None:
            goal = PoseStamped()
            goal.header.frame_id, goal.pose.position.x, goal.pose.position.y = "track", 7.0, -1.0
            self.goals.publish(goal)

    def take(self, name, message):
        """A message."""
        self.counts[name] += 1
        self.newest[name] = message

    def report(self):
        """What has come."""
        found = {"counts": self.counts, "goal": self.goal, "topics": self.topics}
        if "scan" in self.newest:
            scan = self.newest["scan"]
            found["rays"], found["returns"] = len(scan.ranges), sum(1 for r in scan.ranges if scan.range_min <= r <= scan.range_max)
            found["age_s"] = self.get_clock().now().nanoseconds * 1e-9 - scan.header.stamp.sec - scan.header.stamp.nanosec * 1e-9
        if "odom" in self.newest:
            found["x_m"] = self.newest["odom"].pose.pose.position.x
        if "path" in self.newest:
            found["path_m"] = self.newest["path"].poses[-1].pose.position.x
        if "plan" in self.newest:
            found["plan"] = [pose.pose.position.x for pose in self.newest["plan"].poses]
        if "obstacles" in self.newest:
            markers = [m for m in self.newest["obstacles"].markers if m.action == ADD and m.type == ELLIPSE]
            found["obstacles"] = [[m.pose.position.x, m.pose.position.y, m.scale.x, m.scale.y] for m in markers]
        found["states"] = [[s.name, s.message, {v.key: v.value for v in s.values}] for s in (self.states or [[]])[len(self.states) // 2]]
        return found


def main():
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    listener, executor, ended = Listener(), SingleThreadedExecutor(), threading.Event()
    executor.add_node(listener)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    print("ready", flush=True)
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.05)
    print(json.dumps(listener.report()), flush=True)
    executor.shutdown()
    listener.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
