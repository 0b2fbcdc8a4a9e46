"""The samples of Scanloop. Made by `scanloop types --python`: do not edit, make it again.

Fixed layout, no padding; lengths in metres, angles in radians counter-clockwise, x along the track, y to the left.
"""

import ctypes
import enum

