"""An emergency stop at a contact that a file shows, such as `/sys/class/gpio/gpio17/value`: 0 for released.

Anything else, and a file that can't be read, is a pressed button: a broken wire must not look like a released one.
"""

import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))

from button import Button  # noqa: E402
from own_topics import Companion  # noqa: E402

READ_EVERY_NS = 20_000_000


def is_pressed(path: str) -> bool:
    """Whether the contact at this path is anything but released."""
    try:
        with open(path, encoding="ascii") as contact:
            return contact.read(8).strip() != "0"
    except (OSError, ValueError):
        return True


if __name__ == "__main__":
    companion = Companion()
    buttons = companion.open("button", Button)
    if companion.start():
        while companion.wait(READ_EVERY_NS):
            buttons.publish(Button(pressed=is_pressed(sys.argv[1])))
