"""Made by `scanloop types --python --layout FILE`: do not edit, make it again."""

import ctypes

from scanloop_types import Header, StageStamps


class Limit(ctypes.Structure):
    """The speed that an advisor allows."""

    LAYOUT = 0x74264c32
    _fields_ = [
        ("header", Header),  # Identity and stamps of the sample that this one answers
        ("speed_mps", ctypes.c_double),  # Largest speed [m/s]
        ("stage", StageStamps),  # When the process that published it worked on it
    ]

    @staticmethod
    def type_name() -> str:
        return "own.Limit.74264c32"
