"""Made by `scanloop types --python --layout FILE`: do not edit, make it again."""

import ctypes

from scanloop_types import Header, StageStamps


class Limit(ctypes.Structure):
    """The speed that an advisor allows."""

    LAYOUT = 0x00000000
    _fields_ = [
    ]
