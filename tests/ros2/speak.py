#!/usr/bin/env python3
"""A person with the tools of ROS 2: publishes with rclpy what the lines of its standard input say.

A line is JSON: `{"topic": NAME, "kind": NAME, "fields": {PATH: VALUE}, "rate_hz": HZ, "for_s": S}`. A message is sent so
often until another line names its topic, or for that time; without a rate once. With `frozen`, the stamp stays that of the first
message, as of a relay that repeats an old one. The line is answered by `ok` when a reader is there and the messages are on their way, with `for_s` when
they have been sent.
"""

import json
import queue
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu, Joy
from std_msgs.msg import Bool

KINDS = {kind.__name__: kind for kind in (Bool, Imu, Joy, PoseStamped, Twist, TwistStamped)}
READER_S, KNOWN_S = 15.0, 2.0


class Person(Node):
    """Publishes messages, each on its topic."""

    def __init__(self):
        super().__init__("person")
        self.topics = {}
        self.timers_of = {}

    def say(self, line):
        """Begins what a line asks for; returns when it is to be answered."""
        topic = line["topic"]
        if topic in self.timers_of:
            self.destroy_timer(self.timers_of.pop(topic))
        if "kind" not in line:
            return None
        kind = KINDS[line["kind"]]
        if topic not in self.topics:
            self.topics[topic] = self.create_publisher(kind, topic, 10)
        message = kind()
        for path, value in line.get("fields", {}).items():
            place = message
            *parts, last = path.split(".")
            for part in parts:
                place = getattr(place, part)
            setattr(place, last, value)
        begun = time.time()

        def send():
            if hasattr(message, "header"):
                stamp = begun if line.get("frozen") else time.time()
                message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), int(stamp % 1 * 1e9)
            self.topics[topic].publish(message)

        if "rate_hz" in line:
            self.timers_of[topic] = self.create_timer(1.0 / line["rate_hz"], send)
        return send

    def is_read(self, topic):
        """Whether a reader is there."""
        return self.topics[topic].get_subscription_count() > 0


def main():
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    person, executor, lines, greeted = Person(), SingleThreadedExecutor(), queue.Queue(), set()
    executor.add_node(person)

    def read():
        for line in sys.stdin:
            lines.put(json.loads(line))
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()

    def spin(until):
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.01)

    print("ready", flush=True)
    while True:
        executor.spin_once(timeout_sec=0.01)
        try:
            line = lines.get_nowait()
        except queue.Empty:
            continue
        if line is None:
            break
        send = person.say(line)
        end = time.monotonic() + READER_S
        is_new = send and line["topic"] not in greeted
        while is_new and not person.is_read(line["topic"]) and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)
        if is_new:
            # The reader has to know of the publisher as well.
            spin(time.monotonic() + KNOWN_S)
            greeted.add(line["topic"])
        if send and "rate_hz" not in line:
            send()
        if "for_s" in line:
            spin(time.monotonic() + line["for_s"])
            person.say({"topic": line["topic"]})
        print("ok", flush=True)
    executor.shutdown()
    person.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
