"""A companion that limits the speed: slowly within a stretch of the track, elsewhere as fast as the controller likes."""

import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))

from limit import Limit  # noqa: E402
from own_topics import Companion  # noqa: E402
from scanloop import answer  # noqa: E402
from scanloop_types import Pose  # noqa: E402

SLOW_FROM_M, SLOW_TO_M, SLOW_MPS, FAST_MPS = 2.0, 4.0, 0.3, 2.0

companion = Companion()
poses, limits = companion.input(Pose), companion.open("limit", Limit)
if companion.start():
    while companion.wait():
        while (pose := poses.take()) is not None:
            slow = SLOW_FROM_M <= pose.x_m <= SLOW_TO_M
            limits.publish(Limit(header=answer(pose), speed_mps=SLOW_MPS if slow else FAST_MPS))
