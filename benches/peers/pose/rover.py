"""The recording of a rover with an URG-04LX, as a file that `scanloop-lab estimator --follow` reads."""

import math

TICKS = 2000 / math.pi
WHEEL_M, HALF_AXLE_M = 0.077, 0.165
# The published conversion is too short: fitted to the scans.
WAY, TURN = 1.96, 2.1
# A turn of the scanner; what arrives later was delayed [ns].
TURN_NS = 98_700_000
FIRST_RAD, INCREMENT_RAD = -340 * 2 * math.pi / 1024, 2 * math.pi / 1024


def convert(path, file):
    print(682, repr(FIRST_RAD), repr(INCREMENT_RAD), TURN_NS * 2 // 3, TURN_NS, file=file)
    rows = [line.split() for line in open(path) if line.strip()]
    x = y = yaw = 0.0
    ways = []
    ticks = [(int(row[2]), int(row[3])) for row in rows]
    for before, after in zip([ticks[0], *ticks], ticks):
        left, right = ((now - then) / TICKS * WHEEL_M for then, now in zip(before, after))
        ways.append((WAY * (left + right) / 2, TURN * (right - left) / (2 * HALF_AXLE_M)))
    for index, (row, (way, turn)) in enumerate(zip(rows, ways)):
        x += way * math.cos(yaw + turn / 2)
        y += way * math.sin(yaw + turn / 2)
        yaw += turn
        near = ways[max(index - 1, 0):index + 2]
        speed = sum(way for way, _ in near) / len(near) / TURN_NS * 1e9
        time_ns = 1_000_000_000 + index * TURN_NS
        wrapped = (yaw + math.pi) % (2 * math.pi) - math.pi
        numbers = [time_ns, time_ns + TURN_NS * 2 // 3, x, y, wrapped, speed, 0, 0.0, 0.0, "nan", "nan", "nan"]
        print(*(repr(number) if isinstance(number, float) else number for number in numbers), *row[24:706],
              file=file)

