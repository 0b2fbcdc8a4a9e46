"""Whether a robot can drive past the bodies of a world that rest: a search that knows nothing of Scanloop."""

import heapq
import math

import shapely
import shapely.affinity
from surroundings import around

RADIUS_M, MARGIN_M, STEP_M = 3.2, 0.1, 0.25
GRID_M, GRID_RAD = 0.05, math.radians(2)
EDGE_M, TOLERANCE_M = 2.4, 0.1


def shape_of(body):
    """The outline of a body."""
    if "polygon" in body:
        return shapely.Polygon(body["polygon"])
    if "radius" in body:
        return shapely.Point(body["at"]).buffer(body["radius"])
    (x, y), (length, width) = body["at"], body["size"]
    box = shapely.box(x - length / 2, y - width / 2, x + length / 2, y + width / 2)
    return shapely.affinity.rotate(box, body.get("yaw", 0.0), use_radians=True)


def is_passable(world, length_m, width_m):
    """Whether a way leads to the goal on which the body keeps a decimetre to all bodies at rest and all walls."""
    goal_x, goal_y = world["goal"]
    still = [shape_of(body) for body in world["bodies"] if "velocity" not in body]
    # In the open the way ends where the track does.
    edges = [{"at": [goal_x / 2, side * EDGE_M], "size": [goal_x + 18, 0.2]} for side in (1, -1)]
    walls = [shape_of(body) for body in around(world) + edges]
    taken = shapely.union_all([shape.buffer(MARGIN_M) for shape in still + walls])
    shapely.prepare(taken)
    robot = shapely.box(-length_m / 2, -width_m / 2, length_m / 2, width_m / 2)
    waiting, known = [(goal_x, 0.0, 0.0, 0.0)], set()
    while waiting:
        _, x, y, yaw = heapq.heappop(waiting)
        if math.hypot(x - goal_x, y - goal_y) <= STEP_M / 2 + TOLERANCE_M:
            return True
        for curvature in (0.0, 1 / RADIUS_M, -1 / RADIUS_M):
            turn = curvature * STEP_M
            to = x + STEP_M * math.cos(yaw + turn / 2), y + STEP_M * math.sin(yaw + turn / 2), yaw + turn
            place = round(to[0] / GRID_M), round(to[1] / GRID_M), round(to[2] / GRID_RAD)
            if place in known or to[0] > goal_x + 0.5 or abs(to[2]) > 1.2:
                continue
            known.add(place)
            body = shapely.affinity.rotate(robot, to[2], origin=(0, 0), use_radians=True)
            if not taken.intersects(shapely.affinity.translate(body, to[0], to[1])):
                rest = math.hypot(goal_x - to[0], goal_y - to[1])
                heapq.heappush(waiting, (rest, *to))
    return False
