#!/usr/bin/env python3
"""Publishes /tf_static with another implementation of DDS, CycloneDDS: PyPI has no `tf2_msgs` for rclpy.

usage: frames.py DOMAIN PARENT,CHILD,X,YAW,ROLL...

One link each, in metres and degrees.
"""

import math
import os
import signal
import sys
import threading
from dataclasses import dataclass

URI = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
os.environ["CYCLONEDDS_URI"] = URI

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.types import float64, int32, sequence, uint32  # noqa: E402
from cyclonedds.pub import DataWriter, Publisher  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


def transform(text):
    """The transform of one link: first the roll about its own forward axis, then the yaw."""
    parent, child, x, yaw, roll = text.split(",")
    yaw, roll = math.radians(float(yaw)) / 2, math.radians(float(roll)) / 2
    rotation = Quaternion(
        math.cos(yaw) * math.sin(roll), math.sin(yaw) * math.sin(roll), math.sin(yaw) * math.cos(roll), math.cos(yaw) * math.cos(roll)
    )
    return TransformStamped(Header(Time(0, 0), parent), child, Transform(Vector3(float(x), 0.0, 0.2), rotation))


def main():
    participant = DomainParticipant(int(sys.argv[1]))
    latched = Qos(Policy.Reliability.Reliable(1_000_000_000), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    topic = Topic(participant, "rt/tf_static", TFMessage, qos=latched)
    writer = DataWriter(Publisher(participant), topic, qos=latched)
    writer.write(TFMessage([transform(text) for text in sys.argv[2:]]))
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    print("ready", flush=True)
    ended.wait()


if __name__ == "__main__":
    main()
