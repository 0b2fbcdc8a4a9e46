"""What stands around a world: two walls with something uneven at them, so that the way along is seen too, or nothing, or
the polygons of a file, as a floor plan."""

import json
import pathlib

WALL_M, THICK_M = 2.4, 0.1  # middle of each wall, and its thickness
BEHIND_M, BEYOND_M = 3.0, 5.0  # of the start and of the goal
# At uneven distances, so that no place looks like another [m]: where, on which side, how long, and how far from the wall.
PILLARS = [(-1.9, 1, 0.3, 0.25), (-0.6, -1, 0.4, 0.2), (1.1, 1, 0.3, 0.3), (2.3, -1, 0.3, 0.25), (3.9, 1, 0.4, 0.2)]
NICHES = [(-1.2, 1, 1.1, 0.2), (0.9, -1, 0.8, 0.3), (2.7, 1, 0.9, 0.25), (4.4, -1, 1.2, 0.2)]
REPEATED_M = {"pillars": 5.7, "niches": 6.1}
# Walls across beside the way, with a door of 3.4 m in the middle: from -1.7 to 1.7 m.
ROOMS_M, DOOR_M = [-1.5, 1.7, 5.6, 9.3, 12.8, 16.4], 1.7


def around(world):
    """The bodies that stand around a world, of a kind: `open`, `pillars`, `niches`, `rooms`, or a file beside this one."""
    kind, goal_m = world["around"], world["goal"][0]
    if kind == "open":
        return []
    if kind.endswith(".json"):
        parts = json.loads((pathlib.Path(__file__).parent / kind).read_text(encoding="utf-8"))
        return [{"polygon": outline} for part in parts.values() for outline in part]
    from_m, to_m = -BEHIND_M, goal_m + BEYOND_M
    length_m, middle_m = to_m - from_m, (from_m + to_m) / 2
    bodies = [{"at": [middle_m, side * WALL_M], "size": [length_m, THICK_M]} for side in (1, -1)]
    bodies += [{"at": [x, 0.0], "size": [THICK_M, 2 * WALL_M]} for x in (from_m, to_m)]
    inside_m = WALL_M - THICK_M / 2
    if kind == "rooms":
        deep_m = inside_m - DOOR_M
        places = [(x + 0.2 * side, side, 0.15, deep_m) for x in ROOMS_M for side in (1, -1)]
    else:
        pattern, every_m = {"pillars": PILLARS, "niches": NICHES}[kind], REPEATED_M[kind]
        places = [(x + lap * every_m, *rest) for lap in range(4) for x, *rest in pattern]
    for x, side, long_m, deep_m in places:
        if from_m + 0.5 < x < to_m - 0.5:
            bodies.append({"at": [x, side * (inside_m - deep_m / 2)], "size": [long_m, deep_m]})
    return bodies
