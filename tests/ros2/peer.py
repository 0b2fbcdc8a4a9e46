#!/usr/bin/env python3
"""Reads /scan beside Scanloop. When asked to end, it prints when Fast DDS received each scan, on CLOCK_MONOTONIC, as JSON."""

import json
import signal
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan


def main():
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node, executor, ended, received = Node("peer"), SingleThreadedExecutor(), threading.Event(), []
    wall = time.time() - time.monotonic()
    note = lambda message, info: received.append(1e-9 * info["received_timestamp"] - wall)
    node.create_subscription(LaserScan, "/scan", note, qos_profile_sensor_data)
    executor.add_node(node)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    print("ready", flush=True)
    while not ended.is_set():
        executor.spin_once(timeout_sec=0.05)
    print(json.dumps(received), flush=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
