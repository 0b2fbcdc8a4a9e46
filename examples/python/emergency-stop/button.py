"""Made by `scanloop types --python --layout FILE`: do not edit, make it again."""

import ctypes

from scanloop_types import Header, StageStamps


class Button(ctypes.Structure):
    """An emergency stop."""

    LAYOUT = 0xb585a742
    _fields_ = [
        ("header", Header),  # Identity and stamps of the sample that this one answers
        ("pressed", ctypes.c_uint8),  # Not zero while it is pressed, or its contact can't be read
        ("reserved", ctypes.c_uint8 * 7),  # Unused, zero
        ("stage", StageStamps),  # When the process that published it worked on it
    ]

    @staticmethod
    def type_name() -> str:
        return "own.Button.b585a742"
